"""Policy `over_roofs`: crosses a city near the ceiling without sensing obstacles.

A task that this policy solves does not require obstacle sensing.
"""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.readings import (
    cruise_height_difference,
    decode_goal_offset,
    require_blocks,
    unpack_blocks,
)
from bulletuav.policies.straight import APPROACH
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

LEVEL = 1.0
"""Maximum deviation from the cruise height at which a drone cruises, m"""
ABOVE_GOAL = 1.5
"""Horizontal distance to the goal below which a drone descends, m"""


@register("policy")
class OverRoofs(Policy):
    """Climb, cruise at constant height, and descend, without sensing obstacles."""

    name = "over_roofs"
    actions = ("velocity", "velocity_increment")
    reads_swarm = False

    def __init__(self, aviary: Aviary) -> None:
        """Find the observation blocks; see `Policy`.

        Raises:
            ValueError: If the action type is not supported, or the goal or the ceiling is not
                observed.
        """
        super().__init__(aviary)
        require_blocks(self.name, aviary, ("goal", "room"))

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Climb, cruise or descend; see `Policy.act`."""
        seen = unpack_blocks(self.aviary, observations)
        offset = decode_goal_offset(seen["goal"])
        wanted = next_phase(offset, cruise_height_difference(offset, seen["room"]))
        return self.encoded(limit_norm(APPROACH * wanted, self.aviary.options.max_speed))


def next_phase(offset: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Return the offset to the end of the current flight phase: climb, cruise or descent.

    Args:
        offset: (W, N, 3) offset to the goal, m.
        rise: (W, N) height difference to the cruise height, m.

    Returns:
        (W, N, 3) offset to the end of the phase, m.
    """
    far = np.linalg.norm(offset[..., :2], axis=-1) > ABOVE_GOAL
    is_level = np.abs(rise) < LEVEL
    piece = offset.copy()
    piece[..., :2][far & ~is_level] = 0.0
    piece[..., 2] = np.where(far, rise, offset[..., 2])
    return piece
