"""Policies that avoid the task `hover`."""

import numpy as np

from bulletuav.compiled.functions import sin
from bulletuav.policies.shirkers.displaced import HALF, LATE, Displaced
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

BESIDE = 3.0
"""Distance from the target, in radii of success"""
AMPLITUDE, FREQUENCY = 0.5, 3.0
"""Amplitude, m, and angular frequency, rad/s, of passes through the target"""


@register("policy")
class HoverBeside(Displaced):
    """Hover next to the target, outside the radius of success."""

    name = "hover_beside"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return an offset to the east; see `Displaced.offsets`."""
        return np.array((BESIDE * self.aviary.task.config.goal_radius, 0.0, 0.0))


@register("policy")
class HoverLate(HoverBeside):
    """Hover next to the target, and fly to it at the end of the episode."""

    name = "hover_late"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return an offset that ends late; see `Displaced.offsets`."""
        return np.where(self.is_after(LATE), 0.0, super().offsets(swarm))


@register("policy")
class HoverHalf(HoverBeside):
    """Hover at the target for half of the episode, then next to it."""

    name = "hover_half"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return offsets that begin late; see `Displaced.offsets`."""
        return np.where(self.is_after(HALF), super().offsets(swarm), 0.0)


@register("policy")
class HoverPassing(Displaced):
    """Oscillate through the target without stopping there."""

    name = "hover_passing"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return oscillating offsets; see `Displaced.offsets`."""
        time = self.aviary.steps / self.aviary.options.decision_hz
        return AMPLITUDE * sin(FREQUENCY * time)[:, None, None] * (1.0, 0.0, 0.0)
