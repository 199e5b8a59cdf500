"""Start and goal positions that users set instead of having them drawn."""

from typing import NamedTuple

import numpy as np

from bulletuav.tasks.frame import Spawn

PLACES = ("start", "goal")
"""Options that set positions"""


class GivenPositions(NamedTuple):
    """Positions of one world's drones set by the user; None if they are drawn.

    Attributes:
        start: (N, 3) m.
        goal: (N, 3) m.
    """

    start: np.ndarray | None = None
    goal: np.ndarray | None = None

    @property
    def is_empty(self) -> bool:
        """Whether neither starts nor goals are set."""
        return self.start is None and self.goal is None

    def apply_to(self, spawn: Spawn) -> Spawn:
        """Return a spawn with its drawn positions replaced by the given ones."""
        if self.start is not None:
            spawn = spawn._replace(position=self.start)
        return spawn if self.goal is None else spawn._replace(goal=self.goal)
