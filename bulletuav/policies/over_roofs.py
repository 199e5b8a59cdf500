"""Policy `over_roofs`, which crosses a city as high as it may, and looks at nothing.

It shows what a task in a city asks of the sensors: nothing where this policy comes through.
"""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.readings import Readings, climb, goal_offset
from bulletuav.policies.straight import APPROACH
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

LEVEL = 1.0
"""Greatest distance from the height of the crossing at which a drone flies on, m"""
ABOVE_GOAL = 1.5
"""Horizontal distance from the goal below which a drone descends, m"""


@register("policy")
class OverRoofs(Policy):
    """Climb, level flight to above the goal, and descent, without a look at what stands there."""

    name = "over_roofs"
    actions = ("velocity", "velocity_increment")
    reads_swarm = False

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`.

        Raises:
            ValueError: The action is another one, or the goal or the ceiling is not observed.
        """
        super().__init__(aviary)
        self.readings = Readings(self.name, aviary, ("goal", "room"))

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Climb, cross or descend; see `Policy.act`."""
        told = self.readings(observations)
        offset = goal_offset(told["goal"])
        wanted = crossing(offset, climb(offset, told["room"]))
        return self.encoded(limit_norm(APPROACH * wanted, self.aviary.options.max_speed))


def crossing(offset: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Choose the next piece of the way: up, level towards the goal, or down to it.

    Args:
        offset: (W, N, 3) the way to the goal, m.
        rise: (W, N) the way up to the height of the crossing, m.

    Returns:
        (W, N, 3) the way to the end of the piece, m.
    """
    far = np.linalg.norm(offset[..., :2], axis=-1) > ABOVE_GOAL
    is_level = np.abs(rise) < LEVEL
    piece = offset.copy()
    piece[..., :2][far & ~is_level] = 0.0
    piece[..., 2] = np.where(far, rise, offset[..., 2])
    return piece
