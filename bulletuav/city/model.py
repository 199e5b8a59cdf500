"""City model: buildings or trees, ground, streets, and spatial queries."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bulletuav.city.heightfield import Heightfield
from bulletuav.city.import_report import ImportReport
from bulletuav.city.streets import Streets
from bulletuav.errors import finite, numbers_of, shown
from bulletuav.geometry.solids import Solids, box_corners

GROUP = 256
"""Number of neighbouring points that are queried together, to share candidate pieces"""
STRIP = 50.0
"""Width of the strips along y that group neighbouring points, m"""
UPRIGHT = 1e-9
"""Facets with a smaller z component of the unit normal are walls"""
HEADROOM = 2.0
"""Minimum height of an underside above which the ground does not count as built up, m"""
GROUND = -1
"""Index of the building of pieces that are hills"""


@dataclass(frozen=True, eq=False)
class City:
    """Buildings of convex pieces on flat ground, or trees on hills, around the origin.

    x is east, y north, z up, in metres. Flat ground is at z = 0. A tree is a building of two
    pieces.

    Attributes:
        name: Name of the kind or file.
        side: Length of the ground along x, m.
        solids: The pieces.
        building: (P,) int, index of the building of each piece; `GROUND` for hills.
        streets: Street graph.
        depth: Length of the ground along y, m; None for a square.
        report: Import report; None for a city that was not imported.
        ground: Hills; None for flat ground.
        is_terrain: Whether the buildings are trees.
    """

    name: str
    side: float
    solids: Solids
    building: np.ndarray
    streets: Streets
    depth: float | None = None
    report: ImportReport | None = None
    ground: Heightfield | None = None
    is_terrain: bool = False

    @cached_property
    def sides(self) -> np.ndarray:
        """(2,) lengths of the ground along x and y, m."""
        return np.array([self.side, self.side if self.depth is None else self.depth])

    @cached_property
    def heights(self) -> np.ndarray:
        """(B,) height of each building's highest point, m."""
        owner = self.building[self.building != GROUND]
        heights = np.zeros(owner.max(initial=-1) + 1)
        tops = self.raised.bounds[:, 1, 2]
        np.maximum.at(heights, owner, tops)
        return heights

    @cached_property
    def raised(self) -> Solids:
        """The pieces that are not hills, in the same order."""
        if self.ground is None:
            return self.solids
        first = len(self.solids.boxes)
        owners = self.building.tolist()
        hulls = zip(self.solids.hulls, owners[first:], strict=True)
        return Solids(self.solids.boxes, tuple(hull for hull, owner in hulls if owner != GROUND))

    @cached_property
    def footprints(self) -> list[np.ndarray]:
        """(V, 2) corners of the footprint of each piece except hills, counter-clockwise, m."""
        of_boxes = [box_corners(box)[[0, 1, 3, 2], :2] for box in self.raised.boxes]
        of_hulls = [_outline(hull[:, :2]) for hull in self.raised.hulls]
        return of_boxes + of_hulls

    @cached_property
    def coverage(self) -> float:
        """Built-up fraction of the ground.

        Pieces that begin at least 2 m above the ground do not count; the areas of other overlapping
        pieces are added.
        """
        start, edge = (ends[self.headroom < HEADROOM] for ends in self._walls)
        # Shoelace formula: twice the area of each footprint
        forward = start[..., 0] * edge[..., 1]
        backward = start[..., 1] * edge[..., 0]
        double = forward - backward
        return float(double.sum() / 2 / self.sides.prod())

    @cached_property
    def headroom(self) -> np.ndarray:
        """(P,) height of the underside of each piece except hills above the ground, m."""
        low, high = self.raised.bounds.swapaxes(0, 1)
        below: np.ndarray = low[:, 2] - self.surface((low + high) / 2)
        return below

    def surface(self, points: np.ndarray) -> np.ndarray:
        """Return the height of the ground above or below points; 0 in a city and on flat ground.

        Args:
            points: (..., 2 or 3) points, m; z is ignored.

        Returns:
            (...,) m.

        Raises:
            ValueError: If the points are not finite numbers of that shape.
        """
        plan = _plan(points)
        return np.zeros(plan.shape[:-1]) if self.ground is None else self.ground.height(plan)

    def outdoors(
        self, points: np.ndarray, margin: float = 0.0, headroom: float = np.inf
    ) -> np.ndarray:
        """Return which points are farther from all footprints than a margin.

        The ground below elevated parts, such as crowns of trees, is not outdoors by default. Hills
        have no footprints.

        Args:
            points: (..., 2 or 3) points, m; z is ignored.
            margin: Margin, m.
            headroom: Pieces whose underside is at least this high above the ground do not count, m.

        Returns:
            (...,) bool.

        Raises:
            ValueError: If the points are not finite numbers of that shape.
        """
        plan = _plan(points)
        margin = finite("margin", margin)
        free = np.ones(plan[..., 0].size, dtype=bool)
        point, piece, _ = self._near(plan.reshape(-1, 2), margin)
        if headroom < np.inf:
            point = point[self.headroom[piece] < headroom]
        free[point] = False
        return free.reshape(plan.shape[:-1])

    def clearance(self, points: np.ndarray, max_distance: float) -> np.ndarray:
        """Return the horizontal distances from points to the nearest footprint.

        Args:
            points: (..., 2 or 3) points, m; z is ignored.
            max_distance: Maximum distance, m.

        Returns:
            (...,) distances, m: 0 above a footprint, at most `max_distance`.

        Raises:
            ValueError: If the points are not finite numbers of that shape.
        """
        plan = _plan(points)
        max_distance = finite("max_distance", max_distance)
        nearest = np.full(plan[..., 0].size, max_distance)
        point, _, distance = self._near(plan.reshape(-1, 2), max_distance)
        np.minimum.at(nearest, point, distance)
        return nearest.reshape(plan.shape[:-1])

    def roof(self, points: np.ndarray) -> np.ndarray:
        """Return the height of the highest roof, tree or ground above or below points.

        Args:
            points: (..., 2 or 3) points, m; z is ignored.

        Returns:
            (...,) heights, m; that of the ground outdoors.

        Raises:
            ValueError: If the points are not finite numbers of that shape.
        """
        plan = _plan(points)
        flat = plan.reshape(-1, 2)
        top = self.surface(flat)
        point, piece, _ = self._near(flat, 0.0)
        # The top of a convex piece is the minimum of its upper planes
        facets = self._facets[piece]
        rise = (facets[..., :2] * flat[point, None]).sum(axis=-1)
        height = rise + facets[..., 2]
        np.maximum.at(top, point, height.min(axis=1))
        return top.reshape(plan.shape[:-1])

    @cached_property
    def _walls(self) -> tuple[np.ndarray, np.ndarray]:
        """Start points (P, V, 2) of the edges of each footprint, and edge vectors.

        Shorter lists are padded with zero edge vectors.
        """
        start = _padded(self.footprints, 2)
        return start, np.roll(start, -1, axis=1) - start

    @cached_property
    def _facets(self) -> np.ndarray:
        """Planes z = a x + b y + c on top of each piece, (P, F, 3); padded with the last one."""
        tops = self.raised.boxes[:, 1, 2]
        of_boxes = [np.array([[0.0, 0.0, top]]) for top in tops]
        of_hulls = [_top(hull) for hull in self.raised.hulls]
        return _padded(of_boxes + of_hulls, 3)

    def _near(
        self, plan: np.ndarray, max_distance: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find the pairs of points (K, 2) and footprints within `max_distance` m.

        Returns the indices of both, and their distances, m; 0 inside.
        """
        # Sort points by strips from west to east, then from south to north
        order = np.lexsort([plan[:, 1], np.floor(plan[:, 0] / STRIP)])
        groups = np.split(order, range(GROUP, len(order), GROUP))
        west, south = self.raised.bounds[:, 0, :2].T - max_distance
        east, north = self.raised.bounds[:, 1, :2].T + max_distance
        sides = np.stack([west, east, south, north])
        found = [self._near_group(plan, group, max_distance, sides) for group in groups]
        point, piece, distance = zip(*found, strict=True)
        return np.concatenate(point), np.concatenate(piece), np.concatenate(distance)

    def _near_group(
        self, plan: np.ndarray, group: np.ndarray, max_distance: float, sides: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find the pairs of `_near` for the points with the indices `group`.

        `sides` (4, P) are the bounds of inflated footprints: west, east, south, north.
        """
        x, y = plan[group].T
        west, east, south, north = sides

        # Pieces near the bounding rectangle of the group
        beside = (west <= x.max(initial=-np.inf)) & (east >= x.min(initial=np.inf))
        beside &= (south <= y.max(initial=-np.inf)) & (north >= y.min(initial=np.inf))
        close = np.flatnonzero(beside)
        west, east, south, north = sides[:, close]

        # Pairs of points and rectangles that contain them
        holds = (x[:, None] >= west) & (x[:, None] <= east)
        holds &= (y[:, None] >= south) & (y[:, None] <= north)
        one, other = np.nonzero(holds)
        point = group[one]
        piece = close[other]

        # Exact distances
        start, edge = self._walls
        distance = _distance(plan[point, None], start[piece], edge[piece])
        near = distance <= max_distance
        return point[near], piece[near], distance[near]


def _distance(point: np.ndarray, start: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Return the distances (M,) from points (M, 1, 2) to convex polygons, 0 inside.

    Polygon edges start at `start` and have vectors `edge`, both (M, V, 2).
    """
    offset = point - start
    # Interior points are to the left of all edges
    left = edge[..., 0] * offset[..., 1]
    right = edge[..., 1] * offset[..., 0]
    inside = (left >= right).all(axis=1)
    # Nearest point of each edge
    square = np.maximum((edge**2).sum(axis=-1), np.finfo(float).tiny)
    along = (offset * edge).sum(axis=-1)
    fraction = np.clip(along / square, 0, 1)
    away = offset - fraction[..., None] * edge
    nearest = np.linalg.norm(away, axis=-1).min(axis=1)
    return np.where(inside, 0.0, nearest)


def _padded(rows: Sequence[np.ndarray], columns: int) -> np.ndarray:
    """Stack arrays (1 to K, C) to (P, K, C); shorter ones repeat their last entry."""
    longest = max(map(len, rows), default=1)
    index = [np.minimum(np.arange(longest), len(row) - 1) for row in rows]
    stacked = np.array([row[which] for row, which in zip(rows, index, strict=True)])
    return stacked.reshape(-1, longest, columns)


def _plan(points: np.ndarray) -> np.ndarray:
    """Return x and y (..., 2) of points (..., 2 or 3); raise ValueError for invalid points."""
    points = numbers_of("points are", points)
    if not points.ndim or points.shape[-1] not in (2, 3) or not np.isfinite(points).all():
        raise ValueError(
            f"points are {shown(points)}: finite (x, y) or (x, y, z), one or several, are needed"
        )
    return points[..., :2]


def _outline(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of points (K, 2), counter-clockwise."""
    from scipy.spatial import ConvexHull  # lazy: slow to import, and not needed for boxes

    corners: np.ndarray = points[ConvexHull(points).vertices]
    return corners


def _top(hull: np.ndarray) -> np.ndarray:
    """Return (a, b, c) (F, 3) of the upper planes z = a x + b y + c of a hull of points (V, 3)."""
    from scipy.spatial import ConvexHull

    # Exterior points have n . p + d > 0
    planes = ConvexHull(hull).equations
    up = planes[planes[:, 2] > UPRIGHT]
    rows: np.ndarray = -up[:, [0, 1, 3]] / up[:, 2:3]
    return rows
