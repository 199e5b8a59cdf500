"""Reset the contact state of drones that are moved to another place."""

import numpy as np

from bulletuav.compiled.kernel import kernel


@kernel
def reset_contacts(
    mask: np.ndarray,
    budget: np.ndarray,
    asleep: np.ndarray,
    quiet: np.ndarray,
    remembered: np.ndarray,
) -> None:
    """Clear the contact state of drones that are moved to another place.

    Args:
        mask: (W, N) bool, drones that are moved.
        budget: (W, N) motion budgets, m; changed.
        asleep: (W, N) bool, changed: all drones in the worlds of moved drones wake.
        quiet: (W, N) time at rest, s; changed.
        remembered: (W, N) number of cached impulses; changed.
    """
    for w in range(mask.shape[0]):
        any_moved = False
        for i in range(mask.shape[1]):
            if mask[w, i]:
                any_moved = True
                budget[w, i] = -1.0
                quiet[w, i] = 0.0
                remembered[w, i] = 0
        if any_moved:
            for i in range(mask.shape[1]):
                asleep[w, i] = False
