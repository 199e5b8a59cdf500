"""Observation blocks of loads on cables: the load of a drone, its place, and the own cable."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.sensors.imu import MAX_BODY_RATE
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block, make_missing_error, require_task_memory
from bulletuav.tasks.parts.loads import POSITION, QUATERNION, RATES, TAUT, VELOCITY, Loads

PLACE = "place"
"""Name of the memory (3,) with the place of the first load, m"""


def _require_loads(task: Any, block: str) -> Loads:
    """Return the loads of a task, where every drone has a cable; raise ValueError otherwise."""
    loads: Loads | None = task.loads
    owners = set() if loads is None else {cable.drone for cable in loads.cables}
    if loads is None or owners != set(range(task.context.num_drones)):
        raise make_missing_error(task, block)
    return loads


def _cable_of(loads: Loads, num_drones: int) -> np.ndarray:
    """Return the index (N,) of the first cable of each drone."""
    owners = [cable.drone for cable in loads.cables]
    return np.array([owners.index(i) for i in range(num_drones)])


@register("observation")
def load(task: Any) -> Block:
    """Load on the own cable: position relative to the drone, velocity, attitude, body rates.

    Position and velocity are in world axes. The attitude is a quaternion, body to world, with the
    sign for which w >= 0.
    """
    loads = _require_loads(task, "load")
    cable = _cable_of(loads, task.context.num_drones)
    of_drone = np.array([loads.cables[c].load for c in cable])
    size, speed = task.arena_high - task.arena_low, np.full(3, 2 * task.context.max_speed)
    labels = (
        *vector_labels("load", "m", -size, size),
        *vector_labels("load velocity", "m/s", -speed, speed),
        *(Label(f"load quaternion {k}", "1", -1.0 if k != "w" else 0.0, 1.0) for k in "xyzw"),
        *vector_labels("load rates", "rad/s", [-MAX_BODY_RATE] * 3, [MAX_BODY_RATE] * 3),
    )

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        memory = frame.scene.memory
        quaternion = memory[QUATERNION][:, of_drone]
        parts = (
            memory[POSITION][:, of_drone] - frame.known_position,
            memory[VELOCITY][:, of_drone],
            np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion),
            memory[RATES][:, of_drone],
        )
        return np.concatenate(parts, axis=-1)

    return Block(labels, compute)


@register("observation")
def cable(task: Any) -> Block:
    """Own cable: vector from the drone to its end at the load, world axes, and 1 if it pulls."""
    loads = _require_loads(task, "cable")
    own = _cable_of(loads, task.context.num_drones)
    size = task.arena_high - task.arena_low
    labels = (*vector_labels("cable end", "m", -size, size), Label("cable is taut", "1", 0.0, 1.0))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        ends = loads.find_ends(frame.scene.memory)[:, own] - frame.known_position
        return np.concatenate([ends, frame.scene.memory[TAUT][:, own, None]], axis=-1)

    return Block(labels, compute)


@register("observation")
def load_goal_offset(task: Any) -> Block:
    """Vector from the first load to its place, world axes."""
    require_task_memory(task, "load_goal_offset", (PLACE, POSITION))
    size = task.arena_high - task.arena_low
    labels = vector_labels("load goal offset", "m", -size, size)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        memory = frame.scene.memory
        offset = memory[PLACE] - memory[POSITION][:, 0]
        return np.broadcast_to(offset[:, None], (*present.shape, 3))

    return Block(labels, compute)
