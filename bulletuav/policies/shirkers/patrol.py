"""Policies that avoid the task `patrol`."""

import numpy as np

from bulletuav.policies.patrol import CHARGES, PatrolReactive
from bulletuav.registry import register

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
"""Multiples modulo 1 spread choices evenly over the squares"""


@register("policy")
class PatrolRest(PatrolReactive):
    """Fly to the pads, and stay there."""

    name = "patrol_rest"

    def _choose_mode(self, w: int, i: int) -> int:
        """Charge always; see `PatrolPolicy`."""
        return CHARGES


@register("policy")
class PatrolReckless(PatrolReactive):
    """Patrol without charging, until the battery is empty."""

    name = "patrol_reckless"
    charges = False


@register("policy")
class PatrolHalf(PatrolReactive):
    """Patrol the western half of the city only."""

    name = "patrol_half"

    def idleness(self, w: int, i: int, squares: np.ndarray) -> np.ndarray:
        """Return the idleness of the squares in the west; see `PatrolReactive.idleness`."""
        east = self.seen["position"][w, i, 0] + squares[:, 0]
        # Drones in the east fly to the west first
        return np.where(east < 0.0, 1.0 + squares[:, 2], -east)


@register("policy")
class PatrolByOne(PatrolReactive):
    """Patrol with the first drone, while the others stay at the pads."""

    name = "patrol_by_one"

    def _choose_mode(self, w: int, i: int) -> int:
        """Charge always, except for the first drone; see `PatrolPolicy`."""
        return super()._choose_mode(w, i) if i == 0 else CHARGES


@register("policy")
class PatrolBlind(PatrolReactive):
    """Patrol without regard to idleness: fly to one of the nearest squares after the other."""

    name = "patrol_blind"

    def idleness(self, w: int, i: int, squares: np.ndarray) -> np.ndarray:
        """Return 1 for a square that changes over time; see `PatrolReactive.idleness`."""
        step = int(self.aviary.steps[w])
        value = np.zeros(len(squares))
        value[1 + int((len(squares) - 1) * (GOLDEN_RATIO * (step + 17 * i) % 1))] = 1.0
        return value
