"""bulletuav itself, in the cases of the others."""

from functools import partial

import numpy as np
from serve import serve

import bulletuav
from bulletuav.physics.airframe import load_airframe
from bulletuav.physics.swarm import Swarm
from bulletuav.physics.world import World

SUBSTEPS = 24  # a decision: 240 Hz physics, 10 Hz decisions


def _aviary(worlds: int, drones: int, dynamics: str, **options) -> bulletuav.Aviary:
    """Hover on a grid 2 m apart, 1 m up, all forces, decisions about velocity."""
    aviary = bulletuav.Aviary(
        "hover",
        worlds,
        num_drones=drones,
        dynamics=dynamics,
        action="velocity",
        decision_hz=240 // SUBSTEPS,
        horizon=10**9,
        height=1.0,
        spacing=2.0,
        max_distance=1e3,
        **options,
    )
    aviary.reset(seeds=0)
    return aviary


def flight(worlds: int, drones: int, dynamics: str, **options):
    """The whole step: controllers, all forces, engine, contacts, observation, reward."""
    aviary = _aviary(worlds, drones, dynamics, **options)
    return partial(aviary.step, np.zeros((worlds, drones, 3))), worlds * drones * SUBSTEPS


def reset(drones: int):
    """A reset of one world."""
    return partial(_aviary(1, drones, "bullet").reset, seeds=0), 1


def crossing(drones: int):
    """The PettingZoo environment, reset when an agent is done."""
    env = bulletuav.parallel_env("crossing", num_drones=drones, horizon=10**9)
    env.reset(seed=0)
    actions = {agent: np.zeros(3, dtype=np.float32) for agent in env.agents}

    def step() -> None:
        if len(env.agents) < drones:
            env.reset()
        env.step(actions)

    return step, drones * SUBSTEPS


def batched_crossing(worlds: int, drones: int):
    """The batched environment on the cheapest dynamics: agent-decisions, to compare with point masses."""
    env = bulletuav.batch_env("crossing", worlds, num_drones=drones, dynamics="single_integrator")
    env.reset(seed=0)
    return partial(env.step, np.zeros((worlds, drones, 3))), worlds * drones


def floor(worlds: int, drones: int):
    """The engine alone: step, a wrench and a state of every drone, in C, and nothing else."""
    world = World([load_airframe("cf2x")] * drones, worlds, 1 / 240)
    if world.port is None:
        raise RuntimeError("needs the C extension: see `bulletuav doctor`")
    swarm, calls = Swarm.zeros(worlds, drones, 4), world._calls
    swarm.position[:] = [(2.0 * (i % 32), 2.0 * (i // 32), 1.0) for i in range(drones)]
    everyone = np.ones((worlds, drones), dtype=bool)
    swarm.velocity[:] = np.random.default_rng(0).normal(0, 0.01, swarm.velocity.shape)  # at rest the engine does less
    swarm.rates[:] = swarm.velocity
    world.set_states(swarm, everyone)
    omega, place, nothing = np.zeros((3, worlds, drones, 3))
    calls.read(everyone, place, swarm.quaternion, swarm.velocity, omega)

    def decision() -> None:
        for _ in range(SUBSTEPS):
            calls.apply(everyone, place, nothing, nothing)
            world.step()
            calls.read(everyone, place, swarm.quaternion, swarm.velocity, omega)

    return decision, worlds * drones * SUBSTEPS


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
