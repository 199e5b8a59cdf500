"""Stage: further starts of drones whose episode would have ended."""

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.parts.restarts import Restarts


class Respawn(Stage):
    """Place drones that start again, in tasks with `Task.restarts`, with full batteries."""

    name = "respawn"
    reads = ("swarm", "scene", "flown", "rng")
    writes = ("swarm", "scene", "commanded", "energy", "dynamics", "engine", "rng")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        restarts = worlds.task.restarts
        if restarts is None:
            return
        voltage = Program()
        worlds.energy.add_voltage(voltage)

        def start_again(restarts: Restarts = restarts) -> None:
            state, memory = worlds.state, worlds.state.scene.memory
            due = (memory["restarting"] > 0) & state.flown
            if not due.any():
                return
            swarm = state.swarm
            restarts.place(swarm, state.scene, due, state.flown, worlds.rng)
            speed = np.broadcast_to(worlds.hover_speed, swarm.rotor_speed.shape)
            swarm.rotor_speed[due] = 0.0 if worlds.task.takes_off else speed[due]
            surfaces = np.broadcast_to(worlds.cruise.deflection, swarm.deflection.shape)
            swarm.deflection[due] = surfaces[due]
            worlds.start_cruise(due)
            worlds.cascade.memory[due] = 0.0
            state.commanded[due] = swarm.velocity[due]
            worlds.energy.readings()["charge"][due] = 1.0
            worlds.energy.power[due] = 0.0
            voltage.run()
            worlds.dynamics.place(swarm, due)

        program.callback(start_again)
