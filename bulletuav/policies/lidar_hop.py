"""Policy `lidar_hop`: flies to the goal and climbs if the range finder detects a wall."""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.readings import (
    CEILING_MARGIN,
    decode_goal_offset,
    require_blocks,
    unpack_blocks,
)
from bulletuav.policies.straight import APPROACH
from bulletuav.policies.street_map import level_beams
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

SPEED = 6.0
"""Maximum speed, m/s: a Hummingbird then stops within BLOCKED"""
BLOCKED = 12.0
"""Range of a beam towards the goal below which the path is blocked, m"""
CONE = 0.8
"""Cosine of the maximum angle between the goal direction and a beam towards it"""


@register("policy")
class LidarHop(Policy):
    """Flight to the goal, with a climb up to the ceiling if an obstacle blocks the path."""

    name = "lidar_hop"
    actions = ("velocity", "velocity_increment")
    reads_swarm = False

    def __init__(self, aviary: Aviary) -> None:
        """Find the observation blocks and the level beams; see `Policy`.

        Raises:
            ValueError: If the action type is not supported, or a required block is not observed.
        """
        super().__init__(aviary)
        require_blocks(self.name, aviary, ("goal", "room", "lidar"))
        self._chosen, self._directions = level_beams(aviary)

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Fly to the goal, or climb if the path is blocked; see `Policy.act`."""
        seen = unpack_blocks(self.aviary, observations)
        offset = decode_goal_offset(seen["goal"])
        flat = np.linalg.norm(offset[..., :2], axis=-1, keepdims=True)
        towards = offset[..., :2] / np.maximum(flat, 1e-9)
        # Obstacles on beams towards the goal, nearer than the goal.
        cosine = towards @ self._directions.T
        near = seen["lidar"][..., self._chosen] < np.minimum(BLOCKED, flat)
        blocked = ((cosine > CONE) & near).any(axis=-1)
        # Fly level until above the goal, then descend, so as not to descend onto an obstacle.
        wanted = np.zeros(offset.shape)
        wanted[..., :2] = np.where(blocked[..., None], 0.0, offset[..., :2])
        over = flat[..., 0] < BLOCKED
        wanted[..., 2] = np.where(over & ~blocked, offset[..., 2], 0.0)
        wanted[..., 2] = np.where(blocked, seen["room"][..., 2] - CEILING_MARGIN, wanted[..., 2])
        return self.encoded(limit_norm(APPROACH * wanted, SPEED))
