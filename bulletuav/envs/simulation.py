"""Simulation of a task: state of all worlds, and the stages of a decision in their order."""

import time

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.envs.action_masks import ACTION_MASK
from bulletuav.envs.episode_start import EpisodeStart
from bulletuav.envs.results import Results
from bulletuav.envs.stages import Stage, decision_stages
from bulletuav.envs.stages.base import format_stages, insert_stage, stage_programs_of
from bulletuav.envs.stages.observe import Observe
from bulletuav.envs.stages.report import WriteInfos
from bulletuav.envs.stages.separate import Separate
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.check import check_info, check_step_result, require_new_infos
from bulletuav.tasks.stages import add_outcome, clear

DECIDES = "decides"
"""Info of drones whose next action is flown, with the option `decision_every`"""


class Simulation:
    """Simulates W worlds of N drones that fly one task, decision by decision.

    A decision is a program: the compiled calls of all stages, one after the other, without Python
    in between. `print` lists the stages.

    Attributes:
        worlds: Components and state of the worlds.
        stages: Stages of a decision, in their order; see `insert`.
        start: Starts new episodes.
        program: Calls of a decision; None before the first one.
    """

    def __init__(self, worlds: Worlds, first_seed: int | None) -> None:
        """Create a simulation of worlds.

        Args:
            worlds: Components and state of the worlds.
            first_seed: Seed of the first world if a reset has none.
        """
        self.worlds = worlds
        self._has_rates = worlds.spec.decision_every is not None
        self.stages: tuple[Stage, ...] = decision_stages(
            bool(worlds.schedule.events), self._has_rates
        )
        self.start = EpisodeStart(worlds, first_seed)
        self.program: Program | None = None
        self._staged: tuple[Program, dict[str, Program]] | None = None
        self._has_account = self._checked = False

    def __repr__(self) -> str:
        """Return a table of the stages, with the arrays that each reads and writes."""
        worlds, drones = self.worlds.state.alive.shape
        dynamics = self.worlds.options.dynamics_name
        title = f"{self.worlds.task.name} in {dynamics}: {worlds} worlds of {drones} drones"
        return f"{title}\n{format_stages(self.stages)}"

    def insert(self, stage: Stage, after: str | None = None, *, before: str | None = None) -> None:
        """Insert a custom stage into all later decisions.

        Args:
            stage: The stage.
            after: Name of the stage that it follows; or
            before: name of the stage that it precedes.

        Raises:
            ValueError: If none or both of these are given, there is no such stage, the name of
                the new stage is in use, or it declares an unknown array.
        """
        arrays = self.worlds.state.named()
        self.stages = insert_stage(self.stages, stage, arrays, after, before)
        self.program = None

    def decide(self) -> None:
        """Simulate one decision with the actions in `state.given`.

        Raises:
            ValueError: If an action of an active drone is invalid. The worlds are unchanged.
        """
        self.update_scene()
        self.start.is_account_complete = True
        program = self.program or self.make_program()
        self._start_decision()
        program.run()

    def _start_decision(self) -> None:
        """Clear what Python keeps of the previous decision."""
        self.worlds.contacts.start_decision()
        self.worlds.forget_derived()
        self.worlds.any_left = False

    def decide_by_stages(self) -> dict[str, float]:
        """Simulate one decision as `decide` does, stage by stage, with the same bits.

        Returns:
            Time of each stage, by name, s. Each is about 1e-6 s longer than within `decide`, as
            Python calls it.
        """
        self.update_scene()
        self.start.is_account_complete = True
        # Always made, as results after a reset need it
        program = self.program or self.make_program()
        if self._staged is None or self._staged[0] is not program:
            self._staged = program, self.stage_programs()
        self._start_decision()
        times = {}
        for name, part in self._staged[1].items():
            begin = time.perf_counter()
            part.run()
            times[name] = time.perf_counter() - begin
        return times

    def stage_programs(self) -> dict[str, Program]:
        """Make a program of each stage alone, by its name."""
        self._derive()
        return stage_programs_of(self.stages, self.worlds)

    def _derive(self) -> None:
        """Let the task compute its derived values, so that programs find them."""
        self.worlds.forget_derived()
        self.worlds.task.evaluate_step(self.worlds.frame)

    def update_scene(self) -> None:
        """Update programs if bodies changed since they were made."""
        if self.worlds.dynamics.look_around():
            self._has_account = False
        if not self._has_account:
            self.worlds.make_frame_measures()
            self._recomputing = Program()
            Separate().add_to(self._recomputing, self.worlds)
            # Last, so that an interrupt leaves no incomplete program
            self.program, self._has_account = None, True

    def make_program(self) -> Program:
        """Make the program of a decision."""
        worlds = self.worlds
        program = Program(worlds.options.threads)
        self._derive()
        for stage in self.stages:
            stage.add_to(program, worlds)
        program.compile()  # now, so that the first decision is as fast as later ones
        self._observing, self._reporting = Program(), Program()
        Observe().add_observation(self._observing, worlds)
        # Reward terms are zero after a reset
        add_outcome(self._reporting, worlds.task, worlds.frame, worlds.judgement)
        self._reporting.call(clear, worlds.results.weighted)
        WriteInfos().add_to(self._reporting, worlds)
        self.start.make_by_world_programs(self._observing)
        self.program = program  # last, so that an interrupt leaves no incomplete program
        return program

    def start_worlds(
        self, fresh: np.ndarray, indices: list[int], generators: list[np.random.Generator]
    ) -> None:
        """Start worlds from the drawn starts.

        Args:
            fresh: (W,) bool, worlds that start.
            indices: Indices of these worlds.
            generators: Random generators of these worlds.
        """
        self.start.write(fresh, indices, generators)
        # First readings allocate arrays that programs use
        self.update_scene()
        self.start.account(self.program is not None)
        if not self._checked:
            self._check()

    def _check(self) -> None:
        """Check the results of the task once; later results have the same form."""
        task, frame = self.worlds.task, self.worlds.frame
        shape = self.worlds.state.alive.shape
        result = task.evaluate_step(frame)
        check_step_result(task, result, shape)
        info, compiled = task.info(frame), task.compiled_info_names()
        check_info(task, info, shape)
        require_new_infos(task, info, compiled)
        terms = [*result.terms, *task.extra_terms(frame)]
        self.worlds.results = Results(terms, compiled, shape, task.has_goals)
        worlds = self.worlds
        own = task.overrides_method("info") or worlds.masks is not None or self._has_rates
        self._has_further_infos = own or bool(
            task.lands or worlds.uncertainty.drawn or worlds.sensors.sensors
        )
        self._checked = True

    def further_infos(self) -> dict[str, np.ndarray]:
        """Return the infos (W, N) in addition to reward terms and `results.INFOS`."""
        if not self._has_further_infos:
            return {}
        worlds = self.worlds
        landed = {"landed": worlds.frame.landed} if worlds.task.lands else {}
        own = worlds.task.info(worlds.frame)
        masks = {} if worlds.masks is None else {ACTION_MASK: worlds.action_masks()}
        if self._has_rates:
            own = {**own, DECIDES: worlds.decides()}
        return {**landed, **own, **worlds.uncertainty.info(), **worlds.sensors.info(), **masks}

    def observe_start(self) -> None:
        """Write the observations after a reset; needs the program."""
        self.start.observe(self._observing)

    def report_start(self) -> None:
        """Write the infos after a reset."""
        if self.program is None:
            self.make_program()
        self.worlds.forget_derived()
        self._reporting.run()

    def recompute(self) -> None:
        """Recompute everything that follows from a state that was written directly."""
        self.worlds.contacts.keep(None)
        self.worlds.forget_derived()
        self.update_scene()
        self._recomputing.run()
        if self.program is None:
            self.make_program()
        self.worlds.forget_derived()
        self._observing.run()
