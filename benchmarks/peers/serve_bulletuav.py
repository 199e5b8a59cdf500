"""bulletuav itself, in the cases of the others."""

from functools import partial

import numpy as np
from serve import serve

import bulletuav
from bulletuav.benchmark import SUBSTEPS, floors, hovering


def flight(worlds: int, drones: int, dynamics: str, **options):
    """The whole step: controllers, all forces, engine, contacts, observation, reward."""
    aviary = hovering(worlds, drones, dynamics, **options)
    return partial(aviary.step, np.zeros((worlds, drones, 3))), worlds * drones * SUBSTEPS


def reset(drones: int):
    """A reset of one world."""
    return partial(hovering(1, drones, "bullet").reset, seeds=0), 1


def crossing(drones: int):
    """The PettingZoo environment, reset when an agent is done."""
    env = bulletuav.parallel_env("crossing", num_drones=drones, horizon=10**9, randomization={})
    env.reset(seed=0)
    actions = {agent: np.zeros(3, dtype=np.float32) for agent in env.agents}

    def step() -> None:
        if len(env.agents) < drones:
            env.reset()
        env.step(actions)

    return step, drones * SUBSTEPS


def batched_crossing(worlds: int, drones: int):
    """The batched environment on the cheapest dynamics: agent-decisions, to compare with point masses."""
    env = bulletuav.batch_env("crossing", worlds, num_drones=drones, dynamics="single_integrator", randomization={})
    env.reset(seed=0)
    return partial(env.step, np.zeros((worlds, drones, 3))), worlds * drones


def floor(worlds: int, drones: int):
    """The engine alone: step, a wrench and a state of every drone, in C, and nothing else."""
    world, cases = floors(worlds, drones)
    if world.port is None:
        raise RuntimeError("needs the C extension: see `bulletuav doctor`")
    return cases["engine calls"], worlds * drones * SUBSTEPS


if __name__ == "__main__":
    serve(
        {
            "bullet, 10": partial(flight, 1, 10, "bullet"),
            "bullet, 100": partial(flight, 1, 100, "bullet"),
            "bullet, 1000": partial(flight, 1, 1000, "bullet"),
            "bullet, 64 x 8": partial(flight, 64, 8, "bullet"),
            "rigid_body with PID, 64 x 8": partial(flight, 64, 8, "rigid_body", controller="pid"),
            "crossing, 8": partial(crossing, 8),
            "crossing of points, 64 x 8": partial(batched_crossing, 64, 8),
            "reset, 10": partial(reset, 10),
            "floor, 64 x 8": partial(floor, 64, 8),
        }
    )
