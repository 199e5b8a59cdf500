"""Reward terms of seeing and serving targets, such as users on the ground."""

import numpy as np

from bulletuav.compiled.functions import tanh
from bulletuav.network.dwell_time import DWELL_TIME_SCALE
from bulletuav.registry import register
from bulletuav.tasks.ingredients import reward


@register("reward")
@reward
def sight(sight: np.ndarray) -> float:
    """Fraction of the targets that the drone sees."""
    seen = 0
    for j in range(len(sight)):
        seen += 1 if sight[j] else 0
    return seen / len(sight)


@register("reward")
@reward
def served(served: float) -> float:
    """Fraction of the active targets seen by at least one active drone."""
    return served


@register("reward")
@reward
def dwell_time(mean_dwell_time: float) -> float:
    """tanh(0.1 s) of the mean time s for which the drone has seen users: from 0 to 1."""
    return tanh(DWELL_TIME_SCALE * mean_dwell_time)


@register("reward")
@reward
def service_time(steady_service: float) -> float:
    """tanh(0.1 s) of the time s for which a user has been seen, averaged over users: from 0 to 1.

    For each user the drone with the longest time counts. Times are in seconds.
    """
    return steady_service


@register("reward")
@reward
def tasks(completed: float, expected_tasks: float) -> float:
    """Completed tasks of the decision, divided by the expected number of tasks of all users."""
    return completed / expected_tasks


@register("reward")
@reward
def latency(delay_completed: float, deadline: float, expected_tasks: float) -> float:
    """Latencies of the completed tasks over the deadline and the expected number of tasks."""
    return delay_completed / (deadline * expected_tasks)


@register("reward")
@reward
def power_share(power: float, power_scale: float) -> float:
    """Power of the drone, divided by that of full thrust and busy cores."""
    return power / power_scale
