"""Task `flocking`: drones gather to a flock that flies together, behind a virtual leader."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.errors import finite
from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.tasks.base import Weighted
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.goal_flight import (
    REWARD_WEIGHTS,
    TRAINING_WEIGHTS,
    FlightConfig,
    GoalFlight,
)
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.airspace import AirspaceOptions, circle_arena, clearance
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.flocks import (
    linked_groups,
    measure_connectivity,
    measure_correlation,
    measure_directions,
    measure_group_size,
    measure_order,
)
from bulletuav.tasks.parts.holding import HoldingWhere
from bulletuav.tasks.parts.wandering import Wanderer

MAX_DRAWS = 1000
"""Maximum number of draws of a start until it is clear of the others"""
MAX_COVERAGE = 0.4
"""Fraction of the start disc covered by starts, as discs of half their separation, up to which they
are drawn one by one. Such random placement ends at 0.55; denser starts are on a lattice"""
START_LOOSENESS, MAX_START_MARGIN = 2.0, 65.0
"""Default radius of the start disc, as a multiple of that of the lattice, and its maximum distance
beyond the lattice, m: from further away drones would need most of the episode to gather"""
ROOM_FOR_ERRORS = {"spacing": 12.0, "link_range": 18.0}
"""Wider flocks, for drones whose positions have errors of several metres"""
OBSTACLE_SPREAD = 5.0
"""Maximum height of obstacles' centres above and below the flock, m"""


@dataclass(frozen=True)
class FlockingConfig(AirspaceOptions, FlightConfig):
    """Options of `flocking`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        leader: Whether a virtual leader flies ahead of the flock. Without it the flock may fly
            anywhere in the arena, whose walls it has to avoid.
        flock_speed: Speed of the leader, and required speed of the drones, m/s.
        leader_turn: Standard deviation of the random change of the leader's course after one
            second, rad.
        roam: Distance from the origin at which the leader turns back, m.
        leader_distance: Distance of the leader at the start from the centre of the drones, m.
        spacing: Distance between neighbours in a flock of the intended density, m.
        looseness: Radius around the leader in which the flock has to be, as a multiple of that of
            a hexagonal lattice of all drones with this spacing.
        link_range: Distance at which two drones are linked, m. A group is a set of linked drones.
        start_looseness: Radius of the disc in which drones start, as a multiple of that of the
            lattice. By default it is 2, and less where the disc would extend more than 65 m beyond
            the lattice.
        min_order: Minimum order, and minimum cosine between a drone's motion and that of its group.
        min_speed: Minimum speed of a drone, as a fraction of flock_speed; slower drones have no
            direction.
        min_in_place: Fraction of the episode that a drone has to fly in the flock.
        start_speed: Minimum and maximum speed at the start, m/s, in random level directions; the
            default is limited to max_speed.
        jitter: Maximum random offset of a start on each axis, m.
        at_goal: Behaviour at the leader: the flock has to "hold" it.
    """

    leader: bool = True
    flock_speed: float = field(default=6.0, metadata={"most": 100.0})
    leader_turn: float = 0.1
    roam: float = 100.0
    leader_distance: float = 40.0
    spacing: float = 10.0
    looseness: float = 1.3
    link_range: float = 15.0
    start_looseness: float | None = None
    min_order: float = field(default=0.9, metadata={"most": 1.0})
    min_speed: float = field(default=0.5, metadata={"most": 1.0})
    min_in_place: float = 0.6
    start_speed: tuple[float, float] = (2.0, 6.0)
    jitter: float = 0.5
    at_goal: Literal["hold"] = "hold"

    def idle_options(self, num_drones: int) -> Mapping[str, str]:
        """Return the turns of a leader that does not exist; see `TaskConfig.idle_options`."""
        return {} if self.leader else {"leader_turn": "leader is False"}


@reward
def flocking(finished: bool) -> float:
    """1 if the drone flies in the flock."""
    return 1.0 if finished else 0.0


@reward
def alignment(correlation: float) -> float:
    """Mean cosine between the drone's motion and that of others in its group; 0 if it is slow."""
    return correlation


@reward
def cohesion(group_fraction: float) -> float:
    """Fraction of the drones that are in the drone's group."""
    return group_fraction


@reward
def straying(remaining_distance: float, flock_radius: float) -> float:
    """Distance beyond the flock's radius around the leader, m."""
    return max(remaining_distance - flock_radius, 0.0)


@reward
def speed_error(velocity: Vec3, flock_speed: float) -> float:
    """Absolute difference between the drone's speed and flock_speed, m/s."""
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    return abs(speed - flock_speed)


def lattice_radius(drones: int, spacing: float) -> float:
    """Return the radius of a disc with the area of a hexagonal lattice of drones, m.

    A drone has the area sqrt(3) / 2 spacing^2 in a lattice of a given spacing, m.
    """
    return spacing * math.sqrt(math.sqrt(3.0) * drones / (2.0 * math.pi))


@register("task")
class Flocking(GoalFlight[FlockingConfig]):
    """Drones gather to a flock and fly together behind a virtual leader, without places of own.

    The leader is a point that flies level at 6 m/s on a random course, and turns back 100 m from
    the origin. Drones start in a disc around the origin, 40 m from the leader, with random
    velocities. Drones within 15 m are linked; a group is a set of linked drones.

    A drone flies in the flock if its group has more than half of the drones, the order (norm of the
    mean direction of motion) is at least 0.9, its own motion is correlated with that of its group
    by 0.9, its speed is at least half of the leader's, and its distance from the leader is at most
    1.3 times the radius of a lattice of all drones with 10 m between neighbours (hard and extreme
    12 m, and links of 18 m). Without `leader` the last condition is left out, but the task is
    harder: drones disperse unless they look for each other.

    Observation, Box(102) per drone with the defaults, in world axes (east, north, up): position,
    velocity, offset to the leader, the leader's velocity, the 6 nearest active drones and obstacles
    (relative, sorted by distance, and padded with zeros).

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - flocking 2: 1 if the drone flies in the flock.
    - alignment 0.5: mean cosine between its motion and that of others in its group.
    - cohesion 0.5: fraction of the drones in its group.
    - straying -0.05: distance beyond the flock's radius around the leader, m.
    - speed_error -0.1: difference between its speed and flock_speed, m/s.
    - conflict -500: number of drones whose separation falls below d_safe = 5 m.
    - warning -1: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - obstacle_warning -1: sum over obstacles of their proximity, as in `obstacles`.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision outside the flock; if terminated, also 1 per remaining decision.

    End: terminated on contact, when the battery is empty, or outside the arena. Truncated after 500
    decisions; extreme has 750.

    Success: the drone flew in the flock for 60 % of the episode (hard and extreme 50 %), without
    conflict or collision.

    Infos: `order`, `connectivity` (drones minus groups, over drones minus 1), `in_place`.
    """

    name = "flocking"
    baseline = "vasarhelyi"
    oracle = "flock_oracle"
    shirkers: ClassVar = (
        "flock_hover",
        "flock_heading",
        "flock_scatter",
        "flock_clump",
        "flock_unseeing",
        "flock_half",
    )
    defaults: ClassVar = {**GoalFlight.defaults, "num_drones": 16, "num_neighbours": 6}
    presets: ClassVar[dict[str, Mapping[str, Any]]] = {}
    places: ClassVar[tuple[str, ...]] = ("start",)
    observation: ClassVar[tuple[str, ...]] = (
        "position",
        "velocity",
        "goal_offset",
        "goal_velocity",
        "neighbours",
        "obstacles",
    )
    reward: ClassVar[Mapping[str, Weighted]] = {
        **REWARD_WEIGHTS,
        "progress": 0.0,
        "goal": 0.0,
        "conflict": -500.0,
        "warning": -1.0,
        "obstacle_warning": -1.0,
        "flocking": (flocking, 2.0),
        "alignment": (alignment, 0.5),
        "cohesion": (cohesion, 0.5),
        "straying": (straying, -0.05),
        "speed_error": (speed_error, -0.1),
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        **TRAINING_WEIGHTS,
        "goal": 0.0,
        "progress": 0.0,
        "conflict": -3.0,
        "flocking": 0.1,
        "alignment": 0.05,
        "cohesion": 0.02,
        "straying": -0.005,
        "speed_error": -0.01,
    }
    shows: ClassVar = {
        "success": "success",
        "in_place": "in flock",
        "order": "order",
        "connectivity": "connectivity",
        "separation": "nearest (m)",
        "conflicts": "conflicts",
        "collision": "collisions",
    }
    difficulties: ClassVar = {
        "easy": {"num_drones": 8, **UNCERTAINTY["easy"]},
        "medium": {"leader_turn": 0.2, **UNCERTAINTY["medium"]},
        "hard": {
            "num_drones": 30,
            "leader_turn": 0.3,
            "num_obstacles": 12,
            "min_in_place": 0.5,
            **ROOM_FOR_ERRORS,
            **UNCERTAINTY["hard"],
        },
        "extreme": {
            "num_drones": 100,
            "leader_turn": 0.3,
            "num_obstacles": 20,
            "num_moving": 4,
            "min_in_place": 0.5,
            "horizon": 750,
            **ROOM_FOR_ERRORS,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: FlockingConfig, context: TaskContext) -> None:
        """Set the radius of the flock, the start disc and the arena, which grow with the drones.

        Raises:
            ValueError: If the leader is not slower than the drones, distances contradict each
                other, or drones could start in conflict.
        """
        super().__init__(config, context)
        self.holding = self.add(HoldingWhere(config.min_in_place, context, self.finished))
        if not 0 < config.flock_speed < context.max_speed:
            raise ValueError(
                f"flock_speed is {config.flock_speed:g} m/s: more than 0 and less than max_speed "
                f"{context.max_speed:g} m/s is needed"
            )
        apart = clearance(config, context)
        if not apart < config.spacing <= config.link_range:
            raise ValueError(
                f"spacing is {config.spacing:g} m: more than {apart:.3g} m (d_safe) and at most "
                f"link_range {config.link_range:g} m is needed"
            )
        self.lattice_radius = lattice_radius(context.num_drones, config.spacing)
        self.flock_radius = config.looseness * self.lattice_radius
        # Jitter moves two starts towards each other
        self._start_distance = 2 * apart + 2 * np.sqrt(3) * config.jitter
        densest = self._start_distance / config.spacing
        looseness = config.start_looseness
        if looseness is None:
            limit = max(1 + MAX_START_MARGIN / self.lattice_radius, densest)
            looseness = min(START_LOOSENESS, limit)
        looseness = finite("start_looseness", looseness, 0.0, 100.0)
        if context.num_drones > 1 and looseness < densest:
            raise ValueError(
                f"start_looseness is {looseness:g}: starts 2 d_safe apart need {densest:.3g}; "
                f"raise it or spacing, or lower d_safe"
            )
        self._start_radius = looseness * self.lattice_radius
        self._start_pitch = looseness * config.spacing
        discs = context.num_drones * (self._start_distance / 2) ** 2
        self._starts_on_lattice = discs > MAX_COVERAGE * self._start_radius**2
        self.wanderer = Wanderer(
            config.flock_speed, config.leader_turn, config.roam, context.period
        )
        furthest_leader = max(self.wanderer.reach(), config.leader_distance)
        radius = max(furthest_leader + self.flock_radius, self._start_radius)
        self.arena_low, self.arena_high = circle_arena(config, context, radius)
        low, high = self.arena_low.copy(), self.arena_high.copy()
        low[2] = max(config.altitude - OBSTACLE_SPREAD, 0.0)
        high[2] = config.altitude + OBSTACLE_SPREAD
        self.field.bounds = (low, high)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the memory of `GoalFlight`, and "course" (), that the leader follows, rad."""
        return {**super().memory(), "course": ()}

    def quantities(self) -> Mapping[str, Any]:
        """Return the radius of the flock, and each drone's correlation and group for rewards."""
        return {
            **super().quantities(),
            "flock_radius": self.flock_radius if self.config.leader else np.inf,
            "correlation": lambda frame: self._measures(frame)["correlation"],
            "group_fraction": lambda frame: self._measures(frame)["group_fraction"],
        }

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the leader, and starts in a disc, in flight in random directions."""
        config = self.config
        side, course = rng.uniform(-np.pi, np.pi, 2)
        leader, leader_velocity = np.zeros((2, 3))
        leader[2] = config.altitude
        if config.leader:
            leader[:2] = config.leader_distance * np.array([cos(side), sin(side)])
            leader_velocity[:2] = config.flock_speed * np.array([cos(course), sin(course)])
        start = config.scattered(self._draw_starts(rng), rng)
        angle = rng.uniform(-np.pi, np.pi, len(start))
        along = np.stack([cos(angle), sin(angle), np.zeros(len(start))], axis=1)
        goal = np.tile(leader, (len(start), 1))
        memory = {"course": np.array(course)}
        return self.launch(start, goal, rng, along, goal_velocity=leader_velocity, memory=memory)

    def _draw_starts(self, rng: np.random.Generator) -> np.ndarray:
        """Draw starts in a disc at the altitude, clear of each other, (N, 3) m."""
        if self._starts_on_lattice:
            return self._draw_lattice(rng)
        start = np.full((self.context.num_drones, 3), self.config.altitude)
        for i in range(len(start)):
            for _ in range(MAX_DRAWS):
                # The square root makes the density uniform
                radius, angle = (
                    self._start_radius * np.sqrt(rng.random()),
                    rng.uniform(0, 2 * np.pi),
                )
                start[i, :2] = radius * np.array([cos(angle), sin(angle)])
                offset = start[:i, :2] - start[i, :2]
                if ((offset * offset).sum(axis=1) > self._start_distance**2).all():
                    break
        return start

    def _draw_lattice(self, rng: np.random.Generator) -> np.ndarray:
        """Draw starts near the points of a hexagonal lattice in the disc, (N, 3) m."""
        rows = int(np.ceil(1.2 * self._start_radius / self._start_pitch)) + 1
        row = np.arange(-rows, rows + 1)
        column, line = np.meshgrid(row, row)
        lattice = np.stack([column + line / 2, line * np.sqrt(3) / 2], axis=-1).reshape(-1, 2)
        plan = self._start_pitch * (lattice + rng.uniform(-0.5, 0.5, 2))
        nearest = np.argsort((plan**2).sum(axis=1), kind="stable")[: self.context.num_drones]
        # Neighbours may move towards each other by half of what the lattice leaves free each
        free = (self._start_pitch - self._start_distance) / 2
        start = np.full((len(nearest), 3), self.config.altitude)
        start[:, :2] = rng.permutation(plan[nearest])
        start[:, :2] += rng.uniform(-free, free, (len(nearest), 2)) / np.sqrt(2)
        return start

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the leader, and obstacles."""
        if self.config.leader:
            for w in np.flatnonzero(flying).tolist():
                leader, velocity = scene.goal[w, 0].copy(), scene.goal_velocity[w, 0].copy()
                self.wanderer.move(leader, velocity, scene.memory["course"], w, rngs[w])
                scene.goal[w], scene.goal_velocity[w] = leader, velocity
        return super().move_scene(scene, time, flying, rngs)

    def _measures(self, frame: Frame) -> Mapping[str, np.ndarray]:
        """Return the measures of the flocks, computed once for each frame.

        Returns:
            "order" (W,), "connectivity" (W,), "correlation" (W, N), "group_fraction" (W, N).
        """
        known = frame.derived
        if "order" not in known:
            config, alive = self.config, frame.alive
            min_speed = float(config.min_speed * config.flock_speed)
            direction = measure_directions(frame.after.velocity, alive, min_speed)
            group = linked_groups(frame, float(config.link_range))
            known["order"] = measure_order(direction, alive)
            known["connectivity"] = measure_connectivity(group)
            known["correlation"] = measure_correlation(direction, group)
            known["group_fraction"] = measure_group_size(group) / self.context.num_drones
        return known

    def finished(self, frame: Frame) -> np.ndarray:
        """Return which drones fly in the flock, (W, N) bool."""
        config, measures = self.config, self._measures(frame)
        in_flock: np.ndarray = (measures["group_fraction"] > 0.5) & ~frame.collision
        in_flock &= measures["order"][:, None] >= config.min_order
        in_flock &= measures["correlation"] >= config.min_order
        if config.leader:
            in_flock &= frame.distance <= self.flock_radius
        return in_flock

    def arrived(self, frame: Frame) -> np.ndarray:
        """Return which drones fly in the flock, as there are no goals to reach, (W, N) bool."""
        return self.finished(frame)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones flew in the flock for long enough, (W, N) bool."""
        return self.holding.has_held(frame)

    def goals_end(self, frame: Frame, finished: np.ndarray) -> np.ndarray:
        """Return zeros, as flight in the flock ends no episode."""
        return np.zeros_like(finished)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the order and the connectivity of the flock, and the time in the flock."""
        measures, shape = self._measures(frame), frame.alive.shape
        of_world = ("order", "connectivity")
        by_name = {name: np.broadcast_to(measures[name][:, None], shape) for name in of_world}
        return {**super().info(frame), **by_name}
