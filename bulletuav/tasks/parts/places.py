"""Random places that keep clear of each other and of obstacles."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, dot, minus, point
from bulletuav.tasks.parts.draws import RandomSource, draw_uniform


class PlacementRules(NamedTuple):
    """How far random places are from what.

    Attributes:
        keep_off: (K,) from each obstacle, m.
        apart: From each other, m.
        leg: From the starts, of goals, m.
    """

    obstacle_distance: np.ndarray
    apart: float
    leg: float


@func
def _distance(one: Vec3, two: Vec3) -> float:
    """Return the distance of two points, m."""
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
    """Put drones at random places of a box, one after the other, each at the first that is clear.

    Args:
        source: Of random numbers.
        low: (3,) low corner of the box, m.
        high: (3,) its high corner, m.
        places: (N, 3) m, written.
        obstacle: (K, 3) m.
        rules: How far from what.
        start: (N, 3) where drones start, or none, m.
    """
    placed = 0
    while placed < places.shape[0]:
        # Any place in the box is as likely as another
        east = draw_uniform(source, low[0], high[0])
        north = draw_uniform(source, low[1], high[1])
        place = (east, north, draw_uniform(source, low[2], high[2]))
        # Clear of those that are placed, of obstacles, and far enough from its own start
        is_clear = True
        for i in range(placed):
            is_clear = is_clear and _distance(place, point(places, i)) > rules.apart
        for k in range(obstacle.shape[0]):
            is_clear = (
                is_clear and _distance(place, point(obstacle, k)) > rules.obstacle_distance[k]
            )
        if start.shape[0]:
            is_clear = is_clear and _distance(place, point(start, placed)) >= rules.leg
        # Else drawn anew; crowds for which that takes long are refused before
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
    fastest: float,
    moving: int,
    jitter: float,
    obstacle: np.ndarray,
    velocity: np.ndarray,
    start: np.ndarray,
    goal: np.ndarray,
) -> None:
    """Draw where everything is: obstacles, then starts, goals, and shifts of the starts.

    Args:
        source: Of random numbers.
        low: (3,) low corner of the box in which all lies, m.
        high: (3,) its high corner, m.
        start_high: (3,) high corner of the box in which starts lie, m.
        rules: How far from what.
        fastest: Greatest speed of obstacles on each axis, m/s.
        moving: How many obstacles move.
        jitter: Largest shift of a start on each axis, m.
        obstacle: (K, 3) m, written.
        velocity: (K, 3) of obstacles, m/s, written.
        start: (N, 3) m, written.
        goal: (N, 3) m, written.
    """
    # Obstacles keep no distance from each other
    for k in range(obstacle.shape[0]):
        for m in range(3):
            obstacle[k, m] = draw_uniform(source, low[m], high[m])
    for k in range(obstacle.shape[0]):
        for m in range(3):
            # Drawn for all, so that the number of moving ones changes nothing else
            drawn = draw_uniform(source, -fastest, fastest)
            velocity[k, m] = drawn if k < moving else 0.0
    # Starts are only clear of obstacles; goals are far from their starts, too
    _place_sequentially(source, low, start_high, start, obstacle, rules, start[:0])
    _place_sequentially(source, low, high, goal, obstacle, rules, start)
    # Jitter moves starts after all distances were kept; `apart` leaves some room
    for i in range(start.shape[0]):
        for m in range(3):
            start[i, m] += draw_uniform(source, -jitter, jitter)
