"""What drones observe: blocks of numbers and pictures, chosen by name."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.control.actions import Action
from bulletuav.errors import choose
from bulletuav.tasks.observations import motion, sensors, users
from bulletuav.tasks.observations.motion import Block
from bulletuav.tasks.observations.sensors import IMAGES

if TYPE_CHECKING:
    from bulletuav.tasks.base import Frame, Task

BLOCKS: dict[str, Callable[["Task"], Block]] = {
    block.__name__: block
    for block in (
        motion.position,
        motion.attitude,
        motion.velocity,
        motion.rates,
        motion.goal_position,
        motion.goal_offset,
        motion.goal_velocity,
        motion.goal,
        motion.alive,
        motion.identity,
        motion.neighbours,
        motion.all_neighbours,
        motion.obstacles,
        sensors.lidar,
        sensors.imu,
        sensors.clearance,
        sensors.battery,
        sensors.targets,
        sensors.seen_share,
        sensors.sight_ahead,
        users.power,
        users.centroids,
        users.sight_matrix,
        users.dwell_time,
        users.server,
        users.link_rates,
    )
}
NAMES = (*BLOCKS, motion.last_action.__name__, *IMAGES)
STATE = ("position", "attitude", "velocity", "rates", "goal_position", "alive")

Observation = np.ndarray | dict[str, np.ndarray]


class ObservationBuilder:
    """The named blocks of a task side by side: one vector, or, with pictures among them, a dict.

    Vectors are float32, clipped to their bounds, and with `normalise` scaled from the bounds to [-1, 1]. The dict's keys are
    "vector" (where there is one) and the pictures' names.
    """

    def __init__(
        self,
        names: Sequence[str],
        task: "Task",
        action: Action,
        camera_size: tuple[int, int] = (64, 48),
        normalise: bool = False,
    ):
        """Raises ValueError for a block that does not exist."""
        makers: dict[str, Callable[[], Block]] = {
            name: partial(maker, task) for name, maker in BLOCKS.items()
        }
        makers[motion.last_action.__name__] = partial(motion.last_action, action)
        self.images = [name for name in names if name in IMAGES]
        vectors = [name for name in names if name not in IMAGES]
        self._blocks = [choose("observation block", name, makers)() for name in vectors]
        self.labels = [label for block in self._blocks for label in block.labels]
        self._low = np.array([label.low for label in self.labels], dtype=np.float32)
        self._high = np.array([label.high for label in self.labels], dtype=np.float32)
        self._middle, self._half = (self._low + self._high) / 2, (self._high - self._low) / 2
        self._normalise = normalise
        ones = np.ones_like(self._low)
        self.low, self.high = (-ones, ones) if normalise else (self._low, self._high)
        self._camera_shape = camera_size[::-1]

    def space(self) -> Box | Dict:
        """One drone's observation space, a new object each time."""
        vector = Box(self.low, self.high, dtype=np.float32)
        if not self.images:
            return vector
        spaces: dict[str, Space] = {"vector": vector} if self.labels else {}
        for name in self.images:
            low, high, kind, pixel = IMAGES[name]
            spaces[name] = Box(low, high, (*self._camera_shape, *pixel), kind)
        return Dict(spaces)

    def observe(self, frame: "Frame", present: np.ndarray) -> Observation:
        """(W, N, D) float32 after the frame, or the dict; `present` (W, N) are the drones that can still be met."""
        seen: dict[str, np.ndarray] = {}
        if self._blocks:
            parts = [block.compute(frame, present) for block in self._blocks]
            vector = np.concatenate(parts, axis=-1, dtype=np.float32)
            vector = np.minimum(
                np.maximum(vector, self._low), self._high
            )  # np.clip takes twice as long
            if self._normalise:
                vector = np.minimum(np.maximum((vector - self._middle) / self._half, -1.0), 1.0)
            seen["vector"] = vector
        if not self.images:
            return seen["vector"]
        return seen | {name: frame.readings[name].copy() for name in self.images}


def part(observations: Observation, index) -> Any:
    """`observations[index]`, of each entry where they are a dict."""
    if isinstance(observations, dict):
        return {name: array[index] for name, array in observations.items()}
    return observations[index]
