"""Pictures and the live view of a world: a camera that keeps all drones and goals in sight, with marks on them."""

import time

import numpy as np
from PIL import Image, ImageDraw

from bulletuav.engine.engine import Engine
from bulletuav.geometry.view import AIR, LAND, SKY, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import Swarm

GRID = (176, 182, 174)
DRONE, GOAL, SHADOW = (216, 67, 21), (46, 125, 50), (120, 124, 120)
DIRECTION = np.array([-0.55, -0.75, 0.5])
GRID_LINES = 25
FIELD_OF_VIEW = 60.0  # degrees, vertical


class Renderer:
    """Looks at one world from the south-west and above."""

    def __init__(self, engine: Engine, size: tuple[int, int]):
        self._engine, self._size = engine, size
        self._due: float | None = None

    def picture(self, world: int, swarm: Swarm, goal: np.ndarray, alive: np.ndarray) -> np.ndarray:
        """(height, width, 3) uint8 of living drones and goals (N, 3).

        Rings mark drones, crosses goals (from afar a drone is smaller than a pixel), thin lines drop to the ground below.
        """
        flying = swarm.position[world][alive[world]]
        target, distance = self._framing(np.concatenate([flying, goal]))
        view = view_matrix(target + distance * DIRECTION, target)
        projection = projection_matrix(self._size[0] / self._size[1], FIELD_OF_VIEW)
        pixels, _, labels = self._engine.picture(world, view, projection, self._size)
        matrix, ground = projection @ view, labels == LAND
        pixels[labels == SKY] = AIR
        lines = Image.fromarray(pixels.copy())
        self._draw_lines(ImageDraw.Draw(lines), self._grid(target, distance), matrix, GRID)
        feet = flying * [1, 1, 0]
        self._draw_lines(ImageDraw.Draw(lines), np.stack([flying, feet], axis=1), matrix, SHADOW)
        pixels[ground] = np.asarray(lines)[ground]  # behind whatever stands on the ground
        image = Image.fromarray(pixels)
        pen = ImageDraw.Draw(image)
        for x, y in self._project(goal, matrix)[0]:
            pen.line((x - 5, y - 5, x + 5, y + 5), GOAL, 2)
            pen.line((x - 5, y + 5, x + 5, y - 5), GOAL, 2)
        for x, y in self._project(flying, matrix)[0]:
            pen.ellipse((x - 7, y - 7, x + 7, y + 7), outline=DRONE, width=2)
        return np.asarray(image)

    def show(self, swarm: Swarm, alive: np.ndarray, period: float) -> None:
        """Wait until `period` seconds have passed since the last call; the first call points the live view at the drones."""
        flying = swarm.position[0][alive[0]]
        if self._due is None and len(flying):
            target, distance = self._framing(flying)
            self._engine.look_at(0, target, distance)
        now = time.monotonic()
        self._due = max(self._due or now, now - period) + period
        time.sleep(max(0.0, self._due - now))

    @staticmethod
    def _framing(points: np.ndarray) -> tuple[np.ndarray, float]:
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, 0.8 + 1.1 * float(np.linalg.norm(high - low))

    @staticmethod
    def _grid(target: np.ndarray, distance: float) -> np.ndarray:
        """(L, 2, 3) pieces of grid lines on the ground, 1, 10, 100 ... m apart to suit the distance."""
        pitch = 10.0 ** round(np.log10(distance / 2.5))
        line = (np.arange(-GRID_LINES, GRID_LINES + 1)) * pitch
        across, along = np.meshgrid(line, line[:-1], indexing="ij")
        zero = np.zeros(across.size)
        one = [
            np.stack([across.ravel(), along.ravel() + step, zero], axis=1) for step in (0, pitch)
        ]
        other = [end[:, [1, 0, 2]] for end in one]
        centre = np.round(target / pitch) * pitch * [1, 1, 0]
        return np.concatenate([np.stack(one, axis=1), np.stack(other, axis=1)]) + centre

    def _draw_lines(
        self, pen: ImageDraw.ImageDraw, lines: np.ndarray, matrix: np.ndarray, colour
    ) -> None:
        """Lines (L, 2, 3) that lie before the camera."""
        place, before = self._project(lines.reshape(-1, 3), matrix)
        place, before = place.reshape(-1, 4), np.all(before.reshape(-1, 2), axis=1)
        near = np.all(np.abs(place) < 4 * max(self._size), axis=1)
        for line in place[before & near]:
            pen.line(tuple(line), colour)

    def _project(self, points: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(M, 2) x and y in pixels, and (M,) whether the point lies before the camera."""
        clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix.T
        depth = np.where(np.abs(clip[:, 3]) > 1e-6, clip[:, 3], 1e-6)
        width, height = self._size
        return np.stack(
            [(1 + clip[:, 0] / depth) / 2 * width, (1 - clip[:, 1] / depth) / 2 * height], axis=1
        ), clip[:, 3] > 0.1
