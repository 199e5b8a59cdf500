"""A city: solid buildings on flat ground, streets, and what is asked of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bulletuav.city.streets import Streets
from bulletuav.errors import finite, numbers_of, shown
from bulletuav.geometry.solids import Solids, box_corners

GROUP = (
    256  # points that are neighbours along x are asked together, as few pieces come into question
)
UPRIGHT = 1e-9  # facets whose normal rises less than this are walls


@dataclass(frozen=True, eq=False)
class City:
    """The square [-side/2, side/2]^2 of flat ground, z = 0, with buildings of convex pieces on it; x east, y north, z up.

    name      of its kind or file
    side      m
    solids    the pieces
    building  (P,) int, the building that each piece belongs to
    streets   where one walks
    """

    name: str
    side: float
    solids: Solids
    building: np.ndarray
    streets: Streets

    @cached_property
    def heights(self) -> np.ndarray:
        """(n,) height of each building's highest point, m."""
        heights = np.zeros(self.building.max(initial=-1) + 1)
        np.maximum.at(heights, self.building, self.solids.bounds[:, 1, 2])
        return heights

    @cached_property
    def footprints(self) -> list[np.ndarray]:
        """Of each piece the corners (V, 2) of its outline seen from above, turning left, m."""
        of_boxes = [box_corners(box)[[0, 1, 3, 2], :2] for box in self.solids.boxes]
        return of_boxes + [_outline(hull[:, :2]) for hull in self.solids.hulls]

    @cached_property
    def coverage(self) -> float:
        """Built-up share of the ground; pieces above each other count each."""
        start, way = self._walls
        double = start[..., 0] * way[..., 1] - start[..., 1] * way[..., 0]
        return float(double.sum() / 2 / self.side**2)

    def outdoors(self, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """(...,) whether points (..., 2 or 3) are farther than `margin` m from all footprints; their z does not matter."""
        plan, margin = _plan(points), finite("margin", margin)
        free = np.ones(plan[..., 0].size, dtype=bool)
        free[self._near(plan.reshape(-1, 2), margin)[0]] = False
        return free.reshape(plan.shape[:-1])

    def clearance(self, points: np.ndarray, most: float) -> np.ndarray:
        """(...,) way from points (..., 2 or 3) to the nearest footprint seen from above, m: 0 over one, `most` at most."""
        plan, most = _plan(points), finite("most", most)
        gap = np.full(plan[..., 0].size, most)
        point, _, distance = self._near(plan.reshape(-1, 2), most)
        np.minimum.at(gap, point, distance)
        return gap.reshape(plan.shape[:-1])

    def roof(self, points: np.ndarray) -> np.ndarray:
        """(...,) height of the highest roof over or under points (..., 2 or 3), m; 0 outdoors."""
        plan = _plan(points)
        flat = plan.reshape(-1, 2)
        top = np.zeros(len(flat))
        point, piece, _ = self._near(flat, 0.0)
        facets = self._facets[piece]
        np.maximum.at(
            top,
            point,
            ((facets[..., :2] * flat[point, None]).sum(axis=-1) + facets[..., 2]).min(axis=1),
        )
        return top.reshape(plan.shape[:-1])

    @cached_property
    def _walls(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each footprint where its sides start (P, V, 2), and the ways to their ends; short lists end in no way."""
        start = _padded(self.footprints, 2)
        return start, np.roll(start, -1, axis=1) - start

    @cached_property
    def _facets(self) -> np.ndarray:
        """(P, F, 3) a, b, c of the planes z = a x + b y + c that lie on each piece; short lists repeat the last."""
        of_boxes = [np.array([[0.0, 0.0, top]]) for top in self.solids.boxes[:, 1, 2]]
        return _padded(of_boxes + [_top(hull) for hull in self.solids.hulls], 3)

    def _near(self, plan: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of points (K, 2) and footprints within `reach` m: indices of both, and their distance (0 inside)."""
        order = np.argsort(plan[:, 0])
        groups = np.split(order, range(GROUP, len(order), GROUP))
        point, piece, distance = zip(
            *(self._near_group(plan, group, reach) for group in groups), strict=True
        )
        return np.concatenate(point), np.concatenate(piece), np.concatenate(distance)

    def _near_group(
        self, plan: np.ndarray, group: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`_near` of the points with the indices `group`."""
        low, high = self.solids.bounds[:, 0] - reach, self.solids.bounds[:, 1] + reach
        x, y = plan.T
        strip = np.flatnonzero(
            (low[:, 0] <= x[group].max(initial=-np.inf))
            & (high[:, 0] >= x[group].min(initial=np.inf))
        )
        one, other = np.nonzero(
            (x[group, None] >= low[strip, 0]) & (x[group, None] <= high[strip, 0])
        )
        point, piece = group[one], strip[other]
        beside = (y[point] >= low[piece, 1]) & (y[point] <= high[piece, 1])
        point, piece = point[beside], piece[beside]
        start, way = self._walls
        distance = _distance(plan[point, None], start[piece], way[piece])
        near = distance <= reach
        return point[near], piece[near], distance[near]


def _distance(point: np.ndarray, start: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(M,) from points (M, 1, 2) to convex polygons whose sides begin at `start` and go `way` (M, V, 2), 0 inside."""
    offset = point - start
    inside = (way[..., 0] * offset[..., 1] >= way[..., 1] * offset[..., 0]).all(axis=1)
    square = np.maximum((way**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip((offset * way).sum(axis=-1) / square, 0, 1)
    gap = np.linalg.norm(offset - share[..., None] * way, axis=-1).min(axis=1)
    return np.where(inside, 0.0, gap)


def _padded(rows: Sequence[np.ndarray], columns: int) -> np.ndarray:
    """(P, K, C) of arrays (1 to K, C): short ones repeat their last entry."""
    longest = max(map(len, rows), default=1)
    index = [np.minimum(np.arange(longest), len(row) - 1) for row in rows]
    return np.array([row[which] for row, which in zip(rows, index, strict=True)]).reshape(
        -1, longest, columns
    )


def _plan(points: np.ndarray) -> np.ndarray:
    """(..., 2) of points (..., 2 or 3). Raises ValueError unless they are finite numbers of such a shape."""
    points = numbers_of("points are", points)
    if not points.ndim or points.shape[-1] not in (2, 3) or not np.isfinite(points).all():
        raise ValueError(
            f"points are {shown(points)}: finite (x, y) or (x, y, z), one or several, are needed"
        )
    return points[..., :2]


def _outline(points: np.ndarray) -> np.ndarray:
    from scipy.spatial import ConvexHull  # which takes long to import, and boxes do without

    return points[ConvexHull(points).vertices]


def _top(hull: np.ndarray) -> np.ndarray:
    """(F, 3) a, b, c of the planes z = a x + b y + c on top of the hull of points (V, 3)."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(hull).equations  # outside is n . p + d > 0
    up = planes[planes[:, 2] > UPRIGHT]
    return -up[:, [0, 1, 3]] / up[:, 2:3]
