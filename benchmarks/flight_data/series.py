"""What the readers of flight logs share: the package's parts, and splits."""

import subprocess
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from bulletuav.reproduction.flight_series import FULL_PWM, LogError, first_order_lag
from bulletuav.reproduction.flight_series import drop_copies as without_copies
from bulletuav.reproduction.flight_series import find_gaps as in_gap
from bulletuav.reproduction.flight_series import motor_moments as moments
from bulletuav.reproduction.flight_series import require_finite_log as require_finite
from bulletuav.reproduction.flight_series import require_log_columns as require_columns
from bulletuav.reproduction.flight_series import require_rising_time as require_rising
from bulletuav.reproduction.flight_series import resample_columns as resample
from bulletuav.reproduction.flight_series import rotation_matrices as rotations

SPINS = np.array([-1.0, 1.0, -1.0, 1.0])
"""Yaw torque of the Crazyflie's motors 1 to 4, for each N m of drag torque"""

__all__ = [
    "FULL_PWM",
    "SPINS",
    "LogError",
    "binned",
    "binned_error",
    "commit",
    "first_order_lag",
    "in_gap",
    "moments",
    "require_columns",
    "require_finite",
    "require_rising",
    "resample",
    "rms",
    "rotations",
    "split",
    "without_copies",
]

Item = TypeVar("Item")


def split(names: Sequence[Item]) -> tuple[list[Item], list[Item]]:
    """Split into what laws are fitted to and what is kept back: first, third, ...; the rest."""
    return list(names[::2]), list(names[1::2])


def binned(
    along: np.ndarray, edges: Sequence[float], columns: Mapping[str, np.ndarray], fewest: int
) -> list[dict[str, float]]:
    """Return the means of columns in bins of one quantity, and the number of rows of each bin.

    Args:
        along: Quantity (T,) that is binned.
        edges: Edges of the bins.
        columns: Columns (T,) by name.
        fewest: Minimum number of rows of a bin.
    """
    rows = []
    for low, high in pairwise(edges):
        its = (along >= low) & (along < high)
        if its.sum() >= fewest:
            means = {name: float(values[its].mean()) for name, values in columns.items()}
            rows.append({**means, "count": int(its.sum())})
    return rows


def rms(values: np.ndarray) -> np.ndarray:
    """Return the root of the mean square along the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def binned_error(
    measured: Sequence[Mapping[str, float]], told: Sequence[Mapping[str, float]], name: str
) -> float:
    """Return the RMS difference of one column of the same bins."""
    apart = [row[name] - law[name] for row, law in zip(measured, told, strict=True)]
    return float(rms(np.array(apart)))


def commit(folder: Path) -> str:
    """Return the commit of a clone, "unknown" where git does not tell."""
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return told.stdout.strip() if told.returncode == 0 else "unknown"
