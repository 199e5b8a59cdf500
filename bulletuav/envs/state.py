"""The state of a simulation: its arrays by name, with their shapes, types and meanings.

This is the only declaration. Their allocation, what snapshots and hashes hold of them, their
bounds there, the memory that they take, and the tables of the documentation follow from it.
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
"""What an array belongs to: the state and its hash; what the last decision gave, which snapshots
hold, too; and what each decision makes again"""
MAX_STEPS = 2**53
"""Decisions of a world: as many as a float64 counts"""


class Array(NamedTuple):
    """Declaration of an array.

    Attributes:
        axes: Its axes, see `Sizes`; a number is a length.
        dtype: Its type.
        meaning: One line with the unit.
        kept: `STATE`, `LAST` or `DERIVED`.
        saved_as: Its name in snapshots, where that is another.
        max: Highest value in a snapshot, of an array that has no negative ones.
    """

    axes: str
    dtype: type
    meaning: str
    kept: str = DERIVED
    saved_as: str = ""
    max: int | None = None

    def shape(self, sizes: "Sizes") -> tuple[int, ...]:
        """Return its shape in a simulation of these sizes."""
        return tuple(
            int(axis) if axis.isdigit() else getattr(sizes, axis) for axis in self.axes.split()
        )


class Sizes(NamedTuple):
    """Lengths of axes.

    Attributes:
        W: Worlds.
        N: Drones in a world.
        A: Numbers of an action.
        S: Numbers of a setpoint.
        K: Obstacles in a world.
        R: Rotors of the drone with the most.
    """

    W: int
    N: int
    A: int = 0
    S: int = 0
    K: int = 0
    R: int = 0


class Arrays:
    """Arrays that a derived dataclass declares as its annotated fields.

    They are written in place and never replaced.

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
        """Make the declared arrays."""
        return {name: np.zeros(one.shape(sizes), one.dtype) for name, one in cls.declared().items()}

    def kept(self, kind: str) -> dict[str, np.ndarray]:
        """Return the declared arrays of `STATE` or `LAST` by the names that snapshots give them."""
        return {
            one.saved_as or name: getattr(self, name)
            for name, one in self.declared().items()
            if one.kept == kind
        }

    def bounds(self) -> dict[str, tuple[int, int]]:
        """Return the declared bounds of arrays in snapshots, by the names that they have there."""
        return {
            one.saved_as or name: (0, one.max)
            for name, one in self.declared().items()
            if one.max is not None
        }

    def world_bytes(self) -> int:
        """Return the bytes that all arrays have for a world; there need not be any worlds."""
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
    given: Annotated[np.ndarray, Array("W N A", float, "actions, as they were given")]
    setpoint: Annotated[np.ndarray, Array("W N S", float, "setpoints that the actions make")]
    levels: Annotated[np.ndarray, Array("W N", int, "`SetpointLevel` of each setpoint")]
    commanded: Annotated[np.ndarray, Array("W N 3", float, "velocities commanded last, m/s", STATE)]
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
        np.ndarray, Array("W", bool, "where the horizon is reached", LAST, "frame last")
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
    present: Annotated[np.ndarray, Array("W N", bool, "drones that others still meet", LAST)]
    rewards: Annotated[np.ndarray, Array("W N", float, "rewards", LAST)]
    flying: Annotated[np.ndarray, Array("W", bool, "worlds in which any drone flies")]
    wind: Annotated[np.ndarray, Array("W N 3", float, "velocity of the air at each drone, m/s")]
    payload: Annotated[np.ndarray, Array("W N", float, "power that equipment takes, W")]
    moved: Annotated[np.ndarray, Array("W N", bool, "drones that rebound at the arena's bounds")]
    ended: Annotated[np.ndarray, Array("W N", bool, "drones that the task's ends are true of")]
    success: Annotated[np.ndarray, Array("W N", bool, "drones that are where the task wants them")]
    left: Annotated[np.ndarray, Array("W N", bool, "drones that leave with the decision")]

    @classmethod
    def make(cls, sizes: Sizes, memory: Mapping[str, tuple[int, ...]]) -> "State":
        """Make all arrays.

        Args:
            sizes: Lengths of their axes.
            memory: Shape of each array of the task's memory in one world, by name.
        """
        swarm = Swarm.zeros(sizes.W, sizes.N, sizes.R)
        scene = Scene.empty(sizes.W, sizes.N, sizes.K, memory)
        return cls(swarm, swarm.copy(), scene, **cls.zeros(sizes))


@dataclass(frozen=True)
class AirspaceState(Arrays):
    """All arrays of an airspace: one world, W = 1, of N drones without a task."""

    swarm: Swarm
    before: Swarm
    levels: Annotated[np.ndarray, Array("W N", int, "`SetpointLevel` of each setpoint", STATE)]
    setpoint: Annotated[
        np.ndarray, Array("W N S", float, "setpoints that drones were commanded", STATE)
    ]
    commanded: Annotated[
        np.ndarray, Array("W N", bool, "drones that were commanded any", STATE, "told")
    ]
    yaw_rate: Annotated[
        np.ndarray, Array("W N", float, "rates at which yaws of setpoints turn, rad/s", STATE)
    ]
    steps: Annotated[
        np.ndarray, Array("W", np.int64, "steps that were flown", STATE, max=MAX_STEPS)
    ]
    time: Annotated[np.ndarray, Array("W", float, "time since the first step, s", STATE)]
    obstacle: Annotated[np.ndarray, Array("W K 3", float, "places of obstacles, m", STATE)]
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
        """Make all arrays, of sizes with W = 1."""
        swarm = Swarm.zeros(sizes.W, sizes.N, sizes.R)
        return cls(swarm, swarm.copy(), **cls.zeros(sizes))


def with_prefix(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return arrays with a prefix before their names, as snapshots name them."""
    return {f"{prefix} {name}": array for name, array in arrays.items()}
