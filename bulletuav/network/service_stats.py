"""Statistics of edge servers over the last decision and over the episode."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.network.server import Served


class ServiceStats(NamedTuple):
    """Statistics of edge servers, updated by `update_service_stats` after every decision.

    Arrays (W, N) contain one value per drone, arrays (W,) one value per world.

    Attributes:
        utilisation: Utilisation (W, N) of the cores in the last decision, 0 to 1.
        queue: Number (W, N) of tasks of mean size in the system at the end of the decision.
        latency: Mean latency (W, N) of the last decision's tasks of the drone's users, s. A lost
            task contributes the deadline.
        completed: Number (W, N) of tasks of the last decision that complete within the deadline.
        delay_completed: Sum (W, N) of the latencies of these tasks, s.
        completed_share: Fraction (W, N) of the last decision's tasks of the drone's users that
            complete.
        share: Completed fraction (W, N) of the episode's tasks so far, the same for all drones of a
            world. Expected future tasks count as not completed.
        mean_latency: Mean latency (W, N) of the episode's tasks so far, s, the same for all drones
            of a world. A task that is lost or has no drone contributes the deadline.
        generated: Number (W,) of tasks of the episode so far.
        finished: Number (W,) of completed tasks of the episode so far.
        delay: Sum (W,) of the latencies of the episode's tasks so far, s.
    """

    utilisation: np.ndarray
    queue: np.ndarray
    latency: np.ndarray
    completed: np.ndarray
    delay_completed: np.ndarray
    completed_share: np.ndarray
    share: np.ndarray
    mean_latency: np.ndarray
    generated: np.ndarray
    finished: np.ndarray
    delay: np.ndarray


@kernel
def update_service_stats(
    served: Served,
    stats: ServiceStats,
    expected: np.ndarray,
    deadline: float,
    core_seconds: float,
    service_rate: float,
) -> None:
    """Update the statistics by the results of a decision, in place.

    Args:
        served: Results of the tasks of the decision.
        stats: Statistics; modified.
        expected: Expected number (W,) of tasks in the rest of the episode.
        deadline: Deadline of a task, s, finite.
        core_seconds: Total core time of a drone in a decision, s.
        service_rate: Service rate of all cores of a drone for tasks of mean size, 1/s.
    """
    worlds, drones = served.busy.shape
    for w in range(worlds):
        stats.generated[w] += served.generated[w]
        unassigned = served.generated[w]
        for i in range(drones):
            # Statistics of the drone in this decision
            arrived = max(served.arrived[w, i], 1)
            stats.utilisation[w, i] = served.busy[w, i] / core_seconds
            stats.queue[w, i] = served.backlog[w, i] * service_rate
            stats.latency[w, i] = served.latency[w, i] / arrived
            stats.completed[w, i] = served.completed[w, i]
            lost = served.arrived[w, i] - served.completed[w, i]
            stats.delay_completed[w, i] = served.latency[w, i] - deadline * lost
            stats.completed_share[w, i] = served.completed[w, i] / arrived
            # Totals of the episode
            stats.finished[w] += served.completed[w, i]
            stats.delay[w] += served.latency[w, i]
            unassigned -= served.arrived[w, i]
        # Tasks of users without a drone are lost: they contribute the deadline
        stats.delay[w] += deadline * unassigned
        stats.share[w] = stats.finished[w] / max(stats.generated[w] + expected[w], 1.0)
        stats.mean_latency[w] = stats.delay[w] / max(stats.generated[w], 1.0)
