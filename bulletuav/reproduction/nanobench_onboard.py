"""Onboard estimates (task 3) and tracking errors (task 2) of NanoBench's trefoil flights.

The protocols are those of the repository of S. I. Ullah and J. Baca, NanoBench, arXiv 2603.09908
(2026). They score an estimator and controllers that flew on the drone: no model takes part.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bulletuav.reproduction.flight_series import LogError, drop_copies
from bulletuav.reproduction.nanobench_flights import NANOBENCH_DT, read_nanobench_columns

SPEEDS = ("slow", "medium", "fast")
CONTROLLERS = ("PID", "Mellinger")
REPETITIONS = {
    ("PID", "slow"): range(13, 19),
    ("PID", "medium"): range(12, 17),
    ("PID", "fast"): range(14, 16),
    ("Mellinger", "slow"): range(8, 13),
    ("Mellinger", "medium"): range(7, 12),
    ("Mellinger", "fast"): range(9, 14),
}
"""Repetitions of the trefoil flown by each controller, by their published errors: the data name
controllers only in the folders of task 3, whose files are parts of the same flights
"""
ONBOARD_COLUMNS = (
    *("t", "px", "py", "pz", "vx", "vy", "vz", "roll", "pitch", "yaw"),
    *(f"est_stateEstimate_{axis}" for axis in ("x", "y", "z", "vx", "vy", "vz")),
    *(f"att_stateEstimate_{angle}" for angle in ("roll", "pitch", "yaw")),
    *(f"sp_ctrltarget_{axis}" for axis in ("x", "y", "z", "yaw")),
    "motor_motor_m1",
)
"""Columns that are read, in the order of the table"""
MIN_MOTOR_COMMAND = 1000.0
"""Rows of task 3 have a larger command of the first motor, of 65535"""
MIN_TARGET_DISTANCE = 0.05
"""Task 2 begins and ends with a target that is further from the origin, m"""
SEGMENT = 1.0
"""Length of the path within which changes of position are compared, m"""
SEGMENT_STRIDE = 10
"""Rows between starts of segments"""
MAX_TRACKING_ERROR = 1.0
"""RMSE of position, m: the published numbers leave out flights with a larger one"""
MAX_DELAY = 1.0
"""Maximum delay between target and position, s"""
MIN_BEND = 1e-6
"""Minimum second difference of estimated positions that were received, m; files have 9 decimals"""
MAX_GAP = 0.25
"""Maximum duration of a gap, s"""


@dataclass(frozen=True)
class OnboardLog:
    """Motion capture, onboard estimates and targets of one flight; the first axis is time.

    Attributes:
        time: (T,) s.
        position: (T, 3) motion capture, world, m.
        velocity: (T, 3) motion capture, world, m/s.
        angles: (T, 3) motion capture: roll, pitch, yaw in rad.
        estimated_position: (T, 3) m.
        estimated_velocity: (T, 3) m/s.
        estimated_angles: (T, 3) roll, pitch, yaw in degrees, pitch positive with the nose up.
        target: (T, 4) position in m, and yaw.
        command: (T,) command of the first motor.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    angles: np.ndarray
    estimated_position: np.ndarray
    estimated_velocity: np.ndarray
    estimated_angles: np.ndarray
    target: np.ndarray
    command: np.ndarray

    def select(self, rows: np.ndarray | slice) -> "OnboardLog":
        """Return the log of some rows."""
        return OnboardLog(**{name: values[rows] for name, values in vars(self).items()})


def read_onboard_log(path: Path) -> OnboardLog:
    """Read one flight.

    Raises:
        LogError: If columns or numbers are missing, or times do not rise.
    """
    table = read_nanobench_columns(path, ONBOARD_COLUMNS)
    time, *series, command = np.split(table, [1, 4, 7, 10, 13, 16, 19, 23], axis=1)
    return OnboardLog(time[:, 0], *series, command[:, 0])


def find_estimator_logs(folder: Path, speed: str) -> list[Path]:
    """Return the files of task 3 at one speed, with copies.

    Raises:
        LogError: If there are none.
    """
    task = folder / "benchmarks" / "task3_stateEst"
    paths = sorted(task.glob(f"*_trefoil/B9_trefoil_{speed}_rep*.csv"))
    if not paths:
        raise LogError(f"{task}: no {speed} flights; is it a clone of NanoBench?")
    return paths


def find_tracking_logs(folder: Path, controller: str, speed: str) -> list[Path]:
    """Return the files of task 2 of one controller at one speed, sorted, without copies.

    Raises:
        LogError: If there are none.
    """
    data = folder / "datasets" / "dataset"
    names = (f"B9_trefoil_{speed}_rep{k}.csv" for k in REPETITIONS[controller, speed])
    paths = [data / name for name in names if (data / name).is_file()]
    if not paths:
        raise LogError(f"{data}: no {speed} flights of {controller}; is it a clone of NanoBench?")
    return drop_copies(paths)


def drop_interpolated_rows(log: OnboardLog) -> OnboardLog:
    """End a flight where packets of its estimates are missing for `MAX_GAP` seconds.

    The files join the numbers before and after a gap by a straight line. The gaps of three fast
    flights last up to 23 s and end in misread packets, metres off.
    """
    bends = np.abs(np.diff(log.estimated_position, n=2, axis=0)).max(axis=1)
    rows = np.concatenate([np.flatnonzero(bends > MIN_BEND), [len(bends)]]) + 1
    long = np.flatnonzero(np.diff(rows) > MAX_GAP / NANOBENCH_DT)
    return log.select(slice(rows[long[0]] + 1)) if len(long) else log


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


def compute_estimate_errors(log: OnboardLog, is_same_unit: bool = False) -> np.ndarray:
    """Compute the errors of the onboard estimates of one flight.

    Args:
        log: Flight.
        is_same_unit: Whether angles are compared in degrees, pitch positive with the nose down.
            Otherwise estimates in degrees are compared with numbers in rad, as published.

    Returns:
        Aligned position error, root mean square and mean, mm; mean error of the change of position
        within `SEGMENT` of path, mm; root mean squares of the errors of velocity, m/s, and of
        angles, degrees.

    Raises:
        LogError: If the drone flew less than a segment.
    """
    flown = log.select(log.command > MIN_MOTOR_COMMAND)
    steps = np.linalg.norm(np.diff(flown.position, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    starts = np.arange(0, len(steps), SEGMENT_STRIDE)
    starts = starts[path[starts] + SEGMENT <= path[-1]]
    if not len(starts):
        raise LogError(f"a flight of task 3 is shorter than {SEGMENT:g} m; fetch the data again")
    ends = np.searchsorted(path, path[starts] + SEGMENT)
    aligned = align_positions(flown.estimated_position, flown.position)
    distances = np.linalg.norm(aligned - flown.position, axis=1)
    drift = flown.estimated_position - flown.position
    angles = flown.estimated_angles - flown.angles
    if is_same_unit:
        angles = flown.estimated_angles * [1.0, -1.0, 1.0] - np.degrees(flown.angles)
    return np.array(
        [
            1e3 * root_mean_square(distances),
            1e3 * distances.mean(),
            1e3 * np.linalg.norm(drift[ends] - drift[starts], axis=1).mean(),
            root_mean_square(np.linalg.norm(flown.estimated_velocity - flown.velocity, axis=1)),
            root_mean_square(wrap_degrees(angles)),
        ]
    )


def compute_tracking_errors(log: OnboardLog) -> np.ndarray:
    """Compute the errors of tracking of one flight.

    Returns:
        Distance from the target: root mean square, mean and maximum, m; root mean square of the
        error of velocity against differences of targets, m/s; mean error of heading, degrees; root
        mean square of the distance from an earlier target, m, and the delay at which it is least,
        s.

    Raises:
        LogError: If there is no target, or it is shorter than twice the maximum delay.
    """
    away = np.flatnonzero(np.linalg.norm(log.target[:, :3], axis=1) > MIN_TARGET_DISTANCE)
    longest = round(MAX_DELAY / NANOBENCH_DT)
    if len(away) < 2 * longest:
        raise LogError(f"a flight of task 2 has {len(away)} rows with a target; fetch it again")
    flown = log.select(slice(away[0], away[-1] + 1))
    target, position = flown.target[:, :3], flown.position
    distances = np.linalg.norm(position - target, axis=1)
    desired = np.diff(target, axis=0) / np.diff(flown.time)[:, None]
    headings = wrap_degrees(np.degrees(flown.angles[:, 2] - flown.target[:, 3]))
    delayed = [
        root_mean_square(np.linalg.norm(position[k:] - target[: len(target) - k], axis=1))
        for k in range(longest + 1)
    ]
    return np.array(
        [
            root_mean_square(distances),
            distances.mean(),
            distances.max(),
            root_mean_square(np.linalg.norm(flown.velocity[:-1] - desired, axis=1)),
            np.abs(headings).mean(),
            min(delayed),
            NANOBENCH_DT * int(np.argmin(delayed)),
        ]
    )


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def wrap_degrees(angles: np.ndarray) -> np.ndarray:
    """Return angles from -180 to below 180 degrees."""
    wrapped: np.ndarray = (angles + 180.0) % 360.0 - 180.0
    return wrapped


def keep_tracked(errors: Sequence[np.ndarray]) -> np.ndarray:
    """Keep the tracking errors (F, 7) of flights that the published numbers have.

    Raises:
        LogError: If there are none.
    """
    kept = [one for one in errors if one[0] <= MAX_TRACKING_ERROR]
    if not kept:
        raise LogError(f"all flights of a controller are more than {MAX_TRACKING_ERROR:g} m off")
    return np.stack(kept)
