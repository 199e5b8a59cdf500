"""Conditions of a score, which are named with it so that scores can be compared."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Conditions(NamedTuple):
    """Conditions under which a score was measured.

    Attributes:
        task: Name of the task.
        difficulty: Difficulty of the task.
        dynamics: Name of the dynamics.
        episodes: Number of episodes.
        seed: Seed of the first episode; episode e has the seed `seed` + e.
    """

    task: str
    difficulty: str
    dynamics: str
    episodes: int
    seed: int

    @classmethod
    def of(cls, about: Mapping[str, Any]) -> "Conditions":
        """Return the conditions of an evaluation.

        Args:
            about: The description of its flights, see `Evaluation.about`.
        """
        options = about["options"]
        return cls(
            task=about["task"],
            difficulty=options["difficulty"],
            dynamics=options["dynamics"],
            episodes=about["episodes"],
            seed=about["seed"],
        )

    @property
    def flown(self) -> str:
        """The number of episodes and their seeds, such as "20 episodes, seeds 0 to 19"."""
        if self.episodes == 1:
            return f"1 episode, seed {self.seed}"
        return f"{self.episodes} episodes, seeds {self.seed} to {self.seed + self.episodes - 1}"

    def __str__(self) -> str:
        """Format all conditions, for example for the caption of a table."""
        return f"{self.task}, difficulty {self.difficulty}, dynamics {self.dynamics}, {self.flown}"
