"""Observation blocks, chosen by name: each says what its numbers are, in which unit and within which bounds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.errors import pick
from bulletuav.kernel import kernel
from bulletuav.physics.view import FAR

if TYPE_CHECKING:
    from bulletuav.tasks.base import Frame, Task

NEIGHBOURS = 3
MAX_RATE = 50.0  # rad/s


class Label(NamedTuple):
    """One number of an observation; values beyond the bounds are clipped to them."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Block:
    """Some numbers of an observation: `compute(frame, present)` gives (W, N, len(labels)).

    `present` (W, N) are the drones that can still be met after the frame.
    """

    labels: tuple[Label, ...]
    compute: Callable[["Frame", np.ndarray], np.ndarray]


def _vector(name: str, unit: str, low: Iterable[float], high: Iterable[float]) -> tuple[Label, ...]:
    return tuple(Label(f"{name} {k}", unit, a, b) for k, a, b in zip("xyz", low, high, strict=True))


def position(task: "Task") -> Block:
    """Own position, world axes."""
    return Block(_vector("position", "m", task.arena_low, task.arena_high), lambda frame, present: frame.after.position)


def attitude(task: "Task") -> Block:
    """Own attitude: quaternion body to world, of the two signs the one with w >= 0."""

    def compute(frame, present):
        quaternion = frame.after.quaternion
        return np.where(quaternion[..., 3:] < 0, -quaternion, quaternion)

    low = (-1.0, -1.0, -1.0, 0.0)
    return Block(tuple(Label(f"quaternion {k}", "1", a, 1.0) for k, a in zip("xyzw", low, strict=True)), compute)


def velocity(task: "Task") -> Block:
    """Own velocity, world axes."""
    bound = np.full(3, 2 * task.setting.max_speed)
    return Block(_vector("velocity", "m/s", -bound, bound), lambda frame, present: frame.after.velocity)


def rates(task: "Task") -> Block:
    """Own angular velocity, body axes."""
    bound = np.full(3, MAX_RATE)
    return Block(_vector("rates", "rad/s", -bound, bound), lambda frame, present: frame.after.rates)


def goal_position(task: "Task") -> Block:
    """The goal's position, world axes."""
    return Block(_vector("goal", "m", task.arena_low, task.arena_high), lambda frame, present: frame.scene.goal)


def goal_offset(task: "Task") -> Block:
    """From the drone to its goal, world axes."""
    size = task.arena_high - task.arena_low
    return Block(_vector("goal offset", "m", -size, size), lambda frame, present: frame.scene.goal - frame.after.position)


def goal_velocity(task: "Task") -> Block:
    """The goal's velocity, world axes."""
    bound = np.full(3, 2 * task.setting.max_speed)
    return Block(_vector("goal velocity", "m/s", -bound, bound), lambda frame, present: frame.scene.goal_velocity)


def goal(task: "Task") -> Block:
    """Direction to the goal (unit vector, world axes) and distance."""

    def compute(frame, present):
        offset = frame.scene.goal - frame.after.position
        distance = frame.distance[..., None]
        return np.concatenate([offset / np.maximum(distance, 1e-9), distance], axis=-1)

    furthest = float(np.linalg.norm(task.arena_high - task.arena_low))
    one = np.ones(3)
    return Block((*_vector("goal direction", "1", -one, one), Label("goal distance", "m", 0.0, furthest)), compute)


def alive(task: "Task") -> Block:
    """1 while the drone flies, else 0."""
    return Block((Label("alive", "1", 0.0, 1.0),), lambda frame, present: present[..., None].astype(float))


def neighbours(task: "Task") -> Block:
    """The nearest 3 other drones, nearest first: distance, relative position and velocity; zeros where there are none."""
    size = task.arena_high - task.arena_low
    speed = np.full(3, 4 * task.setting.max_speed)
    labels = []
    for k in range(1, NEIGHBOURS + 1):
        labels.append(Label(f"neighbour {k} distance", "m", 0.0, float(np.linalg.norm(size))))
        labels.extend(_vector(f"neighbour {k} position", "m", -size, size))
        labels.extend(_vector(f"neighbour {k} velocity", "m/s", -speed, speed))

    def compute(frame, present):
        out = np.zeros((*present.shape, len(labels)))
        _nearest(frame.after.position, frame.after.velocity, present, NEIGHBOURS, out)
        return out

    return Block(tuple(labels), compute)


@kernel
def _nearest(position, velocity, present, count, out):
    drones = present.shape[1]
    near, distance = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(present.shape[0]):
        for i in range(drones):
            found = 0
            for j in range(drones):
                if j == i or not present[w, j]:
                    continue
                gap = np.sqrt(((position[w, j] - position[w, i]) ** 2).sum())
                if found == count and gap >= distance[count - 1]:
                    continue
                slot = min(found, count - 1)
                while slot > 0 and distance[slot - 1] > gap:
                    distance[slot], near[slot] = distance[slot - 1], near[slot - 1]
                    slot -= 1
                distance[slot], near[slot] = gap, j
                found = min(found + 1, count)
            for slot in range(found):
                out[w, i, 7 * slot] = distance[slot]
                out[w, i, 7 * slot + 1 : 7 * slot + 4] = position[w, near[slot]] - position[w, i]
                out[w, i, 7 * slot + 4 : 7 * slot + 7] = velocity[w, near[slot]] - velocity[w, i]


BLOCKS: dict[str, Callable[["Task"], Block]] = {
    block.__name__: block
    for block in (position, attitude, velocity, rates, goal_position, goal_offset, goal_velocity, goal, alive, neighbours)
}
IMAGES: dict[str, tuple[float, float, Any, tuple[int, ...]]] = {
    "rgb": (0, 255, np.uint8, (3,)),
    "depth": (0.0, FAR, np.float32, ()),
}
"""Blocks that are pictures of the drone's camera: bounds, type, shape of a pixel"""
STATE = ("position", "attitude", "velocity", "rates", "goal_position", "alive")

Observation = np.ndarray | dict[str, np.ndarray]


class Observer:
    """The named blocks of a task side by side: one vector, or, with pictures among them, a dict.

    Vectors are float32, clipped to their bounds. The dict's keys are "vector" (where there is one) and the pictures' names.
    """

    def __init__(self, names: Sequence[str], task: "Task", camera_size: tuple[int, int] = (64, 48)):
        """Raises ValueError for a block that does not exist."""
        self.images = [name for name in names if name in IMAGES]
        vectors = [name for name in names if name not in IMAGES]
        self._blocks = [pick("observation block", name, BLOCKS)(task) for name in vectors]
        self.labels = [label for block in self._blocks for label in block.labels]
        self.low = np.array([label.low for label in self.labels], dtype=np.float32)
        self.high = np.array([label.high for label in self.labels], dtype=np.float32)
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
            seen["vector"] = np.minimum(np.maximum(vector, self.low), self.high)  # np.clip takes twice as long
        if not self.images:
            return seen["vector"]
        return seen | {name: frame.readings[name].copy() for name in self.images}


def part(observations: Observation, index) -> Any:
    """`observations[index]`, of each entry where they are a dict."""
    if isinstance(observations, dict):
        return {name: array[index] for name, array in observations.items()}
    return observations[index]
