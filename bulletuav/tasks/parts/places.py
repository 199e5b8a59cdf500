"""Random positions with minimum distances to each other and to obstacles."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, dot, minus, point
from bulletuav.tasks.parts.draws import RandomSource, draw_uniform


class PlacementRules(NamedTuple):
    """Minimum distances of random positions.

    Attributes:
        obstacle_distance: (K,) distance from each obstacle, m.
        apart: Distance from each other, m.
        leg: Distance of a goal from its start, m.
    """

    obstacle_distance: np.ndarray
    apart: float
    leg: float


@func
def _distance(one: Vec3, two: Vec3) -> float:
    gap = minus(one, two)
    return math.sqrt(dot(gap, gap))


@func
def _place_sequentially(
    source: RandomSource,
    low: np.ndarray,
    high: np.ndarray,
    places: np.ndarray,
    obstacle: np.ndarray,
    rules: PlacementRules,
    start: np.ndarray,
) -> None:
    """Draw positions in a box one after the other, by rejection sampling.

    Args:
        source: Source of random numbers.
        low: (3,) lower corner of the box, m.
        high: (3,) upper corner of the box, m.
        places: (N, 3) output, m.
        obstacle: (K, 3) m.
        rules: Minimum distances.
        start: (N, 3) start of each drone, m, or empty.
    """
    placed = 0
    while placed < places.shape[0]:
        east = draw_uniform(source, low[0], high[0])
        north = draw_uniform(source, low[1], high[1])
        place = (east, north, draw_uniform(source, low[2], high[2]))
        is_clear = True
        for i in range(placed):
            is_clear = is_clear and _distance(place, point(places, i)) > rules.apart
        for k in range(obstacle.shape[0]):
            is_clear = (
                is_clear and _distance(place, point(obstacle, k)) > rules.obstacle_distance[k]
            )
        if start.shape[0]:
            is_clear = is_clear and _distance(place, point(start, placed)) >= rules.leg
        # Otherwise draw again; `FreeSpace` limits the occupancy, so this ends soon
        if is_clear:
            for m in range(3):
                places[placed, m] = place[m]
            placed += 1


@kernel
def draw_places(
    source: RandomSource,
    low: np.ndarray,
    high: np.ndarray,
    start_high: np.ndarray,
    rules: PlacementRules,
    velocity_range: tuple[float, float],
    moving: int,
    jitter: float,
    obstacle: np.ndarray,
    velocity: np.ndarray,
    start: np.ndarray,
    goal: np.ndarray,
) -> None:
    """Draw obstacles, then starts, goals, and the jitter of the starts.

    Args:
        source: Source of random numbers.
        low: (3,) lower corner of the box, m.
        high: (3,) upper corner of the box, m.
        start_high: (3,) upper corner of the box of starts, m.
        rules: Minimum distances.
        velocity_range: Minimum and maximum velocity of obstacles on each axis, m/s.
        moving: Number of moving obstacles.
        jitter: Maximum random offset of a start on each axis, m.
        obstacle: (K, 3) output, m.
        velocity: (K, 3) output, velocities of obstacles, m/s.
        start: (N, 3) output, m.
        goal: (N, 3) output, m.
    """
    # Obstacles may overlap each other
    for k in range(obstacle.shape[0]):
        for m in range(3):
            obstacle[k, m] = draw_uniform(source, low[m], high[m])
    for k in range(obstacle.shape[0]):
        for m in range(3):
            # Drawn for all, so that `moving` does not affect later draws
            drawn = draw_uniform(source, velocity_range[0], velocity_range[1])
            velocity[k, m] = drawn if k < moving else 0.0
    _place_sequentially(source, low, start_high, start, obstacle, rules, start[:0])
    _place_sequentially(source, low, high, goal, obstacle, rules, start)
    # `apart` includes the jitter
    for i in range(start.shape[0]):
        for m in range(3):
            start[i, m] += draw_uniform(source, -jitter, jitter)
