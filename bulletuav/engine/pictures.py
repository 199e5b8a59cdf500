"""Camera pictures of many drones by the rasteriser, without Bullet."""

import math
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.geometry.raster import (
    CHECKER_CONTRAST,
    Cameras,
    Canvas,
    Earlier,
    Images,
    Paint,
    PixelRays,
    draw_pictures,
    make_canvas,
    make_pixel_rays,
)
from bulletuav.geometry.raycast import Poses
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY, SKY_COLOUR
from bulletuav.geometry.view_blocks import GROUND_FACE, make_faces, make_view_blocks

COLOURS = {
    SKY: SKY_COLOUR,
    LAND: (126.0, 134.0, 112.0),
    BUILDING: (178.0, 168.0, 156.0),
    OBSTACLE: (214.0, 96.0, 64.0),
    DRONE: (48.0, 62.0, 120.0),
}
"""Colours of fully lit faces by label: red, green, blue, from 0 to 255"""
HUE_STEPS = 7
"""Number of shades of buildings and obstacles, which differ by `HUE_STEP`"""
HUE_STEP = 6.0
"""Difference between these shades, from 0 to 255"""
SUN = (0.33, -0.57, 0.75)
"""Direction to the sun"""
AMBIENT = 0.7
"""Brightness of faces that are parallel to the direction of the sun"""
WINDOWS = (3.0, 3.0, 0.5, 0.0)
"""Windows of buildings, of which the last number is 0: none; see `Paint.windows`"""
TINT = 60.0
"""Maximum difference of the drawn colours of a building or obstacle, from 0 to 255"""


class Look(NamedTuple):
    """Colours of pictures of a world.

    Attributes:
        strength: From 0, the default colours, to 1, random ones.
        seed: Seed of these: colours of sky, ground and each building, direction of the sun, and
            windows.
    """

    strength: float = 0.0
    seed: int = 0


def _colours_of(layouts: Sequence[Solids]) -> np.ndarray | None:
    """Return the colours (T, 3) of the pieces of layouts; None if no layout has its own."""
    if all(solids.colours is None for solids in layouts):
        return None
    usual = [np.tile(COLOURS[BUILDING], (len(solids.bounds), 1)) for solids in layouts]
    own = [solids.colours for solids in layouts]
    return np.concatenate([a if b is None else b for a, b in zip(usual, own, strict=True)])


class PictureMaker:
    """Draws pictures of the worlds of an engine; see `Engine.pictures`."""

    def __init__(
        self,
        scenery: Scenery,
        layouts: Sequence[Solids],
        colour: np.ndarray | None = None,
        is_load: np.ndarray | None = None,
    ) -> None:
        """Group the pieces of the layouts by blocks.

        Args:
            scenery: Shapes of the worlds.
            layouts: The city layouts.
            colour: (N + R, 3) colours of the drones and the pieces of bodies, from 0 to 255, which
                are not shaded; None for the shaded colours of their labels.
            is_load: (N,) bool, drones that are loads; see `make_faces`.
        """
        self._own_colour, self._is_load = colour, is_load
        grid = scenery.city_grid
        counts = [len(solids.bounds) for solids in layouts]
        self._blocks = make_view_blocks(grid.low, grid.high, counts)
        self._num_worlds = scenery.place.shape[0]
        self._piece_colours = _colours_of(layouts)
        self._looks: dict[int, Look] = {}
        self._set_faces(scenery)
        # Each thread draws in memory of its own
        self._local = threading.local()

    def _set_faces(self, scenery: Scenery) -> None:
        """Assign ids to the faces of the shapes, and choose their colours."""
        self._table = scenery.table
        self._faces = make_faces(scenery, self._is_load)
        self._paint_worlds()

    def set_look(self, world: int, look: Look) -> None:
        """Set the colours of pictures of a world; see `Engine.set_look`."""
        # One palette serves all worlds until one differs
        if look == Look() and not self._looks:
            return
        is_new = not self._looks
        self._looks[world] = look
        if is_new:
            self._paint_worlds()
        else:
            self._paint_world(world)

    def _paint_worlds(self) -> None:
        """Choose the colours of all faces in all worlds."""
        count = self._num_worlds if self._looks else 1
        self._paint = Paint(
            np.empty((count, len(self._faces.labels), 3), dtype=np.uint8), np.empty((count, 4))
        )
        for world in range(count):
            self._paint_world(world)

    def _paint_world(self, world: int) -> None:
        """Choose the colours of all faces in a world."""
        look = self._looks.get(world, Look())
        labels, shape = self._faces.labels, self._faces.shape[2:]
        base = np.array([COLOURS[label] for label in range(len(COLOURS))])
        shade = (HUE_STEP * (shape % HUE_STEPS - HUE_STEPS // 2))[:, None]
        sun, windows = np.array(SUN), np.array(WINDOWS)
        if look.strength:
            # Everything is drawn from the seed, in this order
            rng = np.random.default_rng(look.seed)
            base += look.strength * (rng.uniform(0, 255, base.shape) - base)
            azimuth, height = rng.uniform((0.0, 0.25), (2 * np.pi, 1.0))
            level = math.sqrt(1 - height * height)
            drawn = (level * cos(float(azimuth)), level * sin(float(azimuth)), float(height))
            sun += look.strength * (drawn - sun)
            sun /= math.sqrt(sun @ sun)
            windows = rng.uniform((2.0, 2.5, 0.3, -80.0), (6.0, 4.5, 0.8, 80.0))
            windows[3] *= look.strength
            tint = rng.uniform(-TINT, TINT, (len(self._table.kind), 3))
            shade = shade + look.strength * tint[shape]
        # Half-Lambert shading, so that faces in the shade differ, too
        light = AMBIENT + (1 - AMBIENT) * (self._faces.normal * sun).sum(axis=1)
        light[0] = 1.0
        colour = base[labels]
        if self._piece_colours is not None:
            # The pieces of layouts come last but for the ground
            first = len(self._table.kind) - 1 - len(self._piece_colours)
            is_piece = (shape >= first) & (shape < len(self._table.kind) - 1)
            own = self._piece_colours[shape[is_piece] - first]
            colour[2:][is_piece] += (1 - look.strength) * (own - COLOURS[BUILDING])
            windows[3] = 0.0
        is_varied = np.isin(labels[2:], (BUILDING, OBSTACLE))
        colour[2:] += np.where(is_varied[:, None], shade, 0.0)
        colour *= light[:, None]
        if self._own_colour is not None:
            of_shape = self._own_colour[shape[shape < len(self._own_colour)]]
            colour[2 : 2 + len(of_shape)] = of_shape
        colour = np.clip(colour, 0, 255)
        colour[GROUND_FACE] = np.maximum(colour[GROUND_FACE], CHECKER_CONTRAST)
        self._paint.colour[world] = colour.astype(np.uint8)
        self._paint.windows[world] = windows

    def draw(
        self,
        scenery: Scenery,
        cameras: Cameras,
        images: Images,
        swarm: Poses,
        mask: np.ndarray,
        earlier: Earlier | None,
    ) -> None:
        """Draw pictures; see `Engine.pictures`."""
        if earlier is None:
            now = (swarm.position, swarm.quaternion), (scenery.place, scenery.quaternion)
            earlier = Earlier(cameras.eye, cameras.quaternion, *now)
        if scenery.table is not self._table:
            self._set_faces(scenery)
        rays, canvas = self._memory(images)
        draw_pictures(
            cameras,
            rays,
            scenery,
            self._blocks,
            self._faces,
            self._paint,
            swarm,
            mask,
            canvas,
            images,
            earlier,
        )

    def _memory(self, images: Images) -> tuple[PixelRays, Canvas]:
        """Return memory of the present thread for pictures of a size."""
        height, width = images.depth.shape[1:]
        has_faces = any(len(one) for one in images if one is not images.depth)
        key = (width, height, has_faces)
        if getattr(self._local, "key", None) != key or self._local.table is not self._table:
            rays = make_pixel_rays(width, height)
            canvas = make_canvas(rays, self._table, self._faces, self._blocks, has_faces)
            self._local.key, self._local.table = key, self._table
            self._local.memory = rays, canvas
        memory: tuple[PixelRays, Canvas] = self._local.memory
        return memory
