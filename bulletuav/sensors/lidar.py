"""Range finders: one batch of rays for all beams of all drones of all worlds."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, hypot, sin
from bulletuav.compiled.kernel import allocating
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import axes, quat4
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

FRAMES = ("yaw", "world")


class Beam(NamedTuple):
    """Direction of a beam, degrees.

    Attributes:
        azimuth: To the left of the drone's nose, or of east.
        elevation: Above the horizon.
    """

    azimuth: float
    elevation: float


def make_beams(num_beams: int, elevations: Sequence[float]) -> tuple[Beam, ...]:
    """Make `num_beams` beams evenly around at each elevation (degrees), the first one ahead."""
    return tuple(
        Beam(360.0 * k / num_beams, elevation) for elevation in elevations for k in range(num_beams)
    )


@register("sensor")
class Lidar(Sensor):
    """Beams at fixed directions, with the drone's heading or the world's, level however it tilts.

    They see ground, buildings, obstacles and the shapes of other drones, from the drone's centre.

    Attributes:
        noise: (W, N) standard deviation of a range, m.
        dropout: (W, N) probability that a beam does not come back.
        ranges: (W, N, B) m; `max_range` for what is farther, or did not come back.
    """

    name = "lidar"
    uncertain: ClassVar = {"noise": Uncertain(0.0, 1000.0), "dropout": Uncertain(0.0, 1.0)}

    noise: np.ndarray
    dropout: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell the direction and the reach of each beam."""
        beams = [Beam(*beam) for beam in setup.beams]
        names = [
            f"beam {beam.azimuth:g}" + (f" up {beam.elevation:g}" if beam.elevation else "")
            for beam in beams
        ]
        return {"lidar": tuple(Label(name, "m", 0.0, setup.max_range) for name in names)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Make the beams' unit vectors, and an array for ranges."""
        super().attach(setup, engine)
        azimuth, elevation = np.radians(np.array(setup.beams, dtype=float)).T
        horizontal = cos(elevation)
        self._directions = np.stack(
            [horizontal * cos(azimuth), horizontal * sin(azimuth), sin(elevation)], axis=1
        )
        self._range = setup.max_range
        self._turns = setup.beam_frame == "yaw"
        self.ranges = np.full((*setup.shape, len(setup.beams)), setup.max_range)

    def kept(self) -> Mapping[str, np.ndarray]:
        """Tell the last ranges; see the base class."""
        return {"ranges": self.ranges}

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure new ranges of the drones that measure; others keep theirs, and are not seen.

        Each world draws from its own generator, if its drones' readings are uncertain.
        """
        swarm, mask = moment.after, moment.mask
        start, end, world = cast(
            swarm.position, swarm.quaternion, mask, self._directions, self._range, self._turns
        )
        share = self.engine.cast_rays(start, end, world, (swarm, mask))
        ranges = self._range * share.reshape(-1, len(self._directions))
        if np.count_nonzero(self.noise) or np.count_nonzero(self.dropout):
            self._blur(ranges, mask, moment.rngs)
        self.ranges[mask] = ranges
        return {"lidar": self.ranges.copy()}

    def beams(self, swarm: Swarm, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tell where beams begin and where they end, by what they measured last.

        Args:
            swarm: State of the drones, in which they measured.
            mask: (W, N) bool, drones whose beams are told.

        Returns:
            (M, 2, 3) m, and (M,) bool, whether they hit something.
        """
        where = (swarm.position, swarm.quaternion, mask)
        start, end, _ = cast(*where, self._directions, 1.0, self._turns)
        ranges = self.ranges[mask].reshape(-1, 1)
        ends = np.stack([start, start + ranges * (end - start)], axis=1)
        return ends, ranges[:, 0] < self._range

    def _blur(
        self, ranges: np.ndarray, mask: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Add noise and losses to `ranges` (M, B) of the drones of `mask`."""
        where = np.nonzero(mask)[0]
        shape = self.ranges.shape[1:]
        for w in np.unique(where).tolist():
            error = rngs[w].standard_normal(shape)
            luck = rngs[w].random(shape)
            noise = self.noise[w, mask[w], None]
            dropout = self.dropout[w, mask[w], None]
            true = ranges[where == w]
            noisy = np.clip(true + noise * error[mask[w]], 0.0, self._range)
            seen = np.where(true < self._range, noisy, self._range)
            ranges[where == w] = np.where(luck[mask[w]] < dropout, self._range, seen)


@allocating
def cast(
    position: np.ndarray,
    quaternion: np.ndarray,
    mask: np.ndarray,
    directions: np.ndarray,
    reach: float,
    turns: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List the beams of all drones that measure.

    Args:
        position: (W, N, 3) m.
        quaternion: (W, N, 4) body to world.
        mask: (W, N) drones that measure.
        directions: (B, 3) unit vectors of the beams.
        reach: Length of a beam, m.
        turns: Whether beams turn with each drone's heading.

    Returns:
        Starts and ends (M, 3) of the beams, m, and their worlds (M,).
    """
    # Counted by a loop: stored code of sums of arrays imports SciPy where it is loaded
    count = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            count += directions.shape[0] if mask[w, i] else 0
    start = np.empty((count, 3))
    end = np.empty((count, 3))
    world = np.empty(count, dtype=np.int64)
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            cosine, sine = 1.0, 0.0
            # The heading is that of the nose over ground; a drone on its tail has none.
            if turns:
                forward = axes(quat4(quaternion, w, i))[0]
                horizontal = hypot(forward[0], forward[1])
                if horizontal > 0.0:
                    cosine, sine = forward[0] / horizontal, forward[1] / horizontal
            # One ray for each beam, from the drone's centre.
            for b in range(directions.shape[0]):
                x, y, z = directions[b, 0], directions[b, 1], directions[b, 2]
                along = (cosine * x - sine * y, sine * x + cosine * y, z)
                for k in range(3):
                    start[m, k] = position[w, i, k]
                    end[m, k] = position[w, i, k] + reach * along[k]
                world[m] = w
                m += 1
    return start, end, world
