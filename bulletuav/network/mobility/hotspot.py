"""Users who gather about places that drift, as crowds do about what they came to see; the model is our own."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.errors import as_int
from bulletuav.kernel import kernel
from bulletuav.network.mobility.base import (
    LONGEST,
    MOST_SPEED,
    Generators,
    State,
    Walking,
    check_range,
    headings,
    normals,
)
from bulletuav.network.mobility.gauss_markov import gauss_markov
from bulletuav.network.mobility.ground import Ground, bounce, length

TURNING_TIME = 1 / math.log(2.5)  # s; after a second 0.4 of a heading is left
MOST_HOTSPOTS, MOST_WOBBLE = 1000, 100.0
SHORT = 1e-12  # vectors that are shorter have no direction


@dataclass(frozen=True)
class Hotspot(Walking):
    """Each user belongs to a hotspot and walks at its own constant speed, the way its heading vector points.

    That vector is a Gauss-Markov process about the unit vector towards the hotspot, so that headings blend on the circle,
    alike for any time step; nearer than `radius` to the hotspot it is one about its own direction, and users mill around.
    Hotspots drift straight on. At walls and the edge all turn as light does by mirrors; users know no way round a building
    but find one in time, by their wobble.

    num_hotspots  in each world
    drift         speeds of hotspots, m/s, from low to high, drawn uniformly
    radius        m
    turning_time  s, until 1 / e of a heading is left
    wobble        standard deviation of each axis of the heading vector
    """

    name: ClassVar[str] = "hotspot"
    num_hotspots: int = 2
    drift: tuple[float, float] = (0.2, 1.0)
    radius: float = 20.0
    turning_time: float = TURNING_TIME
    wobble: float = 0.3

    def __post_init__(self):
        super().__post_init__()
        self._keep("num_hotspots", as_int("num_hotspots", self.num_hotspots, 1, MOST_HOTSPOTS))
        self._keep("drift", check_range("drift", self.drift, "m/s", MOST_SPEED, above_zero=False))
        self._size("turning_time", " s", LONGEST, above_zero=True)
        self._size("radius", "", LONGEST, above_zero=False)
        self._size("wobble", "", MOST_WOBBLE, above_zero=False)

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Also "hotspots" (H, 2) m, "hotspot_velocity" (H, 2) m/s, "user_hotspot" (U,), "user_speed" (U,) m/s.

        And "user_heading" (U, 2), about as long as unit vectors.
        """
        of_hotspots = dict.fromkeys(("hotspots", "hotspot_velocity"), (self.num_hotspots, 2))
        own = {"user_hotspot": (count,), "user_speed": (count,), "user_heading": (count, 2)}
        return super().state(count) | of_hotspots | own

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Users and hotspots at random places, with random headings."""
        number, speed, heading = (
            self.num_hotspots,
            rng.uniform(*self.speed, count),
            headings(rng, count),
        )
        return {
            "users": ground.places(rng, layout, count),
            "user_velocity": speed[:, None] * heading,
            "hotspots": ground.places(rng, layout, number)[:, :2],
            "hotspot_velocity": rng.uniform(*self.drift, (number, 1)) * headings(rng, number),
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
        where = (ground.raster, layout, flying, dt)
        drift(state["hotspots"], state["hotspot_velocity"], *where)
        own = (
            state["users"],
            state["user_velocity"],
            state["user_heading"],
            state["user_speed"],
            state["user_hotspot"],
        )
        noise = normals(rng, flying, *state["user_heading"].shape[1:])
        keep = math.exp(-dt / self.turning_time)
        advance(
            *own, state["hotspots"], noise, *where, keep, float(self.radius), float(self.wobble)
        )


@kernel
def drift(hotspots, velocity, raster, layout, flying, dt):
    """Move hotspots (W, H, 2) straight on through dt s."""
    for w in range(hotspots.shape[0]):
        if not flying[w]:
            continue
        for h in range(hotspots.shape[1]):
            place, way = hotspots[w, h], velocity[w, h]
            place[0], place[1], turned_x, turned_y = bounce(
                raster, layout[w], place[0], place[1], dt * way[0], dt * way[1]
            )
            way[0], way[1] = turned_x * way[0], turned_y * way[1]


@kernel
def advance(
    users,
    velocity,
    heading,
    speed,
    hotspot,
    hotspots,
    noise,
    raster,
    layout,
    flying,
    dt,
    keep,
    radius,
    wobble,
):
    """Move users (W, U, 3) through dt s; noise (W, U, 2) is standard normal."""
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        for i in range(users.shape[1]):
            place, own, goal = users[w, i], heading[w, i], hotspots[w, int(hotspot[w, i])]
            x, y = goal[0] - place[0], goal[1] - place[1]
            if length(x, y) < radius:
                x, y = own[0], own[1]
            size = max(length(x, y), SHORT)
            x = gauss_markov(own[0], x / size, keep, wobble, noise[w, i, 0])
            y = gauss_markov(own[1], y / size, keep, wobble, noise[w, i, 1])
            pace = speed[w, i] / max(length(x, y), SHORT)
            place[0], place[1], turned_x, turned_y = bounce(
                raster, layout[w], place[0], place[1], dt * pace * x, dt * pace * y
            )
            own[0], own[1] = turned_x * x, turned_y * y
            velocity[w, i, 0], velocity[w, i, 1] = pace * own[0], pace * own[1]
