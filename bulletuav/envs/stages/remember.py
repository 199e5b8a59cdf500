"""Stage: update of the task's memory."""

from functools import partial

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.base import Task
from bulletuav.tasks.parts.base import Part


class Remember(Stage):
    """Let the task update its memory, by its parts and by `Task.update_memory`."""

    name = "remember"
    reads = ("before", "swarm", "scene", "flown", "account", "readings", "rng")
    writes = ("scene",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        task = worlds.task
        # A method of the task decides when its parts are updated
        if type(task).update_memory is not Task.update_memory:
            program.callback(lambda: task.update_memory(worlds.frame, worlds.rng))
            return
        for part in task.parts:
            for call in part.memory_calls(worlds.frame):
                program.call(*call)
            if type(part).update_memory is not Part.update_memory:
                program.callback(partial(part.update_memory, worlds.frame, worlds.rng))
