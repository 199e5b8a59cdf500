"""Tracking errors (task 2) and onboard estimates (task 3) of NanoBench's flights of a trefoil.

The protocols are those of the repository of S. I. Ullah and J. Baca, NanoBench, arXiv 2603.09908
(2026). They score controllers and an estimator that flew on the drone: no model takes part.

A log is a table (T, 24) of the columns `ONBOARD_COLUMNS`. Its angles of motion capture are in rad,
those of the estimator in degrees, with pitch positive with the nose up.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bulletuav.reproduction.flight_series import LogError
from bulletuav.reproduction.nanobench_flights import NANOBENCH_DT

ONBOARD_COLUMNS = (
    *("t", "px", "py", "pz", "vx", "vy", "vz", "roll", "pitch", "yaw"),
    *(f"est_stateEstimate_{axis}" for axis in ("x", "y", "z", "vx", "vy", "vz")),
    *(f"att_stateEstimate_{angle}" for angle in ("roll", "pitch", "yaw")),
    *(f"sp_ctrltarget_{axis}" for axis in ("x", "y", "z", "yaw")),
    "motor_motor_m1",
)
MIN_MOTOR_COMMAND = 1000.0
"""Rows of task 3 have a larger command of the first motor, of 65535"""
MIN_TARGET_DISTANCE = 0.05
"""Task 2 begins and ends with a target that is further from the origin, m"""
SEGMENT = 1.0
"""Length of the path within which changes of position are compared, m"""
SEGMENT_STRIDE = 10
"""Rows between starts of segments"""
MAX_DELAY_ROWS = 100
"""Maximum delay between target and position"""
MIN_BEND = 1e-6
"""Minimum second difference of estimated positions that were received, m; files have 9 decimals"""
MAX_GAP_ROWS = 25
"""Maximum gap of a log; those of complete logs have up to 13 rows"""


def find_onboard_logs(folder: Path, names: Sequence[str]) -> list[Path]:
    """Find files of a clone of NanoBench by names with wildcards, sorted, with copies.

    Raises:
        LogError: If there are none.
    """
    paths = sorted(path for name in names for path in folder.glob(name))
    if not paths:
        raise LogError(f"{folder}: no {', '.join(names)}; is it a clone of NanoBench?")
    return paths


def drop_interpolated_rows(log: np.ndarray) -> np.ndarray:
    """End a flight where estimates are missing for more than `MAX_GAP_ROWS`.

    The files join the numbers before and after a gap by a straight line. The gaps of three fast
    flights last up to 23 s and end in misread packets, metres off.
    """
    bends = np.abs(np.diff(log[:, 10:13], n=2, axis=0)).max(axis=1)
    rows = np.concatenate([np.flatnonzero(bends > MIN_BEND), [len(bends)]]) + 1
    long = np.flatnonzero(np.diff(rows) > MAX_GAP_ROWS)
    return log[: rows[long[0]] + 1] if len(long) else log


def align_positions(estimated: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Move estimated positions (T, 3) rigidly, so that they are closest to the true ones.

    S. Umeyama, Least-squares estimation of transformation parameters between two point patterns,
    1991, equations 40 and 41 without scale.
    """
    centred = estimated - estimated.mean(axis=0)
    left, _, right = np.linalg.svd((true - true.mean(axis=0)).T @ centred)
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    aligned: np.ndarray = centred @ (left @ right).T + true.mean(axis=0)
    return aligned


def compute_estimate_errors(log: np.ndarray, is_same_unit: bool = False) -> list[float]:
    """Compute the errors of the onboard estimates of one flight.

    Args:
        log: Flight.
        is_same_unit: Whether angles are compared in the same unit and sense. Otherwise numbers in
            rad are subtracted from numbers in degrees, as in the published errors.

    Returns:
        Aligned position error, root mean square and mean, mm; mean error of the change of position
        within `SEGMENT` of path, mm; root mean squares of the errors of velocity, m/s, and of
        angles, degrees.

    Raises:
        LogError: If the drone flew less than a segment.
    """
    log = log[log[:, -1] > MIN_MOTOR_COMMAND]
    true, estimated = log[:, 1:10], log[:, 10:19]
    steps = np.linalg.norm(np.diff(true[:, :3], axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    starts = np.arange(0, len(steps), SEGMENT_STRIDE)
    starts = starts[path[starts] + SEGMENT <= path[-1]]
    if not len(starts):
        raise LogError(f"a flight of task 3 is shorter than {SEGMENT:g} m; fetch the data again")
    ends = np.searchsorted(path, path[starts] + SEGMENT)
    distances = compute_distances(align_positions(estimated[:, :3], true[:, :3]), true[:, :3])
    drift = estimated - true
    angles = drift[:, 6:]
    if is_same_unit:
        angles = estimated[:, 6:] * [1.0, -1.0, 1.0] - np.degrees(true[:, 6:])
    return [
        1e3 * root_mean_square(distances),
        1e3 * float(distances.mean()),
        1e3 * float(compute_distances(drift[ends, :3], drift[starts, :3]).mean()),
        root_mean_square(np.linalg.norm(drift[:, 3:6], axis=1)),
        root_mean_square(wrap_degrees(angles)),
    ]


def compute_tracking_errors(log: np.ndarray) -> list[float]:
    """Compute the errors of tracking of one flight.

    Returns:
        Distance from the target: root mean square, mean and maximum, m; root mean square of the
        error of velocity against differences of targets, m/s; mean error of heading, degrees; root
        mean square of the distance from an earlier target, m, and the delay at which it is least,
        s.

    Raises:
        LogError: If there is no target during twice the maximum delay.
    """
    away = np.flatnonzero(np.linalg.norm(log[:, 19:22], axis=1) > MIN_TARGET_DISTANCE)
    if len(away) < 2 * MAX_DELAY_ROWS:
        raise LogError(f"a flight of task 2 has {len(away)} rows with a target; fetch it again")
    log = log[away[0] : away[-1] + 1]
    position, target = log[:, 1:4], log[:, 19:22]
    distances = compute_distances(position, target)
    desired = np.diff(target, axis=0) / np.diff(log[:, :1], axis=0)
    delayed = [
        root_mean_square(compute_distances(position[k:], target[: len(target) - k]))
        for k in range(MAX_DELAY_ROWS + 1)
    ]
    return [
        root_mean_square(distances),
        float(distances.mean()),
        float(distances.max()),
        root_mean_square(compute_distances(log[:-1, 4:7], desired)),
        float(np.abs(wrap_degrees(np.degrees(log[:, 9] - log[:, 22]))).mean()),
        min(delayed),
        NANOBENCH_DT * delayed.index(min(delayed)),
    ]


def compute_distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the distances (T,) of points (T, 3)."""
    return np.asarray(np.linalg.norm(one - other, axis=1))


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def wrap_degrees(angles: np.ndarray) -> np.ndarray:
    """Return angles from -180 to below 180 degrees."""
    return np.asarray((angles + 180.0) % 360.0 - 180.0)
