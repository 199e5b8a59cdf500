"""GLAS's comparison with ORCA: success by the densities of robots and obstacles."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics.estimates import Estimate, mean_estimate
from bulletuav.errors import require_file
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.planar_rooms import RoomPilot, fly_planar_rooms, read_planar_room
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome

DATA = Data(
    repository="https://github.com/bpriviere/glas",
    commit="0f75053f2b56873b9bb6ba2ff701e61cd34486b9",
    licence="MIT",
    contains="results/singleintegrator/instances/map_8by8_obst6_agents2_ex0000.yaml",
)
"""The rooms; later commits lack most of them"""
OBSTACLES = (6, 9, 12)
"""Numbers of obstacles in the 64 cells of a room: densities of about 10, 15 and 20 %"""
ROBOTS = (2, 4, 8, 16, 32, 64)
"""Numbers of robots in a room"""
ROOMS = 10
"""Number of rooms of each case"""
RVO2_SUCCESS = {
    6: (75.0, 77.5, 72.5, 73.8, 81.6, 86.7),
    9: (65.0, 77.5, 58.8, 64.4, 79.1, 69.5),
    12: (60.0, 65.0, 60.0, 44.4, 56.2, 65.8),
}
"""Success of RVO2 (commit 1c25b27258d191e26c2df83ff6e31abc8efbdaed) in these rooms, %, by number of
obstacles and robots: with the settings of `baseline/orca/orca.cpp` and a sensing range of 3 m, run
for this table"""
GLAS_ADVANTAGE = 20.0
"""Success of GLAS minus that of ORCA over all densities, %: abstract of the paper"""
LABELS: dict[RoomPilot, str] = {
    "plain": "ORCA, bulletuav",
    "orca": "policy orca (turns right)",
    "paths": "policy orca on A* paths",
}
"""Names of the pilots in the picture"""


def _room_file(data: Path, obstacles: int, robots: int, room: int) -> Path:
    """Return the file of a room."""
    name = f"map_8by8_obst{obstacles}_agents{robots}_ex{room:04d}.yaml"
    file = data / "results" / "singleintegrator" / "instances" / name
    return require_file("room of GLAS", file, f"fetch it with: {DATA.commands}")


def _compute(settings: Settings) -> TableOutcome:
    """Fly all rooms by each pilot."""
    assert settings.data is not None
    count = settings.count(ROOMS)
    cases = [(obstacles, robots) for obstacles in OBSTACLES for robots in ROBOTS]
    total = len(LABELS) * sum(robots for _, robots in cases)
    finished = 0.0
    success: dict[RoomPilot, list[np.ndarray]] = {pilot: [] for pilot in LABELS}
    collided: dict[RoomPilot, list[float]] = {pilot: [] for pilot in LABELS}
    for obstacles, robots in cases:
        files = [_room_file(settings.data, obstacles, robots, k) for k in range(count)]
        rooms = [read_planar_room(file) for file in files]
        for pilot in LABELS:
            flights = fly_planar_rooms(rooms, pilot)
            success[pilot].append(100.0 * flights.success)
            collided[pilot].append(100.0 * float(flights.collided.mean()))
            finished += robots / total
            settings.progress(min(finished, 1.0))
    estimates = {
        pilot: [mean_estimate(values.tolist()) for values in success[pilot]] for pilot in LABELS
    }
    rows = [
        _row(
            f"ORCA, {obstacles} obstacles, {robots} robots",
            one,
            RVO2_SUCCESS[obstacles][ROBOTS.index(robots)],
            CROWD if robots >= CROWDED else "",
        )
        for (obstacles, robots), one in zip(cases, estimates["plain"], strict=True)
    ]
    plain, turning, planned = (np.concatenate(success[pilot]) for pilot in LABELS)
    rvo2 = float(np.mean(list(RVO2_SUCCESS.values())))
    rows += [
        _row("ORCA, mean", mean_estimate(plain.tolist()), rvo2),
        _row("policy orca, mean", mean_estimate(turning.tolist()), rvo2, TURN),
    ]
    ahead = mean_estimate((planned - plain).tolist())
    rows.append(
        Row(
            "points above ORCA, GLAS (orca on A* paths)",
            ahead.mean,
            GLAS_ADVANTAGE,
            "",
            ahead.low,
            ahead.high,
            0.5,
            "higher",
        )
    )
    extra: dict[str, Any] = {
        "obstacles": OBSTACLES,
        "robots": ROBOTS,
        "rooms": count,
        "success": {pilot: [one.mean for one in estimates[pilot]] for pilot in LABELS},
        "collided": collided,
    }
    return TableOutcome(rows, _draw(estimates), NOTES, extra)


CROWDED = 64
"""Number of robots from which they push each other into squares"""
CROWD = (
    "In a crowd robots are pushed into squares, and never into each other. If no velocity is "
    "permitted, bulletuav minimises the maximum violation of all half-spaces; RVO2 never violates "
    "those of obstacles."
)
"""Explanation of the success in crowds"""
TURN = (
    "Policy orca turns right where its way is blocked. This leads past a single square, but here "
    "the way to the right often ends in a corner of squares and walls: of 160 robots in rooms with "
    "4 or 8 of them, 50 arrive only without the turn, and 26 only with it. Without the turn, the "
    "same half-spaces give the row above."
)
"""Explanation of the success of policy `orca`"""
NOTES = (
    "Success is the fraction of robots that are within 0.5 m of their goals in the end, and never "
    "overlapped a robot (0.3 m) or a square (0.15 m): results/singleintegrator/stats.py.",
    "The published column is computed, as the paper has curves only: RVO2, the library of the "
    "published ORCA curve, in the published rooms with the published settings. The last row's is "
    "from the abstract, which says 20 %; points are assumed.",
    "The network of GLAS is not flown. A* knows the whole room, GLAS what is within 3 m.",
    "Obstacles are the planes through their nearest points here, and edges with velocity obstacles "
    "in RVO2.",
)
"""Notes of the table"""


def _row(name: str, ours: Estimate, published: float, why: str = "") -> Row:
    """Return the row of a success."""
    return Row(name, ours.mean, published, "%", ours.low, ours.high, 0.05, "higher", why)


def _draw(estimates: dict[RoomPilot, list[Estimate]]) -> Figure:
    """Draw success by the number of robots, one picture for each number of obstacles."""
    figure = blank_figure(10, 4)
    panels = figure.subplots(1, len(OBSTACLES), sharey=True)
    for k, (axes, obstacles) in enumerate(zip(panels, OBSTACLES, strict=True)):
        axes.plot(ROBOTS, RVO2_SUCCESS[obstacles], "k--o", label="ORCA, RVO2")
        for pilot, label in LABELS.items():
            own = estimates[pilot][k * len(ROBOTS) : (k + 1) * len(ROBOTS)]
            (line,) = axes.plot(ROBOTS, [one.mean for one in own], "-o", ms=4, label=label)
            low, high = [one.low for one in own], [one.high for one in own]
            axes.fill_between(ROBOTS, low, high, color=line.get_color(), alpha=0.15, lw=0)
        axes.set_xscale("log", base=2)
        axes.set_xticks(ROBOTS, [str(robots) for robots in ROBOTS])
        axes.set(xlabel="robots", title=f"{obstacles} obstacles ({obstacles / 0.64:.0f} %)")
        axes.set_ylim(0, 105)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("robots that succeed, %")
    panels[0].legend(loc="lower left", fontsize=8)
    return figure


REPRODUCTION = Reproduction(
    title="ORCA and GLAS in rooms with obstacles",
    publication="B. Riviere, W. Hoenig, Y. Yue, S.-J. Chung, GLAS: Global-to-Local Safe Autonomy "
    "Synthesis for Multi-Robot Motion Planning with End-to-End Learning, RA-L 2020",
    address="https://arxiv.org/abs/2002.11807",
    about="Success of ORCA by the numbers of robots and obstacles in the rooms of GLAS, 8 m x 8 m "
    "with squares of 1 m: robots of 0.15 m are single integrators of up to 0.5 m/s. Next to it, "
    "RVO2 in the same rooms, and the advantage over ORCA.",
    minutes=2.0,
    compute=_compute,
    data=DATA,
)
