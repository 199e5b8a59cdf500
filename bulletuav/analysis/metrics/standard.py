"""Names and descriptions of the standard metrics."""

from typing import NamedTuple

from bulletuav.registry import register

RATES = ("collision", "conflict", "success")
"""Metrics that are 0 or 1 in an episode, so that their means are fractions of the episodes"""
SHARES = ("safe_success", "drone_success")
"""Metrics that are fractions of the drones in an episode"""
METRICS = {
    "safe_success": (
        "fraction of drones that succeeded, without conflict or collision in the episode"
    ),
    "collision": "fraction of episodes with a contact of collision shapes",
    "conflict": "fraction of episodes with a separation below d_safe",
    "success": "fraction of episodes in which all drones succeeded",
    "drone_success": "fraction of drones that succeeded, as defined by the task",
    "return": "sum of the rewards of the episode, mean over drones",
    "conflicts": "number of conflicts of two drones that began",
    "near_misses": "number of approaches of two drones below half of d_safe",
    "min_separation": "minimum separation, m",
    "min_time_to_conflict": (
        "minimum time to a conflict of two drones at constant velocity, s, if any"
    ),
    "length": "duration of the episode, s",
    "goal_distance": "distance to the goal at the end, m, mean over drones",
    "path_efficiency": ("progress to the goal over path length, mean over drones that succeeded"),
    "jerk": "jerk, m/s^3, mean over drones and decisions",
    "energy": (
        "mechanical energy of the rotors, J, mean over drones; none if the dynamics have no rotors"
    ),
    "messages": "number of messages that drones received, if communication is simulated",
    "fairness": "Jain's index of the drones' progress towards their goals per second",
    "throughput": "number of drones that succeeded per minute",
    "served": (
        "fraction of the task's targets in sight of a drone, mean over the planned episode: "
        "0 after all drones have finished"
    ),
    "completed": "fraction of the tasks of the planned episode that were computed in time",
    "latency": (
        "time from a task's arrival to its result, s, mean over tasks that arrived; "
        "the deadline for lost tasks"
    ),
}
"""Description of each standard metric, of an episode's value or its mean over episodes"""


class StandardMetric(NamedTuple):
    """Registry entry of a metric that `Meter` always measures.

    Attributes:
        name: Name of the metric.
        about: Description with its unit.
    """

    name: str
    about: str


for _name, _about in METRICS.items():
    register("metric", _name)(StandardMetric(_name, _about))
