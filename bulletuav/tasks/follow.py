"""Task `follow`: drones keep their stations about a moving target."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.errors import choose
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.registry import register
from bulletuav.tasks.base import Rngs, Task, TaskConfig, refuse_early_end
from bulletuav.tasks.check import refuse_overlap
from bulletuav.tasks.ends import at_goal, collision, too_far
from bulletuav.tasks.frame import Scene, Spawn, TaskContext
from bulletuav.tasks.rewards.station import speed_to_goal

TARGETS = {
    "vehicle": (Obstacle("box", (3.0, 3.0, 1.6), (0.75, 0.2, 0.15, 1.0)), 0.8, 8.0),
    "drone": (Obstacle("sphere", (0.3,), (0.75, 0.2, 0.15, 1.0)), 20.0, 0.0),
}
"""What can be followed: the body, its height above ground and the stations' height above it, m"""


@dataclass(frozen=True)
class FollowConfig(TaskConfig):
    """Options of `follow`, m, m/s, rad/s.

    The `target` ("vehicle" or "drone") drives at `target_speed`; its heading wanders by `turn` (rad after one second,
    standard deviation) and turns home at `arena` metres from the start. Stations lie on a circle of radius `distance`.
    """

    target: str = "vehicle"
    target_speed: float = 5.0
    turn: float = 0.3
    arena: float = 80.0
    distance: float = 6.0
    start_offset: float = 1.0
    d_safe: float = 2.0
    goal_radius: float = 1.0
    max_distance: float = 40.0


@register("task")
class Follow(Task[FollowConfig]):
    """Keep a station about a moving target, each drone its own.

    The target is a body that can be hit: a ground vehicle or another drone. Stations are spread evenly on a circle of 6 m
    about it, 8 m above a vehicle, level with a drone, and move with it.

    Observation, per drone, Box(16) with the defaults; `bulletuav tasks follow` lists each number:
    Quaternion body to world; goal offset from the drone to its station, velocities in world axes (east, north, up); rates in
    body axes (forward, left, up).

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed;
    10 decisions a second.

    Reward, per decision: alive 1, distance -0.1 a metre to the station, speed -0.05 per m/s relative to it.

    End: terminated on any contact of collision shapes or further than 40 m from the station; truncated after 300 decisions.
    Success: within 1 m of the station.

    Difficulty, target speed / turn: easy 5 m/s, 0.3 rad; medium 8 m/s, 0.5 rad; hard 10 m/s, 0.8 rad; extreme 12 m/s,
    1.2 rad.
    """

    name = "follow"
    defaults: ClassVar = {
        "num_drones": 1,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 300,
        "max_speed": 15.0,
    }
    difficulties: ClassVar = {
        "easy": {},
        "medium": {"target_speed": 8.0, "turn": 0.5},
        "hard": {"target_speed": 10.0, "turn": 0.8},
        "extreme": {"target_speed": 12.0, "turn": 1.2},
    }
    observation = ("attitude", "goal_offset", "velocity", "rates", "goal_velocity")
    reward: ClassVar = {"alive": 1.0, "distance": -0.1, "speed": (speed_to_goal, -0.05)}
    ends = (collision, too_far)
    success = at_goal

    def __init__(self, config: FollowConfig, context: TaskContext):
        """Raises ValueError for an unknown target, stations too close together or a target faster than the drones."""
        super().__init__(config, context)
        self._body, self._height, above = choose("target", config.target, TARGETS)
        if config.target_speed >= context.max_speed:
            raise ValueError(
                f"target_speed {config.target_speed:g} m/s must be below max_speed {context.max_speed:g} m/s"
            )
        angle = 2 * np.pi * np.arange(context.num_drones) / context.num_drones
        circle = config.distance * np.stack(
            [-np.cos(angle), -np.sin(angle), np.zeros(len(angle))], axis=1
        )
        self._station = circle + np.array((0, 0, above))
        refuse_overlap(self._station, context.collision_radius + config.start_offset * np.sqrt(3))
        nearest = float(
            np.linalg.norm(self._station, axis=1).min()
        ) - config.start_offset * np.sqrt(3)
        if nearest <= self._body.radius + context.collision_radius:
            raise ValueError(
                f"distance {config.distance:g} m with start_offset {config.start_offset:g} m is too close to the target, "
                f"whose radius is {self._body.radius:.3g} m"
            )
        lowest = self._height + above - config.start_offset
        if lowest <= context.collision_radius:
            raise ValueError(
                f"start_offset {config.start_offset:g} m is too large: drones could start {lowest:.3g} m up"
            )
        refuse_early_end(config.max_distance, config.start_offset)
        reach = config.arena + config.distance + config.max_distance
        top = self._height + above + config.max_distance
        self.arena_low, self.arena_high = (
            np.array([-reach, -reach, 0.0]),
            np.array([reach, reach, top]),
        )

    def obstacles(self) -> Sequence[Obstacle]:
        """The target."""
        return (self._body,)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """The target at the origin with a random heading, the drones near their stations, at rest."""
        config, n = self.config, self.context.num_drones
        heading = rng.uniform(-np.pi, np.pi)
        target = np.array([[0.0, 0.0, self._height]])
        velocity = config.target_speed * np.array([[np.cos(heading), np.sin(heading), 0.0]])
        offset = rng.uniform(-config.start_offset, config.start_offset, (n, 3))
        goal = target + self._station
        return Spawn(
            position=goal + offset,
            goal=goal,
            goal_velocity=velocity,
            obstacle=target,
            obstacle_velocity=velocity,
        )

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Drive the target of every world that flies, its stations with it."""
        config, period = self.config, self.context.period
        for w in np.flatnonzero(flying).tolist():
            x, y, _ = scene.obstacle[w, 0]
            vx, vy, _ = scene.obstacle_velocity[w, 0]
            turn = config.turn * np.sqrt(period) * rngs[w].standard_normal()
            heading = np.arctan2(vy, vx) + turn
            if np.hypot(x, y) > config.arena and x * vx + y * vy > 0:
                heading = np.arctan2(-y, -x)
            scene.obstacle_velocity[w, 0] = config.target_speed * np.array(
                [np.cos(heading), np.sin(heading), 0.0]
            )
            scene.obstacle[w, 0] += period * scene.obstacle_velocity[w, 0]
            scene.goal[w] = scene.obstacle[w, 0] + self._station
            scene.goal_velocity[w] = scene.obstacle_velocity[w, 0]
        return True
