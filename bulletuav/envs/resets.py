"""Resets: what the start of an episode reads and writes, and the program that does it."""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.program import ByWorld, Program, by_world
from bulletuav.envs.decisions import Decisions
from bulletuav.envs.rows import add_rows, add_value, renew, spread
from bulletuav.envs.snapshot import UNSTARTED
from bulletuav.envs.stages import keep_before, tick
from bulletuav.tasks import TaskSource
from bulletuav.tasks.account import Account
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import FIELDS, Frame, Spawn
from bulletuav.tasks.given import Given
from bulletuav.tasks.spawns import MEMORY, Starts

STALE = frozenset(
    {
        *(name for name in FIELDS if name.endswith("_before")),
        "conflicts",
        "separation",
        "nearness",
    }
)
"""What tells something else of a decision than once no time has passed"""


class _Stillness(NamedTuple):
    """A program after which it is as if no time had passed, and the account that it fills."""

    account: Account
    program: Program


class Resets(Decisions):
    """How some of the worlds start new episodes, while others stay as they are."""

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 1,
        **options: Any,
    ) -> None:
        """Build the worlds; see `Worlds`."""
        super().__init__(task, num_worlds, **options)
        things = self.scene.obstacle.shape[1]
        sizes = (self.num_worlds, things)
        self._starts = Starts(self.task, self.options.airframe, *sizes, self.scene.memory)
        # Worlds that begin anew: a mask, indices, and a mask of their drones
        self._fresh, self._nobody, self._due = np.zeros((3, self.num_worlds), dtype=bool)
        self._fresh_worlds: list[int] = []
        self._fresh_drones = np.zeros(self.alive.shape, dtype=bool)
        self._start: Program | None = None
        self._still: _Stillness | None = None
        self._alone: tuple[ByWorld, ByWorld] | None = None
        self._is_still = True

    def _generators(self, worlds: list[int], seeds: list[int] | None) -> list[np.random.Generator]:
        if seeds is not None:
            return [np.random.default_rng(seeds[k]) for k in worlds]
        first = None if self.options.seed is None else self.options.seed + self._first_world
        return [
            np.random.default_rng(None if first is None else first + k)
            if self.rng[k] is UNSTARTED
            else self.rng[k]
            for k in worlds
        ]

    def _draw_starts(self, generators: list[np.random.Generator], given: Given) -> None:
        """Draw starts, and check them; nothing of the worlds is written."""
        task = self.task
        spawns = list(task.spawn_many(generators))
        if len(spawns) != len(generators):
            raise ValueError(
                f"spawn_many of task {task.name!r} gave {len(spawns)} starts: "
                f"{len(generators)} are needed, one for each generator"
            )
        # Most starts are whole as they are drawn
        if task.takes_off or not given.is_empty or type(task).finish is not Task.finish:
            spawns = [
                task.finish(spawn, given, rng) if isinstance(spawn, Spawn) else spawn
                for spawn, rng in zip(spawns, generators, strict=True)
            ]
        self._starts.take(spawns)

    def _begin(
        self,
        fresh: np.ndarray,
        worlds: list[int],
        generators: list[np.random.Generator],
    ) -> Frame:
        """Start worlds of `fresh` (W,) from what was drawn, and tell their first frame."""
        if self._start is None:
            self._start = self._make_start()
        self._fresh[:], self._fresh_worlds = fresh, worlds
        if len(worlds) == len(fresh):
            self.rng[:] = generators
        else:
            for k, rng in zip(worlds, generators, strict=True):
                self.rng[k] = rng
        if self._wind.is_gusty or self._uncertainty.drawn:
            for k, rng in zip(worlds, generators, strict=True):
                self._wind.reset(k, rng)
                self._uncertainty.reset(k, rng)
        self._forget()
        self._start.run()
        # First readings make arrays that the next program knows
        self._look()
        # The others are brought up to date when somebody asks for them
        alone = None if self.program is None or len(worlds) == len(fresh) else self._alone
        self._is_still = alone is None
        if alone is None:
            self._stillness().program.run()
        else:
            alone[0].run(self._fresh)
        self._start_memory()
        return self._live

    def _observe_fresh(self) -> None:
        """Write what is observed after a reset."""
        self._forget()
        if self._is_still or self._alone is None:
            self._observing.run()
        else:
            self._alone[1].run(self._due)

    def _current(self) -> Frame:
        """Tell the frame, in which no time has passed after a reset."""
        frame = super()._current()
        if not self._is_still:
            self._is_still = True
            self._forget()
            self._stillness().program.run()
        return frame

    def _stillness(self) -> _Stillness:
        """Make the program after which it is as if no time had passed, once for what stands."""
        account = self._account
        assert account is not None
        if self._still is None or self._still.account is not account:
            self._still = _Stillness(account, self._make_still(account))
        return self._still

    def _make_first(self) -> tuple[Program, Program]:
        """Make also what is done for some worlds alone, where others do not feel it."""
        observing, telling = super()._make_first()
        self._alone = None
        if self.num_worlds > 1 and self._sensors.keep_others and self.observer.reads_none_of(STALE):
            account, program = self._stillness()
            arrays = [*self._state_arrays().values(), *self._more_arrays().values()]
            arrays += [*account.conflict, *account[1:], self._vector, self._nobody]
            still = by_world(program, arrays)
            alone = by_world(observing, arrays)
            self._alone = None if still is None or alone is None else (still, alone)
        return observing, telling

    def _make_start(self) -> Program:
        """Make the program that starts worlds from what was drawn."""
        program, fresh = Program(), self._fresh
        self._add_rows(program)
        program.call(spread, fresh, self._fresh_drones)
        self._dynamics.add_place(program, self.swarm, self._fresh_drones)
        add_value(program, fresh, 0, self._dynamics.contact.touches.number)
        program.call(renew, self.alive, fresh, self._present, self._due)
        # Python's turns together, as each takes the way out of compiled code and back
        if self._sensors.sensors:
            program.turn(self._reset_sensors)
        program.turn(self._put_scene)
        program.turn(self._keep_contacts)
        if self._sensors.sensors:
            swarm, drones = self.swarm, self._fresh_drones
            program.turn(lambda: self._keep(self._measure(swarm, swarm, drones)))
        return program

    def _make_still(self, account: Account) -> Program:
        """Make the program after which it is as if no time had passed in the decision."""
        program, frame, goal = Program(), self._live, self.scene.goal
        self._energy.add_voltage(program)
        nothing = self.scene.obstacle[:, :0]
        before = (goal, frame.goal_before, nothing, nothing)
        program.call(keep_before, self.swarm, frame.before, *before)
        clock = (self.steps, float(self.options.decision_hz), self.options.horizon)
        program.call(tick, self._nobody, *clock, frame.time, frame.last)
        self._add_account(program, account)
        return program

    def _add_rows(self, program: Program) -> None:
        """Add that starts are written, and all that begins anew with them."""
        swarm, scene, rows, fresh = self.swarm, self.scene, self._starts.rows, self._fresh
        written = [(rows[f"{MEMORY}{name}"], array) for name, array in scene.memory.items()]
        written += [(rows[name], getattr(swarm, name)) for name in swarm._fields if name in rows]
        written += [(rows[name], getattr(scene, name)) for name in scene._fields if name in rows]
        written += [(rows["position"], scene.start), (rows["velocity"], self.commanded)]
        for row, array in written:
            add_rows(program, fresh, row, array)
        speed = 0.0 if self.task.takes_off else self._hover_speed
        values = [
            (speed, swarm.rotor_speed),
            (0.0, self._cascade.memory),
            (True, self.alive),
            (0, self.steps),
            (0.0, self._live.action),
            (True, self._live.alive),
        ]
        for value, array in values:
            add_value(program, fresh, value, array)
        self._energy.add_start(program, fresh)

    def _reset_sensors(self) -> None:
        for k in self._fresh_worlds:
            self._sensors.reset(k, self.swarm, self.rng[k])

    def _put_scene(self) -> None:
        """Let what stands in worlds stand where it begins."""
        self._engine.set_layouts(self.scene.layout, self._fresh)
        if self.scene.obstacle.size:
            self._put_obstacles(self._fresh)

    def _put_obstacles(self, worlds: np.ndarray) -> None:
        """Tell the engine where obstacles of `worlds` (W,) bool are."""
        obstacles = (self.scene.obstacle, self.scene.obstacle_quaternion, worlds)
        if self._engine.asks_bodies:
            self._engine.set_obstacles(*obstacles)
        else:
            self._engine.note_obstacles(*obstacles)

    def _keep_contacts(self) -> None:
        """Keep the contacts of worlds that fly on, where only Python knows them."""
        if self.options.contacts == "bullet":
            self._tell_contacts()
        told = self._contacts if self._collects_contacts else None
        self._contacts = None if told is None else told.of_worlds(~self._fresh)

    def _start_memory(self) -> None:
        """Let the task fill the memory of the worlds that were reset; others keep theirs."""
        if type(self.task).start_memory is Task.start_memory:
            return
        memory = self.scene.memory
        kept = {name: array.copy() for name, array in memory.items()}
        self.task.start_memory(self._live)
        for name, array in kept.items():
            memory[name][~self._fresh] = array[~self._fresh]
