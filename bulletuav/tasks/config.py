"""Options of tasks and their defaults."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from bulletuav.tasks.given import PLACES

REBOUND = {"soft": 0.8, "hard": 0.0}
"""Coefficient of restitution at the arena's bounds, by value of the option `boundary`"""
DEFAULTS: Mapping[str, Any] = MappingProxyType(
    {
        "num_drones": 1,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 300,
        "max_speed": 10.0,
    }
)
"""Defaults of environment options, unless a task defines others"""


@dataclass(frozen=True)
class TaskConfig:
    """Options of a task. Subclass it as a frozen dataclass to add options.

    Float fields are sizes: finite and not negative. The metadata of a field may set "least", the
    minimum of an integer (default 1), and "most", the maximum of any number (default 1e9). A field
    that a subclass declares again keeps both.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        weights: Reward weights that differ from the task's, by term.
        start: (N, 3) start positions, m, in tasks that accept them; drawn if omitted.
        goal: (N, 3) goal positions, m, in tasks that accept them; drawn if omitted.
        take_off: Whether drones start at rest on the ground below their starts, with rotors
            stopped. They may then touch the ground, see `Frame.landed`.
    """

    d_safe: float = 1.0
    weights: Mapping[str, float] = field(default_factory=dict)
    start: Any = None
    goal: Any = None
    take_off: bool = False

    def __post_init__(self) -> None:
        """Convert arrays to tuples, so that configs can be compared and saved."""
        for name in PLACES:
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and value.ndim == 2:
                object.__setattr__(self, name, tuple(map(tuple, value.tolist())))

    def idle_options(self, num_drones: int) -> Mapping[str, str]:
        """Return the options that have no effect with these values, and why.

        A user who sets one of them gets a ValueError; defaults and difficulties may set them.

        Args:
            num_drones: Maximum number of drones of an episode.

        Returns:
            The reason of each option, such as {"leader_turn": "leader is False"}.
        """
        return {}


ConfigT = TypeVar("ConfigT", bound=TaskConfig)
