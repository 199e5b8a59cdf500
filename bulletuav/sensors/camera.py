"""Forward camera on each drone: depth, labels and colours, without Bullet unless asked for."""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.engine.calls import require_bullet
from bulletuav.engine.engine import Engine
from bulletuav.engine.pictures import Look
from bulletuav.geometry.raster import MAX_FLOW, Cameras, Earlier, Images
from bulletuav.geometry.raycast import Poses
from bulletuav.geometry.rotation import axes, from_euler, heading, plus, product, quat4, vec3
from bulletuav.geometry.view import (
    DRONE,
    FAR,
    SKY,
    CameraMatrices,
    projection_matrix,
    view_matrix,
)
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.sensors.mounts import Mount
from bulletuav.vehicle.swarm import Swarm

RENDERERS = ("compiled", "bullet")
"""Values of the option `camera`"""
DEPTHS = ("metres", "linear", "inverse")
"""Values of the option `camera_depth`"""
LAYERS = ("depth", "segmentation", "rgb", "normals", "flow")
"""Images in the order of `Images`"""
RENDERED = ("rgb", "depth", "segmentation")
"""Images in the order of `Picture`"""
IMAGES = {
    "rgb": Image(0, 255, np.uint8, (3,)),
    "depth": Image(0.0, FAR, np.float32, ()),
    "segmentation": Image(SKY, DRONE, np.uint8, ()),
    "normals": Image(-1.0, 1.0, np.float32, (3,)),
    "flow": Image(-MAX_FLOW, MAX_FLOW, np.float32, (2,)),
    "ray_depth": Image(0.0, FAR, np.float32, ()),
}
ALIASES = {"ray_depth": "depth"}
"""Other names of images"""
EDGE_BEND = 0.1
"""Second difference of 1/depth at an edge, as a fraction of 1/depth of the nearest pixel"""
MAX_DELAY = 2.0
"""Maximum delay of pictures, s"""
COMPILED_ONLY = ("normals", "flow")
"""Images that PyBullet's renderer does not draw"""
DEPTH_IMAGES = ("depth", "ray_depth")


@register("sensor")
class Camera(Sensor):
    """Cameras of each drone; by default one that looks forward, at the front of the body.

    Images are held between exposures. They show the collision shapes of drones, and are drawn by
    `bulletuav.geometry.raster`: a depth is that of a ray through the upper left corner of the
    pixel. With the option camera="bullet", PyBullet's TinyRenderer draws them: a hundredth of the
    speed, with the visual shapes of drones and facades, and depths in single precision.

    Noise of depths grows with the square of the depth, as that of stereo cameras and structured
    light: standard deviation of a disparity, divided by focal length and baseline, times depth
    squared. The sky has none. Such cameras measure disparities in steps: 1/depth is a multiple of
    the step of the disparity, divided by focal length and baseline, such as 0.00285 1/m of the
    Kinect. At edges of objects, which only one of two views shows, they find no depth.

    References:
        L. Keselman et al., Intel RealSense stereoscopic depth cameras (CVPR workshops 2017).
        K. Khoshelham and S. Oude Elberink, Accuracy and resolution of Kinect depth data for indoor
        mapping applications (Sensors 2012).

    Attributes:
        depth_noise: (W, N) standard deviation of a depth divided by its square, 1/m.
        depth_step: (W, N) steps to which 1/depth is rounded, after the noise, 1/m; 0 for none.
        edge_dropout: (W, N) probability that a pixel at an edge, where the depth jumps, has none:
            it is that of the sky.
        fov: (W, N) vertical field of view, degrees.
        delay: (W, N) delay of pictures, s; rounded to decisions. Until the first picture of an
            episode could be late, it is shown.
        colours: (W,) strength of random colours of "rgb", drawn for each episode: 0 for the default
            colours, 1 for random colours of sky, ground and each building, windows, and direction
            of the sun.
        pictures: Requested images: "rgb" (W, N, height, width, 3) uint8; "segmentation" (W, N,
            height, width) uint8 (see `geometry.view.SKY`); "depth" (W, N, height, width) float32,
            along the view axis, in the form of the option `camera_depth`; "ray_depth", another name
            of "depth"; "normals" (W, N, height, width, 3) float32, outward unit normals of the
            surfaces in the axes of the camera: x along the view axis, y left, z up; zero for the
            sky; "flow" (W, N, height, width, 2) float32, motion of surfaces in the picture since
            the last decision, to the right and down, pixels. With several cameras, their number is
            the third dimension.
    """

    name = "camera"
    gives = tuple(IMAGES)
    uncertain: ClassVar = {
        "depth_noise": Uncertain(0.0, 1.0),
        "depth_step": Uncertain(0.0, 1.0),
        "edge_dropout": Uncertain(0.0, 1.0),
        "fov": Uncertain(10.0, 150.0, 90.0),
        "delay": Uncertain(0.0, MAX_DELAY),
        "colours": Uncertain(0.0, 1.0, per="world"),
    }

    depth_noise: np.ndarray
    depth_step: np.ndarray
    edge_dropout: np.ndarray
    fov: np.ndarray
    delay: np.ndarray
    colours: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, Image]:
        """Return the pixel types of the images."""
        near, far = setup.camera_range if setup.camera_depth == "metres" else (0.0, 1.0)
        depths = {name: IMAGES[name]._replace(low=near, high=far) for name in DEPTH_IMAGES}
        mounts = setup.camera_mounts
        stack = (len(mounts),) if isinstance(mounts, tuple) else ()
        images = IMAGES | depths
        if setup.camera == "bullet":
            images = {name: one for name, one in images.items() if name not in COMPILED_ONLY}
        return {name: one._replace(stack=stack) for name, one in images.items()}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the images and the cameras."""
        super().attach(setup, engine)
        width, height = setup.camera_size
        labels = self.labels(setup)
        names = [name for name in labels if name in setup.wanted]
        wanted = {ALIASES.get(name, name): labels[name] for name in names}
        self._images = {
            name: np.zeros((*setup.shape, *image.stack, height, width, *image.pixel), image.dtype)
            for name, image in wanted.items()
        }
        if "depth" in self._images:
            # Nothing is seen before the first exposure
            self._images["depth"][:] = FAR
            self._scale_depth(np.ones(setup.shape, dtype=np.bool_))
        self._past: dict[str, np.ndarray] = {}  # (W, decisions, N, ...), a ring buffer
        self._shown = self._images
        late = round(setup.longest_picture_delay / setup.period)
        if late:
            images = self._images.items()
            self._past = {name: np.stack([one] * (late + 1), 1) for name, one in images}
            self._shown = {name: one.copy() for name, one in images}
        self.pictures = {name: self._shown[ALIASES.get(name, name)] for name in names}
        self.needs_bodies = setup.camera == "bullet"
        if self.needs_bodies:
            require_bullet("camera 'bullet'")
        # Strength and seed of the colours of each world, and those that the engine has
        self._looks, self._set = np.zeros((2, setup.shape[0], 2))
        mounts = setup.camera_mounts
        self._mounts = _stack_mounts(mounts if isinstance(mounts, tuple) else (mounts,), setup)
        count = setup.shape[0] * setup.shape[1] * len(self._mounts.quaternion)
        self._cameras, self._earlier = _empty_cameras(count), _empty_cameras(count)
        self._bodies = [np.zeros((setup.shape[0], 0, width)) for width in (3, 4)]

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Draw the colours of a world."""
        strength = float(self.colours[world])
        if "rgb" in self._images:
            self._looks[world] = strength, rng.integers(2**31) if strength else 0

    def _set_looks(self) -> None:
        """Pass colours that were drawn, or restored by a snapshot, to the engine."""
        for w in np.flatnonzero((self._looks != self._set).any(axis=1)).tolist():
            self.engine.set_look(w, Look(float(self._looks[w, 0]), int(self._looks[w, 1])))
        self._set[:] = self._looks

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return the current and the past images and the colours; see the base class."""
        kept = {**self._images, "looks": self._looks} if "rgb" in self._images else self._images
        if "flow" in self._images:
            kept = {**kept, "bodies": self._bodies[0], "attitudes": self._bodies[1]}
        if not self._past:
            return kept
        past = {f"past {name}": one for name, one in self._past.items()}
        shown = {f"shown {name}": one for name, one in self._shown.items()}
        return {**kept, **past, **shown}

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Take new images in worlds at which an exposure is due; hold the others."""
        swarm, mask = moment.after, moment.mask
        flown: np.ndarray = np.any(mask, axis=1)
        if "flow" in self._images:
            # Bodies have not moved before a reset, and after one was added
            is_new = self._bodies[0].shape != self.engine.scenery.place.shape
            self._store_bodies(flown & ((moment.steps == 0) | is_new))
        exposed = moment.steps % self.setup.camera_every == 0
        due = mask & exposed[:, None]
        count = _place_cameras(swarm, due, self._mounts, self.fov, self._cameras)
        cameras = Cameras(*(array[:count] for array in self._cameras))
        if self.needs_bodies:
            self._render(cameras)
        elif count:
            self._draw(moment, due, cameras)
        if "flow" in self._images:
            self._store_bodies(flown)
        if "depth" in self._images:
            self._add_noise(self._images["depth"], due, moment.rngs)
            self._scale_depth(due)
        if self._past:
            self._show_past(moment)
        return dict(self.pictures)

    def _add_noise(
        self, depth: np.ndarray, due: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Add errors to the new depths; each world draws from its own generator."""
        for w in np.flatnonzero(due.any(axis=1)).tolist():
            own = (self.depth_noise[w], self.depth_step[w], self.edge_dropout[w])
            is_noisy, is_stepped, drops = (bool(one.any()) for one in own)
            if not (is_noisy or is_stepped or drops):
                continue
            true = depth[w]
            found = true.copy()
            if is_noisy:
                error = rngs[w].standard_normal(true.shape, dtype=np.float32)
                scale = self.depth_noise[w].astype(np.float32)
                scale = scale.reshape(-1, *(1,) * (error.ndim - 1))
                found = np.clip(true + scale * true * true * error, 0, FAR)
                found[true == FAR] = FAR
            chance = np.ones_like(true)
            if drops:
                chance = rngs[w].random(true.shape, dtype=np.float32)
            if is_stepped or drops:
                stack = (-1, max(1, math.prod(true.shape[1:-2])), *true.shape[-2:])
                _match_depths(
                    true.reshape(stack),
                    found.reshape(stack),
                    self.depth_step[w],
                    self.edge_dropout[w],
                    chance.reshape(stack),
                )
            true[due[w]] = found[due[w]]

    def _show_past(self, moment: Moment) -> None:
        """Store the current images, and show those from `delay` ago."""
        w, i = np.nonzero(moment.mask)
        now = moment.steps[w]
        late = np.rint(self.delay[w, i] / self.setup.period).astype(np.int64)
        then = now - np.minimum(late, now)
        for name, past in self._past.items():
            length = past.shape[1]
            past[w, now % length, i] = self._images[name][w, i]
            self._shown[name][w, i] = past[w, then % length, i]

    def _scale_depth(self, due: np.ndarray) -> None:
        """Convert the new depths to the form of the option `camera_depth`."""
        near, far = self.setup.camera_range
        form = DEPTHS.index(self.setup.camera_depth)
        if (near, far, form) != (0.0, FAR, 0):
            depth = self._images["depth"]
            scale_depths(depth.reshape(*depth.shape[:2], -1), due, near, far, form)

    def _draw(self, moment: Moment, due: np.ndarray, cameras: Cameras) -> None:
        """Draw the pictures of cameras, those of the drones in `due` (W, N), in one batch."""
        self._set_looks()
        earlier = None
        if "flow" in self._images:
            before = moment.before
            count = _place_cameras(before, due, self._mounts, self.fov, self._earlier)
            earlier = Earlier(
                self._earlier.eye[:count],
                self._earlier.quaternion[:count],
                (before.position, before.quaternion),
                (self._bodies[0], self._bodies[1]),
            )
        images = Images(*(self._rows(name) for name in LAYERS))
        self.engine.pictures(cameras, images, (moment.after, moment.mask), earlier)

    def _store_bodies(self, worlds: np.ndarray) -> None:
        """Store the present poses of bodies in the worlds of a mask (W,)."""
        scenery = self.engine.scenery
        present = (scenery.place, scenery.quaternion)
        if self._bodies[0].shape != scenery.place.shape:
            self._bodies = [one.copy() for one in present]
        for stored, one in zip(self._bodies, present, strict=True):
            stored[worlds] = one[worlds]

    def _rows(self, name: str) -> np.ndarray:
        """Return a view of an image with a row for each camera; no rows if it is not requested."""
        pixel, size = IMAGES[name].pixel, self.setup.camera_size[::-1]
        if name not in self._images:
            return np.zeros((0, *size, *pixel), IMAGES[name].dtype)
        return self._images[name].reshape(-1, *size, *pixel)

    def _render(self, cameras: Cameras) -> None:
        """Draw the pictures of cameras by PyBullet, one by one."""
        size = self.setup.camera_size
        rows = {name: self._rows(name) for name in RENDERED if name in self._images}
        for c, slot in enumerate(cameras.slot.tolist()):
            w, eye = int(cameras.world[c]), cameras.eye[c]
            forward, _, up = (np.array(axis) for axis in axes(cameras.quaternion[c]))
            projection = projection_matrix(size[0] / size[1], self.fov[w, cameras.drone[c]])
            view = view_matrix(eye, eye + forward, up.tolist())
            seen = self.engine.picture_by_bullet(w, CameraMatrices(view, projection, size))
            for name, picture in zip(RENDERED, (seen.pixels, seen.depth, seen.labels), strict=True):
                if name in rows:
                    rows[name][slot] = picture


@func
def _bends(before: float, here: float, after: float) -> bool:
    """Return True if 1/depth is not linear, as it is on a plane, at three neighbouring pixels."""
    one = 1.0 / before
    two = 1.0 / here
    three = 1.0 / after
    return abs(one - 2.0 * two + three) > EDGE_BEND * max(one, two, three)


@kernel
def _match_depths(
    true: np.ndarray,
    found: np.ndarray,
    step: np.ndarray,
    dropout: np.ndarray,
    chance: np.ndarray,
) -> None:
    """Round depths to steps of 1/depth, and drop depths at edges.

    Args:
        true: (N, K, height, width) true depths of K cameras of each drone, m.
        found: Depths with noise, m; overwritten.
        step: (N,) steps of 1/depth, 1/m; 0 for none.
        dropout: (N,) probabilities that a pixel at an edge has no depth.
        chance: Uniform random number of each pixel, float32.
    """
    drones, cameras, height, width = true.shape
    for i in range(drones):
        for c in range(cameras):
            for v in range(height):
                for u in range(width):
                    z = true[i, c, v, u]
                    if step[i] > 0.0 and z < FAR:
                        # Rounded to zero, the disparity is that of infinity
                        steps = np.floor(1.0 / (step[i] * found[i, c, v, u]) + 0.5)
                        found[i, c, v, u] = min(1.0 / (step[i] * steps), FAR)
                    if chance[i, c, v, u] >= dropout[i]:
                        continue
                    across = 0 < u < width - 1 and _bends(
                        true[i, c, v, u - 1], z, true[i, c, v, u + 1]
                    )
                    down = 0 < v < height - 1 and _bends(
                        true[i, c, v - 1, u], z, true[i, c, v + 1, u]
                    )
                    if across or down:
                        found[i, c, v, u] = FAR


@kernel
def scale_depths(depth: np.ndarray, due: np.ndarray, near: float, far: float, form: int) -> None:
    """Clip depths to a range, and convert them to a form.

    Args:
        depth: (W, N, P) depths, m; overwritten.
        due: (W, N) bool, drones whose depths are converted.
        near: Nearest depth, m.
        far: Farthest depth, m.
        form: Index in `DEPTHS`.
    """
    for w in range(due.shape[0]):
        for i in range(due.shape[1]):
            if not due[w, i]:
                continue
            for p in range(depth.shape[2]):
                z = min(max(float(depth[w, i, p]), near), far)
                if form == 1:
                    z = (z - near) / (far - near)
                elif form == 2:
                    z = (1.0 / z - 1.0 / far) / (1.0 / near - 1.0 / far)
                depth[w, i, p] = z


def _empty_cameras(count: int) -> Cameras:
    """Allocate cameras, which are still to be placed."""
    index = (np.zeros(count, dtype=np.int64) for _ in range(3))
    return Cameras(
        world=next(index),
        drone=next(index),
        eye=np.zeros((count, 3)),
        quaternion=np.zeros((count, 4)),
        tangent=np.zeros(count),
        slot=next(index),
    )


class _Mounts(NamedTuple):
    """Mounts of the K cameras of each of N drones.

    Attributes:
        quaternion: (K, 4) attitudes relative to the drone.
        offset: (N, K, 3) positions in body axes, m.
        stabilized: (K,) bool, cameras that a gimbal levels.
    """

    quaternion: np.ndarray
    offset: np.ndarray
    stabilized: np.ndarray


def _stack_mounts(mounts: Sequence[Mount], setup: SensorSetup) -> _Mounts:
    """Return the mounts of all drones as arrays."""
    front = [[radius, 0.0, 0.0] for radius in setup.radius]
    offsets = [front if one.offset is None else [one.offset] * len(front) for one in mounts]
    return _Mounts(
        quaternion=np.array([one.quaternion for one in mounts]),
        offset=np.array(offsets, dtype=float).swapaxes(0, 1).copy(),
        stabilized=np.array([one.stabilized for one in mounts]),
    )


@kernel
def _place_cameras(
    swarm: Poses, due: np.ndarray, mounts: _Mounts, fov: np.ndarray, cameras: Cameras
) -> int:
    """Place cameras on drones.

    Args:
        swarm: State of the drones.
        due: (W, N) bool, drones whose cameras take a picture.
        mounts: Mounts of the cameras.
        depth_step: (W, N) steps to which 1/depth is rounded, after the noise, 1/m; 0 for none.
        edge_dropout: (W, N) probability that a pixel at an edge, where the depth jumps, has none:
            it is that of the sky.
        fov: (W, N) vertical fields of view, degrees.
        cameras: The cameras; written.

    Returns:
        The number of cameras.
    """
    count = 0
    num_mounts = mounts.quaternion.shape[0]
    for w in range(due.shape[0]):
        for i in range(due.shape[1]):
            if not due[w, i]:
                continue
            body = quat4(swarm.quaternion, w, i)
            forward, left, up = axes(body)
            half = math.radians(fov[w, i]) / 2
            tangent = sin(half) / cos(half)
            for m in range(num_mounts):
                eye = plus(vec3(swarm.position, w, i), mounts.offset[i, m, 0], forward)
                eye = plus(eye, mounts.offset[i, m, 1], left)
                eye = plus(eye, mounts.offset[i, m, 2], up)
                base = body
                if mounts.stabilized[m]:
                    base = from_euler(0.0, 0.0, heading(body))
                turn = (
                    mounts.quaternion[m, 0],
                    mounts.quaternion[m, 1],
                    mounts.quaternion[m, 2],
                    mounts.quaternion[m, 3],
                )
                attitude = product(base, turn)
                cameras.tangent[count] = tangent
                cameras.world[count] = w
                cameras.drone[count] = i
                cameras.slot[count] = (w * due.shape[1] + i) * num_mounts + m
                for k in range(3):
                    cameras.eye[count, k] = eye[k]
                for k in range(4):
                    cameras.quaternion[count, k] = attitude[k]
                count += 1
    return count
