"""Sampling of large swarms for replay pages, so that pages stay small and fluent.

All drones of a large swarm are in the page, by their positions at sampled rows. Only some of them
have attitudes, tracks, goals and plots.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.recorded import Recording

MAX_DETAILED = 256
"""Maximum number of drones that all have attitudes, tracks, goals and plots"""
MAX_POSITIONS = 3_000_000
"""Maximum number of positions of a larger swarm: drones times rows"""
PER_DRONE = ("velocity", "quaternion", "rates")
"""Arrays of the recording (R, N, ...) of which only those of drones in detail are in the page"""


class Sample(NamedTuple):
    """Part of a recording that a page contains.

    Attributes:
        recording: The sampled rows and decisions. Arrays of positions, ends and separations contain
            all drones, those in detail first; other arrays only drones in detail.
        about: Constant part of the scene, of all drones in the same order.
        drones: Indices in the recording of the drones in detail.
        order: (N,) indices in the recording of all drones.
        every: Number of decisions between two rows.
    """

    recording: Recording
    about: dict[str, Any]
    drones: list[int]
    order: np.ndarray
    every: int


def take_whole(recording: Recording, about: dict[str, Any]) -> Sample:
    """Return the whole recording as a sample."""
    order = np.arange(recording.position.shape[1])
    return Sample(recording, about, order.tolist(), order, 1)


def take_sample(recording: Recording, about: dict[str, Any]) -> Sample:
    """Sample a recording of more than `MAX_DETAILED` drones; return a smaller swarm whole.

    A conflict or contact between two sampled rows is shown at the later one. Other numbers of
    decisions are those of the decision that ends at the row.

    Args:
        recording: The episode.
        about: Constant part of its scene.
    """
    rows, drones = recording.position.shape[:2]
    if drones <= MAX_DETAILED:
        return take_whole(recording, about)
    every = -(-rows // max(MAX_POSITIONS // drones, 2))
    row = np.unique(np.append(np.arange(0, rows, every), rows - 1))
    detailed = spread(drones, MAX_DETAILED)
    order = np.append(detailed, np.delete(np.arange(drones), detailed))

    def states(values: np.ndarray) -> np.ndarray:
        taken: np.ndarray = values[row][:, detailed[: values.shape[1]]]
        return taken

    def decisions(values: np.ndarray) -> np.ndarray:
        taken: np.ndarray = values[row[1:] - 1][:, detailed]
        return taken

    nearest = np.minimum.reduceat(recording.separation, row[:-1], axis=0)
    changed: dict[str, Any] = {
        name: states(getattr(recording, name)) for name in (*PER_DRONE, "goal")
    }
    changed |= {
        name: getattr(recording, name)[row] for name in ("time", "obstacle", "target", "seen")
    }
    taken = dataclasses.replace(
        recording,
        **changed,
        position=recording.position[row][:, order],
        alive=recording.alive[row][:, order],
        separation=nearest[:, order],
        reward=decisions(recording.reward),
        contact_step=np.searchsorted(row, recording.contact_step + 1) - 1,
        info={name: decisions(values) for name, values in recording.info.items()},
        reading={name: states(values) for name, values in recording.reading.items()},
        scene=_sample_scene(recording.scene, row, order, states),
    )
    kinds = [about["airframe_of"][drone] for drone in order.tolist()]
    return Sample(taken, {**about, "airframe_of": kinds}, detailed.tolist(), order, every)


def spread(count: int, size: int) -> np.ndarray:
    """Return `size` different indices below `count`, of which any first ones are spread evenly.

    These are the first different floors of `count` times the van der Corput sequence in base 2.
    """
    bits = (count - 1).bit_length()
    numbers = np.arange(2**bits)
    reverse = np.zeros_like(numbers)
    for bit in range(bits):
        reverse |= (numbers >> bit & 1) << bits - 1 - bit
    floors = reverse * count >> bits
    _, first = np.unique(floors, return_index=True)
    chosen: np.ndarray = floors[np.sort(first)][:size]
    return chosen


def _sample_scene(
    scene: Any, row: np.ndarray, order: np.ndarray, states: Callable[[np.ndarray], np.ndarray]
) -> dict[str, np.ndarray]:
    """Sample the arrays of the scene that depend on the row or the drone."""
    taken = dict(scene)
    for name in {"rotor_speed", "deflection", "airspeed"} & set(scene):
        taken[name] = states(scene[name])
    for name in {"obstacle_quaternion", "cable"} & set(scene):
        taken[name] = scene[name][row]
    number, drone, target = scene["link"].T
    is_kept = np.isin(number, row)
    rank = np.argsort(order)
    kept = (np.searchsorted(row, number[is_kept]), rank[drone[is_kept]], target[is_kept])
    taken["link"] = np.column_stack(kept)
    return taken
