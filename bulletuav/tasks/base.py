"""Base class of tasks: a Markov decision process declared by class attributes and a few methods."""

import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import isfunction, unwrap
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
from bulletuav.tasks.parts import base as part_base
from bulletuav.tasks.parts.base import Part
from bulletuav.tasks.parts.loads import Loads
from bulletuav.tasks.parts.restarts import Restarts
from bulletuav.tasks.parts.safety import Safety
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import GROUND

DEFAULT_SHOWS: Mapping[str, str] = MappingProxyType(
    {
        "success": "success",
        "separation": "nearest (m)",
        "conflicts": "conflicts",
        "collision": "collisions",
        "goal_distance": "to goal (m)",
    }
)
"""Infos that tables and pictures show unless a task defines `shows`"""
Rngs = part_base.Rngs
Term = Callable[..., Any]
Weighted = float | tuple[Term | str, float]
PartT = TypeVar("PartT", bound=Part)
Value = TypeVar("Value")
SIDES = ("east", "north", "up", "west", "south", "down")
"""Sides of the arena: first of its upper corner (x, y, z), then of its lower corner"""


class Task(ABC, Generic[ConfigT]):
    """A task for a swarm of drones: starts, observations, reward, termination and success.

    The docstring of a subclass describes its MDP; its class attributes declare the parts. A
    complete task, in which drones fly to a point 10 m up and hold it::

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

    Check a task for mistakes with `bulletuav.check_task(Perch)`. All computations are batched:
    arrays are (W, N, ...) for W worlds of N drones.

    Features shared by several tasks, such as a city, are parts (`bulletuav.tasks.parts`):
    `__init__` creates them from the options and registers them with `add`. Methods documented as
    "by default those of its parts" delegate to the parts; a task that overrides such a method calls
    `super()` in it.

    Attributes:
        name: Name of the task in the registry.
        Config: Class of the task's own options; inferred from `Task[...]`.
        defaults: Defaults of environment options that differ from `DEFAULTS`.
        difficulties: For each difficulty, the options that it sets: environment options or own
            ones.
        version: Version of the environments; incremented when their default behaviour changes.
        presets: Named sets of option values.
        observation: Names of observation blocks, or the blocks themselves; or a dict from the names
            of the teams to such tuples.
        required_sensors: Readings that the task itself uses, such as "lidar".
        reward: Weight of each reward term by name, or (term, weight). Names refer to the registry
            of rewards.
        ends: Conditions that terminate a drone's episode.
        success: Condition under which a drone counts as successful, if it was safe (`safety`).
        events: Names of the arrays that `terminated` writes to `Frame.derived` for reward terms.
        training_weights: Weights for training that differ from those in `reward`, by term; see
            `bulletuav.envs.options.EnvOptions.reward`.
        computed_terms: Names of the terms that `compute_terms` computes from the other terms.
        has_goals: Whether drones have goals, as `goal_distance` reports. If False, `Scene.goal` is
            unused.
        turns_obstacles: Whether `move_scene` changes attitudes of obstacles, too. Within a decision
            they rotate about their positions at constant rates.
        shows: Infos that tables and pictures of a flight show, with their captions.
        baseline: Policy that flies the task when none is named.
        oracle: Policy that knows the whole state and shows that a difficulty can be done; the
            baseline if empty.
        shirkers: Policies that try to be paid in this task without doing it; see
            `bulletuav.analysis.incentives`.
        has_absent: Whether episodes may have fewer drones than `num_drones`; the task then treats
            absent drones as those that are not in `Frame.alive`.
        needs_cables: Whether the task flies only in dynamics with cables, "rigid_body", as `loads`
            need them.
        needs_hover: Whether all drones have to be able to hover. If False, aircraft that cannot
            hover may fly the task, and their episodes start in flight at cruise speed.
        is_game: Whether teams play against each other, so that safety is part of the game.
        places: Positions that users may set: "start", "goal".
        rebound: Coefficient of restitution at the arena's bounds: the fraction of the normal speed
            that is kept, reversed. None if drones can cross the bounds.
        parts: Parts of the task, in the order of `add`.
        safety: Part that counts conflicts and collisions, which rule out success; None if success
            does not depend on them.
        loads: Part with loads on cables, which the environment flies; None without loads.
        restarts: Part that starts drones again whose episode would end; None if their episode ends.
        num_targets: Number of target points that drones are to see.
        target_radius: Radius of the bodies around target points, which do not hide them, m.
        zone: Separation at which the warning zone around a drone ends, m.
        arena_low: (3,) lower corner of the arena, which also bounds observed positions, m.
        arena_high: (3,) upper corner of the arena, m.
        team: (N,) index of each drone's team, from 0.
        takes_off: Whether drones start on the ground.
        lands: Whether drones may touch the ground: contacts marked in `Frame.landed` are no
            collisions.
        landing_places: What drones may land on, as in `Contacts.other`; by default the ground.
        team_names: Names of the teams, by index; empty if there is one team.
        speed_limit: (N,) maximum commanded speed of each drone, m/s, at most max_speed; None if
            max_speed is the only limit.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 1
    Config: ClassVar[type[TaskConfig]] = TaskConfig
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    difficulties: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({"easy": {}})
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    observation: ClassVar[tuple[Any, ...] | Mapping[str, tuple[Any, ...]]]
    required_sensors: ClassVar[tuple[str, ...]] = ()
    reward: ClassVar[Mapping[str, Weighted]]
    training_weights: ClassVar[Mapping[str, float]] = MappingProxyType({})
    ends: ClassVar[tuple[Term, ...]] = ()
    success: ClassVar[Term | None] = None
    events: ClassVar[tuple[str, ...]] = ()
    computed_terms: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[str] = "straight"
    oracle: ClassVar[str] = ""
    shirkers: ClassVar[tuple[str, ...]] = ()
    has_absent: ClassVar[bool] = False
    needs_cables: ClassVar[bool] = False
    needs_hover: ClassVar[bool] = True
    is_game: ClassVar[bool] = False
    places: ClassVar[tuple[str, ...]] = ()
    has_goals: ClassVar[bool] = True
    turns_obstacles: ClassVar[bool] = False
    shows: ClassVar[Mapping[str, str]] = DEFAULT_SHOWS

    team_names: ClassVar[tuple[str, ...]] = ()

    landing_places: tuple[int, ...] = (GROUND,)
    safety: Safety | None = None
    loads: Loads | None = None
    restarts: Restarts | None = None
    rebound: float | None = None
    speed_limit: np.ndarray | None = None
    num_targets: int = 0
    target_radius: float = 0.0
    zone: float
    _binding: Binding
    arena_low: np.ndarray = np.array((-100.0, -100.0, 0.0))
    arena_high: np.ndarray = np.array((100.0, 100.0, 100.0))

    def __init_subclass__(cls) -> None:
        """Set `Config` to the type argument of `Task[...]`."""
        for base in vars(cls).get("__orig_bases__", ()):
            for given in typing.get_args(base):
                if "Config" not in vars(cls) and isinstance(given, type):
                    cls.Config = given

    def __init__(self, config: ConfigT, context: TaskContext) -> None:
        """Store options and context, and merge the weights of the reward terms.

        Args:
            config: The task's own options.
            context: Swarm and sensors for which the task is made.

        Raises:
            ValueError: If the options are invalid.
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
        # Configs that are no TaskConfig may lack this option
        self.lands = self.takes_off = bool(getattr(config, "take_off", False))
        self._named_terms: dict[str, Bound] | None = None

    def add(self, part: PartT) -> PartT:
        """Append a part to the task's parts and return it.

        Raises:
            TypeError: If a method of the task hides a method of the part, as it does not call
                `super()`.
        """
        kind = type(part)
        for name in sorted(vars(Part).keys() & vars(Task).keys()):
            hiding = _hiding_class(type(self), name)
            if hiding and getattr(kind, name) is not getattr(Part, name):
                raise TypeError(
                    f"{hiding}.{name} hides that of the part {kind.__name__}: "
                    f"call super().{name}(...) in it and use the result"
                )
        self.parts.append(part)
        return part

    def overrides_method(self, method: str) -> bool:
        """Return True if the task or one of its parts overrides a method of `Task`."""
        # No generator, as an interrupt within one is lost
        for part in self.parts:
            if getattr(type(part), method) is not getattr(Part, method):
                return True
        return getattr(type(self), method) is not getattr(Task, method)

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return the options that fit the task to aircraft that cannot hover, none by default.

        They replace those of the defaults and the difficulty, and should fit those that are kept.

        Args:
            airframes: Airframes of these aircraft.
            values: All options by name.
            kept: Options that stay, by name: those that the user gives and those of a preset.
        """
        return {}

    def bind(self, readings: frozenset[str], extra: Mapping[str, tuple[Any, float]]) -> Binding:
        """Bind the arguments of all ingredients to their sources. Called once.

        Args:
            readings: Names of the sensors' readings.
            extra: Additional reward terms by name: (term, weight).

        Returns:
            The binding of argument names, for observation blocks.

        Raises:
            ValueError: If an ingredient requests an unknown name, or a term is unknown.
            TypeError: If `ends` or `success` has no effect.
        """
        kind = type(self)
        for given, condition, method in (
            (kind.ends, "ends", "terminated"),
            (kind.success, "success", "succeeded"),
        ):
            hiding = _hiding_class(kind, method)
            if given and hiding:
                raise TypeError(
                    f"{condition} of task {self.name!r} has no effect, as {hiding}.{method} does "
                    f"not call super().{method}(...): override {method} instead"
                )
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
        self.weights |= {name: weight for name, (_, weight) in extra.items()}
        self._binding = binding
        beside = {name: find_term("reward", term) for name, (term, _) in extra.items()}
        # Binding all ingredients here reports wrong names before any flight
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
        """Return the functions of the task's own reward terms with nonzero weights, by name.

        Args:
            everything: Whether to include terms given by name in tasks that override
                `evaluate_step`.

        Raises:
            ValueError: If no reward term has this name.
        """
        found: dict[str, Any] = {}
        for name, value in self.reward.items():
            # A task that overrides `evaluate_step` may compute the terms that it only names
            own = isinstance(value, tuple) or type(self).evaluate_step is Task.evaluate_step
            if (own or everything) and name not in self.computed_terms and self.weights[name]:
                found[name] = find_term("reward", value[0] if isinstance(value, tuple) else name)
        return found

    def _bound(self, name: str, term: Any) -> Bound:
        return Bound(term, self._binding, f"reward term {name!r}", float)

    @abstractmethod
    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the start of one world from `rng`."""

    def spawn_many(self, rngs: Rngs) -> Sequence[Spawn]:
        """Draw the starts of several worlds, each from its own generator; by default by `spawn`."""
        return [self.spawn(rng) for rng in rngs]

    def finish(self, spawn: Spawn, given: GivenPositions, rng: np.random.Generator) -> Spawn:
        """Complete the start of one world.

        Applies given positions, places drones on the ground if they take off, and runs the parts.
        The goal of a drone without a goal is its start.

        Args:
            spawn: Start returned by `spawn`.
            given: Positions set by the user, which replace drawn ones.
            rng: Generator of the world, for draws that depend on these positions.
        """
        spawn = given.apply_to(spawn)
        if self.takes_off:
            place = self.on_ground(np.asarray(spawn.position))
            spawn = spawn._replace(position=place, velocity=0.0, rates=0.0, quaternion=UPRIGHT)
        for part in self.parts:
            spawn = part.finish(spawn, not given.is_empty, rng)
        return spawn if self.has_goals else spawn._replace(goal=spawn.position)

    def on_ground(self, positions: np.ndarray) -> np.ndarray:
        """Return the positions of drones that stand on the ground below given positions.

        Args:
            positions: (N, 3) m.

        Returns:
            (N, 3) m, at each drone's standing height.
        """
        return np.column_stack([positions[:, :2], self.context.standing_height])

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return True if a ball intersects no building of a layout.

        Args:
            place: (3,) centre of the ball, m.
            radius: Radius of the ball, m.
            layout: Index into `layouts`.
        """
        return all(part.is_free(place, radius, layout) for part in self.parts)

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the obstacles in every world; by default those of its parts."""
        return tuple(chain.from_iterable(part.obstacles() for part in self.parts))

    def layouts(self) -> Sequence[Solids]:
        """Return the possible sets of buildings of a world; by default those of its parts."""
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
        """Return how well drones at candidate positions would serve targets, for oracle policies.

        Args:
            place: (C, 3) candidate positions of drones, m.
            targets: (U, 3) positions of targets, m.
            sight: (C, U) bool, whether each target is in line of sight.

        Returns:
            (C, U) quality from 0 to 1; by default 1 if the target is in line of sight.
        """
        return sight.astype(float)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move goals and obstacles through one decision, before the drones fly it.

        Args:
            scene: Scene, modified in place in the worlds of `flying`.
            time: (W,) time since each world's reset, s.
            flying: (W,) bool, worlds that fly the decision.
            rngs: Random generator of each world.

        Returns:
            Whether any obstacle moved; by default whether any part moved one.
        """
        moved = [part.move_scene(scene, time, flying, rngs) for part in self.parts]
        return any(moved)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the arrays that the task keeps in `scene.memory` in an episode.

        Returns:
            Shape of each array in one world, by name; by default those of its parts.
        """
        return _merge_tables(part.memory() for part in self.parts)

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of the arrays in `memory`, by name, to validate loaded snapshots.

        Arrays that compiled code uses as indices or counts need bounds.

        Returns:
            Lower and upper bounds that broadcast to the array of one world; by default those of its
            parts.
        """
        return _merge_tables(part.memory_bounds() for part in self.parts)

    def start_memory(self, frame: Frame) -> None:
        """Initialise the memory of worlds that were reset, from their first frame.

        Use it for memory that the first observation shows, such as a held sensor reading. Values
        written to other worlds are discarded. It must not draw random numbers. Does nothing by
        default.
        """

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update `scene.memory` after a decision, before the decision is evaluated.

        By default updates the memory of its parts.

        Args:
            frame: The decision.
            rngs: Random generator of each world.
        """
        for part in self.parts:
            for function, *arguments in part.memory_calls(frame):
                function(*arguments)
            part.update_memory(frame, rngs)

    def payload_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power of the drones' payloads, (W, N) W; by default the sum over its parts."""
        return sum((part.payload_power(scene) for part in self.parts), 0.0)

    def charging_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power that charges the drones' batteries in flight, (W, N) W.

        By default the sum over its parts.
        """
        return sum((part.charging_power(scene) for part in self.parts), 0.0)

    def observation_blocks(self) -> tuple[Any, ...] | Mapping[str, tuple[Any, ...]]:
        """Return the default observation: the class attribute and the blocks of the parts."""
        added = tuple(chain.from_iterable(part.observation_blocks() for part in self.parts))
        if isinstance(self.observation, Mapping):
            return {team: _joined(own, added) for team, own in self.observation.items()}
        return _joined(self.observation, added)

    def quantities(self) -> Mapping[str, Any]:
        """Return the quantities that the task derives from a frame, by name, for ingredients.

        Returns:
            Functions of a frame that return (W, N, ...), or numbers; by default those of its parts.
            "outside" is always defined.
        """
        return _merge_tables(part.quantities() for part in self.parts)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return additional infos, (W, N) by name; by default those of its parts."""
        return _merge_tables(part.info(frame) for part in self.parts)

    def compiled_info_names(self) -> list[str]:
        """List the names of the infos that compiled calls of the parts write."""
        return list(_merge_tables(dict.fromkeys(part.compiled_infos) for part in self.parts))

    def world_state(self) -> Mapping[str, Block]:
        """Return the global state other than that of drones; by default that of its parts.

        Returns:
            Blocks of (W, labels) by name.
        """
        return _merge_tables(part.world_state() for part in self.parts)

    def outside(self, frame: Frame) -> np.ndarray:
        """Return which drones are outside the arena, or stopped at its bounds, (W, N) bool."""
        known = frame.derived.get("outside")
        if known is not None:  # cached for this frame
            return known
        position = frame.after.position
        if self.rebound is not None:  # drones that rebounded are exactly at the bounds
            beyond = (position <= self.arena_low) | (position >= self.arena_high)
        else:
            beyond = (position < self.arena_low) | (position > self.arena_high)
        outside: np.ndarray = np.any(beyond, axis=-1)
        frame.derived["outside"] = outside
        return outside

    def terminated(self, frame: Frame) -> np.ndarray:
        """Return which drones' episodes terminate, (W, N) bool; by default by any of `ends`."""
        if not self.bound.ends:
            return np.zeros(frame.alive.shape, dtype=bool)
        ended: np.ndarray = np.any([one(frame) for one in self.bound.ends], axis=0)
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones do the task, (W, N) bool; by default where `success` holds.

        They are successful if they were safe, too: see `safety`.
        """
        if self.bound.success is None:
            return np.zeros(frame.alive.shape, dtype=bool)
        return self.bound.success(frame)

    def reward_terms(self, frame: Frame) -> dict[str, np.ndarray]:
        """Compute the reward terms with nonzero weights, unweighted, (W, N) by name."""
        if self._named_terms is None:  # reached if an overridden `evaluate_step` calls this
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
        """Compute the `computed_terms`, unweighted, (W, N) by name, from all other terms.

        Called if any of them has a nonzero weight.
        """
        return {}

    def extra_terms(self, frame: Frame) -> dict[str, np.ndarray]:
        """Compute the reward terms of the option `reward`, unweighted, (W, N) by name."""
        extra = self.bound.extra.items()
        return {name: term(frame) for name, term in extra if self.weights[name]}

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Compute termination, success and reward terms of a decision, in this order.

        The method does not modify the world, so it may be called twice.
        """
        terminated, success = self.terminated(frame), self.succeeded(frame)
        if self.safety is not None:
            success = success & self.safety.is_safe(frame)
        return StepResult(self.reward_terms(frame), terminated, success)


def _hiding_class(kind: type[Task[Any]], method: str) -> str:
    """Return the name of the class whose override of a method of `Task` does not call it, or ""."""
    callers = {"super", *(base.__name__ for base in kind.__mro__)}
    for owner in kind.__mro__[: kind.__mro__.index(Task)]:
        function = vars(owner).get(method)
        if isfunction(function):
            names = unwrap(function).__code__.co_names
            if method not in names or callers.isdisjoint(names):
                return owner.__name__
    return ""


def _joined(own: tuple[Any, ...], added: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return all blocks, without those added that are there already."""
    return (*own, *(one for one in added if one not in own))


def _merge_tables(tables: Iterable[Mapping[str, Value]]) -> dict[str, Value]:
    """Merge the tables of all parts.

    Raises:
        ValueError: If two parts use the same name.
    """
    merged: dict[str, Value] = {}
    for table in tables:
        both = merged.keys() & table.keys()
        if both:
            raise ValueError(f"two parts define {min(both)!r}: rename that of one of them")
        merged.update(table)
    return merged


def merge_weights(defaults: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Return reward weights with some of them replaced.

    Raises:
        ValueError: If `changes` names an unknown term.
    """
    for term in changes:
        if term not in defaults:
            raise ValueError(f"weights: {unknown('reward term', term, defaults)}")
    return {**defaults, **changes}
