"""Line of sight between drones, at any distance."""

from collections.abc import Mapping

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup
from bulletuav.sensors.sight import line_of_sight

DRONE_SIGHT = "drone_sight"
"""Name of the reading"""


@register("sensor")
class DroneSight(Sensor):
    """Line of sight from each drone to each other drone; drones do not occlude.

    Range and field of view are unlimited. A drone always sees itself.
    """

    name = DRONE_SIGHT

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return one label for each drone."""
        drones = range(setup.shape[1])
        return {DRONE_SIGHT: tuple(Label(f"sees drone {k}", "1", 0.0, 1.0) for k in drones)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings; initially no drone is visible."""
        super().attach(setup, engine)
        worlds, drones = setup.shape
        self._seen = np.zeros((worlds, drones, drones), dtype=bool)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Cast one ray for each pair of drones that measure."""
        mask, position = moment.mask, moment.after.position
        pairs = np.triu(mask[:, :, None] & mask[:, None, :], 1)
        w, i, j = np.nonzero(pairs)
        seen = np.zeros(pairs.shape, dtype=bool)
        seen[w, i, j] = line_of_sight(self.engine, position[w, i], position[w, j], w)
        seen |= seen.swapaxes(1, 2) | np.eye(mask.shape[1], dtype=bool)
        self._seen[mask] = seen[mask]
        return {DRONE_SIGHT: self._seen.copy()}
