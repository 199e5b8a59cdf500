"""Stage: the task's evaluation of the decision."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.stages import add_evaluation


class Judge(Stage):
    """Compute the task's ends, its success and its reward terms."""

    name = "judge"
    reads = ("action", "before", "swarm", "scene", "flown", "time", "last", "account", "readings")
    writes = ("ended", "success", "results")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        add_evaluation(program, worlds.task, worlds.frame, worlds.judgement)
