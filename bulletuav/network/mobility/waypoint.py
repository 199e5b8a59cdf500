"""Users who walk straight from place to place and rest there: the random waypoint model.

D. Johnson and D. Maltz, Dynamic source routing in ad hoc wireless networks, 1996; among buildings, as ns-3's outdoor random
walk, only to places in straight view.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.kernel import func, kernel
from bulletuav.network.mobility.base import (
    LONGEST,
    Generators,
    State,
    Walking,
    check_range,
    keys,
    uniform,
)
from bulletuav.network.mobility.ground import Ground, cell_of, is_free, length, walk

TRIES = 100
LOOK = 1.0  # s, until one who saw no place to go to looks again


@dataclass(frozen=True)
class Waypoint(Walking):
    """Each user picks a place, uniform over the free ground in straight view, walks there at a speed drawn anew, and rests.

    The time average of the speed on the way is (high - low) / ln(high / low), less than the middle: slow legs take long.
    Speeds of first legs are drawn from that stationary distribution, so that the mean does not decay (W. Navidi and T. Camp,
    Stationary distributions for the random waypoint mobility model, IEEE Trans. Mobile Computing 3(1), 2004). After 100
    places out of view a user stays for a second.

    pause  s, from low to high, drawn uniformly
    """

    name: ClassVar[str] = "waypoint"
    pause: tuple[float, float] = (0.0, 30.0)

    def __post_init__(self):
        super().__post_init__()
        self._keep("pause", check_range("pause", self.pause, "s", LONGEST, above_zero=False))

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Also "user_goal" (U, 2) m, "user_speed" (U,) m/s of this or the next leg, "user_pause" (U,) s that is left."""
        return super().state(count) | {
            "user_goal": (count, 2),
            "user_speed": (count,),
            "user_pause": (count,),
        }

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """At random places, from which they set out when they first move."""
        users = ground.places(rng, layout, count)
        low, high = self.speed
        return {
            "users": users,
            "user_velocity": np.zeros((count, 2)),
            "user_goal": users[:, :2].copy(),
            "user_speed": low * (high / low) ** rng.random(count),
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
        own = (
            state["users"],
            state["user_velocity"],
            state["user_goal"],
            state["user_speed"],
            state["user_pause"],
        )
        ranges = (*self.speed, *self.pause)
        advance(*own, keys(rng, flying), ground.raster, layout, flying, dt, ranges)


@kernel
def advance(users, velocity, goal, speed, pause, key, raster, layout, flying, dt, ranges):
    """Move users (W, U, 3) through dt s; keys (W,) of `uniform`; ranges of speed and pause, from low to high each."""
    slowest, fastest, shortest, longest = ranges
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        drawn = 0
        for i in range(users.shape[1]):
            place, aim, left = users[w, i], goal[w, i], dt
            while left > 0.0:
                spent = 0.0
                gap = length(aim[0] - place[0], aim[1] - place[1])
                if pause[w, i] > 0.0:
                    spent = min(pause[w, i], left)
                    pause[w, i] -= spent
                elif gap == 0.0:
                    aim[0], aim[1], drawn = seen_place(
                        raster, layout[w], place[0], place[1], key[w], drawn
                    )
                    if aim[0] == place[0] and aim[1] == place[1]:
                        pause[w, i] = LOOK
                elif gap > left * speed[w, i]:
                    spent = left
                    for axis in range(2):
                        place[axis] += left * speed[w, i] * (aim[axis] - place[axis]) / gap
                else:
                    spent = gap / speed[w, i]
                    place[0], place[1] = aim[0], aim[1]
                    speed[w, i] = slowest + (fastest - slowest) * uniform(key[w], drawn)
                    pause[w, i] = shortest + (longest - shortest) * uniform(key[w], drawn + 1)
                    drawn += 2
                left -= spent
            gap = length(aim[0] - place[0], aim[1] - place[1])
            for axis in range(2):
                velocity[w, i, axis] = (
                    speed[w, i] * (aim[axis] - place[axis]) / gap if gap > 0.0 else 0.0
                )


@func
def seen_place(raster, layout, x, y, key, drawn):
    """x, y of a place, uniform over the free ground in straight view of (x, y) m, and how many numbers are drawn then.

    The place itself where none was found.
    """
    side = raster.side[layout]
    for _ in range(TRIES):
        new_x, new_y = side * (uniform(key, drawn) - 0.5), side * (uniform(key, drawn + 1) - 0.5)
        drawn += 2
        if is_free(raster, layout, cell_of(new_x, raster), cell_of(new_y, raster)):
            end_x, end_y, share, _ = walk(raster, layout, x, y, new_x - x, new_y - y)
            if share == 1.0:
                return end_x, end_y, drawn
    return x, y, drawn
