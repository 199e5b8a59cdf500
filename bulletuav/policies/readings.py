"""What policies that see observations only read: blocks by name, in their units."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.observations.observer import Observation

CEILING_ROOM = 2.5
"""Room that is left below the ceiling, m: for wind, and for what a drone rises as it brakes"""
OVER_GOAL = 50.0
"""Height above the goal beyond which no drone climbs, m"""
REMEDY: Mapping[str, str] = MappingProxyType(
    {
        "goal": "direction and distance of the goal",
        "velocity": "its velocity",
        "room": "the ceiling",
        "lidar": "what stands around",
    }
)
"""What each block tells a drone"""


class Readings:
    """Blocks of an aviary's observations, by name and in their units.

    Attributes:
        aviary: The worlds that are observed.
    """

    def __init__(self, policy: str, aviary: Aviary, needed: tuple[str, ...]) -> None:
        """Find the blocks.

        Args:
            policy: Name of the policy that reads them, for the message.
            aviary: The worlds that are observed.
            needed: Names of the blocks.

        Raises:
            ValueError: A block is not observed.
        """
        self.aviary = aviary
        self._needed = needed
        shown = aviary.observer.slices
        for name in needed:
            if name not in shown:
                known = ",".join([*shown, name])
                raise ValueError(
                    f"policy {policy!r} reads block {name!r}, {REMEDY[name]}, which is not "
                    f"observed: choose observation={known!r}"
                )

    def __call__(self, observations: Observation) -> dict[str, np.ndarray]:
        """Give the blocks of observations.

        Args:
            observations: (W, N, D) of each drone, or a dict of such arrays.

        Returns:
            Arrays (W, N, numbers of the block) by name, m and m/s.
        """
        observer = self.aviary.observer
        blocks = observer.split(observations)
        told: dict[str, np.ndarray] = {}
        for name in self._needed:
            numbers = np.asarray(blocks[name], dtype=float)
            if self.aviary.options.normalise:
                labels = observer.labels[observer.slices[name]]
                low = np.array([label.low for label in labels])
                high = np.array([label.high for label in labels])
                numbers = (low + high) / 2 + numbers * (high - low) / 2
            told[name] = numbers
        return told


def goal_offset(goal: np.ndarray) -> np.ndarray:
    """Compute the way to the goal (W, N, 3), m, from its direction and distance (W, N, 4)."""
    offset: np.ndarray = goal[..., :3] * goal[..., 3:]
    return offset


def climb(offset: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Compute how far it is up to the height at which drones cross a city.

    That is CEILING_ROOM below the ceiling, or OVER_GOAL above the goal where that is lower: the
    higher, the fewer houses stand in the way.

    Args:
        offset: (W, N, 3) the way to the goal, m.
        room: (W, N, 6) room to the sides of the airspace, m.

    Returns:
        (W, N) m, negative where the drone is too high.
    """
    return np.minimum(room[..., 2] - CEILING_ROOM, offset[..., 2] + OVER_GOAL)
