"""Starts of episodes: what a reset of some of the worlds reads and writes."""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.program import ByWorld, Program, by_world
from bulletuav.envs.rows import add_rows, add_value, renew, spread
from bulletuav.envs.snapshot import UNSTARTED
from bulletuav.envs.stages.fly import add_tick
from bulletuav.envs.stages.keep_before import keep_before
from bulletuav.envs.stages.separate import Separate
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.account import Account
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import FIELDS, Spawn
from bulletuav.tasks.given import Given
from bulletuav.tasks.spawns import MEMORY, Starts

STALE = frozenset(
    {*(name for name in FIELDS if name.endswith("_before")), "conflicts", "separation", "nearness"}
)
"""Fields of the frame that change when worlds are brought up to date after a reset of others"""


class _Stillness(NamedTuple):
    """A program after which it is as if no time had passed, and the account that it fills."""

    account: Account
    program: Program


class EpisodeStart:
    """Starts new episodes in some of the worlds, while others stay as they are.

    Attributes:
        starts: Rows of the starts that were drawn.
        alone: Programs that update and observe some worlds alone; None where others would be
            affected.
        is_still: Whether the account of all worlds is up to date after a reset of some.
    """

    def __init__(self, worlds: Worlds, first_seed: int | None) -> None:
        """Make the arrays that starts are written to.

        Args:
            worlds: Worlds that start.
            first_seed: Seed of the first of them where a reset is given none.
        """
        self._worlds, self._first_seed = worlds, first_seed
        state, count = worlds.state, worlds.num_worlds
        sizes = (count, state.scene.obstacle.shape[1])
        self.starts = Starts(worlds.task, worlds.options.airframe, *sizes, state.scene.memory)
        # Worlds that start, their indices, and a mask of their drones
        self._fresh, self._no_worlds, self._due = np.zeros((3, count), dtype=bool)
        self._fresh_indices: list[int] = []
        self._fresh_drones = np.zeros(state.alive.shape, dtype=bool)
        self._start: Program | None = None
        self._still: _Stillness | None = None
        self.alone: tuple[ByWorld, ByWorld] | None = None
        self.is_still = True

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

    def draw(self, generators: list[np.random.Generator], given: Given) -> None:
        """Draw starts, and check them; nothing of the worlds is written.

        Raises:
            ValueError: The task's starts cannot be.
        """
        task = self._worlds.task
        spawns = list(task.spawn_many(generators))
        if len(spawns) != len(generators):
            raise ValueError(
                f"spawn_many of task {task.name!r} gave {len(spawns)} starts: "
                f"{len(generators)} are needed, one for each generator"
            )
        # Most starts are whole as they are drawn
        is_whole = task.has_goals and given.is_empty and not task.takes_off
        if not is_whole or task.has_own("finish"):
            spawns = [
                task.finish(spawn, given, rng) if isinstance(spawn, Spawn) else spawn
                for spawn, rng in zip(spawns, generators, strict=True)
            ]
        self.starts.take(spawns)

    def write(
        self, fresh: np.ndarray, indices: list[int], generators: list[np.random.Generator]
    ) -> None:
        """Start the worlds of `fresh` (W,) from what was drawn."""
        worlds = self._worlds
        if self._start is None:
            self._start = self._make_start()
        self._fresh[:], self._fresh_indices = fresh, indices
        for k, rng in zip(indices, generators, strict=True):
            worlds.rng[k] = rng
        if worlds.wind.is_gusty or worlds.uncertainty.drawn:
            for k, rng in zip(indices, generators, strict=True):
                worlds.wind.reset(k, rng)
                worlds.uncertainty.reset(k, rng)
        worlds.forget_derived()
        self._start.run()

    def account(self, can_be_alone: bool) -> None:
        """Fill the account as if no time had passed.

        Args:
            can_be_alone: Whether the worlds that start may be seen to alone; the others are brought
                up to date when they are read.
        """
        is_alone = can_be_alone and len(self._fresh_indices) < len(self._fresh)
        alone = self.alone if is_alone else None
        self.is_still = alone is None
        if alone is None:
            self._stillness().program.run()
        else:
            alone[0].run(self._fresh)
        self._start_memory()

    def observe(self, observing: Program) -> None:
        """Write what is observed after a reset."""
        self._worlds.forget_derived()
        if self.is_still or self.alone is None:
            observing.run()
        else:
            self.alone[1].run(self._due)

    def complete(self) -> None:
        """Bring worlds up to date that were left out after a reset of others."""
        if not self.is_still:
            self.is_still = True
            self._worlds.forget_derived()
            self._stillness().program.run()

    def make_alone(self, observing: Program) -> None:
        """Make programs that see to some worlds alone, where others do not feel it."""
        worlds = self._worlds
        self.alone = None
        observer = worlds.observer
        if worlds.num_worlds > 1 and worlds.sensors.keep_others and observer.reads_none_of(STALE):
            account, program = self._stillness()
            arrays = [*worlds.state_arrays().values(), *worlds.last_arrays().values()]
            arrays += [*account.conflict, *account[1:], worlds.vector, self._no_worlds]
            still = by_world(program, arrays)
            alone = by_world(observing, arrays)
            self.alone = None if still is None or alone is None else (still, alone)

    def _stillness(self) -> _Stillness:
        """Return the program after which it is as if no time had passed, for the account."""
        account = self._worlds.account
        if self._still is None or self._still.account is not account:
            self._still = _Stillness(account, self._make_still())
        return self._still

    def _make_start(self) -> Program:
        """Make the program that starts worlds from what was drawn."""
        program, fresh, worlds, state = Program(), self._fresh, self._worlds, self._worlds.state
        self._add_rows(program)
        program.call(spread, fresh, self._fresh_drones)
        worlds.dynamics.add_place(program, state.swarm, self._fresh_drones)
        add_value(program, fresh, 0, worlds.dynamics.contact.touches.number)
        program.call(renew, state.alive, fresh, state.present, self._due)
        # Python's turns together, as each takes the way out of compiled code and back
        if worlds.sensors.sensors:
            program.callback(self._reset_sensors)
        program.callback(self._place_scene)
        program.callback(self._keep_contacts)
        program.callback(lambda: worlds.measure(state.swarm, state.swarm, self._fresh_drones))
        return program

    def _make_still(self) -> Program:
        """Make the program after which it is as if no time had passed in the decision."""
        program, worlds, state = Program(), self._worlds, self._worlds.state
        worlds.energy.add_voltage(program)
        nothing = state.scene.obstacle[:, :0]
        before = (state.scene.goal, state.goal_before, nothing, nothing)
        program.call(keep_before, state.swarm, state.before, *before)
        add_tick(program, worlds, self._no_worlds)
        Separate().add_to(program, worlds)
        return program

    def _add_rows(self, program: Program) -> None:
        """Add that starts are written, and all that starts again with them."""
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
            (0.0, worlds.cascade.memory),
            (True, state.alive),
            (0, state.steps),
            (0.0, state.action),
            (True, state.flown),
        ]
        for value, array in values:
            add_value(program, fresh, value, array)
        worlds.energy.add_start(program, fresh)

    def _reset_sensors(self) -> None:
        worlds = self._worlds
        for k in self._fresh_indices:
            worlds.sensors.reset(k, worlds.state.swarm, worlds.rng[k])

    def _place_scene(self) -> None:
        """Place the city and the obstacles of worlds where they start."""
        scene = self._worlds.state.scene
        self._worlds.engine.set_layouts(scene.layout, self._fresh)
        if scene.obstacle.size:
            self._worlds.place_obstacles(self._fresh)

    def _keep_contacts(self) -> None:
        """Keep the contacts of worlds that fly on, where only Python knows them."""
        contacts = self._worlds.contacts
        if self._worlds.options.contacts == "bullet":
            contacts.collect()
        contacts.keep(~self._fresh if self._worlds.collects_contacts else None)

    def _start_memory(self) -> None:
        """Let the task fill the memory of the worlds that were reset; others keep theirs."""
        task = self._worlds.task
        if type(task).start_memory is Task.start_memory:
            return
        memory = self._worlds.state.scene.memory
        kept = {name: array.copy() for name, array in memory.items()}
        task.start_memory(self._worlds.frame)
        for name, array in kept.items():
            memory[name][~self._fresh] = array[~self._fresh]
