"""User association: assignment of users to drones by one of three strategies.

- `nearest`: the nearest drone.
- `max_rate`: the drone with the highest received power, which has the highest rate without
interference. Users that no drone receives are not served.
- `dtlcm`: dynamic distance, task and load capacity matching. It prefers drones with a short
horizontal distance, sufficient computing capacity and low load.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, elementwise
from bulletuav.network.access import NO_DRONE

NEAREST, MAX_RATE, DTLCM = range(3)
STRATEGIES = {"nearest": NEAREST, "max_rate": MAX_RATE, "dtlcm": DTLCM}
"""Codes of the strategies by name"""
SCORE_RANGE = 1000.0
"""Distance beyond which `dtlcm_score` does not decrease further, m"""
LOAD_WEIGHT = 0.1
"""Weight of the load in `dtlcm_score`"""


@elementwise
def dtlcm_score(
    distance: float, capacity: float, demand: float, load: float, distance_weight: float
) -> float:
    """Compute the score of a drone for a user; higher is better.

    The heuristic of UrbanMARL 0.3.1 for a distance d, capacity C, demand X and load L is w (1 -
    min(d / 1 km, 1)) + (1 - w) min(C / X, 1) - 0.1 L / C, with w = 0.7 in that package.

    Args:
        distance: Horizontal distance, m.
        capacity: Computing capacity of the drone, cycles/s.
        demand: Demand of a task, cycles.
        load: Load of the drone, cycles/s.
        distance_weight: Weight w of the distance, 0 to 1; computing capacity has weight 1 - w.
    """
    nearness = 1.0 - min(distance / SCORE_RANGE, 1.0)
    ability = min(capacity / demand, 1.0)
    penalty = LOAD_WEIGHT * load / capacity
    return distance_weight * nearness + (1.0 - distance_weight) * ability - penalty


@allocating
def assign_users(
    strategy: int,
    position: np.ndarray,
    alive: np.ndarray,
    users: np.ndarray,
    power: np.ndarray,
    capacity: float,
    demand: float,
    load: np.ndarray,
    distance_weight: float,
) -> np.ndarray:
    """Assign each user to an active drone; ties are broken by the lower index.

    Args:
        strategy: One of `STRATEGIES`.
        position: Positions (W, N, 3) of drones, m.
        alive: Drones (W, N) that can serve users, bool.
        users: Positions (W, U, 3) of users, m.
        power: Received power (W, N, U) of users at drones, W.
        capacity: Computing capacity of a drone, cycles/s.
        demand: Demand of a task, cycles.
        load: Load (W, N) of each drone, cycles/s.
        distance_weight: Weight of the distance in `dtlcm_score`.

    Returns:
        Serving drone (W, U), or `NO_DRONE`.
    """
    worlds, drones, count = power.shape
    chosen = np.full((worlds, count), NO_DRONE)
    for w in range(worlds):
        for j in range(count):
            # Received power must be positive; distances and scores have no limit
            best = 0.0 if strategy == MAX_RATE else -np.inf
            for i in range(drones):
                if not alive[w, i]:
                    continue
                # Displacement from the user to the drone
                east = position[w, i, 0] - users[w, j, 0]
                north = position[w, i, 1] - users[w, j, 1]
                up = position[w, i, 2] - users[w, j, 2]
                if strategy == MAX_RATE:
                    score = power[w, i, j]
                elif strategy == NEAREST:
                    score = -(east * east + north * north + up * up)
                else:
                    distance = math.sqrt(east * east + north * north)
                    own = load[w, i]
                    score = dtlcm_score(distance, capacity, demand, own, distance_weight)
                # Ties keep the lower index
                if score > best:
                    best = score
                    chosen[w, j] = i
    return chosen
