"""A custom task: drones keep an evenly spaced line behind a moving leader.

The goal of the leader moves on a circle. The goal of each other drone is behind the drone in front.

Run it:

    python examples/own/chain.py
    cd examples/own && bulletuav fly chain:Chain --drones 5 --out out
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import bulletuav
from bulletuav.geometry.rotation import Vec3
from bulletuav.tasks import Scene, Spawn, Task, TaskConfig, end, reward
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.ends import collision


@dataclass(frozen=True)
class ChainConfig(TaskConfig):
    """Options of `chain`: m, m/s."""

    spacing: float = 5.0
    leader_speed: float = 4.0
    radius: float = 30.0
    height: float = 10.0


@reward
def uneven(i: int, position: Vec3, all_position: np.ndarray, spacing: float) -> float:
    """Return the error of the horizontal distance to the drone in front, m."""
    if i == 0:
        return 0.0
    front = all_position[i - 1]
    gap = math.hypot(position[0] - front[0], position[1] - front[1])
    return abs(gap - spacing)


@end
def in_place(distance: float, spacing: float) -> bool:
    """Return True if the drone is within a fifth of the spacing of its goal."""
    return distance < spacing / 5


class Chain(Task[ChainConfig]):
    """Keep a line behind the goal of the leader, which moves on a circle.

    Reward, per decision: -0.1 per metre of distance to the goal, -0.1 per metre of spacing error;
    -10 on contact, which ends the episode of the drone.
    """

    name = "chain"
    defaults: ClassVar = {"num_drones": 4, "max_speed": 10.0, "horizon": 200}
    difficulties: ClassVar = {"easy": {}, "hard": {"num_drones": 8, "leader_speed": 8.0}}
    observation = ("velocity", "goal_offset", "goal_velocity", "neighbours")
    reward: ClassVar = {"distance": -0.1, "uneven": (uneven, -0.1), "collision": -10.0}
    ends = (collision,)
    success = in_place

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Start near the goals, at rest."""
        config, count = self.config, self.context.num_drones
        angle = rng.uniform(-np.pi, np.pi) - np.arange(count) * config.spacing / config.radius
        flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        ahead = np.stack([-np.sin(angle), np.cos(angle), np.zeros(count)], axis=1)
        goal = config.radius * flat + (0.0, 0.0, config.height)
        offset = rng.uniform(-1.0, 1.0, (count, 3))
        return Spawn(position=goal + offset, goal=goal, goal_velocity=config.leader_speed * ahead)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Rotate goals and their velocities about the centre."""
        angle = self.context.period * self.config.leader_speed / self.config.radius
        turn = [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        scene.goal[flying] = scene.goal[flying] @ turn
        scene.goal_velocity[flying] = scene.goal_velocity[flying] @ turn
        return False


if __name__ == "__main__":
    bulletuav.check_task(Chain)
    result = bulletuav.evaluate(Chain, "straight", episodes=10)
    for name in ("drone_success", "goal_distance", "return"):
        print(f"{name} {result.estimates()[name].mean:.3f}")
