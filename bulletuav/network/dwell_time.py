"""Dwell time: uninterrupted time for which a drone has had line of sight to each user."""

import numpy as np

from bulletuav.compiled.kernel import kernel


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
