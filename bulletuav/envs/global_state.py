"""Global state: the true state of all drones, then of the world."""

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
"""Part of the state with the numbers of all drones, one drone after the other"""


class GlobalState:
    """Computes the global state.

    The blocks of every drone come first, then the charge of each drone if batteries are limited,
    then the parts that the task adds by `Task.world_state`.

    Attributes:
        drones: Computes the numbers of each drone.
        labels: Name, unit and bounds of each of the K numbers.
        parts: Slice of each part, by name, in order.
        low: (K,) lower bounds.
        high: (K,) upper bounds.
    """

    def __init__(self, task: Task[Any], drones: ObservationBuilder, options: EnvOptions) -> None:
        """Collect the parts.

        Args:
            task: The task.
            drones: Computes the numbers of each drone.
            options: Common options, of which `num_drones` and `battery_capacity` are used.
        """
        self.drones, self._count = drones, options.num_drones
        self._world: dict[str, Block] = {}
        if options.battery_capacity is not None:
            self._world["charge"] = _charges(self._count)
        self._world |= task.world_state()
        of_drones = [
            label._replace(name=f"{label.name} of drone_{i}")
            for i in range(self._count)
            for label in drones.labels
        ]
        sizes = {DRONES: len(of_drones)}
        sizes |= {name: len(block.labels) for name, block in self._world.items()}
        self.parts = slices(sizes)
        self.labels = (*of_drones, *chain(*(block.labels for block in self._world.values())))
        self.low = np.array([label.low for label in self.labels], dtype=np.float32)
        self.high = np.array([label.high for label in self.labels], dtype=np.float32)

    def compute(self, frame: Frame, alive: np.ndarray) -> np.ndarray:
        """Compute the global state.

        Args:
            frame: Frame of the decision, or the first frame after a reset.
            alive: (W, N) bool, drones whose episode is running.

        Returns:
            (W, K) float32, clipped to the bounds.
        """
        # Without readings, observations have the true state
        rows = self.drones.observe(frame.without_readings(), alive)
        assert isinstance(rows, np.ndarray)  # no pictures among its blocks
        state = np.zeros((len(alive), len(self.labels)), dtype=np.float32)
        state[:, self.parts[DRONES]] = rows.reshape(len(alive), -1)
        for name, block in self._world.items():
            state[:, self.parts[name]] = block.compute(frame, alive)
        np.maximum(state, self.low, out=state)
        return np.minimum(state, self.high, out=state)

    def split(self, state: Any) -> dict[str, np.ndarray]:
        """Split states by name.

        Args:
            state: (..., K) numbers.

        Returns:
            Arrays (..., N, numbers of the block) of the drones' blocks, and (..., numbers of the
            part) of all other parts, views of the argument.

        Raises:
            ValueError: If the state has another size.
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
    labels = tuple(Label(f"charge of drone_{i}", "1", 0.0, 1.0) for i in range(drones))
    return Block(labels, lambda frame, present: frame.readings["charge"])


def slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return consecutive slices of these sizes."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {
        name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)
    }
