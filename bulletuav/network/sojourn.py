"""Sojourn: for how many seconds drones have seen users without a break."""

from bulletuav.kernel import kernel


@kernel
def watch(sojourn, mean, sight, alive, period):
    """Bring `sojourn` (W, N, U) s and its `mean` (W, N) up to date after `period` s of `sight` by living drones (W, N)."""
    for w in range(sight.shape[0]):
        for i in range(sight.shape[1]):
            total = 0.0
            for j in range(sight.shape[2]):
                sojourn[w, i, j] = sojourn[w, i, j] + period if alive[w, i] and sight[w, i, j] else 0.0
                total += sojourn[w, i, j]
            mean[w, i] = total / sight.shape[2]
