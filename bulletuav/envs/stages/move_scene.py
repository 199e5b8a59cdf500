"""Stage: motion of goals and obstacles."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class MoveScene(Stage):
    """Let the task move goals, obstacles and users, by `Task.move_scene`."""

    name = "move scene"
    reads = ("time", "flying", "scene", "rng")
    writes = ("scene",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        # Tasks without moving objects need no Python callback
        task, state = worlds.task, worlds.state
        if task.overrides_method("move_scene"):

            def move() -> None:
                task.move_scene(state.scene, state.time, state.flying, worlds.rng)

            program.callback(move)
