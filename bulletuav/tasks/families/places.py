"""Random places that keep clear of each other and of obstacles."""

import math

import numpy as np

from bulletuav.geometry.rotation import Vec3, dot, minus, point
from bulletuav.kernel import func, kernel


@func
def _distance(one: Vec3, two: Vec3) -> float:
    """Return the distance of two points, m."""
    gap = minus(one, two)
    return math.sqrt(dot(gap, gap))


@kernel
def place_in_turn(
    places: np.ndarray,
    placed: int,
    draws: np.ndarray,
    obstacle: np.ndarray,
    keep_off: np.ndarray,
    apart: float,
    start: np.ndarray,
    leg: float,
) -> tuple[int, int]:
    """Put drones at random places, one after the other, each at the first that is clear.

    Args:
        places: (N, 3) m, written from `placed` on.
        placed: How many drones have places.
        draws: (M, 3) places to try, in this order, m.
        obstacle: (K, 3) m.
        keep_off: (K,) how far from each obstacle places are, m.
        apart: How far from each other places are, m.
        start: (N, 3) where drones start, or none, m.
        leg: How far from them places are, m.

    Returns:
        How many places were tried, and how many drones have places.
    """
    used = 0
    while used < draws.shape[0] and placed < places.shape[0]:
        place = point(draws, used)
        used += 1
        is_clear = True
        for i in range(placed):
            is_clear = is_clear and _distance(place, point(places, i)) > apart
        for k in range(obstacle.shape[0]):
            is_clear = is_clear and _distance(place, point(obstacle, k)) > keep_off[k]
        if start.shape[0]:
            is_clear = is_clear and _distance(place, point(start, placed)) >= leg
        if is_clear:
            for m in range(3):
                places[placed, m] = place[m]
            placed += 1
    return used, placed
