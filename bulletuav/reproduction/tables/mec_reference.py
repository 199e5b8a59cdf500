"""Reference table of airborne edge computing: energy and delay of seven policies."""

import math

import numpy as np
from matplotlib.figure import Figure

from bulletuav.analysis.metrics import Estimate
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.edge_reference import (
    EDGE_CITIES,
    EDGE_SEED,
    LEARNED,
    TRAINING_SEED,
    EdgeFlight,
    EdgeScene,
    fly_edge_scenes,
)
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome
from bulletuav.version import REPOSITORY

HEURISTICS = ("stay", "hotspot", "kmeans", "oracle")
"""Baselines: hovering in place, hotspots of users, clusters of users, and full information"""
SCENES = (
    EdgeScene("mec", "medium", (*HEURISTICS, *LEARNED), steps=800_000),
    EdgeScene("mec_advanced", "medium", (*HEURISTICS, "trained", "fast_ppo"), steps=400_000),
    EdgeScene("mec", "easy", ("stay", "kmeans", "oracle", "trained")),
)
"""Scenes of the table. The policy `trained` of `mec` is for the three drones of easy only."""
DYNAMICS = ("point_mass", "rigid_body")
"""Dynamics of all columns, and of the last one"""
COLUMNS = {
    "completed": ("fraction of completed tasks", ""),
    "latency": ("mean delay", "s"),
    "drone_power": ("power of a drone", "W"),
    "task_energy": ("energy per completed task", "J"),
    "safe_success": ("safe success", ""),
    "return": ("return", ""),
}
"""Metrics of the table, with name and unit"""
RIGID_BODY = "fraction of completed tasks in rigid_body"
"""Name of the last column"""
DIGITS = 4
"""Number of significant digits of the published numbers"""
SHOWN = ("completed", "latency", "task_energy")
"""Metrics of the picture"""
PUBLISHED: dict[tuple[str, str], tuple[float, ...]] = {
    ("mec medium", "stay"): (0.5319, 0.7456, 73.17, 73.57, 0.0, 20.61, 0.5319),
    ("mec medium", "hotspot"): (0.6266, 0.691, 71.96, 61.42, 0.02, 26.38, 0.6268),
    ("mec medium", "kmeans"): (0.6568, 0.6766, 72.67, 59.14, 0.08, 26.7, 0.6575),
    ("mec medium", "oracle"): (0.8386, 0.593, 73.52, 46.88, 0.98, 35.57, 0.8396),
    ("mec medium", "fast_ppo"): (0.7459, 0.6447, 71.1, 49.99, 0.54, 31.88, 0.7557),
    ("mec medium", "mappo"): (0.7415, 0.6459, 70.3, 50.11, 0.55, 31.85, 0.7493),
    ("mec_advanced medium", "stay"): (0.3282, 0.1734, 89.26, 43.57, 0.0, 24.37, 0.3282),
    ("mec_advanced medium", "hotspot"): (0.6359, 0.1423, 106.6, 26.83, 0.05, 46.87, 0.6302),
    ("mec_advanced medium", "kmeans"): (0.6856, 0.1411, 109.3, 25.52, 0.18, 43.39, 0.6783),
    ("mec_advanced medium", "oracle"): (0.9183, 0.121, 124.8, 21.74, 0.99, 63.79, 0.9112),
    ("mec_advanced medium", "trained"): (0.6471, 0.1456, 107.3, 25.47, 0.15, 47.16, 0.6519),
    ("mec_advanced medium", "fast_ppo"): (0.6395, 0.1458, 107.3, 25.71, 0.1, 45.35, 0.6108),
    ("mec easy", "stay"): (0.4457, 0.8024, 73.44, 66.25, 0.01, 18.88, 0.4457),
    ("mec easy", "kmeans"): (0.5708, 0.7387, 72.98, 51.47, 0.07, 25.22, 0.571),
    ("mec easy", "oracle"): (0.762, 0.6499, 74.23, 39.17, 0.98, 35.93, 0.7629),
    ("mec easy", "trained"): (0.6616, 0.6952, 68.03, 40.95, 0.45, 30.48, 0.6615),
}
"""Published numbers by scene and policy: those of `COLUMNS`, then `RIGID_BODY`"""


def rounding_error(number: float) -> float:
    """Return half a unit of the last of `DIGITS` significant digits; 0 for 0."""
    if number == 0:
        return 0.0
    return float(0.5 * 10.0 ** (math.floor(math.log10(abs(number))) + 1 - DIGITS))


def make_edge_rows(flights: list[EdgeFlight], size: float) -> list[Row]:
    """Return the rows of the table.

    Args:
        flights: Results of all policies, in each of `DYNAMICS`.
        size: Fraction of the full size; a policy that is trained less is another one.
    """
    rows = []
    for flight in flights:
        case = flight.scene.name, flight.policy
        known = PUBLISHED.get(case, (None,) * (len(COLUMNS) + 1))
        shrunk = flight.policy in LEARNED and size < 1
        why = f"trained with {size:g} of the decisions of the full table" if shrunk else ""
        if flight.dynamics == DYNAMICS[0]:
            cells = [(*COLUMNS[key], flight.estimates[key]) for key in COLUMNS]
            numbers = known[:-1]
        else:
            cells = [(RIGID_BODY, "", flight.estimates["completed"])]
            numbers = known[-1:]
        rows += [
            _make_row(f"{case[0]}, {case[1]}: {name}", unit, found, number, why, size == 1)
            for (name, unit, found), number in zip(cells, numbers, strict=True)
        ]
    return rows


def _make_row(
    name: str, unit: str, found: Estimate, published: float | None, why: str, is_whole: bool
) -> Row:
    """Return a row of the table; the whole table has the same episodes as the published one."""
    tolerance = rounding_error(published or 0.0)
    return Row(
        name,
        found.mean,
        published,
        unit,
        found.low,
        found.high,
        tolerance=tolerance,
        why=why,
        is_exact=is_whole,
    )


def _compute(settings: Settings) -> TableOutcome:
    """Train, fly, and compare."""
    flights = list(fly_edge_scenes(SCENES, DYNAMICS, settings))
    rows = make_edge_rows(flights, settings.size)
    episodes = flights[0].estimates["completed"].episodes
    notes = (
        "The published numbers are those of a run of this command, 30 November 2026.",
        f"{episodes} episodes of each policy, seeds {EDGE_SEED} to {EDGE_SEED + episodes - 1}, "
        f"over {EDGE_CITIES['num_layouts']} cities that no training has seen.",
        "stay, hotspot, kmeans and oracle read the true state; oracle ignores interference and "
        "queues, so that it is a strong baseline and no upper bound.",
        f"{' and '.join(LEARNED)} are trained by this command with seed {TRAINING_SEED}, mappo "
        "with a critic that observes the state of the world; trained is the policy in the package.",
    )
    hashes = {f"{one.scene.name}, {one.policy}, {one.dynamics}": one.hash for one in flights}
    return TableOutcome(rows, _draw(flights), notes, {"hashes": hashes})


def _draw(flights: list[EdgeFlight]) -> Figure:
    """Draw a panel for each scene and metric, with a line for each policy."""
    figure = blank_figure(10, 7)
    heights = [len(scene.policies) for scene in SCENES]
    grid = figure.subplots(len(SCENES), len(SHOWN), squeeze=False, height_ratios=heights)
    for scene, panels in zip(SCENES, grid, strict=True):
        mine = [one for one in flights if one.scene == scene and one.dynamics == DYNAMICS[0]]
        names = [one.policy for one in mine]
        place = np.arange(len(mine))
        for key, axes in zip(SHOWN, panels, strict=True):
            found = [one.estimates[key] for one in mine]
            mean = np.array([one.mean for one in found])
            sides = [mean - [one.low for one in found], [one.high for one in found] - mean]
            axes.errorbar(mean, place, xerr=sides, fmt="o", capsize=3, label="bulletuav, 95 %")
            column = list(COLUMNS).index(key)
            known = [
                (PUBLISHED[scene.name, name][column], k)
                for k, name in enumerate(names)
                if (scene.name, name) in PUBLISHED
            ]
            axes.plot(*np.reshape(known, (-1, 2)).T, "kx", label="published")
            name, unit = COLUMNS[key]
            axes.set(xlabel=f"{name}, {unit}" if unit else name, ylim=(len(mine) - 0.5, -0.5))
            axes.set_yticks(place, names if key == SHOWN[0] else [])
            axes.grid(alpha=0.3)
        panels[1].set_title(scene.name)
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


REPRODUCTION = Reproduction(
    title="Reference of airborne edge computing: energy and delay",
    publication="the bulletuav authors, docs/benchmarks/mec_reference.md, 2026",
    address=REPOSITORY,
    about=(
        "Drones with servers compute the tasks of users on the ground of a city. Hovering in "
        "place, two heuristics, an oracle and learned policies are compared by the fraction of "
        "tasks computed in time, delay, power, energy per task, safe success and return."
    ),
    minutes=7,
    compute=_compute,
    is_parallel=True,
)
