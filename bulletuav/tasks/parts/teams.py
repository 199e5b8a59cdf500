"""Two-team games: team sizes, nearest opponents, closest approaches, and zero-sum payoffs."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.errors import shown
from bulletuav.geometry.closest_approach import closest_squared_distances, offset
from bulletuav.geometry.rotation import dot

NO_OPPONENT = -1
"""Index if there is no opponent"""
PAYOFF_STEP = 2.0**-20
"""Payoffs are integer multiples of this step, so their sums are exact in any order"""


def team_sizes(given: Any, drones: int, usual: tuple[int, int]) -> tuple[int, int]:
    """Return the sizes of two teams from the option `teams`.

    Args:
        given: Value of the option; None for the default.
        drones: Number of drones of both teams.
        usual: Default sizes.

    Returns:
        Number of drones of the first team, and of the second.

    Raises:
        ValueError: If the sizes are not two integers with the sum `drones`.
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
    """Find the nearest drone of another team for each drone.

    Args:
        position: (W, N, 3) m.
        present: (W, N) bool, drones that can be found.
        team: (N,) index of each drone's team.
        nearest: (W, N) output: index of the nearest opponent, or NO_OPPONENT.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            nearest[w, i] = NO_OPPONENT
            min_square = np.inf
            for j in range(position.shape[1]):
                if present[w, j] and team[j] != team[i]:
                    # Ties are broken by index
                    gap = offset(position, w, i, j)
                    square = dot(gap, gap)
                    if square < min_square:
                        min_square = square
                        nearest[w, i] = j


@kernel
def measure_chase(
    before: np.ndarray,
    after: np.ndarray,
    flown: np.ndarray,
    team: np.ndarray,
    min_distance: np.ndarray,
    by: np.ndarray,
    closing: np.ndarray,
) -> None:
    """Compute the closest approach of chasers (team 0) to each evader in a decision.

    All drones are assumed to move straight during the decision.

    Args:
        before: (W, N, 3) positions before the decision, m.
        after: (W, N, 3) positions after the decision, m.
        flown: (W, N) bool, drones active before the decision; others are ignored.
        team: (N,) 0 for chasers, 1 for evaders.
        min_distance: (W, N) output: minimum distance from a chaser, m; infinite if there is none.
        by: (W, N) output: index of this chaser, or NO_OPPONENT.
        closing: (W, N) output: decrease of the distance to the nearest chaser, m; 0 if there is
            none.
    """
    for w in range(before.shape[0]):
        for i in range(before.shape[1]):
            # Result for chasers, and for evaders without chasers
            min_distance[w, i] = np.inf
            by[w, i] = NO_OPPONENT
            closing[w, i] = 0.0
            if team[i] == 0 or not flown[w, i]:
                continue
            # The nearest chasers before, during and after the decision may differ
            first, nearest, last = np.inf, np.inf, np.inf
            for j in range(before.shape[1]):
                if team[j] == 0 and flown[w, j]:
                    later = offset(after, w, i, j)
                    start, least = closest_squared_distances(offset(before, w, i, j), later)
                    first = min(first, start)
                    last = min(last, dot(later, later))
                    if least < nearest:
                        nearest = least
                        by[w, i] = j
            if by[w, i] != NO_OPPONENT:
                min_distance[w, i] = math.sqrt(nearest)
                closing[w, i] = math.sqrt(first) - math.sqrt(last)


def zero_sum(gain: np.ndarray, paid: np.ndarray, paying: np.ndarray) -> np.ndarray:
    """Distribute gains equally over the drones of one team, and charge them to the other team.

    Shares are rounded to `PAYOFF_STEP`. The payoffs of a world therefore sum exactly to 0 in any
    order, also when weighted by integers or fractions such as 1/16.

    Args:
        gain: (W, N) total loss of each drone of `paying`.
        paid: (W, N) bool, drones that share the gains.
        paying: (W, N) bool, drones of the other team that lose.

    Returns:
        (W, N) payoffs; zero in worlds where no drone is paid.
    """
    count = paid.sum(axis=1, keepdims=True)
    each = np.round(np.where(paying, gain, 0.0) / np.maximum(count, 1) / PAYOFF_STEP) * PAYOFF_STEP
    payoff: np.ndarray = np.where(paid, each.sum(axis=1, keepdims=True), 0.0) - each * count
    return payoff
