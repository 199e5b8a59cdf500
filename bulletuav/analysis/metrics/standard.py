"""Metrics that every evaluation takes: their names and what they are."""

from typing import NamedTuple

from bulletuav.registry import register

RATES = ("collision", "conflict", "success")
"""Metrics that are 0 or 1 in an episode, so that their means are shares of the episodes"""
METRICS = {
    "collision": "share of episodes with a contact of collision shapes",
    "conflict": "share of episodes with a separation below d_safe",
    "success": "share of episodes in which all drones succeeded, as the task means it",
    "drone_success": "share of drones that succeeded",
    "return": "sum of the rewards of the episode, mean of the drones",
    "conflicts": "conflicts of two drones that began",
    "near_misses": "times that two came closer than half of d_safe",
    "min_separation": "least separation, m",
    "min_time_to_conflict": (
        "shortest time until two that fly straight on would conflict, s, where there was one"
    ),
    "length": "duration of the episode, s",
    "goal_distance": "distance to the goal at the end, m, mean of the drones",
    "path_efficiency": ("metres made good over metres flown, mean of the drones that succeeded"),
    "jerk": "m/s^3, mean of drones and decisions",
    "energy": (
        "mechanical energy of the rotors, J, mean of the drones; none where dynamics have no rotors"
    ),
    "messages": "messages that drones received, where communication is simulated",
    "fairness": "Jain's index of the drones' metres made good a second",
    "throughput": "drones that succeeded a minute",
    "served": (
        "share of the task's targets in sight of a drone, mean of the episode as planned: "
        "0 once all have left"
    ),
    "completed": "share of the tasks of the episode as planned that were computed in time",
    "latency": (
        "from a task's arrival to its result, s, mean of those that arrived; "
        "the deadline for those that were lost"
    ),
}
"""What each standard metric is, as an episode's number and, over episodes, its mean"""


class StandardMetric(NamedTuple):
    """Entry of the registry for a metric that `Meter` takes anyway.

    Attributes:
        name: Name of the metric.
        about: What it is, with its unit.
    """

    name: str
    about: str


for _name, _about in METRICS.items():
    register("metric", _name)(StandardMetric(_name, _about))
