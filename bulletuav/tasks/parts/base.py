"""What parts of tasks are."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.frame import Frame, Scene, Spawn
from bulletuav.tasks.observations.base import Block

Rngs = Sequence[np.random.Generator]


class Part:
    """A part of a task, such as a city or its users, with its own options, state and infos.

    A task adds its parts by `Task.add`, and asks each of them, in that order, for everything that
    it does not do itself. The methods are those of `Task` of the same names, where arguments and
    results are explained; all do nothing by default.
    """

    def obstacles(self) -> Sequence[Obstacle]:
        """List the bodies that it puts into every world; those of all parts follow each other."""
        return ()

    def layouts(self) -> Sequence[Solids]:
        """List what can stand in a world, one at a time."""
        return ()

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return whether a ball touches nothing of it; it must be free of all parts."""
        return True

    def finish(self, spawn: Spawn, is_given: bool, rng: np.random.Generator) -> Spawn:
        """Complete the start of one world.

        Args:
            spawn: The start, with the places that users gave.
            is_given: Whether they gave any.
            rng: Generator of the world.
        """
        return spawn

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move what belongs to it through one decision, and return whether obstacles moved."""
        return False

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the arrays that it keeps in `scene.memory`, by name."""
        return {}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of these arrays, by name."""
        return {}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Bring these arrays up to date after a decision."""

    def payload_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power of the drones' equipment, (W, N) W; that of all parts adds up."""
        return 0.0

    def quantities(self) -> Mapping[str, Any]:
        """Return what it derives from a frame, by the names that ingredients use."""
        return {}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return its infos, (W, N) by name."""
        return {}

    def world_state(self) -> Mapping[str, Block]:
        """Return its blocks of the global state, by name."""
        return {}


class Starts(ABC):
    """Where drones start and go to; see `GoalFlight.starts`."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Spawn:
        """Draw starts and goals of one world, and what else lies there, of drones at rest."""

    def next_goal(self, place: np.ndarray, layout: int, rng: np.random.Generator) -> np.ndarray:
        """Draw the goal (3,), m, of a drone at `place` (3,), m, where goals respawn.

        Args:
            place: Where the drone reached its last goal.
            layout: Index of the city in its world.
            rng: Generator of the world.

        Raises:
            ValueError: Here goals do not respawn.
        """
        raise ValueError("at_goal is 'respawn': this task draws no further goals")
