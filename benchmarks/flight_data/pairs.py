"""Wake of a Crazyflie: push and moment on another one below it (logs of Neural-Swarm)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from bulletuav.reproduction import wake_pairs
from bulletuav.reproduction.wake_pairs import PAIR_HALF_ARM as HALF_ARM
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data import model
from flight_data.neural_swarm import load
from flight_data.series import binned, binned_error, rms

__all__ = ["HALF_ARM"]
DISTANCES = (0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.2, 0.25)
DROPS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7)
"""Edges of bins, m"""
FEWEST = 50
"""Least samples of a bin"""


@dataclass(frozen=True)
class Samples:
    """Samples of the lower drones of pairs.

    Attributes:
        distance: Horizontal distance to the upper one, m.
        drop: How far it is above, m.
        upper: Its thrust, grams.
        push: Force downwards, grams.
        moment: About the horizontal axis that lowers the side towards the upper one, mN m.
    """

    distance: np.ndarray
    drop: np.ndarray
    upper: np.ndarray
    push: np.ndarray
    moment: np.ndarray


def runs(folder: Path) -> list[tuple[Path, Path]]:
    """Return the pairs of logs of two unmodified Crazyflies in a clone, sorted."""
    return wake_pairs.find_log_pairs(folder, wake_pairs.SMALL_PAIRS)


def samples(pairs: Sequence[tuple[Path, Path]]) -> Samples:
    """Read pairs: each drone below the other in turn."""
    parts = []
    for paths in pairs:
        first, second = (load(path) for path in paths)
        a, b = wake_pairs.align_logs(first, second)
        for me, other, mine, its in ((first, second, a, b), (second, first, b, a)):
            felt = wake_pairs.measure_wake(me, other, mine, its)
            if felt is not None:
                columns = (felt.distance, felt.drop, felt.upper, felt.push, felt.moment)
                parts.append(tuple(values[felt.near] for values in columns))
    whole = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Samples(*whole)


def bins(felt: Samples) -> list[dict[str, float]]:
    """Return bins of drop and distance: means of where, upper thrust, push and moment; count."""
    rows = []
    for low, high in pairwise(DROPS):
        its = (felt.drop >= low) & (felt.drop < high)
        columns = {name: values[its] for name, values in vars(felt).items()}
        rows += binned(columns["distance"], DISTANCES, columns, FEWEST)
    return rows


def errors(felt: Samples, push: np.ndarray, moment: np.ndarray) -> list[float]:
    """Return RMS errors of a law: push of samples and bins, g; moment of samples and bins, mN m."""
    law = Samples(felt.distance, felt.drop, felt.upper, push, moment)
    measured, told = bins(felt), bins(law)
    result = []
    for name in ("push", "moment"):
        result.append(float(rms(getattr(felt, name) - getattr(law, name))))
        result.append(binned_error(measured, told, name))
    return result


def now(felt: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return push, g, and moment, mN m, by the law of this repository."""
    push = model.wake_force(felt.distance, felt.drop, felt.upper)
    return push, STANDARD_GRAVITY * model.wake_moment(felt.distance, felt.drop, felt.upper)
