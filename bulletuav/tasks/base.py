"""What a task is: a Markov decision process whose parts a reader sees at the top of its class."""

import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from bulletuav.errors import unknown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.config import ConfigT, TaskConfig
from bulletuav.tasks.frame import UPRIGHT, Frame, Scene, Spawn, StepResult, TaskContext
from bulletuav.tasks.given import GivenPositions
from bulletuav.tasks.ingredients import Binding, Bound, BoundTerms, find_term, numeric_fields
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.base import Part, Rngs

DEFAULT_SHOWS: Mapping[str, str] = MappingProxyType(
    {
        "success": "reached",
        "separation": "nearest (m)",
        "conflicts": "conflicts",
        "collision": "collisions",
        "goal_distance": "to goal (m)",
    }
)
"""What is shown of flights of a task that tells nothing else"""
Term = Callable[..., Any]
Weighted = float | tuple[Term | str, float]
PartT = TypeVar("PartT", bound=Part)
Value = TypeVar("Value")
SIDES = ("east", "north", "up", "west", "south", "down")
"""Sides of an arena: its upper corner's, then its lower one's"""


class Task(ABC, Generic[ConfigT]):
    """A task. A subclass's docstring tells its MDP, its attributes hold the parts.

    A whole one, in which drones come to a point 10 m up and stay there:

        @dataclass(frozen=True)
        class PerchConfig(TaskConfig):
            height: float = 10.0

        @reward
        def near(distance):
            return 1.0 / (1.0 + distance)

        @end
        def there(distance):
            return distance < 0.5

        class Perch(Task[PerchConfig]):
            name = "perch"
            observation = ("velocity", "goal_offset")
            reward = {"near": (near, 1.0), "collision": -10.0}
            ends = (collision,)
            success = there

            def spawn(self, rng):
                n = self.context.num_drones
                start = rng.uniform(-5.0, 5.0, (n, 3)) + (0.0, 0.0, 10.0)
                return Spawn(position=start, goal=np.array((0.0, 0.0, self.config.height)))

    `bulletuav.check_task(Perch)` looks for mistakes. Everything is batched: arrays are (W, N, ...)
    for W worlds of N drones.

    What several tasks have in common, such as a city, are parts: objects that `__init__` makes of
    the options and adds by `add`. Methods whose text says "by default that of its parts" ask them:
    a task that has such a method of its own calls `super()` in it.

    Attributes:
        name: What users call it.
        Config: Class of its own options; taken from `Task[...]`.
        defaults: Values of the common options where they differ from `DEFAULTS`.
        difficulties: For each difficulty the options that it sets, common or own.
        version: Of its environments; it is raised when their default behaviour changes.
        presets: Named sets of values of options.
        observation: Names of observation blocks, or such blocks.
        required_sensors: Readings that the task itself works with, such as "lidar".
        reward: Weight of each reward term by name, or (term, weight). Names are looked up in the
            registry of rewards.
        ends: What ends a drone's episode.
        success: What tells that a drone is where the task wants it.
        events: Names of what `terminated` puts into `Frame.derived` for terms.
        computed_terms: Names of terms that `compute_terms` computes, from the others.
        has_goals: Whether drones have goals, as `goal_distance` tells; else goals mean nothing.
        shows: Infos that tables and pictures of a flight show, by name: what they are called.
        baseline: Policy that flies it when none is named.
        places: Which of its drones' places users may give: "start", "goal".
        rebound: Share of the speed that is left, reversed, to a drone at the arena's bounds; None
            where they hold nobody back.
        parts: What it is built from, beside its own methods.
        num_targets: How many points drones are to see.
        zone: Separation at which the warning zone about a drone ends, m.
        arena_low: (3,) lower corner of the space to which positions are scaled, m.
        arena_high: (3,) its upper corner, m.
        team: (N,) number of each drone's team, from 0.
        takes_off: Whether drones start on the ground.
        lands: Whether drones may touch the ground: what `Frame.landed` tells is no collision then.
        team_names: Names of the teams, in their order; none where all drones are one.
        speed_limit: (N,) greatest speed that each drone can ask for, m/s, at most max_speed; None
            where that alone holds.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 1
    Config: ClassVar[type[TaskConfig]] = TaskConfig
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    difficulties: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({"easy": {}})
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    observation: ClassVar[tuple[Any, ...]]
    required_sensors: ClassVar[tuple[str, ...]] = ()
    reward: ClassVar[Mapping[str, Weighted]]
    ends: ClassVar[tuple[Term, ...]] = ()
    success: ClassVar[Term | None] = None
    events: ClassVar[tuple[str, ...]] = ()
    computed_terms: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[str] = "straight"
    places: ClassVar[tuple[str, ...]] = ()
    has_goals: ClassVar[bool] = True
    shows: ClassVar[Mapping[str, str]] = DEFAULT_SHOWS

    team_names: ClassVar[tuple[str, ...]] = ()

    rebound: float | None = None
    speed_limit: np.ndarray | None = None
    num_targets: int = 0
    zone: float
    _binding: Binding
    arena_low: np.ndarray = np.array((-100.0, -100.0, 0.0))
    arena_high: np.ndarray = np.array((100.0, 100.0, 100.0))

    def __init_subclass__(cls) -> None:
        """Take the class of the config from `Task[...]`."""
        for base in vars(cls).get("__orig_bases__", ()):
            for given in typing.get_args(base):
                if "Config" not in vars(cls) and isinstance(given, type):
                    cls.Config = given

    def __init__(self, config: ConfigT, context: TaskContext) -> None:
        """Keep options and context, and find out the weights of reward terms.

        Args:
            config: The task's own options.
            context: The swarm and the sensors that it is for.

        Raises:
            ValueError: The options cannot be.
        """
        self.config = config
        self.context = context
        given = self.reward.items()
        usual = {name: value[1] if isinstance(value, tuple) else value for name, value in given}
        self.weights = merge_weights(usual, config.weights)
        self.zone = 2 * config.d_safe
        self.parts: list[Part] = []
        self.bound = BoundTerms()
        self.team = np.zeros(context.num_drones, dtype=int)
        # Configs of other classes may have no such option.
        self.lands = self.takes_off = bool(getattr(config, "take_off", False))
        self._named_terms: dict[str, Bound] | None = None

    def add(self, part: PartT) -> PartT:
        """Add a part, after those that were added before, and return it."""
        self.parts.append(part)
        return part

    def overrides_method(self, method: str) -> bool:
        """Return whether the task, or one of its parts, does anything in a method of `Task`."""
        return getattr(type(self), method) is not getattr(Task, method) or any(
            getattr(type(part), method) is not getattr(Part, method) for part in self.parts
        )

    def bind(self, readings: frozenset[str], extra: Mapping[str, tuple[Any, float]]) -> Binding:
        """Find out what the arguments of its ingredients stand for; called once.

        Args:
            readings: Names of sensors' readings.
            extra: Reward terms beside its own: (term, weight) by name.

        Returns:
            What names stand for, for observation blocks.

        Raises:
            ValueError: An ingredient asks for a name that there is not, or a term is not known.
        """
        kind = type(self)
        # All names that ingredients may use as arguments
        numbers = {**numeric_fields(self.context), **numeric_fields(self.config), "zone": self.zone}
        corners = np.ravel([self.arena_high, self.arena_low]).tolist()
        bounds = {f"bound_{side}": bound for side, bound in zip(SIDES, corners, strict=False)}
        quantities = {"outside": self.outside, **bounds, **self.quantities()}
        names = (readings, frozenset(self.memory()))
        binding = Binding(self.name, *names, quantities, frozenset(self.events), numbers)
        for name in extra:
            if name in self.reward:
                raise ValueError(
                    f"reward has {name!r}, which is a term of task {self.name!r}: choose another "
                    f"name, or change its weight by weights={{{name!r}: ...}}"
                )
        # Extra terms take part like the task's own
        self.weights |= {name: weight for name, (_, weight) in extra.items()}
        self._binding = binding
        beside = {name: find_term("reward", term) for name, (term, _) in extra.items()}
        # Each ingredient is bound once, which finds wrong names before any flight
        self.bound = BoundTerms(
            extra={name: self._bound(name, term) for name, term in beside.items()},
            terms={name: self._bound(name, term) for name, term in self.own_terms().items()},
            ends=tuple(
                Bound(one, binding, f"end {getattr(one, '__name__', one)!r}", bool)
                for one in kind.ends
            ),
            success=kind.success and Bound(kind.success, binding, "success", bool),
        )
        return binding

    def own_terms(self, everything: bool = False) -> dict[str, Any]:
        """List the functions of the task's own reward terms whose weight is not 0, by name.

        Args:
            everything: Also those that a task of its own `evaluate_step` only names.

        Raises:
            ValueError: There is no reward term of a name.
        """
        found: dict[str, Any] = {}
        for name, value in self.reward.items():
            # A task that evaluates decisions by itself may give the terms that it only names.
            own = isinstance(value, tuple) or type(self).evaluate_step is Task.evaluate_step
            if (own or everything) and name not in self.computed_terms and self.weights[name]:
                found[name] = find_term("reward", value[0] if isinstance(value, tuple) else name)
        return found

    def _bound(self, name: str, term: Any) -> Bound:
        return Bound(term, self._binding, f"reward term {name!r}", float)

    @abstractmethod
    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the start of one world."""

    def spawn_many(self, rngs: Rngs) -> Sequence[Spawn]:
        """Draw the starts of several worlds, each from its own generator; by default one by one."""
        return [self.spawn(rng) for rng in rngs]

    def finish(self, spawn: Spawn, given: GivenPositions, rng: np.random.Generator) -> Spawn:
        """Complete the start of one world: put in what users gave, and drones on the ground.

        Then its parts complete it. Drones without goals have their starts as goals.

        Args:
            spawn: What `spawn` drew.
            given: Places in their stead.
            rng: Generator of the world, for what depends on them.
        """
        spawn = given.apply_to(spawn)
        if self.takes_off:
            place = self.on_ground(np.asarray(spawn.position))
            spawn = spawn._replace(position=place, velocity=0.0, rates=0.0, quaternion=UPRIGHT)
        for part in self.parts:
            spawn = part.finish(spawn, not given.is_empty, rng)
        return spawn if self.has_goals else spawn._replace(goal=spawn.position)

    def on_ground(self, positions: np.ndarray) -> np.ndarray:
        """Tell where drones stand on the ground below positions (N, 3), m."""
        return np.column_stack([positions[:, :2], self.context.standing_height])

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return whether a ball touches nothing of what stands in a world.

        Args:
            place: (3,) its middle, m.
            radius: m.
            layout: What stands there, one of `layouts`.
        """
        return all(part.is_free(place, radius, layout) for part in self.parts)

    def obstacles(self) -> Sequence[Obstacle]:
        """List the bodies that are in every world; by default those of its parts."""
        return tuple(chain.from_iterable(part.obstacles() for part in self.parts))

    def layouts(self) -> Sequence[Solids]:
        """List what can stand in a world, one at a time; by default that of its parts."""
        return tuple(chain.from_iterable(part.layouts() for part in self.parts))

    def targets(self, scene: Scene) -> np.ndarray:
        """Return the points that drones are to see, (W, num_targets, 3) m; none by default."""
        return np.zeros((len(scene.goal), 0, 3))

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Return which targets count, (W, num_targets) bool; all by default."""
        return np.ones((len(scene.goal), self.num_targets), dtype=bool)

    def links(self, frame: Frame) -> np.ndarray:
        """Return which drones serve which targets, (W, N, U) bool; none by default."""
        return np.zeros_like(frame.seen)

    def service_quality(
        self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray
    ) -> np.ndarray:
        """Return what targets are worth to drones, for policies that know everything.

        Args:
            place: (C, 3) of the drones, m.
            targets: (U, 3) m.
            sight: (C, U) bool, whether they are in line of sight.

        Returns:
            (C, U) from 0 to 1; by default whether they are seen.
        """
        return sight.astype(float)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move goals and obstacles through one decision, before the drones fly it.

        Args:
            scene: To be changed in place, in the worlds of `flying`.
            time: (W,) since each world's reset, s.
            flying: (W,) bool, worlds that fly.
            rngs: Random generator of each world.

        Returns:
            Whether obstacles moved; by default whether those of its parts did.
        """
        moved = [part.move_scene(scene, time, flying, rngs) for part in self.parts]
        return any(moved)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell what the task keeps in `scene.memory` over an episode.

        Returns:
            Shape of each array in one world by name; by default those of its parts.
        """
        return _merge_tables(part.memory() for part in self.parts)

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of what `memory` has, by name, for snapshots that come from elsewhere.

        Arrays from which compiled code takes indices or numbers of steps need them.

        Returns:
            Lowest and highest values, which broadcast to the array of one world; by default those
            of its parts.
        """
        return _merge_tables(part.memory_bounds() for part in self.parts)

    def start_memory(self, frame: Frame) -> None:
        """Fill the memory of worlds that were reset from their first frame; draws nothing.

        For what the first observation shows of memory, such as a sensor's reading that is kept.
        What it writes of other worlds is dropped. By default there is nothing to do.
        """

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Bring `scene.memory` up to date after a decision, before it is evaluated.

        By default that of its parts.

        Args:
            frame: The decision.
            rngs: Random generator of each world.
        """
        for part in self.parts:
            part.update_memory(frame, rngs)

    def payload_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power of the drones' equipment, (W, N) W; by default that of its parts."""
        return sum((part.payload_power(scene) for part in self.parts), 0.0)

    def quantities(self) -> Mapping[str, Any]:
        """Tell what the task works out of a frame, by the names that its ingredients use.

        Returns:
            Functions of a frame that give (W, N, ...), or numbers; by default those of its parts.
            "outside" is always there.
        """
        return _merge_tables(part.quantities() for part in self.parts)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return further infos, (W, N) by name; by default those of its parts."""
        return _merge_tables(part.info(frame) for part in self.parts)

    def world_state(self) -> Mapping[str, Block]:
        """List what the global state has beside drones; by default that of its parts.

        Returns:
            Blocks of (W, labels) by name.
        """
        return _merge_tables(part.world_state() for part in self.parts)

    def outside(self, frame: Frame) -> np.ndarray:
        """Tell who is outside the arena, or held back at its bounds, (W, N) bool."""
        known = frame.derived.get("outside")
        if known is not None:  # asked before, of the same frame
            return known
        position = frame.after.position
        if self.rebound is not None:  # which left them right at the bounds
            beyond = (position <= self.arena_low) | (position >= self.arena_high)
        else:
            beyond = (position < self.arena_low) | (position > self.arena_high)
        outside: np.ndarray = np.any(beyond, axis=-1)
        frame.derived["outside"] = outside
        return outside

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell whose episode ends here, (W, N) bool; by default by any of `ends`."""
        if not self.bound.ends:
            return np.zeros(frame.alive.shape, dtype=bool)
        ended: np.ndarray = np.any([one(frame) for one in self.bound.ends], axis=0)
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell who is where the task wants it, (W, N) bool; by default by `success`."""
        if self.bound.success is None:
            return np.zeros(frame.alive.shape, dtype=bool)
        return self.bound.success(frame)

    def reward_terms(self, frame: Frame) -> dict[str, np.ndarray]:
        """Compute the reward terms whose weight is not 0, unweighted, (W, N) by name."""
        if self._named_terms is None:  # a task of its own `evaluate_step` asks for them after all
            own = self.own_terms(everything=True)
            self._named_terms = {
                name: self.bound.terms.get(name) or self._bound(name, term)
                for name, term in own.items()
            }
        terms = {name: term(frame) for name, term in self._named_terms.items()}
        if any(self.weights.get(name) for name in self.computed_terms):
            terms |= self.compute_terms(frame, terms)
        return terms

    def compute_terms(
        self, frame: Frame, terms: Mapping[str, np.ndarray]
    ) -> Mapping[str, np.ndarray]:
        """Compute the `computed_terms`, unweighted, (W, N) by name, from all others.

        Called where one of them has a weight other than 0.
        """
        return {}

    def extra_terms(self, frame: Frame) -> dict[str, np.ndarray]:
        """Compute the terms that the option `reward` added."""
        extra = self.bound.extra.items()
        return {name: term(frame) for name, term in extra if self.weights[name]}

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Work out ends, successes and reward terms of a decision, in this order.

        Changes nothing of the world: it may be asked twice.
        """
        terminated, success = self.terminated(frame), self.succeeded(frame)
        return StepResult(self.reward_terms(frame), terminated, success)


def _merge_tables(tables: Iterable[Mapping[str, Value]]) -> dict[str, Value]:
    """Join tables of different names."""
    return {name: value for table in tables for name, value in table.items()}


def merge_weights(defaults: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Change some reward weights. Raises ValueError for a term that does not exist."""
    for term in changes:
        if term not in defaults:
            raise ValueError(f"weights: {unknown('reward term', term, defaults)}")
    return {**defaults, **changes}
