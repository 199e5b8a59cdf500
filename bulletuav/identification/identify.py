"""Fits constants of an airframe to flight logs, and tells how well it then predicts flights."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bulletuav.errors import finite
from bulletuav.identification.battery import BatteryFit, fit_battery
from bulletuav.identification.checks import checked, require_same_logs
from bulletuav.identification.constants import BATTERY, GROUND, Constant, choose_constants
from bulletuav.identification.errors import DELAY, OFFSETS, Errors, errors_of, naive_errors
from bulletuav.identification.fit import Fit, Part, Progress
from bulletuav.identification.fitting import Fitting, halves, own_numbers, silent, split
from bulletuav.identification.flight import prepare
from bulletuav.identification.logs import OTHER, parse_map, read_log
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import MAX_MASS, load_airframe

WINDOW = 0.5
"""Usual duration of a window, s"""
LOW = 0.63
"""Share of its reach below which windows tell of the ground effect: there it is 5 % of itself"""
FEWEST_LOW = 20
"""Fewest such windows: a few take-offs tell more of the touch of the ground than of its effect"""
DIGITS = 5
"""Significant digits of constants that were fitted"""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A constant before and after.

    Attributes:
        constant: What it is.
        before: The airframe's own value.
        after: The fitted value; the airframe's own where logs do not tell it.
        low: Lower end of the interval.
        high: Upper end of the interval.
        told: Whether the logs tell it. Where not, it stays what it was.
    """

    constant: Constant
    before: float
    after: float
    low: float
    high: float
    told: bool


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Windows of one log, and the errors of predictions in them.

    Attributes:
        part: The windows.
        naive: Errors if velocity and rates stay what they are.
        before: Errors with the airframe as it was.
        after: Errors with the airframe as it is now.
        offsets: (7,) the log's own numbers, with the airframe as it is now.
        offsets_before: (7,) the same with the airframe as it was.
    """

    part: Part
    naive: Errors
    before: Errors
    after: Errors
    offsets: np.ndarray
    offsets_before: np.ndarray

    @property
    def delay(self) -> float:
        """How late commands arrive, s."""
        return float(DELAY * self.offsets[0])


@dataclasses.dataclass(frozen=True)
class Identification:
    """Result of `identify`.

    Attributes:
        before: The airframe as it was.
        airframe: The airframe with what was fitted.
        estimates: The constants.
        fitted: Predictions in what was fitted.
        kept: Predictions in what was kept back.
        battery: Constants of the battery, where they were fitted.
        whole_logs: Whether whole logs were kept back; else blocks of the one log.
        window: Duration of a window, s.
        note: What else was changed; empty for nothing.
    """

    before: Airframe
    airframe: Airframe
    estimates: Sequence[Estimate]
    fitted: Sequence[Prediction]
    kept: Sequence[Prediction]
    battery: BatteryFit | None
    whole_logs: bool
    window: float
    note: str


def identify(
    logs: Sequence[str | Path],
    airframe: str | Path | Airframe,
    *,
    fit: Sequence[str] = (),
    columns: Iterable[str] = (),
    mass: float | None = None,
    window: float = WINDOW,
    progress: Progress = silent,
) -> Identification:
    """Fit constants of an airframe to flight logs.

    Of one log, every other block of windows is fitted; of several, every other log. The rest is
    kept back, and tells how good the predictions are.

    Args:
        logs: CSV files, see `bulletuav.identification.logs`.
        airframe: The drone that flew: a name, the path of a URDF, or the airframe.
        fit: Names of constants or groups; none for all that the logs tell.
        columns: Texts NAME=COLUMN[*FACTOR][+OFFSET] for columns of other names and units.
        mass: Mass that flew, kg; the airframe's own when left out. Forces scale with it.
        window: Duration of the flights that are predicted, s.
        progress: Called with the share that is done.

    Returns:
        The airframe with what was fitted, and how well it predicts.

    Raises:
        FileNotFoundError: There is no such log.
        ValueError: A log is broken or tells nothing, or a name is unknown.
    """
    drone = load_airframe(airframe)
    if mass is not None:
        drone = dataclasses.replace(drone, mass=finite("mass", mass, 1e-3, MAX_MASS))
    window = finite("window", window, 0.1, 5.0)
    sources = parse_map(columns)
    require_same_logs([Path(log) for log in logs])
    read = [checked(read_log(log, sources, len(drone.rotors)), drone) for log in logs]
    has_other = all(OTHER[0] in log for log in read)
    has_volts = all(log.kind == "pwm" and "vbat" in log for log in read)
    constants = choose_constants(fit, has_other, has_volts)
    flights = []
    for k, log in enumerate(read):
        flights.append(prepare(log, drone, window))
        progress(0.1 * (k + 1) / len(read))
    parts, kept = split(flights)
    if not fit and low_windows(parts, drone) < FEWEST_LOW:
        constants = [constant for constant in constants if constant.group != GROUND]
    free = np.array([name != "gain" or len(logs) > 1 for name in OFFSETS])
    found = Fitting(parts, drone, free, bool(fit), progress).run(constants)
    fitted_airframe, note = _possible(_rounded(found.airframe, found.constants), found.constants)
    battery = None
    if not fit or BATTERY in fit:
        battery = fit_battery(read, fitted_airframe, required=BATTERY in fit)
        if battery is not None:
            fitted_airframe = battery.put(fitted_airframe)
    predictions = _predictions(parts, kept, drone, fitted_airframe, free, len(logs) > 1, progress)
    return Identification(
        before=drone,
        airframe=fitted_airframe,
        estimates=_estimates(constants, found, drone, fitted_airframe),
        fitted=predictions[0],
        kept=predictions[1],
        battery=battery,
        whole_logs=len(logs) > 1,
        window=window,
        note=note,
    )


def low_windows(parts: Sequence[Part], airframe: Airframe) -> int:
    """Count the windows near the ground, where its effect is felt."""
    count = 0
    for part in parts:
        height = part.flight.track.position[part.flight.windows[part.windows], 2]
        count += int((height < LOW * airframe.ground_effect_reach).sum())
    return count


def _predictions(
    parts: list[Part],
    kept: list[Part],
    before: Airframe,
    after: Airframe,
    free: np.ndarray,
    whole_logs: bool,
    progress: Progress,
) -> tuple[list[Prediction], list[Prediction]]:
    """Predict what was fitted and what was kept; every airframe gets numbers of each log's own.

    In logs that were kept as a whole these are fitted to every other block, and the errors are
    those in the others.
    """
    own = [own_numbers(parts, drone, free) for drone in (before, after)]
    progress(0.95)
    kept_own = own
    if whole_logs:
        pairs = [halves(part.flight) for part in kept]
        fitted = [first for first, _ in pairs]
        kept = [second for _, second in pairs]
        kept_own = [own_numbers(fitted, drone, free) for drone in (before, after)]
    progress(1.0)
    return (
        [_predict(part, before, after, a, b) for part, a, b in zip(parts, *own, strict=True)],
        [_predict(part, before, after, a, b) for part, a, b in zip(kept, *kept_own, strict=True)],
    )


def _predict(
    part: Part,
    before: Airframe,
    after: Airframe,
    own_before: np.ndarray,
    own: np.ndarray,
) -> Prediction:
    """Predict one part with both airframes."""
    return Prediction(
        part=part,
        naive=naive_errors(part.flight, part.windows),
        before=errors_of(part.flight, part.windows, before, own_before),
        after=errors_of(part.flight, part.windows, after, own),
        offsets=own,
        offsets_before=own_before,
    )


def _rounded(airframe: Airframe, constants: Iterable[Constant]) -> Airframe:
    """Round what was fitted to the digits that are written."""
    for constant in constants:
        airframe = constant.put(airframe, float(f"{constant.get(airframe):.{DIGITS}g}"))
    return airframe


def _possible(airframe: Airframe, constants: Sequence[Constant]) -> tuple[Airframe, str]:
    """Make the inertia one that a body can have, and tell if it was changed."""
    x, y, z = airframe.inertia
    names = {constant.name for constant in constants}
    if z <= x + y or "inertia_z" in names:
        return airframe, ""
    # Yaw tells but the quotient of torque ratio and inertia: both are taken down
    most = float(f"{0.99 * (x + y):.{DIGITS}g}")
    ratio = airframe.torque_ratio * most / z
    ratio = float(f"{ratio:.{DIGITS}g}")
    note = (
        f"inertia_z of {z:g} kg m^2 is more than inertia_x + inertia_y, which no body has: it and "
        f"torque_ratio were taken down together, to {most:g} kg m^2 and {ratio:g} m."
    )
    changed = dataclasses.replace(airframe, inertia=(x, y, most), torque_ratio=ratio)
    return changed, note


def _estimates(
    constants: list[Constant],
    found: Fit,
    before: Airframe,
    after: Airframe,
) -> list[Estimate]:
    """Put together what was before and after."""
    ends = {}
    for constant, number, deviation in zip(
        found.constants, found.numbers, found.deviation, strict=True
    ):
        reach = found.quantile * deviation
        ends[constant.name] = (constant.decode(number - reach), constant.decode(number + reach))
    estimates = []
    for constant in constants:
        own = constant.get(before)
        low, high = ends.get(constant.name, (float("nan"),) * 2)
        told = constant.name in ends
        estimates.append(Estimate(constant, own, constant.get(after), low, high, told))
    return estimates
