"""Observation blocks by name and in physical units, for policies that use observations only."""

from collections.abc import Iterable

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.observations.observer import Observation

CEILING_MARGIN = 2.5
"""Margin below the ceiling, m: for wind, and for the overshoot of braking"""
MAX_HEIGHT_ABOVE_GOAL = 50.0
"""Maximum cruise height above the goal, m"""


def require_blocks(policy: str, aviary: Aviary, needed: Iterable[str | tuple[str, ...]]) -> None:
    """Check that the blocks that a policy reads are observed.

    Args:
        policy: Name of the policy, for the message.
        aviary: The observed worlds.
        needed: Names of blocks; a tuple of names for a block that others can replace.

    Raises:
        ValueError: If one is not.
    """
    observed = aviary.observer.slices
    for group in needed:
        choices = (group,) if isinstance(group, str) else group
        if not observed.keys() & set(choices):
            raise ValueError(
                f"policy {policy!r} needs the observation block "
                f"{' or '.join(map(repr, choices))}, and the observation has "
                f"{', '.join(observed)}: add it with option observation"
            )


def unpack_blocks(aviary: Aviary, observations: Observation) -> dict[str, np.ndarray]:
    """Split the observations of an aviary into blocks, and undo their normalisation.

    Args:
        aviary: The observed worlds.
        observations: (W, N, D) observations of the drones, or a dict of such arrays.

    Returns:
        (W, N, width of the block) arrays by name, in physical units.
    """
    observer = aviary.observer
    seen: dict[str, np.ndarray] = {}
    parts = observer.split(observations)
    for name, part in observer.slices.items():
        seen[name] = np.array(parts[name], dtype=float)
        if aviary.options.normalise:
            low, high = np.array([(one.low, one.high) for one in observer.labels[part]]).T
            seen[name] = (low + high) / 2 + (high - low) / 2 * seen[name]
    return seen


def decode_goal_offset(goal: np.ndarray) -> np.ndarray:
    """Compute offsets to the goal (W, N, 3), m, from directions and distances (W, N, 4)."""
    offset: np.ndarray = goal[..., :3] * goal[..., 3:]
    return offset


def cruise_height_difference(offset: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Compute the height difference to the cruise height.

    The cruise height is CEILING_MARGIN below the ceiling, at most MAX_HEIGHT_ABOVE_GOAL above the
    goal: fewer buildings reach greater heights.

    Args:
        offset: (W, N, 3) offset to the goal, m.
        room: (W, N, 6) distances to the sides of the airspace, m.

    Returns:
        (W, N) height difference, m; negative if the drone is too high.
    """
    return np.minimum(room[..., 2] - CEILING_MARGIN, offset[..., 2] + MAX_HEIGHT_ABOVE_GOAL)
