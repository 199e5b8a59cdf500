"""QuadSwarm's success among cylinders: 8 and 32 drones at densities of 20 to 80 %."""

from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics.estimates import Estimate, mean_estimate
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.cylinder_rooms import (
    CylinderFlights,
    DronePilot,
    GoalRule,
    draw_cylinder_room,
    fly_cylinder_rooms,
)
from bulletuav.reproduction.rooms import MIN_ROOMS, room_interval
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome

DENSITIES = (0.2, 0.4, 0.6, 0.8)
"""Fractions of cells with a cylinder"""
EPISODES = {8: 50, 32: 20}
"""Number of rooms of each case, by the number of drones"""
GOALS: tuple[GoalRule, ...] = ("random", "common")
"""Rules of the goals, mixed evenly in all numbers"""
PILOTS: dict[DronePilot, str] = {"orca": "policy orca", "paths": "orca on A* paths"}
"""Pilots, and their names"""
Group = tuple[int, float, DronePilot]
"""Number of drones, density and pilot of the flights of a case"""
SWARM_METHODS = ("QuadSwarm's policy", "GLAS", "SBC")
"""Published methods"""
PUBLISHED: tuple[tuple[str, float, str, float], ...] = (
    ("success", 0.97, SWARM_METHODS[0], 0.005),
    ("success", 0.75, SWARM_METHODS[1], 0.005),
    ("success", 0.99, SWARM_METHODS[2], 0.005),
    ("collided", 0.03, SWARM_METHODS[0], 0.005),
    ("collided", 0.25, SWARM_METHODS[1], 0.005),
    ("collided", 0.01, SWARM_METHODS[2], 0.005),
    ("length", 5.3, SWARM_METHODS[0], 0.05),
    ("length", 7.1, SWARM_METHODS[2], 0.05),
)
"""Numbers of Table I, 8 drones at a density of 20 %: measure, number, method, and half a unit of
the last digit"""
COMMON_DISTANCE = 0.26
"""Distance to a common goal in the final second, 8 drones at 20 %, m: section IV-A"""
MEASURES: dict[str, tuple[str, str, Literal["lower", "higher"]]] = {
    "success": ("success", "", "higher"),
    "collided": ("collision rate", "", "lower"),
    "length": ("flying distance", "m", "lower"),
    "distance": ("distance to goal", "m", "lower"),
}
"""Name, unit and goal of the measures"""


def _compute(settings: Settings) -> TableOutcome:
    """Fly all cases."""
    flights: dict[Group, list[CylinderFlights]] = {}
    case = (8, 0.2)
    ways, integrators = [], []
    total = sum(drones * count for drones, count in EPISODES.items())
    total *= len(DENSITIES) * len(PILOTS) * len(GOALS)
    finished = 0.0
    for drones, full in EPISODES.items():
        for density in DENSITIES:
            for k, goals in enumerate(GOALS):
                rooms = [
                    draw_cylinder_room(_rng(drones, density, k, room), drones, density, goals)
                    for room in range(settings.count(full))
                ]
                for pilot in PILOTS:
                    flown = fly_cylinder_rooms(rooms, pilot)
                    flights.setdefault((drones, density, pilot), []).append(flown)
                    finished += drones * full / total
                    settings.progress(min(finished, 1.0))
                if (drones, density) == case:
                    straight = [np.linalg.norm(room.goal - room.start, axis=1) for room in rooms]
                    ways.append(float(np.mean(straight)))
                    integrators.append(
                        fly_cylinder_rooms(rooms, "orca", dynamics="single_integrator")
                    )
    local, planned = flights[*case, "orca"], flights[*case, "paths"]
    reasons = _explain(local, integrators, ways)
    rows = [
        _row(measure, method, local, "orca", number, half, reasons[measure])
        for measure, number, method, half in PUBLISHED
    ]
    rows += [
        _row(measure, method, planned, "paths", number, half)
        for measure, number, method, half in PUBLISHED
        if method == SWARM_METHODS[0]
    ]
    name, half = f"common goal, {SWARM_METHODS[0]}", 0.005
    rows += [
        _row("distance", name, local[1:], "orca", COMMON_DISTANCE, half, reasons["distance"]),
        _row("distance", name, planned[1:], "paths", COMMON_DISTANCE, half),
    ]
    estimates = {group: _estimate(flown, "success") for group, flown in flights.items()}
    for (drones, density, pilot), one in estimates.items():
        name = f"success, {drones} drones, {density:.0%}: {PILOTS[pilot]}"
        low, high = room_interval(one)
        rows.append(Row(name, one.mean, low=low, high=high, goal="higher"))
    extra: dict[str, Any] = {
        f"{drones} drones, {density:.0%}, {pilot}": {
            **{name: _estimate(flown, name).mean for name in MEASURES},
            "deadlock": 1.0 - _estimate(flown, "success").mean - _estimate(flown, "collided").mean,
            "success by goals": [float(one.success.mean()) for one in flown],
        }
        for (drones, density, pilot), flown in flights.items()
    }
    return TableOutcome(rows, _draw(estimates), NOTES, extra)


def _rng(*numbers: float) -> np.random.Generator:
    """Return the random generator of a room; both pilots fly in the same rooms."""
    return np.random.default_rng([round(100 * number) for number in numbers])


def _estimate(flown: list[CylinderFlights], measure: str) -> Estimate:
    """Estimate the mean of a measure over rooms, which are the independent units."""
    means = [getattr(one, measure).reshape(len(one.success), -1).mean(axis=1) for one in flown]
    return mean_estimate(np.concatenate(means).tolist())


def _explain(
    flown: list[CylinderFlights], integrators: list[CylinderFlights], ways: list[float]
) -> dict[str, str]:
    """Explain the measures of policy `orca` by its flights.

    Args:
        flown: Flights, by rule of the goals.
        integrators: Flights of single integrators in the same rooms.
        ways: Mean distance from start to goal, by rule of the goals, m.

    Returns:
        Sentences by measure.
    """
    success, collided = (_estimate(integrators, name).mean for name in ("success", "collided"))
    away = _estimate(integrators[1:], "distance").mean
    lag = (
        "Policy orca assumes that velocities are reached immediately, and quadrotors lag. As "
        "single integrators, the same drones in the same rooms have a success of "
        f"{success:.3f} and a collision rate of {collided:.3f}, and end {away:.2f} m from a "
        "common goal."
    )
    free, crowded = (_estimate([one], "length").mean for one in flown)
    length = (
        f"Flights to random goals, {ways[0]:.1f} m away, are {free:.1f} m long; those to common "
        f"goals, {ways[1]:.1f} m away, are {crowded:.1f} m long, as drones keep moving around "
        "each other at the goal."
    )
    return {"success": lag, "collided": lag, "distance": lag, "length": length}


def _row(
    measure: str,
    method: str,
    flown: list[CylinderFlights],
    pilot: DronePilot,
    published: float,
    half: float,
    why: str = "",
) -> Row:
    """Return the row of a published number; paths by A* know more than the published methods."""
    name, unit, goal = MEASURES[measure]
    one = _estimate(flown, measure)
    title = f"{name}, {method} ({PILOTS[pilot]})"
    low, high = room_interval(one)
    is_local = pilot == "orca"
    return Row(title, one.mean, published, unit, low, high, half, goal, why, is_local)


NOTES = (
    "Rooms, times and measures are those of the code: a drone succeeds that came within 0.5 m of a "
    "random goal, or within 1 m of a common one, and touched no drone and no cylinder after "
    "1.5 s. Half of the rooms have one goal for all drones, in the centre of the largest free "
    "square. As in the code, this square is found with cells of the first row and column counted "
    "as free where they have a cylinder, and as occupied where not.",
    "Cylinders do not stop drones here: a drone that touches one has collided, and flies through. "
    "In QuadSwarm they are pushed back.",
    "The published curves by density and number of drones are in figures without numbers, which "
    "are not read here; the text says that success does not depend on them up to 80 % and 32 "
    "drones.",
    "Policy orca has no map, as the published methods, but knows the true state of all drones and "
    "cylinders within reach of its horizon of 1 s; QuadSwarm's policy knows two drones and the "
    "distances to cylinders around it, and commands rotor thrusts. A* knows the whole room: its "
    "rows are not comparable.",
    "At 60 and 80 % there are fewer free cells than 32 drones, and the published code draws cells "
    "without replacement, which fails: cells are used several times here, at other heights.",
    "The trained policies of task obstacles are made for rooms of 200 m and 20 m/s, and are not "
    "flown.",
)
"""Notes of the table"""


def _draw(estimates: dict[Group, Estimate]) -> Figure:
    """Draw success by density for each number of drones."""
    figure = blank_figure(9, 4)
    panels = figure.subplots(1, len(EPISODES), sharey=True)
    for axes, drones in zip(panels, EPISODES, strict=True):
        for pilot, label in PILOTS.items():
            own = [estimates[drones, density, pilot] for density in DENSITIES]
            mean = np.array([one.mean for one in own])
            errors = None
            if own[0].episodes >= MIN_ROOMS:
                errors = [mean - [one.low for one in own], [one.high for one in own] - mean]
            axes.errorbar(DENSITIES, mean, errors, fmt="-o", capsize=3, label=label)
        axes.set(xlabel="fraction of cells with a cylinder", title=f"{drones} drones")
        axes.set_xticks(DENSITIES)
        axes.set_ylim(0, 1.05)
        axes.grid(alpha=0.3)
    success = [
        (number, method) for measure, number, method, *_ in PUBLISHED if measure == "success"
    ]
    for (number, method), marker in zip(success, "s^D", strict=True):
        panels[0].plot(
            DENSITIES[0], number, marker, mfc="none", mec="k", ms=9, label=f"{method}, published"
        )
    panels[0].set_ylabel("drones that succeed")
    panels[0].legend(loc="lower left")
    return figure


REPRODUCTION = Reproduction(
    title="Quadrotors among cylinders: QuadSwarm",
    publication="Z. Huang, Z. Yang, R. Krupani, B. Senbaslar, S. Batra, G. S. Sukhatme, Collision "
    "Avoidance and Navigation for a Quadrotor Swarm Using End-to-end Deep Reinforcement Learning, "
    "ICRA 2024",
    address="https://arxiv.org/abs/2309.13285",
    about="8 and 32 Crazyflies fly for 15 s in a room of 10 m, with cylinders of 0.6 m in 20 to "
    "80 % of the cells of 1 m. Policy orca, straight to the goals and along A* paths, next to the "
    "published numbers of QuadSwarm's policy, GLAS and safety barrier certificates (SBC).",
    minutes=3.0,
    compute=_compute,
)
