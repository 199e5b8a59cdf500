"""Renderer of camera images of an engine's worlds, and of its live window."""

import numpy as np

from bulletuav.engine.bodies import FLOOR
from bulletuav.engine.body_table import BodyTable
from bulletuav.engine.calls import bullet
from bulletuav.geometry.view import Picture, linearise_depth

LIGHT = (0.4, -0.7, 1.0)
"""Direction towards the sun, chosen so that walls differ in brightness"""
YAW = 45.0
"""Yaw of the live window's camera, degrees"""
PITCH = -35.0
"""Pitch of the live window's camera, degrees; negative is below the horizon"""


class SceneRenderer:
    """Renderer of one world at a time, which moves the floor and the facades to that world."""

    def __init__(self, client: int, bodies: BodyTable, offset: np.ndarray) -> None:
        """Create the renderer.

        Args:
            client: Id of the client in Bullet.
            bodies: All bodies of the engine.
            offset: (W, 3) origins of the tiles, m.
        """
        self._client = client
        self._bodies = bodies
        self._offset = offset

    def show_city(self, world: int) -> None:
        """Move the floor and the facades of a world's layout to that world."""
        shown = [(self._bodies.floor, -FLOOR / 2), *self._bodies.layouts.facades(world)]
        for body, height in shown:
            place = self._offset[world] + [0, 0, height]
            bullet.resetBasePositionAndOrientation(body, place, [0, 0, 0, 1], self._client)

    def picture(
        self, world: int, view: np.ndarray, projection: np.ndarray, size: tuple[int, int]
    ) -> Picture:
        """Render a camera image of a world; see `Engine.picture_by_bullet`."""
        self.show_city(world)
        # The view matrix is in the world's own frame; Bullet takes matrices in column-major order.
        shift = np.eye(4)
        shift[:3, 3] = -self._offset[world]
        width, height = size
        _, _, pixels, buffer, bodies = bullet.getCameraImage(
            width,
            height,
            (view @ shift).T.ravel().tolist(),
            projection.T.ravel().tolist(),
            lightDirection=LIGHT,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        body = np.asarray(bodies).reshape(height, width)
        colours = np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        depth = linearise_depth(np.asarray(buffer, dtype=np.float64).reshape(height, width))
        # Bodies without a label share the entry before the last.
        label = self._bodies.pixel_labels()
        labels = label[np.minimum(body, len(label) - 2)]
        return Picture(colours, depth.astype(np.float32), labels)

    def look_at(self, world: int, target: np.ndarray, distance: float) -> None:
        """Point the camera of the live window at a position; see `Engine.look_at`."""
        place = (target + self._offset[world]).tolist()
        bullet.resetDebugVisualizerCamera(distance, YAW, PITCH, place, physicsClientId=self._client)
