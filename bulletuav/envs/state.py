"""State of a simulation: its arrays by name, with their shapes, types and meanings.

This is the only declaration. Allocation, contents of snapshots and hashes, bounds, memory
estimates, and the tables in the documentation follow from it.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from bulletuav.tasks.frame import Scene
from bulletuav.vehicle.swarm import Swarm

STATE, LAST, DERIVED = "state", "last decision", "derived"
"""Kinds of arrays.

The state and its hash; results of the last decision, which are also in snapshots; and arrays that
each decision computes again.
"""
MAX_STEPS = 2**53
"""Maximum number of decisions of a world; float64 is exact up to here"""


class Array(NamedTuple):
    """Declaration of an array.

    Attributes:
        axes: Names of its axes, see `Sizes`; a number is a length.
        dtype: Type of its numbers.
        meaning: One line with the unit.
        kept: `STATE`, `LAST` or `DERIVED`.
        saved_as: Name in snapshots, if different.
        max: Highest value in a snapshot, for an array without negative numbers.
    """

    axes: str
    dtype: type
    meaning: str
    kept: str = DERIVED
    saved_as: str = ""
    max: int | None = None

    def shape(self, sizes: "Sizes") -> tuple[int, ...]:
        """Return the shape of the array in a simulation of these sizes."""
        return tuple(
            int(axis) if axis.isdigit() else getattr(sizes, axis) for axis in self.axes.split()
        )


class Sizes(NamedTuple):
    """Lengths of axes.

    Attributes:
        W: Number of worlds.
        N: Number of drones in a world.
        A: Size of an action.
        S: Size of a setpoint.
        K: Number of obstacles in a world.
        R: Maximum number of rotors of a drone.
        F: Maximum number of control surfaces of a drone.
    """

    W: int
    N: int
    A: int = 0
    S: int = 0
    K: int = 0
    R: int = 0
    F: int = 0


class Arrays:
    """Arrays that a derived dataclass declares as its annotated fields.

    The arrays are written in place and never replaced.

    Attributes:
        swarm: State of the drones.
        before: State of the drones before the decision.
    """

    swarm: Swarm
    before: Swarm

    @classmethod
    @functools.cache
    def declared(cls) -> Mapping[str, Array]:
        """Return the declared arrays by name."""
        return {
            name: hint.__metadata__[0]
            for name, hint in get_type_hints(cls, include_extras=True).items()
            if hasattr(hint, "__metadata__")
        }

    @classmethod
    def zeros(cls, sizes: Sizes) -> dict[str, Any]:
        """Allocate the declared arrays."""
        return {name: np.zeros(one.shape(sizes), one.dtype) for name, one in cls.declared().items()}

    def kept(self, kind: str) -> dict[str, np.ndarray]:
        """Return the declared arrays of `STATE` or `LAST` by their names in snapshots."""
        return {
            one.saved_as or name: getattr(self, name)
            for name, one in self.declared().items()
            if one.kept == kind
        }

    def bounds(self) -> dict[str, tuple[int, int]]:
        """Return the declared bounds of arrays by their names in snapshots."""
        return {
            one.saved_as or name: (0, one.max)
            for name, one in self.declared().items()
            if one.max is not None
        }

    def world_bytes(self) -> int:
        """Return the bytes of all arrays per world; the number of worlds may be zero."""
        return sum(math.prod(array.shape[1:]) * array.itemsize for array in self.named().values())

    def named(self) -> dict[str, np.ndarray]:
        """Return all arrays by the names that stages declare, such as "swarm.position"."""
        named = {name: getattr(self, name) for name in self.declared()}
        for group in [name for name in vars(self) if name not in named]:
            parts = getattr(self, group)._asdict()
            memory = parts.pop("memory", {})
            named |= {f"{group}.{name}": array for name, array in parts.items()}
            named |= {f"{group}.memory.{name}": array for name, array in memory.items()}
        return named


@dataclass(frozen=True)
class State(Arrays):
    """All arrays of W worlds of N drones that fly a task.

    Attributes:
        scene: Goals, obstacles, cities, and the task's memory.
    """

    swarm: Swarm
    before: Swarm
    scene: Scene
    given: Annotated[np.ndarray, Array("W N A", float, "actions of the caller")]
    setpoint: Annotated[np.ndarray, Array("W N S", float, "setpoints of the actions")]
    levels: Annotated[np.ndarray, Array("W N", int, "`SetpointLevel` of each setpoint")]
    commanded: Annotated[np.ndarray, Array("W N 3", float, "last commanded velocities, m/s", STATE)]
    alive: Annotated[np.ndarray, Array("W N", bool, "drones whose episode is running", STATE)]
    steps: Annotated[
        np.ndarray, Array("W", np.int64, "decisions since the reset", STATE, max=MAX_STEPS)
    ]
    action: Annotated[
        np.ndarray, Array("W N A", float, "actions within bounds", LAST, "frame action")
    ]
    flown: Annotated[
        np.ndarray, Array("W N", bool, "drones that fly the decision", LAST, "frame alive")
    ]
    time: Annotated[np.ndarray, Array("W", float, "time since the reset, s", LAST, "frame time")]
    last: Annotated[
        np.ndarray, Array("W", bool, "worlds that reached the horizon", LAST, "frame last")
    ]
    goal_before: Annotated[
        np.ndarray, Array("W N 3", float, "goals before the decision, m", LAST, "frame goal_before")
    ]
    terminated: Annotated[
        np.ndarray, Array("W N", bool, "drones whose episode the task ended", LAST)
    ]
    truncated: Annotated[
        np.ndarray, Array("W N", bool, "drones whose episode the horizon ended", LAST)
    ]
    present: Annotated[np.ndarray, Array("W N", bool, "drones that others observe", LAST)]
    rewards: Annotated[np.ndarray, Array("W N", float, "rewards", LAST)]
    flying: Annotated[np.ndarray, Array("W", bool, "worlds in which any drone flies")]
    wind: Annotated[np.ndarray, Array("W N 3", float, "velocity of the air at each drone, m/s")]
    payload: Annotated[np.ndarray, Array("W N", float, "power of equipment, W")]
    moved: Annotated[np.ndarray, Array("W N", bool, "drones that rebound at the arena's bounds")]
    ended: Annotated[np.ndarray, Array("W N", bool, "drones for which an end of the task is true")]
    success: Annotated[np.ndarray, Array("W N", bool, "drones that fulfil the task")]
    left: Annotated[np.ndarray, Array("W N", bool, "drones that leave with the decision")]

    @classmethod
    def make(cls, sizes: Sizes, memory: Mapping[str, tuple[int, ...]]) -> "State":
        """Allocate all arrays.

        Args:
            sizes: Lengths of their axes.
            memory: Shape of each array of the task's memory in one world, by name.
        """
        swarm = Swarm.zeros(sizes.W, sizes.N, sizes.R, sizes.F)
        scene = Scene.empty(sizes.W, sizes.N, sizes.K, memory)
        return cls(swarm, swarm.copy(), scene, **cls.zeros(sizes))


@dataclass(frozen=True)
class AirspaceState(Arrays):
    """All arrays of an airspace: one world, W = 1, of N drones without a task."""

    swarm: Swarm
    before: Swarm
    levels: Annotated[np.ndarray, Array("W N", int, "`SetpointLevel` of each setpoint", STATE)]
    setpoint: Annotated[np.ndarray, Array("W N S", float, "commanded setpoints", STATE)]
    commanded: Annotated[
        np.ndarray, Array("W N", bool, "drones with a commanded setpoint", STATE, "told")
    ]
    yaw_rate: Annotated[np.ndarray, Array("W N", float, "rates of yaw setpoints, rad/s", STATE)]
    steps: Annotated[np.ndarray, Array("W", np.int64, "simulated steps", STATE, max=MAX_STEPS)]
    time: Annotated[np.ndarray, Array("W", float, "time since the first step, s", STATE)]
    obstacle: Annotated[np.ndarray, Array("W K 3", float, "positions of obstacles, m", STATE)]
    obstacle_velocity: Annotated[
        np.ndarray, Array("W K 3", float, "velocities of obstacles, m/s", STATE)
    ]
    obstacle_turn: Annotated[
        np.ndarray, Array("W K 4", float, "attitudes of obstacles, (x, y, z, w)", STATE)
    ]
    alive: Annotated[np.ndarray, Array("W N", bool, "drones that fly: all")]
    wind: Annotated[np.ndarray, Array("W N 3", float, "velocity of the air at each drone, m/s")]

    @classmethod
    def make(cls, sizes: Sizes) -> "AirspaceState":
        """Allocate all arrays, of sizes with W = 1."""
        swarm = Swarm.zeros(sizes.W, sizes.N, sizes.R, sizes.F)
        return cls(swarm, swarm.copy(), **cls.zeros(sizes))


def with_prefix(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return arrays with a prefix to their names, as in snapshots."""
    return {f"{prefix} {name}": array for name, array in arrays.items()}
