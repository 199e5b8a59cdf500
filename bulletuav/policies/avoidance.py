"""Base of the policies that fly towards the goal and avoid what is in the way."""

from abc import abstractmethod

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.half_spaces import Rules
from bulletuav.policies.landing import touch_down
from bulletuav.policies.straight import preferred_velocity
from bulletuav.policies.traffic import Clearance, Traffic, buildings, true_traffic
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 4.0
"""Time without conflict that a velocity must give, s: turning at 20 m/s takes about 1 s"""
BRAKING = 2.0
"""Least time in which a velocity may lead to a wall, s: 20 m/s then stop with 10 m/s^2"""
RECOVERY = 1.0
"""Time in which to leave a zone entered, s: within one decision no quadrotor could"""
LOWEST_CORNER = (-np.inf, -np.inf, 0.0)
"""Lower corner of the world, m"""
MARGIN = 1.5
"""Distance beyond d_safe and contact, m: lag, wind and overshoot carry drones off by as much"""


class Avoidance(Policy):
    """Flight towards the goal that avoids what is in the way.

    A policy adds `avoid`, a function of the `Traffic` around drones. That is the true one unless
    the policy is `Observed`.

    Attributes:
        rules: How drones avoid.
        clear: How far they keep away from what stands still.
        box: Low and high corner (3,) of where they fly, m.
    """

    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`."""
        super().__init__(aviary)
        task = aviary.task
        speed = float(aviary.options.max_speed)
        body = float(task.context.collision_radius)
        # Shapes must not touch, even where d_safe is smaller
        self.rules = Rules(
            separation=max(float(task.config.d_safe), 2 * body) + MARGIN,
            horizon=HORIZON,
            braking=BRAKING,
            recovery=RECOVERY,
            max_speed=speed,
        )
        # Far enough to see that braking from full speed is in time
        self.clear = Clearance(body, MARGIN, BRAKING * speed + body + MARGIN)
        # Obstacles as balls, grown by the drone and a margin
        reach = [one.radius + body + MARGIN for one in task.obstacles()]
        self._ball_radius = np.array(reach, dtype=float)
        self.box = np.maximum(task.arena_low, LOWEST_CORNER), np.array(task.arena_high, dtype=float)
        self._stands = buildings(task.layouts())

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the velocities of `avoid`; see `Policy.act`."""
        traffic = self.traffic(observations, swarm)
        wish = preferred_velocity(traffic.goal, traffic.goal_velocity, self.rules.max_speed)
        velocity = self.avoid(traffic, wish, self.rules)
        task = self.aviary.task
        if task.lands:  # else nobody needs to know how high goals are
            goal_height = self.goal_height(observations, traffic)
            velocity = touch_down(velocity, traffic.goal, goal_height, task)
        return self.encoded(velocity)

    def goal_height(self, observations: Observation, traffic: Traffic) -> np.ndarray:
        """Tell how high above the ground goals are, as drones know it, (W, N) m."""
        return self.aviary.scene.goal[..., 2]

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Tell what drones know of the traffic around them."""
        aviary = self.aviary
        scene = aviary.scene
        return true_traffic(
            (swarm.position, swarm.velocity, aviary.alive),
            (scene.goal, scene.goal_velocity),
            (scene.obstacle, scene.obstacle_velocity, self._ball_radius),
            self.box,
            scene.layout,
            self._stands,
            self.clear,
        )

    @abstractmethod
    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Choose velocities.

        Args:
            traffic: What drones know.
            wish: (W, N, 3) velocities straight to the goals, m/s.
            rules: How they avoid.

        Returns:
            (W, N, 3) velocities, m/s.
        """
