"""Stage: setpoints of actions."""

import numpy as np

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
        if action.level == SetpointLevel.VELOCITY:
            program.call(copy_vectors, state.setpoint, state.commanded)
        if worlds.uncertainty.drains:
            program.callback(lambda: worlds.uncertainty.drain(state.time))
