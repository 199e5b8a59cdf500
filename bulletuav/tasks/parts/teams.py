"""Teams with opposed aims: sizes, nearest opponents, who comes close, and payoffs that add to 0."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.errors import shown
from bulletuav.geometry.closest_approach import closest_squared_distances, offset
from bulletuav.geometry.rotation import dot

NOBODY = -1
"""Index where there is no opponent"""
GRAIN = 2.0**-20
"""Payoffs are whole multiples of it: sums of those are exact, in whatever order"""


def team_sizes(given: Any, drones: int, usual: tuple[int, int]) -> tuple[int, int]:
    """Take the option `teams`: the sizes of two teams.

    Args:
        given: What the option says; None for the usual sizes.
        drones: How many there are in both.
        usual: Sizes when the option is left out.

    Returns:
        Drones of the first team, and of the second.

    Raises:
        ValueError: They are no two whole numbers, or do not add up.
    """
    if given is None:
        return usual
    whole = isinstance(given, tuple | list) and [type(size) for size in given]
    if whole != [int, int]:
        raise ValueError(f"teams is {shown(given)}: two whole numbers are needed")
    first, second = given
    if min(first, second) < 0 or first + second != drones:
        raise ValueError(
            f"teams is {shown(given)}, {shown(first + second)} drones, and num_drones is {drones}: "
            f"they must add up"
        )
    return first, second


@kernel
def nearest_opponents(
    position: np.ndarray, present: np.ndarray, team: np.ndarray, nearest: np.ndarray
) -> None:
    """Find the nearest drone of another team, for each drone.

    Args:
        position: (W, N, 3) m.
        present: (W, N) bool, drones that can be found.
        team: (N,) number of each one's team.
        nearest: (W, N) its index, or NOBODY; written.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            # Nobody, until somebody is found
            nearest[w, i] = NOBODY
            least = np.inf
            for j in range(position.shape[1]):
                if present[w, j] and team[j] != team[i]:
                    # Among equals the first one
                    gap = offset(position, w, i, j)
                    square = dot(gap, gap)
                    if square < least:
                        least = square
                        nearest[w, i] = j


@kernel
def follow_chase(
    before: np.ndarray,
    after: np.ndarray,
    flown: np.ndarray,
    team: np.ndarray,
    least: np.ndarray,
    by: np.ndarray,
    closing: np.ndarray,
) -> None:
    """Tell how near chasers, team 0, came to each evader in a decision.

    All fly straight meanwhile.

    Args:
        before: (W, N, 3) positions before it, m.
        after: (W, N, 3) those after it, m.
        flown: (W, N) bool, drones that flew it; others do not count.
        team: (N,) 0 for chasers, 1 for evaders.
        least: (W, N) least distance from a chaser, m; infinite where there is none; written.
        by: (W, N) which chaser that was, or NOBODY; written.
        closing: (W, N) by how much the nearest chaser is nearer than before, m; 0 where there is
            none; written.
    """
    for w in range(before.shape[0]):
        for i in range(before.shape[1]):
            # What stays for chasers, and for evaders that nobody chases
            least[w, i] = np.inf
            by[w, i] = NOBODY
            closing[w, i] = 0.0
            if team[i] == 0 or not flown[w, i]:
                continue
            # The nearest at the start, on the way, and at the end may be three chasers.
            first, nearest, last = np.inf, np.inf, np.inf
            for j in range(before.shape[1]):
                if team[j] == 0 and flown[w, j]:
                    # Both fly straight, so their gap does, too
                    later = offset(after, w, i, j)
                    start, way = closest_squared_distances(offset(before, w, i, j), later)
                    first = min(first, start)
                    last = min(last, dot(later, later))
                    if way < nearest:
                        nearest = way
                        by[w, i] = j
            # From squares to m
            if by[w, i] != NOBODY:
                least[w, i] = math.sqrt(nearest)
                closing[w, i] = math.sqrt(first) - math.sqrt(last)


def zero_sum(gain: np.ndarray, paid: np.ndarray, paying: np.ndarray) -> np.ndarray:
    """Share gains among the drones of one team that flew, and take them from the other's.

    Each one's share is rounded to `GRAIN`. So payoffs of a world add up to 0, not nearly but to the
    bit, in whatever order; also times weights that are whole, or such as 1/16.

    Args:
        gain: (W, N) what each drone of `paying` loses, all in all.
        paid: (W, N) bool, drones that share it.
        paying: (W, N) bool, drones that lose; of the other team.

    Returns:
        (W, N) payoffs; zeros in worlds where nobody shares.
    """
    count = paid.sum(axis=1, keepdims=True)
    each = np.round(np.where(paying, gain, 0.0) / np.maximum(count, 1) / GRAIN) * GRAIN
    payoff: np.ndarray = np.where(paid, each.sum(axis=1, keepdims=True), 0.0) - each * count
    return payoff
