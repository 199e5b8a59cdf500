"""Random waypoint mobility model: users walk straight from one waypoint to the next, with pauses.

Among buildings, waypoints are always in direct view, as in ns-3's outdoor random walk.

References:
    D. Johnson and D. Maltz, Dynamic source routing in ad hoc wireless networks, 1996.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import power
from bulletuav.compiled.kernel import func, kernel
from bulletuav.network.mobility.base import (
    MAX_TIME,
    MAX_VELOCITY,
    Generators,
    State,
    Walking,
    check_range,
    stream_keys,
    stream_uniform,
)
from bulletuav.network.mobility.ground import Ground
from bulletuav.network.mobility.raster import Raster, cell_index, is_free, length, move_straight
from bulletuav.registry import register

MAX_TRIES = 100
"""Maximum number of candidate waypoints before a user pauses"""
RETRY_PAUSE = 1.0
"""Pause of a user without a visible waypoint, s"""


@register("mobility")
@dataclass(frozen=True)
class Waypoint(Walking):
    """Random waypoint mobility model.

    Each user draws a waypoint, uniformly over the free ground in direct view, walks there at a
    newly drawn speed, and pauses. After 100 candidates out of view, a user waits for a second.

    The time average of the walking speed is (high - low) / ln(high / low). This is less than the
    mean of low and high, since slow legs take longer. The speeds of first legs are drawn from this
    stationary distribution, so that the mean speed does not decay.

    References:
        W. Navidi and T. Camp, Stationary distributions for the random waypoint mobility model, IEEE
        Trans. Mobile Computing 3(1), 2004.

    Attributes:
        pause: Minimum and maximum pause, s; each is drawn uniformly.
    """

    name: ClassVar[str] = "waypoint"
    pause: tuple[float, float] = (0.0, 30.0)

    def __post_init__(self) -> None:
        """Validate the options."""
        super().__post_init__()
        pause = check_range("pause", self.pause, unit="s", most=MAX_TIME, above_zero=False)
        self._set_option("pause", pause)

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Return the state arrays, see `Mobility.state`.

        The additional arrays are "user_goal" (U, 2), m; "user_speed" (U,) of the current or next
        leg, m/s; and "user_pause" (U,), the remaining pause, s.
        """
        return super().state(count) | {
            "user_goal": (count, 2),
            "user_speed": (count,),
            "user_pause": (count,),
        }

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the state arrays, see `Mobility.bounds`."""
        half_side = float(ground.raster.half_side)
        return super().bounds(ground) | {
            "user_goal": (-half_side, half_side),
            "user_speed": (0.0, MAX_VELOCITY),
            "user_pause": (0.0, MAX_TIME),
        }

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw random positions; users choose their first waypoint at the first step.

        See `Mobility.start`.
        """
        users = ground.places(rng, layout, count)
        # Stationary distribution of speeds: density proportional to 1 / speed
        low, high = self.speed
        return {
            "users": users,
            "user_velocity": np.zeros((count, 2)),
            "user_goal": users[:, :2].copy(),
            "user_speed": low * power(high / low, rng.random(count)),
            "user_pause": np.zeros(count),
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
        """Advance users as `move`."""
        advance_waypoint(
            state["users"],
            state["user_velocity"],
            state["user_goal"],
            state["user_speed"],
            state["user_pause"],
            stream_keys(rng, flying),
            ground.raster,
            layout,
            flying,
            dt,
            (*self.speed, *self.pause),
        )


@kernel
def advance_waypoint(
    users: np.ndarray,
    velocity: np.ndarray,
    goal: np.ndarray,
    speed: np.ndarray,
    pause: np.ndarray,
    key: np.ndarray,
    raster: Raster,
    layout: np.ndarray,
    flying: np.ndarray,
    dt: float,
    ranges: tuple[float, float, float, float],
) -> None:
    """Advance users by one time step, in place.

    Args:
        users: Positions (W, U, 3), m; modified.
        velocity: Velocities (W, U, 2), m/s; overwritten.
        goal: Waypoints (W, U, 2), m; modified.
        speed: Speeds (W, U) of the current or next leg, m/s; modified.
        pause: Remaining pauses (W, U), s; modified.
        key: Keys (W,) of the random streams, uint64.
        raster: Free cells of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) users of each world move.
        dt: Length of the step, s.
        ranges: Minimum and maximum speed, m/s; minimum and maximum pause, s.
    """
    slowest, fastest, shortest, longest = ranges
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        # All users of a world share one random stream
        drawn = 0
        for i in range(users.shape[1]):
            place = users[w, i]
            aim = goal[w, i]
            left = dt
            # Pauses and legs until the step is over
            while left > 0.0:
                spent = 0.0
                gap = length(aim[0] - place[0], aim[1] - place[1])
                if pause[w, i] > 0.0:
                    spent = min(pause[w, i], left)
                    pause[w, i] -= spent
                elif gap == 0.0:
                    # Pause is over: draw the next waypoint, or wait if none is visible
                    aim[0], aim[1], drawn = draw_visible_position(
                        raster, layout[w], place[0], place[1], key[w], drawn
                    )
                    if aim[0] == place[0] and aim[1] == place[1]:
                        pause[w, i] = RETRY_PAUSE
                elif gap > left * speed[w, i]:
                    # Walk for the rest of the step
                    spent = left
                    for axis in range(2):
                        place[axis] += left * speed[w, i] * (aim[axis] - place[axis]) / gap
                else:
                    # Reach the waypoint; draw the pause and the speed of the next leg
                    spent = gap / speed[w, i]
                    place[0] = aim[0]
                    place[1] = aim[1]
                    speed[w, i] = slowest + (fastest - slowest) * stream_uniform(key[w], drawn)
                    pause[w, i] = shortest + (longest - shortest) * stream_uniform(
                        key[w], drawn + 1
                    )
                    drawn += 2
                left -= spent
            # Velocity towards the waypoint; zero at the waypoint
            gap = length(aim[0] - place[0], aim[1] - place[1])
            for axis in range(2):
                if gap > 0.0:
                    velocity[w, i, axis] = speed[w, i] * (aim[axis] - place[axis]) / gap
                else:
                    velocity[w, i, axis] = 0.0


@func
def draw_visible_position(
    raster: Raster, layout: int, x: float, y: float, key: int, drawn: int
) -> tuple[float, float, int]:
    """Draw a position, uniformly over the free ground in direct view of a user.

    Args:
        raster: Free cells of all layouts.
        layout: Index of the layout.
        x: Position of the user, m.
        y: Position of the user, m.
        key: Key of the random stream.
        drawn: Number of consumed numbers of the stream.

    Returns:
        x and y of the position, or of the user if no position was found, m; and the new number of
        consumed numbers.
    """
    # Rejection sampling over the whole ground
    for _ in range(MAX_TRIES):
        new_x = raster.sides[layout, 0] * (stream_uniform(key, drawn) - 0.5)
        new_y = raster.sides[layout, 1] * (stream_uniform(key, drawn + 1) - 0.5)
        drawn += 2
        if is_free(raster, layout, cell_index(new_x, raster), cell_index(new_y, raster)):
            end_x, end_y, fraction, _ = move_straight(raster, layout, x, y, new_x - x, new_y - y)
            if fraction == 1.0:
                return end_x, end_y, drawn
    return x, y, drawn
