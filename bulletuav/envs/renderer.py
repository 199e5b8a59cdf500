"""Pictures and live view of a world: a camera that keeps all drones and goals in sight."""

import numpy as np
from PIL import Image, ImageDraw

from bulletuav.engine.engine import Engine
from bulletuav.envs.pacer import Pacer
from bulletuav.geometry.view import AIR, LAND, SKY, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import Swarm

Colour = tuple[int, int, int]

GRID: Colour = (176, 182, 174)
"""Colour of grid lines on the ground"""
DRONE: Colour = (216, 67, 21)
"""Colour of the rings around drones"""
GOAL: Colour = (46, 125, 50)
"""Colour of the crosses on goals"""
SHADOW: Colour = (120, 124, 120)
"""Colour of the lines from drones down to the ground"""
DIRECTION = np.array([-0.55, -0.75, 0.5])
"""Where the camera stands as seen from what it looks at, in distances to it"""
GRID_LINES = 25
"""Grid lines to each side of the middle"""
FIELD_OF_VIEW = 60.0
"""Vertical field of view, degrees"""
RING_RADIUS, CROSS_RADIUS = 7, 5
"""Size of the marks of drones and goals, pixels"""


class Renderer:
    """A camera that looks at one world from the south-west and above."""

    def __init__(self, engine: Engine, size: tuple[int, int]) -> None:
        """Make the camera.

        Args:
            engine: Engine in which the worlds are.
            size: Width and height of pictures, pixels.
        """
        self._engine = engine
        self._size = size
        self._pacer: Pacer | None = None

    def picture(
        self,
        world: int,
        swarm: Swarm,
        goal: np.ndarray,
        alive: np.ndarray,
        collision: bool = False,
    ) -> np.ndarray:
        """Take a picture of the living drones and of the goals.

        Rings mark drones and crosses goals, as a drone is smaller than a pixel from afar. Thin
        lines drop from drones to the ground.

        Args:
            world: Index of the world.
            swarm: State of all worlds.
            goal: (N, 3) goals of this world, m.
            alive: (W, N) bool, drones that are to be seen.
            collision: Whether drones are drawn by their collision shapes.

        Returns:
            (height, width, 3) uint8, red, green, blue.
        """
        flying = swarm.position[world][alive[world]]
        # Point the camera at all of them.
        shown = np.concatenate([flying, goal])
        target, distance = self._framing(shown)
        width, height = self._size
        view = view_matrix(target + distance * DIRECTION, target)
        projection = projection_matrix(width / height, FIELD_OF_VIEW)
        matrix = projection @ view
        # Colour the sky, draw on the ground, then draw marks above everything.
        pixels, _, labels = self._engine.picture(
            world, view, projection, self._size, (swarm, alive) if collision else None
        )
        pixels[labels == SKY] = AIR
        ground = labels == LAND
        grid = self._grid(target, distance)
        self._draw_ground(pixels, ground, grid, flying, matrix)
        image = Image.fromarray(pixels)
        self._draw_marks(ImageDraw.Draw(image), flying, goal, matrix)
        return np.asarray(image)

    def _draw_ground(
        self,
        pixels: np.ndarray,
        ground: np.ndarray,
        grid: np.ndarray,
        flying: np.ndarray,
        matrix: np.ndarray,
    ) -> None:
        """Draw the grid, and lines below drones, into the pixels that show bare ground."""
        lines = Image.fromarray(pixels.copy())
        pen = ImageDraw.Draw(lines)
        self._draw_lines(pen, grid, matrix, GRID)
        feet = flying * [1, 1, 0]
        drops = np.stack([flying, feet], axis=1)
        self._draw_lines(pen, drops, matrix, SHADOW)
        pixels[ground] = np.asarray(lines)[ground]

    def _draw_marks(
        self,
        pen: ImageDraw.ImageDraw,
        flying: np.ndarray,
        goal: np.ndarray,
        matrix: np.ndarray,
    ) -> None:
        """Draw a cross on each goal and a ring around each drone."""
        r = CROSS_RADIUS
        for x, y in self._project(goal, matrix)[0]:
            pen.line((x - r, y - r, x + r, y + r), GOAL, 2)
            pen.line((x - r, y + r, x + r, y - r), GOAL, 2)
        r = RING_RADIUS
        for x, y in self._project(flying, matrix)[0]:
            pen.ellipse((x - r, y - r, x + r, y + r), outline=DRONE, width=2)

    def show(self, swarm: Swarm, alive: np.ndarray, period: float) -> None:
        """Keep the live view of world 0 in real time.

        The first call points it at the drones. Each waits until its time has come.

        Args:
            swarm: State of all worlds.
            alive: (W, N) bool, drones that are to be seen.
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
        """Find the middle of points (M, 3), and a distance from which all are in sight, m."""
        low = points.min(axis=0)
        high = points.max(axis=0)
        middle = (low + high) / 2
        diagonal = float(np.linalg.norm(high - low))
        return middle, 0.8 + 1.1 * diagonal

    @staticmethod
    def _grid(target: np.ndarray, distance: float) -> np.ndarray:
        """Make pieces (L, 2, 3) of grid lines on the ground, m.

        They are 1, 10, 100 ... m apart, to suit the distance.
        """
        pitch = 10.0 ** round(np.log10(distance / 2.5))
        line = (np.arange(-GRID_LINES, GRID_LINES + 1)) * pitch
        # Pieces along y from each crossing to the next, and the same along x.
        across, along = np.meshgrid(line, line[:-1], indexing="ij")
        zero = np.zeros(across.size)
        ends = [
            np.stack([across.ravel(), along.ravel() + step, zero], axis=1) for step in (0, pitch)
        ]
        northward = np.stack(ends, axis=1)
        eastward = northward[:, :, [1, 0, 2]]
        pieces = np.concatenate([northward, eastward])
        # Lines stay where they are while the camera moves.
        centre = np.round(target / pitch) * pitch * [1, 1, 0]
        grid: np.ndarray = pieces + centre
        return grid

    def _draw_lines(
        self,
        pen: ImageDraw.ImageDraw,
        lines: np.ndarray,
        matrix: np.ndarray,
        colour: Colour,
    ) -> None:
        """Draw those of the lines (L, 2, 3) that lie before the camera."""
        ends, is_before = self._project(lines.reshape(-1, 3), matrix)
        ends = ends.reshape(-1, 4)
        both_before = np.all(is_before.reshape(-1, 2), axis=1)
        # Far outside of the picture coordinates get too large to draw.
        limit = 4 * max(self._size)
        near = np.all(np.abs(ends) < limit, axis=1)
        for line in ends[both_before & near]:
            pen.line(tuple(line), colour)

    def _project(self, points: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (M, 3) into the picture.

        Returns:
            (M, 2) x and y, pixels; and (M,) bool, points that lie before the camera.
        """
        ones = np.ones((len(points), 1))
        clip = np.concatenate([points, ones], axis=1) @ matrix.T
        # Points in the plane of the lens have no place in the picture.
        distance = clip[:, 3]
        depth = np.where(np.abs(distance) > 1e-6, distance, 1e-6)
        width, height = self._size
        x = (1 + clip[:, 0] / depth) / 2 * width
        y = (1 - clip[:, 1] / depth) / 2 * height
        return np.stack([x, y], axis=1), distance > 0.1
