"""Measure in how many flights the intervals of `bulletuav identify` hold the true constants.

    python benchmarks/intervals.py --out out/intervals [--logs 40] [--seed 0]

Flies a Crazyflie of known constants, adds the noise of motion capture and a gyroscope, and fits a
wrong idea of it: flights of 40 s for most constants, of 20 s near the ground and below another
drone. Flights that touch the ground are flown anew with another seed, since logs are of flights.
Writes intervals.md and intervals.csv.
"""

import argparse
import csv
import dataclasses
import itertools
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.progress import track
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import flown

from bulletuav import load_airframe
from bulletuav.identification.identify import identify

TRUE = load_airframe("cf2x")
WRONG = {
    "thrust_coefficient": 1.12 * TRUE.thrust_coefficient,
    "torque_ratio": 0.8 * TRUE.torque_ratio,
    "drag_xy": 0.7 * TRUE.drag_xy,
    "drag_z": 0.7 * TRUE.drag_z,
    "drag_height": 0.6 * TRUE.drag_height,
    "lag_up": 0.75 * TRUE.lag_up,
    "lag_down": 0.75 * TRUE.lag_down,
    "inertia": (1.2 * TRUE.inertia[0], 1.2 * TRUE.inertia[1], TRUE.inertia[2]),
    "damping": (1.0, 1.0, 3.0),
}
LEVEL = 0.95
STOOD = 0.02
"""Height below which a Crazyflie stands or scrapes, m"""
LOW, JOLT = 0.1, 3.0
"""Height (m) below which such a change of vertical acceleration between rows (m/s^2) is a touch"""


class Case(NamedTuple):
    """A kind of flight.

    Attributes:
        seconds: Duration of its logs, s.
        wrong: What is wrong about the airframe that is fitted.
        fit: What is fitted; empty for all that the logs tell.
        columns: Columns of the logs.
        places: Draws what `flown.fly` flies along.
    """

    seconds: float
    wrong: dict[str, object]
    fit: tuple[str, ...]
    columns: tuple[str, ...]
    places: Callable[[np.random.Generator], dict[str, object]]


def _low(rng: np.random.Generator) -> dict[str, object]:
    """Fly up and down 4 to 11 cm above the ground."""
    rate, phase = rng.uniform(0.25, 0.5), rng.uniform(0, 2 * np.pi, 3)

    def path(time: float) -> np.ndarray:
        height = 0.075 + 0.035 * np.sin(2 * np.pi * rate * time + phase[2])
        return np.array([0.3 * np.sin(0.9 * time + phase[0]), 0.3 * np.cos(0.7 * time), height])

    return {"path": path}


def _below(rng: np.random.Generator) -> dict[str, object]:
    """Fly through the wake of a drone that hovers 0.3 to 0.6 m above."""
    rate, phase = rng.uniform(0.7, 1.3, 2), rng.uniform(0, 2 * np.pi, 2)
    top = np.array([0.0, 0.0, 3.1 + rng.uniform(0.3, 0.6)])

    def path(time: float) -> np.ndarray:
        x, y = 0.12 * np.sin(rate * time + phase)
        return np.array([x, y, 3.1])

    return {"path": path, "other": lambda time: top}


CASES = {
    "usual": Case(40.0, WRONG, (), flown.COLUMNS, lambda rng: {}),
    "near the ground": Case(
        20.0,
        {"ground_effect_gain": 0.2, "ground_effect_reach": 0.2},
        ("ground_effect", "thrust"),
        flown.COLUMNS,
        _low,
    ),
    "in a wake": Case(
        20.0,
        {"wake_share": 0.2, "wake_spread": 0.14},
        ("wake", "thrust"),
        (*flown.COLUMNS, "other_x", "other_y", "other_z"),
        _below,
    ),
}


def fly(case: Case, seeds: "itertools.count[int]") -> tuple[int, np.ndarray]:
    """Return the next seed with which nothing is touched, and the rows of its flight."""
    while True:
        seed = next(seeds)
        places = case.places(np.random.default_rng(seed))
        rows = flown.fly(TRUE, case.seconds, seed=seed, **places)
        height = rows[:, 3]
        jolt = np.abs(np.diff(height, 3)) * flown.HZ**2
        if height.min() > STOOD and not (jolt[height[3:] < LOW] > JOLT).any():
            return seed, flown.noisy(rows, seed)


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, fit, count, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/intervals"))
    parser.add_argument("--logs", type=int, default=40, help="logs of each kind (40)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first log (0)")
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    held: dict[tuple[str, str], list[bool]] = defaultdict(list)
    widths: dict[tuple[str, str], list[float]] = defaultdict(list)
    rows: list[tuple[object, ...]] = [("case", "seed", "constant", "low", "true", "high")]
    lines = ["| flights | constant | held | share | 95 % interval of it | length of intervals |"]
    lines.append("|---|---|---|---|---|---|")
    for name, case in CASES.items():
        seeds = itertools.count(given.seed)
        start = dataclasses.replace(TRUE, **case.wrong)
        for _ in track(range(given.logs), description=name):
            seed, log = fly(case, seeds)
            path = flown.write(given.out / "log.csv", log, case.columns)
            for one in identify([path], start, fit=case.fit).estimates:
                true = one.constant.get(TRUE)
                rows.append((name, seed, one.constant.name, one.low, true, one.high))
                if one.is_identified:
                    held[name, one.constant.name].append(one.low <= true <= one.high)
                    widths[name, one.constant.name].append((one.high - one.low) / true)
        of_case = {key: found for key, found in held.items() if key[0] == name}
        for (_, constant), found in of_case.items():
            length = f"{np.median(widths[name, constant]):.1%}"
            lines.append(_line(name, constant, found, length))
        lines.append(_line(name, "all", [one for found in of_case.values() for one in found], ""))
        # After each kind, so that what is interrupted leaves what was found
        with open(given.out / "intervals.csv", "w", newline="") as file:
            csv.writer(file).writerows(rows)
        (given.out / "intervals.md").write_text("\n".join(lines) + "\n")
    sys.stdout.write((given.out / "intervals.md").read_text())


def _line(name: str, constant: str, found: Sequence[bool], length: str) -> str:
    """Lay out one line of the table."""
    count = sum(found)
    reach = binomtest(count, len(found)).proportion_ci(LEVEL)
    share = f"{count / len(found):.3f} | {reach.low:.3f} to {reach.high:.3f}"
    return f"| {name} | {constant} | {count} of {len(found)} | {share} | {length} |"


if __name__ == "__main__":
    main()
