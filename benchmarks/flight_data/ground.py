"""Ground effect: by how much the thrust of a Crazyflie grows near the ground (Neural-Swarm)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flight_data.neural_swarm import load, training
from flight_data.series import LogError, binned, binned_error, rms

FOLDERS = (
    "takeoff_s",
    "takeoff_landing_small",
    "randomwalk_s",
    "randomwalk_s_1",
    "randomwalk_s_2",
    "random_walk_small_ground",
)
"""Experiments with one unmodified Crazyflie near the ground"""
BELOW = 0.03
"""Height of the ground in the logs less that of the centre of mass of a drone at rest, m.

Drones at rest are logged at 0.05 m; their centre of mass is taken as 0.02 m above the ground.
"""
HEIGHTS = (0.025, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15, 0.2)
"""Edges of bins, m; below the first, legs touch the ground"""
FREE = 0.17
"""Height from which the ground is not felt, m"""
LEAST_THRUST = 24.0
"""Least thrust of a drone that flies, grams"""


def logs(folder: Path) -> list[Path]:
    """Return the logs of a clone, sorted.

    Raises:
        LogError: There are none.
    """
    found = [
        path for name in FOLDERS for path in training(folder).glob(f"*/{name}/cf5[0-9]_[0-9][0-9]")
    ]
    if not found:
        raise LogError(f"{training(folder)}: no logs near the ground")
    return sorted(found)


def samples(
    paths: Sequence[Path], force_rows: int | None = None, with_touches: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Read logs: heights of the centre of mass, m, and shares by which thrust grows.

    Args:
        paths: The logs.
        force_rows: Rows over which the accelerometer is averaged; None for those of the reader.
        with_touches: Whether samples near a touch of the ground are kept.
    """
    heights, shares = [], []
    averaging = {} if force_rows is None else {"force_rows": force_rows}
    for path in paths:
        log = load(path, **averaging)
        height, lift = log.position[:, 2] - BELOW, log.lift()
        flying = ~log.gap & (log.thrust.sum(axis=1) > LEAST_THRUST)
        mass = np.median((lift / log.load)[flying & (height > FREE)])
        # Jolts of a touch, and what is within a tenth of a second of them, are left out.
        jolt = np.abs(np.gradient(log.load)) > 0.06
        touched = np.convolve(jolt, np.ones(21), "same") > 0
        its = flying & (height > HEIGHTS[0]) & (height < HEIGHTS[-1])
        if not with_touches:
            its &= ~touched
        heights.append(height[its])
        shares.append((mass * log.load / lift - 1.0)[its])
    return np.concatenate(heights), np.concatenate(shares)


def bins(height: np.ndarray, share: np.ndarray) -> list[dict[str, float]]:
    """Return bins of height: mean height, m, mean share, count."""
    return binned(height, HEIGHTS, {"height": height, "share": share}, fewest=1)


def errors(height: np.ndarray, share: np.ndarray, told: np.ndarray) -> list[float]:
    """Return RMS errors of a law, % of thrust: of samples, of bins."""
    apart = binned_error(bins(height, share), bins(height, told), "share")
    return [100.0 * float(rms(share - told)), 100.0 * apart]
