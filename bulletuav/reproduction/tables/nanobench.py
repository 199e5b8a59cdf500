"""NanoBench's tables of predictions, tracking errors and onboard estimates of a Crazyflie."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics.estimates import mean_estimate
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.flight_series import LogError, drop_copies, pick_evenly
from bulletuav.reproduction.nanobench_flights import (
    NANOBENCH_DT,
    NanobenchFlight,
    find_nanobench_flights,
    read_nanobench_columns,
    read_nanobench_flights,
)
from bulletuav.reproduction.nanobench_onboard import (
    ONBOARD_COLUMNS,
    compute_estimate_errors,
    compute_tracking_errors,
    drop_interpolated_rows,
    find_onboard_logs,
)
from bulletuav.reproduction.nanobench_rollouts import (
    CHANNELS,
    HORIZON,
    RATE_ROWS,
    DroneTrim,
    FlightWindows,
    calibrate_trim,
    compute_channel_errors,
    find_all_windows,
    find_flown_windows,
    hold_rates,
    predict_constant_windows,
    predict_windows,
)
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import load_airframe

FLOWN_MASS = 0.04085
"""Mass of the drone with markers and charging deck, kg (paper, section IV-B)"""
MAX_RATE = 35.0
"""Range of the gyroscope, 2000 degrees/s, in rad/s"""
WINDOWS_PER_FLIGHT = 200
TRAINING_WINDOWS = 40
UNITS = ("m", "m/s", "rad", "rad/s")
STEPS = (1, 10, 50)
"""Rows after which the paper states errors; the last number is the sum over 1 to 50"""
PUBLISHED = {
    "naive": (
        (0.0057, 0.0585, 0.2866, 7.3866),
        (0.0085, 0.0786, 0.3542, 9.4178),
        (0.0033, 0.0285, 0.0915, 2.7563),
        (0.0402, 0.2602, 0.4524, 17.1131),
    ),
    "physics": (
        (0.0003, 0.0265, 0.6364, 10.9641),
        (0.0511, 0.5085, 2.5673, 65.0322),
        (0.0019, 0.0198, 0.1425, 3.2693),
        (0.0402, 0.2602, 0.4524, 17.1131),
    ),
    "residual": (
        (0.0045, 0.0445, 0.2282, 5.6810),
        (0.0121, 0.1096, 0.6708, 16.9002),
        (0.0084, 0.1051, 0.1971, 8.8737),
        (0.2043, 1.1173, 1.3046, 54.1783),
    ),
    "physics + residual": (
        (0.0036, 0.0121, 0.2621, 4.4071),
        (0.0201, 0.1370, 1.0771, 26.7469),
        (0.0065, 0.1359, 0.1825, 9.8645),
        (0.8784, 1.5799, 1.1781, 55.3050),
    ),
    "LSTM": (
        (0.0058, 0.0332, 0.2562, 5.9194),
        (0.0199, 0.1077, 0.4782, 11.9639),
        (0.0162, 0.1339, 0.3059, 9.8302),
        (0.1256, 0.8159, 5.1525, 118.0662),
    ),
}
"""Errors in the paper's Table V, by model: position, velocity, attitude, rates"""
COLUMNS = (*(f"after {NANOBENCH_DT * step:g} s" for step in STEPS), "summed over 50 steps")
"""Columns of Table V"""
NAIVE, FLOWN_NAIVE = "naive", "naive, windows of the predictions"
GIVEN, HELD, NOMINAL = "attitude given", "rates held", "rates held, not calibrated"
FREE, OWN_TORQUE = "free", "free, torque of each flight"
"""Predictions of the package: attitude and rates of the log; constant rates, as in the paper's
physics model, with and without calibration; the whole state predicted; and that with a torque that
is calibrated on the predicted flight, which measures the effect of this torque
"""
TOLERANCE = 5e-5
"""Half a unit of the last published digit"""
TRACKING = {
    ("PID", "slow", range(13, 19)): (0.276168, 0.248845, 0.795378, 2.039820, 9.615600),
    ("PID", "medium", (12, 13, 14)): (0.292636, 0.265008, 0.859287, 0.725000, 5.824667),
    ("PID", "fast", (14,)): (0.595938, 0.558921, 0.915002, 1.944760, 8.217333),
    ("Mellinger", "slow", range(8, 13)): (0.264081, 0.243383, 0.845787, 1.203658, 4.192683),
    ("Mellinger", "medium", (7, 8, 9, 11)): (0.282839, 0.269968, 0.483625, 0.885634, 5.273119),
    ("Mellinger", "fast", (11, 12, 13)): (0.557327, 0.517413, 0.843145, 1.536481, 2.441344),
}
"""Errors of task 2 in the repository's table_task2_classical_speed_summary.csv, to six decimals;
no file names the numbers of the flights: their errors in table_task2_classical_per_run.csv do
"""
TRACKING_ERRORS = {
    "position error, root mean square": "m",
    "position error, mean": "m",
    "position error, maximum": "m",
    "velocity error, root mean square": "m/s",
    "heading error, mean": "deg",
    "position error, root mean square at the best delay": "m",
    "best delay": "s",
}
"""Units of the errors of task 2; the last two are not published"""
ESTIMATES = {
    "slow": ((21.1, 3.3), (16.5, 3.2), (28.2, 6.8), (0.069, 0.015), (2.12, 0.05)),
    "medium": ((21.8, 3.0), (17.2, 1.7), (30.3, 2.9), (0.067, 0.013), (2.71, 1.43)),
    "fast": ((3142.7, 3936.6), (2774.4, 3487.9), (384.2, 400.8), (7.629, 8.992), (29.67, 28.52)),
}
"""Means and standard deviations of task 3 over flights, in the repository's task3_trefoil_table"""
ESTIMATE_ERRORS = {
    "aligned position error, root mean square": ("mm", 0.05),
    "aligned position error, mean": ("mm", 0.05),
    "change of position within 1 m, mean error": ("mm", 0.05),
    "velocity error, root mean square": ("m/s", 5e-4),
    "attitude error, root mean square": ("deg", 5e-3),
}
"""Units of the errors of task 3, and half a unit of the last published digit"""
ONBOARD_NOTES = (
    "Tasks 2 and 3 score controllers and an estimator that flew on the drone: their rows need no "
    "model and only show that protocol and data are understood. Published numbers are those of the "
    "repository's result files.",
    "Task 2: the published numbers leave out four flights without stating it: their errors exceed "
    "1 m, because packets are missing as below. Much of the position error is a delay of about "
    "half a second between target and position, with both controllers and at all speeds: rows at "
    "the best delay are without it.",
    "Learned controllers of task 2, which fly in a network of the authors instead of a drone, are "
    "not computed: no model of ours would take part, the repository's list of test flights is not "
    "that of its results, and the scales of the inputs are a pickle, which is not read.",
    "Task 3: the published attitude errors subtract motion capture in rad from estimates in "
    "degrees, and two medium flights count twice. In three of seven fast flights packets are "
    "missing for up to 23 s, and the files join the numbers by straight lines, to metres off and "
    "to motor commands of 19 times the maximum: the published errors of fast flights are those of "
    "these lines. Rows called corrected compare degrees, end flights at such gaps, and count "
    "copies once.",
)
"""Notes on tasks 2 and 3"""


def _compute(settings: Settings) -> TableOutcome:
    """Predict the flights, compare the errors, and draw them."""
    assert settings.data is not None  # the command checks it
    flights, refused = _read(settings)
    # Halves first: the constants of the airframe were fitted to these training flights
    training, tested = (
        _keep_valid_rates(_thin_out(half, settings), refused)
        for half in (flights[::2], flights[1::2])
    )
    airframe = replace(load_airframe("cf2x"), mass=FLOWN_MASS)
    count = settings.count(WINDOWS_PER_FLIGHT, least=4)
    fewer = settings.count(TRAINING_WINDOWS, least=4)
    trim = calibrate_trim(_find_windows(training, fewer), airframe)
    settings.progress(0.7)
    kept = _find_windows(tested, count)
    errors, explained = _predict_all(kept, airframe, trim, settings)
    everything = [find_all_windows(flight, count) for flight in (*training, *tested)]
    errors[NAIVE] = np.stack(
        [_mean_error(one, predict_constant_windows(one)) for one in everything]
    )
    means = {name: _sum_up(values).mean(axis=0) for name, values in errors.items()}
    settings.progress(1.0)
    notes = (
        "The published numbers are Table V of the paper, which gives no list of its test flights. "
        "The windows differ, so all verdicts compare errors on different windows of these flights: "
        "naive rows, which need no model, use all windows of all readable flights, on the ground "
        "as well, and some are outside. On the windows of the predictions, in the air, sums of "
        f"naive errors are {_list_ratios(means[FLOWN_NAIVE])} of the published ones.",
        f"Predictions use {sum(len(one.starts) for one in kept)} windows in the air of every "
        f"second flight ({len(kept)}). Gain of the thrust, tilt of the markers and torque of an "
        "asymmetric drone are calibrated on all other flights together; drag and voltage map "
        "of the airframe were fitted to those flights earlier. The paper's physics model has fixed "
        "coefficients, so the rows without calibration are next to it. The best published number "
        "of a column may be that of the naive model.",
        "Rotor speeds at the start of a window follow from the earlier commands. The paper trains "
        "on a multi-sine flight; random waypoints and stairs are not read.",
        f"Free predictions explain {explained[0]:.0%} (roll) and {explained[1]:.0%} (pitch) of the "
        "variance of changes of body rates within 0.1 s, and within flights "
        f"{explained[2]:.0%} and {explained[3]:.0%}: the torque of the drone differs between "
        "flights. With the torque of each flight, calibrated on the flight itself, errors after "
        f"0.5 s are {means[OWN_TORQUE][2, 1]:.2f} instead of {means[FREE][2, 1]:.2f} m/s and "
        f"{means[OWN_TORQUE][2, 2]:.2f} instead of {means[FREE][2, 2]:.2f} rad.",
        f"Not usable: {len(refused)} flights.",
        *ONBOARD_NOTES,
    )
    return TableOutcome(
        [
            *_list_rows(errors),
            *_list_tracking_rows(settings.data, settings),
            *_list_estimate_rows(settings.data, settings),
        ],
        _draw(errors),
        notes,
        extra={
            "refused": refused,
            "gain": trim.gain,
            "tilt_rad": trim.tilt,
            "torque_n_m": trim.torque,
            "explained_variance": explained,
            "published": PUBLISHED,
            "means": {name: values.T.tolist() for name, values in means.items()},
        },
    )


def _read(settings: Settings) -> tuple[list[NanobenchFlight], list[str]]:
    """Read the flights, and the reasons why others cannot be used."""
    assert settings.data is not None
    paths = find_nanobench_flights(settings.data)
    flights: list[NanobenchFlight] = []
    refused: list[str] = []
    for k, path in enumerate(paths):
        some, reasons = read_nanobench_flights([path])
        flights += some
        refused += reasons
        settings.progress(0.4 * (k + 1) / len(paths))
    return flights, refused


def _thin_out(half: Sequence[NanobenchFlight], settings: Settings) -> list[NanobenchFlight]:
    """Pick the flights of a half at this size."""
    picked = pick_evenly(np.arange(len(half)), settings.count(len(half), least=2))
    return [half[index] for index in picked]


def _keep_valid_rates(
    flights: Sequence[NanobenchFlight], refused: list[str]
) -> list[NanobenchFlight]:
    """Drop flights whose gyroscope exceeds its range, and add the reasons to a list."""
    kept = []
    for flight in flights:
        fastest = float(np.abs(flight.rates).max())
        if fastest > MAX_RATE:
            refused.append(f"{flight.name}: gyroscope up to {fastest:.0f} rad/s")
        else:
            kept.append(flight)
    return kept


def _find_windows(flights: Sequence[NanobenchFlight], count: int) -> list[FlightWindows]:
    """Find windows of flights.

    Raises:
        LogError: If there are none.
    """
    found = [find_flown_windows(flight, count) for flight in flights]
    found = [windows for windows in found if len(windows.starts)]
    if not found:
        names = ", ".join(flight.name for flight in flights) or "none"
        raise LogError(
            "no flight of half a second in one half of the data, every second readable flight "
            f"({names}); fetch it again"
        )
    return found


def _predict_all(
    kept: Sequence[FlightWindows], airframe: Airframe, trim: DroneTrim, settings: Settings
) -> tuple[dict[str, np.ndarray], list[float]]:
    """Predict windows in all modes.

    Returns:
        Mean errors of each flight by mode, (F, HORIZON, 4), and the explained fractions of the
        variance of changes of roll and pitch rate within `RATE_ROWS` rows: over all flights, and
        within flights.
    """
    held = hold_rates(airframe)
    errors: dict[str, list[np.ndarray]] = {}
    changes, deviations = [], []
    for k, windows in enumerate(kept):
        own = replace(trim, torque=calibrate_trim([windows], airframe).torque)
        for name, model, its, is_guided in (
            (GIVEN, airframe, trim, True),
            (HELD, held, trim, False),
            (NOMINAL, held, DroneTrim(), False),
            (OWN_TORQUE, airframe, own, False),
            (FREE, airframe, trim, False),
        ):
            states = predict_windows(windows, model, its, is_guided)
            errors.setdefault(name, []).append(_mean_error(windows, states, its))
        naive = _mean_error(windows, predict_constant_windows(windows))
        errors.setdefault(FLOWN_NAIVE, []).append(naive)
        rates, starts = windows.flight.rates, windows.starts
        # The last states are those of the free prediction
        ends = np.stack([rates[starts + RATE_ROWS], states[:, RATE_ROWS - 1, 10:]])
        change = ends - rates[starts]
        changes.append(change)
        deviations.append(change - change.mean(axis=1, keepdims=True))
        settings.progress(0.7 + 0.25 * (k + 1) / len(kept))
    explained = []
    for samples in (changes, deviations):
        measured, predicted = np.concatenate(samples, axis=1)
        explained += [_explain(measured[:, axis], predicted[:, axis]) for axis in (0, 1)]
    return {name: np.stack(values) for name, values in errors.items()}, explained


def _explain(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Return the squared coefficient of correlation, 0 for constant series."""
    variance = np.var(measured) * np.var(predicted)
    covariance = np.mean((measured - measured.mean()) * (predicted - predicted.mean()))
    return float(covariance**2 / variance) if variance > 0 else 0.0


def _mean_error(
    windows: FlightWindows, states: np.ndarray, trim: DroneTrim | None = None
) -> np.ndarray:
    """Return the mean errors over the windows of one flight, (HORIZON, 4)."""
    tilt = (0.0, 0.0) if trim is None else trim.tilt
    mean: np.ndarray = compute_channel_errors(windows, states, tilt).mean(axis=0)
    return mean


def _sum_up(values: np.ndarray) -> np.ndarray:
    """Return the columns of Table V of each flight, (F, columns, 4), from (F, HORIZON, 4)."""
    after = values[:, np.array(STEPS) - 1]
    return np.concatenate([after, values.sum(axis=1, keepdims=True)], axis=1)


def _list_ratios(means: np.ndarray) -> str:
    """Format the ratios of the sums of naive errors to the published ones."""
    published = [errors[-1] for errors in PUBLISHED["naive"]]
    return ", ".join(
        f"{ours / theirs:.0%} ({name})"
        for name, ours, theirs in zip(CHANNELS, means[-1], published, strict=True)
    )


def find_best_model(channel: int, column: int) -> str:
    """Return the published model with the smallest error, the first one of equal ones."""
    return min(PUBLISHED, key=lambda model: PUBLISHED[model][channel][column])


DIFFERENT_TORQUE = (
    "the torque of the drone differs between flights, but one torque is calibrated for all: with "
    "the torque of each flight at least three quarters of the difference disappear"
)
"""Explanation of errors for which it is true"""


def _is_removed(error: float, smaller: float, published: float | None) -> bool:
    """Check whether a smaller error removes three quarters of the excess over a published one."""
    return published is not None and error - smaller >= 0.75 * (error - published) > 0.0


def _list_rows(errors: dict[str, np.ndarray]) -> list[Row]:
    """List the errors next to the published ones."""
    columns = {mode: _sum_up(values) for mode, values in errors.items()}
    own, free = (columns[mode].mean(axis=0) for mode in (OWN_TORQUE, FREE))
    rows = []
    for mode, opponent, channels in (
        (NAIVE, "naive", range(4)),
        (FLOWN_NAIVE, "naive", range(4)),
        (NOMINAL, "physics", range(4)),
        (HELD, "best", range(4)),
        (FREE, "best", range(4)),
        (GIVEN, "", range(2)),
    ):
        for channel in channels:
            for k, column in enumerate(COLUMNS):
                model = find_best_model(channel, k) if opponent == "best" else opponent
                best = "best, " if opponent == "best" else ""
                against = (
                    f" (published: {best}{model})" if model not in ("", "naive") or best else ""
                )
                published = PUBLISHED[model][channel][k] if model else None
                is_torque = mode == FREE and _is_removed(
                    free[k, channel], own[k, channel], published
                )
                mean, low, high, _ = mean_estimate(columns[mode][:, k, channel].tolist())
                rows.append(
                    Row(
                        f"{mode}: {CHANNELS[channel]} {column}{against}",
                        mean,
                        published,
                        # Sums over steps have the unit of the error
                        UNITS[channel],
                        low,
                        high,
                        TOLERANCE,
                        "equal" if opponent == "naive" else "lower",
                        DIFFERENT_TORQUE if is_torque else "",
                    )
                )
    return rows


def _read_onboard(paths: Sequence[Path], settings: Settings) -> list[np.ndarray]:
    """Read the flights of a group, fewer at a smaller size."""
    picked = pick_evenly(np.arange(len(paths)), settings.count(len(paths)))
    return [read_nanobench_columns(paths[index], ONBOARD_COLUMNS) for index in picked]


def _list_tracking_rows(folder: Path, settings: Settings) -> list[Row]:
    """List the tracking errors of the flown controllers (task 2)."""
    rows = []
    for (controller, speed, flights), published in TRACKING.items():
        names = [f"datasets/dataset/B9_trefoil_{speed}_rep{flight}.csv" for flight in flights]
        logs = _read_onboard(find_onboard_logs(folder, names), settings)
        means = np.mean([compute_tracking_errors(log) for log in logs], axis=0).tolist()
        rows += [
            Row(f"task 2, {controller}, {speed}: {name}", ours, theirs, unit, tolerance=5e-7)
            for (name, unit), ours, theirs in zip(
                TRACKING_ERRORS.items(), means, (*published, None, None), strict=True
            )
        ]
    return rows


def _list_estimate_rows(folder: Path, settings: Settings) -> list[Row]:
    """List the errors of the onboard estimates (task 3), as published and corrected."""
    rows = []
    for speed, published in ESTIMATES.items():
        name = f"benchmarks/task3_stateEst/*_trefoil/B9_trefoil_{speed}_rep*.csv"
        paths = find_onboard_logs(folder, [name])
        errors = [compute_estimate_errors(log) for log in _read_onboard(paths, settings)]
        received = map(drop_interpolated_rows, _read_onboard(drop_copies(paths), settings))
        corrected = [compute_estimate_errors(log, True) for log in received]
        for k, (error, (unit, tolerance)) in enumerate(ESTIMATE_ERRORS.items()):
            values = [one[k] for one in errors]
            for kind, ours, theirs in (
                ("", np.mean(values), published[k][0]),
                (", standard deviation", np.std(values), published[k][1]),
                (", corrected", np.mean([one[k] for one in corrected]), None),
            ):
                label = f"task 3, {speed}: {error}{kind}"
                rows.append(Row(label, float(ours), theirs, unit, tolerance=tolerance))
    return rows


def _draw(errors: dict[str, np.ndarray]) -> Figure:
    """Draw errors against the horizon, with the published ones as marks."""
    figure = blank_figure(11, 9)
    panels = figure.subplots(2, 2)
    seconds = NANOBENCH_DT * np.arange(1, HORIZON + 1)
    colours = {
        NAIVE: "black",
        GIVEN: "#4477aa",
        HELD: "#228833",
        NOMINAL: "#99cc88",
        FREE: "#ee7733",
        OWN_TORQUE: "#ccaa33",
    }
    marks = dict(zip(PUBLISHED, "os^vD", strict=True))
    for channel, axes in enumerate(panels.ravel()):
        for name, colour in colours.items():
            if channel > 1 and name == GIVEN:
                continue
            values = errors[name][..., channel].mean(axis=0)
            axes.plot(seconds, values, color=colour, label=f"bulletuav, {name}")
        for model, mark in marks.items():
            axes.plot(
                NANOBENCH_DT * np.array(STEPS),
                PUBLISHED[model][channel][:3],
                mark,
                color=colours[NAIVE] if model == "naive" else "#aa3377",
                fillstyle="none",
                label=f"published, {model}",
            )
        axes.set(
            xlabel="prediction horizon, s",
            ylabel=f"mean error of {CHANNELS[channel]}, {UNITS[channel]}",
            yscale="log",
        )
        axes.grid(alpha=0.3)
    labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=4, fontsize=9)
    return figure


REPRODUCTION = Reproduction(
    title="NanoBench: predictions, tracking and onboard estimates of a Crazyflie",
    publication=(
        "S. I. Ullah and J. Baca, NanoBench: A Multi-Task Benchmark Dataset for Nano-Quadrotor "
        "System Identification, Control, and State Estimation, 2026"
    ),
    address="https://arxiv.org/abs/2603.09908",
    about=(
        "Task 1, Table V: errors of open-loop predictions from motor commands, 1, 10 and 50 steps "
        "of 0.01 s ahead, on flights of a Crazyflie 2.1. The airframe cf2x predicts with the "
        "attitude of the log, with constant body rates, and with the whole state free. Tasks 2 and "
        "3: errors of tracking and of onboard estimates in flights of a trefoil, from the logs."
    ),
    minutes=1.0,
    compute=_compute,
    data=Data(
        repository="https://github.com/syediu/nanobench-iros2026",
        commit="0ae7d689749db174dc779ab2f7c416cc12e14e2b",
        licence="BSD-3-Clause",
        contains="datasets/dataset/B2_circle_fast_rep1.csv",
    ),
)
