"""Flights to goals through one shared airspace: options, reward weights, ends, uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.geometry.closest_approach import distances
from bulletuav.tasks.base import REBOUND, Rngs, Task, TaskConfig, Weighted, affected
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.rewards.airspace import follow_encounters, variance_nearby

TOUCHDOWN, TOUCHDOWN_SPEED = 1.0, 2.0
"""Height above the ground, m, and speed, m/s, below which a drone has landed"""
REWARD_WEIGHTS = {
    "progress": 5.0,
    "goal": 50.0,
    "conflict": -100.0,
    "warning": -5.0,
    "collision": -200.0,
    "out_of_bounds": -50.0,
    "energy": -0.01,
    "efficiency": 0.0,
    "speed_keeping": 0.0,
    "time": 0.0,
    "shaping": 0.0,
    "fairness": 0.0,
    "concession": 0.0,
}
UNCERTAINTY: dict[str, dict[str, Any]] = {
    "easy": {},
    "medium": {"randomization": {"gps_noise": (0.5, 1.5)}},
    "hard": {
        "randomization": {"gps_noise": (0.5, 3.0), "gps_walk": (0.0, 0.1), "wind": (-3.0, 3.0)}
    },
    "extreme": {
        "turbulence": "light",
        "randomization": {
            "mass": (0.8, 1.2),
            "thrust": (0.9, 1.1),
            "drag": (1 / 3, 5 / 3),
            "motor_lag": (0.5, 2.0),
            "battery": (0.0, 0.1),
            "gps_noise": (0.5, 5.0),
            "gps_walk": (0.0, 0.1),
            "gps_dropout": (0.0, 0.1),
            "wind": (-3.0, 3.0),
            "radio_delay": (0.005, 0.1),
            "radio_loss": (0.0, 0.3),
            "radio_range": (100.0, 200.0),
        },
    },
}
"""What a difficulty makes uncertain"""
UAVCONFLICT: dict[str, Any] = {
    "num_drones": 8,
    "d_safe": 5.0,
    "goal_radius": 2.0,
    "max_speed": 20.0,
    "decision_hz": 10,
    "horizon": 500,
    "action": "velocity_increment",
    "observation": ("position", "velocity", "goal", "identity", "all_neighbours"),
    "at_goal": "hold",
    "boundary": "soft",
    "conflict_ends": "world",
    "randomization": {},
    "weights": {
        "progress": 10.0,
        "goal": 50.0,
        "conflict": -200.0,
        "warning": -5.0,
        "collision": 0.0,
        "out_of_bounds": 0.0,
        "energy": -0.01,
        "speed_keeping": 0.5,
    },
}
"""Sizes, observation and reward constants of UAVConflictGym; docs/conflict.md lists where it differs and why"""


@dataclass(frozen=True)
class FlightConfig(TaskConfig):
    """Options that all flights to goals have in common, m, m/s.

    at_goal        "leave": a drone that reaches its goal leaves the airspace; "land": it has to go down to the ground below
                   first; "hold": it stays, until all that fly are at their goals
    boundary       "end": a drone outside the arena is done; "soft": it is thrown back with 0.8 of its speed; "hard": it
                   stops at the wall; "open": nothing happens
    contact_ends, conflict_ends  whose episode contact of shapes, or a separation below d_safe, ends: "nothing" (conflict
                   only), the "drone"'s, or that of its whole "world"
    warning_zone   where the warning begins, in d_safe
    fairness_range whose rewards the term `fairness` compares
    discount       of the term `shaping`
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
        """Raise ValueError for speeds that no drone has, or a warning zone that ends where it begins."""
        if not 0 <= self.start_speed[0] <= self.start_speed[1] <= context.max_speed:
            raise ValueError(
                f"start_speed is {self.start_speed}: from low to high within 0 and max_speed {context.max_speed:g}"
            )
        if self.warning_zone <= 1:
            raise ValueError(
                f"warning_zone is {self.warning_zone:g}: it must end beyond d_safe, at more than 1"
            )
        if self.discount > 1:
            raise ValueError(f"discount is {self.discount:g}: from 0 to 1 is needed")


@dataclass(frozen=True)
class AirspaceConfig(FlightConfig):
    """Options of free airspace: places lie about `altitude`, each axis up to `jitter` off; the bounds are `margin` away."""

    altitude: float = 40.0
    jitter: float = 1.0
    margin: float = 30.0

    def check(self, context: TaskContext) -> None:
        """See `FlightConfig.check`; also refuses jitter beyond the bounds."""
        super().check(context)
        if self.margin <= self.jitter:
            raise ValueError(
                f"margin {self.margin:g} m must exceed jitter {self.jitter:g} m: starts must be in the arena"
            )

    def scattered(self, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Places (N, 3), m, each axis up to `jitter` off."""
        return places + rng.uniform(-self.jitter, self.jitter, places.shape)


FlightConfigT = TypeVar("FlightConfigT", bound=FlightConfig)


def clearance(config: FlightConfig, context: TaskContext) -> float:
    """Distance between two drones below which they conflict or touch, m."""
    return max(2 * context.collision_radius, config.d_safe)


def circle_arena(
    config: AirspaceConfig, context: TaskContext, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,), m, of the arena of drones on a circle. Raises ValueError where they could touch the ground."""
    if config.altitude - config.jitter <= context.collision_radius:
        raise ValueError(
            f"altitude {config.altitude:g} m is too low for jitter {config.jitter:g} m"
        )
    reach = radius + config.margin
    return np.array([-reach, -reach, 0.0]), np.array(
        [reach, reach, config.altitude + config.margin]
    )


def between_neighbours(config: AirspaceConfig, chord: float) -> float:
    """How near two drones may start whose places are `chord` m apart on the level, m."""
    return chord - 2 * np.sqrt(2) * config.jitter


class Airspace(Task[FlightConfigT], Generic[FlightConfigT]):
    """A task of flights to goals in one airspace; a task adds where they start and where they go.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed;
    10 decisions a second.

    Reward, per decision, weighted terms: progress 5 a metre nearer to the goal; goal 50 on reaching it; conflict -100 for
    each other drone with which a separation falls below d_safe = 5 m; warning -5 for each other drone, linear from 0 at
    2 d_safe to 1 at d_safe; collision -200; out_of_bounds -50; energy -0.01 per (m/s)^2 of velocity change. For the
    asking: efficiency 0 (1 - distance over that at the start), speed_keeping 0 (0.3 to 0.8 of max_speed), time 0 (1 a
    decision), shaping 0 (by the potential -distance), fairness 0 (variance of the rewards nearby), concession 0 (made way).

    End: terminated on reaching the goal (within 2 m), on contact of collision shapes, with an empty battery, or outside the
    arena (bounds of position); the drone then leaves the airspace. Conflict ends nothing. Options change each of these.
    Truncated after 500 decisions unless the difficulty says otherwise.
    Success: goal reached.

    Uncertain from medium on: positions by 0.5 to 1.5 m (GPS). Hard: up to 3 m, and wind. Extreme: everything (see
    `UNCERTAINTY`), in light turbulence.

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
    observation: ClassVar[tuple[str, ...]] = ("position", "velocity", "goal", "neighbours")
    reward: ClassVar[Mapping[str, Weighted]] = REWARD_WEIGHTS
    events = ("reached", "terminated", "ended")
    computed_terms = ("fairness",)

    def __init__(self, config: FlightConfigT, context: TaskContext) -> None:
        """Raises ValueError for options that cannot be."""
        super().__init__(config, context)
        config.check(context)
        self.rebound = REBOUND.get(config.boundary)
        self.zone = config.warning_zone * config.d_safe

    def launch(
        self,
        start: np.ndarray,
        goal: np.ndarray,
        rng: np.random.Generator,
        along: np.ndarray | None = None,
    ) -> Spawn:
        """Drones at `start` (N, 3), in flight, noses to the east.

        They fly towards `goal` (N, 3), or in the direction of `along` (N, 3).
        """
        low, high = self.config.start_speed
        along = goal - start if along is None else along
        heading = along / np.linalg.norm(along, axis=1, keepdims=True)
        velocity = heading * rng.uniform(low, high, (len(start), 1))
        return Spawn(position=start, goal=goal, velocity=velocity)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell what is kept of each drone, and where concession counts, of pairs.

        "reached" is when a drone first came to its goal, s, 0 before; "first_way" how far it had to
        go from its start, m. "encounter" and "effort" are of pairs; see `follow_encounters`.
        """
        drones = self.context.num_drones
        shapes: dict[str, tuple[int, ...]] = {"reached": (drones,), "first_way": (drones,)}
        if self.weights.get("concession"):
            shapes |= {"encounter": (drones, drones), "effort": (drones, drones)}
        return shapes

    def quantities(self) -> Mapping[str, Any]:
        """Tell the ways to the goal, which terms read."""
        return {"way": self.way, "way_before": self.way_before}

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the goals of drones that are to land to the ground, once they have reached them."""
        if self.config.at_goal == "land":
            down = (scene.memory["reached"] > 0) & flying[:, None]
            scene.goal[..., 2] = np.where(down, TOUCHDOWN / 2, scene.goal[..., 2])
        return False

    def ahead(self, goal: np.ndarray, time: np.ndarray) -> np.ndarray | float:
        """Tell how far goals have yet to move: to the ground for landing, else not at all.

        Args:
            goal: (W, N, 3) where they are, m.
            time: (W,) s.

        Returns:
            (W, N) m.
        """
        return goal[..., 2] - TOUCHDOWN / 2 if self.config.at_goal == "land" else 0.0

    def way(self, frame: Frame) -> np.ndarray:
        """Compute how far it is to the goal and on with it to where it stops, (W, N) m."""
        return frame.distance + self.ahead(frame.scene.goal, frame.time)

    def way_before(self, frame: Frame) -> np.ndarray:
        """Compute the same before the decision."""
        ahead = self.ahead(frame.goal_before, frame.time - self.context.period)
        return distances(frame.goal_before, frame.before.position) + ahead

    def arrived(self, frame: Frame) -> np.ndarray:
        """Tell who is at the goal, (W, N) bool."""
        return frame.distance <= self.config.goal_radius

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Note when goals were reached, how far it was to them at the start, and who made way."""
        memory = frame.scene.memory
        first = memory["first_way"]
        np.copyto(first, self.way_before(frame), where=first == 0)
        new = self.arrived(frame) & frame.alive & ~frame.collision & (memory["reached"] == 0)
        np.copyto(memory["reached"], frame.time[:, None], where=new)
        if "encounter" in memory:
            pairs = (memory["encounter"], memory["effort"])
            follow_encounters(*pairs, frame.before, frame.after, frame.d_safe, frame.alive)

    def finished(self, frame: Frame) -> np.ndarray:
        """Tell who is at the goal, or landed where that is asked for, without a crash."""
        if self.config.at_goal != "land":
            return self.arrived(frame) & ~frame.collision
        aside = np.linalg.norm((frame.after.position - frame.scene.goal)[..., :2], axis=-1)
        near = aside <= self.config.goal_radius
        slow = np.linalg.norm(frame.after.velocity, axis=-1) <= TOUCHDOWN_SPEED
        low = frame.after.position[..., 2] <= TOUCHDOWN
        been_there = frame.scene.memory["reached"] > 0
        landed: np.ndarray = been_there & low & slow & near & ~frame.collision
        return landed

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell who did as the task wants, (W, N) bool; by default all that finished."""
        found = frame.derived.get("finished")
        return self.finished(frame) if found is None else found

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell whose episode ends as the options ask for, and derive the events that terms read."""
        config = self.config
        finished = self.finished(frame)
        ended = affected(frame.collision, frame, config.contact_ends) | frame.depleted
        if config.at_goal == "hold":
            ended = ended | np.all(finished | ~frame.alive, axis=1, keepdims=True)
        else:
            ended = ended | finished
        if config.boundary == "end":
            ended = ended | self.outside(frame)
        if config.conflict_ends != "nothing":
            close = frame.conflict.separation < config.d_safe
            ended = ended | affected(close, frame, config.conflict_ends)
        reached = frame.scene.memory["reached"]
        frame.derived["finished"] = finished
        frame.derived["reached"] = (reached > 0) & (reached == frame.time[:, None])
        frame.derived["terminated"] = ended
        frame.derived["ended"] = ended | frame.last[:, None]
        return ended

    def reward_terms(self, frame: Frame) -> dict[str, np.ndarray]:
        """Compute the terms; `fairness` compares what the others come to."""
        terms = super().reward_terms(frame)
        if self.weights.get("fairness"):
            weighted = (self.weights[name] * term for name, term in terms.items())
            total = sum(weighted, np.zeros(frame.alive.shape))
            near = (frame.after.position, frame.alive, self.config.fairness_range)
            terms["fairness"] = variance_nearby(total, *near)
        return terms
