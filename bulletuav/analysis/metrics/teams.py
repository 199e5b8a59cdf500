"""Return and success of each of two opposing teams."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.registry import register


class TeamReturn:
    """Sum of the rewards of the episode, mean of the team's drones.

    Attributes:
        team: Number of the team.
        name: Name of the metric.
    """

    def __init__(self, team: int) -> None:
        """Initialize the sum.

        Args:
            team: Number of the team, from 0.
        """
        self.team, self.name = team, f"team_{team}_return"
        self._total: np.ndarray | float = 0.0

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Add the rewards of a decision, (W,); NaN for a team without drones."""
        own = aviary.task.team == self.team
        self._total = self._total + (step.rewards * own).sum(axis=1)
        total: np.ndarray = np.asarray(self._total) / (own.sum() or np.nan)
        return total


class TeamSuccess:
    """Fraction of the team's drones that succeeded.

    Attributes:
        team: Number of the team.
        name: Name of the metric.
    """

    def __init__(self, team: int) -> None:
        """Initialize without success.

        Args:
            team: Number of the team, from 0.
        """
        self.team, self.name = team, f"team_{team}_success"
        self._was: np.ndarray | bool = False

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Return the fraction of drones whose last decision was a success, (W,)."""
        flown = aviary.alive | step.terminated | step.truncated
        self._was = np.where(flown, step.info["success"], self._was)
        own = aviary.task.team == self.team
        shared: np.ndarray = (self._was * own).sum(axis=1) / max(int(own.sum()), 1)
        return shared


FIRST_RETURN = register("metric", "team_0_return")(TeamReturn(0))
SECOND_RETURN = register("metric", "team_1_return")(TeamReturn(1))
FIRST_SUCCESS = register("metric", "team_0_success")(TeamSuccess(0))
SECOND_SUCCESS = register("metric", "team_1_success")(TeamSuccess(1))
