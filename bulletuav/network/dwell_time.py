"""Dwell time: uninterrupted time for which a drone has had line of sight to each user."""

import numpy as np

from bulletuav.compiled.functions import tanh
from bulletuav.compiled.kernel import allocating, kernel

DWELL_TIME_SCALE = 0.1
"""Rate at which dwell times saturate, 1/s"""


@kernel
def update_dwell_time(
    dwell_time: np.ndarray, mean: np.ndarray, sight: np.ndarray, alive: np.ndarray, period: float
) -> None:
    """Update dwell times and their means after a decision, in place.

    A dwell time grows by the length of the decision while the user is in line of sight. It is reset
    to 0 when the line of sight is lost, or when the drone is not alive.

    Args:
        dwell_time: Dwell time (W, N, U) of each user at each drone, s; modified.
        mean: Mean dwell time (W, N) over users, s; overwritten.
        sight: Whether (W, N, U) each drone has line of sight to each user.
        alive: Whether (W, N) each drone is alive.
        period: Length of a decision, s.
    """
    for w in range(sight.shape[0]):
        for i in range(sight.shape[1]):
            total = 0.0
            for j in range(sight.shape[2]):
                if alive[w, i] and sight[w, i, j]:
                    dwell_time[w, i, j] = dwell_time[w, i, j] + period
                else:
                    dwell_time[w, i, j] = 0.0
                total += dwell_time[w, i, j]
            mean[w, i] = total / sight.shape[2]


@allocating
def compute_steady_service(dwell_time: np.ndarray) -> np.ndarray:
    """Average tanh(0.1 s) over users, where s is the longest time for which a drone has seen one.

    Saturation of each user's time, rather than of the mean time, pays for every user: a few users
    that are seen for long do not make up for those that no drone sees.

    Args:
        dwell_time: (W, N, U) times for which drones have seen users without interruption, s.

    Returns:
        (W, N) from 0 to 1, the same for all drones of a world.
    """
    worlds, drones, users = dwell_time.shape
    service = np.zeros((worlds, drones))
    for w in range(worlds):
        total = 0.0
        for j in range(users):
            longest = 0.0
            for i in range(drones):
                longest = max(longest, dwell_time[w, i, j])
            total += tanh(DWELL_TIME_SCALE * longest)
        service[w] = total / users
    return service
