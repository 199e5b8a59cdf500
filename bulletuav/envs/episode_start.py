"""Start of episodes in some of the worlds."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.program import ByWorld, Program, by_world
from bulletuav.envs.rows import add_rows, add_value, expand_mask, update_present
from bulletuav.envs.snapshot import UNSTARTED
from bulletuav.envs.stages.fly import add_decision_count
from bulletuav.envs.stages.keep_before import keep_before
from bulletuav.envs.stages.separate import Separate
from bulletuav.envs.world_bodies import MAX_TRIES, Slots
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import FIELDS, Spawn
from bulletuav.tasks.frame_measures import FrameMeasures
from bulletuav.tasks.given import DRAWN, GivenStart
from bulletuav.tasks.parts.loads import POSITION, QUATERNION
from bulletuav.tasks.spawns import MEMORY, SpawnBuffer

STALE_FIELDS = frozenset(
    {*(name for name in FIELDS if name.endswith("_before")), "conflicts", "separation", "nearness"}
)
"""Fields of the frame that change when other worlds are brought up to date after a reset"""


class _AccountUpdate(NamedTuple):
    """Program that fills the account as if no time had passed, and that account."""

    account: FrameMeasures
    program: Program


class EpisodeStart:
    """Starts new episodes in some of the worlds, and leaves the others unchanged.

    Attributes:
        starts: Rows of the drawn starts.
        by_world_programs: Programs that update and observe selected worlds only; None if that would
            affect others.
        is_account_complete: Whether the account of all worlds is up to date after a reset of some.
    """

    def __init__(self, worlds: Worlds, first_seed: int | None) -> None:
        """Allocate the arrays of starts.

        Args:
            worlds: Worlds that start.
            first_seed: Seed of the first world if a reset has none.
        """
        self._worlds, self._first_seed = worlds, first_seed
        state, count = worlds.state, worlds.num_worlds
        sizes = (count, state.scene.obstacle.shape[1])
        self.starts = SpawnBuffer(worlds.task, worlds.options.airframe, *sizes, state.scene.memory)
        # Masks of worlds; indices and drones of the worlds that start
        self._fresh, self._no_worlds, self._due = np.zeros((3, count), dtype=bool)
        self._fresh_indices: list[int] = []
        self._fresh_drones = np.zeros(state.alive.shape, dtype=bool)
        self._drawn_members: list[np.ndarray] = []
        self._charge = np.ones(state.alive.shape)  # of the worlds that start, first rows
        self._start: Program | None = None
        self._update: _AccountUpdate | None = None
        self._slots: list[Slots] = []
        self._given: Sequence[GivenStart] = ()
        self.by_world_programs: tuple[ByWorld, ByWorld] | None = None
        self.is_account_complete = True

    def generators(self, worlds: list[int], seeds: list[int] | None) -> list[np.random.Generator]:
        """Return the random generator of each world that starts."""
        if seeds is not None:
            return [np.random.default_rng(seeds[k]) for k in worlds]
        first = self._first_seed
        return [
            np.random.default_rng(None if first is None else first + k)
            if self._worlds.rng[k] is UNSTARTED
            else self._worlds.rng[k]
            for k in worlds
        ]

    def draw(self, generators: list[np.random.Generator], given: Sequence[GivenStart]) -> None:
        """Draw starts and check them, without changing the worlds.

        Args:
            generators: Generator of each world that starts.
            given: What the user sets in each of these worlds.

        Raises:
            ValueError: If the task's starts are invalid.
        """
        worlds, task = self._worlds, self._worlds.task
        spawns = list(task.spawn_many(generators))
        if len(spawns) != len(generators):
            raise ValueError(
                f"spawn_many of task {task.name!r} gave {len(spawns)} starts: "
                f"{len(generators)} are needed, one for each generator"
            )
        # Most starts are complete as drawn
        is_whole = task.has_goals and not task.takes_off and all(one is DRAWN for one in given)
        if not is_whole or task.overrides_method("finish") or worlds.cruise.drones.size:
            spawns = [
                self._finish(spawn, one, rng) if isinstance(spawn, Spawn) else spawn
                for spawn, rng, one in zip(spawns, generators, given, strict=True)
            ]
        self.starts.store(spawns)
        for row, one in zip(self._charge, given, strict=False):
            row[:] = 1.0 if one.charge is None else one.charge
        self._slots, self._given = [], given
        if worlds.bodies.count:
            self._draw_bodies(spawns, generators, given)
        if worlds.options.has_absent:
            # After the starts, which therefore do not depend on the range
            self._drawn_members = [self._draw_members(rng) for rng in generators]

    def _finish(self, spawn: Spawn, given: GivenStart, rng: np.random.Generator) -> Spawn:
        """Complete a drawn start of one world."""
        task = self._worlds.task
        spawn = task.finish(spawn, given.positions, rng)
        spawn = self._worlds.cruise.apply_to(spawn, task.has_goals)
        return given.motion.apply_to(spawn)

    def _draw_bodies(
        self,
        spawns: list[Spawn],
        generators: list[np.random.Generator],
        given: Sequence[GivenStart],
    ) -> None:
        """Draw the bodies of each world, and its start again while that is in a body.

        Raises:
            ValueError: If a drawn body is invalid, or starts stay in bodies.
        """
        task, bodies, rows = self._worlds.task, self._worlds.bodies, self.starts.rows
        for k, rng in enumerate(generators):
            for _ in range(MAX_TRIES):
                slots = bodies.draw(rng)
                position, quaternion = rows["position"][k], rows["quaternion"][k]
                count = len(position)
                if task.loads is not None:
                    position = np.append(position, rows[MEMORY + POSITION][k], axis=0)
                    quaternion = np.append(quaternion, rows[MEMORY + QUATERNION][k], axis=0)
                goal = rows["goal"][k] if task.has_goals else None
                blocked = bodies.find_blocked(slots, position, quaternion, count, goal)
                if not blocked:
                    break
                (spawn,) = task.spawn_many([rng])
                spawns[k] = self._finish(spawn, given[k], rng)
                self.starts.store(spawns)
            else:
                raise ValueError(
                    f"bodies: {blocked} is in a body, also after {MAX_TRIES} draws of what is not "
                    f"given: keep the bodies clear of starts and goals"
                )
            self._slots.append(slots)

    def _draw_members(self, rng: np.random.Generator) -> np.ndarray:
        """Draw which drones (N,) take part in an episode: their number, then any so many."""
        options = self._worlds.options
        fewest = options.num_drones if options.min_drones is None else options.min_drones
        members = np.zeros(options.num_drones, dtype=bool)
        count = rng.integers(fewest, options.num_drones, endpoint=True)
        members[rng.permutation(options.num_drones)[:count]] = True
        return members

    def write(
        self, fresh: np.ndarray, indices: list[int], generators: list[np.random.Generator]
    ) -> None:
        """Start the worlds of `fresh` (W,) from the drawn starts."""
        worlds = self._worlds
        if self._start is None:
            self._start = self._make_start()
        self._fresh[:], self._fresh_indices = fresh, indices
        for k, rng in zip(indices, generators, strict=True):
            worlds.rng[k] = rng
        for k, members in zip(indices, self._drawn_members, strict=False):
            worlds.members[k] = members
        schedule = worlds.schedule
        changes = bool(schedule.events) or schedule.changed.any()
        if worlds.wind.is_gusty or worlds.uncertainty.drawn or changes:
            for k, rng in zip(indices, generators, strict=True):
                worlds.wind.reset(k, rng)
                worlds.uncertainty.reset(k, rng)
                if changes:
                    schedule.reset(k, rng, worlds.members[k])
        worlds.forget_derived()
        self._start.run()

    def account(self, can_skip_others: bool) -> None:
        """Fill the account as if no time had passed.

        Args:
            can_skip_others: Whether only the worlds that start may be updated; the others are
                brought up to date when they are read.
        """
        skips_others = can_skip_others and len(self._fresh_indices) < len(self._fresh)
        programs = self.by_world_programs if skips_others else None
        self.is_account_complete = programs is None
        if programs is None:
            self._account_update().program.run()
        else:
            programs[0].run(self._fresh)
        self._start_memory()

    def observe(self, observing: Program) -> None:
        """Write the observations after a reset."""
        self._worlds.forget_derived()
        if self.is_account_complete or self.by_world_programs is None:
            observing.run()
        else:
            self.by_world_programs[1].run(self._due)

    def complete_account(self) -> None:
        """Bring worlds up to date that were skipped after a reset of others."""
        if not self.is_account_complete:
            self.is_account_complete = True
            self._worlds.forget_derived()
            self._account_update().program.run()

    def make_by_world_programs(self, observing: Program) -> None:
        """Make programs that update selected worlds only, if that does not affect others."""
        worlds = self._worlds
        self.by_world_programs = None
        observer = worlds.observer
        if (
            worlds.num_worlds > 1
            and worlds.sensors.keep_others
            and not observer.reads_any(STALE_FIELDS)
        ):
            account, program = self._account_update()
            arrays = [*worlds.state_arrays().values(), *worlds.last_arrays().values()]
            arrays += [*account.conflict, *account[1:], worlds.vector, self._no_worlds]
            arrays += observer.scratch()
            update = by_world(program, arrays)
            observe = by_world(observing, arrays)
            self.by_world_programs = (
                None if update is None or observe is None else (update, observe)
            )

    def _account_update(self) -> _AccountUpdate:
        """Return the program that fills the account as if no time had passed."""
        account = self._worlds.account
        if self._update is None or self._update.account is not account:
            self._update = _AccountUpdate(account, self._make_account_update())
        return self._update

    def _make_start(self) -> Program:
        """Make the program that starts worlds from the drawn starts."""
        program, fresh, worlds, state = Program(), self._fresh, self._worlds, self._worlds.state
        self._add_rows(program)
        program.call(expand_mask, fresh, self._fresh_drones)
        if worlds.cruise.drones.size:
            program.callback(self._start_cruise)
        if worlds.options.has_absent:
            program.callback(self._leave_out_absent)
        if worlds.loads is None:
            worlds.dynamics.add_place(program, state.swarm, self._fresh_drones)
        else:
            program.call(expand_mask, fresh, worlds.loads.fresh)
            program.callback(worlds.loads.join)
            worlds.dynamics.add_place(program, worlds.loads.bodies, worlds.loads.fresh)
        add_value(program, fresh, 0, worlds.dynamics.contact.touches.number)
        program.call(update_present, state.alive, fresh, state.present, self._due)
        # Python callbacks together, as each leaves and enters compiled code
        if worlds.sensors.sensors:
            program.callback(self._reset_sensors)
        program.callback(self._place_scene)
        program.callback(self._keep_contacts)
        program.callback(lambda: worlds.measure(state.swarm, state.swarm, self._fresh_drones))
        return program

    def _start_cruise(self) -> None:
        """Start aircraft that cannot hover in the wind of the episode, which is drawn by now."""
        state = self._worlds.state
        self._worlds.start_cruise(self._fresh_drones)
        for k, one in zip(self._fresh_indices, self._given, strict=False):
            for name, value in one.motion._asdict().items():
                if value is not None:
                    getattr(state.swarm, name)[k] = value
        state.commanded[self._fresh] = state.swarm.velocity[self._fresh]

    def _leave_out_absent(self) -> None:
        """Treat absent drones as those whose episode ended, and clear their old readings."""
        worlds, state = self._worlds, self._worlds.state
        absent = self._fresh_drones & ~worlds.members
        self._fresh_drones &= worlds.members
        for mask in (state.alive, state.flown):
            mask[absent] = False
        worlds.engine.park(absent)
        energy = worlds.energy.readings()
        for name, reading in worlds.readings.items():
            if name not in energy:
                reading[absent] = 0

    def _make_account_update(self) -> Program:
        """Make the program that fills the account as if no time had passed in the decision."""
        program, worlds, state = Program(), self._worlds, self._worlds.state
        worlds.energy.add_voltage(program)
        nothing = state.scene.obstacle[:, :0]
        before = (state.scene.goal, state.goal_before, nothing, nothing)
        program.call(keep_before, state.swarm, state.before, *before)
        add_decision_count(program, worlds, self._no_worlds)
        Separate().add_to(program, worlds)
        return program

    def _add_rows(self, program: Program) -> None:
        """Add that the drawn starts are written, and everything else is reset with them."""
        worlds, state = self._worlds, self._worlds.state
        swarm, scene, rows, fresh = state.swarm, state.scene, self.starts.rows, self._fresh
        written: list[tuple[Any, np.ndarray]] = [
            (rows[f"{MEMORY}{name}"], array) for name, array in scene.memory.items()
        ]
        written += [(rows[name], getattr(swarm, name)) for name in swarm._fields if name in rows]
        written += [(rows[name], getattr(scene, name)) for name in scene._fields if name in rows]
        written += [(rows["position"], scene.start), (rows["velocity"], state.commanded)]
        for row, array in written:
            add_rows(program, fresh, row, array)
        speed = 0.0 if worlds.task.takes_off else worlds.hover_speed
        values = [
            (speed, swarm.rotor_speed),
            (worlds.cruise.deflection, swarm.deflection),
            (0.0, worlds.cascade.memory),
            (True, state.alive),
            (0, state.steps),
            (0.0, state.action),
            (True, state.flown),
        ]
        for value, array in values:
            add_value(program, fresh, value, array)
        worlds.energy.add_start(program, fresh, self._charge)

    def _reset_sensors(self) -> None:
        worlds = self._worlds
        for k in self._fresh_indices:
            worlds.sensors.reset(k, worlds.state.swarm, worlds.rng[k])

    def _place_scene(self) -> None:
        """Place the city and the obstacles of worlds that start."""
        scene = self._worlds.state.scene
        if self._worlds.loads is not None:
            self._worlds.loads.start(self._fresh)
        self._worlds.engine.set_layouts(scene.layout, self._fresh)
        if scene.obstacle.size:
            self._worlds.place_obstacles(self._fresh)
        for k, slots in zip(self._fresh_indices, self._slots, strict=False):
            self._worlds.bodies.place(k, slots, self._worlds.dynamics.contact)

    def _keep_contacts(self) -> None:
        """Keep contacts of the other worlds if only Python has collected them."""
        contacts = self._worlds.contacts
        if self._worlds.options.contacts == "bullet":
            contacts.collect()
        contacts.keep(~self._fresh if self._worlds.collects_contacts else None)

    def _start_memory(self) -> None:
        """Let the task initialise the memory of worlds that were reset; keep that of others."""
        task = self._worlds.task
        if type(task).start_memory is Task.start_memory:
            return
        memory = self._worlds.state.scene.memory
        kept = {name: array.copy() for name, array in memory.items()}
        task.start_memory(self._worlds.frame)
        for name, array in kept.items():
            memory[name][~self._fresh] = array[~self._fresh]
