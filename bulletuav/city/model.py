"""A city: solid buildings on flat ground, streets, and what is asked of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bulletuav.city.import_report import ImportReport
from bulletuav.city.streets import Streets
from bulletuav.errors import finite, numbers_of, shown
from bulletuav.geometry.solids import Solids, box_corners

GROUP = 256
"""Points that are neighbours are asked together, as few pieces come into question"""
STRIP = 50.0
"""Width of the strips along y in which neighbours are looked for, m"""
UPRIGHT = 1e-9
"""Facets whose normal rises less than this are walls"""
HEADROOM = 2.0
"""Height of an underside, m, from which on the ground below is not built up"""


@dataclass(frozen=True, eq=False)
class City:
    """Buildings of convex pieces on the flat ground z = 0, about the origin.

    x is east, y north, z up, in metres.

    Attributes:
        name: Of its kind or file.
        side: Length of the ground along x, m.
        solids: The pieces.
        building: (P,) int, the building that each piece belongs to.
        streets: Where one walks.
        depth: Length of the ground along y, m; None for a square.
        report: What its importer did; None for a city that is not from a file.
    """

    name: str
    side: float
    solids: Solids
    building: np.ndarray
    streets: Streets
    depth: float | None = None
    report: ImportReport | None = None

    @cached_property
    def sides(self) -> np.ndarray:
        """Lengths (2,) of the ground along x and along y, m."""
        return np.array([self.side, self.side if self.depth is None else self.depth])

    @cached_property
    def heights(self) -> np.ndarray:
        """Height (B,) of each building's highest point, m."""
        heights = np.zeros(self.building.max(initial=-1) + 1)
        tops = self.solids.bounds[:, 1, 2]
        np.maximum.at(heights, self.building, tops)
        return heights

    @cached_property
    def footprints(self) -> list[np.ndarray]:
        """Corners (V, 2) of the outline of each piece seen from above, turning left, m."""
        of_boxes = [box_corners(box)[[0, 1, 3, 2], :2] for box in self.solids.boxes]
        of_hulls = [_outline(hull[:, :2]) for hull in self.solids.hulls]
        return of_boxes + of_hulls

    @cached_property
    def coverage(self) -> float:
        """Built-up share of the ground.

        Pieces that begin 2 m up or higher do not count; others above each other count each.
        """
        start, way = (ends[self.solids.bounds[:, 0, 2] < HEADROOM] for ends in self._walls)
        # Shoelace formula: twice the area of each footprint
        forward = start[..., 0] * way[..., 1]
        backward = start[..., 1] * way[..., 0]
        double = forward - backward
        return float(double.sum() / 2 / self.sides.prod())

    def outdoors(self, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Tell which points are farther from all footprints than a margin.

        The ground below parts in the air is not outdoors.

        Args:
            points: (..., 2 or 3) in m; their z does not matter.
            margin: m.

        Returns:
            (...,) bool.

        Raises:
            ValueError: The points are not finite numbers of that shape.
        """
        plan = _plan(points)
        margin = finite("margin", margin)
        free = np.ones(plan[..., 0].size, dtype=bool)
        point, _, _ = self._near(plan.reshape(-1, 2), margin)
        free[point] = False
        return free.reshape(plan.shape[:-1])

    def clearance(self, points: np.ndarray, most: float) -> np.ndarray:
        """Return the way from points to the nearest footprint, seen from above.

        Args:
            points: (..., 2 or 3) in m; their z does not matter.
            most: Ways are looked for up to this, m.

        Returns:
            (...,) in m: 0 over a footprint, `most` at most.

        Raises:
            ValueError: The points are not finite numbers of that shape.
        """
        plan = _plan(points)
        most = finite("most", most)
        gap = np.full(plan[..., 0].size, most)
        point, _, distance = self._near(plan.reshape(-1, 2), most)
        np.minimum.at(gap, point, distance)
        return gap.reshape(plan.shape[:-1])

    def roof(self, points: np.ndarray) -> np.ndarray:
        """Return the height of the highest roof over or under points.

        Args:
            points: (..., 2 or 3) in m; their z does not matter.

        Returns:
            (...,) in m; 0 outdoors.

        Raises:
            ValueError: The points are not finite numbers of that shape.
        """
        plan = _plan(points)
        flat = plan.reshape(-1, 2)
        top = np.zeros(len(flat))
        point, piece, _ = self._near(flat, 0.0)
        # A convex piece ends at the lowest of the planes on it
        facets = self._facets[piece]
        rise = (facets[..., :2] * flat[point, None]).sum(axis=-1)
        height = rise + facets[..., 2]
        np.maximum.at(top, point, height.min(axis=1))
        return top.reshape(plan.shape[:-1])

    @cached_property
    def _walls(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts (P, V, 2) of the sides of each footprint, and ways to their ends.

        Short lists end in no way.
        """
        start = _padded(self.footprints, 2)
        return start, np.roll(start, -1, axis=1) - start

    @cached_property
    def _facets(self) -> np.ndarray:
        """Planes z = a x + b y + c on each piece, (P, F, 3); short lists repeat the last."""
        tops = self.solids.boxes[:, 1, 2]
        of_boxes = [np.array([[0.0, 0.0, top]]) for top in tops]
        of_hulls = [_top(hull) for hull in self.solids.hulls]
        return _padded(of_boxes + of_hulls, 3)

    def _near(self, plan: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find the pairs of points (K, 2) and footprints within `reach` m.

        Returns the indices of both, and their distance, m, 0 inside.
        """
        # Strip by strip from west to east, in each from south to north
        order = np.lexsort([plan[:, 1], np.floor(plan[:, 0] / STRIP)])
        groups = np.split(order, range(GROUP, len(order), GROUP))
        west, south = self.solids.bounds[:, 0, :2].T - reach
        east, north = self.solids.bounds[:, 1, :2].T + reach
        sides = np.stack([west, east, south, north])
        found = [self._near_group(plan, group, reach, sides) for group in groups]
        point, piece, distance = zip(*found, strict=True)
        return np.concatenate(point), np.concatenate(piece), np.concatenate(distance)

    def _near_group(
        self, plan: np.ndarray, group: np.ndarray, reach: float, sides: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Do as `_near`, of the points with the indices `group`.

        `sides` (4, P) are those of rectangles about the footprints: west, east, south, north.
        """
        x, y = plan[group].T
        west, east, south, north = sides

        # Pieces near the rectangle that the group covers
        beside = (west <= x.max(initial=-np.inf)) & (east >= x.min(initial=np.inf))
        beside &= (south <= y.max(initial=-np.inf)) & (north >= y.min(initial=np.inf))
        close = np.flatnonzero(beside)
        west, east, south, north = sides[:, close]

        # Pairs of points and rectangles that hold them
        holds = (x[:, None] >= west) & (x[:, None] <= east)
        holds &= (y[:, None] >= south) & (y[:, None] <= north)
        one, other = np.nonzero(holds)
        point = group[one]
        piece = close[other]

        # Exact distances
        start, way = self._walls
        distance = _distance(plan[point, None], start[piece], way[piece])
        near = distance <= reach
        return point[near], piece[near], distance[near]


def _distance(point: np.ndarray, start: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the distances (M,) from points (M, 1, 2) to convex polygons, 0 inside.

    Their sides begin at `start` and go `way`, both (M, V, 2).
    """
    offset = point - start
    # Inside is to the left of all sides
    left = way[..., 0] * offset[..., 1]
    right = way[..., 1] * offset[..., 0]
    inside = (left >= right).all(axis=1)
    # Nearest point of each side
    square = np.maximum((way**2).sum(axis=-1), np.finfo(float).tiny)
    along = (offset * way).sum(axis=-1)
    share = np.clip(along / square, 0, 1)
    away = offset - share[..., None] * way
    gap = np.linalg.norm(away, axis=-1).min(axis=1)
    return np.where(inside, 0.0, gap)


def _padded(rows: Sequence[np.ndarray], columns: int) -> np.ndarray:
    """Stack arrays (1 to K, C) to (P, K, C); short ones repeat their last entry."""
    longest = max(map(len, rows), default=1)
    index = [np.minimum(np.arange(longest), len(row) - 1) for row in rows]
    stacked = np.array([row[which] for row, which in zip(rows, index, strict=True)])
    return stacked.reshape(-1, longest, columns)


def _plan(points: np.ndarray) -> np.ndarray:
    """Return x and y (..., 2) of points (..., 2 or 3), or raise ValueError for what is none."""
    points = numbers_of("points are", points)
    if not points.ndim or points.shape[-1] not in (2, 3) or not np.isfinite(points).all():
        raise ValueError(
            f"points are {shown(points)}: finite (x, y) or (x, y, z), one or several, are needed"
        )
    return points[..., :2]


def _outline(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of points (K, 2), turning left."""
    from scipy.spatial import ConvexHull  # which takes long to import, and boxes do without

    corners: np.ndarray = points[ConvexHull(points).vertices]
    return corners


def _top(hull: np.ndarray) -> np.ndarray:
    """Return a, b, c (F, 3) of the planes z = a x + b y + c on top of the hull of points (V, 3)."""
    from scipy.spatial import ConvexHull

    # Outside is n . p + d > 0
    planes = ConvexHull(hull).equations
    up = planes[planes[:, 2] > UPRIGHT]
    rows: np.ndarray = -up[:, [0, 1, 3]] / up[:, 2:3]
    return rows
