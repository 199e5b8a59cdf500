"""Spaces of one drone and of all drones together."""

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space

from bulletuav.control.actions import Action
from bulletuav.errors import numbers_of


def drone_action_space(action: Action, drone: int) -> Space:
    """What one drone is given: a Box of its own numbers, or Discrete choices."""
    if action.choices is not None:
        return Discrete(action.choices)
    size = action.size(drone)
    return Box(
        action.low[drone, :size].astype(np.float32),
        action.high[drone, :size].astype(np.float32),
        dtype=np.float32,
    )


def widest_action_space(action: Action) -> Space:
    """That of the drone with the most numbers: what one row of a batch holds."""
    return drone_action_space(action, max(range(len(action.labels)), key=action.size))


def joint_action_space(action: Action) -> Space:
    """What all drones together are given: their numbers one after the other, or one choice each."""
    drones = len(action.labels)
    if drones == 1:
        return drone_action_space(action, 0)
    if action.choices is not None:
        return MultiDiscrete([action.choices] * drones)
    parts = [drone_action_space(action, drone) for drone in range(drones)]
    low, high = (
        np.concatenate([getattr(part, side) for part in parts]) for side in ("low", "high")
    )
    return Box(low, high, dtype=np.float32)


def drone_numbers(action: Action, drone: int, given: object) -> np.ndarray:
    """(A,) one drone's numbers, padded; raises ValueError for another shape than its space has."""
    numbers = numbers_of(f"parts of the action of drone_{drone} are", given)
    expected = () if action.choices is not None else (action.size(drone),)
    if numbers.shape != expected:
        raise ValueError(f"action of drone_{drone} has shape {numbers.shape}: {expected} is needed")
    padded = np.zeros(action.low.shape[-1])
    padded[: numbers.size] = numbers
    return padded


def joint_numbers(action: Action, given: object, num_worlds: int) -> np.ndarray:
    """(W, N, A) from joint actions (W, ...) of all drones; raises ValueError for another shape than their space has."""
    drones, width = action.low.shape
    sizes = [action.size(drone) for drone in range(drones)]
    numbers = numbers_of("actions are", given)
    expected = (num_worlds, *(() if action.choices is not None and drones == 1 else (sum(sizes),)))
    if numbers.shape != expected:
        raise ValueError(f"actions have shape {numbers.shape}: {expected} is needed")
    batch = np.zeros((num_worlds, drones, width))
    batch[:, np.arange(width) < np.array(sizes)[:, None]] = numbers.reshape(num_worlds, -1)
    return batch
