"""Order, cohesion and separation of flocks, mean values of an episode, in any task.

Drones are linked within the task's `link_range`, or 3 d_safe in tasks without it. Only drones that
flew a decision count in it. Formulas and sources: `bulletuav.tasks.parts.flocks`.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.registry import register
from bulletuav.tasks.parts.flocks import (
    find_groups,
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


class FlockState(NamedTuple):
    """Drones of W worlds after a decision.

    Attributes:
        position: (W, N, 3) m.
        velocity: (W, N, 3) m/s.
        flown: (W, N) bool, drones that flew the decision.
        aviary: The worlds.
    """

    position: np.ndarray
    velocity: np.ndarray
    flown: np.ndarray
    aviary: Aviary

    @property
    def directions(self) -> np.ndarray:
        """Directions of motion, (W, N, 3)."""
        return measure_directions(self.velocity, self.flown, MIN_SPEED)

    @property
    def groups(self) -> np.ndarray:
        """Groups of linked drones, (W, N); see `find_groups`."""
        config = self.aviary.task.config
        reach = float(getattr(config, "link_range", LINKS * config.d_safe))
        return find_groups(self.position, self.flown, reach)


class FlockMetric(ABC):
    """Mean of a measure over the decisions of the episode in which any drone flew."""

    name: ClassVar[str]

    def __init__(self, aviary: Aviary) -> None:
        """Initialize the mean of an episode of the aviary's worlds."""
        self._total, self._decisions = np.zeros((2, aviary.num_worlds))

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Return the mean over all decisions so far, (W,)."""
        flown = aviary.alive | step.terminated | step.truncated
        swarm = aviary.swarm
        flies = flown.any(axis=1)
        state = FlockState(swarm.position, swarm.velocity, flown, aviary)
        self._total += np.where(flies, self.measure(state), 0.0)
        self._decisions += flies
        mean: np.ndarray = self._total / np.maximum(self._decisions, 1)
        return mean

    @abstractmethod
    def measure(self, state: FlockState) -> np.ndarray:
        """Return the measure after one decision, (W,)."""


@register("metric")
class FlockOrder(FlockMetric):
    """Vicsek's order parameter: norm of the drones' mean direction of motion, from 0 to 1."""

    name = "flock_order"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the order, (W,)."""
        return measure_order(state.directions, state.flown)


@register("metric")
class FlockCorrelation(FlockMetric):
    """Vasarhelyi's phi_corr: mean cosine between the motions of linked drones, -1 to 1."""

    name = "flock_correlation"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the mean correlation of drones that are not alone, (W,)."""
        groups = state.groups
        correlation = measure_correlation(state.directions, groups)
        has_others = measure_group_size(groups) > 1
        mean: np.ndarray = np.where(has_others, correlation, 0.0).sum(axis=1)
        mean /= np.maximum(has_others.sum(axis=1), 1)
        return mean


@register("metric")
class FlockSpeed(FlockMetric):
    """Vasarhelyi's phi_vel: mean speed, m/s."""

    name = "flock_speed"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the mean speed, (W,)."""
        return measure_mean_speed(state.velocity, state.flown)


@register("metric")
class FlockCollisions(FlockMetric):
    """Vasarhelyi's phi_coll: fraction of pairs of drones closer than d_safe."""

    name = "flock_collisions"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the fraction, (W,)."""
        d_safe = float(state.aviary.task.config.d_safe)
        return measure_close_pairs(state.position, state.flown, d_safe)


@register("metric")
class FlockWall(FlockMetric):
    """Vasarhelyi's phi_wall: fraction of drones outside the arena."""

    name = "flock_wall"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the fraction, (W,)."""
        task, position = state.aviary.task, state.position
        outside = (position < task.arena_low) | (position > task.arena_high)
        count = (outside.any(axis=-1) & state.flown).sum(axis=1)
        fraction: np.ndarray = count / np.maximum(state.flown.sum(axis=1), 1)
        return fraction


@register("metric")
class FlockVelocityVariance(FlockMetric):
    """Mean squared deviation of the drones' velocities from their mean, (m/s)^2."""

    name = "flock_velocity_variance"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the variance, (W,)."""
        return measure_velocity_variance(state.velocity, state.flown)


@register("metric")
class FlockRadius(FlockMetric):
    """Olfati-Saber's cohesion radius: maximum distance of a drone from the flock's centre, m."""

    name = "flock_radius"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the radius, (W,)."""
        return measure_cohesion_radius(state.position, state.flown)


@register("metric")
class FlockConnectivity(FlockMetric):
    """Olfati-Saber's relative connectivity of the graph of linked drones, from 0 to 1."""

    name = "flock_connectivity"

    def measure(self, state: FlockState) -> np.ndarray:
        """Return the connectivity, (W,)."""
        return measure_connectivity(state.groups)
