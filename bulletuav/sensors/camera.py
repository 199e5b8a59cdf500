"""A camera on every drone, looking forward."""

import numpy as np

from bulletuav.physics.rotation import axes
from bulletuav.physics.swarm import Swarm
from bulletuav.physics.view import FAR, projection_matrix, view_matrix
from bulletuav.physics.world import World

FIELD_OF_VIEW = 90.0  # degrees, vertical


class DroneCameras:
    """Forward cameras at the front of each drone, fixed to the body; pictures are held between exposures.

    pictures: "rgb" (W, N, H, W, 3) uint8 and "depth" (W, N, H, W) float32, m along the view axis.
    """

    def __init__(self, world: World, shape: tuple[int, int], radius: np.ndarray, size: tuple[int, int], every: int):
        """`radius` (N,) m ahead of the centre sits the lens; `size` (width, height) pixels; exposed every so many steps."""
        width, height = size
        self._world, self._radius, self._size, self._every = world, radius, size, every
        self.pictures: dict[str, np.ndarray] = {
            "rgb": np.zeros((*shape, height, width, 3), dtype=np.uint8),
            "depth": np.full((*shape, height, width), FAR, dtype=np.float32),
        }

    def expose(self, swarm: Swarm, alive: np.ndarray, steps: np.ndarray) -> None:
        """Take new pictures of living drones (W, N) in worlds whose step count (W,) says so."""
        due = alive & (steps % self._every == 0)[:, None]
        projection = projection_matrix(self._size[0] / self._size[1], FIELD_OF_VIEW)
        for w, i in np.argwhere(due).tolist():
            forward, _, up = (np.array(axis) for axis in axes(swarm.quaternion[w, i]))
            eye = swarm.position[w, i] + self._radius[i] * forward
            seen = self._world.picture(w, view_matrix(eye, eye + forward, up.tolist()), projection, self._size)
            self.pictures["rgb"][w, i], self.pictures["depth"][w, i] = seen.pixels, seen.depth
