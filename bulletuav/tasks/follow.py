"""Task `follow`: drones keep their stations around a moving target."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.errors import find_choice
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, held, too_far
from bulletuav.tasks.frame import Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.holding import Holding
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.wandering import Wanderer
from bulletuav.tasks.rewards.station import speed_to_goal
from bulletuav.tasks.starts import check_start_distance

RED = (0.75, 0.2, 0.15, 1.0)
"""Colour of targets, RGBA"""


class FollowTarget(NamedTuple):
    """A body that drones can follow.

    Attributes:
        body: Its shape.
        height: Height of its centre above ground, m.
        station_height: Height of the stations above its centre, m.
    """

    body: Obstacle
    height: float
    station_height: float


TARGETS = {
    "vehicle": FollowTarget(
        body=Obstacle("box", (3.0, 3.0, 1.6), RED), height=0.8, station_height=8.0
    ),
    "drone": FollowTarget(body=Obstacle("sphere", (0.3,), RED), height=20.0, station_height=0.0),
}
"""Bodies that drones can follow, by name"""


@dataclass(frozen=True)
class FollowConfig(TaskConfig):
    """Options of `follow`, in addition to those of every task.

    Attributes:
        target: Kind of target: "vehicle" or "drone".
        target_speed: Speed of the target, m/s.
        turn: Standard deviation of the random change of the target's course after one second, rad.
            The heading follows the course as fast as a car could, see `Wanderer`.
        arena: Distance from the start at which the target turns back, m.
        distance: Radius of the circle of stations around the target, m.
        start_offset: Maximum offset of a start from its station on each axis, m.
        d_safe: Separation below which two drones are in conflict, m.
        goal_radius: Distance from the station within which a drone is in place, m.
        min_in_place: Fraction of the episode that a drone has to be in place.
        max_distance: Distance from the station at which an episode ends, m.
    """

    target: str = "vehicle"
    target_speed: float = 5.0
    turn: float = 0.3
    arena: float = 80.0
    distance: float = 6.0
    start_offset: float = 1.0
    d_safe: float = 2.0
    goal_radius: float = 1.0
    min_in_place: float = 0.9
    max_distance: float = 40.0


@reward
def lost(
    collision: bool,
    distance: float,
    max_distance: float,
    time: float,
    duration: float,
    period: float,
) -> float:
    """Count the remaining decisions when the drone's episode terminates."""
    return (duration - time) / period if collision or distance > max_distance else 0.0


@register("task")
class Follow(Task[FollowConfig]):
    """Drones keep their stations around a moving target.

    The target is a solid body: a ground vehicle or another drone. It moves at constant speed with a
    randomly varying heading, and turns back 80 m from its start. The stations are evenly spaced on
    a circle of radius 6 m around the target, 8 m above a vehicle or level with a drone, and move
    with it. Drones start at rest near their stations.

    Observation, Box(16) per drone with the defaults: attitude as a quaternion, body to world;
    offset from the drone to its station, velocity and the station's velocity in world axes (east,
    north, up); rates in body axes (forward, left, up).

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - alive 1: 1 per decision.
    - holding 2: 1 within 1 m of the station.
    - distance -0.1: distance to the station, m.
    - speed -0.05: speed relative to the station, m/s.
    - lost -1: number of remaining decisions when the drone's episode terminates.

    End: terminated on any contact of collision shapes, or farther than 40 m from the station.
    Truncated after 300 decisions.

    Success: the drone was within 1 m of its station for 90 % of the episode (extreme 85 %), without
    conflict or collision.

    Infos: `in_place` is the fraction of the time for which the drone was within 1 m.
    """

    version = 2
    name = "follow"
    baseline = "station_keeper"
    shirkers: ClassVar = ("follow_above", "follow_behind", "follow_late", "follow_half")
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
        "extreme": {"target_speed": 12.0, "turn": 1.2, "min_in_place": 0.85},
    }
    observation = ("attitude", "goal_offset", "velocity", "rates", "goal_velocity")
    reward: ClassVar = {
        "alive": 1.0,
        "holding": 2.0,
        "distance": -0.1,
        "speed": (speed_to_goal, -0.05),
        "lost": (lost, -1.0),
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        "alive": 0.1,
        "holding": 0.2,
        "distance": -0.02,
        "speed": -0.01,
        "lost": -0.03,
    }
    shows: ClassVar = {
        "success": "success",
        "in_place": "at station",
        "collision": "collisions",
        "goal_distance": "to station (m)",
    }
    ends = (collision, too_far)
    success = held

    def __init__(self, config: FollowConfig, context: TaskContext) -> None:
        """Place the stations around the target, and set the arena.

        Raises:
            ValueError: If the target is unknown or faster than the drones, stations are too close
                together, or drones could start touching the target or the ground.
        """
        super().__init__(config, context)
        self.safety = self.add(Safety(context.num_drones))
        self.add(Holding(config.min_in_place, context, config.goal_radius))
        target = find_choice("target", config.target, TARGETS)
        self._body = target.body
        self._height = target.height
        if config.target_speed >= context.max_speed:
            raise ValueError(
                f"target_speed {config.target_speed:g} m/s "
                f"must be below max_speed {context.max_speed:g} m/s"
            )
        # Stations relative to the target, the first to its west
        angle = 2 * np.pi * np.arange(context.num_drones) / context.num_drones
        directions = np.stack([-cos(angle), -sin(angle), np.zeros(len(angle))], axis=1)
        circle = config.distance * directions
        self._station = circle + np.array((0, 0, target.station_height))
        self._check_start(target)
        check_start_distance(config.max_distance, config.start_offset)
        motion = (config.target_speed, config.turn, config.arena, context.period)
        self._wanderer = Wanderer(*motion)
        half_side = self._wanderer.reach() + config.distance + config.max_distance
        top = self._height + target.station_height + config.max_distance
        self.arena_low = np.array([-half_side, -half_side, 0.0])
        self.arena_high = np.array([half_side, half_side, top])

    def _check_start(self, target: FollowTarget) -> None:
        """Check that starts cannot touch each other, the target or the ground."""
        config = self.config
        radius = self.context.collision_radius
        # Worst case: an offset on all three axes
        largest_offset = config.start_offset * np.sqrt(3)
        drones, needed = self.context.num_drones, 2 * (radius + largest_offset)
        between = 2 * config.distance * sin(np.pi / max(drones, 2))
        if drones > 1 and between <= needed:
            raise ValueError(
                f"{drones} stations on a circle with distance {config.distance:g} m from the "
                f"target are {between:.3g} m apart, and more than {needed:.3g} m is needed: raise "
                f"distance, or lower start_offset or num_drones"
            )
        nearest = float(np.linalg.norm(self._station, axis=1).min()) - largest_offset
        if nearest <= target.body.radius + radius:
            raise ValueError(
                f"distance {config.distance:g} m with start_offset {config.start_offset:g} m "
                f"is too close to the target, whose radius is {target.body.radius:.3g} m"
            )
        lowest = target.height + target.station_height - config.start_offset
        if lowest <= radius:
            raise ValueError(
                f"start_offset {config.start_offset:g} m is too large: "
                f"drones could start {lowest:.3g} m up"
            )

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the target, which is the only obstacle."""
        return (self._body,)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of "course" (), the course of the target, rad, and of the parts."""
        return {**super().memory(), "course": ()}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the target's heading at the origin, and starts at rest near the stations."""
        config = self.config
        heading = rng.uniform(-np.pi, np.pi)
        target = np.array([[0.0, 0.0, self._height]])
        velocity = config.target_speed * np.array([[cos(heading), sin(heading), 0.0]])
        shape = (self.context.num_drones, 3)
        offset = rng.uniform(-config.start_offset, config.start_offset, shape)
        station = target + self._station
        return Spawn(
            position=station + offset,
            goal=station,
            goal_velocity=velocity,
            obstacle=target,
            obstacle_velocity=velocity,
            memory={"course": np.array(heading)},
        )

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the target of every flying world, and its stations with it.

        Returns:
            True, as the target moves.
        """
        for w in np.flatnonzero(flying).tolist():
            position, velocity = scene.obstacle[w, 0], scene.obstacle_velocity[w, 0]
            self._wanderer.move(position, velocity, scene.memory["course"], w, rngs[w])
            scene.goal[w] = position + self._station
            scene.goal_velocity[w] = velocity
        return True
