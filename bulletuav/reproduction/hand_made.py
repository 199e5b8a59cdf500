"""Decisions from hand-made states, to compare environments number by number."""

from typing import Any

import numpy as np

from bulletuav import Aviary
from bulletuav.envs.step import Step
from bulletuav.reproduction.table import Row
from bulletuav.tasks.base import Task

SINGLE_PRECISION = 1e-6
"""Relative error of a few operations in single precision"""


def compare_number(name: str, ours: Any, theirs: float, unit: str = "", why: str = "") -> Row:
    """Compare with a number that an environment of others computes in single precision.

    Args:
        name: Name of the number.
        ours: Number that is computed here.
        theirs: Their number.
        unit: Unit.
        why: Explanation of a difference.
    """
    tolerance = SINGLE_PRECISION * max(1.0, abs(theirs))
    return Row(name, float(ours), float(theirs), unit, tolerance=tolerance, why=why)


class HandMade:
    """An environment of one world in which every decision begins from a state made by hand.

    Attributes:
        aviary: The environment.
        before: (N, D) observations at the start.
        steps: The decisions.
    """

    def __init__(
        self,
        task: type[Task[Any]],
        actions: Any = 0.0,
        decisions: int = 1,
        given: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        """Fly the decisions.

        Args:
            task: The task, which starts in the state.
            actions: (N, A) actions of all decisions, or one number for all.
            decisions: Number of decisions.
            given: Parts of the state that `Aviary.reset` takes, such as "start".
            **options: Options of the environment.
        """
        self.aviary = Aviary(task, **options)
        first = self.aviary.reset(seeds=0, **(given or {}))
        self.before = np.asarray(first)[0]
        shape = self.aviary.given.shape
        flown = np.array(np.broadcast_to(np.asarray(actions, dtype=float), shape))
        self.steps: list[Step] = [self.aviary.step(flown) for _ in range(decisions)]

    @property
    def position(self) -> np.ndarray:
        """(N, 3) positions after the last decision, m."""
        place: np.ndarray = self.aviary.swarm.position[0]
        return place

    @property
    def velocity(self) -> np.ndarray:
        """(N, 3) velocities after the last decision, m/s."""
        velocity: np.ndarray = self.aviary.swarm.velocity[0]
        return velocity

    @property
    def rewards(self) -> np.ndarray:
        """(N,) rewards of the last decision."""
        rewards: np.ndarray = self.steps[-1].rewards[0]
        return rewards

    @property
    def after(self) -> np.ndarray:
        """(N, D) observations after the last decision."""
        seen: np.ndarray = np.asarray(self.steps[-1].observations)[0]
        return seen

    def term(self, name: str) -> np.ndarray:
        """Return the weighted reward term of a name in the last decision, (N,)."""
        term: np.ndarray = self.steps[-1].info[f"reward/{name}"][0]
        return term
