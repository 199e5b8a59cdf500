"""Flight times of TOGT-Planner: planned here, and flown in `rigid_body`."""

import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome
from bulletuav.reproduction.time_optimal import MAX_ITERATIONS, PolynomialFlight, optimize_flight
from bulletuav.reproduction.togt import (
    TOGT_LIMITS,
    TogtFlight,
    fly_plan,
    read_togt_track,
    write_togt_urdf,
)

PIECES = (1, 3, 5)
"""Numbers of polynomials from gate to gate, one plan after the other"""
MAX_DEVIATION = 0.02
"""Relative difference of flown and planned times that counts as none"""
MISSING = 0.02
"""Distance from an opening that counts as none, m: a step of the flight at 20 m/s"""


COLUMNS = {"t", "p_x", "p_y", "p_z", "w_x", "w_y", "u_1", "u_2", "u_3", "u_4"}
"""Columns of published trajectories that are read"""


class PublishedTime(NamedTuple):
    """A published flight time.

    Attributes:
        name: Its name here.
        seconds: Time of the last line of the file, s.
        file: File in the folder resources/trajectory.
        pieces: Index of the plan here that it is compared with, in `PIECES`.
    """

    name: str
    seconds: float
    file: str
    pieces: int


class PublishedTrack(NamedTuple):
    """A track with its published times.

    Attributes:
        name: Its name here.
        file: File in the folder resources/racetrack.
        times: Published times.
    """

    name: str
    file: str
    times: Sequence[PublishedTime]


TRACKS = (
    PublishedTrack(
        "7 gates",
        "race_uzh_7g_multiprisma.yaml",
        (
            PublishedTime("one polynomial from gate to gate", 8.216, "togt_traj.csv", 0),
            PublishedTime("refined", 7.003, "togt_refined_traj.csv", 2),
        ),
    ),
    PublishedTrack(
        "19 points",
        "race_uzh_19wp.yaml",
        (
            PublishedTime("five polynomials", 17.911, "aos_traj.csv", 2),
            PublishedTime("refined", 17.597, "aos_refined_traj.csv", 2),
        ),
    ),
    PublishedTrack(
        "19 gates",
        "race_uzh_19g.yaml",
        (PublishedTime("five polynomials", 16.829, "aos_togt_traj.csv", 2),),
    ),
)
"""Tracks, and times of the repository at the commit of the table"""


def plan_track(path: Path, pieces: Sequence[int], iterations: int) -> list[PolynomialFlight]:
    """Plan flights through a track with the limits of TOGT-Planner's drone.

    Args:
        path: File of the track.
        pieces: Numbers of polynomials from gate to gate.
        iterations: Maximum number of iterations.

    Returns:
        For each number of polynomials the fastest plan with at most that many.
    """
    track = read_togt_track(path)
    flights = optimize_flight(track.openings, track.ends, TOGT_LIMITS, pieces, iterations)
    best = [flights[0]]
    for flight in flights[1:]:
        best.append(min(best[-1], flight, key=lambda one: one.duration))
    return best


def _read_published(path: Path) -> dict[str, np.ndarray]:
    """Return columns of a published trajectory."""
    with path.open(encoding="utf-8") as lines:
        names = lines.readline().strip().split(",")
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    missing = COLUMNS - set(names)
    if missing or table.shape[1] != len(names) or not np.isfinite(table).all():
        raise ValueError(f"{path} is no trajectory of TOGT-Planner: check out the commit again")
    return dict(zip(names, table.T, strict=True))


def _explain(published: dict[str, np.ndarray], seconds: float, plan: float) -> str:
    """Explain why a plan is slower than a published one, by the limits of the published one."""
    reasons = []
    rate = float(np.hypot(published["w_x"], published["w_y"]).max())
    if rate > 1.01 * TOGT_LIMITS.max_rate:
        reasons.append(f"turns its thrust at up to {rate:.1f} rad/s, here 15 are allowed")
    low = float(published["p_z"].min())
    if low < TOGT_LIMITS.min_height - 0.01:
        reasons.append(f"sinks to {low:.2f} m, here {TOGT_LIMITS.min_height:g} m are allowed")
    thrusts = np.stack([published[f"u_{r}"] for r in range(1, 5)])
    if thrusts.min() < TOGT_LIMITS.min_thrust - 0.01:
        reasons.append(f"uses thrusts down to {max(thrusts.min(), 0.0):.2f} N, here 0.1 N")
    if not reasons:
        reasons.append("keeps the limits of the plan here, which is another local optimum")
    slower = 100 * (plan / seconds - 1)
    return f"{slower:.1f} % slower: the published flight {', '.join(reasons)}"


def _make_rows(
    name: str, published: float, planned: float, flight: TogtFlight, why: str
) -> list[Row]:
    """Compare the duration of a plan, and its flight, with a published time, s."""
    times = (("planned", planned), ("flown", flight.time))
    return [
        *(
            Row(f"{name}: {kind}", ours, published, "s", tolerance=0.0005, goal="lower", why=why)
            for kind, ours in times
        ),
        Row(f"{name}: flown over planned", flight.time / planned, 1.0, tolerance=MAX_DEVIATION),
        Row(
            f"{name}: largest distance from an opening",
            float(flight.excess.max()),
            0.0,
            "m",
            tolerance=MISSING,
        ),
    ]


def _draw_flight(axes: Axes, plan: PolynomialFlight, flight: TogtFlight) -> None:
    """Draw a plan and its flight from above."""
    path = plan.motion(np.linspace(0.0, plan.duration, 1000))[:, 0]
    axes.plot(path[:, 0], path[:, 1], label=f"plan, {plan.duration:.2f} s")
    place, label = flight.position, f"flown, {flight.time:.2f} s"
    axes.plot(place[:, 0], place[:, 1], "--", linewidth=1, label=label)


def _compute(settings: Settings) -> TableOutcome:
    """Plan all tracks, fly the plans, and compare."""
    assert settings.data is not None
    resources = settings.data / "resources"
    tracks = TRACKS[: settings.count(len(TRACKS))]
    iterations = settings.count(MAX_ITERATIONS, 2)
    pieces = PIECES if settings.size > 0.1 else PIECES[:1]
    plan = partial(plan_track, pieces=pieces, iterations=iterations)
    files = [resources / "racetrack" / track.file for track in tracks]
    plans: list[list[PolynomialFlight]] = []
    with ProcessPoolExecutor(settings.workers, mp_context=get_context("spawn")) as pool:
        for found in pool.map(plan, files):
            plans.append(found)
            settings.progress(0.8 * len(plans) / len(tracks))
    rows: list[Row] = []
    extra: dict[str, object] = {}
    figure = blank_figure(5 * len(tracks), 6)
    with tempfile.TemporaryDirectory() as place:
        urdf = Path(place) / "togt.urdf"
        write_togt_urdf(urdf)
        for k, (track, file, own) in enumerate(zip(tracks, files, plans, strict=True)):
            course = read_togt_track(file)
            axes = figure.add_subplot(1, len(tracks), k + 1)
            axes.set(title=track.name, xlabel="x (m)", ylabel="y (m)", aspect="equal")
            flown: dict[int, TogtFlight] = {}
            for time in track.times:
                number = min(time.pieces, len(pieces) - 1)
                planned = own[number].duration
                if number not in flown:
                    flown[number] = fly_plan(own[number], course, urdf)
                    _draw_flight(axes, own[number], flown[number])
                flight, name = flown[number], f"{track.name}, {time.name}"
                published = _read_published(resources / "trajectory" / time.file)
                label = f"published, {time.seconds:.2f} s"
                axes.plot(published["p_x"], published["p_y"], ":", linewidth=1, label=label)
                # A plan that is not optimised explains nothing
                is_optimised = iterations == MAX_ITERATIONS
                why = _explain(published, time.seconds, planned) if is_optimised else ""
                rows += _make_rows(name, time.seconds, planned, flight, why)
                extra[name] = {
                    "largest distance from the plan, m": flight.error,
                    "largest speed, m/s": float(flight.speed.max()),
                }
            centres = np.array([opening.centre for opening in course.openings])
            axes.plot(centres[:, 0], centres[:, 1], "k+", markersize=8, label="gates")
            axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
            durations = [one.duration for one in own]
            extra[f"{track.name}: planned by {pieces} polynomials, s"] = durations
            settings.progress(0.8 + 0.2 * (k + 1) / len(tracks))
    notes = (
        "Published times are those of the last lines of the files in resources/trajectory.",
        "Plans are minimum-snap polynomials whose junctions and durations are optimised; limits "
        "are those of TOGT-Planner's parameters: 0.1 to 6.879 N a rotor, 15 rad/s, 0.3 m.",
        "Flights are steered by body rates and thrust at 1,000 Hz; rotors have no lag, and there "
        "is no drag, as in the published plans. Their delay is that at 5 cm and 5 cm/s from rest.",
    )
    return TableOutcome(rows, figure, notes, extra)


REPRODUCTION = Reproduction(
    title="Time-optimal flights through gates of TOGT-Planner",
    publication=(
        "C. Qin, M. Michet, J. Chen, H. Liu, Time-optimal gate-traversing planner for autonomous "
        "drone racing, ICRA 2024"
    ),
    address="https://github.com/FSC-Lab/TOGT-Planner",
    about=(
        "Plans through its three tracks for its drone of 0.85 kg, and flights along the plans in "
        "rigid_body, next to the times of its planner and of its refinement."
    ),
    minutes=3.0,
    compute=_compute,
    is_parallel=True,
    data=Data(
        repository="https://github.com/FSC-Lab/TOGT-Planner",
        commit="6707d3a1d06e4bd33d4aaa5e6f9fa02497ee90c5",
        licence="MIT",
        contains="resources/racetrack/race_uzh_7g_multiprisma.yaml",
    ),
)
