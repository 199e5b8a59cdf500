"""Order, cohesion and separation of flocks, mean values of an episode, in any task.

Drones are linked within the task's `link_range`, or 3 d_safe in tasks without it. Only drones that
flew a decision count in it. Formulas and sources: `bulletuav.tasks.parts.flocks`.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.parts.flocks import (
    linked_groups,
    measure_close_pairs,
    measure_cohesion_radius,
    measure_connectivity,
    measure_correlation,
    measure_directions,
    measure_group_size,
    measure_mean_speed,
    measure_order,
    measure_velocity_variance,
)

LINKS = 3.0
"""Distance of linked drones in tasks without the option `link_range`, in d_safe"""
MIN_SPEED = 0.5
"""Speed below which a drone has no direction of motion, m/s, as hovering drones drift"""


def _find_directions(frame: Frame) -> np.ndarray:
    """Return the directions of motion, (W, N, 3)."""
    return measure_directions(frame.after.velocity, frame.alive, MIN_SPEED)


def _find_groups(frame: Frame, task: Task[Any]) -> np.ndarray:
    """Return the groups of linked drones, (W, N)."""
    reach = getattr(task.config, "link_range", LINKS * task.config.d_safe)
    return linked_groups(frame, float(reach))


class FlockMetric(ABC):
    """Mean of a measure over the decisions of the episode in which any drone flew."""

    name: ClassVar[str]

    def __init__(self, aviary: Aviary) -> None:
        """Initialize the mean of an episode of the aviary's worlds."""
        self._total, self._decisions = np.zeros((2, aviary.num_worlds))

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Return the mean over all decisions so far, (W,)."""
        frame = aviary.current_frame()
        flies = frame.alive.any(axis=1)
        self._total += np.where(flies, self.measure(frame, aviary.task), 0.0)
        self._decisions += flies
        mean: np.ndarray = self._total / np.maximum(self._decisions, 1)
        return mean

    @abstractmethod
    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the measure after one decision, (W,)."""


@register("metric")
class FlockOrder(FlockMetric):
    """Vicsek's order parameter: norm of the drones' mean direction of motion, from 0 to 1."""

    name = "flock_order"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the order, (W,)."""
        return measure_order(_find_directions(frame), frame.alive)


@register("metric")
class FlockCorrelation(FlockMetric):
    """Vasarhelyi's phi_corr: mean cosine between the motions of linked drones, -1 to 1."""

    name = "flock_correlation"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the mean correlation of drones that are not alone, (W,)."""
        groups = _find_groups(frame, task)
        correlation = measure_correlation(_find_directions(frame), groups)
        has_others = measure_group_size(groups) > 1
        mean: np.ndarray = np.where(has_others, correlation, 0.0).sum(axis=1)
        mean /= np.maximum(has_others.sum(axis=1), 1)
        return mean


@register("metric")
class FlockSpeed(FlockMetric):
    """Vasarhelyi's phi_vel: mean speed, m/s."""

    name = "flock_speed"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the mean speed, (W,)."""
        return measure_mean_speed(frame.after.velocity, frame.alive)


@register("metric")
class FlockCollisions(FlockMetric):
    """Vasarhelyi's phi_coll: fraction of pairs of drones closer than d_safe."""

    name = "flock_collisions"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the fraction, (W,)."""
        d_safe = float(task.config.d_safe)
        return measure_close_pairs(frame.after.position, frame.alive, d_safe)


@register("metric")
class FlockWall(FlockMetric):
    """Vasarhelyi's phi_wall: fraction of drones outside the arena."""

    name = "flock_wall"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the fraction, (W,)."""
        task, position = task, frame.after.position
        outside = (position < task.arena_low) | (position > task.arena_high)
        count = (outside.any(axis=-1) & frame.alive).sum(axis=1)
        fraction: np.ndarray = count / np.maximum(frame.alive.sum(axis=1), 1)
        return fraction


@register("metric")
class FlockVelocityVariance(FlockMetric):
    """Mean squared deviation of the drones' velocities from their mean, (m/s)^2."""

    name = "flock_velocity_variance"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the variance, (W,)."""
        return measure_velocity_variance(frame.after.velocity, frame.alive)


@register("metric")
class FlockRadius(FlockMetric):
    """Olfati-Saber's cohesion radius: maximum distance of a drone from the flock's centre, m."""

    name = "flock_radius"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the radius, (W,)."""
        return measure_cohesion_radius(frame.after.position, frame.alive)


@register("metric")
class FlockConnectivity(FlockMetric):
    """Olfati-Saber's relative connectivity of the graph of linked drones, from 0 to 1."""

    name = "flock_connectivity"

    def measure(self, frame: Frame, task: Task[Any]) -> np.ndarray:
        """Return the connectivity, (W,)."""
        return measure_connectivity(_find_groups(frame, task))
