"""Line of sight to targets, and clearance to the nearest object."""

import math
from collections.abc import Mapping

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.engine.engine import Engine
from bulletuav.geometry.clearance import measure_clearance
from bulletuav.geometry.gjk import make_scratch
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup
from bulletuav.vehicle.swarm import Swarm


def line_of_sight(
    engine: Engine, start: np.ndarray, end: np.ndarray, where: np.ndarray
) -> np.ndarray:
    """Check the line of sight between pairs of points; drones do not occlude.

    The result is symmetric: each ray is cast from the higher to the lower point; at equal heights
    ordered by x, then y.

    Args:
        engine: The engine with the worlds.
        start: (M, 3) points, m.
        end: (M, 3) points, m.
        where: (M,) world of each pair.

    Returns:
        (M,) bool.
    """
    descends = (np.sign(end - start) @ [3, 1, 9] > 0)[:, None]
    return (
        engine.cast_rays(np.where(descends, end, start), np.where(descends, start, end), where) >= 1
    )


@kernel
def _list_rays(
    position: np.ndarray,
    targets: np.ndarray,
    mask: np.ndarray,
    inset: float,
    start: np.ndarray,
    end: np.ndarray,
    where: np.ndarray,
) -> None:
    """Write rays from drones (W, N) to targets (W, U, 3), ordered as in `line_of_sight`.

    Rays end `inset` before the targets, m.
    """
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            for j in range(targets.shape[1]):
                # From the higher to the lower end, so that the result is symmetric.
                order = 0.0
                for k, weight in ((0, 3.0), (1, 1.0), (2, 9.0)):
                    order += weight * np.sign(targets[w, j, k] - position[w, i, k])
                for k in range(3):
                    start[m, k] = targets[w, j, k] if order > 0.0 else position[w, i, k]
                    end[m, k] = position[w, i, k] if order > 0.0 else targets[w, j, k]
                if inset > 0.0:
                    square = 0.0
                    for k in range(3):
                        square += (targets[w, j, k] - position[w, i, k]) ** 2
                    left = max(1.0 - inset / max(math.sqrt(square), inset), 0.0)
                    for k in range(3):
                        last = position[w, i, k] + left * (targets[w, j, k] - position[w, i, k])
                        if order > 0.0:
                            start[m, k] = last
                        else:
                            end[m, k] = last
                where[m] = w
                m += 1


BODY_MARGIN = 0.01
"""Distance beyond the radius of a target's body at which lines of sight end, m"""


def sights(
    engine: Engine,
    position: np.ndarray,
    targets: np.ndarray,
    mask: np.ndarray,
    target_radius: float = 0.0,
) -> np.ndarray:
    """Check the line of sight from drones to targets.

    Args:
        engine: The engine with the worlds.
        position: (W, N, 3) positions of the drones, m.
        targets: (W, U, 3) positions of the targets, m.
        mask: (W, N) drones to check; False for all others.
        target_radius: Radius of the bodies around the targets, which do not occlude them, m.

    Returns:
        (W, N, U) bool.
    """
    count = targets.shape[1]
    rays = np.count_nonzero(mask) * count
    start, end, where = np.empty((rays, 3)), np.empty((rays, 3)), np.empty(rays, dtype=np.int64)
    inset = target_radius + BODY_MARGIN if target_radius else 0.0
    _list_rays(position, targets, mask, inset, start, end, where)
    free = engine.cast_rays(start, end, where) >= 1
    if rays == mask.size * count:  # no drone is masked
        return free.reshape(*mask.shape, count)
    seen = np.zeros((*mask.shape, count), dtype=bool)
    seen[mask] = free.reshape(-1, count)
    return seen


def clearances(engine: Engine, swarm: Swarm, mask: np.ndarray, max_distance: float) -> np.ndarray:
    """Compute the distance to the nearest object: ground, building, obstacle, body, load or drone.

    Args:
        engine: The engine, whose scenery is read and not modified.
        swarm: Poses of the drones.
        mask: (W, N) drones to measure; others are ignored as objects, too.
        max_distance: Maximum distance, m.

    Returns:
        (W, N) distance between collision shapes, m, to 1e-6; negative if shapes overlap. It is
        `max_distance` if nothing is nearer, and for drones outside `mask`.
    """
    drones = mask.shape[1]
    swarm, mask = engine.with_loads((swarm, mask)) or (swarm, mask)
    poses = swarm.position, swarm.quaternion
    found = measure_clearance(engine.scenery, *poses, mask, max_distance, make_scratch())
    return found[:, :drones]


AHEAD = {
    "east": (30.0, 0.0, 0.0),
    "north": (0.0, 30.0, 0.0),
    "west": (-30.0, 0.0, 0.0),
    "south": (0.0, -30.0, 0.0),
}
"""Offsets from which `sight_ahead` checks the line of sight, m"""


@register("sensor")
class SightSensor(Sensor):
    """Line of sight from each drone to each target of the task; drones do not occlude."""

    name = "sight"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return one label for each target."""
        numbers = range(1, setup.num_targets + 1)
        return {"sight": tuple(Label(f"sees {k}", "1", 0.0, 1.0) for k in numbers)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings; initially no target is visible."""
        super().attach(setup, engine)
        self._seen = np.zeros((*setup.shape, setup.num_targets), dtype=bool)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Check the line of sight of the drones in the mask."""
        if self.setup.num_targets:
            radius = self.setup.target_radius
            places, targets = moment.after.position, moment.targets
            seen = sights(self.engine, places, targets, moment.mask, radius)
            np.copyto(self._seen, seen, where=moment.mask[..., None])
        return {"sight": self._seen.copy()}


@register("sensor")
class SightAhead(Sensor):
    """Line of sight to targets from positions 30 m east, north, west and south of a drone."""

    name = "sight_ahead"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return one label for each direction and target."""
        targets = range(1, setup.num_targets + 1)
        labels = [Label(f"{way} sees {k}", "1", 0.0, 1.0) for way in AHEAD for k in targets]
        return {"sight_ahead": tuple(labels)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings; initially no target is visible."""
        super().attach(setup, engine)
        self._seen = np.zeros((*setup.shape, len(AHEAD), setup.num_targets), dtype=bool)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Check the line of sight from the offset positions, clipped to the airspace."""
        low, high = self.setup.arena
        position, mask = moment.after.position, moment.mask
        for k, way in enumerate(AHEAD.values() if self.setup.num_targets else ()):
            places = np.clip(position + way, low, high)
            radius = self.setup.target_radius
            seen = sights(self.engine, places, moment.targets, mask, radius)
            self._seen[mask, k] = seen[mask]
        return {"sight_ahead": self._seen.reshape(*mask.shape, -1).copy()}


@register("sensor")
class ClearanceSensor(Sensor):
    """Distance of each drone's collision shape to the nearest object; see `clearances`."""

    name = "clearance"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the label of the distance, bounded by the maximum range."""
        return {"clearance": (Label("clearance", "m", -1.0, setup.max_range),)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings at the maximum range."""
        super().attach(setup, engine)
        self._distance = np.full(setup.shape, setup.max_range)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure the clearance of the drones in the mask."""
        mask = moment.mask
        max_distance = self.setup.max_range
        self._distance[mask] = clearances(self.engine, moment.after, mask, max_distance)[mask]
        return {"clearance": self._distance.copy()}
