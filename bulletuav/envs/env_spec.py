"""Validated options, task, action and observation of an environment, before an engine exists."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.actions import Action, ActionContext, make_actions
from bulletuav.control.actions.messages import add_message
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import find_dynamics
from bulletuav.envs.bodies import count_bodies
from bulletuav.envs.cables import require_cables
from bulletuav.envs.global_state import GlobalState
from bulletuav.envs.loads import require_lift
from bulletuav.envs.options import EnvOptions, check_names
from bulletuav.envs.parts import num_surfaces, sensor_setup
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.envs.state import Sizes, State
from bulletuav.envs.teams import of_drones
from bulletuav.errors import (
    as_int,
    as_sequence,
    numbers_of,
    require_available_memory,
    shown,
    unknown,
)
from bulletuav.sensors.base import SensorSetup
from bulletuav.sensors.camera import COMPILED_ONLY, DEPTH_IMAGES, IMAGES
from bulletuav.sensors.lidar import make_beams
from bulletuav.sensors.messages import Channel, Messages
from bulletuav.sensors.suite import provider
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.base import Task
from bulletuav.tasks.check import check_arena, check_bodies
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.given import DRAWN, PLACES, GivenStart
from bulletuav.tasks.ingredients import find_term
from bulletuav.tasks.observations.images import ARRAY
from bulletuav.tasks.observations.mixed import MixedObservations
from bulletuav.tasks.observations.observer import (
    STATE,
    ObservationBuilder,
    known_observations,
    needed_readings,
    observation_name,
    requested_readings,
)
from bulletuav.tasks.starts import read_given_positions
from bulletuav.vehicle.cruise import top_speed, turn_radius

MAX_WORLDS = 1_000_000
BODY_BYTES, OBSTACLE_BYTES, LAYOUT_BYTES = 100_000, 5_000, 100_000
"""Bytes of a drone, an obstacle and a city in one world, without the arrays of the state.

Most of the memory is in the engine; measured.
"""
NUMBER_BYTES = 8
HEARD_NUMBERS = 5
"""A third of the numbers that a drone keeps of each other one: message, age, copy, chances"""
CAMERA_OPTIONS = {
    "camera_range": DEPTH_IMAGES,
    "camera_depth": DEPTH_IMAGES,
    "camera_mounts": tuple(IMAGES),
}
"""Images that options of cameras change"""
ENERGY_READINGS = frozenset({"charge", "power", "voltage"})
"""Readings of the battery, which no sensor provides"""


class EnvSpec:
    """Validated options of an environment, and what follows from them.

    Attributes:
        num_worlds: Number of worlds W.
        options: Common options.
        task: The task.
        given: Starts from the options: positions and goals.
        action: Definition of actions.
        decision_every: (N,) decisions of the world for each one of a drone; None for 1.
        observer: Computes the observations.
        state: Computes the global state.
        sensors: All available sensors, by name.
        setup: Description of the environment for sensors.
    """

    def __init__(self, task: TaskSource, num_worlds: int, options: dict[str, Any]) -> None:
        """Validate all options; see `Aviary`.

        Raises:
            ValueError: If an option is invalid.
        """
        kind = find_task(task)
        self.num_worlds = as_int("num_worlds", num_worlds, 1, MAX_WORLDS)
        self.options, config, self.sensors = resolve_options(kind, options)
        self.options.check_worlds(self.num_worlds)
        self._require_memory(BODY_BYTES * self.options.num_drones)
        self._check_absent(kind)
        self.task = _make_task(kind, config, self.options)
        dynamics = find_dynamics(self.options.dynamics)
        if kind.needs_cables or self.task.loads is not None:
            loaded = f"task {self.task.name!r} has loads"
            require_cables(dynamics, self.options.contacts, loaded)
        places = (getattr(self.task.config, name, None) for name in PLACES)
        given = read_given_positions(self.task, *places)
        self.given = DRAWN if given.is_empty else GivenStart(given)
        if self.task.loads is not None:
            require_lift(self.task.loads, self.options)
        self.action = _make_action(self.options, self.task)
        rates = self.options.decision_every
        self.decision_every = (
            None if rates is None else np.array(of_drones("decision_every", rates, self.task))
        )
        # Observations determine which sensors are needed
        given_blocks = self.options.observation
        asked = self.task.observation_blocks() if given_blocks is None else given_blocks
        if self.options.communication is not None:
            asked = self._add_messages(self.options.communication, asked)
        for one in asked.values() if isinstance(asked, Mapping) else (asked,):
            self._check_observation(one)
        kinds, kind_of = _kinds_of_drones(asked, self.task)
        sources = _joined(kinds)
        self._names = {observation_name(source) for source in sources}
        wanted = self._wanted(sources)
        self._check_cameras(wanted)
        self.setup = self._make_setup(wanted)
        readings = frozenset(name for one in self.sensors.values() for name in one.gives)
        if not self.task.num_targets:  # there is nothing to see
            readings -= {"sight"}
        # Names in ingredients and blocks are resolved once, here
        binding = self.task.bind(readings | ENERGY_READINGS, self.options.reward)
        parts = (self.task, self.action, binding, self.sensors, self.setup)
        settings: dict[str, Any] = {
            "normalise": self.options.normalise,
            "form": self.options.observation_format,
            "num_frames": self.options.frame_stack,
            "camera_format": self.options.camera_format,
        }
        self.observer = ObservationBuilder(sources, *parts, **settings)
        if len(kinds) > 1:
            self.observer.require_vectors()
            made = [ObservationBuilder(one, *parts, **settings) for one in kinds]
            self.observer = MixedObservations(made, kind_of, self.observer)
        self._check_pictures()
        if getattr(self.task, "respawns", False) and count_bodies(self.options.bodies):
            raise ValueError(
                "at_goal is 'respawn', and new goals may lie in bodies: leave out bodies, or "
                "choose another at_goal"
            )
        if self.options.battery_capacity is None and self.task.overrides_method("charging_power"):
            raise ValueError(
                "charging_pads have no effect without battery_capacity: set it in W h, or leave "
                "them out"
            )
        drones = ObservationBuilder(STATE, *parts)
        self.state = GlobalState(self.task, drones, self.options)
        self._require_memory(self._world_bytes())
        # If it is no class attribute, `Worlds` checks it with the instance
        consumes: object = find_dynamics(self.options.dynamics).consumes
        if isinstance(consumes, SetpointLevel):
            self.options.check_setpoint_levels(self.action.kind_levels, consumes)

    def _add_messages(self, channel: Channel, observation: Any) -> Any:
        """Add messages to actions, sensors and the observation, or that of each team."""
        is_discrete = self.action.choices is not None
        messages = Messages(channel, is_discrete)
        if messages.name in self.sensors:
            raise ValueError(
                f"sensors has {messages.name!r}, the name of the sensor of communication: rename it"
            )
        self.sensors = {**self.sensors, messages.name: messages}
        self.action = add_message(self.action, channel.size, channel.tokens)

        def added(sources: Any) -> tuple[Any, ...]:
            listed = tuple(sources)
            return listed if messages.name in listed else (*listed, messages.name)

        if isinstance(observation, Mapping):
            return {team: added(sources) for team, sources in observation.items()}
        return added(observation)

    def _check_absent(self, kind: type[Task[Any]]) -> None:
        """Raise ValueError for a drawn number of drones in tasks that need all of them."""
        options = self.options
        if options.min_drones is not None and not kind.has_absent:
            raise ValueError(
                f"num_drones is {(options.min_drones, options.num_drones)}, and task {kind.name!r} "
                f"needs all of its drones: give one number"
            )

    def _check_observation(self, sources: tuple[Any, ...]) -> None:
        """Raise ValueError for unknown names of observations, and for repeated ones."""
        if not sources:
            raise ValueError(
                "observation is empty: name at least one block, or leave it out for the task's own"
            )
        known = known_observations(self.sensors)
        plain = tuple(one for one in sources if isinstance(one, str) and ":" not in one)
        check_names("observation", "observation block", plain, known)
        names = [observation_name(source) for source in sources]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(
                    f"observation has {name!r} {names.count(name)} times: name it once"
                )
        for one in sources:
            if not isinstance(one, str) and not callable(one) and not hasattr(one, "labels"):
                raise ValueError(f"observation: {unknown('observation block', one, known)}")

    def _check_pictures(self) -> None:
        """Raise ValueError for options of pictures without a picture."""
        if self.observer.images:
            return
        if self.options.frame_stack > 1:
            raise ValueError(
                f"frame_stack is {self.options.frame_stack}, and no picture is observed: name one "
                "in observation, such as 'depth', or stack vectors by "
                "gymnasium.wrappers.FrameStackObservation"
            )
        if self.options.camera_format != ARRAY:
            raise ValueError(
                f"camera_format is {self.options.camera_format!r}, and no picture is observed: add "
                f"one, such as 'depth', or leave it out"
            )

    def _wanted(self, sources: tuple[Any, ...]) -> frozenset[str]:
        """List the readings that observations, the task and reward terms need."""
        kind = type(self.task)
        terms = [find_term("reward", value[0]) for value in self.options.reward.values()]
        terms += [*self.task.own_terms().values(), *kind.ends, kind.success]
        asked = needed_readings(sources, self.sensors)
        asked = asked.union(*(requested_readings(one, self.sensors) for one in terms))
        for name in kind.required_sensors:
            if provider(self.sensors, name) is None:
                what = f"reading among the required_sensors of task {self.task.name!r}:"
                known = {reading for one in self.sensors.values() for reading in one.gives}
                raise unknown(what, name, known)
        given = [one.name for one in self.options.sensors if hasattr(one, "name")]
        own = {reading for name in given for reading in self.sensors[name].gives}
        return frozenset({*asked, *kind.required_sensors, *own})

    def _check_cameras(self, wanted: frozenset[str]) -> None:
        """Raise ValueError for pictures that cannot be taken, and options of those not taken."""
        # All readings of an additional camera are wanted; they are not observed
        for name in COMPILED_ONLY:
            if self.options.camera == "bullet" and name in self._names:
                raise ValueError(f"camera 'bullet' draws no {name!r}: use camera 'compiled'")
        for name, images in CAMERA_OPTIONS.items():
            usual = getattr(EnvOptions, name)
            usual = self.task.defaults.get(name, usual), usual
            given = getattr(self.options, name) not in usual
            if given and not wanted.intersection(images):
                raise ValueError(
                    f"{name} has no effect without {' or '.join(map(repr, images))}: leave it out, "
                    f"or add one to observation"
                )

    def _make_setup(self, wanted: frozenset[str]) -> SensorSetup:
        return dataclasses.replace(
            sensor_setup(self.options, self.num_worlds, wanted),
            num_targets=self.task.num_targets,
            target_radius=self.task.target_radius,
            arena=(self.task.arena_low, self.task.arena_high),
        )

    def _require_memory(self, each: float) -> None:
        """Raise ValueError if worlds of `each` bytes do not fit into memory."""
        drones = self.options.num_drones
        what = (
            f"{self.num_worlds} worlds of {drones} drones (num_worlds, num_drones) with their "
            f"observations"
        )
        remedy = "lower num_worlds, num_drones, or the size of observations"
        require_available_memory(what, self.num_worlds * each, remedy)

    def _world_bytes(self) -> float:
        """Estimate the memory of a world.

        The estimate includes bodies of drones, obstacles and cities, the arrays of the state, and
        the data of each drone: its observation, pictures, the other drones, and targets.
        """
        drones, task = self.options.num_drones, self.task
        images = self._names.intersection(IMAGES)
        mounts = self.setup.camera_mounts
        cameras = len(mounts) if isinstance(mounts, tuple) else 1
        late = round(self.setup.longest_picture_delay / self.setup.period)
        stored = cameras * (1 + late) if images else 0
        pictures = stored * math.prod(self.options.camera_size)
        others = drones if "all_neighbours" in self._names else 0
        others += HEARD_NUMBERS * drones if self._has_radio() else 0
        pictures *= 1 + self.options.frame_stack
        features = sum(one.low.size for one in self.observer.kinds)
        observed = 2 * features + pictures + 3 * others + 2 * task.num_targets
        obstacles = len(task.obstacles()) + count_bodies(self.options.bodies)
        things = OBSTACLE_BYTES * obstacles + LAYOUT_BYTES * len(task.layouts())
        return (BODY_BYTES + NUMBER_BYTES * observed) * drones + self.state_bytes() + things

    def _has_radio(self) -> bool:
        """Return True if each drone keeps what it hears from each other drone."""
        radio = self.sensors["radio"]
        names = {f"{radio.prefix}{key}" for key in radio.uncertain}
        is_uncertain = not names.isdisjoint(self.options.randomization.active)
        return is_uncertain or bool(self.setup.wanted.intersection(radio.gives))

    def state_bytes(self) -> int:
        """Return the bytes that the arrays of the state need for a world.

        They are computed from the shapes of a state of zero worlds.
        """
        rotors = max(len(one.rotors) for one in self.options.airframe)
        surfaces = num_surfaces(self.options)
        # Setpoints have three numbers and a yaw, or one for each rotor and control surface
        numbers = (self.action.low.shape[-1], max(4, rotors + surfaces))
        obstacles = len(self.task.obstacles())
        sizes = Sizes(0, self.options.num_drones, *numbers, obstacles, rotors, surfaces)
        return State.make(sizes, self.task.memory()).world_bytes()

    def mask(self, mask: np.ndarray | None) -> np.ndarray:
        """Convert a mask (W,) of worlds to reset; None selects all.

        Raises:
            ValueError: If the mask has another shape or type.
        """
        if mask is None:
            return np.ones(self.num_worlds, dtype=bool)
        try:
            mask = np.asarray(mask)
        except ValueError:
            raise ValueError(
                f"mask is {shown(mask)}: ({self.num_worlds},) bool is needed"
            ) from None
        if mask.shape != (self.num_worlds,) or mask.dtype.kind != "b":
            raise ValueError(
                f"mask has shape {mask.shape} and type {mask.dtype}: ({self.num_worlds},) bool is "
                f"needed"
            )
        return mask

    def indices(self, worlds: Any) -> np.ndarray:
        """Convert the indices (S,) of worlds; None selects all, and one number one world.

        Raises:
            ValueError: If indices are not whole numbers, are repeated, or there is no such world.
        """
        if worlds is None:
            return np.arange(self.num_worlds)
        listed = [worlds] if isinstance(worlds, int | np.integer) else worlds
        chosen = as_sequence("worlds", listed, most=self.num_worlds)
        for world in chosen:
            self.require_world(world)
        if len(set(chosen)) < len(chosen):
            raise ValueError(f"worlds is {shown(worlds)}: each one once is needed")
        return np.array(chosen, dtype=int)

    def require_world(self, world: Any) -> None:
        """Check the index of a world.

        Raises:
            ValueError: If there is no such world.
        """
        if (
            not isinstance(world, int | np.integer)
            or isinstance(world, bool)
            or not 0 <= world < self.num_worlds
        ):
            raise self._no_world(world)

    def worlds(self, world: Any) -> np.ndarray:
        """Convert one or several indices of worlds to an array.

        Raises:
            ValueError: If there is no such world.
        """
        try:
            worlds = np.asarray(world)
        except ValueError:
            raise self._no_world(world) from None
        if worlds.dtype.kind not in "iu" or ((worlds < 0) | (worlds >= self.num_worlds)).any():
            raise self._no_world(world)
        return worlds

    def _no_world(self, world: Any) -> ValueError:
        return ValueError(
            f"world is {shown(world)}: a whole number from 0 to {self.num_worlds - 1} is needed"
        )

    def seeds(self, seeds: Any) -> list[int] | None:
        """Return a seed for each world.

        Args:
            seeds: An int s for s, s + 1 and so on; a sequence; or None.

        Returns:
            A seed for each world; None for None.

        Raises:
            ValueError: If a seed is invalid.
        """
        if seeds is None:
            return None
        if isinstance(seeds, int | np.integer) and not isinstance(seeds, bool):
            return [as_int("seed", seeds, 0) + k for k in range(self.num_worlds)]
        listed = isinstance(seeds, list | tuple) or (
            isinstance(seeds, np.ndarray) and seeds.ndim == 1
        )
        if not listed or len(seeds) != self.num_worlds:
            raise ValueError(
                f"seed is {shown(seeds)}: a whole number, or a list of {self.num_worlds}, one for "
                f"each world, is needed"
            )
        return [as_int("seed", seed, 0) for seed in seeds]

    def actions(self, actions: Any, alive: np.ndarray) -> np.ndarray:
        """Clip actions to their bounds, and set those of drones that are not alive to zero.

        Args:
            actions: (W, N, A).
            alive: (W, N) bool.

        Returns:
            (W, N, A).

        Raises:
            ValueError: If the shape is wrong, or an action of an active drone is not finite or no
                valid choice.
        """
        actions = numbers_of("actions are", actions)
        shape = (*alive.shape, self.action.low.shape[-1])
        if actions.shape != shape:
            raise ValueError(
                f"actions have shape {actions.shape}: (worlds, drones, {self.action.name}) = "
                f"{shape} is needed"
            )
        # Actions of drones that are not alive are ignored
        finite = np.isfinite(actions)
        if not finite.all() and (bad := ~finite.all(axis=-1) & alive).any():
            w, i = np.argwhere(bad)[0]
            raise ValueError(
                f"action of drone {i} in world {w} is {actions[w, i]}: finite numbers are needed"
            )
        if not alive.all():
            actions = np.where(alive[..., None], actions, 0.0)
        clipped: np.ndarray = np.minimum(np.maximum(actions, self.action.low), self.action.high)
        # Continuous actions are clipped; discrete ones must be valid
        if self.action.choices is None:
            return clipped
        wrong = (clipped != actions) | (clipped % 1 != 0)
        if wrong.any():
            w, i, _ = np.argwhere(wrong)[0]
            raise ValueError(
                f"action of drone {i} in world {w} is {actions[w, i, 0]:g}: a whole number from "
                f"0 to {self.action.choices - 1} is needed"
            )
        return clipped


def _make_task(kind: type[Task[Any]], config: TaskConfig, options: EnvOptions) -> Task[Any]:
    # Distances follow from the largest drone
    radius = max(airframe.collision_radius for airframe in options.airframe)
    period = 1 / options.decision_hz
    task = kind(
        config,
        TaskContext(
            options.num_drones,
            radius,
            options.max_speed,
            period,
            options.num_neighbours,
            options.horizon * period,
            make_beams(options.num_beams, options.lidar_elevations),
            options.max_range,
            tuple(airframe.standing_height for airframe in options.airframe),
            max((turn_radius(one) for one in options.airframe if one.needs_airspeed), default=0.0),
        ),
    )
    # The resulting scene is checked, as valid sizes alone do not suffice
    check_arena(task, config, radius)
    check_bodies(task)
    if config.d_safe <= 2 * radius:
        raise ValueError(
            f"d_safe {config.d_safe:g} m must exceed the {2 * radius:.3g} m across of the largest "
            f"drone"
        )
    return task


def action_context(options: EnvOptions, task: Task[Any]) -> ActionContext:
    """Return what definitions of actions may depend on."""
    climb = options.max_climb
    return ActionContext(
        options.airframe,
        options.max_speed,
        # Without a climb limit the speed limit applies
        options.max_speed if climb is None else min(climb, options.max_speed),
        task.arena_low,
        task.arena_high,
        1 / options.decision_hz,
        options.gravity,
    )


def _make_action(options: EnvOptions, task: Task[Any]) -> Action:
    climb = options.max_climb
    names = _names_of_drones(options, task)
    action = make_actions(names, action_context(options, task))
    # Other actions command no velocity
    others = [kind.name for kind in action.kinds if kind.level != SetpointLevel.VELOCITY]
    if climb is not None and others:
        raise ValueError(
            f"max_climb is {climb:g} m/s: it limits actions that command velocities, and "
            f"{others[0]!r} does not; max_climb=None leaves it out"
        )
    _check_masks(options, action)
    limit = task.speed_limit
    if limit is not None and (np.shape(limit) != (options.num_drones,) or not (limit > 0).all()):
        raise ValueError(
            f"speed_limit of task {task.name!r} is {shown(limit)}: a speed above 0 for each of "
            f"{options.num_drones} drones is needed"
        )
    if limit is not None and others:
        raise ValueError(
            f"action {others[0]!r} does not command velocities, and task {task.name!r} limits "
            f"the commanded speeds: choose action='velocity', or options without limits"
        )
    if any(one.needs_airspeed for one in options.airframe) and not others:
        # Drones of a mixed fleet may be slower than the max_speed of the environment
        own = np.minimum([top_speed(one) for one in options.airframe], options.max_speed)
        task.speed_limit = own if limit is None else np.minimum(own, limit)
    return action


def _names_of_drones(options: EnvOptions, task: Task[Any]) -> Sequence[str]:
    """Return the name of each drone's action."""
    action = options.action
    if isinstance(action, str):
        return (action,) * options.num_drones
    return of_drones("action", action, task) if isinstance(action, Mapping) else action


def _kinds_of_drones(observation: Any, task: Task[Any]) -> tuple[list[tuple[Any, ...]], list[int]]:
    """Return the different observations of the drones, and the index of each drone's own."""
    drones = len(task.team)
    if not isinstance(observation, Mapping):
        return [tuple(observation)], [0] * drones
    each = [tuple(one) for one in of_drones("observation", observation, task)]
    kinds: list[tuple[Any, ...]] = []
    for one in each:
        if one not in kinds:
            kinds.append(one)
    return kinds, [kinds.index(one) for one in each]


def _joined(kinds: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
    """List the blocks of several observations once.

    Raises:
        ValueError: If two different blocks have the same name.
    """
    by_name: dict[str, Any] = {}
    for source in itertools.chain.from_iterable(kinds):
        name = observation_name(source)
        if by_name.setdefault(name, source) != source:
            raise ValueError(
                f"observation has different blocks of the name {name!r} for different teams: "
                f"rename one of them"
            )
    return tuple(by_name.values())


def _check_masks(options: EnvOptions, action: Action) -> None:
    """Raise ValueError for masks of actions that are no moves to choose from."""
    if options.action_masks and (action.choices is None or action.level != SetpointLevel.VELOCITY):
        raise ValueError(
            f"action_masks is True, and action {options.action!r} is no choice of velocities: "
            f"choose action='discrete' or 'discrete_27', or leave action_masks out"
        )
