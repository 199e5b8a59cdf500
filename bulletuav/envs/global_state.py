"""The global state: what is true of all drones, then of the world that they fly in."""

import dataclasses
from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np

from bulletuav.envs.options import EnvOptions
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.observations.observer import ObservationBuilder

DRONES = "drones"
"""Part of the state in which the numbers of all drones are, one drone after the other"""


class GlobalState:
    """The numbers of a global state, and how they are computed.

    First come the blocks of every drone, then the charge of each, where batteries empty, then what
    the task reports of the world by `Task.world_state`.

    Attributes:
        drones: Makes the numbers of each drone.
        labels: Name, unit and bounds of each number, K.
        parts: Which numbers each part has, by name, in order.
        low: (K,) lower bounds.
        high: (K,) upper bounds.
    """

    def __init__(self, task: Task[Any], drones: ObservationBuilder, options: EnvOptions) -> None:
        """Collect the parts.

        Args:
            task: The task.
            drones: Makes the numbers of each drone.
            options: Common options, of which `num_drones` and `battery_capacity` count.
        """
        self.drones, self._count = drones, options.num_drones
        # Of the world: charges, and what the task reports
        self._world: dict[str, Block] = {}
        if options.battery_capacity is not None:
            self._world["charge"] = _charges(self._count)
        self._world |= task.world_state()
        # Of each drone, with its name
        of_drones = [
            label._replace(name=f"{label.name} of drone_{i}")
            for i in range(self._count)
            for label in drones.labels
        ]
        # Where each part begins in the vector
        sizes = {DRONES: len(of_drones)}
        sizes |= {name: len(block.labels) for name, block in self._world.items()}
        self.parts = slices(sizes)
        self.labels = (*of_drones, *chain(*(block.labels for block in self._world.values())))
        self.low = np.array([label.low for label in self.labels], dtype=np.float32)
        self.high = np.array([label.high for label in self.labels], dtype=np.float32)

    def tell(self, frame: Frame, alive: np.ndarray) -> np.ndarray:
        """Compute the state.

        Args:
            frame: The decision, or the first frame after a reset.
            alive: (W, N) bool, drones whose episode goes on.

        Returns:
            (W, K) float32, clipped to the bounds.
        """
        # Without readings drones know where they are
        rows = self.drones.observe(dataclasses.replace(frame, readings={}), alive)
        assert isinstance(rows, np.ndarray)  # no pictures among its blocks
        state = np.zeros((len(alive), len(self.labels)), dtype=np.float32)
        state[:, self.parts[DRONES]] = rows.reshape(len(alive), -1)
        for name, block in self._world.items():
            state[:, self.parts[name]] = block.compute(frame, alive)
        return np.clip(state, self.low, self.high)

    def split(self, state: Any) -> dict[str, np.ndarray]:
        """Split states by name.

        Args:
            state: (..., K) numbers.

        Returns:
            Arrays (..., N, numbers of the block) of the drones' blocks, and (..., numbers of the
            part) of all other parts, views of the given one.

        Raises:
            ValueError: The state has another number of numbers.
        """
        vector = np.asarray(state)
        if vector.ndim == 0 or vector.shape[-1] != len(self.labels):
            raise ValueError(
                f"state is an array {vector.shape}: {len(self.labels)} numbers are needed, one for "
                f"each label"
            )
        rows = vector[..., self.parts[DRONES]].reshape(*vector.shape[:-1], self._count, -1)
        world = {name: vector[..., self.parts[name]] for name in self._world}
        return self.drones.split(rows) | world


def _charges(drones: int) -> Block:
    """Make the part with the charge of batteries."""
    labels = tuple(Label(f"charge of drone_{i}", "1", 0.0, 1.0) for i in range(drones))
    return Block(labels, lambda frame, present: frame.readings["charge"])


def slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Lay parts of these sizes side by side, in order."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {
        name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)
    }
