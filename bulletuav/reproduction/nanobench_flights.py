"""Flights of NanoBench: a Crazyflie 2.1 under motion capture.

S. I. Ullah and J. Baca, NanoBench, arXiv 2603.09908 (2026): pose, gyroscope, motor commands and
battery voltage at 100 Hz.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bulletuav.reproduction.flight_series import (
    FULL_PWM,
    LogError,
    drop_copies,
    require_finite_log,
    require_log_columns,
    require_rising_time,
)
from bulletuav.vehicle.rotors import RPM

TRACKING_FAMILIES = ("B2_", "B3_", "B5_", "B6_", "B7_", "B8_", "B9_", "B10_")
"""Flights that are read: the tracked paths, without random waypoints and stairs"""
MOTOR_COLUMNS = tuple(f"motor_motor_m{i}" for i in range(1, 5))
NANOBENCH_COLUMNS = (
    *("t", "px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz"),
    *("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"),
    *MOTOR_COLUMNS,
    "pwr_pm_vbat",
)
"""Columns that are read, in the order of the table"""
NANOBENCH_DT = 0.01
"""Time between rows, s"""
MIN_FLIGHT_HEIGHT = 0.5
"""Minimum height of a flight, m: above the ground effect, and after take-off"""
MIN_FLIGHT_COMMAND = 0.08
"""Minimum command of a motor in flight, as a fraction of the maximum"""


@dataclass(frozen=True)
class NanobenchFlight:
    """One flight: series at 100 Hz, whose first axis is time.

    Attributes:
        name: Name of the file without its ending.
        time: (T,) s.
        position: (T, 3) world, m.
        velocity: (T, 3) world, m/s.
        quaternion: (T, 4) body to world, scalar last.
        rates: (T, 3) gyroscope, body axes, rad/s.
        pwm: (T, 4) motor commands, as fractions of the maximum.
        volts: (T,) battery voltage, V.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    quaternion: np.ndarray
    rates: np.ndarray
    pwm: np.ndarray
    volts: np.ndarray

    @property
    def state(self) -> np.ndarray:
        """Position, quaternion, velocity and rates, (T, 13)."""
        return np.concatenate([self.position, self.quaternion, self.velocity, self.rates], axis=1)


def read_nanobench_columns(path: Path, columns: Sequence[str]) -> np.ndarray:
    """Read columns of one flight, the first of which is time.

    Returns:
        Table (rows, columns).

    Raises:
        LogError: If columns or numbers are missing, or times do not rise.
    """
    name = path.stem
    with path.open(errors="replace") as lines:
        header = lines.readline().strip().split(",")
    require_log_columns(name, header, columns)
    indices = [header.index(column) for column in columns]
    try:
        with warnings.catch_warnings():
            # Of files without rows, whose times do not rise
            warnings.simplefilter("ignore", UserWarning)
            table = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=indices, ndmin=2)
        table = table.reshape(-1, len(indices))
    except ValueError as error:
        raise LogError(f"{name}: rows differ in length; fetch the file again") from error
    require_finite_log(name, table, columns)
    require_rising_time(name, table[:, 0])
    return table


def read_nanobench_flight(path: Path) -> NanobenchFlight:
    """Read one flight.

    Raises:
        LogError: If columns or numbers are missing, times do not rise, quaternions have another
            length than 1, motor commands are out of
            range (misread packets of the radio), or the drone never flew.
    """
    name = path.stem
    table = read_nanobench_columns(path, NANOBENCH_COLUMNS)
    lengths = np.linalg.norm(table[:, 4:8], axis=1)
    if np.abs(lengths - 1.0).max() > 0.01:
        worst = lengths[np.argmax(np.abs(lengths - 1.0))]
        raise LogError(f"{name}: a quaternion of length {worst:.2f}, not 1")
    pwm = table[:, 14:18] / FULL_PWM
    if pwm.min() < 0.0 or pwm.max() > 1.0:
        raise LogError(f"{name}: motor commands from {pwm.min():.2f} to {pwm.max():.2f} of full")
    if table[:, 3].max() < MIN_FLIGHT_HEIGHT:
        raise LogError(f"{name}: never above {MIN_FLIGHT_HEIGHT:g} m")
    return NanobenchFlight(
        name,
        time=table[:, 0],
        position=table[:, 1:4],
        velocity=table[:, 8:11],
        quaternion=table[:, 4:8],
        rates=table[:, 11:14],
        pwm=pwm,
        volts=table[:, 18],
    )


def find_nanobench_flights(folder: Path) -> list[Path]:
    """Return the files of the tracked paths in a clone of NanoBench, sorted, without copies.

    Raises:
        LogError: If there are none.
    """
    paths = [
        path
        for path in (folder / "datasets" / "dataset").glob("*.csv")
        if path.name.startswith(TRACKING_FAMILIES)
    ]
    if not paths:
        raise LogError(
            f"{folder / 'datasets' / 'dataset'}: no flights; is it a clone of NanoBench?"
        )
    return drop_copies(paths)


def read_nanobench_flights(paths: Sequence[Path]) -> tuple[list[NanobenchFlight], list[str]]:
    """Read flights.

    Returns:
        The flights, and the reasons why others cannot be used.
    """
    flights, refused = [], []
    for path in paths:
        try:
            flights.append(read_nanobench_flight(path))
        except LogError as error:
            refused.append(str(error))
    return flights, refused


def compute_rotor_commands(pwm: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Return the commanded rotor speeds of a Crazyflie 2.x.

    Measured maps of three sources agree on this line, see docs/explanation/truth.md. The battery of
    the package has the same line about hover: 4670.5 rpm and more at its PWM map, at 3.57 V.

    Args:
        pwm: Motor commands, as fractions of the maximum.
        volts: Voltage of the battery under load, V.

    Returns:
        Speeds, rad/s.
    """
    speeds: np.ndarray = (1900.0 + 6980.0 * pwm * volts) * RPM
    return speeds
