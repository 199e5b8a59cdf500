"""Starts and goals that users give instead of having them drawn."""

from typing import NamedTuple

import numpy as np

from bulletuav.tasks.frame import Spawn

PLACES = ("start", "goal")
"""Options that give places"""


class GivenPositions(NamedTuple):
    """Places of one world's drones that are given; None where they are drawn.

    Attributes:
        start: (N, 3) m.
        goal: (N, 3) m.
    """

    start: np.ndarray | None = None
    goal: np.ndarray | None = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing is given."""
        return self.start is None and self.goal is None

    def apply_to(self, spawn: Spawn) -> Spawn:
        """Replace what was drawn by what is given."""
        if self.start is not None:
            spawn = spawn._replace(position=self.start)
        return spawn if self.goal is None else spawn._replace(goal=self.goal)
