"""Errors that the model of the wake removes on flights of pairs of drones."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics.estimates import RESAMPLES, TAIL
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.flight_series import LogError, pick_evenly
from bulletuav.reproduction.swarm_logs import SWARM_DT, is_large_drone, read_swarm_log
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome
from bulletuav.reproduction.wake_pairs import (
    FREE_DISTANCE,
    MIXED_PAIRS,
    SMALL_PAIRS,
    LowerDrone,
    align_logs,
    find_log_pairs,
    fit_wake_share,
    measure_wake,
    predict_near_wake,
    simulate_height_error,
)
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import ParameterRow, parameter_rows

SMALL, MIXED = "small above small", "large above small"
EXPERIMENTS = {SMALL: SMALL_PAIRS, MIXED: MIXED_PAIRS}
FLOWN_CONTROLLER_MASS = 0.032
"""Mass in the controller of these flights, kg (crazyflieTypes.yaml of the data)"""
STIFFNESS, DAMPING = 1.25 / FLOWN_CONTROLLER_MASS, 0.4 / FLOWN_CONTROLLER_MASS
"""Gains of the height in the controller of these flights (kp_z, kd_z), 1/s^2 and 1/s"""
SMITH_3D, SMITH_VERTICAL, LI_HEIGHT = 36.0, 56.0, 75.37
"""Published reductions of tracking errors, %: two of Smith et al., that of heights of Li et al."""
ERRORS: tuple[tuple[str, str, float | None, float], ...] = (
    ("vertical force", "vertical tracking of Smith et al.", SMITH_VERTICAL, 0.5),
    ("3-D force", "3-D tracking of Smith et al.", SMITH_3D, 0.5),
    ("height, wake fed forward", "height of Li et al.", LI_HEIGHT, 0.005),
    ("moment", "", None, 0.0),
)
"""Errors: name, published counterpart, its reduction in %, half a unit of its last digit"""
DISTANCE_EDGES = np.linspace(0.0, 0.25, 11)
DROPS_SHOWN = ((0.15, 0.3), (0.3, 0.45), (0.45, 0.7))
"""Ranges of the distance below in the picture, m"""


def _compute(settings: Settings) -> TableOutcome:
    """Measure the wakes, compare the errors with and without the model, and draw them."""
    assert settings.data is not None  # the command checks it
    row = parameter_rows([load_airframe("cf2x")])[0]
    rows: list[Row] = []
    shares: dict[str, float] = {}
    counts: dict[str, int] = {}
    shown: list[LowerDrone] = []
    left_out: dict[str, list[str]] = {}
    for k, (name, experiments) in enumerate(EXPERIMENTS.items()):
        paths = find_log_pairs(settings.data, experiments)
        fitted, _ = _measure(paths[::2], settings, 0.5 * k)
        kept, left_out[name] = _measure(paths[1::2], settings, 0.5 * k + 0.25)
        shown = shown or [one for pair in kept for one in pair]
        share = fit_wake_share([one for pair in fitted for one in pair], row)
        refitted = row.copy()
        refitted.wake_share = share
        shares[name], counts[name] = share, len(kept)
        rows += _compare(name, kept, row)
        rows += _compare(f"{name}, strength fitted", kept, refitted)
    settings.progress(1.0)
    notes = (
        "No number is comparable: published percentages are of tracking errors of other drones in "
        "flight, with and without a learned model of the wake in the controller. The flights of "
        "Smith et al. are not public, and the repository of Li et al. has their networks but no "
        "flights. Ours are of forces that Neural-Swarm measured, and of heights: a controller with "
        "the gains of these flights is simulated under the measured force, with and without the "
        "predicted force subtracted.",
        f"Every second flight is held out. Used are {_count(counts, left_out, SMALL)} of two "
        f"Crazyflies and {_count(counts, left_out, MIXED)} of a larger drone and a Crazyflie; in "
        "the others the Crazyflie flew less than a second outside of wakes, from which its mass "
        "follows, or was never in the wake. The wake of the airframe cf2x "
        "was fitted to the other flights of two Crazyflies. It is used for the larger drone as "
        "well, with that drone's thrust, since the data does not state the length of its arms.",
        "Errors are root-mean-square values where the lower drone is within 0.25 m of the axis and "
        f"0.15 to 0.7 m below; rows more than {FREE_DISTANCE:g} m from the axis also count as free "
        f"flight. Fitted strengths: {shares[SMALL]:.3f} and {shares[MIXED]:.3f} instead of "
        f"{row.wake_share:g}.",
    )
    extra = {"wake_share": shares, "used": counts, "left_out": left_out}
    return TableOutcome(rows, _draw(rows, shown, row), notes, extra=extra)


def _count(used: dict[str, int], left_out: dict[str, list[str]], name: str) -> str:
    """Format how many held-out flights are used."""
    return f"{used[name]} of {used[name] + len(left_out[name])}"


def _measure(
    paths: Sequence[tuple[Path, Path]], settings: Settings, done: float
) -> tuple[list[list[LowerDrone]], list[str]]:
    """Measure the wakes on the smaller drone of each flight, or on both of equal ones.

    Returns:
        Lower drones by flight, and the reasons why other flights are left out.

    Raises:
        LogError: If no drone was in the wake of another.
    """
    picked = pick_evenly(np.arange(len(paths)), settings.count(len(paths), least=2))
    flights, left_out = [], []
    for k, index in enumerate(picked):
        first, second = (read_swarm_log(path) for path in paths[index])
        a, b = align_logs(first, second)
        felt = (measure_wake(first, second, a, b), measure_wake(second, first, b, a))
        small = [
            one for one, path in zip(felt, paths[index], strict=True) if not is_large_drone(path)
        ]
        lower = [one for one in small if one is not None and one.near.any()]
        if lower:
            flights.append(lower)
        else:
            one, other = paths[index]
            place = f"{one.parent.parent.name}/{one.parent.name}"
            reason = "less than a second of free flight" if None in small else "never in the wake"
            left_out.append(f"{place}, {one.name} and {other.name}: {reason}")
        settings.progress(done + 0.25 * (k + 1) / len(picked))
    if not flights:
        names = ", ".join(path.name for pair in paths for path in pair)
        raise LogError(f"no drone flew in the wake of another in {names}; fetch the data again")
    return flights, left_out


def _squares(flight: Sequence[LowerDrone], row: ParameterRow) -> np.ndarray:
    """Sum squared errors of one flight, (errors, 2): without and with the model of the wake."""
    total = np.zeros((len(ERRORS), 2))
    for one in flight:
        push, moment = predict_near_wake(one, row)
        for k, share in enumerate((0.0, 1.0)):
            rest = one.push - share * push
            felt = np.where(one.usable, rest, 0.0) * STANDARD_GRAVITY / one.mass
            height = simulate_height_error(felt, STIFFNESS, DAMPING, SWARM_DT)
            vertical = np.sum(rest[one.near] ** 2)
            total[:, k] += (
                vertical,
                vertical + np.sum(one.sideways[one.near] ** 2),
                np.sum(height[one.near] ** 2),
                np.sum((one.moment - share * moment)[one.near] ** 2),
            )
    return total


def compute_reduction(squares: np.ndarray) -> np.ndarray:
    """Return by how much root-mean-square errors are reduced, %.

    Args:
        squares: Sums of squared errors (..., 2), without and with the model.
    """
    return np.asarray(100.0 * (1.0 - np.sqrt(squares[..., 1] / squares[..., 0])))


def _compare(name: str, kept: Sequence[Sequence[LowerDrone]], row: ParameterRow) -> list[Row]:
    """List the reductions of all errors, with intervals of the bootstrap over flights."""
    squares = np.stack([_squares(flight, row) for flight in kept])
    chosen = np.random.default_rng(0).integers(0, len(kept), (RESAMPLES, len(kept)))
    samples = compute_reduction(squares[chosen].sum(axis=1))
    low, high = np.quantile(samples, (TAIL, 1.0 - TAIL), axis=0)
    mean = compute_reduction(squares.sum(axis=0))
    # A single flight has no interval
    ends = np.stack([low, high], axis=1).tolist() if len(kept) > 1 else [(None, None)] * len(ERRORS)
    return [
        Row(
            f"{name}: {error}" + (f" (published: {counterpart})" if counterpart else ""),
            float(size),
            published,
            "%",
            first,
            last,
            tolerance,
            # Theirs are of tracking errors, ours of forces or of simulated heights
            is_comparable=published is None,
        )
        for (error, counterpart, published, tolerance), size, (first, last) in zip(
            ERRORS, mean, ends, strict=True
        )
    ]


def _draw(rows: Sequence[Row], shown: Sequence[LowerDrone], row: ParameterRow) -> Figure:
    """Draw measured and predicted forces, and the reductions next to the published ones."""
    figure = blank_figure(13, 5)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.3))
    columns = [
        np.concatenate([values[one.near] for one, values in pairs])
        for pairs in (
            [(one, one.distance) for one in shown],
            [(one, one.drop) for one in shown],
            [(one, one.push) for one in shown],
            [(one, predict_near_wake(one, row)[0]) for one in shown],
        )
    ]
    distance, drop, push, law = columns
    middle = 0.5 * (DISTANCE_EDGES[1:] + DISTANCE_EDGES[:-1])
    place = np.digitize(distance, DISTANCE_EDGES) - 1
    for colour, (top, bottom) in zip(("#4477aa", "#ee7733", "#228833"), DROPS_SHOWN, strict=True):
        its = [(place == k) & (drop >= top) & (drop < bottom) for k in range(len(middle))]
        filled = [k for k, rows_of_bin in enumerate(its) if rows_of_bin.sum() >= 10]
        label = f"{top:g} to {bottom:g} m below"
        measured = [push[its[k]].mean() for k in filled]
        left.plot(middle[filled], measured, "o", color=colour, label=f"measured, {label}")
        predicted = [law[its[k]].mean() for k in filled]
        left.plot(middle[filled], predicted, color=colour, label=f"bulletuav, {label}")
    left.set(xlabel="horizontal distance, m", ylabel="downward force, g (small above small)")
    left.legend(fontsize=8)
    left.grid(alpha=0.3)
    listed = [one for one in rows if one.published is not None]
    at = np.arange(len(listed))[::-1]
    ours = np.array([one.ours for one in listed])
    ends = np.array([[one.low, one.high] for one in listed], dtype=float)
    right.barh(at, ours, 0.5, color="#99bbdd", label="bulletuav, of forces and simulated heights")
    bars = {"fmt": "none", "color": "black", "capsize": 2, "label": "95 % interval"}
    right.errorbar(ours, at, xerr=np.abs(ends.T - ours), **bars)
    published = [one.published for one in listed]
    label = "published, of tracking errors of other drones"
    right.plot(published, at, "D", color="#aa3377", fillstyle="none", label=label)
    right.set_yticks(at, [one.name.replace(" (", "\n(") for one in listed], fontsize=7)
    right.set(xlabel="reduction of the error by the model of the wake, %", xlim=(0, 100))
    right.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.3, 1.0), ncols=3)
    return figure


REPRODUCTION = Reproduction(
    title="Downwash on the lower of two drones: errors that a model of the wake removes",
    publication=(
        "H. Smith, A. Shankar, J. Gielis, J. Blumenkamp and A. Prorok, SO(2)-Equivariant Downwash "
        "Models for Close Proximity Flight, 2024 (arXiv 2305.18983); J. Li, L. Han, H. Yu, Y. Lin, "
        "Q. Li and Z. Ren, Nonlinear MPC for Quadrotors in Close-Proximity Flight with Neural "
        "Network Downwash Prediction, 2023 (arXiv 2304.07794)"
    ),
    address="https://arxiv.org/abs/2305.18983",
    about=(
        "By how much the wake of the airframe cf2x reduces the errors of force and height of a "
        "drone below another, on held-out flights of Neural-Swarm (G. Shi et al., 2021), next to "
        "the reductions of tracking errors that two publications report for learned models."
    ),
    minutes=0.5,
    compute=_compute,
    data=Data(
        repository="https://github.com/aerorobotics/neural-swarm",
        commit="48b185118edde247f46ab76ee821ec23fc1b98ed",
        licence="none",
        contains="data/training/datacollection21_06_16_2020/randomwalk_ss/cf50_00",
    ),
)
