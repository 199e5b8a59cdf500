"""The batched core: W independent worlds of N drones through one decision at a time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.envs.agents import USUAL_TYPES
from bulletuav.envs.decisions import Decisions
from bulletuav.envs.environment import exclusive
from bulletuav.envs.infos import Infos, later
from bulletuav.envs.snapshot import (
    Layout,
    Snapshot,
    hashes_of,
    layout_of,
    pack,
    require_contacts,
    require_form,
    require_snapshot,
)
from bulletuav.envs.step import Step
from bulletuav.envs.worlds import UNSTARTED
from bulletuav.tasks.base import Task
from bulletuav.tasks.check import check_info, check_step_result, take_spawns
from bulletuav.tasks.frame import Frame, Spawn
from bulletuav.tasks.given import Given
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.starts import take_given


class Aviary(Decisions):
    """W worlds of N drones flying one task.

    Never resets by itself: a drone whose episode ended leaves the airspace and is masked by `alive`
    until its world is reset. World k's random numbers come from seed + k alone, and nothing that
    other worlds do changes world k.

    Its arrays stay the same for its life, and each decision writes them anew: copy what you keep.

    Attributes:
        options: Common options.
        task: The task.
        action: What actions mean.
        observer: Makes observations; tells labels, and splits by name.
        global_state: Tells labels of the global state, and splits it by name.
        swarm: State of the drones, (W, N, ...).
        scene: Goals, obstacles and the task's memory.
        alive: (W, N) bool, drones whose episode goes on.
        steps: (W,) decisions since the reset.
        commanded: (W, N, 3) velocities commanded last, m/s.
        parameters: (W, N) rows of `PARAMETERS` with which the drones fly.
        rng: Random generator of each world.
        program: What a decision does; None before the first one.
        given: (W, N, A) actions for `decide`.
        rewards: (W, N) rewards of the last decision.
        terminated: (W, N) bool, drones whose episode the task ended in it.
        truncated: (W, N) bool, drones whose episode the horizon ended in it.
        viewer: Shows world 0 with `render_mode` "web" and "foxglove"; None otherwise.
    """

    _layout: Layout | None = None

    @exclusive
    def reset(
        self,
        mask: np.ndarray | None = None,
        seeds: int | Sequence[int] | None = None,
        start: Any = None,
        goal: Any = None,
    ) -> Observation:
        """Start new episodes.

        Args:
            mask: (W,) bool, worlds to reset; all when left out.
            seeds: An int s gives world k the seed s + k; a sequence gives each of the W worlds its
                own; None goes on with each world's random numbers, which begin from the option
                `seed`, or from entropy.
            start: (N, 3) where drones start in these episodes, m; as the task's option `start`
                says when left out.
            goal: (N, 3) where they are to go, m; as `goal` says when left out.

        Returns:
            Observations of all worlds, (W, N, D) float32 or a dict.

        Raises:
            ValueError: The task's start cannot be, or what is given; the worlds stay as they were.
            RuntimeError: The environment is closed.
        """
        self._require_open()
        worlds = np.flatnonzero(self._spec.mask(mask))
        generators = self._generators(worlds, self._spec.seeds(seeds))
        spawns = list(self.task.spawn_many(generators))
        if len(spawns) != len(generators):
            raise ValueError(
                f"spawn_many of task {self.task.name!r} gave {len(spawns)} starts: "
                f"{len(generators)} "
                f"are needed, one for each generator"
            )
        given = take_given(self.task, start, goal)
        given = Given(*(self._given[k] if one is None else one for k, one in enumerate(given)))
        spawns = [
            self.task.finish(spawn, given, rng) if isinstance(spawn, Spawn) else spawn
            for spawn, rng in zip(spawns, generators, strict=True)
        ]
        # All before anything of the worlds is written
        things = self.scene.obstacle.shape[1]
        starts = take_spawns(self.task, spawns, self.options.airframe, things, self.scene.memory)
        self._place(worlds, starts)
        for k, rng in zip(worlds.tolist(), generators, strict=True):
            self.rng[k] = rng
            self._wind.reset(k, rng)
            self._uncertainty.reset(k, rng)
            self._sensors.reset(k, self.swarm, rng)
        reset = np.zeros(self.num_worlds, dtype=bool)
        reset[worlds] = True
        chosen = np.zeros(self.alive.shape, dtype=bool)
        chosen[reset] = True
        self._dynamics.place(self.swarm, chosen)
        self._engine.set_layouts(self.scene.layout, reset)
        self._put_obstacles(reset)
        frame = self._first_frame(chosen, reset)
        self._start_memory(frame, chosen)
        if not self._checked:  # once: later results are of the same form
            result = self.task.evaluate_step(frame)
            check_step_result(self.task, result, chosen.shape)
            check_info(self.task, self.task.info(frame), chosen.shape)
            self._name_infos([*result.terms, *self.task.extra_terms(frame)])
            self._checked = True
        self._frame = frame
        if self.viewer is not None and reset[0]:
            self.viewer.begin()
        if self.program is None:
            return self.observer.observe(frame, self.alive)
        self._present[:] = self.alive
        self._forget()
        self._observing.run()
        return self.observations()

    def _generators(self, worlds: np.ndarray, seeds: list[int] | None) -> list[np.random.Generator]:
        if seeds is not None:
            return [np.random.default_rng(seeds[k]) for k in worlds]
        first = None if self.options.seed is None else self.options.seed + self._first_world
        return [
            np.random.default_rng(None if first is None else first + int(k))
            if self.rng[k] is UNSTARTED
            else self.rng[k]
            for k in worlds
        ]

    def _place(self, worlds: np.ndarray, start: Mapping[str, np.ndarray]) -> None:
        """Write the starts (S, ...) of some worlds (S,)."""
        swarm, scene = self.swarm, self.scene
        # A slice is found sooner than a list of indices
        at = slice(worlds[0], worlds[0] + 1) if len(worlds) == 1 else worlds
        swarm.position[at], swarm.quaternion[at] = start["position"], start["quaternion"]
        swarm.velocity[at], swarm.rates[at] = start["velocity"], start["rates"]
        swarm.rotor_speed[at] = 0.0 if self.task.takes_off else self._hover_speed
        scene.start[at], scene.goal[at] = start["position"], start["goal"]
        scene.goal_velocity[at] = start["goal_velocity"]
        if scene.obstacle.shape[1]:
            scene.obstacle[at] = start["obstacle"]
            scene.obstacle_velocity[at] = start["obstacle_velocity"]
            scene.obstacle_quaternion[at] = start["obstacle_quaternion"]
        scene.layout[at] = start["layout"]
        for name, remembered in scene.memory.items():
            remembered[at] = start[f"memory {name}"]
        self._cascade.memory[at] = 0
        self.commanded[at] = start["velocity"]
        self.alive[at] = True
        self.steps[at] = 0
        self._energy.start(at)

    def _first_frame(self, chosen: np.ndarray, reset: np.ndarray) -> Frame:
        """Bring the frame to right after a reset of the drones of `chosen` (W, N)."""
        frame = self._live
        # Of the worlds that fly on, it is as if no time had passed
        for before, now in zip(frame.before, self.swarm, strict=True):
            before[:] = now
        frame.goal_before[:] = self.scene.goal
        frame.action[chosen] = 0.0
        frame.alive[:] |= chosen
        frame.time[:] = self.steps / self.options.decision_hz
        frame.last[:] = self.steps >= self.options.horizon
        kept = self._tell_contacts().of_worlds(~reset) if self._collects_contacts else None
        self._contacts = kept
        self._dynamics.contact.touches.number[reset] = 0
        self._forget()
        self._keep(self._measure(self.swarm, self.swarm, chosen))
        self._look()
        self._reckoning.run()
        return frame

    def _start_memory(self, frame: Frame, chosen: np.ndarray) -> None:
        """Let the task fill the memory of the worlds that were reset; others keep theirs."""
        if type(self.task).start_memory is Task.start_memory:
            return
        memory = self.scene.memory
        kept = {name: array.copy() for name, array in memory.items()}
        self.task.start_memory(frame)
        others = ~np.any(chosen, axis=1)
        for name, array in kept.items():
            memory[name][others] = array[others]

    @exclusive
    def step(self, actions: np.ndarray) -> Step:
        """Fly one decision.

        Args:
            actions: (W, N, A); those beyond the bounds are clipped to them.

        Raises:
            ValueError: A wrong shape, or a number that is not finite in a living drone's action.
                The worlds stay as they were.
            RuntimeError: Before the first reset or after `close`.
        """
        self.require_started()
        given = self.given
        if (
            type(actions) is np.ndarray
            and actions.shape == given.shape
            and actions.dtype in USUAL_TYPES
        ):
            given[:] = actions  # the program looks at them
        else:
            given[:] = self._spec.actions(actions, self.alive)
        self.decide()
        ends = (self.terminated.copy(), self.truncated.copy())
        return Step(self.observations(), self.rewards.copy(), *ends, later(self.telling()))

    def decide(self) -> None:
        """Fly one decision of the actions that were written to `given`.

        For environment classes, which take the results from `rewards`, `terminated`, `truncated`,
        `observations` and `telling`.

        Raises:
            ValueError: A number of a living drone's action cannot be. The worlds stay as they were.
        """
        self._look()
        program = self.program or self._make_program()
        self._contacts_before, self._contacts = self._contacts, None
        self._forget()
        program.run()
        if self.viewer is not None:
            self.viewer.show()

    def observations(self) -> Observation:
        """Copy the observations of the last decision."""
        vector = self._vector.copy()
        return vector if self.observer.is_plain else self.observer.shown(self._live, vector)

    @exclusive
    def first_info(self) -> Infos:
        """Tell the infos right after a reset: the keys of every step's info, terms at zero."""
        self._current()
        if self.program is None:
            self._make_program()
        self._forget()
        self._telling.run()
        return later(self.telling())

    @exclusive
    def save_state(self, worlds: Any = None) -> Snapshot:
        """Save all that makes the future of worlds, for `load_state`.

        With dynamics "bullet" this rounds their attitudes by some 1e-17: a flight that was saved
        goes on as from the snapshot, and differs in the last bits from one that was not.

        Args:
            worlds: Indices of them; all when left out.

        Raises:
            RuntimeError: Before the first reset, or after `close`.
            ValueError: There are no such worlds, or contacts are Bullet's own.
        """
        self.require_started()
        require_contacts(self.options.contacts)
        layout, chosen = self._all_arrays(), self._spec.indices(worlds)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Bullet rounds what is written: both flights are to go on from that.
        self._dynamics.restore(self.swarm, mask[:, None] & self.alive)
        return Snapshot(layout.pack(self.rng, chosen), layout.form)

    @exclusive
    def load_state(self, snapshot: Snapshot, worlds: Any = None) -> Observation:
        """Go on from a state that was saved here, or in an environment made from the same options.

        What follows is the same to the last bit; with dynamics "bullet" only in the world's own
        place, as Bullet rounds by where it is.

        Args:
            snapshot: As many worlds as are to be written.
            worlds: Their indices here; all when left out.

        Returns:
            Observations of all worlds, as `reset` gives them.

        Raises:
            ValueError: It does not fit; the worlds stay as they were.
            RuntimeError: After `close`.
        """
        chosen = self._spec.indices(worlds)
        if self._frame is None:
            self.reset()
        layout = self._all_arrays()
        require_snapshot(snapshot, Snapshot, len(chosen))
        require_form(snapshot, layout.form, f"environment of {self.task.name!r}")
        layout.unpack(snapshot.data, self.rng, chosen)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Bodies, and what was worked out of the state.
        drones = mask[:, None] & self.alive
        self._uncertainty.restore(chosen)
        self._engine.set_layouts(self.scene.layout, mask)
        self._put_obstacles(mask)
        self._dynamics.restore(self.swarm, drones)
        self._engine.park(mask[:, None] & ~self.alive)
        self._contacts = None
        self._forget()
        self._look()
        self._reckoning.run()
        if self.program is None:
            self._make_program()
        self._forget()
        self._observing.run()
        return self.observations()

    @exclusive
    def state_hash(self, worlds: Any = None) -> tuple[str, ...]:
        """Hash the state of each world, with its random generator.

        Equal flights have equal hashes, whatever flew before. What sensors and contacts remember is
        left out.

        Args:
            worlds: Indices of them; all when left out.
        """
        self.require_started()
        chosen = self._spec.indices(worlds)
        return hashes_of(pack(self._state_arrays(), self.rng, chosen))

    def _all_arrays(self) -> Layout:
        arrays = {**self._state_arrays(), **self._more_arrays()}
        self._layout = layout_of(self._layout, self.task.name, arrays)
        return self._layout

    def _put_obstacles(self, worlds: np.ndarray) -> None:
        """Tell the engine where obstacles of `worlds` (W,) bool are."""
        obstacles = (self.scene.obstacle, self.scene.obstacle_quaternion, worlds)
        if self._engine.asks_bodies:
            self._engine.set_obstacles(*obstacles)
        else:
            self._engine.note_obstacles(*obstacles)
