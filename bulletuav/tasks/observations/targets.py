"""Observation blocks of targets that drones see or visit, and of charge and power."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.sensors.sight import AHEAD
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.base import Block, make_missing_error, require_task_memory
from bulletuav.tasks.targets import compute_seen_fraction

TRACK_MEMORY = ("track", "track_detected", "track_age")
"""Arrays of `bulletuav.tasks.parts.target_track.TargetTrack` that `target_track` shows"""
MAX_POWER = 1000.0
"""Bound of observed power, W"""
NUM_CELLS = 12
"""Maximum number of the nearest squares whose idleness is observed"""


@register("observation")
@block([Label("charge", "1", 0.0, 1.0)])
def battery(charge: float) -> float:
    """Remaining fraction of the battery's charge."""
    return charge


@register("observation")
@block([Label("power", "W", 0.0, MAX_POWER)])
def power(power: float) -> float:
    """Mean power of the drone in the decision."""
    return power


@register("observation")
def targets(task: Any) -> Block:
    """Targets of the task: position relative to the drone, and whether the drone sees them."""
    size = task.arena_high - task.arena_low
    labels: list[Label] = []
    for k in range(1, task.num_targets + 1):
        offset = vector_labels(f"target {k}", "m", -size, size)
        labels += [*offset, Label(f"target {k} seen", "1", 0.0, 1.0)]

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        places = task.targets(frame.scene)
        offset = places[:, None] - frame.known_position[:, :, None]
        seen = frame.readings["sight"][..., None]
        return np.concatenate([offset, seen], axis=-1).reshape(*present.shape, len(labels))

    return Block(tuple(labels), compute)


def _contribution_labels(task: Any) -> tuple[Label, ...]:
    require_targets(task, "contribution_ahead")
    ahead = [Label(f"contribution gain {way}", "%", -100.0, 100.0) for way in AHEAD]
    return (Label("contribution", "%", 0.0, 100.0), *ahead)


@register("observation")
@block(_contribution_labels)
def contribution_ahead(
    i: int, all_present: np.ndarray, all_sight: np.ndarray, sight_ahead: np.ndarray, out: np.ndarray
) -> None:
    """Contribution: percentage of the targets that only the drone itself sees; and gains 30 m away.

    A gain is the difference that a move of the drone alone would make to the contribution. The
    places are those of the reading `sight_ahead`: east, north, west and south of the drone.
    """
    drones, count = all_sight.shape
    for j in range(count):
        is_seen = False
        for k in range(drones):
            is_seen = is_seen or (k != i and all_present[k] and all_sight[k, j])
        if is_seen:
            continue
        here = 100.0 / count if all_sight[i, j] else 0.0
        out[0] += here
        for place in range(1, len(out)):
            there = 100.0 / count if sight_ahead[(place - 1) * count + j] else 0.0
            out[place] += there - here


@register("observation")
def target_track(task: Any) -> Block:
    """Track of the target: whether it is detected now, its offset, velocity, and the track's age.

    The track is that of all drones of the world; see `bulletuav.tasks.parts.target_track`. The
    offset is from the drone to the estimated position. The age is the time since the last
    detection, or since the start.
    """
    require_task_memory(task, "target_track", TRACK_MEMORY)
    size, speed = task.arena_high - task.arena_low, np.full(3, 2 * task.context.max_speed)
    labels = (
        Label("track detected", "1", 0.0, 1.0),
        *vector_labels("track position", "m", -size, size),
        *vector_labels("track velocity", "m/s", -speed, speed),
        Label("track age", "s", 0.0, task.context.duration),
    )

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        track, detected, age = (frame.scene.memory[name] for name in TRACK_MEMORY)
        rows = np.empty((*present.shape, len(labels)))
        rows[..., 0] = detected[:, None]
        rows[..., 1:4] = track[:, None, :3] - frame.known_position
        rows[..., 4:7] = track[:, None, 3:]
        rows[..., 7] = age[:, None]
        return rows

    return Block(labels, compute)


@register("observation")
def seen_share(task: Any) -> Block:
    """Fraction of the task's active targets that the drone sees."""
    require_targets(task, "seen_share")

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        active = task.active_targets(frame.scene)[:, None]
        return compute_seen_fraction(frame.readings["sight"], active)[..., None]

    return Block((Label("seen share", "1", 0.0, 1.0),), compute)


@register("observation")
def centroids(task: Any) -> Block:
    """Horizontal centroid of all active targets, and of the drone's own targets.

    A drone's own targets are those closer to it than to other active drones; all if it has none.
    """
    require_targets(task, "centroids")
    bounds = [(task.arena_low[axis], task.arena_high[axis]) for axis in (0, 1)]
    labels = tuple(
        Label(f"{whose}centroid {axis}", "m", float(low), float(high))
        for whose in ("", "own ")
        for axis, (low, high) in zip("xy", bounds, strict=True)
    )

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        place = task.targets(frame.scene)[..., :2]
        active = task.active_targets(frame.scene)[:, None]
        # Horizontal distances; inactive drones have no own targets
        gap = np.linalg.norm(place[:, None] - frame.known_position[:, :, None, :2], axis=-1)
        gap = np.where(present[..., None], gap, np.inf)
        # A target at equal distances belongs to both drones
        own = (gap == gap.min(axis=1, keepdims=True)) & active & present[..., None]
        own = np.where(own.any(axis=-1, keepdims=True), own, active)
        of_all = _mean(place, np.broadcast_to(active, own.shape))
        return np.concatenate([of_all, _mean(place, own)], axis=-1)

    return Block(labels, compute)


def _mean(place: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the means (W, N, 2) of the positions (W, U, 2) that are `chosen` (W, N, U)."""
    # In the order of the targets; a product of matrices adds in another order on each processor
    total = np.add.reduce(np.where(chosen[..., None], place[:, None], 0.0), axis=2)
    mean: np.ndarray = total / np.maximum(chosen.sum(axis=-1, keepdims=True), 1)
    return mean


@register("observation")
def sight_matrix(task: Any) -> Block:
    """Which drone sees which target: the drone's own row first, then the others by index."""
    drones, count = task.context.num_drones, task.num_targets
    names = ["own", *(f"other {k}" for k in range(1, drones))]
    labels = tuple(
        Label(f"{name} sees {j}", "1", 0.0, 1.0) for name in names for j in range(1, count + 1)
    )
    order = np.array([[i, *(j for j in range(drones) if j != i)] for i in range(drones)])

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        seen = frame.readings["sight"] & present[..., None]
        ordered: np.ndarray = seen[:, order].reshape(*present.shape, len(labels))
        return ordered

    return Block(labels, compute)


def require_targets(task: Any, name: str) -> None:
    """Check that the task of a block has targets.

    Raises:
        ValueError: If the task has none.
    """
    if not task.num_targets:
        raise make_missing_error(task, name)


@register("observation")
def idleness(task: Any) -> Block:
    """Time since squares of the ground were last visited: mean, and those of some squares.

    The mean of all squares comes first, then the horizontal position relative to the drone and the
    idleness of the most idle square, and of the nearest ones, sorted by distance. Idleness is known
    to all drones.
    """
    require_task_memory(task, "idleness", ("idleness",))
    size = task.arena_high - task.arena_low
    near = min(NUM_CELLS, task.num_targets)
    time = task.context.duration
    labels = [Label("mean idleness", "s", 0.0, time)]
    for name in ("most idle", *(f"square {k}" for k in range(1, near + 1))):
        labels += vector_labels(name, "m", -size, size)[:2]
        labels.append(Label(f"{name} idleness", "s", 0.0, time))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        scene = frame.scene
        idle, active = scene.memory["idleness"], task.active_targets(scene)
        cells = task.targets(scene)[:, None, :, :2]
        offset = cells - frame.known_position[:, :, None, :2]
        squared = offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1]
        squared = np.where(active[:, None], squared, np.inf)
        nearest = np.argsort(squared, axis=-1, kind="stable")[..., :near]
        most = np.broadcast_to(idle.argmax(axis=1)[:, None, None], (*present.shape, 1))
        chosen = np.concatenate([most, nearest], axis=-1)[..., None]
        times = np.broadcast_to(idle[:, None, :, None], (*squared.shape, 1))
        rows = np.take_along_axis(np.concatenate([offset, times], axis=-1), chosen, axis=2)
        mean = (idle.sum(axis=1) / active.sum(axis=1))[:, None, None] + np.zeros(
            (*present.shape, 1)
        )
        return np.concatenate([mean, rows.reshape(*present.shape, -1)], axis=-1)

    return Block(tuple(labels), compute)
