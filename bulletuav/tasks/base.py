"""What a task is made of: it spawns worlds, names reward terms and ends episodes; everything is batched (W, N, ...)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from bulletuav.conflict.separation import Conflict, conflict
from bulletuav.errors import unknown
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.closest_approach import distances
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.lidar import Beam
from bulletuav.tasks.observations.sensors import served_share
from bulletuav.vehicle.swarm import Contacts, Swarm

NOTHING = np.zeros((0, 3))
REBOUND = {"soft": 0.8, "hard": 0.0}
"""Share of the speed against a wall that is left, reversed, by the option `boundary`"""


class Spawn(NamedTuple):
    """Start of one world: position (N, 3) m, quaternion (N, 4), velocity (N, 3) m/s, rates (N, 3) rad/s, goal (N, 3) m.

    Velocity of the goals (N, 3), m/s. Of the task's K obstacles position and velocity (K, 3). `layout`: which of the task's
    layouts stands there. `memory`: what the task remembers from the start, by name.
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    goal: np.ndarray
    goal_velocity: np.ndarray | float = 0.0
    obstacle: np.ndarray = NOTHING
    obstacle_velocity: np.ndarray = NOTHING
    layout: int = NO_LAYOUT
    memory: Mapping[str, np.ndarray] = MappingProxyType({})


class Scene(NamedTuple):
    """Beside the drones: goals (W, N, 3) m, m/s, start positions (W, N, 3) m; obstacles (W, K, 3) m, m/s, (W, K, 4).

    `layout` (W,): which of the task's layouts stands in each world, or NO_LAYOUT. `memory`: the task's own arrays (W, ...) by
    name, zero when a world starts, unless its spawn says otherwise.
    """

    goal: np.ndarray
    goal_velocity: np.ndarray
    start: np.ndarray
    obstacle: np.ndarray
    obstacle_velocity: np.ndarray
    obstacle_quaternion: np.ndarray
    layout: np.ndarray
    memory: Mapping[str, np.ndarray]

    @classmethod
    def empty(
        cls,
        num_worlds: int,
        num_drones: int,
        num_obstacles: int,
        memory: Mapping[str, tuple[int, ...]],
    ) -> "Scene":
        """All at the origin, unturned; `memory` tells the shape of each array in one world."""
        of_drones, of_obstacles = (num_worlds, num_drones, 3), (num_worlds, num_obstacles, 3)
        turns = np.tile([0.0, 0.0, 0.0, 1.0], (num_worlds, num_obstacles, 1))
        goal, goal_velocity, start = np.zeros((3, *of_drones))
        remembered = {name: np.zeros((num_worlds, *shape)) for name, shape in memory.items()}
        obstacle, obstacle_velocity = np.zeros((2, *of_obstacles))
        layout = np.full(num_worlds, NO_LAYOUT)
        return cls(
            goal, goal_velocity, start, obstacle, obstacle_velocity, turns, layout, remembered
        )


@dataclass(frozen=True)
class TaskContext:
    """The swarm that a task is set for: size, largest collision radius (m), speed limit (m/s), decision period (s).

    `num_neighbours`: how many other drones, obstacles and buildings a drone observes; `duration`: of an episode, s;
    `beams` of the range finder, which reaches `max_range` m.
    """

    num_drones: int
    collision_radius: float
    max_speed: float
    period: float
    num_neighbours: int
    duration: float
    beams: tuple[Beam, ...]
    max_range: float


@dataclass(frozen=True)
class Frame:
    """One decision, for a task to judge. Arrays (W, N, ...); `alive` are the drones that flew it, `time` (W,) s since reset.

    `last` (W,) tells where the horizon is reached; the warning zone about a drone ends at `zone` m; the goals were at
    `goal_before` (W, N, 3), m, before the decision and move ahead of the drones. `readings` are what sensors measured after
    it, by name, as far as the observation or the task asks for it: pictures; "lidar" (W, N, B) m; "imu" (W, N, 6);
    "clearance" (W, N) m; "sight" (W, N, U), whether the task's targets are in sight; "charge" (W, N), what is left in
    batteries; "power" (W, N) W, that it took; with randomization also what drones know of themselves, "position" and
    "velocity" (W, N, 3), and with communication what drone i last heard of drone j, "heard_position" and "heard_velocity"
    (W, N, N, 3), where "heard" (W, N, N).
    """

    before: Swarm
    after: Swarm
    action: np.ndarray
    scene: Scene
    contacts: Contacts
    alive: np.ndarray
    time: np.ndarray
    last: np.ndarray
    d_safe: float
    zone: float
    goal_before: np.ndarray
    readings: Mapping[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def conflict(self) -> Conflict:
        """Separations within the decision."""
        return conflict(
            self.before.position, self.after.position, self.alive, self.d_safe, self.zone
        )

    @property
    def known_position(self) -> np.ndarray:
        """(W, N, 3) where the drones think that they are, m."""
        return self.readings.get("position", self.after.position)

    @property
    def known_velocity(self) -> np.ndarray:
        """(W, N, 3) how they think that they move, m/s."""
        return self.readings.get("velocity", self.after.velocity)

    @cached_property
    def known_distance(self) -> np.ndarray:
        """(W, N) from there to the goal, m."""
        return distances(self.scene.goal, self.known_position)

    @property
    def depleted(self) -> np.ndarray:
        """(W, N) bool: the battery is empty."""
        return self.readings["charge"] <= 0

    @property
    def seen(self) -> np.ndarray:
        """(W, N, U) bool: which of the task's targets the drones saw that flew the decision."""
        return self.readings["sight"] & self.alive[..., None]

    @cached_property
    def collision(self) -> np.ndarray:
        """(W, N) bool: contact of collision shapes."""
        return self.contacts.mask(self.alive.shape)

    @cached_property
    def distance(self) -> np.ndarray:
        """(W, N) distance to the goal after the decision, m."""
        return distances(self.scene.goal, self.after.position)

    @cached_property
    def distance_before(self) -> np.ndarray:
        """(W, N) distance to the goal before the decision, m."""
        return distances(self.scene.goal, self.before.position)


class StepResult(NamedTuple):
    """What a task makes of a frame.

    terms       unweighted reward terms by name, (W, N) each; the reward is their sum times the task's `weights`
    terminated  (W, N) bool: drones whose episode ends here, in success or failure
    success     (W, N) bool: drones that are where the task wants them
    """

    terms: dict[str, np.ndarray]
    terminated: np.ndarray
    success: np.ndarray


class Task(ABC):
    """A task. A subclass's docstring is its MDP; class attributes hold its defaults, methods its ingredients.

    name         what `parallel_env` calls it
    Config       frozen dataclass of the task's own options; needs `d_safe` (m) and `weights` (of the reward terms);
                 its float fields are sizes, finite and not negative; a field's metadata may tell the "least" of a whole
                 number, and the "most" of any (1e9 unless told)
    defaults     values of the common options where they differ from the package's
    difficulties for each difficulty the options that it sets, common or own
    presets      named sets of values of options
    observation  names of the observation blocks
    senses       readings that the task itself judges by, such as "lidar"
    baseline     policy that flies it when none is named
    reward_weights  of the reward terms by name, unless the config's `weights` change them
    """

    name: ClassVar[str]
    Config: ClassVar[type]
    defaults: ClassVar[Mapping[str, Any]]
    difficulties: ClassVar[Mapping[str, Mapping[str, Any]]]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    observation: ClassVar[tuple[str, ...]]
    senses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[str] = "straight"
    reward_weights: ClassVar[Mapping[str, float]]

    rebound: float | None = None
    """share of the speed that is left, reversed, to a drone at the arena's bounds; None where they hold nobody back"""
    num_targets = 0
    """how many points drones are to see"""
    zone: float
    """where the warning zone about a drone ends, m"""
    arena_low: np.ndarray
    """(3,) lower corner of the space that observations and target positions are scaled to, m"""
    arena_high: np.ndarray
    """(3,) its upper corner, m"""

    def __init__(self, config: Any, context: TaskContext):
        self.config = config
        self.context = context
        self.weights = merged_weights(self.reward_weights, config.weights)
        self.zone = 2 * config.d_safe

    @abstractmethod
    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Start of one world."""

    def obstacles(self) -> Sequence[Obstacle]:
        """The bodies in every world, none by default."""
        return ()

    def layouts(self) -> Sequence[Solids]:
        """What can stand in a world, one at a time: cities, none by default."""
        return ()

    def targets(self, scene: Scene) -> np.ndarray:
        """(W, num_targets, 3) points, m, that drones are to see; none by default."""
        return np.zeros((len(scene.goal), 0, 3))

    def active_targets(self, scene: Scene) -> np.ndarray:
        """(W, num_targets) bool: targets that count, all by default."""
        return np.ones((len(scene.goal), self.num_targets), dtype=bool)

    def advance(
        self,
        scene: Scene,
        time: np.ndarray,
        flying: np.ndarray,
        rng: Sequence[np.random.Generator | None],
    ) -> bool:
        """Move goals and obstacles of the worlds that fly (W,) through one decision from `time` (W,), in place.

        Called before the drones fly. Returns whether obstacles moved; by default nothing does.
        """
        return False

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Arrays that the task keeps in `scene.memory` over an episode: shape in one world by name; none by default."""
        return {}

    def update_memory(self, frame: Frame, rng: Sequence[np.random.Generator | None]) -> None:  # noqa: B027
        """Bring `scene.memory` up to date after a decision, before it is judged; by default nothing to do.

        `rng`: the generator of each world; None before its first reset.
        """

    def payload_power(self, scene: Scene) -> np.ndarray | float:
        """(W, N) what the drones' equipment takes beside flight, W; by default nothing."""
        return 0.0

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """What else infos tell, (W, N) by name; by default the share of the targets that is served, where there are any."""
        return {"served": self.served(frame)} if self.num_targets else {}

    def served(self, frame: Frame) -> np.ndarray:
        """(W, N) share of the targets that some living drone sees, the same for all."""
        return served_share(frame.readings["sight"], frame.alive, self.active_targets(frame.scene))

    def service_quality(
        self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray
    ) -> np.ndarray:
        """(C, U) from 0 to 1: what targets (U, 3), m, are worth to drones at places (C, 3), by `sight` (C, U) bool.

        For policies that know everything; by default whether they are seen.
        """
        return sight.astype(float)

    def outside(self, frame: Frame) -> np.ndarray:
        """(W, N) bool: outside the arena after the decision, or held back at its bounds."""
        if self.rebound is not None:  # which left them right at the bounds
            return np.any(
                (frame.after.position <= self.arena_low)
                | (frame.after.position >= self.arena_high),
                axis=-1,
            )
        return np.any(
            (frame.after.position < self.arena_low) | (frame.after.position > self.arena_high),
            axis=-1,
        )

    @abstractmethod
    def evaluate_step(self, frame: Frame) -> StepResult:
        """Reward terms, ends and successes of a decision. Changes nothing: it may be asked twice."""


def affected(happened: np.ndarray, frame: Frame, whom: str) -> np.ndarray:
    """(W, N): the drones to which it happened, or, for "world", all drones of their worlds."""
    if whom == "world":
        return np.broadcast_to(
            np.any(happened & frame.alive, axis=1, keepdims=True), happened.shape
        )
    return happened


def merged_weights(defaults: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Reward weights with some of them changed. Raises ValueError for a term that does not exist."""
    for term in changes:
        if term not in defaults:
            raise ValueError(f"weights: {unknown('reward term', term, defaults)}")
    return {**defaults, **changes}


def refuse_early_end(max_distance: float, start_offset: float) -> None:
    """Raise ValueError when a drone that starts off its goal by `start_offset` m on each axis is too far from it already."""
    if max_distance <= start_offset * np.sqrt(3):
        raise ValueError(
            f"max_distance {max_distance:g} m must exceed the start offset of {start_offset:g} m"
        )
