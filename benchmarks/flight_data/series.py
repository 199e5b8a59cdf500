"""What the readers of flight logs share: checks, time series, splits."""

import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

FULL_PWM = 65535.0
"""Greatest motor command of a Crazyflie"""
SPINS = np.array([-1.0, 1.0, -1.0, 1.0])
"""Yaw torque of the Crazyflie's motors 1 to 4, for each N m of drag torque"""
PLACES = np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
"""Places of the motors 1 to 4, in half arms: x forward, y left"""

Item = TypeVar("Item")


class LogError(ValueError):
    """A flight log that cannot be used, and why."""


def split(names: Sequence[Item]) -> tuple[list[Item], list[Item]]:
    """Split into what laws are fitted to and what is kept back: first, third, ...; the rest."""
    return list(names[::2]), list(names[1::2])


def without_copies(paths: Sequence[Path]) -> list[Path]:
    """Return the files, sorted by name, without those whose bytes an earlier one has."""
    seen: set[bytes] = set()
    first = []
    for path in sorted(paths):
        digest = hashlib.sha256(path.read_bytes()).digest()
        if digest not in seen:
            first.append(path)
        seen.add(digest)
    return first


def require_finite(name: str, values: np.ndarray, columns: Sequence[str]) -> None:
    """Check a table (rows, columns).

    Raises:
        LogError: A number of it is not finite.
    """
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise LogError(
            f"{name}: {bad.sum()} numbers are not finite, the first in {columns[column]}, row {row}"
        )


def require_columns(name: str, has: Sequence[str], needed: Sequence[str]) -> None:
    """Check that a log has what is needed.

    Raises:
        LogError: A column is missing.
    """
    missing = [column for column in needed if column not in has]
    if missing:
        raise LogError(f"{name}: no column {', '.join(missing)}")


def require_rising(name: str, time: np.ndarray) -> None:
    """Check the times of a log.

    Raises:
        LogError: They do not rise, or there are less than two.
    """
    if len(time) < 2 or (np.diff(time) <= 0).any():
        raise LogError(f"{name}: times of {len(time)} rows do not rise")


def first_order_lag(values: np.ndarray, constant: float, dt: float) -> np.ndarray:
    """Filter series (T, ...) by a first-order lag that starts at rest.

    Args:
        values: The series, first axis time.
        constant: Time constant, s; 0 for none.
        dt: Time between rows, s.
    """
    if constant <= 0.0:
        return values
    keep = np.exp(-dt / constant)
    start = keep * values[:1]
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=start)[0])


def resample(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate series (T, C) linearly, column by column."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def in_gap(time: np.ndarray, at: np.ndarray, longest: float) -> np.ndarray:
    """Return which of the times `at` lie between rows more than `longest` seconds apart."""
    after = np.searchsorted(time, at).clip(1, len(time) - 1)
    return np.asarray(time[after] - time[after - 1] > longest)


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Return body-to-world matrices (T, 3, 3) of quaternions (T, 4), scalar last."""
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def moments(forces: np.ndarray, half_arm: float) -> np.ndarray:
    """Return roll and pitch moments (T, 2) of upward forces (T, 4) of motors 1 to 4."""
    return half_arm * np.stack([forces @ PLACES[:, 1], -forces @ PLACES[:, 0]], axis=1)


def binned(
    along: np.ndarray, edges: Sequence[float], columns: Mapping[str, np.ndarray], fewest: int
) -> list[dict[str, float]]:
    """Return means of columns in bins of one of them, and how many rows a bin has.

    Args:
        along: What the bins are of (T,).
        edges: Edges of the bins.
        columns: Columns (T,) by name.
        fewest: Least rows of a bin.
    """
    rows = []
    for low, high in pairwise(edges):
        its = (along >= low) & (along < high)
        if its.sum() >= fewest:
            means = {name: float(values[its].mean()) for name, values in columns.items()}
            rows.append({**means, "count": int(its.sum())})
    return rows


def binned_error(
    measured: Sequence[Mapping[str, float]], told: Sequence[Mapping[str, float]], name: str
) -> float:
    """Return the RMS difference of one column of the same bins."""
    apart = [row[name] - law[name] for row, law in zip(measured, told, strict=True)]
    return float(rms(np.array(apart)))


def rms(values: np.ndarray) -> np.ndarray:
    """Return the root of the mean square along the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def commit(folder: Path) -> str:
    """Return the commit of a clone, "unknown" where git does not tell."""
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return told.stdout.strip() if told.returncode == 0 else "unknown"
