"""Forward camera on each drone: depth, labels and colours, without Bullet unless asked for."""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import kernel
from bulletuav.engine.calls import require_bullet
from bulletuav.engine.engine import Engine
from bulletuav.geometry.raster import Cameras, Images
from bulletuav.geometry.raycast import Poses
from bulletuav.geometry.rotation import axes, plus, quat4, vec3
from bulletuav.geometry.view import (
    DRONE,
    FAR,
    SKY,
    CameraMatrices,
    projection_matrix,
    view_matrix,
)
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

RENDERERS = ("compiled", "bullet")
"""Values of the option `camera`"""
RENDERED = ("rgb", "depth", "segmentation")
IMAGES = {
    "rgb": Image(0, 255, np.uint8, (3,)),
    "depth": Image(0.0, FAR, np.float32, ()),
    "segmentation": Image(SKY, DRONE, np.uint8, ()),
    "ray_depth": Image(0.0, FAR, np.float32, ()),
}
ALIASES = {"ray_depth": "depth"}
"""Other names of images"""


@register("sensor")
class Camera(Sensor):
    """Forward-looking camera at the front of each drone, fixed to the body.

    Images are held between exposures. They show the collision shapes of drones, and are drawn by
    `bulletuav.geometry.raster`: a depth is that of a ray through the upper left corner of the
    pixel. With the option camera="bullet", PyBullet's TinyRenderer draws them: a hundredth of the
    speed, with the visual shapes of drones and facades, and depths in single precision.

    Noise of depths grows with the square of the depth, as that of stereo cameras and structured
    light: standard deviation of a disparity, divided by focal length and baseline, times depth
    squared. The sky has none.

    References:
        K. Khoshelham and S. Oude Elberink, Accuracy and resolution of Kinect depth data for indoor
        mapping applications (Sensors 2012).

    Attributes:
        depth_noise: (W, N) standard deviation of a depth divided by its square, 1/m.
        fov: (W, N) vertical field of view, degrees.
        pictures: Requested images: "rgb" (W, N, height, width, 3) uint8; "segmentation" (W, N,
            height, width) uint8 (see `geometry.view.SKY`); "depth" (W, N, height, width) float32, m
            along the view axis; "ray_depth", another name of "depth".
    """

    name = "camera"
    gives = tuple(IMAGES)
    uncertain: ClassVar = {
        "depth_noise": Uncertain(0.0, 1.0),
        "fov": Uncertain(10.0, 150.0, 90.0),
    }

    depth_noise: np.ndarray
    fov: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the pixel types of the images."""
        return dict(IMAGES)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the images, and compute the rays of one camera."""
        super().attach(setup, engine)
        self._radius = np.array(setup.radius)
        width, height = setup.camera_size
        wanted = {ALIASES.get(name, name): IMAGES[name] for name in IMAGES if name in setup.wanted}
        self._images = {
            name: np.full(
                (*setup.shape, height, width, *image.pixel),
                FAR if image.dtype == np.float32 else 0,
                image.dtype,
            )
            for name, image in wanted.items()
        }
        self.pictures = {
            name: self._images[ALIASES.get(name, name)] for name in IMAGES if name in setup.wanted
        }
        self.needs_bodies = setup.camera == "bullet"
        if self.needs_bodies:
            require_bullet("camera 'bullet'")
        count = setup.shape[0] * setup.shape[1]
        index = (np.zeros(count, dtype=np.int64) for _ in range(3))
        self._cameras = Cameras(
            world=next(index),
            drone=next(index),
            eye=np.zeros((count, 3)),
            quaternion=np.zeros((count, 4)),
            tangent=np.zeros(count),
            slot=next(index),
        )

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return the current images; see the base class."""
        return self._images

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Take new images in worlds at which an exposure is due; hold the others."""
        swarm, mask = moment.after, moment.mask
        exposed = moment.steps % self.setup.camera_every == 0
        due = mask & exposed[:, None]
        if self.needs_bodies:
            self._render(swarm, np.argwhere(due))
        else:
            self._draw(swarm, mask, due)
        if "depth" in self._images:
            self._add_noise(self._images["depth"], due, moment.rngs)
        return dict(self.pictures)

    def _add_noise(
        self, depth: np.ndarray, due: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Add noise to the new depths; each world draws from its own generator."""
        for w in np.flatnonzero(due.any(axis=1) & self.depth_noise.any(axis=1)).tolist():
            error = rngs[w].standard_normal(depth.shape[1:], dtype=np.float32)
            new, scale = due[w], self.depth_noise[w].astype(np.float32)[:, None, None]
            true = depth[w]
            noisy = np.clip(true + scale * true * true * error, 0, FAR)
            noisy[true == FAR] = FAR
            depth[w][new] = noisy[new]

    def _draw(self, swarm: Swarm, mask: np.ndarray, due: np.ndarray) -> None:
        """Draw the pictures of all cameras that are due (W, N) in one batch."""
        count = _place_cameras(swarm, due, self._radius, self.fov, self._cameras)
        if not count:
            return
        cameras = Cameras(*(array[:count] for array in self._cameras))
        size = self.setup.camera_size[::-1]
        pixels = {name: IMAGES[name].pixel for name in RENDERED}
        # Images that are not requested have no rows
        images = {
            name: self._images[name].reshape(-1, *size, *pixel)
            if name in self._images
            else np.zeros((0, *size, *pixel), IMAGES[name].dtype)
            for name, pixel in pixels.items()
        }
        self.engine.pictures(
            cameras,
            Images(images["depth"], images["segmentation"], images["rgb"]),
            (swarm, mask),
        )

    def _render(self, swarm: Swarm, due: np.ndarray) -> None:
        aspect = self.setup.camera_size[0] / self.setup.camera_size[1]
        for w, i in due.tolist():
            projection = projection_matrix(aspect, self.fov[w, i])
            forward, _, up = (np.array(axis) for axis in axes(swarm.quaternion[w, i]))
            eye = swarm.position[w, i] + self._radius[i] * forward
            view = view_matrix(eye, eye + forward, up.tolist())
            seen = self.engine.picture_by_bullet(
                w, CameraMatrices(view, projection, self.setup.camera_size)
            )
            for name, picture in zip(RENDERED, (seen.pixels, seen.depth, seen.labels), strict=True):
                if name in self._images:
                    self._images[name][w, i] = picture


@kernel
def _place_cameras(
    swarm: Poses, due: np.ndarray, radius: np.ndarray, fov: np.ndarray, cameras: Cameras
) -> int:
    """Mount cameras at the front of drones.

    Args:
        swarm: State of the drones.
        due: (W, N) bool, drones whose cameras take a picture.
        radius: (N,) distances of the cameras from the centres of mass, m.
        fov: (W, N) vertical fields of view, degrees.
        cameras: The cameras; written.

    Returns:
        The number of cameras.
    """
    count = 0
    for w in range(due.shape[0]):
        for i in range(due.shape[1]):
            if due[w, i]:
                quaternion = quat4(swarm.quaternion, w, i)
                eye = plus(vec3(swarm.position, w, i), radius[i], axes(quaternion)[0])
                half = math.radians(fov[w, i]) / 2
                cameras.tangent[count] = sin(half) / cos(half)
                cameras.world[count] = w
                cameras.drone[count] = i
                cameras.slot[count] = w * due.shape[1] + i
                for k in range(3):
                    cameras.eye[count, k] = eye[k]
                for k in range(4):
                    cameras.quaternion[count, k] = swarm.quaternion[w, i, k]
                count += 1
    return count
