"""Observation blocks of service to users on the ground, and of charging pads there."""

from typing import Any

import numpy as np

from bulletuav.network.link import capacity
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block, require_task_memory

MAX_DATA_RATE = 500.0
"""Bound of an observed data rate, Mbit/s"""
MAX_QUEUE = 100.0
"""Bound of an observed queue, tasks"""


@register("observation")
def dwell_time(task: Any) -> Block:
    """Time for which the drone has seen targets without interruption, mean over targets."""
    require_task_memory(task, "dwell_time", ("dwell_time",))
    label = Label("dwell_time", "s", 0.0, task.context.duration)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        return frame.scene.memory["mean_dwell_time"][..., None]

    return Block((label,), compute)


@register("observation")
def server(task: Any) -> Block:
    """Utilisation of the drone's cores, queue, latency and completed fraction of tasks.

    All refer to the last decision.
    """
    names = ("utilisation", "queue", "latency", "completed_share")
    require_task_memory(task, "server", names)
    labels = (
        Label("utilisation", "1", 0.0, 1.0),
        Label("queue", "tasks", 0.0, MAX_QUEUE),
        Label("latency", "s", 0.0, float(task.config.deadline)),
        Label("completed share", "1", 0.0, 1.0),
    )

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        numbers = np.empty((*present.shape, len(names)))
        for k, name in enumerate(names):
            numbers[..., k] = frame.scene.memory[name]
        return numbers

    return Block(labels, compute)


@register("observation")
def link_rates(task: Any) -> Block:
    """Rate of each user's link to the drone with the whole bandwidth."""
    require_task_memory(task, "link_rates", ("received",))
    band, noise = task.config.bandwidth, task.service.uplink.noise
    users = range(1, task.num_targets + 1)
    labels = tuple(Label(f"rate of user {j}", "Mbit/s", 0.0, MAX_DATA_RATE) for j in users)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        rate: np.ndarray = capacity(band, frame.scene.memory["received"] / noise) / 1e6
        return rate

    return Block(labels, compute)


@register("observation")
def pads(task: Any) -> Block:
    """Nearest charging pads: relative position, and whether it charges another drone.

    Sorted by horizontal distance. The last number is 1 while the drone itself is being charged.
    Pads measure relative positions, which are therefore free of GPS errors.
    """
    require_task_memory(task, "pads", ("pad", "pad_drone"))
    size = task.arena_high - task.arena_low
    shown = min(task.memory()["pad_drone"][0], task.context.num_neighbours)
    labels: list[Label] = []
    for k in range(1, shown + 1):
        labels += vector_labels(f"pad {k}", "m", -size, size)
        labels.append(Label(f"pad {k} taken", "1", 0.0, 1.0))
    labels.append(Label("charging", "1", 0.0, 1.0))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        memory = frame.scene.memory
        # The drone that each pad charges, for each observer: (W, N, K) bool
        drone = memory["pad_drone"][:, None]
        is_own = drone == np.arange(1, present.shape[1] + 1)[:, None]
        is_taken = (drone > 0) & ~is_own
        offset = memory["pad"][:, None] - frame.after.position[:, :, None]
        rows = np.concatenate([offset, is_taken[..., None]], axis=-1)
        squared = offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1]
        nearest = np.argsort(squared, axis=-1, kind="stable")[..., :shown, None]
        rows = np.take_along_axis(rows, nearest, axis=2).reshape(*present.shape, 4 * shown)
        return np.concatenate([rows, is_own.any(axis=-1)[..., None]], axis=-1)

    return Block(tuple(labels), compute)
