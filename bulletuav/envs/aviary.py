"""The batched core: W independent worlds of N drones through one decision at a time."""

import operator
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.envs.agents import USUAL_TYPES
from bulletuav.envs.described import parts_of
from bulletuav.envs.environment import exclusive, in_plain_python
from bulletuav.envs.infos import Infos, later
from bulletuav.envs.resets import Resets
from bulletuav.envs.snapshot import (
    BODIES,
    Layout,
    Snapshot,
    hashes_of,
    own_snapshot,
    pack,
    require_contacts,
    require_parts,
    require_snapshot,
)
from bulletuav.envs.step import Step
from bulletuav.tasks import TaskSource
from bulletuav.tasks.check import check_info, check_step_result
from bulletuav.tasks.given import Given
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.starts import take_given


class Aviary(Resets):
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
    _parts: Mapping[str, str] | None = None
    _varying: Sequence[object] = ()

    def __init__(self, task: TaskSource, num_worlds: int = 1, **options: Any) -> None:
        """Build the worlds; see `Worlds`."""
        super().__init__(task, num_worlds, **options)
        if self.options.debug:
            in_plain_python(self, ("reset", "decide", "first_info", "load_state", "state"))

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
        spec = self._spec
        chosen = spec.mask(mask)
        worlds = chosen.nonzero()[0].tolist()
        generators = self._generators(worlds, spec.seeds(seeds))
        given = self._given
        if not (start is None and goal is None):
            places = take_given(self.task, start, goal)
            given = Given(*(given[k] if one is None else one for k, one in enumerate(places)))
        # All before anything of the worlds is written
        self._draw_starts(generators, given)
        frame = self._begin(chosen, worlds, generators)
        if not self._checked:  # once: later results are of the same form
            result = self.task.evaluate_step(frame)
            check_step_result(self.task, result, self.alive.shape)
            check_info(self.task, self.task.info(frame), self.alive.shape)
            self._name_infos([*result.terms, *self.task.extra_terms(frame)])
            self._checked = True
        self._frame = frame
        if self.viewer is not None and chosen[0]:
            self.viewer.begin()
        if self.program is None:
            self._present[:] = False  # so that all are due when a program first observes
            return self.observer.observe(frame, self.alive)
        self._observe_fresh()
        return self.observations()

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
        self._is_still = True
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
    def first_info(self, worlds: np.ndarray | None = None) -> Infos:
        """Tell the infos right after a reset: the keys of every step's info, terms at zero.

        Args:
            worlds: (W,) bool, worlds that were just reset, of which alone they are read; those of
                others may then be of before the reset. All when left out.
        """
        if worlds is None:
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
        self._current()
        require_contacts(self.options.contacts)
        layout, chosen = self._all_arrays(), self._spec.indices(worlds)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Bullet rounds what is written: both flights are to go on from that.
        self._dynamics.restore(self.swarm, mask[:, None] & self.alive)
        return own_snapshot(layout.pack(self.rng, chosen), layout.form)

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
            ValueError: It does not fit; the worlds stay as they were, or as their first reset made
                them.
            RuntimeError: After `close`.
        """
        # All is checked before anything is written
        chosen = self._spec.indices(worlds)
        require_snapshot(snapshot, Snapshot, len(chosen))
        layout = self._layout_for(snapshot, chosen)
        # The state itself, and generators of random numbers
        layout.unpack(snapshot.data, self.rng, chosen)
        mask = np.zeros(self.num_worlds, dtype=bool)
        mask[chosen] = True
        # Bodies, and what was worked out of the state.
        drones = mask[:, None] & self.alive
        self._uncertainty.restore(chosen)
        self._engine.set_layouts(self.scene.layout, mask)
        self._put_obstacles(mask)
        self._dynamics.restore(self.swarm, drones)
        gone = mask[:, None] & ~self.alive
        if gone.any():
            self._engine.park(gone)
        # What is worked out when asked for, and observations
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

    @exclusive
    def require_loadable(self, snapshot: Snapshot) -> None:
        """Check a snapshot as `load_state` does, whatever its number of worlds, and write nothing.

        Raises:
            ValueError: It does not fit.
            RuntimeError: After `close`.
        """
        require_snapshot(snapshot, Snapshot, None)
        self._layout_for(snapshot, np.zeros(len(snapshot), dtype=int))

    def _layout_for(self, snapshot: Snapshot, chosen: np.ndarray) -> Layout:
        """Check a snapshot against worlds (S,), and return where it is to be written."""
        # Worlds that were never reset begin first
        if self._frame is None:
            self._require_open()
            require_parts(snapshot.form, self._own_parts(), self._of)
            self.reset()
        self._current()
        layout = self._all_arrays()
        layout.require(snapshot, chosen)
        return layout

    def _all_arrays(self) -> Layout:
        # Sensors may keep other arrays later, readings make some, bodies change the bounds
        varying: list[object] = [*self._sensors.kept().values(), *self._dynamics.kept().values()]
        varying += [*self._readings.values(), self._engine.scenery]
        known = self._varying
        is_known = len(known) == len(varying) and all(map(operator.is_, known, varying))
        if self._layout is None or not is_known:
            arrays = {BODIES: self._engine.bodies, **self._state_arrays(), **self._more_arrays()}
            self._layout = Layout(self._of, self._own_parts(), self._bounds(), arrays)
            self._varying = varying
        return self._layout

    @property
    def _of(self) -> str:
        return f"environment of {self.task.name!r}"

    def _own_parts(self) -> Mapping[str, str]:
        if self._parts is None:
            self._parts = parts_of(self.options, self.task)
        return self._parts
