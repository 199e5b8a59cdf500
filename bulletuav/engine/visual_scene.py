"""Pictures for people: visual shapes of drones, obstacles and cities, drawn without Bullet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.engine.body_table import Contents
from bulletuav.engine.pictures import AMBIENT, SUN, PictureMaker
from bulletuav.geometry.city_grid import make_city_grid
from bulletuav.geometry.quaternions import multiply_quaternions, rotate_vectors
from bulletuav.geometry.raster import Cameras, Images
from bulletuav.geometry.rotation import Quat4Like, to_body
from bulletuav.geometry.scenery import Scenery, add_pieces, make_scenery
from bulletuav.geometry.shapes import Shape
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import DRONE, FAR, LAND, OBSTACLE, CameraMatrices, Picture
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Swarm
from bulletuav.vehicle.visuals import Colour, VisualShape, collision_part, read_visual_shapes

FLOOR_COLOUR = (200, 205, 197)
"""Colour of the ground: red, green, blue, from 0 to 255"""
COLLISION_COLOUR: Colour = (0.98, 0.62, 0.15, 1.0)
"""Colour of the collision shapes of drones"""
CODE_DIGITS = np.array([1, 256, 65536], dtype=np.int32)
"""Factors of the red, green and blue of the code of a shape"""
SAMPLES = 2
"""Number of samples of a pixel's colour in each direction, against jagged edges"""


class ScenePoses(NamedTuple):
    """Poses of all bodies in W worlds that pictures show.

    Attributes:
        position: (W, N, 3) of the drones, m.
        quaternion: (W, N, 4) of the drones, body to world.
        body_position: (W, R, 3) of the pieces of obstacles and added bodies, m.
        body_quaternion: (W, R, 4) of these pieces.
        layout: (W,) present city layout of each world, or `NO_LAYOUT`.
        added: Shapes and colours of the pieces of added bodies, which follow the obstacles.
    """

    position: np.ndarray
    quaternion: np.ndarray
    body_position: np.ndarray
    body_quaternion: np.ndarray
    layout: np.ndarray
    added: Sequence[tuple[Shape, Colour]] = ()


class _Model(NamedTuple):
    """Shapes of one world, scaled.

    Attributes:
        scenery: The shapes.
        layouts: The city layouts.
        maker: Rasteriser of pictures.
        body: (S,) int32 index of the drone of each part, and N + r for piece r of the bodies.
    """

    scenery: Scenery
    layouts: list[Solids]
    maker: PictureMaker
    body: np.ndarray


class VisualScene:
    """Visual shapes of one world of an engine at a time."""

    def __init__(self, contents: Contents, collision: bool = False) -> None:
        """Read the visual shapes of the drones.

        Args:
            contents: Drones, obstacles and city layouts of the worlds.
            collision: Whether drones are shown by their collision shapes.
        """
        self._contents = contents
        # Drones share airframes, whose files are read once
        parts = {one: _parts(one, collision) for one in dict.fromkeys(contents.airframes)}
        self._parts = [part for one in contents.airframes for part in parts[one]]
        count = [len(parts[one]) for one in contents.airframes]
        self._owner = np.repeat(np.arange(len(count)), count)
        self._offset = np.array([part.position for part in self._parts]).reshape(-1, 3)
        self._turn = np.array([part.quaternion for part in self._parts]).reshape(-1, 4)
        self._model: _Model | None = None
        # Rasteriser in whose pictures drones and bodies have their codes as colours
        self._coder: PictureMaker | None = None
        self._key: tuple[float, int] = (0.0, 0)

    def draw(
        self,
        world: int,
        poses: ScenePoses,
        shot: CameraMatrices,
        mask: np.ndarray | None = None,
        far: float = FAR,
        with_bodies: bool = False,
    ) -> tuple[Picture, np.ndarray | None]:
        """Draw the picture of a camera in a world.

        Args:
            world: Index of the world.
            poses: Poses of all bodies.
            shot: View, projection and size of the picture.
            mask: (N,) bool, drones that are shown; None for all.
            far: Depth that the picture reaches at least, m. That of the sky is not less.
            with_bodies: Whether to find the body at each pixel.

        Returns:
            The picture: colours, averages over each pixel; depths and labels by the ray through the
            corner of each pixel, as `Engine.pictures` draws them.
            (H, W) int32 body at each pixel by the same ray: the index of a drone, N + r for piece r
            of the obstacles and added bodies, and -1 for sky, ground and buildings; None without
            `with_bodies`.
        """
        # The rasteriser draws to the depth FAR: scenes that reach farther are made smaller, by a
        # power of two, so that they are rarely made again
        scale = 2.0 ** -np.ceil(np.log2(max(far, FAR) / FAR))
        key = (scale, len(poses.added))
        if self._model is None or key != self._key:
            self._model, self._key, self._coder = self._build(scale, poses.added), key, None
        scenery = self._model.scenery
        shown = np.ones(len(self._contents.airframes), dtype=bool) if mask is None else mask
        of_part = poses.quaternion[world, self._owner]
        place = poses.position[world, self._owner] + rotate_vectors(of_part, self._offset)
        drones = Swarm.zeros(1, len(self._owner), 1)
        drones.position[0] = scale * place
        drones.quaternion[0] = multiply_quaternions(of_part, self._turn)
        scenery.place[0] = scale * poses.body_position[world]
        scenery.quaternion[0] = poses.body_quaternion[world]
        scenery.city_grid.layout[0] = poses.layout[world]
        width, height = (SAMPLES * size for size in shot.size)
        images = Images(
            depth=np.empty((1, height, width), dtype=np.float32),
            labels=np.empty((1, height, width), dtype=np.uint8),
            colours=np.empty((1, height, width, 3), dtype=np.uint8),
            normals=np.empty((1, height, width, 3), dtype=np.float32),
        )
        camera = _camera(shot, scale)
        is_shown = shown[None, self._owner]
        self._model.maker.draw(scenery, camera, images, drones, is_shown, None)
        _shade(images, tuple(camera.quaternion[0]))
        # Rays through the corners of pixels
        depth = images.depth[0, SAMPLES - 1 :: SAMPLES, ::SAMPLES] / scale
        labels = images.labels[0, SAMPLES - 1 :: SAMPLES, ::SAMPLES].copy()
        picture = Picture(_average(images.colours[0], images.labels[0]), depth, labels)
        if not with_bodies:
            return picture, None
        return picture, self._find_bodies(self._model, camera, shot.size, drones, is_shown)

    def _find_bodies(
        self,
        model: _Model,
        camera: Cameras,
        size: tuple[int, int],
        drones: Swarm,
        is_shown: np.ndarray,
    ) -> np.ndarray:
        """Return the body at each pixel (H, W) by the ray through its corner; see `draw`."""
        if self._coder is None:
            codes = np.arange(len(model.body))[:, None] // CODE_DIGITS % 256
            self._coder = PictureMaker(model.scenery, model.layouts, codes)
        width, height = size
        images = Images(
            depth=np.empty((1, height, width), dtype=np.float32),
            labels=np.empty((1, height, width), dtype=np.uint8),
            colours=np.empty((1, height, width, 3), dtype=np.uint8),
        )
        self._coder.draw(model.scenery, camera, images, drones, is_shown, None)
        is_own = np.isin(images.labels[0], (OBSTACLE, DRONE))
        bodies = np.full((height, width), -1, dtype=np.int32)
        bodies[is_own] = model.body[images.colours[0][is_own] @ CODE_DIGITS]
        return bodies

    def _build(self, scale: float, added: Sequence[tuple[Shape, Colour]]) -> _Model:
        """Make the shapes of a world, with lengths multiplied by a factor."""
        layouts = [
            Solids(scale * one.boxes, tuple(scale * hull for hull in one.hulls), one.colours)
            for one in self._contents.layouts
        ]
        scenery = make_scenery(
            drones=[_scaled(part.shape, scale) for part in self._parts],
            obstacles=(),
            others=(),
            layouts=layouts,
            city_grid=make_city_grid(layouts, 1),
        )
        bodies = [(one.shape, one.colour) for one in self._contents.obstacles] + list(added)
        scenery = add_pieces(
            scenery,
            [_scaled(shape, scale) for shape, _ in bodies],
            place=np.zeros((1, len(bodies), 3)),
            quaternion=np.zeros((1, len(bodies), 4)),
            other=FIRST_OBSTACLE,
            friction=0.0,
            restitution=0.0,
        )
        colours = [part.colour for part in self._parts] + [colour for _, colour in bodies]
        colour = 255 * np.array(colours).reshape(-1, 4)[:, :3]
        body = np.append(self._owner, len(self._contents.airframes) + np.arange(len(bodies)))
        maker = PictureMaker(scenery, layouts, colour)
        return _Model(scenery, layouts, maker, body.astype(np.int32))


def _parts(airframe: Airframe, collision: bool) -> list[VisualShape]:
    """Return the shapes that show a drone; fully transparent ones do not."""
    if collision:
        return [collision_part(airframe, COLLISION_COLOUR)]
    return [part for part in read_visual_shapes(airframe) if part.colour[3] > 0]


def _scaled(shape: Shape, scale: float) -> Shape:
    """Return a shape with lengths multiplied by a factor."""
    x, y, z = shape.half
    corners = tuple((scale * a, scale * b, scale * c) for a, b, c in shape.corners)
    return Shape(shape.kind, (scale * x, scale * y, scale * z), corners)


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of a rotation matrix (3, 3).

    It is the eigenvector of the largest eigenvalue, which has no singular attitude.

    References:
        I. Y. Bar-Itzhack, New method for extracting the quaternion from a rotation matrix (2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix
    lower = [
        [a - e - i, 0.0, 0.0, 0.0],
        [d + b, e - a - i, 0.0, 0.0],
        [g + c, h + f, i - a - e, 0.0],
        [h - f, c - g, d - b, a + e + i],
    ]
    _, vectors = np.linalg.eigh(np.array(lower) / 3)
    largest: np.ndarray = vectors[:, 3]
    return largest


def _camera(shot: CameraMatrices, scale: float) -> Cameras:
    """Convert matrices to a camera in a scaled world."""
    right, up, back = shot.view[:3, :3]
    eye = -shot.view[:3, 3] @ shot.view[:3, :3]
    attitude = _quaternion(np.stack([-back, -right, up], axis=1))
    return Cameras(
        world=np.zeros(1, dtype=np.int64),
        drone=np.full(1, -1),
        eye=scale * eye[None],
        quaternion=attitude[None],
        tangent=1 / shot.projection[1:2, 1],
        slot=np.zeros(1, dtype=np.int64),
    )


def _shade(images: Images, attitude: Quat4Like) -> None:
    """Shade drones, obstacles and bodies by the sun; cities are shaded already."""
    is_own = np.isin(images.labels, (OBSTACLE, DRONE))
    light = AMBIENT + (1 - AMBIENT) * (images.normals[is_own] @ np.array(to_body(attitude, SUN)))
    images.colours[is_own] = (images.colours[is_own] * light[:, None]).astype(np.uint8)


def _average(colours: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Average the samples of each pixel, with a ground of one colour."""
    from PIL import Image  # slow to import

    np.copyto(colours, np.array(FLOOR_COLOUR, np.uint8), where=(labels == LAND)[..., None])
    return np.array(Image.fromarray(colours).reduce(SAMPLES))
