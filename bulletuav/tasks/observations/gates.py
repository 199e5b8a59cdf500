"""Observation blocks of the gates of a race."""

import math
from typing import Any

import numpy as np

from bulletuav.geometry.rotation import Quat4, to_body
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.base import require_task_memory

PER_GATE = 10
"""Numbers per gate: position, direction, velocity (3 each) and width"""
AIM_BEYOND = 2.0
"""Distance beyond a gate at which a drone on its axis aims, m"""
AIM_RETREAT = 2.0
"""Distance by which a drone aims farther back per distance from the axis"""


def gate_labels(task: Any) -> tuple[Label, ...]:
    """Return the labels of the next gates."""
    require_task_memory(task, "next_gates", ("gate", "gate_axis", "gate_velocity", "gate_size"))
    size = np.full(3, float(np.linalg.norm(task.arena_high - task.arena_low)))
    fast = np.full(3, task.course.fastest)
    labels: list[Label] = []
    for k in range(1, task.config.gates_seen + 1):
        labels += vector_labels(f"gate {k} position", "m", -size, size)
        labels += vector_labels(f"gate {k} direction", "1", -np.ones(3), np.ones(3))
        labels += vector_labels(f"gate {k} velocity", "m/s", -fast, fast)
        labels.append(Label(f"gate {k} size", "m", 0.0, task.course.widest))
    return tuple(labels)


@register("observation")
@block(gate_labels)
def next_gates(
    known_position: np.ndarray,
    quaternion: Quat4,
    passed: float,
    all_gate: np.ndarray,
    all_gate_axis: np.ndarray,
    all_gate_velocity: np.ndarray,
    all_gate_size: np.ndarray,
    laps: int,
    out: np.ndarray,
) -> None:
    """Next gates, in body axes: position of the centre, direction of flight, velocity; and width.

    Padded with zeros after the last gate.
    """
    count = len(all_gate)
    for k in range(len(out) // PER_GATE):
        turn = int(passed) + k
        if turn >= laps * count:
            continue
        g = turn % count
        middle, ahead, moving = all_gate[g], all_gate_axis[g, 0], all_gate_velocity[g]
        offset = (
            middle[0] - known_position[0],
            middle[1] - known_position[1],
            middle[2] - known_position[2],
        )
        seen = (
            to_body(quaternion, offset),
            to_body(quaternion, (ahead[0], ahead[1], ahead[2])),
            to_body(quaternion, (moving[0], moving[1], moving[2])),
        )
        for m in range(3):
            for axis in range(3):
                out[PER_GATE * k + 3 * m + axis] = seen[m][axis]
        out[PER_GATE * k + 9] = all_gate_size[g]


def aim_labels(task: Any) -> tuple[Label, ...]:
    """Return the labels of the offset to the point to aim at."""
    require_task_memory(task, "gate_aim", ("gate", "gate_axis"))
    size = 4.0 * np.full(3, float(np.linalg.norm(task.arena_high - task.arena_low)))
    return vector_labels("aim", "m", -size, size)


@register("observation")
@block(aim_labels)
def gate_aim(
    known_position: np.ndarray,
    passed: float,
    all_gate: np.ndarray,
    all_gate_axis: np.ndarray,
    laps: int,
    out: np.ndarray,
) -> None:
    """Offset to a point on the axis of the next gate, in world axes: beyond it for a drone there.

    For a drone beside the axis the point is farther back, so that flying towards it leads to the
    axis before the gate. Zeros after the last gate.
    """
    count = len(all_gate)
    if passed >= laps * count:
        return
    middle, ahead = all_gate[int(passed) % count], all_gate_axis[int(passed) % count, 0]
    along, square = 0.0, 0.0
    for axis in range(3):
        offset = middle[axis] - known_position[axis]
        along += ahead[axis] * offset
        square += offset * offset
    aside = math.sqrt(max(square - along * along, 0.0))
    for axis in range(3):
        offset = middle[axis] - known_position[axis]
        out[axis] = offset + ahead[axis] * (AIM_BEYOND - AIM_RETREAT * aside)


def rank_labels(task: Any) -> tuple[Label, ...]:
    """Return the label of the rank."""
    require_task_memory(task, "rank", ("rank",))
    return (Label("rank", "1", 1.0, float(max(task.context.num_drones, 2))),)


@register("observation")
@block(rank_labels)
def rank(rank: float) -> float:
    """Rank in the race by the remaining distance, from 1; equal drones are ranked by index."""
    return rank
