"""Speed of every dynamics, beside the floor that the engine's calls set.

The unit is drone-substeps per CPU-second.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bulletuav.dynamics import DYNAMICS
from bulletuav.engine.engine import Engine
from bulletuav.envs.aviary import Aviary
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import Swarm

SWARM_SIZES = (1, 10, 100, 1000)
"""Swarms that are measured"""
ROUNDS = 3
"""How often each case is measured"""
SUBSTEPS = 24
"""Substeps of a decision: physics at 240 Hz, decisions at 10 Hz"""
ENGINE_CASES = ("bare step", "engine calls")
"""Cases without any arithmetic of ours"""


class BenchmarkResult(NamedTuple):
    """Speed of one case.

    Attributes:
        name: Name of the dynamics, or one of `ENGINE_CASES`.
        num_drones: Size of the swarm, in one world.
        rate: Drone-substeps per CPU-second, median of the rounds.
        reset_ms: Time of a reset, ms; NaN for floors.
    """

    name: str
    num_drones: int
    rate: float
    reset_ms: float


def measure_speed(
    sizes: tuple[int, ...] = SWARM_SIZES,
    seconds: float = 0.3,
    progress: Callable[[], None] = lambda: None,
) -> list[BenchmarkResult]:
    """Measure all cases of all sizes.

    Args:
        sizes: Sizes of the swarm.
        seconds: CPU time of each measurement, s.
        progress: Called after every measurement.

    Returns:
        A result for each case and size.
    """
    results = []
    for num_drones in sizes:
        results += _measure_size(num_drones, seconds, progress)
    return results


def _measure_size(
    num_drones: int, seconds: float, progress: Callable[[], None]
) -> list[BenchmarkResult]:
    """Measure all cases of one size, interleaved over the rounds."""
    cases: dict[str, Callable[[], object]] = {}
    resets: dict[str, Callable[[], object]] = {}
    # A case is a function of one decision; resets are measured of dynamics alone.
    aviaries = {name: make_hovering_aviary(1, num_drones, name) for name in DYNAMICS}
    for name, aviary in aviaries.items():
        cases[name] = partial(aviary.step, np.zeros((1, num_drones, 3)))
        resets[name] = partial(aviary.reset, seeds=0)
    engine, of_engine = make_engine_cases(1, num_drones)
    cases |= of_engine
    rates: dict[str, list[float]] = {name: [] for name in cases}
    # Cases alternate, so that what slows the machine down meets all of them.
    for _ in range(ROUNDS):
        for name, case in cases.items():
            if name in resets:
                resets[name]()
            rates[name].append(num_drones * SUBSTEPS * _per_second(case, seconds))
            progress()
    results = []
    for name in cases:
        reset = 1e3 / _per_second(resets[name], seconds / 3) if name in resets else float("nan")
        rate = statistics.median(rates[name])
        results.append(BenchmarkResult(name=name, num_drones=num_drones, rate=rate, reset_ms=reset))
    engine.close()
    for aviary in aviaries.values():
        aviary.close()
    return results


def make_hovering_aviary(num_worlds: int, num_drones: int, dynamics: str, **options: Any) -> Aviary:
    """Make started worlds of drones that hover 2 m apart and 1 m up, with all forces.

    Args:
        num_worlds: How many worlds.
        num_drones: Drones in each.
        dynamics: Name of the dynamics.
        **options: Further options of `Aviary`.

    Returns:
        The worlds, after a first decision, of which each has `SUBSTEPS` substeps.
    """
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
    # The first decision compiles.
    aviary.step(np.zeros((num_worlds, num_drones, 3)))
    return aviary


def make_engine_cases(
    num_worlds: int, num_drones: int
) -> tuple[Engine, dict[str, Callable[[], None]]]:
    """Make the cases without any arithmetic of ours, one decision each.

    Args:
        num_worlds: How many worlds.
        num_drones: Drones in each.

    Returns:
        The engine, to be closed, and the cases by name: its step alone, and its step with a wrench
        and a state of every drone.
    """
    engine = Engine([load_airframe("cf2x")] * num_drones, num_worlds, 1 / 240)
    swarm = Swarm.zeros(num_worlds, num_drones, 4)
    swarm.position[:] = [(2.0 * (i % 32), 2.0 * (i // 32), 1.0) for i in range(num_drones)]
    # The engine does less for bodies at rest.
    shape = swarm.velocity.shape
    swarm.velocity[:] = np.random.default_rng(0).normal(0, 0.01, shape)
    swarm.rates[:] = swarm.velocity
    all_drones = np.ones((num_worlds, num_drones), dtype=bool)
    engine.set_states(swarm, all_drones)
    zeros = np.zeros((num_worlds, num_drones, 3))

    def bare() -> None:
        for _ in range(SUBSTEPS):
            engine.step()

    def calls() -> None:
        for _ in range(SUBSTEPS):
            engine.apply_wrenches(zeros, zeros, all_drones)
            engine.step()
            engine.read_states(swarm, all_drones)

    return engine, dict(zip(ENGINE_CASES, (bare, calls), strict=True))


def _per_second(case: Callable[[], object], seconds: float) -> float:
    """Count calls per CPU-second."""
    begin = time.process_time()
    calls = 0
    while (spent := time.process_time() - begin) < seconds:
        case()
        calls += 1
    return calls / spent
