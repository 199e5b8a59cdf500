"""Identification of a battery's resistance and capacity from voltage and current in flight."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from bulletuav.compiled.kernel import kernel
from bulletuav.identification.fit import SOFT_L1_SCALE
from bulletuav.identification.intervals import MAX_HALF_WIDTH, newey_west, quantile
from bulletuav.identification.logs import Log
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.battery import WATT_HOUR, loaded_voltage, resting_voltage

PERIOD = 0.1
"""Interval between the voltages that are compared, s"""
BLOCK = 20
"""Number of voltages in a block, whose scores are summed for the covariance: 2 s"""
DIGITS = 5
"""Significant digits of fitted constants"""
MIN_RESISTANCE = 1e-3
"""Initial resistance of the fit for a battery that has none, ohm"""


@dataclasses.dataclass(frozen=True)
class BatteryFit:
    """Fitted resistance and capacity of a battery.

    Attributes:
        resistance: Internal resistance, ohm: estimate, lower and upper end of its interval.
        capacity: Energy of the full battery, W h: estimate, lower and upper end of its interval.
        is_identified: Whether the logs determine the resistance, and the capacity.
        error: RMS error of the voltage, V, over the fitted blocks and over the held-out blocks.
        start: State of charge at the start of each log, (L,), from 0 to 1.
    """

    resistance: tuple[float, float, float]
    capacity: tuple[float, float, float]
    is_identified: tuple[bool, bool]
    error: tuple[float, float]
    start: np.ndarray

    def apply_to(self, airframe: Airframe) -> Airframe:
        """Return the airframe with the fitted constants that the logs determine."""
        assert airframe.pack is not None
        pack = airframe.pack
        if self.is_identified[0]:
            pack = dataclasses.replace(pack, resistance=self.resistance[0])
        if self.is_identified[1]:
            pack = dataclasses.replace(pack, capacity=self.capacity[0])
        return dataclasses.replace(airframe, pack=pack)


@kernel
def predict_voltages(
    power: np.ndarray,
    dt: float,
    cells: float,
    start: float,
    energy: float,
    resistance: float,
    volts: np.ndarray,
) -> None:
    """Predict the voltage of a battery from the power that is drawn.

    Args:
        power: Power drawn from the battery, (n,), W.
        dt: Sample interval, s.
        cells: Number of cells in series.
        start: Initial state of charge, from 0 to 1.
        energy: Energy of the full battery, J.
        resistance: Internal resistance, ohm.
        volts: Output: voltages, (n,), V.
    """
    charge = start
    for k in range(power.size):
        rest = cells * resting_voltage(charge)
        volts[k] = loaded_voltage(rest, power[k], resistance)
        charge -= power[k] * dt / energy


def fit_battery(
    logs: Sequence[Log], airframe: Airframe, required: bool = False
) -> BatteryFit | None:
    """Fit a battery's resistance and capacity to the logs that contain voltage and current.

    Every second block of 2 s of each log is fitted, and the other blocks are held out.

    Args:
        logs: The flight logs.
        airframe: The airframe, whose battery is the initial guess.
        required: Whether to raise an error if the battery cannot be fitted.

    Returns:
        The fitted constants, or None if no log contains voltage and current, or the airframe has no
        battery.

    Raises:
        ValueError: If `required` is True and the battery cannot be fitted.
    """
    having = [log for log in logs if "vbat" in log and "current" in log]
    if not having or airframe.pack is None:
        if not required:
            return None
        lacks = "the columns vbat and current" if not having else "a <battery> in the URDF"
        raise ValueError(f"--fit battery needs {lacks}")
    runs = [_resample(log) for log in having]
    pack = airframe.pack
    fitted = np.concatenate([np.arange(len(volts)) // BLOCK % 2 == 0 for volts, _ in runs])

    def errors(theta: np.ndarray) -> np.ndarray:
        found = []
        for (volts, power), start in zip(runs, theta[2:], strict=True):
            predicted = np.empty_like(volts)
            energy = WATT_HOUR * pack.capacity * np.exp(theta[1])
            ohm = max(pack.resistance, MIN_RESISTANCE) * np.exp(theta[0])
            predict_voltages(power, PERIOD, float(pack.cells), start, energy, ohm, predicted)
            found.append(predicted - volts)
        return np.concatenate(found)

    def residuals(theta: np.ndarray) -> np.ndarray:
        # The weak prior on the constants keeps unobservable ones near their initial values
        return np.concatenate([errors(theta)[fitted] / 0.01, theta[:2]])

    start = np.concatenate([np.zeros(2), np.full(len(runs), 0.9)])
    low = np.concatenate([np.full(2, -3.0), np.zeros(len(runs))])
    high = np.concatenate([np.full(2, 3.0), np.ones(len(runs))])
    solution = least_squares(
        residuals, start, bounds=(low, high), loss="soft_l1", f_scale=SOFT_L1_SCALE, x_scale="jac"
    )
    theta = solution.x
    deviation, half_width = _standard_deviations(residuals, theta)
    error = errors(theta)
    rms = (float(np.sqrt(np.mean(error[part] ** 2))) for part in (fitted, ~fitted))
    own = (max(pack.resistance, MIN_RESISTANCE), pack.capacity)
    return BatteryFit(
        resistance=_confidence_interval(own[0], theta[0], half_width * deviation[0]),
        capacity=_confidence_interval(own[1], theta[1], half_width * deviation[1]),
        is_identified=(
            bool(half_width * deviation[0] < MAX_HALF_WIDTH),
            bool(half_width * deviation[1] < MAX_HALF_WIDTH),
        ),
        error=(next(rms), next(rms)),
        start=theta[2:],
    )


def _confidence_interval(
    own: float, number: float, half_width: float
) -> tuple[float, float, float]:
    """Convert the logarithm of a ratio and its half width to a value and its interval's ends."""
    values = own * np.exp([number, number - half_width, number + half_width])
    middle, low, high = (float(f"{value:.{DIGITS}g}") for value in values)
    return middle, low, high


def _resample(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Resample a log to equally spaced voltages (V) and powers (W)."""
    time = log.time
    grid = np.arange(time[0], time[-1], PERIOD)
    volts = np.interp(grid, time, log.columns["vbat"])
    current = np.interp(grid, time, log.columns["current"])
    return volts, volts * np.maximum(current, 0.0)


def _standard_deviations(residuals: object, theta: np.ndarray) -> tuple[np.ndarray, float]:
    """Return robust standard deviations of the parameters, and the quantile for intervals."""
    assert callable(residuals)
    base = residuals(theta)
    step = 1e-5
    slopes = np.stack(
        [(residuals(theta + step * unit) - base) / step for unit in np.eye(len(theta))], axis=1
    )
    stretch = 1 + (base / SOFT_L1_SCALE) ** 2
    scores = (stretch**-0.5 * base)[:, None] * slopes
    bread = (stretch**-1.5 * slopes.T) @ slopes
    count = -(-len(scores) // BLOCK)
    blocks = np.add.reduceat(scores, np.arange(0, len(scores), BLOCK))
    meat = newey_west(blocks) + np.diag([1.0, 1.0, *np.zeros(len(theta) - 2)])
    inverse = np.linalg.pinv(bread)
    covariance = inverse @ meat @ inverse * count / max(count - len(theta), 1)
    return np.sqrt(np.diag(covariance)), quantile(count, len(theta))
