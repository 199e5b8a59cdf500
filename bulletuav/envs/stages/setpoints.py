"""Stage: setpoints of actions."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.control.actions.base import Compiled, limit_each
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.parts import copy_vectors
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class MakeSetpoints(Stage):
    """Convert actions to setpoints; reduce thrust if randomization drains batteries."""

    name = "setpoints"
    reads = ("action", "setpoint", "commanded", "time")
    writes = ("setpoint", "commanded", "dynamics")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, action, decode = worlds.state, worlds.action, worlds.action.decode
        if isinstance(decode, Compiled):
            numbers = (state.setpoint, *decode.numbers)
            program.call(decode.kernel, state.action, state.commanded, *numbers)
        else:
            program.callback(
                lambda: np.copyto(state.setpoint, decode(state.action, state.commanded))
            )
        if worlds.task.speed_limit is not None:
            limit = np.array(worlds.task.speed_limit, dtype=float)
            program.call(limit_each, state.setpoint, limit)
        # Velocity increments add to the last commanded velocity
        commands = action.levels == SetpointLevel.VELOCITY
        if commands.all():
            program.call(copy_vectors, state.setpoint, state.commanded)
        elif commands.any():
            program.call(_copy_commanded, state.setpoint, commands, state.commanded)
        if worlds.uncertainty.drains:
            program.callback(lambda: worlds.uncertainty.drain(state.time))


@kernel
def _copy_commanded(setpoint: np.ndarray, commands: np.ndarray, commanded: np.ndarray) -> None:
    """Copy the velocities of setpoints (W, N, S) of drones of the mask `commands` (N,)."""
    for w in range(setpoint.shape[0]):
        for i in range(setpoint.shape[1]):
            if commands[i]:
                for k in range(3):
                    commanded[w, i, k] = setpoint[w, i, k]
