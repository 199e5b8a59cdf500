"""Base class of flights of several drones to goals: options, rewards and ends."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.tasks.base import Task, Weighted
from bulletuav.tasks.config import REBOUND, TaskConfig
from bulletuav.tasks.ends import affected_drones
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.given import PLACES
from bulletuav.tasks.parts.base import Part, Rngs, Starts
from bulletuav.tasks.parts.draws import get_random_source
from bulletuav.tasks.parts.headings import draw_velocities
from bulletuav.tasks.parts.obstacle_field import ObstacleField, ObstacleOptions
from bulletuav.tasks.parts.presets import UAVCONFLICT
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.rewards.airspace import (
    sum_obstacle_nearness,
    update_encounters,
    variance_nearby,
)

REWARD_WEIGHTS = {
    "progress": 5.0,
    "goal": 50.0,
    "conflict": -200.0,
    "warning": -5.0,
    "collision": -200.0,
    "obstacle_warning": -5.0,
    "out_of_bounds": -50.0,
    "energy": -0.01,
    "efficiency": 0.0,
    "speed_keeping": 0.0,
    "time": -0.5,
    "shaping": 0.0,
    "fairness": 0.0,
    "concession": 0.0,
}
"""Weights of the reward terms of all flights to goals"""
CITY_REWARD_WEIGHTS = {**REWARD_WEIGHTS, "goal": 300.0}
"""Weights in cities; at 50, drones that stop just before the goal earn nine tenths of the pay"""
GOAL_FLIGHT_SHIRKERS = ("stop_short", "fly_over", "leave_near_goal")
"""Policies that try to be paid for flights to goals without doing them; see `Task.shirkers`"""
TRAINING_WEIGHTS = {
    "progress": 0.05,
    "goal": 2.0,
    "conflict": -6.0,
    "warning": -0.1,
    "collision": -5.0,
    "obstacle_warning": -0.1,
    "out_of_bounds": -5.0,
    "energy": -0.0005,
    "time": -0.02,
}
"""Weights for training in all flights to goals: returns of the order of 1, which networks fit"""


@dataclass(frozen=True)
class FlightConfig(ObstacleOptions, TaskConfig):
    """Options of all flights to goals, in addition to those of obstacles (`ObstacleOptions`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Minimum and maximum speed at the start, m/s; the default is limited to
            max_speed.
        goal_radius: Distance from the goal within which it is reached, m.
        at_goal: Behaviour at the goal. "leave": the drone leaves the airspace. "land": the drone
            first has to land on the ground below, see `Frame.landed`. "hold": the drone stays,
            until all flying drones are at their goals.
        boundary: Behaviour outside the arena. "end": the drone's episode ends. "soft": the drone
            rebounds with 0.8 of its speed. "hard": the drone stops at the wall. "open": no effect.
        contact_ends: Episode that a contact of collision shapes ends: that of the "drone", or of
            its whole "world".
        conflict_ends: Episode that a separation below `d_safe` ends: "nothing", "drone" or "world".
        warning_zone: Separation at which the warning zone begins, as a multiple of `d_safe`.
        fairness_range: Distance up to which the term `fairness` compares rewards, m.
        discount: Discount factor of the term `shaping`, from 0 to 1.
    """

    d_safe: float = 5.0
    start_speed: tuple[float, float] = (5.0, 15.0)
    goal_radius: float = 2.0
    at_goal: Literal["leave", "land", "hold"] = "leave"
    boundary: Literal["end", "soft", "hard", "open"] = "end"
    contact_ends: Literal["drone", "world"] = "drone"
    conflict_ends: Literal["nothing", "drone", "world"] = "nothing"
    warning_zone: float = 2.0
    fairness_range: float = 50.0
    discount: float = 0.99

    def check(self, context: TaskContext) -> None:
        """Check options that depend on each other.

        Args:
            context: Swarm for which the options are checked.

        Raises:
            ValueError: If a start speed exceeds the speed limit, the warning zone is not larger
                than d_safe, or the discount is above 1.
        """
        slowest, fastest = self.start_speed
        usual = self.start_speed == type(self).start_speed
        if not (0 <= slowest <= fastest and (usual or fastest <= context.max_speed)):
            raise ValueError(
                f"start_speed is {self.start_speed}: "
                f"from low to high within 0 and max_speed {context.max_speed:g} is needed"
            )
        if self.warning_zone <= 1:
            raise ValueError(
                f"warning_zone is {self.warning_zone:g}: more than 1, beyond d_safe, is needed"
            )
        if context.turn_radius:
            self._check_forward_flight()
        if self.discount > 1:
            raise ValueError(f"discount is {self.discount:g}: from 0 to 1 is needed")

    def _check_forward_flight(self) -> None:
        """Raise ValueError for options that aircraft which cannot hover cannot fly."""
        impossible = {"at_goal": ("land", "hold"), "boundary": ("soft", "hard")}
        for name, values in impossible.items():
            value = getattr(self, name)
            if value in values:
                raise ValueError(
                    f"{name} is {value!r}, and an airframe of the fleet cannot hover: leave {name} "
                    f"out"
                )


FlightConfigT = TypeVar("FlightConfigT", bound=FlightConfig)


class GoalCount(Part):
    """Number of goals that each drone reached, as memory and infos if goals respawn."""

    def __init__(self, num_drones: int) -> None:
        """Count the goals of the drones of each world."""
        self._num_drones = num_drones

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of the counts."""
        return {"goals": (self._num_drones,)}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the counts, and per hour since the start, (W, N)."""
        goals = frame.scene.memory["goals"]
        hours = np.maximum(frame.time, 1.0) / 3600  # not above 3600 per goal at the start
        return {"goals": goals.copy(), "goals_per_hour": goals / hours[:, None]}


class GoalFlight(Task[FlightConfigT], Generic[FlightConfigT]):
    """Base class of flights to goals in one airspace. Subclasses define starts and goals.

    A subclass sets `starts` or overrides `spawn`.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - progress 5: decrease of the distance to the goal, m.
    - goal 50: 1 in the decision in which the drone first reaches the goal.
    - conflict -200: number of drones whose separation falls below d_safe = 5 m.
    - warning -5: sum over other drones of their proximity, linear from 0 at 2 d_safe to 1 at
      d_safe.
    - collision -200: 1 on contact of collision shapes.
    - obstacle_warning -5: sum over obstacles of their proximity, linear from 0 at d_safe from the
      bounding sphere to 1 at contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - efficiency 0: 1 - d / d0, where d is the remaining distance and d0 that at the start.
    - speed_keeping 0: 1 at a speed between 0.3 and 0.8 of max_speed.
    - time -0.5: 1 per decision until the goal is reached; if the episode ends otherwise, also 1 per
      remaining decision.
    - shaping 0: discounted change of the potential, the negative distance to the goal.
    - fairness 0: variance of the rewards of nearby drones.
    - concession 0: at the end, number of drones to which the drone gave way minus number of drones
      that gave way to it.

    Enable terms of weight 0 by the option `weights`.

    End of a drone's episode: terminated on reaching the goal (within 2 m), on contact of collision
    shapes, when the battery is empty, or outside the arena. The drone then leaves the airspace. A
    conflict does not end the episode. Options change each of these conditions. Truncated after 500
    decisions unless the difficulty says otherwise.

    Success: the goal is reached, without conflict or collision in the episode.

    Uncertainty, by difficulty:

    - easy: none.
    - medium: positions have GPS noise of 0.5 to 1.5 m.
    - hard: positions have GPS noise of up to 3 m, and there is wind.
    - extreme: all parameters in `UNCERTAINTY` are randomized, with light turbulence.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.

    Attributes:
        field: Obstacles among the drones.
        starts: Draws starts and goals, unless the task overrides `spawn`.
        respawns: Whether drones that reach their goals get new ones.
    """

    defaults: ClassVar = {
        "num_drones": 8,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 500,
        "max_speed": 20.0,
        "difficulty": "medium",
    }
    presets: ClassVar = {"uavconflict": UAVCONFLICT}
    baseline = "orca"
    observation: ClassVar[tuple[str, ...]] = (
        "position",
        "velocity",
        "goal",
        "neighbours",
        "obstacles",
    )
    reward: ClassVar[Mapping[str, Weighted]] = REWARD_WEIGHTS
    training_weights: ClassVar[Mapping[str, float]] = TRAINING_WEIGHTS
    places: ClassVar[tuple[str, ...]] = PLACES
    events = ("finished", "reached", "terminated", "ended")
    computed_terms = ("fairness",)
    starts: Starts

    def __init__(self, config: FlightConfigT, context: TaskContext) -> None:
        """Check the options, and set the warning zone and the rebound at the arena's bounds.

        Raises:
            ValueError: If options contradict each other.
        """
        super().__init__(config, context)
        self.field = self.add(ObstacleField(self))
        self.safety = self.add(Safety(context.num_drones))
        at_goal: str = config.at_goal  # tasks in cities have "respawn", too
        self.respawns = at_goal == "respawn"
        if self.respawns:
            self.add(GoalCount(context.num_drones))
        config.check(context)
        self.rebound = REBOUND.get(config.boundary)
        self.zone = config.warning_zone * config.d_safe
        self.lands = self.takes_off or config.at_goal == "land"
        if not config.num_obstacles:
            self.weights["obstacle_warning"] = 0.0

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts and goals by `starts`, with drones in flight."""
        drawn = self.starts.draw(rng)._asdict()
        return self.launch(drawn.pop("position"), drawn.pop("goal"), rng, **drawn)

    def launch(
        self,
        start: np.ndarray,
        goal: np.ndarray,
        rng: np.random.Generator,
        along: np.ndarray | None = None,
        **others: Any,
    ) -> Spawn:
        """Return a start of level drones in flight.

        Args:
            start: (N, 3) start positions, m.
            goal: (N, 3) goals, m.
            rng: Generator of the start speeds.
            along: (N, 3) directions of flight, of any length; towards the goal by default.
            **others: Other fields of the start.
        """
        (slowest, fastest), limit = self.config.start_speed, self.context.max_speed
        velocity, directions = np.empty(start.shape), goal - start if along is None else along
        speeds = (float(min(slowest, limit)), float(min(fastest, limit)))
        draw_velocities(get_random_source(rng), *speeds, directions, velocity)
        return Spawn(position=start, goal=goal, **{**others, "velocity": velocity})

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of drones and, if `concession` is used, of pairs.

        Returns:
            "reached" (N,), time at which a drone first reached its goal (the last time if goals
            respawn), s, 0 before. "goals" (N,), number of goals reached if they respawn.
            "initial_distance" (N,), remaining distance at the start, m. "encounter" and "effort"
            (N, N), see `bulletuav.tasks.rewards.airspace.update_encounters`.
        """
        drones = self.context.num_drones
        shapes = {"reached": (drones,), "initial_distance": (drones,), **super().memory()}
        if self.weights.get("concession"):
            shapes["encounter"] = (drones, drones)
            shapes["effort"] = (drones, drones)
        return shapes

    def quantities(self) -> Mapping[str, Any]:
        """Return the remaining distances before and after the decision, and obstacle proximity."""
        return {
            **super().quantities(),
            "remaining_distance": self.remaining_distance,
            "remaining_distance_before": self.remaining_distance_before,
            "obstacle_nearness": self._obstacle_nearness,
        }

    def _obstacle_nearness(self, frame: Frame) -> np.ndarray:
        """Return the sum over obstacles of their proximity, (W, N); see `sum_obstacle_nearness`."""
        nearness = np.empty(frame.alive.shape)
        contact_distance = self.field.radius + self.context.collision_radius
        place, d_safe = frame.scene.obstacle, float(frame.d_safe)
        sum_obstacle_nearness(frame.after.position, place, contact_distance, d_safe, nearness)
        return nearness

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move obstacles, and lower reached goals to the ground if drones have to land."""
        if self.config.at_goal == "land":
            is_landing = (scene.memory["reached"] > 0) & flying[:, None]
            scene.goal[..., 2] = np.where(is_landing, 0.0, scene.goal[..., 2])
        return super().move_scene(scene, time, flying, rngs)

    def _descent(self, goal: np.ndarray) -> np.ndarray | float:
        """Return the height of goals (W, N, 3) above ground, m, if drones have to land; else 0."""
        if self.config.at_goal != "land":
            return 0.0
        left: np.ndarray = goal[..., 2]
        return left

    def remaining_distance(self, frame: Frame) -> np.ndarray:
        """Compute the remaining distance to the goal, plus its remaining descent, (W, N) m."""
        return frame.distance + self._descent(frame.scene.goal)

    def remaining_distance_before(self, frame: Frame) -> np.ndarray:
        """Compute `remaining_distance` before the decision, (W, N) m."""
        distance: np.ndarray = paired_distances(frame.goal_before, frame.before.position)
        distance += self._descent(frame.goal_before)
        return distance

    def arrived(self, frame: Frame) -> np.ndarray:
        """Return which drones are within `goal_radius` of their goals, (W, N) bool."""
        return frame.distance <= self.config.goal_radius

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update the times of reaching goals, initial distances, and encounters."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
        # Zero before the first decision of an episode
        initial_distance = memory["initial_distance"]
        np.copyto(
            initial_distance, self.remaining_distance_before(frame), where=initial_distance == 0
        )
        # A goal is reached once, without collision
        is_first = memory["reached"] == 0
        has_reached = self.arrived(frame) & frame.alive & ~frame.collision & is_first
        np.copyto(memory["reached"], frame.time[:, None], where=has_reached)
        if self.respawns:
            self._respawn(frame, rngs)
        if "encounter" in memory:
            pairs = (memory["encounter"], memory["effort"])
            update_encounters(*pairs, frame.before, frame.after, frame.d_safe, frame.alive)
        if self.restarts is not None:
            ended = self._failed(frame, super().terminated)
            self.restarts.mark(frame, ended)
            memory["initial_distance"][ended] = 0.0

    def _respawn(self, frame: Frame, rngs: Rngs) -> None:
        """Draw new goals for drones that reached theirs.

        Rewards and infos of the decision refer to the previous goals; observations show the new
        ones.
        """
        scene = frame.scene
        at_goal = self.arrived(frame) & frame.alive & ~frame.collision
        np.copyto(scene.memory["reached"], frame.time[:, None], where=at_goal)
        scene.memory["goals"][:] += at_goal
        for w, i in np.argwhere(at_goal).tolist():
            place = frame.after.position[w, i]
            scene.goal[w, i] = self.starts.next_goal(place, scene, w, rngs[w])
            frame.known_distance[w, i] = math.dist(scene.goal[w, i], frame.known_position[w, i])

    def finished(self, frame: Frame) -> np.ndarray:
        """Return which drones are at the goal, or landed if required, without collision.

        Returns:
            (W, N) bool; all False if goals respawn.
        """
        if self.respawns:
            return np.zeros(frame.alive.shape, dtype=bool)
        if self.config.at_goal != "land":
            at_goal: np.ndarray = self.arrived(frame) & ~frame.collision
            return at_goal
        offset = frame.after.position - frame.scene.goal
        is_near = np.linalg.norm(offset[..., :2], axis=-1) <= self.config.goal_radius
        was_at_goal = frame.scene.memory["reached"] > 0
        landed: np.ndarray = was_at_goal & frame.landed & is_near
        return landed

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones finished, or reached a goal if goals respawn, (W, N) bool."""
        if self.respawns:
            reached: np.ndarray = (frame.scene.memory["goals"] > 0) & ~frame.collision
            return reached
        # Cached by `terminated`
        finished = frame.derived.get("finished")
        return self.finished(frame) if finished is None else finished

    def goals_end(self, frame: Frame, finished: np.ndarray) -> np.ndarray:
        """Return which drones' episodes end at goals: each on its own, or a world together.

        Args:
            frame: The decision.
            finished: (W, N) bool, drones at the goal, or landed.

        Returns:
            (W, N) bool.
        """
        if self.config.at_goal != "hold":
            return finished
        all_there = np.all(finished | ~frame.alive, axis=1, keepdims=True)
        return np.broadcast_to(all_there, finished.shape)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Return which drones' episodes terminate, and derive the events that reward terms read.

        Subclasses declare further conditions in `ends`, so that these events include them.

        Returns:
            (W, N) bool. Sets "finished", "reached", "terminated" and "ended" in `frame.derived`.
        """
        finished = self.finished(frame)
        ended = self.goals_end(frame, finished)
        if self.restarts is None:
            ended = ended | self._failed(frame, super().terminated)
        reached = frame.scene.memory["reached"]
        frame.derived["finished"] = finished
        frame.derived["reached"] = (reached > 0) & (reached == frame.time[:, None])
        frame.derived["terminated"] = ended
        frame.derived["ended"] = ended | frame.last[:, None]
        return ended

    def _failed(self, frame: Frame, by_ends: Callable[[Frame], np.ndarray]) -> np.ndarray:
        """Return which drones fail, (W, N) bool; `by_ends` evaluates the declared `ends`."""
        config = self.config
        # Collisions and empty batteries always end an episode
        crashed = affected_drones(frame.collision, frame, config.contact_ends)
        ended: np.ndarray = crashed | frame.depleted
        # Bounds and conflicts end it depending on the options
        if config.boundary == "end":
            ended = ended | self.outside(frame)
        if config.conflict_ends != "nothing":
            in_conflict = frame.conflict.separation < config.d_safe
            ended = ended | affected_drones(in_conflict, frame, config.conflict_ends)
        return ended | by_ends(frame) if self.ends else ended

    def compute_terms(
        self, frame: Frame, terms: Mapping[str, np.ndarray]
    ) -> Mapping[str, np.ndarray]:
        """Compute `fairness`, which compares the weighted sums of the other terms."""
        weighted = (self.weights[name] * term for name, term in terms.items())
        total = sum(weighted, np.zeros(frame.alive.shape))
        max_distance = self.config.fairness_range
        return {"fairness": variance_nearby(total, frame.after.position, frame.alive, max_distance)}
