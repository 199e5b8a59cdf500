"""Flights of bulletuav with its forces, or with those of its first model, for forces.py.

    serve_forces.py now|laws|first FOLDER

"laws" has the forces of the first model, "first" also a controller that need not make up for the
torque of drag. Their compiled kernels are kept in FOLDER, away from those of the package. The rate
is in drone-substeps: controllers, forces and contacts, without Python around them.
"""

import dataclasses
import os
import sys
from functools import partial
from pathlib import Path

WHICH, FOLDER = sys.argv[1:]
if WHICH != "now":
    # Read when the package is imported
    os.environ["NUMBA_CACHE_DIR"] = str(Path(FOLDER, "kernels").resolve())

import numpy as np  # noqa: E402
from serve import SUBSTEPS, grid, serve  # noqa: E402

import bulletuav  # noqa: E402
from bulletuav.compiled.program import run_calls  # noqa: E402
from bulletuav.vehicle.airframes import load_airframe  # noqa: E402

SWAY = np.array([0.0, 0.0, 0.01])
"""Way up and down, m: bodies that stand quite still cost Bullet less than any in flight"""
SETTLING = 50
"""Decisions before it is measured"""
NEAR, BELOW = 0.08, 0.4
"""Height near the ground, and distance of two drones above each other, m"""


def places(drones: int, how: str) -> np.ndarray:
    """Place drones (N, 3): "apart", "near the ground", or in pairs "above each other"."""
    if how == "above each other":
        lower = np.array(grid(drones // 2))
        return np.concatenate([lower, lower + np.array([0.0, 0.0, BELOW])])
    return np.array(grid(drones)) * (1.0, 1.0, NEAR if how == "near the ground" else 1.0)


def flight(dynamics: str, worlds: int, drones: int, how: str):
    """Let drones sway about their places, under the Lee controller."""
    airframe, options = load_airframe("cf2x"), {}
    if WHICH != "now":
        options["effects"] = first_forces.EFFECTS
    if WHICH == "first":
        airframe = dataclasses.replace(airframe, drag_height=0.0)
    goal = places(drones, how)
    aviary = bulletuav.Aviary(
        "hover",
        worlds,
        num_drones=drones,
        airframe=airframe,
        dynamics=dynamics,
        action="target_position",
        decision_hz=240 // SUBSTEPS,
        horizon=10**9,
        start=goal,
        goal=goal,
        **options,
    )
    aviary.reset(seeds=0)
    there, back = (
        np.broadcast_to(aviary.action.encode(goal + way), (worlds, drones, 3))
        for way in (SWAY, -SWAY)
    )
    for _ in range(SETTLING):
        aviary.step(there)
        aviary.step(back)
    assert aviary.alive.all()
    # What comes before the flight in a decision takes next to nothing
    calls = aviary.program.table[: aviary.program.names.index("advance_rigid_body") + 1].copy()

    def fly() -> None:
        for action in (there, back):
            aviary.given[:] = action
            run_calls(calls, 0)

    return fly, 2 * worlds * drones * SUBSTEPS


if WHICH != "now":
    import first_forces

    first_forces.install()
serve(
    {
        f"{dynamics}, {worlds} x {drones}, {how}": partial(flight, dynamics, worlds, drones, how)
        for dynamics in ("rigid_body", "bullet")
        for worlds, drones in ((1, 1), (1, 10), (64, 8))
        for how in ("apart", "near the ground", "above each other")
        if drones > 1 or how != "above each other"
    }
)
