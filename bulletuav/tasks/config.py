"""Options of a task."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from bulletuav.tasks.given import PLACES

REBOUND = {"soft": 0.8, "hard": 0.0}
"""Share of the speed against a wall that is left, reversed, by the option `boundary`"""
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
"""Options of a task that tells nothing else"""


@dataclass(frozen=True)
class TaskConfig:
    """Options of a task beside those that all tasks have. Derive from it, as a frozen dataclass.

    Float fields are sizes: finite and not negative. A field's metadata may tell the "least" of a
    whole number (1 unless told), and the "most" of any number (1e9 unless told).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        weights: Changes of the weights of reward terms, by name.
        start: (N, 3) where drones start, m, in tasks that take it; drawn when left out.
        goal: (N, 3) where they are to go, m, in tasks that take it; drawn when left out.
        take_off: Whether drones start at rest on the ground below their starts, with rotors that
            stand still. They may then touch the ground, see `Frame.landed`.
    """

    d_safe: float = 1.0
    weights: Mapping[str, float] = field(default_factory=dict)
    start: Any = None
    goal: Any = None
    take_off: bool = False

    def __post_init__(self) -> None:
        """Keep arrays as tuples, so that configs can be compared and written."""
        for name in PLACES:
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and value.ndim == 2:
                object.__setattr__(self, name, tuple(map(tuple, value.tolist())))


ConfigT = TypeVar("ConfigT", bound=TaskConfig)
