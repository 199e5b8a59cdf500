"""Range finder: the rays of all beams of all drones in all worlds are cast in one batch."""

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
        azimuth: Counter-clockwise from the drone's heading, or from east.
        elevation: Above the horizon.
    """

    azimuth: float
    elevation: float


def make_beams(num_beams: int, elevations: Sequence[float]) -> tuple[Beam, ...]:
    """Return `num_beams` evenly spaced beams at each elevation (degrees), the first one ahead."""
    return tuple(
        Beam(360.0 * k / num_beams, elevation) for elevation in elevations for k in range(num_beams)
    )


@register("sensor")
class Lidar(Sensor):
    """Range finder with beams at fixed directions, stabilised against roll and pitch.

    Beams turn with the heading of the drone, or have world axes. They start at the centre of the
    drone and hit the ground, buildings, obstacles and the shapes of other drones.

    Attributes:
        noise: (W, N) standard deviation of a range, m.
        dropout: (W, N) probability that a beam has no return.
        ranges: (W, N, B) ranges, m; `max_range` for beams without a hit or a return.
    """

    name = "lidar"
    uncertain: ClassVar = {"noise": Uncertain(0.0, 1000.0), "dropout": Uncertain(0.0, 1.0)}

    noise: np.ndarray
    dropout: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the direction and maximum range of each beam."""
        beams = [Beam(*beam) for beam in setup.beams]
        names = [
            f"beam {beam.azimuth:g}" + (f" up {beam.elevation:g}" if beam.elevation else "")
            for beam in beams
        ]
        return {"lidar": tuple(Label(name, "m", 0.0, setup.max_range) for name in names)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Compute the unit vectors of the beams, and allocate the ranges."""
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
        """Return the current ranges; see the base class."""
        return {"ranges": self.ranges}

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure the ranges of the drones in the mask; other readings do not change.

        Drones outside the mask are not hit by beams. Each world draws from its own generator if its
        noise or dropout is above 0.
        """
        swarm, mask = moment.after, moment.mask
        start, end, world = make_rays(
            swarm.position, swarm.quaternion, mask, self._directions, self._range, self._turns
        )
        fraction = self.engine.cast_rays(start, end, world, (swarm, mask))
        ranges = self._range * fraction.reshape(-1, len(self._directions))
        if np.count_nonzero(self.noise) or np.count_nonzero(self.dropout):
            self._add_errors(ranges, mask, moment.rngs)
        self.ranges[mask] = ranges
        return {"lidar": self.ranges.copy()}

    def beams(self, swarm: Swarm, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the start and end points of beams according to the last measurement.

        Args:
            swarm: State of the drones at the measurement.
            mask: (W, N) bool, drones whose beams are returned.

        Returns:
            (M, 2, 3) start and end points, m, and (M,) bool, whether the beams hit something.
        """
        where = (swarm.position, swarm.quaternion, mask)
        start, end, _ = make_rays(*where, self._directions, 1.0, self._turns)
        ranges = self.ranges[mask].reshape(-1, 1)
        ends = np.stack([start, start + ranges * (end - start)], axis=1)
        return ends, ranges[:, 0] < self._range

    def _add_errors(
        self, ranges: np.ndarray, mask: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Add noise and dropouts to `ranges` (M, B) of the drones in `mask`."""
        where = np.nonzero(mask)[0]
        shape = self.ranges.shape[1:]
        for w in np.unique(where).tolist():
            error = rngs[w].standard_normal(shape)
            chance = rngs[w].random(shape)
            noise = self.noise[w, mask[w], None]
            dropout = self.dropout[w, mask[w], None]
            true = ranges[where == w]
            noisy = np.clip(true + noise * error[mask[w]], 0.0, self._range)
            seen = np.where(true < self._range, noisy, self._range)
            ranges[where == w] = np.where(chance[mask[w]] < dropout, self._range, seen)


@allocating
def make_rays(
    position: np.ndarray,
    quaternion: np.ndarray,
    mask: np.ndarray,
    directions: np.ndarray,
    reach: float,
    turns: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the rays of all drones that measure.

    Args:
        position: (W, N, 3) positions, m.
        quaternion: (W, N, 4) attitudes, body to world.
        mask: (W, N) drones that measure.
        directions: (B, 3) unit vectors of the beams.
        reach: Length of the rays, m.
        turns: Whether beams turn with the heading of each drone.

    Returns:
        Start and end points (M, 3) of the rays, m, and their worlds (M,).
    """
    # An explicit loop: cached compiled code of array sums imports SciPy when it is loaded
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
            # The heading is the horizontal direction of the nose, undefined at 90 degrees pitch.
            if turns:
                forward = axes(quat4(quaternion, w, i))[0]
                horizontal = hypot(forward[0], forward[1])
                if horizontal > 0.0:
                    cosine, sine = forward[0] / horizontal, forward[1] / horizontal
            for b in range(directions.shape[0]):
                x, y, z = directions[b, 0], directions[b, 1], directions[b, 2]
                along = (cosine * x - sine * y, sine * x + cosine * y, z)
                for k in range(3):
                    start[m, k] = position[w, i, k]
                    end[m, k] = position[w, i, k] + reach * along[k]
                world[m] = w
                m += 1
    return start, end, world
