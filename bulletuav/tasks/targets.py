"""Tasks in which drones are to see points: users on the ground, or cells of it."""

from typing import Any, ClassVar, Generic

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import ConfigT
from bulletuav.tasks.frame import Frame, Scene

SERVED = "served share"
"""Where a frame keeps what `TargetTask.served` tells"""


class TargetTask(Task[ConfigT], Generic[ConfigT]):
    """A task with `num_targets` targets; a task says where they are, by `targets(scene)`.

    Its drones have no goals of their own.
    """

    has_goals = False
    shows: ClassVar = {"served": "served by all", "collision": "collisions"}

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Tell which targets count, (W, num_targets) bool; all by default."""
        return np.ones((len(scene.goal), self.num_targets), dtype=bool)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell the share of the targets that is served, beside what every task tells."""
        return {"served": self.served(frame), **super().info(frame)}

    def served(self, frame: Frame) -> np.ndarray:
        """Compute the share of the targets that some living drone sees, (W, N)."""
        known = frame.derived.get(SERVED)
        if known is None:  # else asked before, of the same frame
            active = self.active_targets(frame.scene)
            known = served_share(frame.readings["sight"], frame.alive, active)
            frame.derived[SERVED] = known
        return known

    def links(self, frame: Frame) -> np.ndarray:
        """Tell which drones serve which targets, for pictures, (W, N, U) bool; by default none."""
        return np.zeros_like(frame.seen)

    def service_quality(
        self,
        place: np.ndarray,
        targets: np.ndarray,
        sight: np.ndarray,
    ) -> np.ndarray:
        """Tell what targets are worth to drones, for policies that know everything.

        Args:
            place: (C, 3) of the drones, m.
            targets: (U, 3) m.
            sight: (C, U) bool, whether they are in line of sight.

        Returns:
            (C, U) from 0 to 1; by default whether they are seen.
        """
        return sight.astype(float)


def active_targets(task: Task[Any], scene: Scene) -> np.ndarray:
    """Tell which targets of any task count, (W, num_targets) bool."""
    if isinstance(task, TargetTask):
        return task.active_targets(scene)
    return np.ones((len(scene.goal), task.num_targets), dtype=bool)


def links(task: Task[Any], frame: Frame) -> np.ndarray:
    """Tell which drones of any task serve which targets; see `TargetTask.links`."""
    return task.links(frame) if isinstance(task, TargetTask) else np.zeros_like(frame.seen)


def service_quality(
    task: Task[Any],
    place: np.ndarray,
    targets: np.ndarray,
    sight: np.ndarray,
) -> np.ndarray:
    """Tell what targets of any task are worth to drones; see `TargetTask.service_quality`."""
    if isinstance(task, TargetTask):
        return task.service_quality(place, targets, sight)
    return sight.astype(float)


def share_of(seen: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Compute the share of active targets that are seen.

    Args:
        seen: (..., U) bool.
        active: (..., U) bool.

    Returns:
        (...,), exactly 1 for all, 0 where none is active.
    """
    share: np.ndarray = (seen & active).sum(axis=-1) / np.maximum(active.sum(axis=-1), 1)
    return share


@allocating
def served_share(
    sight: np.ndarray,
    alive: np.ndarray,
    active: np.ndarray,
) -> np.ndarray:
    """Compute the share of active targets that any living drone sees.

    Args:
        sight: (W, N, U) bool.
        alive: (W, N) bool.
        active: (W, U) bool.

    Returns:
        (W, N), the same for all drones of a world.
    """
    share = np.zeros(alive.shape)
    for w in range(alive.shape[0]):
        seen, most = 0, 0
        for j in range(active.shape[1]):
            if active[w, j]:
                most += 1
                # One drone that sees it is enough.
                for i in range(alive.shape[1]):
                    if alive[w, i] and sight[w, i, j]:
                        seen += 1
                        break
        share[w] = seen / max(most, 1)
    return share
