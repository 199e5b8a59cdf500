"""Identification of airframe constants from flight logs, with held-out prediction errors."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bulletuav.errors import finite
from bulletuav.identification.battery import BatteryFit, fit_battery
from bulletuav.identification.checks import check_distinct_logs, check_log, require_no_wings
from bulletuav.identification.constants import (
    BATTERY,
    GROUND,
    MOTOR_GAINS,
    Constant,
    choose_constants,
)
from bulletuav.identification.errors import (
    CLOCKS,
    DELAY_UNIT,
    LOG_PARAMETERS,
    PredictionErrors,
    compute_errors,
    compute_naive_errors,
)
from bulletuav.identification.fit import Fit, FlightPart, Progress
from bulletuav.identification.fitting import (
    StepwiseFit,
    fit_log_parameters,
    ignore_progress,
    split_blocks,
    split_flights,
)
from bulletuav.identification.flight import MAX_GYRO_DELAY, prepare_log
from bulletuav.identification.formats import read_flight_log
from bulletuav.identification.logs import OTHER, POSITION, VELOCITY, parse_map
from bulletuav.identification.motor_gains import (
    describe_missing_gains,
    make_even,
    make_gain_constants,
    make_uneven,
)
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import MAX_MASS, load_airframe

WINDOW = 0.5
"""Default duration of a window, s"""
LOW_HEIGHT_FRACTION = 0.63
"""Fraction of the reach below which the ground effect exceeds 5 % and can be fitted"""
MIN_LOW_WINDOWS = 20
"""Minimum number of windows in ground effect: fewer show take-offs, not the effect"""
DIGITS = 5
"""Significant digits of fitted constants"""
CLOCK_RESOLUTION = 1.5e-4
"""Standard deviation that is added to that of a clock offset, s, see `Constant.resolution`. In fits
to 10 simulated logs of 30 s, errors were 0.15 ms and their estimated deviations 0.12 ms without it.
"""


@dataclasses.dataclass(frozen=True)
class ConstantEstimate:
    """A constant before and after the fit.

    Attributes:
        constant: The constant.
        before: The airframe's own value.
        after: The fitted value, or the airframe's own value if the constant is not identified.
        low: Lower end of the interval.
        high: Upper end of the interval.
        is_identified: Whether the logs determine the constant. If not, it keeps its value.
    """

    constant: Constant
    before: float
    after: float
    low: float
    high: float
    is_identified: bool


@dataclasses.dataclass(frozen=True)
class ClockOffset:
    """Delay of the positions or velocities of a fitted log behind its attitude.

    Attributes:
        log: Name of the log's file.
        quantity: "position" or "velocity". Velocities that are computed from positions have the
            delay of the positions.
        delay: Delay, s.
        low: Lower end of the interval, s.
        high: Upper end of the interval, s.
    """

    log: str
    quantity: str
    delay: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Windows of one log, and the errors of predictions in these windows.

    Attributes:
        part: The windows.
        naive: Errors of a prediction with constant velocity and rates.
        before: Errors with the initial airframe.
        after: Errors with the fitted airframe.
        log_parameters: Per-log parameters, (9,), with the fitted airframe.
        log_parameters_before: Per-log parameters, (9,), with the initial airframe.
    """

    part: FlightPart
    naive: PredictionErrors
    before: PredictionErrors
    after: PredictionErrors
    log_parameters: np.ndarray
    log_parameters_before: np.ndarray

    @property
    def delay(self) -> float:
        """Delay of the commands, s."""
        return float(DELAY_UNIT * self.log_parameters[0])


@dataclasses.dataclass(frozen=True)
class Identification:
    """Result of `identify`.

    Attributes:
        before: The initial airframe.
        airframe: The fitted airframe.
        estimates: The constants.
        fitted: Predictions in the fitted windows.
        kept: Predictions in the held-out windows.
        battery: Fitted constants of the battery, or None if they were not fitted.
        whole_logs: Whether whole logs were held out; otherwise blocks of the single log.
        window: Duration of a window, s.
        note: Description of further changes; empty if there are none.
        clocks: Clock offsets of the fitted logs; empty if they were not fitted.
    """

    before: Airframe
    airframe: Airframe
    estimates: Sequence[ConstantEstimate]
    fitted: Sequence[Prediction]
    kept: Sequence[Prediction]
    battery: BatteryFit | None
    whole_logs: bool
    window: float
    note: str
    clocks: Sequence[ClockOffset] = ()


def identify(
    logs: Sequence[str | Path],
    airframe: str | Path | Airframe,
    *,
    fit: Sequence[str] = (),
    columns: Iterable[str] = (),
    mass: float | None = None,
    window: float = WINDOW,
    measured: bool = False,
    clocks: bool = False,
    progress: Progress = ignore_progress,
) -> Identification:
    """Fit constants of an airframe to flight logs.

    With one log, every second block of windows is fitted; with several, every second log. The rest
    is held out to evaluate the predictions.

    Args:
        logs: CSV files, see `bulletuav.identification.logs`, or other formats, see
            `bulletuav.identification.formats`.
        airframe: The airframe that was flown: a name, the path of a URDF, or the airframe.
        fit: Names of constants or groups; empty for all that the logs determine. "motor_gains"
            are the thrust gains of single motors, relative to their mean. They are among the
            estimates and in the predictions, but not in the fitted airframe.
        columns: Mappings NAME=COLUMN[*FACTOR][+OFFSET] for columns with other names or units.
        mass: Mass in flight, kg; the airframe's own by default. Forces scale with it.
        window: Duration of the predicted flights, s.
        measured: Whether the rotor speeds of the logs were measured, not commanded. They are
            interpolated between samples, and the motors' lag is not applied.
        clocks: Whether to fit the delays of positions and of velocities behind the attitude, for
            logs whose position and attitude have different clocks. They are compensated.
        progress: Callback that receives the completed fraction.

    Returns:
        The fitted airframe, and its prediction errors.

    Raises:
        FileNotFoundError: If a log does not exist.
        ValueError: If a log is damaged or not informative, or a name is unknown; if `measured` is
            given for motor commands; if the airframe has wings.
    """
    drone = load_airframe(airframe)
    require_no_wings(drone)
    if mass is not None:
        drone = dataclasses.replace(drone, mass=finite("mass", mass, 1e-3, MAX_MASS))
    window = finite("window", window, 0.1, 5.0)
    sources = parse_map(columns)
    check_distinct_logs([Path(log) for log in logs])
    read = [check_log(read_flight_log(log, sources, drone), drone) for log in logs]
    has_other = all(OTHER[0] in log for log in read)
    has_volts = all(log.kind == "pwm" and "vbat" in log for log in read)
    for log in read:
        if measured and log.kind == "pwm":
            raise ValueError(
                f"{log.path}: --measured needs rotor speeds, as w1 ... or rpm1 ...: pwm1 ... are "
                f"commands"
            )
    constants = choose_constants(fit, has_other, has_volts, measured)
    start = drone
    if MOTOR_GAINS in fit:
        constants += make_gain_constants(len(drone.rotors))
        start = make_uneven(drone)
    flights = []
    for k, log in enumerate(read):
        flights.append(prepare_log(log, drone, window, measured))
        progress(0.1 * (k + 1) / len(read))
    parts, kept = split_flights(flights)
    if not fit and count_low_windows(parts, drone) < MIN_LOW_WINDOWS:
        constants = [constant for constant in constants if constant.group != GROUND]
    is_free = dict.fromkeys(LOG_PARAMETERS, True) | dict.fromkeys(CLOCKS, clocks)
    is_free["gain"] = len(logs) > 1
    is_free["velocity_delay"] = clocks and any(VELOCITY[0] in log for log in read)
    free = np.array([is_free[name] for name in LOG_PARAMETERS])
    found = StepwiseFit(parts, start, free, bool(fit), progress).run(constants)
    offsets = _find_clock_offsets(parts, found, free)
    fitted_airframe, note = _limit_yaw_inertia(
        _round_constants(found.airframe, found.constants), found.constants
    )
    battery = None
    if not fit or BATTERY in fit:
        battery = fit_battery(read, fitted_airframe, required=BATTERY in fit)
        if battery is not None:
            fitted_airframe = battery.apply_to(fitted_airframe)
    predictions = _predictions(parts, kept, drone, fitted_airframe, free, len(logs) > 1, progress)
    estimates = _make_estimates(constants, found, drone, fitted_airframe)
    gains = [one.after for one in estimates if one.constant.group == MOTOR_GAINS]
    if gains:
        note = " ".join(filter(None, (note, describe_missing_gains(gains))))
    return Identification(
        before=drone,
        airframe=make_even(fitted_airframe),
        estimates=estimates,
        fitted=predictions[0],
        kept=predictions[1],
        battery=battery,
        whole_logs=len(logs) > 1,
        window=window,
        note=note,
        clocks=offsets,
    )


def _find_clock_offsets(
    parts: Sequence[FlightPart], found: Fit, free: np.ndarray
) -> list[ClockOffset]:
    """Return the clock offsets of the fitted logs; raise ValueError if one is too large."""
    offsets = []
    for part, own, deviations in zip(
        parts, found.log_parameters, found.log_parameter_deviation, strict=True
    ):
        log = part.flight.log
        for name in CLOCKS:
            place = LOG_PARAMETERS.index(name)
            quantity = name.removesuffix("_delay")
            if not free[place] or (quantity == "velocity" and VELOCITY[0] not in log):
                continue
            delay = float(DELAY_UNIT * own[place])
            if abs(delay) >= MAX_GYRO_DELAY:
                columns = ", ".join(VELOCITY if quantity == "velocity" else POSITION)
                raise ValueError(
                    f"{log.path}: the clock of the {quantity} is {MAX_GYRO_DELAY:g} s or more off "
                    f"that of the attitude: shift {columns} by the known delay first"
                )
            # Deviations are those of the free parameters only
            deviation = DELAY_UNIT * deviations[free[:place].sum()]
            half_width = found.quantile * float(np.hypot(deviation, CLOCK_RESOLUTION))
            ends = (delay - half_width, delay + half_width)
            offsets.append(ClockOffset(log.path.name, quantity, delay, *ends))
    return offsets


def count_low_windows(parts: Sequence[FlightPart], airframe: Airframe) -> int:
    """Count the windows in which the ground effect is noticeable."""
    count = 0
    for part in parts:
        height = part.flight.track.position[part.flight.windows[part.windows], 2]
        count += int((height < LOW_HEIGHT_FRACTION * airframe.ground_effect_reach).sum())
    return count


def _predictions(
    parts: list[FlightPart],
    kept: list[FlightPart],
    before: Airframe,
    after: Airframe,
    free: np.ndarray,
    whole_logs: bool,
    progress: Progress,
) -> tuple[list[Prediction], list[Prediction]]:
    """Predict the fitted and held-out windows with both airframes, each with per-log parameters.

    The per-log parameters of a held-out log are fitted to every second block, and its errors are
    those in the other blocks.
    """
    own = [fit_log_parameters(parts, drone, free) for drone in (before, after)]
    progress(0.95)
    kept_own = own
    if whole_logs:
        pairs = [split_blocks(part.flight) for part in kept]
        fitted = [first for first, _ in pairs]
        kept = [second for _, second in pairs]
        kept_own = [fit_log_parameters(fitted, drone, free) for drone in (before, after)]
    progress(1.0)
    return (
        [_predict(part, before, after, a, b) for part, a, b in zip(parts, *own, strict=True)],
        [_predict(part, before, after, a, b) for part, a, b in zip(kept, *kept_own, strict=True)],
    )


def _predict(
    part: FlightPart, before: Airframe, after: Airframe, own_before: np.ndarray, own: np.ndarray
) -> Prediction:
    return Prediction(
        part=part,
        naive=compute_naive_errors(part.flight, part.windows),
        before=compute_errors(part.flight, part.windows, before, own_before),
        after=compute_errors(part.flight, part.windows, after, own),
        log_parameters=own,
        log_parameters_before=own_before,
    )


def _round_constants(airframe: Airframe, constants: Iterable[Constant]) -> Airframe:
    """Round the fitted constants to `DIGITS` significant digits."""
    for constant in constants:
        airframe = constant.replace(airframe, float(f"{constant.get(airframe):.{DIGITS}g}"))
    return airframe


def _limit_yaw_inertia(airframe: Airframe, constants: Sequence[Constant]) -> tuple[Airframe, str]:
    """Reduce inertia_z to a physically possible value.

    Returns:
        The airframe, and a note on the change, empty if there is none.
    """
    x, y, z = airframe.inertia
    names = {constant.name for constant in constants}
    if z <= x + y or "inertia_z" in names:
        return airframe, ""
    # Yaw motion determines only the ratio of torque_ratio to inertia_z: both are reduced
    max_inertia_z = float(f"{0.99 * (x + y):.{DIGITS}g}")
    ratio = airframe.torque_ratio * max_inertia_z / z
    ratio = float(f"{ratio:.{DIGITS}g}")
    note = (
        f"inertia_z of {z:g} kg m^2 is more than inertia_x + inertia_y, which no body has: it and "
        f"torque_ratio were reduced together, to {max_inertia_z:g} kg m^2 and {ratio:g} m."
    )
    changed = dataclasses.replace(airframe, inertia=(x, y, max_inertia_z), torque_ratio=ratio)
    return changed, note


def _make_estimates(
    constants: list[Constant], found: Fit, before: Airframe, after: Airframe
) -> list[ConstantEstimate]:
    """Collect the values before and after the fit."""
    ends = {}
    for constant, number, deviation in zip(
        found.constants, found.theta, found.deviation, strict=True
    ):
        half_width = found.quantile * deviation
        ends[constant.name] = (
            constant.decode(number - half_width),
            constant.decode(number + half_width),
        )
    estimates = []
    for constant in constants:
        own = constant.get(before)
        low, high = ends.get(constant.name, (float("nan"),) * 2)
        is_identified = constant.name in ends
        estimates.append(
            ConstantEstimate(constant, own, constant.get(after), low, high, is_identified)
        )
    return estimates
