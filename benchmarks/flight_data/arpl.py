"""ARPL: body rates of a Crazyflie half a second later, from its motor commands.

J. Eschmann et al., Data-Driven System Identification of Quadrotors Subject to Motor Delays (2024):
accelerometer, gyroscope and motor commands at 1 kHz. No attitude, velocity or voltage is logged.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data.predictors import Predictor
from flight_data.series import (
    FULL_PWM,
    SPINS,
    LogError,
    first_order_lag,
    in_gap,
    moments,
    require_columns,
    require_finite,
    require_rising,
    resample,
    rms,
)

REPOSITORY, LICENCE = "data-driven-system-identification", "MIT"
FLIGHTS = (
    ("log10", 6.5, 41.5),
    ("log15", 12.5, 53.5),
    ("log16", 15.5, 21.8),
    ("log16", 28.0, 32.3),
)
"""Times in the air, s after the log's first row"""
ACCELERATION = ("acc.x", "acc.y", "acc.z")
GYROSCOPE = ("gyro.x", "gyro.y", "gyro.z")
MOTORS = ("motor.m1", "motor.m2", "motor.m3", "motor.m4")
COLUMNS = (*ACCELERATION, *GYROSCOPE, *MOTORS)
TYPES = {"f": "<f4", "I": "<u4", "H": "<u2", "h": "<i2", "i": "<i4", "B": "u1", "b": "i1"}
DT = 0.001
STEPS = 500
"""Rows of a window"""
SOON = 100
"""Rows of a short window"""
LENGTHS = (50, 100, 200, 300, 500)
"""Rows of windows to which damping is fitted"""
BLOCK = 5.0
"""Seconds of a flight that are fitted or kept back, in turn"""
COARSE = 5
"""Rows of a step of the prediction"""
LONGEST_GAP = 0.003
DELAY = 8
"""Rows by which the gyroscope's filter delays"""
SMOOTH = 0.02
"""Time constant of the accelerometer's filter, s"""
VOLTS = 3.7
"""Taken where a predictor asks for the voltage"""


@dataclass(frozen=True)
class Log:
    """One log: times, s; specific force, m/s^2; rates, rad/s; motor commands, shares."""

    name: str
    time: np.ndarray
    force: np.ndarray
    rates: np.ndarray
    pwm: np.ndarray


@dataclass(frozen=True)
class Windows:
    """Windows of half a second in coarse steps, (W, S, ...), and the index of the log of each.

    Attributes:
        start: Rates at the start (W, 3), rad/s.
        end: Rates at the end.
        torque: Roll, pitch and yaw torque of the rotors, N m.
        force: Horizontal specific force of the accelerometer (W, S, 2), m/s^2.
        spin: Sum of the rotor speeds over that at hover.
        log: Index of the log.
        block: Number of the block of `BLOCK` seconds, over all flights.
    """

    start: np.ndarray
    end: np.ndarray
    torque: np.ndarray
    force: np.ndarray
    spin: np.ndarray
    log: np.ndarray
    block: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))


def decode(name: str, content: bytes) -> np.ndarray:
    """Decode a log of the Crazyflie's SD card, version 2, one event, as a structured array.

    Raises:
        LogError: It is none, or torn.
    """
    if len(content) < 5 or content[0] != 0xBC:
        raise LogError(f"{name}: no log of an SD card")
    version, events = struct.unpack_from("<HH", content, 1)
    if version != 2 or events != 1:
        raise LogError(f"{name}: version {version} with {events} events, not 2 with one")
    try:
        at = content.index(b"\0", 7) + 1
        (variables,) = struct.unpack_from("<H", content, at)
        at += 2
        fields = [("event", "<u2"), ("microseconds", "<u8")]
        for _ in range(variables):
            end = content.index(b"\0", at)
            text = content[at:end].decode("ascii")
            fields.append((text[:-3], TYPES[text[-2]]))
            at = end + 1
    except (ValueError, KeyError, struct.error) as error:
        raise LogError(f"{name}: its header cannot be read") from error
    layout = np.dtype(fields)
    return np.frombuffer(content, layout, (len(content) - at) // layout.itemsize, at)


def load(path: Path) -> Log:
    """Read one log.

    Raises:
        LogError: It cannot be decoded, or columns or numbers are missing.
    """
    rows = decode(path.name, path.read_bytes())
    require_columns(path.name, rows.dtype.names or (), COLUMNS)
    table = np.stack([rows[column].astype(float) for column in COLUMNS], axis=1)
    require_finite(path.name, table, COLUMNS)
    time = rows["microseconds"] / 1e6
    require_rising(path.name, time)
    pwm = table[:, 6:] / FULL_PWM
    if pwm.max() > 1.0:
        raise LogError(f"{path.name}: motor commands up to {pwm.max():.2f} of full")
    force, rates = table[:, :3] * STANDARD_GRAVITY, np.radians(table[:, 3:6])
    return Log(path.name, time - time[0], force, rates, pwm)


def load_all(folder: Path) -> dict[str, Log]:
    """Read the logs of a clone."""
    names = dict.fromkeys(name for name, _, _ in FLIGHTS)
    return {name: load(folder / "logs_crazyflie" / name) for name in names}


def windows(
    logs: dict[str, Log], predictor: Predictor, steps: int = STEPS
) -> tuple[Windows, Windows]:
    """Cut the flights into windows of blocks to fit, and of blocks kept back.

    Windows that lie in two blocks or in a gap of the log are left out.

    Args:
        logs: The logs by name.
        predictor: The model, for the torques of the rotors.
        steps: Rows of a window, a multiple of `COARSE`; there are two windows in that time.
    """
    halves: tuple[list[tuple[np.ndarray, ...]], list[tuple[np.ndarray, ...]]] = ([], [])
    for flight, (name, first, last) in enumerate(FLIGHTS):
        log = logs[name]
        time = np.arange(first, last, DT)
        rates = resample(log.time, log.rates, time)
        torque, spin = rotor_torques(predictor, log, time)
        force = first_order_lag(resample(log.time, log.force, time), SMOOTH, DT)[:, :2]
        gap = in_gap(log.time, time, LONGEST_GAP)
        for row in range(0, len(time) - steps, steps // 2):
            end = row + steps
            block = int((time[row] - first) / BLOCK)
            if block != int((time[end] - first) / BLOCK) or gap[row : end + 1].any():
                continue
            coarse = [
                values[row:end].reshape(steps // COARSE, COARSE, -1).mean(axis=1)
                for values in (torque, force, spin[:, None])
            ]
            index = np.array(list(logs).index(name))
            number = np.array(100 * flight + block)
            halves[block % 2].append((rates[row], rates[end], *coarse, index, number))
    return (_stacked(halves[0]), _stacked(halves[1]))


def _stacked(parts: Sequence[tuple[np.ndarray, ...]]) -> Windows:
    return Windows(*(np.stack(column) for column in zip(*parts, strict=True)))


def rotor_torques(
    predictor: Predictor, log: Log, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return torques (T, 3), N m, and the sum of the rotor speeds over that at hover (T,).

    The thrust is scaled so that it is what the accelerometer felt, on average.
    """
    pwm = resample(log.time, log.pwm, time)
    speed = predictor.rotor_speeds(pwm, np.full(len(time), VOLTS), DT)
    speed = np.roll(speed, DELAY, axis=0)
    thrust = predictor.thrust(speed)
    felt = predictor.mass * np.interp(time, log.time, log.force[:, 2]).mean()
    gain = felt / thrust.sum(axis=1).mean()
    thrust = gain * thrust
    yaw = predictor.torque_ratio * thrust @ SPINS
    yaw += predictor.propeller_inertia * np.gradient(speed, DT, axis=0) @ SPINS
    torque = np.column_stack([moments(thrust, predictor.half_arm), yaw])
    spin = np.sqrt(gain) * speed.sum(axis=1) / predictor.hover_speed()
    return torque, spin


def predict(predictor: Predictor, cut: Windows, bias: np.ndarray) -> np.ndarray:
    """Predict rates (W, 3) at the end of windows, rad/s.

    The moment of the drag is that of the drag which the accelerometer felt.

    Args:
        predictor: The model.
        cut: The windows.
        bias: Angular accelerations (L, 3) of each log, rad/s^2.
    """
    inertia = np.array(predictor.inertia)
    damping = np.array(predictor.rate_damping)
    lever = predictor.mass * predictor.drag_height
    rates = cut.start.copy()
    for step in range(cut.torque.shape[1]):
        torque = cut.torque[:, step] - np.cross(rates, inertia * rates)
        torque[:, 0] -= lever * cut.force[:, step, 1]
        torque[:, 1] += lever * cut.force[:, step, 0]
        change = torque / inertia + bias[cut.log]
        slow = 1.0 + damping * cut.spin[:, step] * DT * COARSE
        rates = (rates + change * DT * COARSE) / slow
    return rates


def fitted_bias(predictor: Predictor, cut: Windows) -> np.ndarray:
    """Fit the angular accelerations (L, 3) that motors and centre of mass cause, log by log."""
    bias = np.zeros((cut.log.max() + 1, 3))
    for _ in range(4):
        duration = cut.torque.shape[1] * COARSE * DT
        error = (cut.end - predict(predictor, cut, bias)) / duration
        for log in range(len(bias)):
            bias[log] += error[cut.log == log].mean(axis=0)
    return bias


def likeliest_damping(cuts: Sequence[Windows], predictor: Predictor) -> float:
    """Return the damping of roll and pitch rates that makes windows likeliest, 1/s.

    Errors of each length of windows are taken as normal, with a variance of their own, and
    windows as independent: the sum of n log(mean square) is least.

    Args:
        cuts: Windows of the half that is fitted, of each length.
        predictor: The model; its damping in roll and pitch is replaced.
    """

    def unlikely(damping: float) -> float:
        trial = replace(predictor, rate_damping=(damping, damping, predictor.rate_damping[2]))
        total = 0.0
        for cut in cuts:
            roll, pitch, _ = errors(cut, predict(trial, cut, fitted_bias(trial, cut)))
            total += len(cut.start) * np.log(roll**2 + pitch**2)
        return total

    found = minimize_scalar(unlikely, bounds=(0.0, 20.0), method="bounded")
    return float(found.x)


def errors(cut: Windows, rates: np.ndarray) -> list[float]:
    """Return RMS errors of roll, pitch and yaw rate, rad/s."""
    return [float(value) for value in rms(rates - cut.end)]
