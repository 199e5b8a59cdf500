"""Hotspot mobility model: users gather around drifting hotspots, as crowds do.

The model is specific to this package.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import exp, log
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import as_int
from bulletuav.network.mobility.base import (
    MAX_LENGTH,
    MAX_TIME,
    MAX_VELOCITY,
    SPEED_LIMIT,
    Generators,
    State,
    Walking,
    check_range,
    random_headings,
    standard_normals,
)
from bulletuav.network.mobility.gauss_markov import gauss_markov
from bulletuav.network.mobility.ground import Ground
from bulletuav.network.mobility.raster import Raster, bounce, length
from bulletuav.registry import register

TURNING_TIME = 1 / log(2.5)
"""Default turning time, s: after one second a fraction of 0.4 of a heading remains"""
MAX_HOTSPOTS = 1000
"""Maximum number of hotspots in options"""
MAX_WOBBLE = 100.0
"""Maximum wobble in options"""
SHORT = 1e-12
"""Minimum length of a vector that has a direction"""


@register("mobility")
@dataclass(frozen=True)
class HotspotMobility(Walking):
    """Hotspot mobility model.

    Each user belongs to a hotspot and walks with its own constant speed along its heading vector.
    The heading vector is a Gauss-Markov process around the unit vector to the hotspot, so that
    headings change smoothly and independently of the time step. Within `radius` of the hotspot, the
    mean is the user's own direction, and users mill around.

    Hotspots drift with constant velocity. At walls and at the edge, hotspots and users are
    reflected. Users have no path planning; their wobble leads them around buildings eventually.

    Attributes:
        num_hotspots: Number of hotspots in each world.
        drift: Minimum and maximum speed of hotspots, m/s; each is drawn uniformly.
        radius: Distance within which users mill around, m.
        turning_time: Time constant of heading changes (decay to 1 / e), s.
        wobble: Standard deviation of each component of the heading vector.
    """

    name: ClassVar[str] = "hotspot"
    num_hotspots: int = 2
    drift: tuple[float, float] = (0.2, 1.0)
    radius: float = 20.0
    turning_time: float = TURNING_TIME
    wobble: float = 0.3

    def __post_init__(self) -> None:
        """Validate the options."""
        super().__post_init__()
        count = as_int("num_hotspots", self.num_hotspots, 1, MAX_HOTSPOTS)
        self._set_option("num_hotspots", count)
        drift = check_range("drift", self.drift, unit="m/s", most=SPEED_LIMIT, above_zero=False)
        self._set_option("drift", drift)
        self._check_number("turning_time", unit=" s", most=MAX_TIME, above_zero=True)
        self._check_number("radius", unit="", most=MAX_LENGTH, above_zero=False)
        self._check_number("wobble", unit="", most=MAX_WOBBLE, above_zero=False)

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Return the state arrays, see `Mobility.state`.

        The additional arrays are, for H hotspots: "hotspots" (H, 2), positions, m;
        "hotspot_velocity" (H, 2), m/s; "user_hotspot" (U,), the index of each user's hotspot;
        "user_speed" (U,), m/s; and "user_heading" (U, 2), with a length of about 1.
        """
        return super().state(count) | {
            "hotspots": (self.num_hotspots, 2),
            "hotspot_velocity": (self.num_hotspots, 2),
            "user_hotspot": (count,),
            "user_speed": (count,),
            "user_heading": (count, 2),
        }

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the state arrays, see `Mobility.bounds`."""
        half_side = float(ground.raster.half_side)
        return super().bounds(ground) | {
            "hotspots": (-half_side, half_side),
            "hotspot_velocity": (-MAX_VELOCITY, MAX_VELOCITY),
            "user_hotspot": (0, self.num_hotspots - 1),
            "user_speed": (0.0, MAX_VELOCITY),
            "user_heading": (-MAX_VELOCITY, MAX_VELOCITY),
        }

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw random positions of users and hotspots, with random headings.

        See `Mobility.start`.
        """
        number = self.num_hotspots
        speed = rng.uniform(*self.speed, count)
        heading = random_headings(rng, count)
        users = ground.places(rng, layout, count)
        hotspots = ground.places(rng, layout, number)[:, :2]
        drift_speed = rng.uniform(*self.drift, (number, 1))
        drift_heading = random_headings(rng, number)
        return {
            "users": users,
            "user_velocity": speed[:, None] * heading,
            "hotspots": hotspots,
            "hotspot_velocity": drift_speed * drift_heading,
            "user_hotspot": rng.integers(number, size=count).astype(float),
            "user_speed": speed,
            "user_heading": heading,
        }

    def _move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Advance hotspots and users as `move`."""
        # Hotspots first: users follow the new positions
        drift(state["hotspots"], state["hotspot_velocity"], ground.raster, layout, flying, dt)
        # Draw only for worlds that fly, so that paused worlds stay reproducible
        noise = standard_normals(rng, flying, *state["user_heading"].shape[1:])
        advance_hotspot_users(
            state["users"],
            state["user_velocity"],
            state["user_heading"],
            state["user_speed"],
            state["user_hotspot"],
            state["hotspots"],
            noise,
            ground.raster,
            layout,
            flying,
            dt,
            exp(-dt / self.turning_time),
            float(self.radius),
            float(self.wobble),
        )


@kernel
def drift(
    hotspots: np.ndarray,
    velocity: np.ndarray,
    raster: Raster,
    layout: np.ndarray,
    flying: np.ndarray,
    dt: float,
) -> None:
    """Advance hotspots with constant velocity by one time step, in place.

    Args:
        hotspots: Positions (W, H, 2), m; modified.
        velocity: Velocities (W, H, 2), m/s; modified at walls.
        raster: Free cells of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) hotspots of each world move.
        dt: Length of the step, s.
    """
    for w in range(hotspots.shape[0]):
        if not flying[w]:
            continue
        for i in range(hotspots.shape[1]):
            place = hotspots[w, i]
            own = velocity[w, i]
            # Move, with reflections at walls
            end_x, end_y, turned_x, turned_y = bounce(
                raster, layout[w], place[0], place[1], dt * own[0], dt * own[1]
            )
            place[0] = end_x
            place[1] = end_y
            # Apply the reflections to the direction
            own[0] = turned_x * own[0]
            own[1] = turned_y * own[1]


@kernel
def advance_hotspot_users(
    users: np.ndarray,
    velocity: np.ndarray,
    heading: np.ndarray,
    speed: np.ndarray,
    hotspot: np.ndarray,
    hotspots: np.ndarray,
    noise: np.ndarray,
    raster: Raster,
    layout: np.ndarray,
    flying: np.ndarray,
    dt: float,
    correlation: float,
    radius: float,
    wobble: float,
) -> None:
    """Advance users by one time step, in place.

    Args:
        users: Positions (W, U, 3), m; modified.
        velocity: Velocities (W, U, 2), m/s; overwritten.
        heading: Heading vectors (W, U, 2); modified.
        speed: Speeds (W, U), m/s.
        hotspot: Index (W, U) of each user's hotspot.
        hotspots: Positions (W, H, 2) of hotspots, m.
        noise: Standard normal numbers (W, U, 2).
        raster: Free cells of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) users of each world move.
        dt: Length of the step, s.
        correlation: Correlation of headings `dt` apart.
        radius: Distance within which users mill around, m.
        wobble: Standard deviation of each component of the heading vector.
    """
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        for i in range(users.shape[1]):
            place = users[w, i]
            own = heading[w, i]
            goal = hotspots[w, int(hotspot[w, i])]
            # Mean heading: towards the hotspot, or the user's own heading near the hotspot
            x = goal[0] - place[0]
            y = goal[1] - place[1]
            if length(x, y) < radius:
                x = own[0]
                y = own[1]
            size = max(length(x, y), SHORT)
            # Next heading, and a move along it at the user's speed
            x = gauss_markov(own[0], x / size, correlation, wobble, noise[w, i, 0])
            y = gauss_markov(own[1], y / size, correlation, wobble, noise[w, i, 1])
            pace = speed[w, i] / max(length(x, y), SHORT)
            end_x, end_y, turned_x, turned_y = bounce(
                raster, layout[w], place[0], place[1], dt * pace * x, dt * pace * y
            )
            place[0] = end_x
            place[1] = end_y
            # Apply the reflections to the direction
            own[0] = turned_x * x
            own[1] = turned_y * y
            velocity[w, i, 0] = pace * own[0]
            velocity[w, i, 1] = pace * own[1]
