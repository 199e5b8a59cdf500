"""Batched core: W independent worlds of N drones, simulated one decision at a time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.body_source import BodySource
from bulletuav.envs.agents import ACTION_TYPES
from bulletuav.envs.airspace_inputs import Drones, rows_of
from bulletuav.envs.cables import list_ends
from bulletuav.envs.descriptions import describe_parts
from bulletuav.envs.env_spec import MAX_WORLDS, EnvSpec
from bulletuav.envs.environment import Environment, exclusive, in_plain_python
from bulletuav.envs.given_starts import STARTS, read_given_starts
from bulletuav.envs.infos import Infos, InfoTable, lazy_infos
from bulletuav.envs.marks import marks_of
from bulletuav.envs.simulation import Simulation
from bulletuav.envs.snapshot import (
    Snapshot,
    SnapshotLayout,
    own_snapshot,
    require_contacts,
    require_parts,
    require_snapshot,
)
from bulletuav.envs.step import Step
from bulletuav.envs.viewer import VIEWERS, Viewer, make_viewer
from bulletuav.envs.worlds import Worlds
from bulletuav.errors import as_bool, as_int, points_of
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.sensors.sight import line_of_sight
from bulletuav.tasks import TaskSource
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Contacts

NOTHING_STANDS = Solids(np.zeros((0, 2, 3)))


class Aviary(Environment):
    """W independent worlds of N drones that fly one task.

    The class never resets by itself: a drone whose episode ended leaves the airspace and is masked
    by `alive` until its world is reset. The random numbers of world k follow from seed + k only,
    and no world affects another.

    The arrays are allocated once and overwritten in each decision: copy what you keep.

    Attributes:
        options: Common options.
        task: The task.
        action: Definition of actions.
        observer: Computes observations; has their labels, and splits them by name. `of(i)` is that
            of drone i, if teams observe different blocks.
        global_state: Computes the global state; has its labels, and splits it by name.
        swarm: State of the drones, (W, N, ...).
        scene: Goals, obstacles and the task's memory.
        alive: (W, N) bool, drones whose episode is running.
        members: (W, N) bool, drones of the episode: all, unless num_drones is (min, max).
        steps: (W,) decisions since the reset.
        commanded: (W, N, 3) last commanded velocities, m/s.
        parameters: (W, N) rows of `PARAMETERS` that the dynamics uses.
        rng: Random generator of each world.
        worlds: Components and state of all worlds.
        simulation: Stages of a decision.
        given: (W, N, A) actions for `decide`.
        rewards: (W, N) rewards of the last decision.
        terminated: (W, N) bool, drones whose episode the task ended in the last decision.
        truncated: (W, N) bool, drones whose episode the horizon ended in the last decision.
        viewer: Live view of world 0 with `render_mode` "web" and "foxglove"; None otherwise.
    """

    _parts: Mapping[str, str] | None = None

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 1,
        *,
        first_world: int = 0,
        copy: bool = True,
        **options: Any,
    ) -> None:
        """Create the worlds.

        Args:
            task: Name of a task, `module:Name`, or a task class.
            num_worlds: Number of worlds W.
            first_world: Index of the first of these worlds among those of several processes. World
                k then equals world k of a single process.
            copy: If False, observations are not copied: they are arrays that the next decision or
                reset overwrites.
            **options: See `EnvOptions` and the task's config.

        Raises:
            ValueError: If an option is invalid.
        """
        self._spec = spec = EnvSpec(task, num_worlds, options)
        first_world = as_int("first_world", first_world, 0, MAX_WORLDS)
        self._copies = as_bool("copy", copy)
        self.worlds = worlds = Worlds(spec, first_world)
        seed = spec.options.seed
        self.simulation = Simulation(worlds, None if seed is None else seed + first_world)
        self.options, self.task, self.action = spec.options, spec.task, spec.action
        self.observer, self.global_state = spec.observer, spec.state
        self.num_worlds, self.num_drones = spec.num_worlds, spec.options.num_drones
        self.parameters, self.rng = worlds.parameters, worlds.rng
        state = worlds.state
        self.swarm, self.scene, self.commanded = state.swarm, state.scene, state.commanded
        self.given, self.alive, self.steps = state.given, state.alive, state.steps
        self.members = worlds.members
        self.rewards, self.terminated, self.truncated = (
            state.rewards,
            state.terminated,
            state.truncated,
        )
        self._is_started = False
        if self.options.debug:
            methods = ("reset", "decide", "first_info", "load_state", "state", "profile")
            in_plain_python(self, methods)
        # Last, as the viewer opens a port
        is_served = self.options.render_mode in VIEWERS
        self.viewer: Viewer | None = make_viewer(self) if is_served else None

    @property
    def any_left(self) -> bool:
        """Whether the episode of any drone ended in the last decision."""
        return self.worlds.any_left

    @property
    def program(self) -> Program | None:
        """Program of a decision; None before the first one."""
        return self.simulation.program

    @exclusive
    def reset(
        self,
        mask: np.ndarray | None = None,
        seeds: int | Sequence[int] | None = None,
        start: Any = None,
        goal: Any = None,
        *,
        velocity: Any = None,
        quaternion: Any = None,
        rates: Any = None,
        charge: Any = None,
    ) -> Observation:
        """Start new episodes.

        Args:
            mask: (W,) bool, worlds to reset; None for all.
            seeds: An int s gives world k the seed s + k. A sequence gives each of the W worlds its
                own seed. None continues the random numbers of each world, which start from the
                option `seed`, or from entropy.
            start: (N, 3) start positions in these episodes, m, or (W, N, 3) for each world; None
                for the task's option `start`.
            goal: (N, 3) or (W, N, 3) goals in these episodes, m; None for the task's option `goal`.
            velocity: (N, 3) or (W, N, 3) velocities at the start, m/s; None for the task's own.
            quaternion: (N, 4) or (W, N, 4) attitudes at the start, body to world; None for the
                task's own. It needs dynamics that rotate, as do rates.
            rates: (N, 3) or (W, N, 3) body rates at the start, rad/s; None for the task's own.
            charge: (N,) or (W, N) charge of the batteries at the start, above 0 and at most 1; None
                for full batteries.

        Returns:
            Observations of all worlds, (W, N, D) float32 or a dict.

        Raises:
            ValueError: If the task's start or an argument is invalid; the worlds are unchanged.
            RuntimeError: If the environment is closed.
        """
        self._require_open()
        spec = self._spec
        chosen = spec.mask(mask)
        worlds = chosen.nonzero()[0].tolist()
        simulation = self.simulation
        generators = simulation.start.generators(worlds, spec.seeds(seeds))
        values = (start, goal, velocity, quaternion, rates, charge)
        given = [spec.given] * len(worlds)
        if any(value is not None for value in values):
            kinds = (self.task, self.options, spec.given.positions, worlds, self.num_worlds)
            given = read_given_starts(*kinds, dict(zip(STARTS, values, strict=True)))
        # All checks are made before the worlds are written
        simulation.start.draw(generators, given)
        simulation.start_worlds(chosen, worlds, generators)
        self._is_started = True
        if self.viewer is not None and chosen[0]:
            self.viewer.begin()
        if simulation.program is None:
            self.worlds.state.present[:] = False  # then all worlds are observed first
            return self.observer.observe(self.worlds.frame, self.alive, self._copies)
        simulation.observe_start()
        return self.observations()

    @exclusive
    def step(self, actions: np.ndarray) -> Step:
        """Simulate one decision.

        Args:
            actions: (W, N, A), clipped to their bounds.

        Raises:
            ValueError: If the actions have a wrong shape, or an action of an active drone is not
                finite. The worlds are unchanged.
            RuntimeError: If called before the first reset or after `close`.
        """
        self.require_started()
        self.write_actions(actions)
        self.decide()
        ends = (self.terminated.copy(), self.truncated.copy())
        return Step(self.observations(), self.rewards.copy(), *ends, lazy_infos(self.info_table()))

    def write_actions(self, actions: np.ndarray) -> None:
        """Write actions (W, N, A) to `given`, for `decide`.

        Raises:
            ValueError: If the actions have a wrong shape or type.
        """
        given = self.given
        if (
            type(actions) is np.ndarray
            and actions.shape == given.shape
            and actions.dtype in ACTION_TYPES
        ):
            given[:] = actions  # the program checks them
        else:
            given[:] = self._spec.actions(actions, self.decides)

    def decide(self) -> None:
        """Simulate one decision with the actions that were written to `given`.

        Environment classes call this method, and read the results from `rewards`, `terminated`,
        `truncated`, `observations` and `info_table`.

        Raises:
            ValueError: If an action of an active drone is invalid. The worlds are unchanged.
        """
        self.simulation.decide()
        if self.viewer is not None:
            self.viewer.show()

    @exclusive
    def profile(self, decisions: int = 100, seed: int = 0) -> dict[str, float]:
        """Simulate random actions stage by stage, and measure the time of each stage.

        Worlds are reset when all their drones have left. The decisions are part of the flight: use
        a separate environment.

        Args:
            decisions: Number of decisions; one more is simulated first and not measured.
            seed: Seed of the actions.

        Returns:
            Mean time of each stage, microseconds, by the names of `simulation.stages`.

        Raises:
            RuntimeError: If called before the first reset or after `close`.
            ValueError: If a number is invalid.
        """
        self.require_started()
        as_int("decisions", decisions, 1)
        rng = np.random.default_rng(as_int("seed", seed, 0))
        low, high, choices = self.action.low, self.action.high, self.action.choices
        totals = dict.fromkeys([one.name for one in self.simulation.stages], 0.0)
        for k in range(decisions + 1):
            drawn = rng.uniform(low, high, self.given.shape)
            self.given[:] = drawn if choices is None else np.rint(drawn)
            for name, taken in self.simulation.decide_by_stages().items():
                totals[name] += 1e6 * taken / decisions if k else 0.0
            over = np.asarray(~self.alive.any(axis=1))
            if over.any():
                self.reset(over)
        return totals

    def observations(self) -> Observation:
        """Return the observations of the last decision; a copy by default."""
        vector = self.worlds.vector.copy() if self._copies else self.worlds.vector
        if self.observer.is_plain:
            return vector
        return self.observer.assemble(self.worlds.frame, vector, self._copies)

    def info_table(self, world: Any = ...) -> InfoTable:
        """Copy the results of the last decision; calling the returned object makes infos.

        Args:
            world: Index of the world of the infos, which are then arrays (N,); `...` for all, (W,
                N).
        """
        return self.worlds.results.info_table(self.simulation.further_infos(), world)

    def mean_of_members(self, values: np.ndarray, members: np.ndarray | None = None) -> np.ndarray:
        """Return the mean (W,) of values (W, N) over the drones of each world's episode.

        Args:
            values: (W, N).
            members: (W, N) bool, the drones; None for those of the running episodes.
        """
        if self.num_drones == 1:
            return np.array(values[:, 0])
        if not self.options.has_absent:
            # Faster than `values.mean(axis=1)`, with the same bits
            every: np.ndarray = np.add.reduce(values, axis=1) / self.num_drones
            return every
        members = self.members if members is None else members
        own: np.ndarray = np.where(members, values, 0.0).sum(axis=1) / members.sum(axis=1)
        return own

    @exclusive
    def action_masks(self) -> np.ndarray:
        """Return the masks of discrete actions; see `bulletuav.envs.action_masks.ActionMasks`.

        Returns:
            (W, N, C) int8, 1 for valid moves.

        Raises:
            ValueError: Without the option `action_masks`.
            RuntimeError: If called before the first reset or after `close`.
        """
        self.require_started()
        if not self.options.action_masks:
            raise ValueError("this environment computes no masks: make it with action_masks=True")
        return self.worlds.action_masks()

    @property
    def decides(self) -> np.ndarray:
        """(W, N) bool: active drones whose next action is flown; see option `decision_every`."""
        return self.worlds.decides()

    @exclusive
    def set_condition(self, drones: Drones = None, worlds: Any = None, **changes: Any) -> None:
        """Change drones, wind or gravity in flight, from the next decision on.

        A change is in force until it is set again, or the episode of the world ends. It follows
        events of the option `events` that are due. See `bulletuav.envs.conditions`.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all.
            worlds: Indices of the worlds, or one; None for all.
            **changes: Any of "rotor_effectiveness", "added_mass", "added_inertia", "charge", "wind"
                and "gravity", the same for all of these drones; see `bulletuav.envs.events.Event`.
                Wind and gravity are those of a whole world.

        Raises:
            ValueError: If there is no such drone or world, no change is given, or a change is
                unknown, invalid or without effect; nothing is changed.
            RuntimeError: If called before the first reset or after `close`.
        """
        self.require_started()
        chosen = self._spec.indices(worlds).tolist()
        rows, _ = rows_of(drones, self.num_drones)
        listed = None if isinstance(rows, slice) else np.atleast_1d(rows).tolist()
        time = self.steps / self.options.decision_hz
        self.worlds.schedule.change(chosen, listed, changes, time)

    def require_action(self, drone: int, numbers: np.ndarray) -> None:
        """Raise ValueError for an invalid action (A,) of a drone; nothing is simulated."""
        given, chosen = np.zeros(self.given.shape), np.zeros(self.alive.shape, dtype=bool)
        given[:, drone], chosen[:, drone] = numbers, self.decides[:, drone]
        self._spec.actions(given, chosen)

    @exclusive
    def first_info(self, worlds: np.ndarray | None = None) -> Infos:
        """Return the infos after a reset: the keys of every step's info, with reward terms of zero.

        Args:
            worlds: (W,) bool, worlds that were just reset, if only their infos are read; those of
                others may then be from before the reset. None for all.
        """
        if worlds is None:
            self.current_frame()
        self.simulation.report_start()
        return lazy_infos(self.info_table())

    @exclusive
    def save_state(self, worlds: Any = None) -> Snapshot:
        """Save the complete state of worlds, for `load_state`.

        With dynamics "bullet" this rounds attitudes by about 1e-17: the saved flight continues as
        from the snapshot, and differs in the last bits from a flight that was not saved.

        Args:
            worlds: Indices of the worlds; None for all.

        Raises:
            RuntimeError: If called before the first reset or after `close`.
            ValueError: If there are no such worlds, or contacts are Bullet's own.
        """
        self.require_started()
        self.simulation.start.complete_account()
        require_contacts(self.options.contacts)
        self.worlds.bodies.require_saveable()
        layout = self.worlds.layout(self._of, self._own_parts())
        chosen = self._spec.indices(worlds)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Bullet rounds the state that is written: both flights continue from the rounded one
        self.worlds.restore_flight(mask[:, None] & self.alive)
        return own_snapshot(layout.pack_worlds(self.rng, chosen), layout.form)

    @exclusive
    def load_state(self, snapshot: Snapshot, worlds: Any = None) -> Observation:
        """Restore a state that was saved here, or in an environment made from the same options.

        The flight continues with the same bits. With dynamics "bullet" this holds only for a world
        that is restored to its own index, as Bullet's rounding depends on the position of the
        world.

        Args:
            snapshot: Snapshot with as many worlds as are to be written.
            worlds: Indices of the worlds here; None for all.

        Returns:
            Observations of all worlds, as from `reset`.

        Raises:
            ValueError: If the snapshot does not fit; the worlds are unchanged, or as their first
                reset made them.
            RuntimeError: If called after `close`.
        """
        # All checks are made before the worlds are written
        chosen = self._spec.indices(worlds)
        require_snapshot(snapshot, Snapshot, len(chosen))
        layout = self._layout_for(snapshot, chosen)
        layout.unpack_worlds(snapshot.data, self.rng, chosen)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Components with their own copies of the state
        drones, parts = mask[:, None] & self.alive, self.worlds
        parts.uncertainty.restore(chosen)
        parts.schedule.restore(chosen)
        parts.engine.set_layouts(self.scene.layout, mask)
        parts.place_obstacles(mask)
        parts.bodies.restore(chosen.tolist())
        parts.restore_flight(drones)
        gone = mask[:, None] & ~self.alive
        if gone.any():
            parts.engine.park(gone)
        self.simulation.recompute()
        return self.observations()

    @exclusive
    def state_hash(self, worlds: Any = None) -> tuple[str, ...]:
        """Compute a hash of the state of each world, with its random generator.

        Equal flights have equal hashes, whatever flew before. The memory of sensors and contacts is
        not included.

        Args:
            worlds: Indices of the worlds; None for all.
        """
        self.require_started()
        chosen = self._spec.indices(worlds)
        return self.worlds.state_hashes(self.rng, chosen)

    @exclusive
    def require_loadable(self, snapshot: Snapshot) -> None:
        """Check a snapshot with any number of worlds as `load_state` does, without writing it.

        Raises:
            ValueError: If the snapshot does not fit.
            RuntimeError: If called after `close`.
        """
        require_snapshot(snapshot, Snapshot, None)
        self._layout_for(snapshot, np.zeros(len(snapshot), dtype=int))

    def _layout_for(self, snapshot: Snapshot, chosen: np.ndarray) -> SnapshotLayout:
        """Check a snapshot against worlds (S,), and return the layout of its arrays."""
        if not self._is_started:
            self._require_open()
            require_parts(snapshot.form, self._own_parts(), self._of)
            self.reset()
        self.simulation.start.complete_account()
        layout = self.worlds.layout(self._of, self._own_parts())
        layout.require(snapshot, chosen)
        return layout

    @property
    def _of(self) -> str:
        return f"environment of {self.task.name!r}"

    def _own_parts(self) -> Mapping[str, str]:
        if self._parts is None:
            self._parts = describe_parts(self.options, self.task)
        return self._parts

    def current_frame(self) -> Frame:
        """Return the frame of the last decision.

        After a reset, the frame is one in which no time has passed.

        Raises:
            RuntimeError: If called before the first reset.
        """
        if not self._is_started:
            raise RuntimeError("the worlds have not been started: call reset() first")
        self.simulation.start.complete_account()
        return self.worlds.frame

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state.

        Returns:
            (W, K) float32: the true position, attitude, velocity, rates, goal position and alive
            flag of every drone, 17 numbers each; then, if present, charges, the city's parameters,
            users, utilisations and queues. `global_state.labels` lists all numbers.
        """
        self._require_open()
        return self.global_state.compute(self.current_frame(), self.alive)

    @exclusive
    def render(
        self, world: int = 0, *, collision: bool = False, marks: bool = True
    ) -> np.ndarray | None:
        """Render a world as (height, width, 3) uint8 with render_mode "rgb_array"; None otherwise.

        Shows the drones that flew the last decision, including those whose episode it ended. Marks
        are rings around drones, and arrows of their motion in one second; crosses on goals, and
        lines to them; dots on targets, green if any drone sees them, else red, and blue lines to
        targets that a drone serves; orange lines along the range finder's beams, pale without a
        hit. Pictures of 240 pixels' height or more have a legend.

        Args:
            world: Index of the world.
            collision: Whether drones are drawn by their collision shapes instead of their visual
                shapes.
            marks: Whether marks are drawn.
        """
        self._require_open()
        if self.options.render_mode != "rgb_array":
            return None
        self._spec.require_world(world)
        flown = self.current_frame().alive
        seen = marks_of(
            self.task, self.current_frame(), world, self.worlds.sensors.sensors.values()
        )
        swarm, shown = self.worlds.shown(self.swarm, flown)
        if self.worlds.loads is not None:
            seen = seen._replace(cable=list_ends(self.worlds.dynamics.cables, swarm, world))
        return self.worlds.renderer.picture(world, swarm, seen, shown, collision, marks)

    @exclusive
    def add_body(
        self,
        source: BodySource,
        position: Sequence[float],
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        world: int | None = None,
        friction: float | None = None,
        restitution: float | None = None,
    ) -> int:
        """Add a static body, which drones collide with, sensors measure and pictures show.

        The body stays through resets. Tasks do not know it: their starts may lie within it.

        Args:
            source: Path of a URDF with one link, of which all collision shapes are used (box,
                sphere, cylinder, or a mesh by its convex hull); path of a Wavefront OBJ, in which
                each object is a convex hull; corners (V, 3) of a hull, m; or an `Obstacle`.
            position: (3,) of the body's origin in the world's own frame, m.
            quaternion: (4,) body to world, (x, y, z, w).
            world: Index of the world in which the body stands; None for all.
            friction: Coefficient of friction; None for that of the obstacle, or 0.5.
            restitution: Coefficient of restitution; None for that of the obstacle, or 0.

        Returns:
            Identifier of the body in `Contacts.other`.

        Raises:
            ValueError: If the source or a number is invalid, or there is no such world.
            FileNotFoundError: If there is no such file.
        """
        self._require_open()
        if world is not None:
            self._spec.require_world(world)
        return self.worlds.engine.add_body(
            source, position, quaternion, world, friction, restitution
        )

    @exclusive
    def line_of_sight(
        self, start: np.ndarray, end: np.ndarray, world: np.ndarray | int = 0
    ) -> np.ndarray:
        """Check for pairs of points whether the line between them is free; drones do not block it.

        Args:
            start: (M, 3) m, or one point.
            end: (M, 3) m, or one point.
            world: World of each pair, (M,), or one for all.

        Returns:
            (M,) bool.

        Raises:
            ValueError: If points are not finite, or there is no such world.
        """
        self.require_started()
        start, end = np.broadcast_arrays(points_of("start", start), points_of("end", end))
        return line_of_sight(
            self.worlds.engine, start, end, np.broadcast_to(self._spec.worlds(world), len(start))
        )

    @property
    def sight(self) -> np.ndarray:
        """(W, N, U) bool: targets seen by the drones that flew the last decision."""
        return self.current_frame().seen

    @property
    def links(self) -> np.ndarray:
        """(W, N, U) bool: targets served by the drones that flew the last decision."""
        frame = self.current_frame()
        served: np.ndarray = self.task.links(frame) & frame.alive[..., None]
        return served

    @property
    def readings(self) -> Mapping[str, np.ndarray]:
        """Last sensor readings, (W, N, ...) by name; see `Frame.readings`."""
        return self.current_frame().readings

    @property
    def reading_labels(self) -> dict[str, tuple[Label, ...]]:
        """Labels of the numbers of sensor readings, by name of the reading."""
        return self.worlds.sensors.numbers()

    @property
    def contacts(self) -> Contacts:
        """Contacts of the last decision; none in worlds that were just reset."""
        return self.current_frame().contacts.of_worlds(np.ones(self.num_worlds, dtype=bool))

    def solids(self, world: int = 0) -> Solids:
        """Return the buildings of a world, without obstacles."""
        layout = self.scene.layout[self._spec.worlds(world)]
        return NOTHING_STANDS if layout == NO_LAYOUT else self.task.layouts()[layout]

    @property
    def setpoint_level(self) -> SetpointLevel:
        """Setpoint level that the dynamics consumes."""
        return self.worlds.dynamics.consumes

    @property
    def communicates(self) -> bool:
        """Whether messages between drones are simulated, with infos that count them."""
        return "radio" in self.worlds.sensors.sensors

    def require_started(self) -> None:
        """Raise RuntimeError before the first reset and after `close`."""
        if self.worlds.engine.closed or not self._is_started:
            self._require_open()
            self.current_frame()

    def _require_open(self) -> None:
        if self.worlds.engine.closed:
            raise RuntimeError("this environment is closed: make a new one")

    @exclusive
    def close(self) -> None:
        """Free the engine, and close the live view. Further calls do nothing."""
        if self.viewer is not None:
            self.viewer.close()
        self.worlds.engine.close()
