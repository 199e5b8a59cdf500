"""Observation blocks, chosen by name: each says what its numbers are, in which unit and within which bounds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bulletuav.errors import pick
from bulletuav.kernel import kernel

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
    for block in (position, attitude, velocity, rates, goal_position, goal_offset, goal, alive, neighbours)
}
STATE = ("position", "attitude", "velocity", "rates", "goal_position", "alive")


class Observer:
    """The named blocks of a task side by side, clipped to their bounds, as float32."""

    def __init__(self, names: Sequence[str], task: "Task"):
        """Raises ValueError for a block that does not exist."""
        self._blocks = [pick("observation block", name, BLOCKS)(task) for name in names]
        self.labels = [label for block in self._blocks for label in block.labels]
        self.low = np.array([label.low for label in self.labels], dtype=np.float32)
        self.high = np.array([label.high for label in self.labels], dtype=np.float32)

    def observe(self, frame: "Frame", present: np.ndarray) -> np.ndarray:
        """(W, N, D) float32 after the frame; `present` (W, N) are the drones that can still be met."""
        parts = [block.compute(frame, present) for block in self._blocks]
        return np.clip(np.concatenate(parts, axis=-1).astype(np.float32), self.low, self.high)

    def table(self) -> list[str]:
        """One line a number: index, name, unit, bounds."""
        return [f"{k:3d}  {x.name:24s} {x.unit:6s} [{x.low:g}, {x.high:g}]" for k, x in enumerate(self.labels)]
