"""Base of the policies of one side of a game between teams."""

from abc import abstractmethod

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.control.actions.base import limit_each
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import MARGIN, Avoidance
from bulletuav.policies.half_spaces import Rules
from bulletuav.policies.mvp import mvp_velocities
from bulletuav.policies.traffic import Clearance, Traffic
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 1.0
"""Time for which they are avoided, s: those who close in on one evader come near each other"""


class Game(Avoidance):
    """Flight of one side of a game, at the greatest speed that the drones can ask for.

    A policy adds `velocities`. Teammates, obstacles, buildings, the ground and the arena's bounds
    are avoided as in policy `mvp`; opponents are not. All drones fly as that side would: policy
    `teams` joins two sides. Each drone's goal is the nearest opponent, or in tasks without
    opponents the goal of the task.

    Attributes:
        speed: (N,) greatest speed of each drone, m/s.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`."""
        super().__init__(aviary)
        task, body = aviary.task, float(aviary.task.context.collision_radius)
        fastest = float(aviary.options.max_speed)
        limit = task.speed_limit
        self.speed = np.full(aviary.num_drones, fastest) if limit is None else limit.astype(float)
        self.rules = Rules(
            separation=2 * body + MARGIN,
            horizon=HORIZON,
            braking=HORIZON,
            recovery=HORIZON,
            max_speed=fastest,
        )
        self.clear = Clearance(body, MARGIN, HORIZON * fastest + body + MARGIN)
        self._own = task.team[:, None] == task.team

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the velocities of `velocities`, as far as they are clear; see `Policy.act`."""
        traffic = self.traffic(observations, swarm)
        wish = limit_norm(self.velocities(swarm), self.rules.max_speed)
        limit_each(wish, self.speed)
        return self.encoded(self.avoid(traffic, wish, self.rules))

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `mvp_velocities` among teammates; see `Avoidance.avoid`."""
        return mvp_velocities(traffic._replace(known=traffic.known & self._own), wish, rules)

    @abstractmethod
    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose velocities, (W, N, 3) m/s, which are then cut to `speed`."""

    def full(self, way: np.ndarray) -> np.ndarray:
        """Make velocities (W, N, 3) of full speed along ways (W, N, 3), m; zeros where none is."""
        length = np.linalg.norm(way, axis=-1, keepdims=True)
        fastest: np.ndarray = self.speed[:, None] * way / np.maximum(length, 1e-9)
        return fastest

    def opponents(self) -> np.ndarray:
        """Tell which drones j are opponents of i and fly, (W, N, N) bool."""
        opposed: np.ndarray = ~self._own & self.aviary.alive[:, None, :]
        return opposed
