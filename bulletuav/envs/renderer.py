"""Pictures and live view of a world: a camera that keeps drones, goals and targets in view."""

from typing import TYPE_CHECKING

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.envs.marks import Colour, Lens, Marks, draw
from bulletuav.envs.pacer import Pacer
from bulletuav.geometry.view import FAR, LAND, CameraMatrices, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import Swarm

if TYPE_CHECKING:
    from PIL import Image

GRID: Colour = (176, 182, 174)
"""Colour of grid lines on the ground"""
SHADOW: Colour = (120, 124, 120)
"""Colour of the vertical lines from drones to the ground"""
DIRECTION = np.array([-0.55, -0.75, 0.5])
"""Direction from the target to the camera, in units of the distance"""
MIN_DISTANCE = 0.8
"""Minimum distance of the camera, in units of `DIRECTION`, m"""
MARGIN = 1.12
"""Factor on the smallest distance at which everything is in the picture"""
GRID_LINES = 25
"""Grid lines to each side of the middle"""
FIELD_OF_VIEW = 60.0
"""Vertical field of view, degrees"""


class Renderer:
    """A camera that looks at one world from the south-west and above."""

    def __init__(self, engine: Engine, size: tuple[int, int]) -> None:
        """Create the camera.

        Args:
            engine: Engine of the worlds.
            size: Width and height of pictures, pixels.
        """
        self._engine = engine
        self._size = size
        self._pacer: Pacer | None = None

    def picture(
        self,
        world: int,
        swarm: Swarm,
        marks: Marks,
        alive: np.ndarray,
        collision: bool = False,
        marked: bool = True,
    ) -> np.ndarray:
        """Render the active drones, with marks of objects that are too small to be seen.

        Thin lines drop from drones to the ground.

        Args:
            world: Index of the world.
            swarm: State of all worlds.
            marks: Marks of the world.
            alive: (W, N) bool, drones that are shown.
            collision: Whether drones are drawn by their collision shapes.
            marked: Whether marks are drawn.

        Returns:
            (height, width, 3) uint8, red, green, blue.
        """
        from PIL import ImageDraw  # slow to import

        # Without anything to show, the camera looks at the last positions of drones
        shown = np.concatenate([marks.drone, marks.goal, marks.target])
        points = shown if len(shown) else swarm.position[world]
        target, distance = fit_camera(points, DIRECTION, self._size)
        away = distance * DIRECTION
        image, lens, _ = self.shot(world, target, away, marks.drone, (swarm, alive), collision)
        if marked:
            draw(marks, lens, ImageDraw.Draw(image))
        return np.asarray(image)

    def shot(
        self,
        world: int,
        target: np.ndarray,
        away: np.ndarray,
        flying: np.ndarray,
        drones: tuple[Swarm, np.ndarray] | None = None,
        collision: bool = False,
    ) -> tuple["Image.Image", Lens, np.ndarray]:
        """Render a picture without marks: bodies, sky, a grid on the ground, lines below drones.

        Args:
            world: Index of the world.
            target: (3,) point that the camera looks at, m.
            away: (3,) from the target to the camera, m.
            flying: (M, 3) starts of the lines to the ground, m.
            drones: Drones that are drawn, or None; see `Engine.picture`.
            collision: Whether drones are drawn by their collision shapes.

        Returns:
            The picture; the projection from the world to the picture; and (height, width) depth
            along the view axis, m.
        """
        from PIL import Image

        width, height = self._size
        distance = float(np.linalg.norm(away)) / float(np.linalg.norm(DIRECTION))
        view = view_matrix(target + away, target)
        # Scenes of kilometres need a far plane beyond that of drones' cameras
        far = max(FAR, 2 * distance)
        projection = projection_matrix(width / height, FIELD_OF_VIEW)
        lens = Lens(projection @ view, self._size)
        shot = CameraMatrices(view, projection, self._size)
        pixels, depth, labels = self._engine.picture(world, shot, drones, collision, far)
        grid = self._grid(target, max(distance, float(target[2])))
        self._draw_ground(pixels, labels == LAND, grid, flying, lens)
        return Image.fromarray(pixels), lens, depth

    def _draw_ground(
        self,
        pixels: np.ndarray,
        ground: np.ndarray,
        grid: np.ndarray,
        flying: np.ndarray,
        lens: Lens,
    ) -> None:
        """Draw the grid, and lines below drones, into the pixels of bare ground."""
        from PIL import Image, ImageDraw

        lines = Image.fromarray(pixels.copy())
        pen = ImageDraw.Draw(lines)
        lens.draw_lines(pen, grid, GRID)
        feet = flying * [1, 1, 0]
        drops = np.stack([flying, feet], axis=1)
        lens.draw_lines(pen, drops, SHADOW)
        pixels[ground] = np.asarray(lines)[ground]

    def show(self, swarm: Swarm, alive: np.ndarray, period: float) -> None:
        """Pace the live view of world 0 in real time.

        The first call points the camera at the drones. Each call waits for its deadline.

        Args:
            swarm: State of all worlds.
            alive: (W, N) bool, drones that are shown.
            period: Time between calls, s.
        """
        if self._pacer is None:
            flying = swarm.position[0][alive[0]]
            if len(flying):
                self._engine.look_at(0, *self._framing(flying))
            self._pacer = Pacer(period)
        self._pacer.wait()

    @staticmethod
    def _framing(points: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the middle of points (M, 3), and a distance from which all are in view, m."""
        low = points.min(axis=0)
        high = points.max(axis=0)
        middle = (low + high) / 2
        diagonal = float(np.linalg.norm(high - low))
        return middle, MIN_DISTANCE + 1.1 * diagonal

    @staticmethod
    def _grid(target: np.ndarray, distance: float) -> np.ndarray:
        """Return pieces (L, 2, 3) of grid lines on the ground, m.

        Their spacing is 1, 10, 100 ... m, depending on the distance.
        """
        pitch = 10.0 ** round(np.log10(distance / 2.5))
        line = (np.arange(-GRID_LINES, GRID_LINES + 1)) * pitch
        # Pieces along y between crossings, and the same along x
        across, along = np.meshgrid(line, line[:-1], indexing="ij")
        zero = np.zeros(across.size)
        ends = [
            np.stack([across.ravel(), along.ravel() + step, zero], axis=1) for step in (0, pitch)
        ]
        northward = np.stack(ends, axis=1)
        eastward = northward[:, :, [1, 0, 2]]
        pieces = np.concatenate([northward, eastward])
        # Lines do not move with the camera
        centre = np.round(target / pitch) * pitch * [1, 1, 0]
        grid: np.ndarray = pieces + centre
        return grid


def fit_camera(
    points: np.ndarray, direction: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, float]:
    """Return the middle of points (M, 3), and the distance at which all just fit into a picture.

    A point is in the picture if its offset from the view axis is at most its depth times the
    tangent of half the angle of view.

    Args:
        points: (M, 3) m.
        direction: (3,) from the middle to the camera.
        size: Width and height of the picture, pixels.

    Returns:
        The middle, and the distance of the camera in units of `direction`.
    """
    aspect = size[0] / size[1]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    # Axes of the camera; rows right, up, back
    right, up, back = view_matrix(direction, np.zeros(3))[:3, :3] @ (points - middle).T
    tangent = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    needed = np.maximum(np.abs(right) / aspect, np.abs(up)) / tangent + back
    return middle, MIN_DISTANCE + MARGIN * float(needed.max()) / float(np.linalg.norm(direction))


def pixel_size(distance: float, height: int) -> float:
    """Return the size of a pixel at a distance, m, in a picture `height` pixels high."""
    return 2 * distance * float(np.tan(np.radians(FIELD_OF_VIEW) / 2)) / height
