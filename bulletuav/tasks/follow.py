"""Task `follow`: drones keep their stations about a moving target."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from bulletuav.errors import choose
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.tasks.base import (
    Frame,
    Scene,
    Spawn,
    StepResult,
    Task,
    TaskContext,
    refuse_early_end,
)
from bulletuav.tasks.check import refuse_overlap

TARGETS = {
    "vehicle": (Obstacle("box", (3.0, 3.0, 1.6), (0.75, 0.2, 0.15, 1.0)), 0.8, 8.0),
    "drone": (Obstacle("sphere", (0.3,), (0.75, 0.2, 0.15, 1.0)), 20.0, 0.0),
}
"""What can be followed: the body, its height above ground and the stations' height above it, m"""


@dataclass(frozen=True)
class FollowConfig:
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
    weights: Mapping[str, float] = field(default_factory=dict)


class Follow(Task):
    """Keep a station about a moving target, each drone its own.

    The target is a body that can be hit: a ground vehicle or another drone. Stations are spread evenly on a circle of 6 m
    about it, 8 m above a vehicle, level with a drone, and move with it.

    Observation, per drone, Box(16) float32, clipped to its bounds (here for max_speed 15):
      0  quaternion x             1      [-1, 1]
      1  quaternion y             1      [-1, 1]
      2  quaternion z             1      [-1, 1]
      3  quaternion w             1      [0, 1]
      4  goal offset x            m      [-252, 252]
      5  goal offset y            m      [-252, 252]
      6  goal offset z            m      [-48.8, 48.8]
      7  velocity x               m/s    [-30, 30]
      8  velocity y               m/s    [-30, 30]
      9  velocity z               m/s    [-30, 30]
     10  rates x                  rad/s  [-50, 50]
     11  rates y                  rad/s  [-50, 50]
     12  rates z                  rad/s  [-50, 50]
     13  goal velocity x          m/s    [-30, 30]
     14  goal velocity y          m/s    [-30, 30]
     15  goal velocity z          m/s    [-30, 30]
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
    Config = FollowConfig
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
    reward_weights: ClassVar = {"alive": 1.0, "distance": -0.1, "speed": -0.05}

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
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        return Spawn(
            goal + offset,
            upright,
            np.zeros((n, 3)),
            np.zeros((n, 3)),
            goal,
            velocity,
            target,
            velocity,
        )

    def advance(
        self,
        scene: Scene,
        time: np.ndarray,
        flying: np.ndarray,
        rng: Sequence[np.random.Generator | None],
    ) -> bool:
        """Drive the target of every world that flies, its stations with it."""
        config, period = self.config, self.context.period
        for w in np.flatnonzero(flying).tolist():
            generator = rng[w]
            assert generator is not None  # a world that flies was reset
            x, y, _ = scene.obstacle[w, 0]
            vx, vy, _ = scene.obstacle_velocity[w, 0]
            heading = (
                np.arctan2(vy, vx) + config.turn * np.sqrt(period) * generator.standard_normal()
            )
            if np.hypot(x, y) > config.arena and x * vx + y * vy > 0:
                heading = np.arctan2(-y, -x)
            scene.obstacle_velocity[w, 0] = config.target_speed * np.array(
                [np.cos(heading), np.sin(heading), 0.0]
            )
            scene.obstacle[w, 0] += period * scene.obstacle_velocity[w, 0]
            scene.goal[w] = scene.obstacle[w, 0] + self._station
            scene.goal_velocity[w] = scene.obstacle_velocity[w, 0]
        return True

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Being there, distance to the station (m) and speed relative to it (m/s).

        Ends: contact, or too far away. Success: at the station.
        """
        speed = np.linalg.norm(frame.after.velocity - frame.scene.goal_velocity, axis=-1)
        terms = {"alive": np.ones(frame.alive.shape), "distance": frame.distance, "speed": speed}
        lost = frame.collision | (frame.distance > self.config.max_distance)
        return StepResult(terms, lost, frame.distance <= self.config.goal_radius)
