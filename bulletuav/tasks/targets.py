"""Fractions of targets in sight: users on the ground, or cells of it."""

from typing import Any

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame

SERVED = "served share"
"""Key of `Frame.derived` for the result of `get_served_fraction`"""


def get_served_fraction(task: Task[Any], frame: Frame) -> np.ndarray:
    """Return the fraction of active targets seen by at least one active drone, cached in the frame.

    Args:
        task: The task, with targets.
        frame: The decision.

    Returns:
        (W, N), the same for all drones of a world.
    """
    known = frame.derived.get(SERVED)
    if known is None:
        active = task.active_targets(frame.scene)
        known = compute_served_fraction(frame.readings["sight"], frame.alive, active)
        frame.derived[SERVED] = known
    return known


def compute_seen_fraction(seen: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Compute the fraction of active targets that are seen.

    Args:
        seen: (..., U) bool.
        active: (..., U) bool.

    Returns:
        (...,), exactly 1 if all are seen, 0 if none is active.
    """
    share: np.ndarray = (seen & active).sum(axis=-1) / np.maximum(active.sum(axis=-1), 1)
    return share


@allocating
def compute_served_fraction(sight: np.ndarray, alive: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Compute the fraction of active targets seen by at least one active drone.

    Args:
        sight: (W, N, U) bool.
        alive: (W, N) bool.
        active: (W, U) bool.

    Returns:
        (W, N), the same for all drones of a world.
    """
    share = np.zeros(alive.shape)
    for w in range(alive.shape[0]):
        seen, num_active = 0, 0
        for j in range(active.shape[1]):
            if active[w, j]:
                num_active += 1
                for i in range(alive.shape[1]):
                    if alive[w, i] and sight[w, i, j]:
                        seen += 1
                        break
        share[w] = seen / max(num_active, 1)
    return share
