"""Shared parts of the readers of flight logs: checks, time series and errors of predictions."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from bulletuav.geometry.quaternions import multiply_quaternions
from bulletuav.identification.errors import conjugate

FULL_PWM = 65535.0
"""Maximum motor command of a Crazyflie"""
MOTOR_PLACES = np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
"""Positions of the motors 1 to 4, in half arms: x forward, y left"""


class LogError(ValueError):
    """A flight log that cannot be used."""


def drop_copies(paths: Sequence[Path]) -> list[Path]:
    """Sort files by name, and drop those with the same bytes as an earlier one."""
    seen: set[bytes] = set()
    first = []
    for path in sorted(paths):
        digest = hashlib.sha256(path.read_bytes()).digest()
        if digest not in seen:
            first.append(path)
        seen.add(digest)
    return first


def pick_evenly(items: np.ndarray, count: int) -> np.ndarray:
    """Return at most `count` items, equally spaced."""
    if len(items) <= count:
        return items
    return np.asarray(items[np.linspace(0, len(items) - 1, count).round().astype(int)])


def require_finite_log(name: str, values: np.ndarray, columns: Sequence[str]) -> None:
    """Check that all numbers of a log are finite.

    Args:
        name: Name of the log, for the message.
        values: Table (rows, columns).
        columns: Names of the columns.

    Raises:
        LogError: If a number is not finite.
    """
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise LogError(
            f"{name}: {bad.sum()} numbers are not finite, the first in {columns[column]}, row {row}"
        )


def require_log_columns(name: str, has: Sequence[str], needed: Sequence[str]) -> None:
    """Check that a log has the columns that are needed.

    Raises:
        LogError: If a column is missing.
    """
    missing = [column for column in needed if column not in has]
    if missing:
        raise LogError(f"{name}: no column {', '.join(missing)}")


def require_rising_time(name: str, time: np.ndarray) -> None:
    """Check that the times of a log rise.

    Raises:
        LogError: If they do not rise, or there are fewer than two.
    """
    if len(time) < 2 or (np.diff(time) <= 0).any():
        raise LogError(f"{name}: times of {len(time)} rows do not rise")


def first_order_lag(values: np.ndarray, constant: float, dt: float) -> np.ndarray:
    """Filter series by a first-order lag that starts at rest.

    Args:
        values: Series (T, ...), first axis time.
        constant: Time constant, s; 0 for none.
        dt: Time between rows, s.

    Returns:
        The filtered series (T, ...).
    """
    if constant <= 0.0:
        return values
    keep = np.exp(-dt / constant)
    start = keep * values[:1]
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=start)[0])


def resample_columns(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate series (T, C) linearly at other times."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def find_gaps(time: np.ndarray, at: np.ndarray, longest: float) -> np.ndarray:
    """Return True for the times `at` between rows that are more than `longest` seconds apart."""
    after = np.searchsorted(time, at).clip(1, len(time) - 1)
    return np.asarray(time[after] - time[after - 1] > longest)


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return body-to-world matrices (T, 3, 3) of quaternions (T, 4), scalar last."""
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def compute_state_errors(
    predicted: np.ndarray, true: np.ndarray, is_shortest: bool = False
) -> np.ndarray:
    """Return errors of position (m), velocity (m/s), rotation (rad) and rates (rad/s), (..., 4).

    Args:
        predicted: Predicted states, (..., 13).
        true: Measured states, (..., 13).
        is_shortest: Whether angles are those of the shortest rotations, at most pi. Otherwise they
            depend on the signs of the quaternions, and are at most 2 pi.
    """
    turn = multiply_quaternions(conjugate(true[..., 3:7]), predicted[..., 3:7])
    scalar = np.abs(turn[..., 3]) if is_shortest else turn[..., 3]
    angle = 2.0 * np.arctan2(np.linalg.norm(turn[..., :3], axis=-1), scalar)
    return np.stack(
        [
            np.linalg.norm(predicted[..., :3] - true[..., :3], axis=-1),
            np.linalg.norm(predicted[..., 7:10] - true[..., 7:10], axis=-1),
            angle,
            np.linalg.norm(predicted[..., 10:] - true[..., 10:], axis=-1),
        ],
        axis=-1,
    )


def motor_moments(forces: np.ndarray, half_arm: float) -> np.ndarray:
    """Return roll and pitch moments (T, 2) of the upward forces (T, 4) of motors 1 to 4.

    Args:
        forces: Forces, N.
        half_arm: Distance of the motors from the body axes, m.
    """
    return half_arm * np.stack([forces @ MOTOR_PLACES[:, 1], -forces @ MOTOR_PLACES[:, 0]], axis=1)
