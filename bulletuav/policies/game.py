"""Base class of the policies of one team in a game."""

from abc import abstractmethod

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.control.actions.base import limit_each
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import MARGIN, Avoidance
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.mvp import mvp_velocities
from bulletuav.policies.traffic import ObstacleClearance, Traffic
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 1.0
"""Time horizon of conflict detection, s; short, as pursuers of one evader converge"""


class Game(Avoidance):
    """Flight of one team at the maximum speed of its drones.

    Subclasses implement `velocities`. Teammates, obstacles, buildings, the ground and the bounds of
    the arena are avoided as in policy `mvp`; opponents are not. The policy controls all drones as
    members of this team; `TeamPolicies` combines two policies. The goal of each drone is the
    nearest opponent, or the goal of the task if there are no opponents.

    Attributes:
        speed: (N,) maximum speed of each drone, m/s.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Compute the speed limits and the avoidance parameters; see `Policy`."""
        super().__init__(aviary)
        task, body = aviary.task, float(aviary.task.context.collision_radius)
        fastest = float(aviary.options.max_speed)
        limit = task.speed_limit
        self.speed = np.full(aviary.num_drones, fastest) if limit is None else limit.astype(float)
        self.parameters = AvoidanceParameters(
            separation=2 * body + MARGIN,
            horizon=HORIZON,
            braking_time=HORIZON,
            recovery_time=HORIZON,
            max_speed=fastest,
        )
        self.clearance = ObstacleClearance(body, MARGIN, HORIZON * fastest + body + MARGIN)
        self._own = task.team[:, None] == task.team

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the collision-free velocities nearest to `velocities`; see `Policy.act`."""
        traffic = self.traffic(observations, swarm)
        preferred = limit_norm(self.velocities(swarm), self.parameters.max_speed)
        limit_each(preferred, self.speed)
        return self.encoded(self.avoid(traffic, preferred, self.parameters))

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Resolve conflicts among teammates with `mvp_velocities`; see `Avoidance.avoid`."""
        return mvp_velocities(
            traffic._replace(known=traffic.known & self._own), preferred, parameters
        )

    @abstractmethod
    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return the preferred velocities, (W, N, 3) m/s, which are then clipped to `speed`."""

    def full(self, direction: np.ndarray) -> np.ndarray:
        """Return full-speed velocities (W, N, 3) along `direction`; zero for zero vectors."""
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        fastest: np.ndarray = self.speed[:, None] * direction / np.maximum(length, 1e-9)
        return fastest

    def opponents(self) -> np.ndarray:
        """Return which drones j are active opponents of drone i, (W, N, N) bool."""
        opposed: np.ndarray = ~self._own & self.aviary.alive[:, None, :]
        return opposed
