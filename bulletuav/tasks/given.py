"""Starts and goals that users set instead of having them drawn."""

from typing import NamedTuple

import numpy as np

from bulletuav.tasks.frame import Spawn

PLACES = ("start", "goal")
"""Options that set positions"""
MOTIONS = ("velocity", "quaternion", "rates")
"""Options of a reset that set the motion at the start"""
CHARGE = "charge"
"""Option of a reset that sets the charge of batteries"""


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


class GivenMotion(NamedTuple):
    """Motion of one world's drones at the start, set by the user; None if it is drawn.

    Attributes:
        velocity: (N, 3) m/s, in world axes.
        quaternion: (N, 4) body to world.
        rates: (N, 3) body rates, rad/s.
    """

    velocity: np.ndarray | None = None
    quaternion: np.ndarray | None = None
    rates: np.ndarray | None = None

    def apply_to(self, spawn: Spawn) -> Spawn:
        """Return a spawn with its drawn motion replaced by the given one."""
        given = {name: value for name, value in self._asdict().items() if value is not None}
        return spawn._replace(**given)


class GivenStart(NamedTuple):
    """Start of one world's drones, as far as the user sets it.

    Attributes:
        positions: Starts and goals.
        motion: Motion at the start.
        charge: (N,) charge of the batteries, from above 0 to 1; None for full batteries.
    """

    positions: GivenPositions = GivenPositions()
    motion: GivenMotion = GivenMotion()
    charge: np.ndarray | None = None


DRAWN = GivenStart()
"""Start of which the user sets nothing"""
