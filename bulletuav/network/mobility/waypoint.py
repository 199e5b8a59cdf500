"""Users who walk straight from place to place and rest there: the random waypoint model.

D. Johnson and D. Maltz, Dynamic source routing in ad hoc wireless networks, 1996. Among buildings
users walk only to places in straight view, as in ns-3's outdoor random walk.
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
    uniform,
)
from bulletuav.network.mobility.ground import Ground
from bulletuav.network.mobility.raster import Raster, cell_of, is_free, length, walk
from bulletuav.registry import register

MAX_TRIES = 100
"""Places that a user draws before giving up for a while"""
RETRY_PAUSE = 1.0
"""Time until a user who saw no place to go to looks again, s"""


@register("mobility")
@dataclass(frozen=True)
class Waypoint(Walking):
    """The random waypoint model.

    Each user picks a place, uniform over the free ground in straight view. It walks there at a
    speed drawn anew, and rests. After 100 places out of view a user stays for a second.

    The time average of the speed on the way is (high - low) / ln(high / low). This is less than the
    middle, since slow legs take long. Speeds of first legs are drawn from that stationary
    distribution, so that the mean does not decay: W. Navidi and T. Camp, Stationary distributions
    for the random waypoint mobility model, IEEE Trans. Mobile Computing 3(1), 2004.

    Attributes:
        pause: Shortest and longest rest, s; each is drawn uniformly.
    """

    name: ClassVar[str] = "waypoint"
    pause: tuple[float, float] = (0.0, 30.0)

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        pause = check_range("pause", self.pause, unit="s", most=MAX_TIME, above_zero=False)
        self._set_option("pause", pause)

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Tell the arrays that the model keeps, see `Mobility.state`.

        Beside those of every model these are "user_goal" (U, 2), m; "user_speed" (U,) of this or
        the next leg, m/s; and "user_pause" (U,), the rest that is left, s.
        """
        return super().state(count) | {
            "user_goal": (count, 2),
            "user_speed": (count,),
            "user_pause": (count,),
        }

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of what the model keeps, see `Mobility.bounds`."""
        reach = float(ground.raster.reach)
        return super().bounds(ground) | {
            "user_goal": (-reach, reach),
            "user_speed": (0.0, MAX_VELOCITY),
            "user_pause": (0.0, MAX_TIME),
        }

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw random positions, from which users set out when they first move.

        See `Mobility.start`.
        """
        users = ground.places(rng, layout, count)
        # Speeds in the mean over time: their density falls as 1 / speed
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
        """Move users as `move` tells."""
        advance(
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
def advance(
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
    """Move users through a time step, in place.

    Args:
        users: Positions (W, U, 3), m; changed.
        velocity: Velocities (W, U, 2), m/s; overwritten.
        goal: Places (W, U, 2) that users walk to, m; changed.
        speed: Speeds (W, U) of this or the next leg, m/s; changed.
        pause: Rests (W, U) that are left, s; changed.
        key: Keys (W,) of `uniform`, uint64.
        raster: Free cells of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) users of each world move.
        dt: Length of the step, s.
        ranges: Lowest and highest speed, m/s; shortest and longest rest, s.
    """
    slowest, fastest, shortest, longest = ranges
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        # All users of a world draw from one stream
        drawn = 0
        for i in range(users.shape[1]):
            place = users[w, i]
            aim = goal[w, i]
            left = dt
            # Rests and legs one after the other, until the step is over
            while left > 0.0:
                spent = 0.0
                gap = length(aim[0] - place[0], aim[1] - place[1])
                if pause[w, i] > 0.0:
                    # Rest
                    spent = min(pause[w, i], left)
                    pause[w, i] -= spent
                elif gap == 0.0:
                    # Rested at the goal: choose the next one, or wait where none is in view
                    aim[0], aim[1], drawn = seen_place(
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
                    # Reach the goal, and draw the rest there and the speed of the next leg
                    spent = gap / speed[w, i]
                    place[0] = aim[0]
                    place[1] = aim[1]
                    speed[w, i] = slowest + (fastest - slowest) * uniform(key[w], drawn)
                    pause[w, i] = shortest + (longest - shortest) * uniform(key[w], drawn + 1)
                    drawn += 2
                left -= spent
            # Velocity towards the goal; none for who has reached it
            gap = length(aim[0] - place[0], aim[1] - place[1])
            for axis in range(2):
                if gap > 0.0:
                    velocity[w, i, axis] = speed[w, i] * (aim[axis] - place[axis]) / gap
                else:
                    velocity[w, i, axis] = 0.0


@func
def seen_place(
    raster: Raster, layout: int, x: float, y: float, key: int, drawn: int
) -> tuple[float, float, int]:
    """Draw a place, uniform over the free ground in straight view of a user.

    Args:
        raster: Free cells of all layouts.
        layout: Index of the layout.
        x: Position of the user, m.
        y: Position of the user, m.
        key: Key of `uniform`.
        drawn: How many numbers of its stream are drawn already.

    Returns:
        x and y of the place, or of the user where no place was found, m; and how many numbers are
        drawn then.
    """
    # Draw from the whole ground until a place is free and in view
    for _ in range(MAX_TRIES):
        new_x = raster.sides[layout, 0] * (uniform(key, drawn) - 0.5)
        new_y = raster.sides[layout, 1] * (uniform(key, drawn + 1) - 0.5)
        drawn += 2
        if is_free(raster, layout, cell_of(new_x, raster), cell_of(new_y, raster)):
            end_x, end_y, share, _ = walk(raster, layout, x, y, new_x - x, new_y - y)
            if share == 1.0:
                return end_x, end_y, drawn
    return x, y, drawn
