"""Wake of a Crazyflie: push and moment on another one below it (logs of Neural-Swarm)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data import model
from flight_data.neural_swarm import DT, Log, load, training
from flight_data.series import LogError, binned, binned_error, moments, rms

FOLDERS = ("swap_small_small", "random_walk_small_small", "swap_ss", "randomwalk_ss")
"""Experiments with two unmodified Crazyflies"""
DISTANCES = (0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.2, 0.25)
DROPS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7)
"""Edges of bins, m"""
FEWEST = 50
"""Least samples of a bin"""
AWAY = 0.18
"""Horizontal distance from which no wake is felt, m"""
LOWEST = 0.3
"""Least height, m: out of the ground effect"""
HALF_ARM, INERTIA = 0.0325, 1.66e-5


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
    """Return the pairs of logs of a clone, sorted.

    Raises:
        LogError: There are none.
    """
    found = []
    for name in FOLDERS:
        for place in sorted(training(folder).glob(f"*/{name}")):
            for number in sorted(
                {path.name.split("_")[-1] for path in place.glob("cf*_[0-9][0-9]")}
            ):
                pair = sorted(place.glob(f"cf*_{number}"))
                if len(pair) == 2:
                    found.append((pair[0], pair[1]))
    if not found:
        raise LogError(f"{training(folder)}: no pairs of logs")
    return sorted(found)


def samples(pairs: Sequence[tuple[Path, Path]]) -> Samples:
    """Read pairs: each drone below the other in turn."""
    parts = []
    for paths in pairs:
        first, second = (load(path) for path in paths)
        count = min(len(first.time), len(second.time))
        start = round((second.time[0] - first.time[0]) / DT)
        # Both logs begin when the radio says so, and are cut to the time that they share.
        a = slice(max(start, 0), max(start, 0) + count - abs(start))
        b = slice(max(-start, 0), max(-start, 0) + count - abs(start))
        for me, other, mine, its in ((first, second, a, b), (second, first, b, a)):
            parts.append(_seen_by(me, other, mine, its))
    whole = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Samples(*whole)


def _seen_by(me: Log, other: Log, mine: slice, its: slice) -> tuple[np.ndarray, ...]:
    """Return what a drone feels, and where the other one is, in its own yaw."""
    apart = other.position[its] - me.position[mine]
    attitude = me.attitude[mine]
    forward = attitude[:, :2, 0] / np.linalg.norm(attitude[:, :2, 0], axis=1, keepdims=True)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    side = np.stack([np.sum(apart[:, :2] * axis, axis=1) for axis in (forward, left)], axis=1)
    distance, drop = np.linalg.norm(side, axis=1), apart[:, 2]
    usable = ~me.gap[mine] & ~other.gap[its] & (me.position[mine, 2] > LOWEST)
    free = usable & ((distance > AWAY) | (drop < 0.0))
    if free.sum() < 100:
        return tuple(np.zeros(0) for _ in range(5))
    # The mass is that of free flight, and the torque in free flight is the trim.
    lift, weight = me.lift()[mine], me.load[mine]
    push = lift - np.median((lift / weight)[free]) * weight
    rates = uniform_filter1d(me.rates[mine, :2], 5, axis=0)
    torque = INERTIA * np.gradient(rates, DT, axis=0)
    torque -= moments(me.thrust[mine] * STANDARD_GRAVITY / 1e3, HALF_ARM)
    torque -= np.median(torque[free], axis=0)
    towards = side / np.maximum(distance, 1e-6)[:, None]
    moment = 1e3 * (torque[:, 1] * towards[:, 0] - torque[:, 0] * towards[:, 1])
    upper = other.thrust[its].sum(axis=1)
    near = usable & (distance < DISTANCES[-1]) & (drop > DROPS[0]) & (drop < DROPS[-1])
    return tuple(values[near] for values in (distance, drop, upper, push, moment))


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
