"""Stage: the flight."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.obstacle_turns import finish_turns, start_turns
from bulletuav.control.setpoint import Setpoints
from bulletuav.envs.parts import add_obstacles, copy_vectors
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.vehicle.swarm import confine


class Fly(Stage):
    """Simulate all substeps (controllers, forces, contacts), and apply the arena's bounds."""

    name = "fly"
    reads = (
        *("setpoint", "levels", "wind", "flown", "scene.obstacle", "steps", "flying"),
        *("swarm", "dynamics", "commanded"),
    )
    writes = ("swarm", "dynamics", "steps", "time", "last", "moved", "commanded", "engine")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, task, dynamics = worlds.state, worlds.task, worlds.dynamics
        program.call(copy_vectors, state.scene.obstacle, dynamics.contact.after)
        turns = (worlds.engine.scenery, state.scene.obstacle_quaternion, dynamics.contact.turns)
        if task.turns_obstacles:
            program.call(start_turns, *turns)
        if worlds.loads is None:
            setpoints = Setpoints(state.levels, state.setpoint)
            dynamics.add_to(program, state.swarm, state.flown, setpoints, state.wind)
        else:
            worlds.loads.add_to(program, worlds.wind)
        if task.turns_obstacles:
            program.call(finish_turns, *turns)
        add_obstacles(program, worlds.engine, state.scene.obstacle)
        if task.rebound is not None:

            def place_again() -> None:
                dynamics.place(state.swarm, state.moved)
                # Overlaps at the new positions are contacts, too. Contacts of the flight are
                # collected first, as overlaps are written to the same arrays
                worlds.contacts.collect()
                worlds.contacts.add(dynamics.overlaps(state.swarm, state.moved, state.flown))

            box = (task.arena_low, task.arena_high, float(task.rebound))
            bounds = (state.swarm, state.commanded, state.flown, *box, state.moved)
            program.call(confine, *bounds, otherwise=place_again)
        add_decision_count(program, worlds, state.flying)


def add_decision_count(program: Program, worlds: Worlds, flying: np.ndarray) -> None:
    """Add to a program that a decision is counted in worlds of a mask (W,)."""
    state, options = worlds.state, worlds.options
    clock = (state.steps, float(options.decision_hz), options.horizon)
    program.call(count_decision, flying, *clock, state.time, state.last)


@kernel
def count_decision(
    flying: np.ndarray,
    steps: np.ndarray,
    hz: float,
    horizon: int,
    time: np.ndarray,
    last: np.ndarray,
) -> None:
    """Count a decision in the worlds that fly, and write where the horizon is reached.

    Args:
        flying: (W,) bool.
        steps: (W,) decisions since the reset, incremented.
        hz: Decisions per second.
        horizon: Number of decisions after which an episode is truncated.
        time: (W,) time since the reset, s, written.
        last: (W,) bool, whether the horizon is reached, written.
    """
    for w in range(flying.shape[0]):
        if flying[w]:
            steps[w] += 1
        time[w] = steps[w] / hz
        last[w] = steps[w] >= horizon
