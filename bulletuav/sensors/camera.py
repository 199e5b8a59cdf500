"""Forward camera on each drone: rendered images, or depth images by ray casting."""

from collections.abc import Mapping

import numpy as np

from bulletuav.engine.calls import require_bullet
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import axes
from bulletuav.geometry.view import DRONE, FAR, SKY, projection_matrix, view_matrix
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup
from bulletuav.vehicle.swarm import Swarm

FIELD_OF_VIEW = 90.0
"""Vertical field of view, degrees"""
RENDERED = ("rgb", "depth", "segmentation")
IMAGES = {
    "rgb": Image(0, 255, np.uint8, (3,)),
    "depth": Image(0.0, FAR, np.float32, ()),
    "segmentation": Image(SKY, DRONE, np.uint8, ()),
    "ray_depth": Image(0.0, FAR, np.float32, ()),
}


@register("sensor")
class Camera(Sensor):
    """Forward-looking camera at the front of each drone, fixed to the body.

    Images are held between exposures. "depth" and "ray_depth" differ by the rounding of the
    renderer, and rays intersect the collision shapes of drones; ray casting takes a tenth of the
    time.

    Attributes:
        pictures: Requested images: "rgb" (W, N, height, width, 3) uint8; "segmentation" (W, N,
            height, width) uint8 (see `geometry.view.SKY`); "depth" and "ray_depth" (W, N, height,
            width) float32, m along the view axis.
    """

    name = "camera"
    gives = tuple(IMAGES)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the pixel types of the images."""
        return dict(IMAGES)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the images, and compute the rays of one camera."""
        super().attach(setup, engine)
        self._radius = np.array(setup.radius)
        width, height = setup.camera_size
        shape = (*setup.shape, height, width)
        self.pictures = {
            name: np.full(
                (*shape, *image.pixel), FAR if image.dtype == np.float32 else 0, image.dtype
            )
            for name, image in IMAGES.items()
            if name in setup.wanted
        }
        self.needs_bodies = not self.pictures.keys().isdisjoint(RENDERED)
        if self.needs_bodies:
            require_bullet("the observations 'rgb', 'depth' and 'segmentation'")
        half = np.tan(np.radians(FIELD_OF_VIEW) / 2)
        # Rays through the pixel corners that the renderer samples, up to the plane at distance FAR;
        # hit fractions of these rays are depths.
        left = half * width / height * (1 - 2 * np.arange(width) / width)
        up = half * (1 - 2 * (np.arange(height) + 1) / height)
        self._rays = FAR * np.stack(
            np.broadcast_arrays(1.0, left[None, :], up[:, None]), axis=-1
        ).reshape(-1, 3)

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return the current images; see the base class."""
        return self.pictures

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Take new images in worlds at which an exposure is due; hold the others."""
        swarm, mask = moment.after, moment.mask
        exposed = moment.steps % self.setup.camera_every == 0
        due = np.argwhere(mask & exposed[:, None])
        if self.needs_bodies:
            self._render(swarm, due)
        if "ray_depth" in self.pictures and len(due):
            self._cast(swarm, mask, due)
        return dict(self.pictures)

    def _render(self, swarm: Swarm, due: np.ndarray) -> None:
        projection = projection_matrix(
            self.setup.camera_size[0] / self.setup.camera_size[1], FIELD_OF_VIEW
        )
        for w, i in due.tolist():
            forward, _, up = (np.array(axis) for axis in axes(swarm.quaternion[w, i]))
            eye = swarm.position[w, i] + self._radius[i] * forward
            seen = self.engine.picture(
                w, view_matrix(eye, eye + forward, up.tolist()), projection, self.setup.camera_size
            )
            for name, picture in zip(RENDERED, (seen.pixels, seen.depth, seen.labels), strict=True):
                if name in self.pictures:
                    self.pictures[name][w, i] = picture

    def _cast(self, swarm: Swarm, mask: np.ndarray, due: np.ndarray) -> None:
        """Cast the rays of all cameras in one batch."""
        where, drone = due.T
        frames = np.array(
            [np.stack(axes(quaternion)) for quaternion in swarm.quaternion[where, drone]]
        )
        eye = swarm.position[where, drone] + self._radius[drone, None] * frames[:, 0]
        start = np.repeat(eye, len(self._rays), axis=0)
        end = start + (self._rays @ frames).reshape(-1, 3)
        fraction = self.engine.cast_rays(
            start, end, np.repeat(where, len(self._rays)), (swarm, mask)
        )
        self.pictures["ray_depth"][where, drone] = FAR * fraction.reshape(
            -1, *self.setup.camera_size[::-1]
        )
