"""Ground with hills: heights on a grid, and the convex columns that fill it."""

from dataclasses import dataclass

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.solids import box_corners

BASE = -2.0
"""Height of the underside of the columns, m: penetrating drones are pushed up, not down"""
OVERLAP = 1e-6
"""Distance by which columns extend beyond their cells, so that no ray passes between them, m"""
RIM = 1.0
"""Maximum width of the rim of a column, below the surface of its neighbours, m"""
DROP = 0.02
"""Depth of the outer edge of a rim below the planes of the surface, m: drones that slide at 10 m/s
move half as far below this edge in a step of 1/240 s"""


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
        lengths: np.ndarray = self.sides / (np.array(self.corners.shape) - 1)
        return lengths

    @property
    def steepest(self) -> float:
        """Maximum slope of the surface, the tangent of its angle."""
        along_x = np.diff(self.corners, axis=0) / self.cell[0]
        along_y = np.diff(self.corners, axis=1) / self.cell[1]
        # Each triangle has one edge of its cell along x and one along y
        low, high = slice(None, -1), slice(1, None)
        pairs = [
            np.hypot(along_x[:, one], along_y[other])
            for one in (low, high)
            for other in (low, high)
        ]
        return float(np.max(pairs))

    def height(self, plan: np.ndarray) -> np.ndarray:
        """Return the height of the surface by linear interpolation.

        Args:
            plan: (..., 2) x and y, m.

        Returns:
            (...,) m; 0 outside the ground.
        """
        surface = np.empty(plan.shape[:-1])
        points = np.ascontiguousarray(plan, dtype=float).reshape(-1, 2)
        _write_heights(self.corners, self.sides, points, surface.reshape(-1))
        return surface

    def columns(self) -> list[np.ndarray]:
        """Return the corners (V, 3) of the column of each cell, m; cells along y come first.

        Around the surface of its cell a column has a rim, which sinks slowly below the surface of
        the neighbours: drones that slide over the surface would be stopped by vertical walls. At
        the edge of the ground there is no rim.
        """
        inner, across = self.cell * min(RIM / self.cell.min(), 0.25), self._rim_slopes()
        x, y = (
            np.linspace(-side / 2, side / 2, count)
            for side, count in zip(self.sides, self.corners.shape, strict=True)
        )
        columns = []
        for i, j in np.ndindex(len(x) - 1, len(y) - 1):
            low = np.array([x[i], y[j]]) - OVERLAP
            high = np.array([x[i + 1], y[j + 1]]) + OVERLAP
            top = box_corners(np.array([(*low, 0.0), (*high, 0.0)]))[:4]
            # The order of `box_corners`: x changes first
            top[:, 2] = self.corners[i : i + 2, j : j + 2].T.ravel()
            rim, outline = [], []
            for axis, side in np.ndindex(2, 2):
                # Corners of the edge, and the direction along it
                edge = top[(np.arange(4) >> axis & 1) == side]
                if (i, j)[axis] == side * (self.corners.shape[axis] - 2):
                    # An edge of the ground; `side` is 1 for its last cell
                    outline += list(edge)
                    continue
                along = (edge[1] - edge[0]) / (edge[1] - edge[0])[1 - axis]
                for end, sign in ((edge[0], 1), (edge[1], -1)):
                    place = end + sign * inner[1 - axis] * along
                    place[axis] += (2 * side - 1) * inner[axis]
                    place[2] += inner[axis] * across[axis, side, i, j] - DROP
                    rim.append(place)
            base = np.array(rim + outline)
            base[:, 2] = BASE
            columns.append(np.concatenate([top, np.reshape(rim, (-1, 3)), base]))
        return columns

    def _rim_slopes(self) -> np.ndarray:
        """Return the outward slopes (2, 2, K, L) of rims, by axis and side: low or high.

        They are the lower ones of the two triangles at an edge, so that columns stay convex and
        below the surface.
        """
        low, right = self.corners[:-1, :-1], self.corners[1:, :-1]
        left, high = self.corners[:-1, 1:], self.corners[1:, 1:]
        rises = low + high >= right + left
        # Slopes of the triangle at each edge of a cell, outwards
        before, after = (right - low) / self.cell[0], (high - left) / self.cell[0]
        west, east = -np.where(rises, after, before), np.where(rises, before, after)
        before, after = (left - low) / self.cell[1], (high - right) / self.cell[1]
        south, north = -np.where(rises, after, before), np.where(rises, before, after)
        slopes = np.array([(west, east), (south, north)])
        # The slope towards a neighbour is the opposite of its own outward slope
        both = slopes.copy()
        both[0, 1, :-1] = np.minimum(east[:-1], -west[1:])
        both[0, 0, 1:] = np.minimum(west[1:], -east[:-1])
        both[1, 1, :, :-1] = np.minimum(north[:, :-1], -south[:, 1:])
        both[1, 0, :, 1:] = np.minimum(south[:, 1:], -north[:, :-1])
        return both


@func
def surface_height(corners: np.ndarray, sides: np.ndarray, x: float, y: float) -> float:
    """Return the height of the surface at a point; see `Heightfield.height`.

    Args:
        corners: (K + 1, L + 1) heights at the corners of the cells, m; (0, 0) for flat ground.
        sides: (2,) lengths of the ground along x and y, m.
        x: Position east, m.
        y: Position north, m.
    """
    half_x, half_y = sides[0] / 2, sides[1] / 2
    if corners.size == 0 or not (abs(x) <= half_x and abs(y) <= half_y):
        return 0.0
    along, across = corners.shape[0] - 1, corners.shape[1] - 1
    u, v = (x + half_x) / (sides[0] / along), (y + half_y) / (sides[1] / across)
    i, j = min(int(u), along - 1), min(int(v), across - 1)
    u, v = u - i, v - j
    # Heights of the corners: low x and low y first
    low, right = corners[i, j], corners[i + 1, j]
    left, high = corners[i, j + 1], corners[i + 1, j + 1]
    # Two triangles on either side of each diagonal
    if u >= v:
        rising = low + u * (right - low) + v * (high - right)
    else:
        rising = low + v * (left - low) + u * (high - left)
    if u + v <= 1:
        falling = low + u * (right - low) + v * (left - low)
    else:
        falling = high + (1 - u) * (left - high) + (1 - v) * (right - high)
    return float(max(rising, falling))


@kernel
def _write_heights(
    corners: np.ndarray, sides: np.ndarray, points: np.ndarray, surface: np.ndarray
) -> None:
    """Write the heights (M,) of the surface at points (M, 2), m."""
    for m in range(points.shape[0]):
        surface[m] = surface_height(corners, sides, points[m, 0], points[m, 1])
