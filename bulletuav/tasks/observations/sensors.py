"""Observation blocks of sensors that look at the world, and of what is left in batteries."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bulletuav.geometry.view import DRONE, FAR, SKY
from bulletuav.kernel import kernel
from bulletuav.tasks.observations.motion import MAX_BODY_RATE, Block, Label, vector_labels

if TYPE_CHECKING:
    from bulletuav.tasks.base import Frame, Task

MAX_FORCE = 100.0  # m/s^2
AHEAD = {
    "east": (30.0, 0.0, 0.0),
    "north": (0.0, 30.0, 0.0),
    "west": (-30.0, 0.0, 0.0),
    "south": (0.0, -30.0, 0.0),
}
"""Ways, m, at whose ends `sight_ahead` looks"""


def lidar(task: "Task") -> Block:
    """Ranges of the beams."""
    reach = task.context.max_range
    labels = tuple(
        Label(
            f"beam {beam.azimuth:g}" + (f" up {beam.elevation:g}" if beam.elevation else ""),
            "m",
            0.0,
            reach,
        )
        for beam in task.context.beams
    )
    return Block(labels, _reading("lidar"))


def imu(task: "Task") -> Block:
    """Specific force and angular velocity, body axes."""
    labels = vector_labels("force", "m/s^2", [-MAX_FORCE] * 3, [MAX_FORCE] * 3)
    return Block(
        (*labels, *vector_labels("rates", "rad/s", [-MAX_BODY_RATE] * 3, [MAX_BODY_RATE] * 3)),
        _reading("imu"),
    )


def clearance(task: "Task") -> Block:
    """Distance of the drone's shape from the nearest thing."""
    return Block((Label("clearance", "m", -1.0, task.context.max_range),), _reading("clearance"))


def battery(task: "Task") -> Block:
    """What is left of the charge."""
    return Block((Label("charge", "1", 0.0, 1.0),), _reading("charge"))


def targets(task: "Task") -> Block:
    """The task's targets: position as seen from the drone, world axes, and whether it sees them."""
    size = task.arena_high - task.arena_low
    labels: list[Label] = []
    for k in range(1, task.num_targets + 1):
        labels += [
            *vector_labels(f"target {k}", "m", -size, size),
            Label(f"target {k} seen", "1", 0.0, 1.0),
        ]

    def compute(frame, present):
        places = task.targets(frame.scene)
        offset = places[:, None] - frame.known_position[:, :, None]
        seen = frame.readings["sight"][..., None]
        return np.concatenate([offset, seen], axis=-1).reshape(*present.shape, len(labels))

    return Block(tuple(labels), compute)


def seen_share(task: "Task") -> Block:
    """Share of the task's targets that the drone sees."""

    def compute(frame, present):
        return share_of(frame.readings["sight"], task.active_targets(frame.scene)[:, None])[
            ..., None
        ]

    return Block((Label("seen share", "1", 0.0, 1.0),), compute)


def sight_ahead(task: "Task") -> Block:
    """Which targets the drone would see from 30 m east, north, west and south of it, by a map: how sight would change."""
    labels = [
        Label(f"{way} sees {k}", "1", 0.0, 1.0)
        for way in AHEAD
        for k in range(1, task.num_targets + 1)
    ]
    return Block(tuple(labels), _reading("sight_ahead"))


def share_of(seen: np.ndarray, active_targets: np.ndarray) -> np.ndarray:
    """(...,) share of those that count which are seen, (..., U) bool both, exactly 1 for all; 0 where none counts."""
    return (seen & active_targets).sum(axis=-1) / np.maximum(active_targets.sum(axis=-1), 1)


@kernel
def served_share(sight, alive, active_targets):
    """(W, N) share of the targets that count (W, U) which any living drone (W, N) sees, by `sight` (W, N, U)."""
    share = np.zeros(alive.shape)
    for w in range(alive.shape[0]):
        seen, most = 0, 0
        for j in range(active_targets.shape[1]):
            if active_targets[w, j]:
                most += 1
                for i in range(alive.shape[1]):
                    if alive[w, i] and sight[w, i, j]:
                        seen += 1
                        break
        share[w] = seen / max(most, 1)
    return share


def _reading(name: str) -> Callable[["Frame", np.ndarray], np.ndarray]:
    """What a sensor reads, (W, N) or (W, N, ...)."""
    return lambda frame, present: frame.readings[name].reshape(*present.shape, -1)


IMAGES: dict[str, tuple[float, float, Any, tuple[int, ...]]] = {
    "rgb": (0, 255, np.uint8, (3,)),
    "depth": (0.0, FAR, np.float32, ()),
    "segmentation": (SKY, DRONE, np.uint8, ()),
    "ray_depth": (0.0, FAR, np.float32, ()),
}
"""Blocks that are pictures of the drone's camera: bounds, type, shape of a pixel"""
