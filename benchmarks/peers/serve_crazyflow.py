"""crazyflow (Learning Systems and Robotics Lab): JAX on the CPU."""

from serve import SUBSTEPS, serve  # first: it takes care of what others print

# isort: split

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.control import Control
from crazyflow.dynamics import Dynamics
from crazyflow.sim import Sim


def flight(worlds: int, drones: int, contacts: bool):
    """Fly first-principles dynamics under the state controller, 24 substeps a decision."""
    sim = Sim(
        n_worlds=worlds,
        n_drones=drones,
        dynamics=Dynamics.first_principles,
        control=Control.state,
        freq=240,
        state_freq=240,
        attitude_freq=240,
        body_rate_freq=240,
        force_torque_freq=240,
    )
    sim.reset()
    command = np.zeros((worlds, drones, 16), dtype=np.float32)
    command[..., :3] = np.asarray(sim.data.states.pos)
    command[..., 2] += 1.0
    command = jnp.asarray(command)

    def decision() -> None:
        sim.state_control(command)
        if contacts:
            for _ in range(SUBSTEPS):
                sim.step(1)
                sim.contacts()
        else:
            sim.step(SUBSTEPS)
        jax.block_until_ready(sim.data.states.pos)

    return decision, worlds * drones * SUBSTEPS


def reset(drones: int):
    """Reset one world."""
    sim = Sim(
        n_worlds=1,
        n_drones=drones,
        dynamics=Dynamics.first_principles,
        control=Control.state,
        freq=240,
    )

    def call() -> None:
        sim.reset()
        jax.block_until_ready(sim.data.states.pos)

    return call, 1


if __name__ == "__main__":
    serve(
        {
            "no contacts, 64 x 8": partial(flight, 64, 8, False),
            "contacts, 64 x 8": partial(flight, 64, 8, True),
            "reset, 10": partial(reset, 10),
        }
    )
