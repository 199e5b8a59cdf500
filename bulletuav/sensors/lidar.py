"""Range finders: one batch of rays for all beams of all drones of all worlds."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import axes, quat4
from bulletuav.kernel import kernel
from bulletuav.vehicle.swarm import Swarm

FRAMES = ("yaw", "world")


class Beam(NamedTuple):
    """Direction of a beam, degrees: azimuth to the left of the drone's nose (or of east), elevation above the horizon."""

    azimuth: float
    elevation: float


def make_beams(num_beams: int, elevations: Sequence[float]) -> tuple[Beam, ...]:
    """`num_beams` evenly around at each elevation, the first ahead."""
    return tuple(
        Beam(360.0 * k / num_beams, elevation) for elevation in elevations for k in range(num_beams)
    )


class Lidar:
    """Beams at fixed directions: with the drone's heading (frame "yaw") or the world's; level, however the drone tilts.

    They see ground, buildings, obstacles and the shapes of other drones, from the drone's centre.

    noise     (W, N) standard deviation of a range, m
    dropout   (W, N) probability that a beam does not come back
    ranges    (W, N, B) m; `max_range` for what is farther, or did not come back
    """

    def __init__(self, engine: Engine, beams: Sequence[Beam], max_range: float, frame: str):
        """`max_range` in m; `frame` one of FRAMES."""
        azimuth, elevation = np.radians(np.array(beams, dtype=float)).T
        level = np.cos(elevation)
        self._directions = np.stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1
        )
        self._engine, self._range, self._turns = engine, max_range, frame == "yaw"
        self.noise, self.dropout = np.zeros((2, *engine.shape))
        self.ranges = np.full((*engine.shape, len(beams)), max_range)

    def scan(
        self, swarm: Swarm, mask: np.ndarray, rngs: Sequence[np.random.Generator | None]
    ) -> None:
        """New ranges of the drones of `mask` (W, N); others keep theirs, and are not seen.

        Each world draws from its own generator, if its drones' readings are uncertain.
        """
        start, end, world = cast(
            swarm.position, swarm.quaternion, mask, self._directions, self._range, self._turns
        )
        share = self._engine.cast_rays(start, end, world, (swarm, mask))
        ranges = self._range * share.reshape(-1, len(self._directions))
        if self.noise.any() or self.dropout.any():
            self._blur(ranges, mask, rngs)
        self.ranges[mask] = ranges

    def _blur(
        self, ranges: np.ndarray, mask: np.ndarray, rngs: Sequence[np.random.Generator | None]
    ) -> None:
        """Noise and losses for `ranges` (M, B) of the drones of `mask`."""
        where = np.nonzero(mask)[0]
        for w in np.unique(where).tolist():
            rng = rngs[w]
            assert rng is not None  # a world that flies was reset
            error, luck = (
                rng.standard_normal(self.ranges[w].shape),
                rng.random(self.ranges[w].shape),
            )
            noise, dropout = self.noise[w, mask[w], None], self.dropout[w, mask[w], None]
            true = ranges[where == w]
            seen = np.where(
                true < self._range,
                np.clip(true + noise * error[mask[w]], 0.0, self._range),
                self._range,
            )
            ranges[where == w] = np.where(luck[mask[w]] < dropout, self._range, seen)


@kernel
def cast(position, quaternion, mask, directions, reach, turns):
    """Starts and ends (M, 3), m, and worlds (M,) of the beams along `directions` (B, 3) of the drones of `mask` (W, N).

    With `turns` they turn with each drone's heading.
    """
    count = mask.sum() * directions.shape[0]
    start, end, world = np.empty((count, 3)), np.empty((count, 3)), np.empty(count, dtype=np.int64)
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            cosine, sine = 1.0, 0.0
            if turns:
                forward = axes(quat4(quaternion, w, i))[0]
                level = math.hypot(forward[0], forward[1])
                if level > 0.0:
                    cosine, sine = forward[0] / level, forward[1] / level
            for b in range(directions.shape[0]):
                x, y, z = directions[b, 0], directions[b, 1], directions[b, 2]
                along = (cosine * x - sine * y, sine * x + cosine * y, z)
                for k in range(3):
                    start[m, k] = position[w, i, k]
                    end[m, k] = position[w, i, k] + reach * along[k]
                world[m] = w
                m += 1
    return start, end, world
