"""Action spaces of one drone and of all drones, and conversions of actions to arrays."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space

from bulletuav.control.actions import Action
from bulletuav.errors import numbers_of


def drone_action_space(action: Action, drone: int) -> Space[Any]:
    """Return the action space of one drone.

    Args:
        action: Definition of actions.
        drone: Index of the drone.

    Returns:
        A Box of the drone's own numbers, or Discrete choices.
    """
    if action.choices is not None:
        return Discrete(action.choices)
    return _drone_box(action, drone)


def _drone_box(action: Action, drone: int) -> Box:
    """Return the Box of one drone's own numbers."""
    size = action.size(drone)
    low = action.low[drone, :size].astype(np.float32)
    high = action.high[drone, :size].astype(np.float32)
    return Box(low, high, dtype=np.float32)


def widest_action_space(action: Action) -> Space[Any]:
    """Return the action space of the drone with the most numbers.

    If drones differ in the kind of action, its bounds include those of all drones.
    """
    if action.parts:
        low, high = action.low.min(axis=0), action.high.max(axis=0)
        return Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
    drones = range(len(action.labels))
    widest = max(drones, key=action.size)
    return drone_action_space(action, widest)


def joint_action_space(action: Action) -> Space[Any]:
    """Return the action space of all drones together.

    Args:
        action: Definition of actions.

    Returns:
        Concatenated numbers of all drones, or one choice of each; for one drone its own space.
    """
    drones = len(action.labels)
    if drones == 1:
        return drone_action_space(action, 0)
    if action.choices is not None:
        return MultiDiscrete([action.choices] * drones)
    boxes = [_drone_box(action, drone) for drone in range(drones)]
    low = np.concatenate([box.low for box in boxes])
    high = np.concatenate([box.high for box in boxes])
    return Box(low, high, dtype=np.float32)


def drone_numbers(action: Action, drone: int, given: object) -> np.ndarray:
    """Convert one drone's action to a row of a batch.

    Args:
        action: Definition of actions.
        drone: Index of the drone.
        given: Action of the drone, of the shape of its space.

    Returns:
        (A,) numbers, padded with zeros if other drones have more.

    Raises:
        ValueError: If the action has another shape, or is not numeric.
    """
    numbers = numbers_of(f"parts of the action of drone_{drone} are", given)
    expected = (action.size(drone),) if action.choices is None else ()
    if numbers.shape != expected:
        raise ValueError(f"action of drone_{drone} has shape {numbers.shape}: {expected} is needed")
    padded = np.zeros(action.low.shape[-1])
    padded[: numbers.size] = numbers
    return padded


def joint_numbers(action: Action, given: object, num_worlds: int) -> np.ndarray:
    """Convert joint actions to a batch.

    Args:
        action: Definition of actions.
        given: (W, ...) a joint action of all drones for each world, of the shape of its space.
        num_worlds: Number of worlds W.

    Returns:
        (W, N, A) numbers of each drone, padded with zeros if others have more.

    Raises:
        ValueError: If the actions have another shape, or are not numeric.
    """
    drones, width = action.low.shape
    sizes = [action.size(drone) for drone in range(drones)]
    numbers = numbers_of("actions are", given)
    is_one_choice = action.choices is not None and drones == 1
    expected = (num_worlds,) if is_one_choice else (num_worlds, sum(sizes))
    if numbers.shape != expected:
        raise ValueError(f"actions have shape {numbers.shape}: {expected} is needed")
    if sum(sizes) == drones * width:
        return numbers.reshape(num_worlds, drones, width)
    # The numbers fill the used columns of each drone, in order
    batch = np.zeros((num_worlds, drones, width))
    size_of_drone = np.array(sizes)[:, None]
    used = np.arange(width) < size_of_drone
    batch[:, used] = numbers.reshape(num_worlds, -1)
    return batch
