"""Camera pictures of many drones by the rasteriser, without Bullet."""

import threading
from collections.abc import Sequence

import numpy as np

from bulletuav.geometry.raster import (
    Cameras,
    Canvas,
    Images,
    PixelRays,
    draw_pictures,
    make_canvas,
    make_pixel_rays,
)
from bulletuav.geometry.raycast import Poses
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY, SKY_COLOUR
from bulletuav.geometry.view_blocks import face_normals, make_faces, make_view_blocks

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


class PictureMaker:
    """Draws pictures of the worlds of an engine; see `Engine.pictures`."""

    def __init__(
        self, scenery: Scenery, layouts: Sequence[Solids], colour: np.ndarray | None = None
    ) -> None:
        """Group the pieces of the layouts by blocks.

        Args:
            scenery: Shapes of the worlds.
            layouts: The city layouts.
            colour: (N + R, 3) colours of the drones and the pieces of bodies, fully lit, from 0 to
                255; None for those of their labels.
        """
        self._own_colour = colour
        grid = scenery.city_grid
        counts = [len(solids.bounds) for solids in layouts]
        self._blocks = make_view_blocks(grid.low, grid.high, counts)
        self._set_faces(scenery)
        # Each thread draws in memory of its own
        self._local = threading.local()

    def _set_faces(self, scenery: Scenery) -> None:
        """Assign ids to the faces of the shapes, and choose their colours."""
        self._table = scenery.table
        self._faces = make_faces(scenery)
        normal = face_normals(scenery.table)
        # Half-Lambert shading, so that faces in the shade differ, too
        light = AMBIENT + (1 - AMBIENT) * (normal * SUN).sum(axis=1)
        light[0] = 1.0
        colour = np.array([COLOURS[label] for label in range(len(COLOURS))])[self._faces.labels]
        shape = np.repeat(np.arange(len(scenery.table.kind)), np.diff(self._faces.first))
        shade = HUE_STEP * (shape % HUE_STEPS - HUE_STEPS // 2)
        is_varied = np.isin(self._faces.labels[2:], (BUILDING, OBSTACLE))
        colour[2:] += np.where(is_varied, shade, 0.0)[:, None]
        if self._own_colour is not None:
            of_shape = self._own_colour[shape[shape < scenery.first_piece]]
            colour[2 : 2 + len(of_shape)] = of_shape
        self._colour = np.clip(colour * light[:, None], 0, 255).astype(np.uint8)

    def draw(
        self,
        scenery: Scenery,
        cameras: Cameras,
        images: Images,
        swarm: Poses,
        mask: np.ndarray,
    ) -> None:
        """Draw pictures; see `Engine.pictures`."""
        if scenery.table is not self._table:
            self._set_faces(scenery)
        rays, canvas = self._memory(images)
        draw_pictures(
            cameras,
            rays,
            scenery,
            self._blocks,
            self._faces,
            self._colour,
            swarm,
            mask,
            canvas,
            images,
        )

    def _memory(self, images: Images) -> tuple[PixelRays, Canvas]:
        """Return memory of the present thread for pictures of a size."""
        height, width = images.depth.shape[1:]
        has_faces = bool(len(images.labels) or len(images.colours))
        key = (width, height, has_faces)
        if getattr(self._local, "key", None) != key or self._local.table is not self._table:
            rays = make_pixel_rays(width, height)
            canvas = make_canvas(rays, self._table, self._faces, self._blocks, has_faces)
            self._local.key, self._local.table = key, self._table
            self._local.memory = rays, canvas
        memory: tuple[PixelRays, Canvas] = self._local.memory
        return memory
