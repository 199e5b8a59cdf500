"""Drones that are put somewhere else: what contacts forget of them."""

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
    """Forget what was before of drones that are put somewhere else.

    Args:
        mask: (W, N) bool, drones that are put somewhere else.
        budget: Of the contact, changed, as are the others.
        asleep: (W, N) bool; all who sleep in these worlds wake.
        quiet: (W, N) s.
        remembered: (W, N) how many impulses are remembered.
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
