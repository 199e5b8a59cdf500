"""Base class of the policies that fly to the goal and avoid collisions."""

from abc import abstractmethod

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.landing import touch_down
from bulletuav.policies.straight import preferred_velocity
from bulletuav.policies.traffic import ObstacleClearance, Traffic, tabulate_buildings, true_traffic
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 4.0
"""Time horizon tau of conflict detection, s: a turn at 20 m/s takes about 1 s"""
BRAKING = 2.0
"""Minimum time to reach a wall at the chosen velocity, s: 20 m/s then stop with 10 m/s^2"""
RECOVERY = 1.0
"""Time in which a drone leaves a violated separation zone, s; no quadrotor could do so within
one decision"""
LOWEST_CORNER = (-np.inf, -np.inf, 0.0)
"""Lower corner of the world, m"""
MARGIN = 1.5
"""Margin added to d_safe and to the contact distance, m: lag, wind and overshoot displace drones
by as much"""


class Avoidance(Policy):
    """Flight to the goal with collision avoidance.

    Subclasses implement `avoid`, which maps the `Traffic` around the drones to velocities.
    `Traffic` is the true state unless the policy derives from `Observed`.

    Attributes:
        parameters: Parameters of collision avoidance.
        clearance: Distances to static obstacles.
        sphere_radius: (K,) distances to maintain from the centres of obstacles, m; 0 for none.
        box: Lower and upper corner (3,) of the arena, m.
        max_distance: Distance beyond which `avoid` ignores other drones, m.
        searches_drones: Whether `avoid` searches large swarms itself; see `true_traffic`.
    """

    actions = ("velocity", "velocity_increment")
    reads_swarm = True
    max_distance = np.inf
    searches_drones = False

    def __init__(self, aviary: Aviary) -> None:
        """Compute the avoidance parameters from the task and the options; see `Policy`."""
        super().__init__(aviary)
        task = aviary.task
        speed = float(aviary.options.max_speed)
        body = float(task.context.collision_radius)
        # Collision shapes must not overlap, even if d_safe is smaller
        self.parameters = AvoidanceParameters(
            separation=max(float(task.config.d_safe), 2 * body) + MARGIN,
            horizon=HORIZON,
            braking_time=BRAKING,
            recovery_time=RECOVERY,
            max_speed=speed,
        )
        # Surfaces within the braking distance from full speed are considered
        self.clearance = ObstacleClearance(body, MARGIN, BRAKING * speed + body + MARGIN)
        # Bounding spheres of the obstacles, inflated by the drone's radius and the margin
        radii = [one.radius + body + MARGIN for one in task.obstacles()]
        self.sphere_radius = np.array(radii, dtype=float)
        self.box = np.maximum(task.arena_low, LOWEST_CORNER), np.array(task.arena_high, dtype=float)
        self._buildings = tabulate_buildings(task.layouts())

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the velocities of `avoid`; see `Policy.act`."""
        traffic = self.traffic(observations, swarm)
        velocity = self.avoid(traffic, self.preferred(traffic, swarm), self.parameters)
        task = self.aviary.task
        if task.lands:  # the height of the goals matters for landing only
            goal_height = self.goal_height(observations, traffic)
            velocity = touch_down(velocity, traffic.goal, goal_height, task)
        return self.encoded(velocity)

    def preferred(self, traffic: Traffic, swarm: Swarm) -> np.ndarray:
        """Return the velocities without other traffic, (W, N, 3) m/s; by default to the goals."""
        return preferred_velocity(traffic.goal, traffic.goal_velocity, self.parameters.max_speed)

    def goal_height(self, observations: Observation, traffic: Traffic) -> np.ndarray:
        """Return the heights of the goals above ground as the drones know them, (W, N) m."""
        return self.aviary.scene.goal[..., 2]

    def spheres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return spheres to avoid: positions and velocities (W, K, 3), and distances (K,), m."""
        scene = self.aviary.scene
        return scene.obstacle, scene.obstacle_velocity, self.sphere_radius

    def _with_bodies(
        self, place: np.ndarray, velocity: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Add the bounding spheres of the bodies of option `bodies` to spheres; see `spheres`."""
        count = self.aviary.worlds.bodies.count
        if not count:
            return place, velocity, radius
        bodies = self.aviary.worlds.engine.scenery.bodies
        keep = bodies.reach[:count] + float(self.aviary.task.context.collision_radius) + MARGIN
        return (
            np.concatenate([place, bodies.position[:, :count]], axis=1),
            np.concatenate([velocity, bodies.velocity[:, :count]], axis=1),
            np.concatenate([radius, keep]),
        )

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic around each drone as the drones know it."""
        aviary = self.aviary
        scene = aviary.scene
        return true_traffic(
            (swarm.position, swarm.velocity, aviary.alive),
            (scene.goal, scene.goal_velocity),
            self._with_bodies(*self.spheres()),
            self.box,
            scene.layout,
            self._buildings,
            self.clearance,
            self.max_distance,
            self.searches_drones,
        )

    @abstractmethod
    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Choose collision-free velocities.

        Args:
            traffic: The traffic around each drone.
            preferred: (W, N, 3) preferred velocities, m/s.
            parameters: Parameters of collision avoidance.

        Returns:
            (W, N, 3) velocities, m/s.
        """
