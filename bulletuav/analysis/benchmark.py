"""Speed: drone-substeps per CPU-second of every dynamics, beside the floor that the engine's calls set."""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bulletuav.dynamics import DYNAMICS
from bulletuav.engine.engine import Engine
from bulletuav.envs.aviary import Aviary
from bulletuav.vehicle.airframe import load_airframe
from bulletuav.vehicle.swarm import Swarm

SIZES = (1, 10, 100, 1000)
ROUNDS = 3
SUBSTEPS = 24  # a decision: 240 Hz physics, 10 Hz decisions
FLOORS = ("bare step", "engine calls")


class Result(NamedTuple):
    """Drone-substeps per CPU-second of `name` with `num_drones` in one world, median; reset in ms, NaN for floors."""

    name: str
    num_drones: int
    rate: float
    reset_ms: float


def measure(
    sizes: tuple[int, ...] = SIZES,
    seconds: float = 0.3,
    progress: Callable[[], None] = lambda: None,
) -> list[Result]:
    """All cases of all sizes, interleaved over `ROUNDS`; `progress` is called after every measurement."""
    results = []
    for num_drones in sizes:
        cases: dict[str, Callable[[], object]] = {}
        resets: dict[str, Callable[[], object]] = {}
        aviaries = {name: hovering(1, num_drones, name) for name in DYNAMICS}
        for name, aviary in aviaries.items():
            cases[name] = partial(aviary.step, np.zeros((1, num_drones, 3)))
            resets[name] = partial(aviary.reset, seeds=0)
        engine, of_engine = floors(1, num_drones)
        cases |= of_engine
        rates: dict[str, list[float]] = {name: [] for name in cases}
        for _ in range(ROUNDS):
            for name, case in cases.items():
                if name in resets:
                    resets[name]()
                rates[name].append(num_drones * SUBSTEPS * _per_second(case, seconds))
                progress()
        for name in cases:
            reset = 1e3 / _per_second(resets[name], seconds / 3) if name in resets else float("nan")
            results.append(Result(name, num_drones, statistics.median(rates[name]), reset))
        engine.close()
        for aviary in aviaries.values():
            aviary.close()
    return results


def hovering(num_worlds: int, num_drones: int, dynamics: str, **options: Any) -> Aviary:
    """Started worlds of drones that hover 2 m apart, 1 m up, with all forces and decisions of 24 substeps."""
    aviary = Aviary(
        "hover",
        num_worlds,
        num_drones=num_drones,
        dynamics=dynamics,
        action="velocity",
        decision_hz=240 // SUBSTEPS,
        horizon=10**9,
        height=1.0,
        max_distance=1000.0,
        **options,
    )
    aviary.reset(seeds=0)
    aviary.step(np.zeros((num_worlds, num_drones, 3)))  # compiles
    return aviary


def floors(num_worlds: int, num_drones: int) -> tuple[Engine, dict[str, Callable[[], None]]]:
    """A decision of the engine's step alone, and with a wrench and a state of every drone; no arithmetic of ours."""
    engine = Engine([load_airframe("cf2x")] * num_drones, num_worlds, 1 / 240)
    swarm = Swarm.zeros(num_worlds, num_drones, 4)
    swarm.position[:] = [(2.0 * (i % 32), 2.0 * (i // 32), 1.0) for i in range(num_drones)]
    swarm.velocity[:] = np.random.default_rng(0).normal(
        0, 0.01, swarm.velocity.shape
    )  # at rest the engine does less
    swarm.rates[:] = swarm.velocity
    everyone = np.ones((num_worlds, num_drones), dtype=bool)
    engine.set_states(swarm, everyone)
    nothing = np.zeros((num_worlds, num_drones, 3))

    def bare() -> None:
        for _ in range(SUBSTEPS):
            engine.step()

    def calls() -> None:
        for _ in range(SUBSTEPS):
            engine.apply_wrenches(nothing, nothing, everyone)
            engine.step()
            engine.read_states(swarm, everyone)

    return engine, dict(zip(FLOORS, (bare, calls), strict=True))


def _per_second(case: Callable[[], object], seconds: float) -> float:
    """Calls per CPU-second."""
    begin, calls = time.process_time(), 0
    while (spent := time.process_time() - begin) < seconds:
        case()
        calls += 1
    return calls / spent
