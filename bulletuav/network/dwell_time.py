"""Dwell time: for how long a drone has had each user in sight without a break."""

import numpy as np

from bulletuav.compiled.kernel import kernel


@kernel
def watch(
    dwell_time: np.ndarray, mean: np.ndarray, sight: np.ndarray, alive: np.ndarray, period: float
) -> None:
    """Bring dwell times and their means up to date after a decision, in place.

    A dwell time grows by the length of the decision while the user is in sight. It falls back to 0
    when the user is out of sight, or when the drone is no longer alive.

    Args:
        dwell_time: Dwell time (W, N, U) of each user at each drone, s; changed.
        mean: Mean (W, N) of it over users, s; overwritten.
        sight: Whether (W, N, U) each drone has a line of sight to each user now.
        alive: Whether (W, N) each drone is alive.
        period: Length of a decision, s.
    """
    for w in range(sight.shape[0]):
        for i in range(sight.shape[1]):
            # Any break starts the count again
            total = 0.0
            for j in range(sight.shape[2]):
                if alive[w, i] and sight[w, i, j]:
                    dwell_time[w, i, j] = dwell_time[w, i, j] + period
                else:
                    dwell_time[w, i, j] = 0.0
                total += dwell_time[w, i, j]
            mean[w, i] = total / sight.shape[2]
