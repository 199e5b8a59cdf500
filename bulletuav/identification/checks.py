"""Validation of flight logs. Each error names the column, its value and a remedy."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bulletuav.geometry.rotation import from_euler
from bulletuav.identification.logs import (
    EULER,
    FORCE,
    OTHER,
    POSITION,
    QUATERNION,
    RATES,
    VELOCITY,
    Log,
)
from bulletuav.identification.missing_data import (
    check_not_constant,
    check_times,
    fill_gaps,
    log_error,
    remove_spikes,
)
from bulletuav.identification.smoothing import compute_body_rates
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.rotors import RPM

MAX_SPEED = 60.0
"""Maximum plausible speed, m/s"""
MAX_TILT = math.radians(60)
"""Maximum plausible median tilt, rad"""
THRUST_BOUNDS = (0.4, 2.5)
"""Plausible range of the median thrust, in weights"""


def require_no_wings(airframe: Airframe) -> None:
    """Raise ValueError for an airframe with wings, as forces of wings are not fitted."""
    if airframe.wings:
        raise ValueError(
            f"airframe {airframe.name!r} has wings, whose forces are not identified: pass a "
            f"multirotor"
        )


def check_log(log: Log, airframe: Airframe) -> Log:
    """Validate a log, fill its short gaps, and convert its attitude to unit quaternions.

    Args:
        log: The log as read from the file.
        airframe: The airframe that was flown.

    Returns:
        The log without missing values, with unit quaternions.

    Raises:
        ValueError: If the log is damaged, or its values are implausible in the units of `logs`.
    """
    check_times(log)
    log = fill_gaps(log)
    check_not_constant(log)
    columns = dict(log.columns)
    if EULER[0] in log:
        _check_radians(log)
        turns = [from_euler(*row) for row in log.stack(EULER)]
        columns |= dict(zip(QUATERNION, np.array(turns).T, strict=True))
    log = replace(log, columns=columns)
    quaternion = _unit_quaternions(log)
    columns |= dict(zip(QUATERNION, quaternion.T, strict=True))
    log = replace(log, columns=columns)
    _check_metres(log)
    log = remove_spikes(log)
    _check_upright(log)
    _check_rates(log)
    _check_velocity(log)
    _check_force(log)
    _check_commands(log, airframe)
    return log


def _check_radians(log: Log) -> None:
    """Raise ValueError for Euler angles beyond a full turn, which are in degrees."""
    for name in EULER:
        largest = np.abs(log.columns[name]).max()
        if largest > 2 * math.pi:
            raise log_error(
                log, f"{name} goes to {largest:.4g}: radians are needed; --map {name}={name}*deg"
            )


def _unit_quaternions(log: Log) -> np.ndarray:
    """Return normalized quaternions (n, 4) without sign changes."""
    quaternion = log.stack(QUATERNION)
    norm = np.linalg.norm(quaternion, axis=1)
    median = float(np.median(norm))
    if abs(median - 1) > 0.05 or norm.min() < 0.5:
        row = int(np.argmax(np.abs(norm - 1)))
        raise log_error(
            log,
            f"qx, qy, qz, qw have a norm of {median:.4g} (row {row + 2}: {norm[row]:.4g}): unit "
            f"quaternions are needed; check the four columns",
        )
    quaternion = quaternion / norm[:, None]
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0
    sign = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2, -1.0, 1.0)])
    unit: np.ndarray = quaternion * sign[:, None]
    return unit


def _check_metres(log: Log) -> None:
    """Raise ValueError for positions that move too fast to be in metres."""
    time = log.time
    ahead = np.minimum(np.searchsorted(time, time + 0.2), len(time) - 1)
    for name in (*POSITION, *(OTHER if OTHER[0] in log else ())):
        values = log.columns[name]
        lapse = time[ahead] - time
        moved = np.abs(values[ahead] - values)[lapse > 0.1] / lapse[lapse > 0.1]
        speed = float(np.quantile(moved, 0.95))
        if speed > MAX_SPEED:
            raise log_error(
                log,
                f"{name} moves at {speed:.4g} m/s (range {values.min():.4g} to "
                f"{values.max():.4g}): metres are needed; if these are millimetres, "
                f"--map {name}={name}*mm",
            )


def _check_upright(log: Log) -> None:
    """Raise ValueError if the median tilt is implausible."""
    x, y, _, _ = log.stack(QUATERNION).T
    tilt = float(np.median(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1))))
    if tilt > MAX_TILT:
        raise log_error(
            log,
            f"the attitude is tilted by {math.degrees(tilt):.0f} degrees for half of the log: "
            f"body axes x forward, y left, z up, and a quaternion in the order x, y, z, w are "
            f"needed; check --map of qx, qy, qz, qw",
        )


def _check_rates(log: Log) -> None:
    """Raise ValueError if the body rates contradict the attitude in unit, sign or axis."""
    if RATES[0] not in log:
        return
    time = log.time
    quaternion = log.stack(QUATERNION)
    turning = compute_body_rates(time, quaternion)
    gyro = log.stack(RATES)
    for k, name in enumerate(RATES):
        slope, fit = _regress(turning[:, k], gyro[:, k])
        if np.std(_clip_outliers(turning[:, k])) < 0.05 or abs(fit) < 0.5:
            continue
        if slope < 0:
            raise log_error(
                log,
                f"{name} has the opposite sign of the attitude's rate (slope {slope:.3g}): body "
                f"axes are x forward, y left, z up; --map {name}={name}*-1, or the attitude is "
                f"world to body",
            )
        if 20 < slope < 170:
            raise log_error(
                log,
                f"{name} is {slope:.3g} times the rate of the attitude: rad/s are needed; "
                f"--map {name}={name}*deg",
            )
        if not 0.33 < slope < 3:
            raise log_error(
                log,
                f"{name} is {slope:.3g} times the rate of the attitude: rad/s in body axes are "
                f"needed; check its unit and column",
            )
    moving = [np.std(_clip_outliers(turning[:, k])) > 0.2 for k in range(3)]
    fits = [_regress(turning[:, k], gyro[:, k])[1] for k in range(3)]
    lost = [k for k in range(3) if moving[k] and abs(fits[k]) < 0.2]
    if lost:
        k = lost[0]
        raise log_error(
            log,
            f"{RATES[k]} does not follow the attitude (correlation {fits[k]:.2f}): p, q, r are "
            f"rates about the body's x, y, z axes; check their columns",
        )


def _clip_outliers(values: np.ndarray) -> np.ndarray:
    """Return deviations from the median, clipped at the 95 % quantile of their magnitude."""
    off = values - np.median(values)
    largest = np.quantile(np.abs(off), 0.95)
    clipped: np.ndarray = np.clip(off, -largest, largest)
    return clipped


def _regress(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the slope of y over x, and their strongest correlation at any small delay."""
    x = _clip_outliers(x)
    y = _clip_outliers(y)
    size = len(x)
    spectrum = np.fft.rfft(y, 2 * size) * np.conj(np.fft.rfft(x, 2 * size))
    product = np.fft.irfft(spectrum, 2 * size)
    near = min(30, size // 4)
    lags = np.concatenate([product[-near:], product[:near]])
    best = float(lags[np.argmax(np.abs(lags))])
    own, other = math.sqrt(float(x @ x)), math.sqrt(float(y @ y))
    if own * other == 0:
        return 0.0, 0.0
    # The ratio of the norms is not biased towards 0 by noise in x, as least squares would be
    return math.copysign(other / own, best), best / (own * other)


def _check_velocity(log: Log) -> None:
    """Raise ValueError if velocities contradict the positions."""
    if VELOCITY[0] not in log:
        return
    for place, name in zip(POSITION, VELOCITY, strict=True):
        moved = np.gradient(log.columns[place], log.time)
        slope, fit = _regress(_running_mean(moved), _running_mean(log.columns[name]))
        if np.std(_running_mean(moved)) > 0.1 and (abs(fit) < 0.5 or not 0.5 < slope < 2):
            raise log_error(
                log,
                f"{name} is {slope:.3g} times the velocity of {place} (correlation {fit:.2f}): "
                f"m/s in world axes are needed; leave it out to have {place} differentiated",
            )


def _running_mean(values: np.ndarray) -> np.ndarray:
    """Return the running mean over nine samples."""
    return np.convolve(values, np.ones(9) / 9, mode="same")


def _check_force(log: Log) -> None:
    """Raise ValueError if the specific force is implausible in m/s^2."""
    if FORCE[0] not in log:
        return
    median = float(np.median(np.linalg.norm(log.stack(FORCE), axis=1)))
    if 0.5 < median < 2:
        raise log_error(
            log,
            f"ax, ay, az are {median:.3g} long for half of the log: m/s^2 are needed; a hovering "
            f"drone measures 9.8; --map ax=ax*g, and so on",
        )
    if not 0.4 < median / STANDARD_GRAVITY < 2.5:
        raise log_error(
            log, f"ax, ay, az are {median:.3g} long for half of the log: m/s^2 are needed"
        )


def _check_commands(log: Log, airframe: Airframe) -> None:
    """Raise ValueError if the commands cannot carry the airframe."""
    kind = log.kind
    commands = log.stack([f"{kind}{r + 1}" for r in range(len(airframe.rotors))])
    flying = commands.min(axis=1) > 0
    if flying.sum() < 2:
        raise log_error(log, f"{kind}1 and the others are 0: there is no flight in this log")
    median = float(np.median(commands[flying]))
    if kind == "pwm":
        _check_pwm(log, airframe, median)
        return
    hover = airframe.hover_speed()
    scale = RPM if kind == "rpm" else 1.0
    weights = (median * scale / hover) ** 2
    if THRUST_BOUNDS[0] < weights < THRUST_BOUNDS[1]:
        return
    remedy = f"check that {airframe.name} is the airframe that flew"
    for other, factor in (("rpm", RPM), ("w", 1.0)):
        fits = THRUST_BOUNDS[0] < (median * factor / hover) ** 2 < THRUST_BOUNDS[1]
        if other != kind and fits:
            remedy = (
                f"if these are {'1/min' if other == 'rpm' else 'rad/s'}: --map {other}1={kind}1"
            )
    raise log_error(
        log,
        f"{kind}1 and the others are {median:.5g} for half of the flight, and {airframe.name} "
        f"hovers at {hover / scale:.5g} {'1/min' if kind == 'rpm' else 'rad/s'}: {remedy}",
    )


def _check_pwm(log: Log, airframe: Airframe, median: float) -> None:
    """Raise ValueError if motor commands are outside the range of the airframe's PWM map."""
    if airframe.pwm is None:
        raise log_error(
            log,
            f"the log has pwm1, but {airframe.name} has no <pwm> in its URDF: log rotor speeds "
            f"as w1 or rpm1, or add the map",
        )
    if not 0.5 * airframe.pwm.minimum < median <= airframe.pwm.maximum:
        raise log_error(
            log,
            f"pwm1 and the others are {median:.5g} for half of the flight: {airframe.name} takes "
            f"{airframe.pwm.minimum:g} to {airframe.pwm.maximum:g}; pass --map pwm1=pwm1*FACTOR",
        )


def check_distinct_logs(paths: Sequence[Path]) -> None:
    """Raise ValueError if a log is given twice."""
    twice = [path for path in paths if paths.count(path) > 1]
    if twice:
        raise ValueError(f"the log {twice[0]} is given twice")
