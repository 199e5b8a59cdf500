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
PUBLISHED: tuple[tuple[str, float, str, DronePilot, float], ...] = (
    ("success", 0.97, "QuadSwarm's policy", "paths", 0.005),
    ("success", 0.75, "GLAS", "orca", 0.005),
    ("success", 0.99, "SBC", "orca", 0.005),
    ("collided", 0.03, "QuadSwarm's policy", "paths", 0.005),
    ("collided", 0.25, "GLAS", "orca", 0.005),
    ("collided", 0.01, "SBC", "orca", 0.005),
    ("length", 5.3, "QuadSwarm's policy", "paths", 0.05),
    ("length", 7.1, "SBC", "orca", 0.05),
)
"""Numbers of Table I, 8 drones at a density of 20 %: measure, number, method, our pilot, and half a
unit of the last digit"""
COMMON_DISTANCE = 0.26
"""Distance to a common goal in the final second, 8 drones at 20 %, m: section IV-A"""
MEASURES: dict[str, tuple[str, str, Literal["lower", "higher"]]] = {
    "success": ("success", "", "higher"),
    "collided": ("collision rate", "", "lower"),
    "length": ("flying distance", "m", "lower"),
    "distance": ("distance to goal", "m", "lower"),
}
"""Name, unit and goal of the measures"""

LAG = (
    "The pilots assume that velocities are reached immediately, and quadrotors lag. As single "
    "integrators, the same drones in the same rooms have no collision, and end 0.22 m from a "
    "common goal."
)
"""Explanation of collisions and distances, from flights with other dynamics"""
CROWD_LENGTH = (
    "Drones never rest at a common goal, but keep moving around each other: these flights are "
    "9.6 m long, and those to random goals 4.3 m."
)
"""Explanation of the length of flights"""
REASONS = {"success": LAG, "collided": LAG, "distance": LAG, "length": CROWD_LENGTH}
"""Explanations by measure"""


def _compute(settings: Settings) -> TableOutcome:
    """Fly all cases."""
    flights: dict[Group, list[CylinderFlights]] = {}
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
    rows = [
        _row(measure, method, _estimate(flights[8, 0.2, pilot], measure), pilot, number, half)
        for measure, number, method, pilot, half in PUBLISHED
    ]
    same = _estimate(flights[8, 0.2, "paths"][1:], "distance")
    rows.append(_row("distance", "common goal", same, "paths", COMMON_DISTANCE, 0.005))
    estimates = {group: _estimate(flown, "success") for group, flown in flights.items()}
    for (drones, density, pilot), one in estimates.items():
        name = f"success, {drones} drones, {density:.0%}: {PILOTS[pilot]}"
        rows.append(Row(name, one.mean, low=one.low, high=one.high, goal="higher"))
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


def _row(
    measure: str, method: str, one: Estimate, pilot: DronePilot, published: float, half: float
) -> Row:
    """Return the row of a published number."""
    name, unit, goal = MEASURES[measure]
    title = f"{name}, {method} ({PILOTS[pilot]})"
    why = REASONS[measure]
    return Row(title, one.mean, published, unit, one.low, one.high, half, goal, why)


NOTES = (
    "Rooms, times and measures are those of the code: a drone succeeds that came within 0.5 m of "
    "its goal, and touched no drone and no cylinder after 1.5 s. Half of the rooms have one goal "
    "for all drones.",
    "The published curves by density and number of drones are in figures without numbers, which "
    "are not read here; the text says that success does not depend on them up to 80 % and 32 "
    "drones.",
    "Both pilots know the true state, and A* the whole room; QuadSwarm's policy knows two drones "
    "and the distances to cylinders around it, and commands rotor thrusts.",
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
    minutes=2.5,
    compute=_compute,
)
