"""Stage: update of the task's memory."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class Remember(Stage):
    """Let the task update its memory, by its parts and by `Task.update_memory`."""

    name = "remember"
    reads = ("before", "swarm", "scene", "flown", "account", "readings", "rng")
    writes = ("scene",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        task = worlds.task
        if task.overrides_method("update_memory"):
            program.callback(lambda: task.update_memory(worlds.frame, worlds.rng))
        # Afterwards, as tasks decide there what is a collision
        for part in task.parts:
            for call in part.memory_calls(worlds.frame):
                program.call(*call)
