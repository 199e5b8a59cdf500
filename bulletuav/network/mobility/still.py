"""Mobility model of static users."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.network.mobility.base import Generators, Mobility, State
from bulletuav.network.mobility.ground import Ground
from bulletuav.registry import register


@register("mobility")
@dataclass(frozen=True)
class Still(Mobility):
    """Static users, uniformly distributed over free ground."""

    name: ClassVar[str] = "still"

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw random positions, see `Mobility.start`."""
        return {"users": ground.places(rng, layout, count), "user_velocity": np.zeros((count, 2))}

    def _move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Do nothing."""
