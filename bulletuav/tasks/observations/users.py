"""Observation blocks of what drones do for users on the ground."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bulletuav.network.link import capacity
from bulletuav.tasks.observations.motion import Block, Label

if TYPE_CHECKING:
    from bulletuav.tasks.base import Task

MAX_POWER = 1000.0  # W
MAX_DATA_RATE = 500.0  # Mbit/s
MAX_QUEUE = 100.0  # tasks


def power(task: "Task") -> Block:
    """Power that the drone takes, mean of the decision."""
    return Block(
        (Label("power", "W", 0.0, MAX_POWER),),
        lambda frame, present: frame.readings["power"][..., None],
    )


def centroids(task: "Task") -> Block:
    """Over ground, the centroid of all targets, and that of those nearer to the drone than to other living ones, if any."""
    bounds = [(task.arena_low[axis], task.arena_high[axis]) for axis in (0, 1)]
    labels = tuple(
        Label(f"{affected}centroid {name}", "m", float(low), float(high))
        for affected in ("", "own ")
        for name, (low, high) in zip("xy", bounds, strict=True)
    )

    def compute(frame, present):
        place, active_targets = task.targets(frame.scene)[..., :2], task.active_targets(frame.scene)
        gap = np.linalg.norm(place[:, None] - frame.known_position[:, :, None, :2], axis=-1)
        gap = np.where(present[..., None], gap, np.inf)
        own = (gap == gap.min(axis=1, keepdims=True)) & active_targets[:, None] & present[..., None]
        own = np.where(own.any(axis=-1, keepdims=True), own, active_targets[:, None])
        of_all, of_own = (
            _mean(place, weight)
            for weight in (np.broadcast_to(active_targets[:, None], own.shape), own)
        )
        return np.concatenate([of_all, of_own], axis=-1)

    return Block(labels, compute)


def _mean(place: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(W, N, 2) mean of the places (W, U, 2) that are `chosen` (W, N, U)."""
    return chosen.astype(float) @ place / np.maximum(chosen.sum(axis=-1, keepdims=True), 1)


def sight_matrix(task: "Task") -> Block:
    """Which drone sees which target: the drone itself first, then the others by index."""
    drones, count = task.context.num_drones, task.num_targets
    names = ["own", *(f"other {k}" for k in range(1, drones))]
    labels = tuple(
        Label(f"{name} sees {j}", "1", 0.0, 1.0) for name in names for j in range(1, count + 1)
    )
    order = np.array([[i, *(j for j in range(drones) if j != i)] for i in range(drones)])

    def compute(frame, present):
        seen = frame.readings["sight"] & present[..., None]
        return seen[:, order].reshape(*present.shape, len(labels))

    return Block(labels, compute)


def dwell_time(task: "Task") -> Block:
    """For how long the drone has seen targets without a break, mean of all."""
    _require(task, "dwell_time", ["dwell_time"])
    label = Label("dwell_time", "s", 0.0, task.context.duration)
    return Block((label,), lambda frame, present: frame.scene.memory["mean_dwell_time"][..., None])


def server(task: "Task") -> Block:
    """Utilisation of the drone's cores, queue, latency and share of completed tasks of its users, in the last decision."""
    names = ["utilisation", "queue", "latency", "completed_share"]
    _require(task, "server", names)
    labels = (
        Label("utilisation", "1", 0.0, 1.0),
        Label("queue", "tasks", 0.0, MAX_QUEUE),
        Label("latency", "s", 0.0, float(task.config.deadline)),
        Label("completed share", "1", 0.0, 1.0),
    )
    return Block(
        labels,
        lambda frame, present: np.stack([frame.scene.memory[name] for name in names], axis=-1),
    )


def link_rates(task: "Task") -> Block:
    """Rate that each user would reach to the drone if it had it for itself."""
    _require(task, "link_rates", ["received"])
    band, noise = task.config.bandwidth, task.uplink.noise  # type: ignore[attr-defined]
    labels = tuple(
        Label(f"rate of user {j}", "Mbit/s", 0.0, MAX_DATA_RATE)
        for j in range(1, task.num_targets + 1)
    )
    return Block(
        labels, lambda frame, present: capacity(band, frame.scene.memory["received"] / noise) / 1e6
    )


def _require(task: "Task", block: str, names: Sequence[str]) -> None:
    """Raise ValueError unless the task remembers what the block shows."""
    if not task.memory().keys() >= set(names):
        raise ValueError(
            f"observation block {block!r} shows what task {task.name!r} does not have: leave it out"
        )
