"""Neural-Swarm: logs of Crazyflies that fly near each other and near the ground, at 100 Hz.

G. Shi et al., Neural-Swarm (ICRA 2020), Neural-Swarm2 (T-RO 2021). The repository has no licence:
figures alone are derived from it.
"""

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data.series import (
    FULL_PWM,
    LogError,
    first_order_lag,
    in_gap,
    require_columns,
    require_finite,
    require_rising,
    resample,
    rotations,
)

REPOSITORY, LICENCE = "neural-swarm", "none: figures only"
STATE = "stateEstimateZ."
POSITION = tuple(STATE + axis for axis in "xyz")
FORCE = tuple(f"{STATE}a{axis}" for axis in "xyz")
RATES = tuple(STATE + name for name in ("rateRoll", "ratePitch", "rateYaw"))
PWM = tuple(f"pwm.m{i}_pwm" for i in range(1, 5))
COLUMNS = ("tick", *POSITION, *FORCE, *RATES, STATE + "quat", *PWM, "pm.vbatMV")
TYPES = {"f": "<f4", "i": "<i4", "I": "<u4", "h": "<i2", "H": "<u2", "b": "i1", "B": "u1"}
DT = 0.01
LAG = 0.065
"""Lag of the rotors, s"""
LONGEST_GAP = 0.03
SMOOTH = 5
"""Rows over which the accelerometer is averaged"""


@dataclass(frozen=True)
class Log:
    """One drone's log: series whose first axis is time, resampled at 100 Hz.

    Attributes:
        time: s.
        position: m.
        load: Vertical specific force over gravity, averaged.
        rates: Body rates, rad/s.
        attitude: Body to world.
        thrust: Of each motor, grams, lagged: what a test stand measured for command and voltage.
        gap: Where rows are missing.
    """

    time: np.ndarray
    position: np.ndarray
    load: np.ndarray
    rates: np.ndarray
    attitude: np.ndarray
    thrust: np.ndarray
    gap: np.ndarray

    def lift(self) -> np.ndarray:
        """Return the vertical part of the thrust, grams."""
        return np.asarray(self.thrust.sum(axis=1) * self.attitude[:, 2, 2])


def decode(name: str, content: bytes) -> np.ndarray:
    """Decode a log of the Crazyflie's SD card, version 1, as a structured array.

    Raises:
        LogError: Its header cannot be read, it ends early, or a checksum is wrong.
    """
    try:
        at = 1
        fields = []
        for _ in range(content[0]):
            end = content.index(b",", at)
            title, _, kind = content[at:end].decode("ascii").rpartition("(")
            fields.append((title.strip(), TYPES[kind[0]]))
            at = end + 1
    except (ValueError, KeyError, IndexError) as error:
        raise LogError(f"{name}: its header cannot be read") from error
    layout = np.dtype(fields)
    _check(name, content[: at + 4])
    at += 4
    sets = []
    while at < len(content):
        end = at + 1 + content[at] * layout.itemsize
        _check(name, content[at : end + 4])
        sets.append(np.frombuffer(content, layout, content[at], at + 1))
        at = end + 4
    if not sets:
        raise LogError(f"{name}: it has no rows")
    return np.concatenate(sets)


def _check(name: str, block: bytes) -> None:
    """Check a block that ends with its checksum: the checksum of both is all ones."""
    if zlib.crc32(block) != 0xFFFFFFFF:
        raise LogError(f"{name}: a checksum is wrong, or it ends early")


def decompress(packed: np.ndarray) -> np.ndarray:
    """Decompress quaternions (T, 4), scalar last: see quatcompress.h of the firmware."""
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


def stand_thrust(pwm: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Return the thrust of each motor, grams: the repository's fit to its test stand, by command.

    Args:
        pwm: Commands (T, 4), shares.
        volts: Voltages (T,).
    """
    v = (volts / 4.2)[:, None]
    linear = 11.093358483549203 - 39.08104165843915 * pwm - 9.525647087583181 * v
    return np.asarray(linear + 20.573302305476638 * pwm * pwm + 38.42885066644033 * v * pwm)


def load(path: Path) -> Log:
    """Read one log.

    Raises:
        LogError: It cannot be decoded, or columns or numbers are missing.
    """
    rows = decode(path.name, path.read_bytes())
    require_columns(path.name, rows.dtype.names or (), COLUMNS)
    tick = rows["tick"] / 1e6
    require_rising(path.name, tick)
    table = np.stack([rows[column].astype(float) for column in COLUMNS], axis=1)
    require_finite(path.name, table, COLUMNS)
    time = np.arange(tick[0], tick[-1], DT)
    series = resample(tick, table, time)
    quaternion = resample(tick, decompress(rows[STATE + "quat"]), time)
    thrust = stand_thrust(series[:, 11:15] / FULL_PWM, series[:, 15] / 1e3)
    return Log(
        time,
        position=series[:, 1:4] / 1e3,
        load=uniform_filter1d(series[:, 6] / 1e3 / STANDARD_GRAVITY, SMOOTH),
        rates=series[:, 7:10] / 1e3,
        attitude=rotations(quaternion),
        thrust=first_order_lag(thrust, LAG, DT),
        gap=in_gap(tick, time, LONGEST_GAP),
    )


def training(folder: Path) -> Path:
    """Return the folder of the logs of a clone."""
    return folder / "data" / "training"
