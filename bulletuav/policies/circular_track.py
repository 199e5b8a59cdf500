"""Base class of scripted policies that fly around the track of `pursuit`."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.scripted import Scripted
from bulletuav.tasks.pursuit import Pursuit
from bulletuav.vehicle.swarm import Swarm

TRACK_GAIN = 1.0
"""Gain from the distance to the path to the speed of the correction, 1/s"""


class TrackPolicy(Scripted):
    """Base class of policies that fly around the track of `pursuit`.

    Attributes:
        task: The task.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Bind the policy to an aviary.

        Raises:
            ValueError: If the task is not `pursuit`.
        """
        super().__init__(aviary)
        self.task = require_supported_task(self, Pursuit)

    @property
    def cruising_speed(self) -> np.ndarray:
        """Cruising speeds of the drones, (W, N) m/s."""
        return self.aviary.scene.memory["cruising_speed"]

    @property
    def flown(self) -> np.ndarray:
        """Distances that the goals moved along the track, (W, N) m."""
        time = self.aviary.steps * self.task.context.period
        return self.task.flown(self.cruising_speed, time)

    def around(
        self, swarm: Swarm, speed: np.ndarray | float, aside: float = 0.0, up: float = 0.0
    ) -> np.ndarray:
        """Return velocities around the track, clockwise, (W, N, 3) m/s.

        Args:
            swarm: The drones.
            speed: Speed along the path, m/s; negative for counterclockwise flight. Broadcasts to
                (W, N).
            aside: Distance of the path outside the track, m.
            up: Height of the path above the track, m.
        """
        config = self.task.config
        outward = swarm.position * (1.0, 1.0, 0.0)
        distance = np.linalg.norm(outward, axis=-1, keepdims=True)
        outward /= np.maximum(distance, 1e-9)
        along = np.stack(
            [outward[..., 1], -outward[..., 0], np.zeros(distance.shape[:-1])], axis=-1
        )
        velocity: np.ndarray = np.broadcast_to(speed, distance.shape[:-1])[..., None] * along
        velocity += TRACK_GAIN * (config.radius + aside - distance) * outward
        velocity[..., 2] = TRACK_GAIN * (config.altitude + up - swarm.position[..., 2])
        return velocity
