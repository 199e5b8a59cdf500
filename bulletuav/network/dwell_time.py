"""Dwell time: for how many seconds drones have seen users without a break."""

from bulletuav.kernel import kernel


@kernel
def watch(dwell_time, mean, sight, alive, period):
    """Bring `dwell_time` (W, N, U) s and its `mean` (W, N) up to date after `period` s of `sight` by living drones (W, N)."""
    for w in range(sight.shape[0]):
        for i in range(sight.shape[1]):
            total = 0.0
            for j in range(sight.shape[2]):
                dwell_time[w, i, j] = (
                    dwell_time[w, i, j] + period if alive[w, i] and sight[w, i, j] else 0.0
                )
                total += dwell_time[w, i, j]
            mean[w, i] = total / sight.shape[2]
