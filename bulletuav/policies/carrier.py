"""Policy `carrier`: carries a load on cables to its place, and sets it down, from observations."""

from typing import NamedTuple

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy, require_supported_task
from bulletuav.policies.readings import require_blocks, unpack_blocks
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.transport import Transport
from bulletuav.vehicle.swarm import Swarm

NEEDED = ("load", "cable", "load_goal_offset")
"""Blocks that the policy reads"""
CARRY_HEIGHT = 0.6
"""Height above the ground at which loads are carried, m"""
LIFTED = 0.25
"""Height at which a load starts to move to its place, m"""
NEAR = 0.5
"""Horizontal distance from the place at which a load is lowered, m"""
THERE, PLACED = 2.5, 1.25
"""Ratios of the radius of the place to horizontal distances from it: from the smaller distance on
loads are lowered to the ground, and within the larger one loads on the ground stay there"""
LOAD_GAIN, SPEED_GAIN = 0.6, 0.4
"""Gains from the offset of a load to its speed, 1/s, and from its speed error to that of drones"""
INTEGRAL_GAIN, MAX_INTEGRAL = 0.25, 1.5
"""Gain from the integral of the offset near the place to the speed of drones, 1/s^2, and the limit
of this speed, m/s: the wind moves loads aside"""
HEIGHT_GAIN = 1.0
"""Gain from the height error of the load to its speed, 1/s"""
CARRY_SPEED, CLIMB, SINK = 1.2, 0.6, 0.3
"""Maximum horizontal speed of loads, and speeds of lifting and lowering, m/s"""
FORMATION_GAIN = 1.5
"""Gain from the offset of a drone to its place above the load to its speed, 1/s"""
GROUND = 0.03
"""Height up to which a load is taken to be on the ground, m"""
SLACK = 0.2
"""Fraction of the cable by which drones descend when the load stands"""


class LoadView(NamedTuple):
    """What each drone observes of the load.

    Attributes:
        offset: (W, N, 3) from the load to its place, m.
        position: (W, N, 3) of the load relative to the drone, m.
        velocity: (W, N, 3) of the load, m/s.
        end: (W, N, 3) from the drone to the end of its cable, m.
    """

    offset: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    end: np.ndarray


@register("policy")
class Carrier(Policy):
    """Cascaded control of the load: its place, its velocity, and places of drones above it.

    Each drone hovers vertically above the end of its cable and adds the velocity that the load
    should have. The load is lifted, moved with a limited speed, lowered in its place, and the
    cables are then made slack. The controllers of the drones learn its weight.
    """

    name = "carrier"
    actions = ("velocity",)
    reads_swarm = False
    remembers = ("_drift",)

    def __init__(self, aviary: Aviary) -> None:
        """Check the task and its observation; see `Policy`.

        Raises:
            ValueError: If the task is another one, or a block is not observed.
        """
        super().__init__(aviary)
        self.task = require_supported_task(self, Transport)
        require_blocks(self.name, aviary, NEEDED)
        radius = self.task.config.place_radius
        self._there, self._placed = radius / THERE, radius / PLACED
        self._drift = np.zeros((*aviary.alive.shape, 2))

    def reset(self, mask: np.ndarray) -> None:
        """Forget the integrals of the worlds of `mask` (W,)."""
        self._drift[mask] = 0.0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities; see `Policy.act`."""
        view = self.view(observations, swarm)
        return self.encoded(limit_norm(self.plan(view), self.aviary.options.max_speed))

    def view(self, observations: Observation, swarm: Swarm) -> LoadView:
        """Return what each drone observes of the load."""
        seen = unpack_blocks(self.aviary, observations)
        return LoadView(
            offset=seen["load_goal_offset"],
            position=seen["load"][..., :3],
            velocity=seen["load"][..., 3:6],
            end=seen["cable"][..., :3],
        )

    def plan(self, view: LoadView) -> np.ndarray:
        """Return the velocities (W, N, 3) of the drones, m/s."""
        across = horizontal_distance(view.offset)
        height = -view.offset[..., 2]
        stands = (height < GROUND) & (across < self._placed)
        speed = self.load_velocity(view)
        speed[stands] = 0.0
        # Against the swing: towards the speed that the load should have
        damping = SPEED_GAIN * (speed[..., :2] - view.velocity[..., :2])
        velocity = speed.copy()
        velocity[..., :2] += np.where(stands[..., None], 0.0, damping)
        is_near = (across < 2 * NEAR) & ~stands & (height > GROUND)
        gain = INTEGRAL_GAIN / self.aviary.options.decision_hz
        self._drift += np.where(is_near[..., None], gain * view.offset[..., :2], 0.0)
        self._drift[:] = limit_norm(self._drift, MAX_INTEGRAL)
        velocity[..., :2] += self._drift
        # Above the end of the cable
        length = self.task.config.cable_length
        place = view.end.copy()
        place[..., 2] += np.where(stands, 1.0 - SLACK, 1.0) * length
        velocity += FORMATION_GAIN * place
        return velocity

    def load_velocity(self, view: LoadView) -> np.ndarray:
        """Return the velocity (W, N, 3) that the load should have, m/s: up, across, and down."""
        across = horizontal_distance(view.offset)
        height = -view.offset[..., 2]
        wanted = CARRY_HEIGHT * np.clip((across - self._there) / (NEAR - self._there), 0.0, 1.0)
        # Lifted before it moves
        is_free = np.clip((height - GROUND) / (LIFTED - GROUND), 0.0, 1.0)
        speed = np.zeros_like(view.offset)
        towards = limit_norm(LOAD_GAIN * view.offset[..., :2], CARRY_SPEED)
        speed[..., :2] = is_free[..., None] * towards
        speed[..., 2] = np.clip(HEIGHT_GAIN * (wanted - height), -SINK, CLIMB)
        return speed


def horizontal_distance(offset: np.ndarray) -> np.ndarray:
    """Return the horizontal lengths (W, N) of vectors (W, N, 3)."""
    length: np.ndarray = np.sqrt((offset[..., :2] ** 2).sum(axis=-1))
    return length
