"""Time that drones hold their goals, on which success depends."""

import math
from collections.abc import Callable, Mapping, Sequence
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
    moment, and denied to drones that a gust displaces in this moment. A drone is in place near its
    goal.
    """

    compiled_infos = ("in_place",)

    def __init__(
        self,
        min_in_place: float,
        context: TaskContext,
        goal_radius: float,
        lands: bool = False,
    ) -> None:
        """Check the fraction.

        Args:
            min_in_place: Fraction of the episode that a drone has to be in place.
            context: The swarm, and the length of an episode.
            goal_radius: Maximum distance to the goal of drones in place, m.
            lands: Whether drones in place also stand on the ground.

        Raises:
            ValueError: If the fraction is not in (0, 1], or the radius is a function.
        """
        if not 0 < min_in_place <= 1:
            raise ValueError(
                f"min_in_place is {min_in_place:g}: a fraction above 0 and up to 1 is needed"
            )
        if callable(goal_radius):
            raise ValueError("goal_radius is a function: pass it to HoldingWhere instead")
        self._num_drones = context.num_drones
        self._goal_radius, self._lands = goal_radius, lands
        self._period = context.period
        self._needed = min_in_place * context.duration / context.period - ROUNDING

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of "held" (N,), number of decisions in place so far."""
        return {"held": (self._num_drones,)}

    def memory_calls(self, frame: Frame) -> Sequence[tuple[Any, ...]]:
        """Count the decision of drones in place."""
        held, near = frame.scene.memory["held"], (frame.distance, self._goal_radius)
        return ((count_near, frame.alive, *near, frame.landed, self._lands, held),)

    def quantities(self) -> Mapping[str, Any]:
        """Return `has_held` and `min_held`, the decisions needed, for ingredients."""
        return {"has_held": self.has_held, "min_held": self._needed}

    def has_held(self, frame: Frame) -> np.ndarray:
        """Return which drones were in place for long enough, (W, N) bool."""
        held: np.ndarray = frame.scene.memory["held"] >= self._needed
        return held

    def info_calls(
        self, frame: Frame, infos: Mapping[str, np.ndarray]
    ) -> Sequence[tuple[Any, ...]]:
        """Write "in_place", the fraction of the time so far for which the drone was in place."""
        held = frame.scene.memory["held"]
        return ((write_fraction, held, frame.time, self._period, infos["in_place"]),)


class HoldingWhere(Holding):
    """Counts the decisions in which drones were in place, as the task defines it."""

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
        super().__init__(min_in_place, context, math.inf)
        self._in_place = in_place

    def memory_calls(self, frame: Frame) -> Sequence[tuple[Any, ...]]:
        """Return nothing, as Python computes which drones are in place."""
        return ()

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Count the decision of drones in place."""
        count_in_place(frame.alive, self._in_place(frame), frame.scene.memory["held"])


@kernel
def write_fraction(held: np.ndarray, time: np.ndarray, period: float, in_place: np.ndarray) -> None:
    """Write `held` (W, N), in decisions of `period`, as fractions of the times (W,) in s."""
    for w in range(held.shape[0]):
        elapsed = max(time[w], period)
        for i in range(held.shape[1]):
            in_place[w, i] = held[w, i] * period / elapsed


@kernel
def count_near(
    alive: np.ndarray,
    distance: np.ndarray,
    goal_radius: float,
    landed: np.ndarray,
    lands: bool,
    held: np.ndarray,
) -> None:
    """Add a decision of active drones near their goals to `held`, all (W, N).

    If `lands` is True, these drones are also `landed`.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i] and distance[w, i] <= goal_radius and (landed[w, i] or not lands):
                held[w, i] += 1.0


@kernel
def count_in_place(alive: np.ndarray, in_place: np.ndarray, held: np.ndarray) -> None:
    """Add a decision of active drones in place to `held`, all (W, N)."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i] and in_place[w, i]:
                held[w, i] += 1.0
