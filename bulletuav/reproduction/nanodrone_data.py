"""Flights of the nano-drone identification benchmark of IDSIA, processed as its authors did.

The flights are those of a Crazyflie 2.1 Brushless in a motion capture system, at 100 Hz. The
squares are read as the authors processed them. Of the other training flights, the commit holds the
recordings only, and of the held-out ones recordings and aligned flights without the filters.
`process_recording` repeats the processing of both: spikes of the motor speeds are removed, motors
are aligned with the acceleration, the flight is aligned with a simulated one, whose mean replaces
the mean of every state (also of velocities, rates and quaternions), and all signals pass low-pass
filters without phase, which look ahead.

References:
    R. Busetto et al., Nonlinear system identification for a nano-drone benchmark, Control
    Engineering Practice 172, 2026, arXiv 2512.14450.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, correlate, sosfiltfilt
from scipy.spatial.transform import Rotation

from bulletuav.errors import require_file
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.identification.errors import conjugate

SAMPLE_RATE = 100.0
"""Rate of the samples, Hz"""
ERPM = 2.0 * math.pi / 360.0
"""One electrical revolution a minute of a motor with 6 pole pairs, rad/s"""
RECORDINGS, PROCESSED = Path("data/real/raw/parquets"), Path("data/real/processed/train")
"""Folders of recordings and of processed flights in the repository"""
SIMULATED = {
    name: Path("data/sim") / f"{flight}_20251017.parquet"
    for name, flight in (("melon", "melon"), ("multisine", "chirp"), ("random2", "random"))
}
"""Simulated flights with which recordings are aligned, by the name that recordings begin with"""
TRAINING = {
    "square": tuple(f"square_20251017_run{k}.csv" for k in (1, 2, 3, 4)),
    "chirp": tuple(f"multisine_20251017_run{k}.parquet" for k in (1, 2, 3, 4)),
    "random": tuple(f"random2_20251017_run{k}.parquet" for k in (1, 2, 3, 4)),
}
"""Files of the training flights by trajectory"""
HELD_OUT = tuple(f"melon_20251017_run{k}.parquet" for k in (1, 4, 5))
"""Files of the held-out trajectory: runs 1, 2 and 3 of the benchmark"""
POSITIONS = ("x", "y", "z")
QUATERNIONS = ("qx", "qy", "qz", "qw")
VELOCITIES = ("vx", "vy", "vz")
RATES_BODY = ("wx", "wy", "wz")
ACCELERATIONS = ("ax", "ay", "az")
MAX_ERPM, MAX_ERPM_JUMP = 3e5, 1e5
"""Speeds and changes between samples beyond which a motor's reading is a spike, 1/min electrical"""
SMALL_ANGLE = 1e-6
"""Constant of the processing that avoids divisions by zero"""
FILTER_ORDER = 4
CUTOFFS = {"position": 10.0, "velocity": 18.0, "attitude": 12.0, "rates": 18.0, "speed": 20.0}
"""Cut-off frequencies of the filters, Hz"""
MIN_SAMPLES = 100
"""Minimum number of samples of a flight: the longest prediction, and margins of the filters"""
MAX_GAPS = 0.1
"""Maximum fraction of a column that is filled in; the benchmark's files need 0.006"""
MIN_QUATERNION = 0.5
"""Minimum length of a recorded quaternion"""

REMEDY = "fetch the commit that the table names"
"""What to do about files that are missing or damaged"""


@dataclass(frozen=True)
class NanodroneFlight:
    """One flight, at 100 Hz.

    Attributes:
        name: Name of the file.
        state: Position (world, m), quaternion (body to world), velocity (world, m/s) and body
            rates (rad/s), (n, 13).
        speed: Measured rotor speeds, (n, 4), rad/s.
    """

    name: str
    state: np.ndarray
    speed: np.ndarray


def read_nanodrone_flight(folder: Path, name: str) -> NanodroneFlight:
    """Read one flight.

    Args:
        folder: Folder of the repository.
        name: Name of the file: a processed flight (.csv) or a recording (.parquet).

    Returns:
        The flight. Its last sample is left out, as in the benchmark.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file is damaged, or lacks columns.
        ImportError: If the extra `dataset` is missing, which recordings need.
    """
    is_processed = name.endswith(".csv")
    path = folder / (PROCESSED if is_processed else RECORDINGS) / name
    require_file("a flight of the benchmark", path, REMEDY)
    if is_processed:
        columns = _read_csv(path)
        motors = _stack(columns, [f"m{k}_rads" for k in (1, 2, 3, 4)], path)
        flight = NanodroneFlight(name, _read_state(columns, path), motors)
    else:
        simulated = folder / SIMULATED[name.partition("_")[0]]
        require_file("a simulated flight of the benchmark", simulated, REMEDY)
        columns, reference = _read_parquet(path), _read_parquet(simulated)
        flight = process_recording(columns, path, reference, simulated)
    flight.state[:, 3:7] /= np.linalg.norm(flight.state[:, 3:7], axis=1, keepdims=True)
    return NanodroneFlight(name, flight.state[:-1], flight.speed[:-1])


def process_recording(
    columns: dict[str, np.ndarray], path: Path, simulated: dict[str, np.ndarray], source: Path
) -> NanodroneFlight:
    """Process a recording as the benchmark's authors did.

    Args:
        columns: Columns of the recording.
        path: Its file, for messages.
        simulated: Columns of the simulated flight.
        source: Its file.

    Returns:
        The flight.

    Raises:
        ValueError: If columns are missing, damaged or constant, or the flights do not overlap.
    """
    state = _read_state(columns, path)
    acceleration = _stack(columns, ACCELERATIONS, path)
    erpm = _stack(columns, [f"m{k}_erpm" for k in (1, 2, 3, 4)], path)
    speed = ERPM * remove_speed_spikes(erpm, path)
    body = rotate_vectors(conjugate(state[:, 3:7]), acceleration)
    speed = align_speeds(speed, body[:, 2])
    reference = _read_state(simulated, source)
    setpoints = [
        _stack(one, ["x_r"], file)[:, 0] for one, file in ((simulated, source), (columns, path))
    ]
    for setpoint, file in zip(setpoints, (source, path), strict=True):
        _require_changes(setpoint, "x_r", file)
    lag = find_lag(*setpoints)
    kept = slice(max(0, -lag), min(len(state), len(reference) - lag))
    if kept.stop - kept.start < MIN_SAMPLES:
        raise ValueError(
            f"{path} overlaps with {source} in {max(kept.stop - kept.start, 0)} samples by x_r: "
            f"at least {MIN_SAMPLES} are needed; {REMEDY}"
        )
    state, speed = state[kept], speed[kept]
    state = state - (state - reference[kept.start + lag : kept.stop + lag]).mean(axis=0)
    vectors = rotation_vectors_of(state[:, 3:7])
    state = np.concatenate(
        [
            smooth_flight(state[:, :3], CUTOFFS["position"]),
            Rotation.from_rotvec(smooth_flight(vectors, CUTOFFS["attitude"])).as_quat(),
            smooth_flight(state[:, 7:10], CUTOFFS["velocity"]),
            smooth_flight(state[:, 10:], CUTOFFS["rates"]),
        ],
        axis=1,
    )
    return NanodroneFlight(path.name, state, smooth_flight(speed, CUTOFFS["speed"]))


def rotation_vectors_of(quaternions: np.ndarray) -> np.ndarray:
    """Return rotation vectors (n, 3) of quaternions (n, 4) as the benchmark's processing does.

    After the means were replaced, quaternions are not of unit length. The scalar part is clamped
    below 1, and the vector part is divided by its own length.
    """
    size = np.linalg.norm(quaternions[:, :3], axis=1, keepdims=True)
    scalar = np.clip(quaternions[:, 3:], SMALL_ANGLE - 1.0, 1.0 - SMALL_ANGLE)
    angle = 2.0 * np.arctan2(size, scalar)
    vectors: np.ndarray = angle / (size + SMALL_ANGLE) * quaternions[:, :3]
    return vectors


def remove_speed_spikes(speed: np.ndarray, path: Path) -> np.ndarray:
    """Replace spikes of any motor by the next speeds of all motors.

    Args:
        speed: Speeds (n, 4), 1/min electrical.
        path: File, for messages.

    Returns:
        The speeds without spikes. A jump removes the samples before, at and after it.

    Raises:
        ValueError: If there are too many spikes, or the speed of a motor never changes.
    """
    for k, motor in enumerate(speed.T):
        _require_changes(motor, f"m{k + 1}_erpm", path)
    jumps = np.abs(np.diff(speed, axis=0)).max(axis=1) > MAX_ERPM_JUMP
    bad = np.abs(speed).max(axis=1) > MAX_ERPM
    bad[:-1] |= jumps
    bad[1:] |= jumps
    bad[:-2] |= jumps[1:]
    if bad.mean() > MAX_GAPS:
        raise ValueError(
            f"{path}: {100 * bad.mean():.0f} % of the motor speeds are spikes, such as "
            f"{np.abs(speed).max():g} 1/min: {REMEDY}"
        )
    return fill_from_next(np.where(bad[:, None], np.nan, speed))


def align_speeds(speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Shift motor speeds so that thrust and measured acceleration correlate best.

    Args:
        speed: Rotor speeds, (n, 4), rad/s.
        acceleration: Acceleration along the body's z axis, (n,), m/s^2.

    Returns:
        The speeds, shifted by whole samples; the ends repeat the first or the last one.
    """
    count = len(speed)
    lag = find_lag(acceleration, (speed**2).sum(axis=1))
    return speed[np.clip(np.arange(count) - lag, 0, count - 1)]


def find_lag(reference: np.ndarray, signal: np.ndarray) -> int:
    """Return the shift of a signal, in samples, at which it correlates best with a reference."""
    signals = [(one - one.mean()) / one.std() for one in (reference, signal)]
    return int(np.argmax(correlate(*signals, mode="full"))) - (len(signal) - 1)


def smooth_flight(values: np.ndarray, cutoff: float) -> np.ndarray:
    """Filter series (n, C) forwards and backwards by a Butterworth low-pass, Hz."""
    sections = butter(FILTER_ORDER, cutoff, btype="low", fs=SAMPLE_RATE, output="sos")
    smoothed: np.ndarray = sosfiltfilt(sections, values, axis=0)
    return smoothed


def fill_from_next(values: np.ndarray) -> np.ndarray:
    """Replace NaN in series (n, C) by the next value, at the end by the last one."""
    count = len(values)
    filled = values.copy()
    for column in filled.T:
        good = np.flatnonzero(np.isfinite(column))
        if len(good):
            following = np.searchsorted(good, np.arange(count))
            column[:] = column[good[np.minimum(following, len(good) - 1)]]
    return filled


def _require_changes(values: np.ndarray, name: str, path: Path) -> None:
    """Raise ValueError for a column that never changes: nothing can be aligned with it."""
    if np.ptp(values) == 0.0:
        raise ValueError(f"{path}: column {name} is {values[0]:g} everywhere: {REMEDY}")


def _read_state(columns: dict[str, np.ndarray], path: Path) -> np.ndarray:
    """Return the states (n, 13)."""
    names = (*POSITIONS, *QUATERNIONS, *VELOCITIES, *RATES_BODY)
    state = _stack(columns, names, path)
    length = np.linalg.norm(state[:, 3:7], axis=1)
    if length.min() < MIN_QUATERNION:
        raise ValueError(
            f"{path}: the quaternion of row {length.argmin()} has length {length.min():g}, "
            f"not 1: {REMEDY}"
        )
    return state


def _stack(columns: dict[str, np.ndarray], names: Sequence[str], path: Path) -> np.ndarray:
    """Return columns as one array (n, C), with gaps filled."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise ValueError(f"{path} lacks the column {missing[0]}: {REMEDY}")
    values = np.stack([_to_numbers(columns[name], name, path) for name in names], axis=1)
    if len(values) < MIN_SAMPLES:
        raise ValueError(f"{path} has {len(values)} rows: at least {MIN_SAMPLES} are needed")
    gaps = np.isnan(values).mean(axis=0)
    if gaps.max() > MAX_GAPS:
        name = names[int(gaps.argmax())]
        raise ValueError(f"{path}: {100 * gaps.max():.0f} % of column {name} are empty: {REMEDY}")
    return fill_from_next(values)


def _to_numbers(cells: np.ndarray, name: str, path: Path) -> np.ndarray:
    """Convert a column of numbers or of text; empty cells and None are NaN."""
    found = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            found[row] = np.nan if cell in ("", None) else float(cell)
        except (ValueError, TypeError):
            raise ValueError(
                f"{path}: row {row} of column {name} is {cell!r}, no number: {REMEDY}"
            ) from None
    if np.isinf(found).any():
        row = int(np.isinf(found).argmax())
        raise ValueError(f"{path}: row {row} of column {name} is {found[row]}: {REMEDY}")
    return found


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a Parquet file."""
    from bulletuav.adapters.parquet import read_table  # which needs an extra

    try:
        return read_table(path)
    except ValueError:
        raise ValueError(f"{path} is damaged: {REMEDY}") from None


def _read_csv(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a CSV file, as text."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error):
        raise ValueError(f"{path} is no table in text: {REMEDY}") from None
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise ValueError(f"{path} is no table of equal rows: {REMEDY}")
    cells = np.array(rows[1:], object).reshape(-1, len(rows[0]))
    return dict(zip(rows[0], cells.T, strict=True))
