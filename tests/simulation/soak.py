"""Soaks: a million steps with resets, memory that stays flat, and no number that is not finite."""

import time

import numpy as np

import bulletuav

from .invariants import Resources, require, resident

CASES = {
    "bullet": {"task": "crossing", "dynamics": "bullet", "num_drones": 2},
    "rigid_body": {"task": "crossing", "dynamics": "rigid_body", "num_drones": 2},
    "city": {"task": "mec", "dynamics": "point_mass", "num_drones": 3, "area": 250.0},
}
GROWTH = 30.0
"""Most that memory may grow once a tenth was flown, MB"""


def soak(steps: int) -> int:
    """Fly steps of a world in each case; print and return 1 where memory grows."""
    failed = 0
    for name, options in CASES.items():
        before, begin = Resources.now(), time.perf_counter()
        start, end = _fly(dict(options), steps)
        grown, took = end - start, time.perf_counter() - begin
        after = Resources.now()
        flat = grown < GROWTH and after.clients == before.clients
        failed += not flat
        print(
            f"{name}: {steps} steps, {took:.0f} s, memory {start:.0f} to {end:.0f} MB", flush=True
        )
    return int(failed > 0)


def _fly(options: dict[str, object], steps: int, worlds: int = 10) -> tuple[float, float]:
    """Fly with random actions and resets; tell the memory after a tenth, and in the end, MB."""
    aviary = bulletuav.Aviary(options.pop("task"), worlds, horizon=200, **options)
    rng, start = np.random.default_rng(0), 0.0
    aviary.reset(seeds=0)
    for k in range(steps // worlds):
        shape = (worlds, *aviary.action.low.shape)
        step = aviary.step(rng.uniform(aviary.action.low, aviary.action.high, shape))
        finite = np.isfinite(step.observations).all() and np.isfinite(step.rewards).all()
        require(finite, f"step {k}: a number is not finite")
        over = ~aviary.alive.any(axis=1)
        if over.any():
            aviary.reset(over)
        if k == steps // worlds // 10:
            start = resident()
    aviary.close()
    return start, resident()
