"""Time that drones hold their goals, on which success depends."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.tasks.frame import Frame, TaskContext
from bulletuav.tasks.parts.base import Part, Rngs

ROUNDING = 1e-6
"""Tolerance of the number of decisions in place, for fractions that are not exact"""


class Holding(Part):
    """Counts the decisions in which each drone was in place: success needs a fraction of them.

    A drone succeeds once it was in place for the fraction `min_in_place` of the decisions of a
    whole episode. Success at one instant would also be granted to drones that arrive at the last
    moment, and denied to drones that a gust displaces in this moment.
    """

    def __init__(
        self,
        min_in_place: float,
        context: TaskContext,
        in_place: Callable[[Frame], np.ndarray],
    ) -> None:
        """Check the fraction.

        Args:
            min_in_place: Fraction of the episode that a drone has to be in place.
            context: The swarm, and the length of an episode.
            in_place: Returns which drones are in place, (W, N) bool.

        Raises:
            ValueError: If the fraction is not in (0, 1].
        """
        if not 0 < min_in_place <= 1:
            raise ValueError(
                f"min_in_place is {min_in_place:g}: a fraction above 0 and up to 1 is needed"
            )
        self._num_drones, self._in_place = context.num_drones, in_place
        self._period = context.period
        self._needed = min_in_place * context.duration / context.period - ROUNDING

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of "held" (N,), number of decisions in place so far."""
        return {"held": (self._num_drones,)}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Count the decision of drones in place."""
        count_in_place(frame.alive, self._in_place(frame), frame.scene.memory["held"])

    def quantities(self) -> Mapping[str, Any]:
        """Return `has_held` for ingredients."""
        return {"has_held": self.has_held}

    def has_held(self, frame: Frame) -> np.ndarray:
        """Return which drones were in place for long enough, (W, N) bool."""
        held: np.ndarray = frame.scene.memory["held"] >= self._needed
        return held

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return "in_place", the fraction of the time so far for which the drone was in place."""
        elapsed = np.maximum(frame.time, self._period)[:, None]
        return {"in_place": frame.scene.memory["held"] * self._period / elapsed}


@kernel
def count_in_place(alive: np.ndarray, in_place: np.ndarray, held: np.ndarray) -> None:
    """Add a decision of active drones in place to `held`, all (W, N)."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i] and in_place[w, i]:
                held[w, i] += 1.0
