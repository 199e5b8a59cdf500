"""Benchmark of the simulation speed of each dynamics, with the engine alone as baseline.

The unit is drone-substeps per CPU-second.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bulletuav.dynamics import DYNAMICS
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.engine.engine import Engine
from bulletuav.envs.aviary import Aviary
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import Swarm

SWARM_SIZES = (1, 10, 100, 1000)
"""Numbers of drones that are measured"""
ROUNDS = 3
"""Number of measurements of each case"""
SUBSTEPS = 24
"""Substeps of a decision: physics at 240 Hz, decisions at 10 Hz"""
ENGINE_CASES = ("bare step", "engine calls")
"""Baseline cases, which call only the physics engine"""
MEASURED = (
    (*DYNAMICS, *ENGINE_CASES) if HAS_BULLET else tuple(one for one in DYNAMICS if one != "bullet")
)
"""Names of all cases that are possible here"""


class BenchmarkResult(NamedTuple):
    """Speed of one case.

    Attributes:
        name: Name of the dynamics, or one of `ENGINE_CASES`.
        num_drones: Number of drones, in one world.
        rate: Drone-substeps per CPU-second, median of the rounds.
        reset_ms: Duration of a reset, ms; NaN for engine cases.
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
    """Measure the speed of all cases for all swarm sizes.

    Args:
        sizes: Numbers of drones.
        seconds: CPU time of each measurement, s.
        progress: Callback after every measurement.

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
    # A case is a function that steps one decision. Engine cases have no reset.
    names = [name for name in MEASURED if name in DYNAMICS]
    aviaries = {name: make_hovering_aviary(1, num_drones, name) for name in names}
    made: list[Aviary | Engine] = list(aviaries.values())
    for name, aviary in aviaries.items():
        cases[name] = partial(aviary.step, np.zeros((1, num_drones, 3)))
        resets[name] = partial(aviary.reset, seeds=0)
    if HAS_BULLET:
        engine, of_engine = make_engine_cases(1, num_drones)
        made.append(engine)
        cases |= of_engine
    rates: dict[str, list[float]] = {name: [] for name in cases}
    # Cases alternate, so that disturbances of the machine affect all of them.
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
    for one in made:
        one.close()
    return results


def make_hovering_aviary(num_worlds: int, num_drones: int, dynamics: str, **options: Any) -> Aviary:
    """Create worlds of drones that hover 2 m apart at a height of 1 m, with all forces enabled.

    Args:
        num_worlds: Number of worlds.
        num_drones: Number of drones in each world.
        dynamics: Name of the dynamics.
        **options: Further options of `Aviary`.

    Returns:
        The environment, after a first decision of `SUBSTEPS` substeps, which compiles the kernels.
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
    # The first decision compiles the kernels.
    aviary.step(np.zeros((num_worlds, num_drones, 3)))
    return aviary


def make_engine_cases(
    num_worlds: int, num_drones: int
) -> tuple[Engine, dict[str, Callable[[], None]]]:
    """Create the baseline cases, which call only the physics engine, for one decision each.

    Args:
        num_worlds: Number of worlds.
        num_drones: Number of drones in each world.

    Returns:
        The engine, which the caller must close, and the cases by name: engine steps alone, and
        engine steps that also apply a wrench to each drone and read its state.
    """
    engine = Engine([load_airframe("cf2x")] * num_drones, num_worlds, 1 / 240)
    swarm = Swarm.zeros(num_worlds, num_drones, 4)
    swarm.position[:] = [(2.0 * (i % 32), 2.0 * (i // 32), 1.0) for i in range(num_drones)]
    # Moving bodies: the engine skips work for bodies at rest.
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
    """Measure the calls of a function per CPU-second."""
    begin = time.process_time()
    calls = 0
    while (spent := time.process_time() - begin) < seconds:
        case()
        calls += 1
    return calls / spent
