"""ORCA in the rooms of GLAS: success by the densities of robots and obstacles."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics.estimates import Estimate, mean_estimate
from bulletuav.errors import require_file
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.planar_rooms import (
    PlanarRoom,
    RoomFlights,
    RoomPilot,
    fly_planar_rooms,
    read_planar_room,
)
from bulletuav.reproduction.rooms import MIN_ROOMS, room_interval
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
RVO2_ROBOTS: dict[int, dict[int, tuple[int, ...]]] = {
    6: {
        2: (2, 1, 2, 1, 2, 2, 1, 1, 1, 2),
        4: (3, 3, 3, 4, 2, 3, 3, 4, 4, 2),
        8: (5, 6, 6, 7, 5, 6, 8, 5, 3, 7),
        16: (12, 11, 13, 11, 13, 11, 13, 14, 13, 7),
        32: (26, 20, 25, 17, 27, 28, 28, 31, 30, 29),
        64: (56, 36, 57, 60, 55, 60, 50, 62, 56, 56),
    },
    9: {
        2: (2, 1, 2, 1, 1, 1, 0, 1, 2, 2),
        4: (3, 4, 2, 4, 4, 2, 2, 3, 4, 3),
        8: (6, 5, 8, 5, 2, 3, 2, 3, 6, 7),
        16: (10, 9, 8, 5, 11, 12, 15, 10, 11, 12),
        32: (26, 24, 24, 28, 28, 22, 23, 30, 26, 22),
        64: (53, 40, 49, 42, 26, 53, 36, 42, 44, 56),
    },
    12: {
        2: (1, 2, 1, 2, 1, 1, 1, 0, 2, 1),
        4: (3, 3, 3, 3, 4, 3, 2, 2, 0, 3),
        8: (5, 3, 5, 4, 8, 7, 2, 4, 6, 4),
        16: (9, 4, 5, 6, 7, 11, 9, 8, 3, 9),
        32: (23, 3, 12, 19, 23, 20, 22, 21, 23, 14),
        64: (51, 50, 32, 35, 20, 44, 30, 60, 51, 36),
    },
}
"""Robots of RVO2 (commit 1c25b27258d191e26c2df83ff6e31abc8efbdaed) that succeed in each room, by
numbers of obstacles and robots: benchmarks/rvo2_rooms.cpp, built with -O2, with the settings of
`baseline/orca/orca.cpp` and a sensing range of 3 m"""
GLAS_ADVANTAGE = 20.0
"""Success of GLAS minus that of ORCA over all densities, %: abstract of the paper"""
LABELS: dict[RoomPilot, str] = {
    "plain": "ORCA, bulletuav",
    "orca": "policy orca (turns right)",
    "paths": "policy orca on A* paths",
}
"""Names of the pilots in the picture"""


def read_glas_rooms(data: Path, obstacles: int, robots: int, count: int) -> list[PlanarRoom]:
    """Read the first rooms of a case.

    Args:
        data: Folder of the data.
        obstacles: Number of obstacles.
        robots: Number of robots.
        count: Number of rooms.

    Returns:
        The rooms.

    Raises:
        FileNotFoundError: If there is no file of a room.
        ValueError: If a room is invalid, or has other numbers of obstacles or robots than its name.
    """
    remedy = f"fetch it with: {DATA.commands}"
    rooms = []
    for k in range(count):
        name = f"map_8by8_obst{obstacles}_agents{robots}_ex{k:04d}.yaml"
        file = data / "results" / "singleintegrator" / "instances" / name
        room = read_planar_room(require_file("room of GLAS", file, remedy))
        found = (len(room.square), len(room.start))
        if found != (obstacles, robots):
            raise ValueError(
                f"{file}: {found[0]} obstacles and {found[1]} robots, by its name {obstacles} and "
                f"{robots}: {remedy}"
            )
        rooms.append(room)
    return rooms


def _compute(settings: Settings) -> TableOutcome:
    """Fly all rooms by each pilot."""
    assert settings.data is not None
    count = settings.count(ROOMS)
    cases = [(obstacles, robots) for obstacles in OBSTACLES for robots in ROBOTS]
    total = len(LABELS) * sum(robots for _, robots in cases)
    finished = 0.0
    flights: dict[RoomPilot, list[RoomFlights]] = {pilot: [] for pilot in LABELS}
    for obstacles, robots in cases:
        rooms = read_glas_rooms(settings.data, obstacles, robots, count)
        for pilot in LABELS:
            flights[pilot].append(fly_planar_rooms(rooms, pilot))
            finished += robots / total
            settings.progress(min(finished, 1.0))
    success = {pilot: [100.0 * one.success for one in flown] for pilot, flown in flights.items()}
    rvo2 = [
        100.0 * np.array(RVO2_ROBOTS[obstacles][robots][:count]) / robots
        for obstacles, robots in cases
    ]
    rows = [
        _row(
            f"RVO2 and ORCA, {obstacles} obstacles, {robots} robots",
            100.0 * flown.success,
            theirs,
            _explain_squares(flown, theirs),
        )
        for (obstacles, robots), flown, theirs in zip(cases, flights["plain"], rvo2, strict=True)
    ]
    plain, turning, planned = (np.concatenate(success[pilot]) for pilot in LABELS)
    all_rvo2 = np.concatenate(rvo2)
    rows += [
        _row("RVO2 and ORCA, mean", plain, all_rvo2),
        _row("RVO2 and policy orca, mean", turning, all_rvo2, _explain_turn(flights)),
    ]
    ahead = mean_estimate((planned - plain).tolist())
    low, high = room_interval(ahead)
    rows.append(
        Row(
            "above ORCA, GLAS (orca on A* paths)",
            ahead.mean,
            GLAS_ADVANTAGE,
            "percentage points",
            low,
            high,
            0.5,
            "higher",
            is_comparable=False,
        )
    )
    estimates = {
        pilot: [mean_estimate(values.tolist()) for values in success[pilot]] for pilot in LABELS
    }
    extra: dict[str, Any] = {
        "obstacles": OBSTACLES,
        "robots": ROBOTS,
        "rooms": count,
        "success": {pilot: [one.mean for one in estimates[pilot]] for pilot in LABELS},
        "success of RVO2": [float(values.mean()) for values in rvo2],
        "collided": {
            pilot: [100.0 * float(one.collided.mean()) for one in flown]
            for pilot, flown in flights.items()
        },
    }
    return TableOutcome(rows, _draw(estimates, extra["success of RVO2"]), NOTES, extra)


def _explain_squares(flown: RoomFlights, theirs: np.ndarray) -> str:
    """Explain a success by overlaps of squares, if RVO2's is in the interval without them."""
    apart = 100.0 * (flown.reached & ~flown.hit_robot).mean(axis=1)
    rest = mean_estimate((apart - theirs).tolist())
    if not flown.hit_square.any() or not rest.low <= 0.0 <= rest.high:
        return ""
    return (
        f"{int(flown.hit_square.sum())} of {flown.reached.size} robots overlap a square, those of "
        f"RVO2 never. If this did not count, {apart.mean():.1f} % would succeed, and the interval "
        "of the difference would contain 0. If no velocity is permitted, bulletuav minimises the "
        "maximum violation of all half-spaces; RVO2 never violates those of obstacles."
    )


def _explain_turn(flights: dict[RoomPilot, list[RoomFlights]]) -> str:
    """Explain the success of policy `orca` by flights without its right turn."""
    plain, turning = (
        np.concatenate([(one.reached & ~one.collided).ravel() for one in flights[pilot]])
        for pilot in ("plain", "orca")
    )
    return (
        "Policy orca turns right where its way is blocked, which RVO2 does not. With the same "
        f"half-spaces, {int((plain & ~turning).sum())} of all {len(plain)} robots succeed only "
        f"without this turn, and {int((turning & ~plain).sum())} only with it."
    )


NOTES = (
    "Success is the fraction of robots that are within 0.5 m of their goals in the end, and never "
    "overlapped a robot (0.3 m) or a square (0.15 m): results/singleintegrator/stats.py.",
    "The paper has curves only: the column of published numbers is RVO2, computed by us "
    "(benchmarks/rvo2_rooms.cpp) with the library of the published ORCA curve, commit 1c25b27, in "
    "the published rooms with the published settings. The last row's number is from the abstract, "
    "which says 20 %; points are assumed.",
    "Both fly in the same rooms: intervals are RVO2's success plus the interval of the difference "
    "per room, ours minus RVO2's.",
    "RVO2 itself depends on rounding: built with -O3 -march=native instead of -O2, its success "
    "varies by up to 3.3 percentage points with 64 robots, 1.6 with 32, 1.3 with 8, and 0.3 in the "
    "mean. This is chance in each room, so that the intervals have it; there is no tolerance.",
    "The network of GLAS is not flown. A* knows the whole room, GLAS what is within 3 m: the last "
    "row is not comparable.",
    "Obstacles are the planes through their nearest points here, and edges with velocity obstacles "
    "in RVO2.",
)
"""Notes of the table"""


def _row(name: str, ours: np.ndarray, theirs: np.ndarray, why: str = "") -> Row:
    """Return the row of a success, with the interval of the difference in each room."""
    published = float(theirs.mean())
    low, high = room_interval(mean_estimate((ours - theirs).tolist()))
    if low is not None and high is not None:
        low, high = published + low, published + high
    return Row(name, float(ours.mean()), published, "%", low, high, goal="higher", why=why)


def _draw(estimates: dict[RoomPilot, list[Estimate]], rvo2: list[float]) -> Figure:
    """Draw success by the number of robots, one picture for each number of obstacles."""
    figure = blank_figure(10, 4)
    panels = figure.subplots(1, len(OBSTACLES), sharey=True)
    for k, (axes, obstacles) in enumerate(zip(panels, OBSTACLES, strict=True)):
        here = slice(k * len(ROBOTS), (k + 1) * len(ROBOTS))
        axes.plot(ROBOTS, rvo2[here], "k--o", label="ORCA, RVO2 (computed by us)")
        for pilot, label in LABELS.items():
            own = estimates[pilot][here]
            (line,) = axes.plot(ROBOTS, [one.mean for one in own], "-o", ms=4, label=label)
            if own[0].episodes >= MIN_ROOMS:
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
    title="ORCA, and RVO2 computed by us, in the rooms of GLAS",
    publication="B. Riviere, W. Hoenig, Y. Yue, S.-J. Chung, GLAS: Global-to-Local Safe Autonomy "
    "Synthesis for Multi-Robot Motion Planning with End-to-End Learning, RA-L 2020",
    address="https://arxiv.org/abs/2002.11807",
    about="Success of ORCA by the numbers of robots and obstacles in the rooms of GLAS, 8 m x 8 m "
    "with squares of 1 m: robots of 0.15 m are single integrators of up to 0.5 m/s. Next to it, "
    "the library RVO2, computed by us in the same rooms, and the published advantage of GLAS over "
    "ORCA.",
    minutes=2.0,
    compute=_compute,
    data=DATA,
)
