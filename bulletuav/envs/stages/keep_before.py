"""Stage: copy of the state before the decision, which tasks compare with the state after it."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.vehicle.swarm import Swarm


class KeepBefore(Stage):
    """Copy the drones, goals and obstacles before the decision."""

    name = "keep before"
    reads = ("swarm", "scene.goal", "scene.obstacle")
    writes = ("before", "goal_before", "dynamics")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        obstacles = (state.scene.obstacle, worlds.dynamics.contact.before)
        goals = (state.scene.goal, state.goal_before)
        program.call(keep_before, state.swarm, state.before, *goals, *obstacles)


@kernel
def keep_before(
    swarm: Swarm,
    before: Swarm,
    goal: np.ndarray,
    goal_before: np.ndarray,
    obstacle: np.ndarray,
    obstacle_before: np.ndarray,
) -> None:
    """Copy the state, goals (W, N, 3) and obstacles (W, K, 3) before a decision."""
    # In place, as tasks keep references to these arrays
    for w in range(goal.shape[0]):
        for i in range(goal.shape[1]):
            for k in range(3):
                before.position[w, i, k] = swarm.position[w, i, k]
                before.velocity[w, i, k] = swarm.velocity[w, i, k]
                before.rates[w, i, k] = swarm.rates[w, i, k]
                goal_before[w, i, k] = goal[w, i, k]
            for k in range(4):
                before.quaternion[w, i, k] = swarm.quaternion[w, i, k]
            for k in range(swarm.rotor_speed.shape[2]):
                before.rotor_speed[w, i, k] = swarm.rotor_speed[w, i, k]
            for k in range(swarm.deflection.shape[2]):
                before.deflection[w, i, k] = swarm.deflection[w, i, k]
        for m in range(obstacle.shape[1]):
            for k in range(3):
                obstacle_before[w, m, k] = obstacle[w, m, k]
