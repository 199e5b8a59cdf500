"""Which drone serves which user.

`nearest`   by distance
`max_rate`  by received power, and so by the rate without interference; of users that no drone hears, none
`dtlcm`     dynamic distance, task and load capacity matching: near over ground, able to compute, and not loaded
"""

import math

import numpy as np

from bulletuav.kernel import elementwise, kernel
from bulletuav.network.access import NOBODY

NEAREST, MAX_RATE, DTLCM = range(3)
STRATEGIES = {"nearest": NEAREST, "max_rate": MAX_RATE, "dtlcm": DTLCM}
REACH = 1000.0  # m, beyond which distance counts no more for `dtlcm_score`
NEARNESS = 0.7  # share of distance in it
LOAD = 0.1  # weight of the load in it


@elementwise
def dtlcm_score(distance, capacity, demand, load):
    """How well a drone suits a user: distance over ground, m; capacity, cycles/s; demand of a task, cycles; load, cycles/s.

    w (1 - min(d / 1 km, 1)) + (1 - w) min(C / X, 1) - 0.1 load / C with w = 0.7, the heuristic of UrbanMARL 0.3.1.
    """
    near = 1.0 - min(distance / REACH, 1.0)
    return NEARNESS * near + (1.0 - NEARNESS) * min(capacity / demand, 1.0) - LOAD * load / capacity


@kernel
def assign(strategy, position, alive, users, power, capacity, demand, load):
    """(W, U) the living drone that serves each user, the first of equals, or NOBODY.

    position (W, N, 3) and users (W, U, 3) m; alive (W, N); received power (W, N, U) W; capacity of a drone and load
    (W, N) of each, cycles/s; demand of a task, cycles.
    """
    worlds, drones, count = power.shape
    chosen = np.full((worlds, count), NOBODY)
    for w in range(worlds):
        for j in range(count):
            best = 0.0 if strategy == MAX_RATE else -np.inf
            for i in range(drones):
                if not alive[w, i]:
                    continue
                east, north = position[w, i, 0] - users[w, j, 0], position[w, i, 1] - users[w, j, 1]
                up = position[w, i, 2] - users[w, j, 2]
                if strategy == MAX_RATE:
                    score = power[w, i, j]
                elif strategy == NEAREST:
                    score = -(east * east + north * north + up * up)
                else:
                    score = dtlcm_score(
                        math.sqrt(east * east + north * north), capacity, demand, load[w, i]
                    )
                if score > best:
                    best, chosen[w, j] = score, i
    return chosen
