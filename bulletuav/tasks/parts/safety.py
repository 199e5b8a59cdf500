"""Safety of drones: conflicts and collisions, which rule out success."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.parts.base import Part


class Safety(Part):
    """Counts the conflicts and collisions of each drone: with any of them it has no success.

    A task that sets `self.safety = self.add(Safety(context.num_drones))` succeeds only for drones
    that had neither a separation below the task's `d_safe` nor a contact of their collision shapes
    in the whole episode. Landings, where a task allows them, are no collisions.
    """

    def __init__(self, num_drones: int) -> None:
        """Count the violations of the drones of each world.

        Args:
            num_drones: Drones per world.
        """
        self._num_drones = num_drones

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of "violations" (N,), number of conflicts and collisions so far."""
        return {"violations": (self._num_drones,)}

    def memory_calls(self, frame: Frame) -> Sequence[tuple[Any, ...]]:
        """Count the decision's conflicts that began, and its collisions."""
        violations = frame.scene.memory["violations"]
        return (
            (count_violations, frame.alive, frame.conflict.onsets, frame.collision, violations),
        )

    def quantities(self) -> Mapping[str, Any]:
        """Return `is_safe` for ingredients."""
        return {"is_safe": self.is_safe}

    def is_safe(self, frame: Frame) -> np.ndarray:
        """Return which drones had no conflict and no collision so far, (W, N) bool."""
        safe: np.ndarray = frame.scene.memory["violations"] == 0
        return safe


@kernel
def count_violations(
    alive: np.ndarray, onsets: np.ndarray, collision: np.ndarray, violations: np.ndarray
) -> None:
    """Add a decision's conflicts and collisions of active drones to `violations`, all (W, N)."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i]:
                violations[w, i] += onsets[w, i] + (1 if collision[w, i] else 0)


@kernel
def deny_unsafe(violations: np.ndarray, success: np.ndarray) -> None:
    """Set `success` to False where there were violations, both (W, N)."""
    for w in range(success.shape[0]):
        for i in range(success.shape[1]):
            success[w, i] = success[w, i] and violations[w, i] == 0.0
