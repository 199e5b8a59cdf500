"""Ground with hills: heights on a grid, and the convex columns that fill it."""

from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.solids import box_corners

BASE = -1.0
"""Height of the underside of the columns, m: penetrating drones are pushed up, not down"""
OVERLAP = 1e-6
"""Distance by which columns extend beyond their cells, so that no ray passes between them, m"""


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Ground around the origin whose height is given at the corners of rectangular cells.

    The column of a cell is the convex hull of its corners: the upper two of the four triangles
    between them are the surface, so that each cell is flat or has a ridge along a diagonal.

    Attributes:
        corners: Heights (K + 1, L + 1) at the corners of K cells along x and L along y, m.
        sides: (2,) lengths of the ground along x and y, m.
    """

    corners: np.ndarray
    sides: np.ndarray

    @property
    def cell(self) -> np.ndarray:
        """(2,) lengths of a cell along x and y, m."""
        return self.sides / (np.array(self.corners.shape) - 1)

    def height(self, plan: np.ndarray) -> np.ndarray:
        """Return the height of the surface by linear interpolation.

        Args:
            plan: (..., 2) x and y, m.

        Returns:
            (...,) m; 0 outside the ground.
        """
        place = (plan + self.sides / 2) / self.cell
        last = np.array(self.corners.shape) - 2
        index = np.clip(np.floor(place), 0, last).astype(int)
        i, j = np.moveaxis(index, -1, 0)
        u, v = np.moveaxis(place - index, -1, 0)
        # Heights of the corners: low x and low y first
        low, right = self.corners[i, j], self.corners[i + 1, j]
        left, high = self.corners[i, j + 1], self.corners[i + 1, j + 1]
        # Two triangles on either side of each diagonal
        rising = np.where(
            u >= v,
            low + u * (right - low) + v * (high - right),
            low + v * (left - low) + u * (high - left),
        )
        falling = np.where(
            u + v <= 1,
            low + u * (right - low) + v * (left - low),
            high + (1 - u) * (left - high) + (1 - v) * (right - high),
        )
        is_inside = (np.abs(plan) <= self.sides / 2).all(axis=-1)
        surface: np.ndarray = np.where(is_inside, np.maximum(rising, falling), 0.0)
        return surface

    def columns(self) -> list[np.ndarray]:
        """Return the corners (8, 3) of the column of each cell, m; cells along y come first."""
        x, y = (
            np.linspace(-side / 2, side / 2, count)
            for side, count in zip(self.sides, self.corners.shape, strict=True)
        )
        columns = []
        for i, j in np.ndindex(len(x) - 1, len(y) - 1):
            low = (x[i] - OVERLAP, y[j] - OVERLAP, BASE)
            high = (x[i + 1] + OVERLAP, y[j + 1] + OVERLAP, 0.0)
            column = box_corners(np.array([low, high]))
            # The order of `box_corners`: x changes first
            column[4:, 2] = self.corners[i : i + 2, j : j + 2].T.ravel()
            columns.append(column)
        return columns
