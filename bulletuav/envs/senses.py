"""What the drones of an environment read from their sensors: only what its observation or its task asks for."""

from collections.abc import Sequence

import numpy as np

from bulletuav.dynamics.base import Dynamics
from bulletuav.engine.engine import Engine
from bulletuav.envs.options import EnvOptions
from bulletuav.sensors.camera import DroneCameras
from bulletuav.sensors.imu import Imu
from bulletuav.sensors.lidar import Lidar
from bulletuav.sensors.sight import clearances, sights
from bulletuav.tasks.base import Scene, Task
from bulletuav.tasks.observations.observer import IMAGES
from bulletuav.tasks.observations.sensors import AHEAD
from bulletuav.vehicle.swarm import Swarm

LIDAR = {"lidar_noise": "noise", "lidar_dropout": "dropout"}
IMU = {
    "accelerometer_noise": "acceleration_noise",
    "accelerometer_walk": "acceleration_walk",
    "gyroscope_noise": "rates_noise",
    "gyroscope_walk": "rates_walk",
}
"""What of the sensors each uncertainty changes"""


class SensorSuite:
    """Sensors that look at the world: range finders, cameras, lines of sight, clearances, inertial measurement."""

    def __init__(
        self,
        wanted: set[str],
        task: Task,
        options: EnvOptions,
        engine: Engine,
        dynamics: Dynamics,
        drawn: dict[str, np.ndarray],
    ):
        """`wanted` names readings; `drawn` what is uncertain, (W, N) by name, which sensors read where it stands."""
        self._engine, self._dynamics, self._task, self._range = (
            engine,
            dynamics,
            task,
            options.max_range,
        )
        self._lidar = self._imu = self._cameras = None
        if "lidar" in wanted:
            self._lidar = Lidar(engine, task.context.beams, options.max_range, options.lidar_frame)
            _connect(self._lidar, LIDAR, drawn)
        if "imu" in wanted:
            self._imu = Imu(engine.shape, 1 / options.decision_hz, options.gravity)
            _connect(self._imu, IMU, drawn)
        images = [name for name in IMAGES if name in wanted]
        if images:
            radius = np.array([airframe.collision_radius for airframe in options.airframe])
            every = options.decision_hz // (options.camera_hz or options.decision_hz)
            self._cameras = DroneCameras(engine, images, radius, options.camera_size, every)
        self._sight = np.zeros((*engine.shape, task.num_targets), dtype=bool)
        ahead = (*engine.shape, len(AHEAD), task.num_targets)
        self._ahead = np.zeros(ahead, dtype=bool) if "sight_ahead" in wanted else None
        self._clearance = (
            np.full(engine.shape, options.max_range) if "clearance" in wanted else None
        )

    def start(self, k: int, swarm: Swarm, rng: np.random.Generator) -> None:
        """World k begins."""
        if self._imu is not None:
            self._imu.start(k, swarm, rng)

    def take(
        self,
        before: Swarm,
        after: Swarm,
        scene: Scene,
        mask: np.ndarray,
        steps: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
    ) -> None:
        """Bring the readings of the drones of `mask` (W, N) up to date, after a decision or, where steps is 0, a reset."""
        if self._imu is not None:
            self._imu.read(before, after, mask.any(axis=1) & (steps > 0), rngs)
        if self._cameras is not None or self._clearance is not None:
            self._dynamics.show(after, mask)
        if self._lidar is not None:
            self._lidar.scan(after, mask, rngs)
        if self._cameras is not None:
            self._cameras.expose(after, mask, steps)
        if self._clearance is not None:
            self._clearance[mask] = clearances(self._engine, mask, self._range)[mask]
        if self._task.num_targets:
            self._sight[mask] = sights(
                self._engine, after.position, self._task.targets(scene), mask
            )[mask]
        if self._ahead is not None and self._task.num_targets:
            self._look_ahead(self._ahead, after.position, self._task.targets(scene), mask)

    def _look_ahead(
        self, ahead: np.ndarray, position: np.ndarray, targets: np.ndarray, mask: np.ndarray
    ) -> None:
        """From places within the airspace."""
        low, high = self._task.arena_low, self._task.arena_high
        for k, way in enumerate(AHEAD.values()):
            places = np.clip(position + way, low, high)
            ahead[mask, k] = sights(self._engine, places, targets, mask)[mask]

    def readings(self) -> dict[str, np.ndarray]:
        """The readings by the names that `Frame` tells, as they are now."""
        readings: dict[str, np.ndarray] = (
            {} if self._cameras is None else dict(self._cameras.pictures)
        )
        if self._lidar is not None:
            readings["lidar"] = self._lidar.ranges.copy()
        if self._imu is not None:
            readings["imu"] = np.concatenate([self._imu.acceleration, self._imu.rates], axis=-1)
        if self._clearance is not None:
            readings["clearance"] = self._clearance.copy()
        if self._ahead is not None:
            readings["sight_ahead"] = self._ahead.copy()
        return readings | {"sight": self._sight.copy()}


def _connect(sensor: Lidar | Imu, names: dict[str, str], drawn: dict[str, np.ndarray]) -> None:
    for name, attribute in names.items():
        if name in drawn:
            setattr(sensor, attribute, drawn[name])
