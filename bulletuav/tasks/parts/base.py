"""Base classes of parts of tasks and of start distributions."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.frame import Frame, Scene, Spawn
from bulletuav.tasks.observations.base import Block

Rngs = Sequence[np.random.Generator]


class Part:
    """A part of a task, such as a city or its users, with its own options, state and infos.

    A task registers its parts by `Task.add`, and delegates to them in this order. The methods
    correspond to those of `Task` of the same names, where arguments and results are documented; by
    default all do nothing. Observation blocks, reward terms and ends stay with the task; they read
    the part's `memory` and `quantities` by name.

    Attributes:
        compiled_infos: Names of the infos that `info_calls` writes, in addition to those of `info`.
    """

    compiled_infos: ClassVar[tuple[str, ...]] = ()

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the part's obstacles in every world; those of all parts are concatenated."""
        return ()

    def layouts(self) -> Sequence[Solids]:
        """Return alternative sets of buildings, one of which is in each world."""
        return ()

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return True if a ball intersects nothing of the part; it must be free of all parts."""
        return True

    def finish(self, spawn: Spawn, is_given: bool, rng: np.random.Generator) -> Spawn:
        """Complete the start of one world.

        Args:
            spawn: The start, with positions set by the user.
            is_given: Whether the user set any.
            rng: Generator of the world.
        """
        return spawn

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the part's objects through one decision; return whether obstacles moved."""
        return False

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the part's arrays in `scene.memory`, by name."""
        return {}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of these arrays, by name."""
        return {}

    def memory_calls(self, frame: Frame) -> Sequence[tuple[Any, ...]]:
        """Return compiled calls that update these arrays after a decision.

        They run before the part's `update_memory`. In tasks without `update_memory` of their own
        they take less time, as Python does not call them.

        Args:
            frame: The frame of all decisions, whose arrays last, unlike those of `derived`.

        Returns:
            Kernels, see `bulletuav.compiled.kernel`, each with its arguments.
        """
        return ()

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update these arrays after a decision."""

    def payload_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power of the drones' equipment, (W, N) W, summed over parts."""
        return 0.0

    def charging_power(self, scene: Scene) -> np.ndarray | float:
        """Return the power that charges the drones' batteries, (W, N) W, summed over parts."""
        return 0.0

    def observation_blocks(self) -> tuple[Any, ...]:
        """Return the blocks that the part adds to the task's default observation."""
        return ()

    def quantities(self) -> Mapping[str, Any]:
        """Return the quantities that the part derives from a frame, by name, for ingredients."""
        return {}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the part's infos, (W, N) by name."""
        return {}

    def info_calls(
        self, frame: Frame, infos: Mapping[str, np.ndarray]
    ) -> Sequence[tuple[Any, ...]]:
        """Return compiled calls that write the infos `compiled_infos`, in less time than `info`.

        Args:
            frame: See `memory_calls`, like the result.
            infos: Arrays (W, N) to write, by name.
        """
        return ()

    def world_state(self) -> Mapping[str, Block]:
        """Return the part's blocks of the global state, by name."""
        return {}


class Starts(ABC):
    """Distribution of starts and goals; see `GoalFlight.starts`."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Spawn:
        """Draw starts and goals of one world, and its obstacles, with drones at rest."""

    def next_goal(
        self, place: np.ndarray, scene: Scene, world: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Draw the next goal (3,), m, of a drone, if goals respawn.

        Args:
            place: (3,) position at which the drone reached its last goal, m.
            scene: Goals, obstacles and city.
            world: Index of the drone's world.
            rng: Generator of the world.

        Raises:
            ValueError: If goals do not respawn.
        """
        raise ValueError("at_goal is 'respawn': this task draws no further goals")
