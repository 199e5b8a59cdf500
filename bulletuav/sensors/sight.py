"""Line of sight to targets, and how near the nearest thing is."""

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
    engine: Engine,
    start: np.ndarray,
    end: np.ndarray,
    where: np.ndarray,
) -> np.ndarray:
    """Tell for pairs of points whether nothing but drones is in between.

    Args:
        engine: The engine with the worlds.
        start: (M, 3) m.
        end: (M, 3) m.
        where: (M,) world of each pair.

    Returns:
        (M,) bool.

    Either way gives the same answer: the ray goes from the higher point to the lower, on the level
    by x, then y.
    """
    rises = (np.sign(end - start) @ [3, 1, 9] > 0)[:, None]
    return engine.cast_rays(np.where(rises, end, start), np.where(rises, start, end), where) >= 1


@kernel
def _links(
    position: np.ndarray,
    targets: np.ndarray,
    mask: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    where: np.ndarray,
) -> None:
    """List rays from drones (W, N) to targets (W, U, 3), ordered as in `line_of_sight`."""
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            for j in range(targets.shape[1]):
                # From the higher end to the lower one, so that both ways give the same answer.
                order = 0.0
                for k, weight in ((0, 3.0), (1, 1.0), (2, 9.0)):
                    order += weight * np.sign(targets[w, j, k] - position[w, i, k])
                for k in range(3):
                    start[m, k] = targets[w, j, k] if order > 0.0 else position[w, i, k]
                    end[m, k] = position[w, i, k] if order > 0.0 else targets[w, j, k]
                where[m] = w
                m += 1


def sights(
    engine: Engine,
    position: np.ndarray,
    targets: np.ndarray,
    mask: np.ndarray,
) -> np.ndarray:
    """Tell which targets drones see.

    Args:
        engine: The engine with the worlds.
        position: (W, N, 3) of the drones, m.
        targets: (W, U, 3) m.
        mask: (W, N) drones that look; others see none.

    Returns:
        (W, N, U) bool.
    """
    count = targets.shape[1]
    rays = np.count_nonzero(mask) * count
    start, end, where = np.empty((rays, 3)), np.empty((rays, 3)), np.empty(rays, dtype=np.int64)
    _links(position, targets, mask, start, end, where)
    free = engine.cast_rays(start, end, where) >= 1
    if rays == mask.size * count:  # all look
        return free.reshape(*mask.shape, count)
    seen = np.zeros((*mask.shape, count), dtype=bool)
    seen[mask] = free.reshape(-1, count)
    return seen


def clearances(
    engine: Engine,
    swarm: Swarm,
    mask: np.ndarray,
    most: float,
) -> np.ndarray:
    """Measure how near the nearest thing is: ground, building, obstacle, body or drone.

    Args:
        engine: The engine; it tells what stands, and nothing in it moves.
        swarm: Where the drones are.
        mask: (W, N) drones that measure; others are not measured either.
        most: Distance beyond which nothing is looked for, m.

    Returns:
        (W, N) distance between collision shapes, m, to 1e-6; negative where shapes overlap. It is
        `most` where nothing is nearer, and for drones that are not in `mask`.
    """
    poses = swarm.position, swarm.quaternion
    return measure_clearance(engine.scenery, *poses, mask, most, make_scratch())


AHEAD = {
    "east": (30.0, 0.0, 0.0),
    "north": (0.0, 30.0, 0.0),
    "west": (-30.0, 0.0, 0.0),
    "south": (0.0, -30.0, 0.0),
}
"""Ways, m, at whose ends `sight_ahead` looks"""


@register("sensor")
class Sight(Sensor):
    """Which of the task's targets each drone sees: nothing but drones in between."""

    name = "sight"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell one number for each target."""
        numbers = range(1, setup.num_targets + 1)
        return {"sight": tuple(Label(f"sees {k}", "1", 0.0, 1.0) for k in numbers)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Begin with nothing seen."""
        super().attach(setup, engine)
        self._seen = np.zeros((*setup.shape, setup.num_targets), dtype=bool)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Look from the drones that measure."""
        if self.setup.num_targets:
            seen = sights(self.engine, moment.after.position, moment.targets, moment.mask)
            np.copyto(self._seen, seen, where=moment.mask[..., None])
        return {"sight": self._seen.copy()}


@register("sensor")
class SightAhead(Sensor):
    """Which targets a drone would see from 30 m east, north, west and south of it, by a map."""

    name = "sight_ahead"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell one number for each way and target."""
        targets = range(1, setup.num_targets + 1)
        labels = [Label(f"{way} sees {k}", "1", 0.0, 1.0) for way in AHEAD for k in targets]
        return {"sight_ahead": tuple(labels)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Begin with nothing seen."""
        super().attach(setup, engine)
        self._seen = np.zeros((*setup.shape, len(AHEAD), setup.num_targets), dtype=bool)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Look from places within the airspace."""
        low, high = self.setup.arena
        position, mask = moment.after.position, moment.mask
        for k, way in enumerate(AHEAD.values() if self.setup.num_targets else ()):
            places = np.clip(position + way, low, high)
            self._seen[mask, k] = sights(self.engine, places, moment.targets, mask)[mask]
        return {"sight_ahead": self._seen.reshape(*mask.shape, -1).copy()}


@register("sensor")
class Clearance(Sensor):
    """Distance of each drone's collision shape from the nearest thing; see `clearances`."""

    name = "clearance"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell the distance and how far it reaches."""
        return {"clearance": (Label("clearance", "m", -1.0, setup.max_range),)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Begin with nothing near."""
        super().attach(setup, engine)
        self._distance = np.full(setup.shape, setup.max_range)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure from the drones that measure."""
        mask = moment.mask
        most = self.setup.max_range
        self._distance[mask] = clearances(self.engine, moment.after, mask, most)[mask]
        return {"clearance": self._distance.copy()}
