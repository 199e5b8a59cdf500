"""Flights of several drones to goals through one shared airspace: options, rewards and ends."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.tasks.base import Task, Weighted
from bulletuav.tasks.config import REBOUND, TaskConfig
from bulletuav.tasks.ends import affected
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.given import PLACES
from bulletuav.tasks.parts.base import Rngs, Starts
from bulletuav.tasks.parts.draws import source_of
from bulletuav.tasks.parts.headings import draw_velocities
from bulletuav.tasks.parts.obstacle_field import ObstacleField, ObstacleOptions
from bulletuav.tasks.parts.presets import UAVCONFLICT
from bulletuav.tasks.rewards.airspace import (
    follow_encounters,
    sum_obstacle_nearness,
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


@dataclass(frozen=True)
class FlightConfig(ObstacleOptions, TaskConfig):
    """Options of all flights to goals, beside those of obstacles (`ObstacleOptions`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Least and greatest speed at the start, m/s; by default cut to max_speed.
        goal_radius: Distance from the goal at which it counts as reached, m.
        at_goal: What happens at the goal. "leave": the drone leaves the airspace. "land": it has
            to land on the ground below first, see `Frame.landed`. "hold": it stays, until all
            that fly are at their goals.
        boundary: What happens outside the arena. "end": the drone's episode ends. "soft": it is
            thrown back with 0.8 of its speed. "hard": it stops at the wall. "open": nothing.
        contact_ends: Whose episode a contact of collision shapes ends: that of the "drone", or
            of its whole "world".
        conflict_ends: Whose episode a separation below `d_safe` ends: "nothing", "drone" or
            "world".
        warning_zone: Separation at which the warning zone begins, as a multiple of `d_safe`.
        fairness_range: Distance up to which the term `fairness` compares rewards, m.
        discount: Discount of the term `shaping`, from 0 to 1.
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
        """Refuse options that contradict each other.

        Args:
            context: The swarm that the options are for.

        Raises:
            ValueError: A start speed is one that no drone has, the warning zone ends where it
                begins, or the discount is above 1.
        """
        slowest, fastest = self.start_speed
        usual = self.start_speed == type(self).start_speed
        if not (0 <= slowest <= fastest and (usual or fastest <= context.max_speed)):
            raise ValueError(
                f"start_speed is {self.start_speed}: "
                f"from low to high within 0 and max_speed {context.max_speed:g}"
            )
        if self.warning_zone <= 1:
            raise ValueError(
                f"warning_zone is {self.warning_zone:g}: it must end beyond d_safe, at more than 1"
            )
        if self.discount > 1:
            raise ValueError(f"discount is {self.discount:g}: from 0 to 1 is needed")


FlightConfigT = TypeVar("FlightConfigT", bound=FlightConfig)


class GoalFlight(Task[FlightConfigT], Generic[FlightConfigT]):
    """Base of flights to goals in one airspace; a task adds where drones start and where they go.

    It sets `starts`, or has a `spawn` of its own.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed. Its norm
    is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the sum of these terms times their weights:

    - progress 5: metres nearer to the goal.
    - goal 50: 1 on reaching the goal, once.
    - conflict -200: other drones with which a separation falls below d_safe = 5 m.
    - warning -5: for each other drone, linear from 0 at 2 d_safe to 1 at d_safe.
    - collision -200: 1 on contact of collision shapes.
    - obstacle_warning -5: for each obstacle, linear from 0 at d_safe from its bounding sphere to
      1 at contact with it.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: square of the velocity change, (m/s)^2.
    - efficiency 0: 1 - distance to the goal over that at the start.
    - speed_keeping 0: 1 at a speed between 0.3 and 0.8 of max_speed.
    - time -0.5: 1 a decision until the goal is reached. Whoever ends before that pays for all
      decisions that are left.
    - shaping 0: discounted change of the potential, which is -distance to the goal.
    - fairness 0: variance of the rewards of drones nearby.
    - concession 0: at the end, drones that it made way for less those that made way for it.

    Terms of weight 0 are there for the asking: set their `weights`.

    End of a drone's episode: terminated on reaching the goal (within 2 m), on contact of collision
    shapes, with an empty battery, or outside the arena. The drone then leaves the airspace. A
    conflict ends nothing. Options change each of these. Truncated after 500 decisions unless the
    difficulty says otherwise.

    Success: the goal is reached.

    Uncertainty, by difficulty:

    - easy: none.
    - medium: positions are wrong by 0.5 to 1.5 m (GPS).
    - hard: positions are wrong by up to 3 m, and there is wind.
    - extreme: everything in `UNCERTAINTY` is uncertain, in light turbulence.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.
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
    places: ClassVar[tuple[str, ...]] = PLACES
    events = ("finished", "reached", "terminated", "ended")
    computed_terms = ("fairness",)
    starts: Starts

    def __init__(self, config: FlightConfigT, context: TaskContext) -> None:
        """Check the options, and take the warning zone and the bounds' rebound from them.

        Raises:
            ValueError: Options contradict each other.
        """
        super().__init__(config, context)
        self.field = self.add(ObstacleField(self))
        config.check(context)
        self.rebound = REBOUND.get(config.boundary)
        self.zone = config.warning_zone * config.d_safe
        self.lands = self.takes_off or config.at_goal == "land"
        if not config.num_obstacles:
            self.weights["obstacle_warning"] = 0.0

    @property
    def respawns(self) -> bool:
        """Whether drones that reach their goals get others."""
        at_goal: str = self.config.at_goal
        return at_goal == "respawn"

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start in flight from the places that `starts` draws."""
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
        """Make a start of level drones in flight.

        Args:
            start: (N, 3) where drones start, m.
            goal: (N, 3) where they are to go, m.
            rng: Generator of the start speeds.
            along: (N, 3) directions in which they fly, of any length; towards the goal by default.
            **others: Other fields of the start.
        """
        (slowest, fastest), limit = self.config.start_speed, self.context.max_speed
        velocity, ways = np.empty(start.shape), goal - start if along is None else along
        speeds = (float(min(slowest, limit)), float(min(fastest, limit)))
        draw_velocities(source_of(rng), *speeds, ways, velocity)
        return Spawn(position=start, goal=goal, **{**others, "velocity": velocity})

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of what is kept of each drone and, where concession counts, of pairs.

        Returns:
            "reached" (N,), time at which a drone first came to its goal, s, 0 before; where goals
            respawn the last time. "goals" (N,), how many it reached then. "first_way" (N,), how far
            it had to go from its start, m. "encounter" and "effort" (N, N), see
            `bulletuav.tasks.rewards.airspace.follow_encounters`.
        """
        drones = self.context.num_drones
        shapes = {"reached": (drones,), "first_way": (drones,), **super().memory()}
        if self.respawns:
            shapes["goals"] = (drones,)
        if self.weights.get("concession"):
            shapes["encounter"] = (drones, drones)
            shapes["effort"] = (drones, drones)
        return shapes

    def quantities(self) -> Mapping[str, Any]:
        """Return the ways to the goal before and after the decision, and how near obstacles are."""
        return {
            **super().quantities(),
            "way": self.way,
            "way_before": self.way_before,
            "obstacle_nearness": self._obstacle_nearness,
        }

    def _obstacle_nearness(self, frame: Frame) -> np.ndarray:
        """Sum up over obstacles how deep each drone is within d_safe of them, (W, N)."""
        nearness = np.empty(frame.alive.shape)
        reach = self.field.radius + self.context.collision_radius
        place, d_safe = frame.scene.obstacle, float(frame.d_safe)
        sum_obstacle_nearness(frame.after.position, place, reach, d_safe, nearness)
        return nearness

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move obstacles, and goals that were reached down to the ground for who is to land."""
        if self.config.at_goal == "land":
            is_landing = (scene.memory["reached"] > 0) & flying[:, None]
            scene.goal[..., 2] = np.where(is_landing, 0.0, scene.goal[..., 2])
        return super().move_scene(scene, time, flying, rngs)

    def _descent(self, goal: np.ndarray) -> np.ndarray | float:
        """Tell how far goals (W, N, 3) have yet to come down for landing, (W, N) m, or 0."""
        if self.config.at_goal != "land":
            return 0.0
        left: np.ndarray = goal[..., 2]
        return left

    def way(self, frame: Frame) -> np.ndarray:
        """Compute the way to the goal, and on with the goal to where it stops, (W, N) m."""
        return frame.distance + self._descent(frame.scene.goal)

    def way_before(self, frame: Frame) -> np.ndarray:
        """Compute what `way` was before the decision, (W, N) m."""
        way: np.ndarray = paired_distances(frame.goal_before, frame.before.position)
        way += self._descent(frame.goal_before)
        return way

    def arrived(self, frame: Frame) -> np.ndarray:
        """Tell who is at the goal, (W, N) bool."""
        return frame.distance <= self.config.goal_radius

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Note when goals were reached, how far it was to them at the start, and who made way."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
        # The first decision of an episode tells the way from the start.
        first_way = memory["first_way"]
        np.copyto(first_way, self.way_before(frame), where=first_way == 0)
        # A goal counts as reached once, without a crash.
        is_first = memory["reached"] == 0
        has_reached = self.arrived(frame) & frame.alive & ~frame.collision & is_first
        np.copyto(memory["reached"], frame.time[:, None], where=has_reached)
        if self.respawns:
            self._respawn(frame, rngs)
        if "encounter" in memory:
            pairs = (memory["encounter"], memory["effort"])
            follow_encounters(*pairs, frame.before, frame.after, frame.d_safe, frame.alive)

    def _respawn(self, frame: Frame, rngs: Rngs) -> None:
        """Draw new goals for drones at theirs.

        Rewards and infos of the decision are about the goals before; observations have the new.
        """
        scene = frame.scene
        at_goal = self.arrived(frame) & frame.alive & ~frame.collision
        np.copyto(scene.memory["reached"], frame.time[:, None], where=at_goal)
        scene.memory["goals"][:] += at_goal
        for w, i in np.argwhere(at_goal).tolist():
            place = frame.after.position[w, i]
            scene.goal[w, i] = self.starts.next_goal(place, int(scene.layout[w]), rngs[w])
            frame.known_distance[w, i] = math.dist(scene.goal[w, i], frame.known_position[w, i])

    def finished(self, frame: Frame) -> np.ndarray:
        """Return which drones are at the goal, or landed where that is asked for, without a crash.

        Returns:
            (W, N) bool; none where goals respawn.
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
        """Return which drones finished, or reached a goal where these respawn, (W, N) bool."""
        if self.respawns:
            reached: np.ndarray = (frame.scene.memory["goals"] > 0) & ~frame.collision
            return reached
        # `terminated` leaves this here, so that it is worked out once a decision.
        finished = frame.derived.get("finished")
        return self.finished(frame) if finished is None else finished

    def goals_end(self, frame: Frame, finished: np.ndarray) -> np.ndarray:
        """Tell whose episode goals end: the drone's own, or that of all of a world together.

        Args:
            frame: The decision.
            finished: (W, N) bool, who is at the goal, or landed.

        Returns:
            (W, N) bool.
        """
        if self.config.at_goal != "hold":
            return finished
        all_there = np.all(finished | ~frame.alive, axis=1, keepdims=True)
        return np.broadcast_to(all_there, finished.shape)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell whose episode ends as the options ask for, and derive the events that terms read.

        Returns:
            (W, N) bool. `frame.derived` gets "finished", "reached", "terminated" and "ended".
        """
        config = self.config
        finished = self.finished(frame)
        # Crashes and empty batteries always end an episode.
        crashed = affected(frame.collision, frame, config.contact_ends)
        ended: np.ndarray = crashed | frame.depleted
        ended = ended | self.goals_end(frame, finished)
        # Bounds and conflicts end it where options say so.
        if config.boundary == "end":
            ended = ended | self.outside(frame)
        if config.conflict_ends != "nothing":
            in_conflict = frame.conflict.separation < config.d_safe
            ended = ended | affected(in_conflict, frame, config.conflict_ends)
        # Reward terms read these events by name.
        reached = frame.scene.memory["reached"]
        frame.derived["finished"] = finished
        frame.derived["reached"] = (reached > 0) & (reached == frame.time[:, None])
        frame.derived["terminated"] = ended
        frame.derived["ended"] = ended | frame.last[:, None]
        return ended

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return infos of the parts and, where goals respawn, the number of goals reached."""
        goals = {"goals": frame.scene.memory["goals"].copy()} if self.respawns else {}
        return {**super().info(frame), **goals}

    def compute_terms(
        self, frame: Frame, terms: Mapping[str, np.ndarray]
    ) -> Mapping[str, np.ndarray]:
        """Compute `fairness`: it compares the rewards that the other terms add up to."""
        weighted = (self.weights[name] * term for name, term in terms.items())
        total = sum(weighted, np.zeros(frame.alive.shape))
        reach = self.config.fairness_range
        return {"fairness": variance_nearby(total, frame.after.position, frame.alive, reach)}
