"""Stage: energy consumption of the flight."""

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class DrainBatteries(Stage):
    """Drain batteries by the power of flight and payload, charge them; compute their voltage."""

    name = "energy"
    reads = ("before", "swarm", "wind", "flown", "scene", "payload", "energy")
    writes = ("payload", "energy", "dynamics")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, task = worlds.state, worlds.task
        if task.overrides_method("payload_power"):
            program.callback(lambda: np.copyto(state.payload, task.payload_power(state.scene)))
        charging: np.ndarray | None = None
        if task.overrides_method("charging_power"):
            charging = given = np.zeros(state.payload.shape)
            program.callback(lambda: np.copyto(given, task.charging_power(state.scene)))
        pull = np.zeros(state.payload.shape)
        loads = worlds.loads
        if loads is not None:
            program.callback(lambda: loads.fill_pull(pull))
        taken = (state.wind, state.payload, state.flown, pull, charging)
        worlds.energy.add_to(program, state.before, state.swarm, *taken)
