"""The state of a simulation: its arrays by name, with their shapes, types and meanings.

This is the only declaration. What snapshots and hashes hold of them, and the table of the
documentation, follow from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from bulletuav.tasks.frame import Scene
from bulletuav.vehicle.swarm import Swarm

STATE, LAST, DERIVED = "state", "last decision", "derived"
"""What an array belongs to: the state and its hash; what the last decision gave, which snapshots
hold, too; and what each decision makes again"""


class Array(NamedTuple):
    """Declaration of an array.

    Attributes:
        axes: Its axes, see `Sizes`; a number is a length.
        dtype: Its type.
        meaning: One line with the unit.
        kept: `STATE`, `LAST` or `DERIVED`.
        saved_as: Its name in snapshots, where that is another.
    """

    axes: str
    dtype: type
    meaning: str
    kept: str = DERIVED
    saved_as: str = ""

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
    """

    W: int
    N: int
    A: int
    S: int


@dataclass(frozen=True)
class State:
    """All arrays of W worlds of N drones; they are written in place and never replaced.

    Attributes:
        swarm: State of the drones.
        before: State of the drones before the decision.
        scene: Goals, obstacles, cities, and the task's memory.
    """

    swarm: Swarm
    before: Swarm
    scene: Scene
    given: Annotated[np.ndarray, Array("W N A", float, "actions, as they were given")]
    setpoint: Annotated[np.ndarray, Array("W N S", float, "setpoints that the actions make")]
    levels: Annotated[np.ndarray, Array("W N", int, "`SetpointLevel` of each setpoint")]
    commanded: Annotated[np.ndarray, Array("W N 3", float, "velocities commanded last, m/s", STATE)]
    alive: Annotated[np.ndarray, Array("W N", bool, "drones whose episode goes on", STATE)]
    steps: Annotated[np.ndarray, Array("W", np.int64, "decisions since the reset", STATE)]
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
    def zeros(cls, sizes: Sizes, swarm: Swarm, scene: Scene) -> "State":
        """Make all arrays, zero but for the swarm and the scene."""
        arrays: dict[str, Any] = {
            name: np.zeros(one.shape(sizes), one.dtype) for name, one in ARRAYS.items()
        }
        return cls(swarm, swarm.copy(), scene, **arrays)

    def kept(self, kind: str) -> dict[str, np.ndarray]:
        """Return the arrays of `STATE` or `LAST` by the names that snapshots give them.

        The swarms and the scene are not among them.
        """
        chosen = {name: one.saved_as for name, one in ARRAYS.items() if one.kept == kind}
        return {saved_as or name: getattr(self, name) for name, saved_as in chosen.items()}

    def named(self) -> dict[str, np.ndarray]:
        """Return all arrays by the names that stages declare, such as "swarm.position"."""
        named = {name: getattr(self, name) for name in ARRAYS}
        for group in ("swarm", "before", "scene"):
            parts = getattr(self, group)._asdict()
            memory = parts.pop("memory", {})
            named |= {f"{group}.{name}": array for name, array in parts.items()}
            named |= {f"{group}.memory.{name}": array for name, array in memory.items()}
        return named


ARRAYS: Mapping[str, Array] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(State, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}
"""The declared arrays by name"""


def with_prefix(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return arrays with a prefix before their names, as snapshots name them."""
    return {f"{prefix} {name}": array for name, array in arrays.items()}
