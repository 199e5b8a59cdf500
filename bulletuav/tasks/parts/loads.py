"""Loads of a task: bodies without rotors that hang on cables below drones."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.tasks.parts.base import Part
from bulletuav.vehicle.load import Load

POSITION, QUATERNION = "load_position", "load_quaternion"
VELOCITY, RATES = "load_velocity", "load_rates"
GRAVITY = "load_gravity"
ATTACHED, TAUT, TENSION = "cable_attached", "cable_taut", "cable_tension"
"""Names of arrays in the memory"""


class LoadCable(NamedTuple):
    """A cable from a drone to a load.

    Attributes:
        drone: Index of the drone, from its centre of mass.
        load: Index of the load.
        point: (3,) end at the load, in its axes, m.
        length: Length, m.
    """

    drone: int
    load: int
    point: tuple[float, float, float]
    length: float


class Loads(Part):
    """L loads and C cables of each world; a task sets them as `self.loads = self.add(Loads(...))`.

    The environment flies the loads as bodies of its dynamics, which must have cables, and writes
    their state to the memory after each flight. A start sets where loads are, by `start`. A task
    releases a load by setting entries of "cable_attached" to 0. Cables of drones whose episode
    ended do not pull. Sensors see loads, but no cables. Contacts of loads are only those of drones
    with them, whose `Contacts.other` is the number of drones plus the index of the load.

    Attributes:
        loads: The loads.
        cables: The cables.
    """

    def __init__(self, loads: Sequence[Load], cables: Sequence[LoadCable]) -> None:
        """Store loads and cables."""
        self.loads, self.cables = tuple(loads), tuple(cables)

    def find_ends(self, memory: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the positions of the ends of cables at loads, (W, C, 3) m."""
        load = np.array([cable.load for cable in self.cables], dtype=int)
        points = np.array([cable.point for cable in self.cables]).reshape(-1, 3)
        quaternion = memory[QUATERNION][:, load]
        turned = rotate_vectors(quaternion, np.broadcast_to(points, (*quaternion.shape[:2], 3)))
        ends: np.ndarray = memory[POSITION][:, load] + turned
        return ends

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the state of loads and cables.

        Returns:
            "load_position" (L, 3), m; "load_quaternion" (L, 4), body to world; "load_velocity" (L,
            3), m/s; "load_rates" (L, 3), body axes, rad/s; "load_gravity" (L,), gravitational
            acceleration in the last decision, m/s^2; "cable_attached" (C,), 1 for attached cables;
            "cable_taut" (C,), 1 for cables that pull; "cable_tension" (C,), mean tension in the
            last substep, N.
        """
        loads, cables = len(self.loads), len(self.cables)
        vectors = dict.fromkeys((POSITION, VELOCITY, RATES), (loads, 3))
        numbers = dict.fromkeys((ATTACHED, TAUT, TENSION), (cables,))
        return {**vectors, QUATERNION: (loads, 4), GRAVITY: (loads,), **numbers}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of flags and tensions."""
        flags = dict.fromkeys((ATTACHED, TAUT), (0.0, 1.0))
        return {**flags, TENSION: (0.0, np.inf), QUATERNION: (-1.0 - 1e-6, 1.0 + 1e-6)}

    def start(self, position: np.ndarray, quaternion: np.ndarray) -> dict[str, np.ndarray]:
        """Return the memory of loads at rest with all cables attached, for a `Spawn`.

        Args:
            position: (L, 3) m.
            quaternion: (L, 4) body to world.
        """
        attached = np.ones(len(self.cables))
        return {POSITION: position, QUATERNION: quaternion, ATTACHED: attached}
