"""Logs of Neural-Swarm: Crazyflies that fly near each other and near the ground, at 100 Hz.

G. Shi et al., Neural-Swarm (ICRA 2020), Neural-Swarm2 (T-RO 2021). The repository has no licence:
only figures are derived from it.
"""

import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from bulletuav.reproduction.flight_series import (
    FULL_PWM,
    LogError,
    find_gaps,
    first_order_lag,
    require_finite_log,
    require_log_columns,
    require_rising_time,
    resample_columns,
    rotation_matrices,
)
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

SWARM_STATE = "stateEstimateZ."
SWARM_COLUMNS = (
    "tick",
    *(SWARM_STATE + axis for axis in "xyz"),
    *(f"{SWARM_STATE}a{axis}" for axis in "xyz"),
    *(SWARM_STATE + name for name in ("rateRoll", "ratePitch", "rateYaw")),
    SWARM_STATE + "quat",
    *(f"pwm.m{i}_pwm" for i in range(1, 5)),
    "pm.vbatMV",
)
"""Columns that are read, in the order of the table"""
COLUMN_TYPES = {
    **{"f": "<f4", "i": "<i4", "I": "<u4", "h": "<i2"},
    **{"H": "<u2", "b": "i1", "B": "u1"},
}
"""Types of columns, by their letters in the header"""
SWARM_DT = 0.01
"""Time between rows, s"""
SWARM_MOTOR_LAG = 0.065
"""Lag of the rotors, s"""
MAX_ROW_GAP = 0.03
"""Time between rows from which they count as missing, s"""
FORCE_ROWS = 5
"""Rows over which the accelerometer is averaged"""
_SMALL = 11.093358483549203, -39.08104165843915, -9.525647087583181
_LARGE = 44.10386631845999, -122.51151800146272, -36.18484254283743
STAND_FITS = {
    "small": (*_SMALL, 20.573302305476638, 38.42885066644033),
    "large": (*_LARGE, 53.10772568607133, 107.6819263349139),
}
"""Fits of the repository to its test stand, by drone: 1, u, v, u^2 and u v, of the command u as a
fraction and the voltage v over 4.2 V, in grams (training.py; parrot_frame.txt)
"""


@dataclass(frozen=True)
class SwarmLog:
    """One drone's log: series whose first axis is time, resampled at 100 Hz.

    Attributes:
        time: (T,) s.
        position: (T, 3) m.
        load: (T,) vertical specific force over gravity, averaged.
        rates: (T, 3) body rates, rad/s.
        attitude: (T, 3, 3) body to world.
        thrust: (T, 4) of each motor, grams, with lag: the test stand's for command and voltage.
        gap: (T,) whether rows are missing.
        sideways: (T, 2) horizontal specific force in world axes over gravity, averaged.
    """

    time: np.ndarray
    position: np.ndarray
    load: np.ndarray
    rates: np.ndarray
    attitude: np.ndarray
    thrust: np.ndarray
    gap: np.ndarray
    sideways: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def lift(self) -> np.ndarray:
        """Return the vertical part of the thrust (T,), grams."""
        return np.asarray(self.thrust.sum(axis=1) * self.attitude[:, 2, 2])


def decode_swarm_log(name: str, content: bytes) -> np.ndarray:
    """Decode a log of the Crazyflie's SD card, version 1, as a structured array.

    Raises:
        LogError: If its header cannot be read, it ends early, or a checksum is wrong.
    """
    try:
        at = 1
        fields = []
        for _ in range(content[0]):
            end = content.index(b",", at)
            title, _, kind = content[at:end].decode("ascii").rpartition("(")
            fields.append((title.strip(), COLUMN_TYPES[kind[0]]))
            at = end + 1
        layout = np.dtype(fields)
    except (ValueError, KeyError, IndexError) as error:
        raise LogError(f"{name}: its header cannot be read") from error
    _check_sum(name, content[: at + 4])
    at += 4
    sets = []
    while at < len(content):
        end = at + 1 + content[at] * layout.itemsize
        _check_sum(name, content[at : end + 4])
        sets.append(np.frombuffer(content, layout, content[at], at + 1))
        at = end + 4
    if not sets:
        raise LogError(f"{name}: it has no rows")
    return np.concatenate(sets)


def _check_sum(name: str, block: bytes) -> None:
    """Check a block that ends with its checksum: the checksum of both is all ones."""
    if zlib.crc32(block) != 0xFFFFFFFF:
        raise LogError(f"{name}: a checksum is wrong, or it ends early")


def decompress_quaternions(packed: np.ndarray) -> np.ndarray:
    """Decompress quaternions (T, 4), scalar last, as packed by the firmware's quatcompress.h."""
    rest = packed.astype(np.int64)
    largest = rest >> 30
    rows = np.arange(len(rest))
    quaternion = np.zeros((len(rest), 4))
    for index in (3, 2, 1, 0):
        its = largest != index
        size = (rest & 511) / 511.0 / np.sqrt(2.0)
        sign = np.where(rest & 512, -1.0, 1.0)
        quaternion[its, index] = (sign * size)[its]
        rest = np.where(its, rest >> 10, rest)
    quaternion[rows, largest] = np.sqrt(1.0 - np.sum(quaternion**2, axis=1))
    return quaternion


def compute_stand_thrust(pwm: np.ndarray, volts: np.ndarray, drone: str = "small") -> np.ndarray:
    """Return the thrust of each motor on the test stand, grams.

    Args:
        pwm: Commands (T, 4), as fractions of the maximum.
        volts: Voltages (T,), V.
        drone: Name of a fit of `STAND_FITS`.
    """
    v = (volts / 4.2)[:, None]
    one, u, by_voltage, square, product = STAND_FITS[drone]
    linear = one + u * pwm + by_voltage * v
    return np.asarray(linear + square * pwm * pwm + product * v * pwm)


def is_large_drone(path: Path) -> bool:
    """Return True for logs of the larger drones: cf100, cf101 and cf102."""
    return path.name.startswith("cf1")


def read_swarm_log(path: Path, force_rows: int = FORCE_ROWS) -> SwarmLog:
    """Read one log.

    Args:
        path: The log.
        force_rows: Number of rows over which the accelerometer is averaged.

    Raises:
        LogError: If it cannot be decoded, or columns or numbers are missing.
    """
    rows = decode_swarm_log(path.name, path.read_bytes())
    require_log_columns(path.name, rows.dtype.names or (), SWARM_COLUMNS)
    tick = rows["tick"] / 1e6
    require_rising_time(path.name, tick)
    table = np.stack([rows[column].astype(float) for column in SWARM_COLUMNS], axis=1)
    require_finite_log(path.name, table, SWARM_COLUMNS)
    time = np.arange(tick[0], tick[-1], SWARM_DT)
    series = resample_columns(tick, table, time)
    quaternion = resample_columns(tick, decompress_quaternions(rows[SWARM_STATE + "quat"]), time)
    drone = "large" if is_large_drone(path) else "small"
    thrust = compute_stand_thrust(series[:, 11:15] / FULL_PWM, series[:, 15] / 1e3, drone)
    force = uniform_filter1d(series[:, 4:7] / 1e3 / STANDARD_GRAVITY, force_rows, axis=0)
    return SwarmLog(
        time,
        position=series[:, 1:4] / 1e3,
        load=force[:, 2],
        rates=series[:, 7:10] / 1e3,
        attitude=rotation_matrices(quaternion),
        thrust=first_order_lag(thrust, SWARM_MOTOR_LAG, SWARM_DT),
        gap=find_gaps(tick, time, MAX_ROW_GAP),
        sideways=force[:, :2],
    )


def find_training_folder(folder: Path) -> Path:
    """Return the folder of the logs in a clone of Neural-Swarm."""
    return folder / "data" / "training"
