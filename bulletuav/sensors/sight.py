"""Line of sight, and how near the nearest thing is."""

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.kernel import kernel
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND


def line_of_sight(
    engine: Engine, start: np.ndarray, end: np.ndarray, where: np.ndarray
) -> np.ndarray:
    """(M,) bool: nothing but drones between points `start` and `end` (M, 3), m, in worlds `where` (M,).

    Either way gives the same answer: the ray goes from the higher point to the lower, on the level by x, then y.
    """
    rises = (np.sign(end - start) @ [3, 1, 9] > 0)[:, None]
    return engine.cast_rays(np.where(rises, end, start), np.where(rises, start, end), where) >= 1


@kernel
def _links(position, targets, mask, start, end, where):
    """Rays from the drones of `mask` (W, N) to `targets` (W, U, 3), ordered as in `line_of_sight`."""
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            for j in range(targets.shape[1]):
                order = 0.0
                for k, weight in ((0, 3.0), (1, 1.0), (2, 9.0)):
                    order += weight * np.sign(targets[w, j, k] - position[w, i, k])
                for k in range(3):
                    start[m, k] = targets[w, j, k] if order > 0.0 else position[w, i, k]
                    end[m, k] = position[w, i, k] if order > 0.0 else targets[w, j, k]
                where[m] = w
                m += 1


def sights(
    engine: Engine, position: np.ndarray, targets: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """(W, N, U) bool: which of `targets` (W, U, 3) the drones of `mask` (W, N) at `position` (W, N, 3) see; others none."""
    count = targets.shape[1]
    rays = np.count_nonzero(mask) * count
    start, end, where = np.empty((rays, 3)), np.empty((rays, 3)), np.empty(rays, dtype=np.int64)
    _links(position, targets, mask, start, end, where)
    seen = np.zeros((*mask.shape, count), dtype=bool)
    seen[mask] = (engine.cast_rays(start, end, where) >= 1).reshape(-1, count)
    return seen


def clearances(engine: Engine, mask: np.ndarray, most: float) -> np.ndarray:
    """(W, N) distance of each drone's collision shape from the nearest other, m: ground, building, obstacle or drone.

    To a millimetre (by which the engine rounds edges and thickens hulls), negative where shapes overlap; `most` where
    nothing is nearer and for drones that are not among `mask` (W, N).
    Drones are where the engine's bodies stand.
    """
    result = np.full(mask.shape, most)
    obstacles = range(FIRST_OBSTACLE, FIRST_OBSTACLE - len(engine.obstacle_radius), -1)
    for w, i in np.argwhere(mask).tolist():
        others = [*np.flatnonzero(mask[w]).tolist(), GROUND, CITY, *obstacles]
        gaps = [
            engine.separation(w, (i, None, None), (other, None, None), most)
            for other in others
            if other != i
        ]
        result[w, i] = min(most, *gaps)
    return result
