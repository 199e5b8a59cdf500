"""Stage: motion of goals, obstacles and bodies."""

from bulletuav.compiled.program import Program
from bulletuav.contact.moving_bodies import start_bodies
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class MoveScene(Stage):
    """Move bodies, and let the task move goals, obstacles and users, by `Task.move_scene`."""

    name = "move scene"
    reads = ("time", "flying", "steps", "scene", "rng")
    writes = ("scene", "engine")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        # Tasks without moving objects need no Python callback
        task, state = worlds.task, worlds.state
        if task.overrides_method("move_scene"):

            def move() -> None:
                task.move_scene(state.scene, state.time, state.flying, worlds.rng)

            program.callback(move)
        scenery, bodies = worlds.engine.scenery.bodies, worlds.bodies
        if not len(scenery.reach):
            return
        hz = float(worlds.options.decision_hz)
        program.callback(lambda: bodies.follow_motions(state.flying, state.steps, hz))
        program.call(start_bodies, scenery, state.flying, 1 / hz)
