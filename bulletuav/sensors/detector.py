"""Detector of targets: their positions relative to the drone, within range and field of view."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import cos
from bulletuav.engine.engine import Engine
from bulletuav.registry import register
from bulletuav.sensors.base import (
    Image,
    Label,
    Moment,
    Sensor,
    SensorSetup,
    Uncertain,
    vector_labels,
)
from bulletuav.sensors.sight import sights

ROUNDING = 1e-9
"""Tolerance of the cosine at the edge of the field of view"""
PER_TARGET = 4
"""Numbers per target: whether it is detected, and its offset"""


@register("sensor")
class Detector(Sensor):
    """Positions of targets relative to the drone, as found in pictures or by radar.

    A target is detected within the range and the field of view, if nothing hides it. The reading
    "detection" has for each target 1 and its offset in world axes, m, or zeros.

    Attributes:
        range: (W, N) maximum distance of a detection, m.
        fov: (W, N) angle of the cone around the nose in which targets are detected, degrees; 360
            for all directions.
        noise: (W, N) standard deviation of the offset on each axis, as a fraction of the distance.
        dropout: (W, N) probability that the drone detects nothing in a decision.
    """

    name = "detector"
    gives = ("detection",)
    uncertain: ClassVar = {
        "range": Uncertain(0.0, 1e4, usual=100.0),
        "fov": Uncertain(0.0, 360.0, usual=360.0),
        "noise": Uncertain(0.0, 1.0, usual=0.01),
        "dropout": Uncertain(0.0, 1.0),
    }

    range: np.ndarray
    fov: np.ndarray
    noise: np.ndarray
    dropout: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels of each target's detection."""
        low, high = setup.arena
        size = high - low
        labels: list[Label] = []
        for k in range(1, setup.num_targets + 1):
            labels.append(Label(f"target {k} detected", "1", 0.0, 1.0))
            labels += vector_labels(f"target {k} offset", "m", -size, size)
        return {"detection": tuple(labels)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the reading; initially nothing is detected."""
        super().attach(setup, engine)
        self._reading = np.zeros((*setup.shape, PER_TARGET * setup.num_targets))

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Detect the targets in sight of the drones in the mask."""
        count = self.setup.num_targets
        if not count:
            return {"detection": self._reading.copy()}
        offset = moment.targets[:, None] - moment.after.position[:, :, None]
        distance = np.linalg.norm(offset, axis=-1)
        x, y, z, w = np.moveaxis(moment.after.quaternion, -1, 0)
        nose = np.stack(
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=-1
        )
        ahead = (nose[:, :, None] * offset).sum(axis=-1)
        edge = (cos(np.radians(self.fov) / 2) - ROUNDING)[..., None] * distance
        normal, uniform = moment.draw(3 * count)
        places, radius = moment.after.position, self.setup.target_radius
        seen = sights(self.engine, places, moment.targets, moment.mask, radius)
        seen &= (distance <= self.range[..., None]) & (ahead >= edge)
        seen &= (uniform >= self.dropout)[..., None]
        error = (self.noise[..., None] * distance)[..., None] * normal.reshape(offset.shape)
        rows = np.concatenate([np.ones((*distance.shape, 1)), offset + error], axis=-1)
        rows = np.where(seen[..., None], rows, 0.0).reshape(self._reading.shape)
        np.copyto(self._reading, rows, where=moment.mask[..., None])
        return {"detection": self._reading.copy()}
