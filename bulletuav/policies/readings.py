"""Observation blocks by name and in physical units, for policies that use observations only."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.observations.observer import Observation

CEILING_MARGIN = 2.5
"""Margin below the ceiling, m: for wind, and for the overshoot of braking"""
MAX_HEIGHT_ABOVE_GOAL = 50.0
"""Maximum cruise height above the goal, m"""
BLOCK_CONTENTS: Mapping[str, str] = MappingProxyType(
    {
        "goal": "direction and distance of the goal",
        "velocity": "its velocity",
        "room": "the ceiling",
        "lidar": "the range finder",
        "position": "its position",
        "all_neighbours": "the other drones",
        "clue_offset": "the offset to the clue",
        "sighting": "the victim in sight",
        "victims_found": "the fraction of victims found",
        "searched_cells": "the ground that is searched",
    }
)
"""Contents of each block, for messages"""


class Readings:
    """Observation blocks of an aviary, by name and in physical units.

    Attributes:
        aviary: The observed worlds.
    """

    def __init__(self, policy: str, aviary: Aviary, needed: tuple[str, ...]) -> None:
        """Check that the required blocks are observed.

        Args:
            policy: Name of the policy that reads the blocks, for the message.
            aviary: The observed worlds.
            needed: Names of the blocks.

        Raises:
            ValueError: If a block is not observed.
        """
        self.aviary = aviary
        self._needed = needed
        shown = aviary.observer.slices
        for name in needed:
            if name not in shown:
                known = ",".join([*shown, name])
                raise ValueError(
                    f"policy {policy!r} reads block {name!r}, {BLOCK_CONTENTS[name]}, which is not "
                    f"observed: set observation={known!r}"
                )

    def __call__(self, observations: Observation) -> dict[str, np.ndarray]:
        """Return the blocks of observations, in physical units.

        Args:
            observations: (W, N, D) observations of the drones, or a dict of such arrays.

        Returns:
            Arrays (W, N, width of the block) by name, m and m/s.
        """
        observer = self.aviary.observer
        blocks = observer.split(observations)
        readings: dict[str, np.ndarray] = {}
        for name in self._needed:
            numbers = np.asarray(blocks[name], dtype=float)
            if self.aviary.options.normalise:
                labels = observer.labels[observer.slices[name]]
                low = np.array([label.low for label in labels])
                high = np.array([label.high for label in labels])
                numbers = (low + high) / 2 + numbers * (high - low) / 2
            readings[name] = numbers
        return readings


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
