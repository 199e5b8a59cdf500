"""Statistics of edge servers: what they did in the last decision, and in the episode so far."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.network.server import Served


class ServiceStats(NamedTuple):
    """Statistics of edge servers, which `count` brings up to date after every decision.

    Arrays (W, N) hold a value of each drone, arrays (W,) one of the whole world.

    Attributes:
        utilisation: Share (W, N) of the cores' time in the last decision in which they worked.
        queue: Tasks (W, N) of mean size that wait or are computed at the end of the decision.
        latency: Mean latency (W, N) of the last decision's tasks of the drone's users, s. A lost
            task counts as the deadline.
        completed: Tasks (W, N) of the last decision that are completed within the deadline.
        delay_completed: Sum (W, N) of the latencies of these, s.
        completed_share: Share (W, N) of the last decision's tasks of the drone's users that are
            completed.
        share: Share of the episode's tasks that are completed, so far (W, N), the same for all
            drones of a world. Tasks that are yet to come count as not completed.
        mean_latency: Mean latency (W, N) of the episode's tasks so far, s, the same for all drones
            of a world. A task that is lost or has no drone counts as the deadline.
        generated: Tasks (W,) of the episode so far.
        finished: Tasks (W,) of the episode that are completed, so far.
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
def count(
    served: Served,
    stats: ServiceStats,
    expected: np.ndarray,
    deadline: float,
    core_seconds: float,
    service_rate: float,
) -> None:
    """Enter a decision into the statistics, in place.

    Args:
        served: What became of the tasks of the decision.
        stats: Statistics to bring up to date; changed.
        expected: Number (W,) of tasks that are yet to come in the episode, in the mean.
        deadline: Deadline of a task, s, finite.
        core_seconds: Time that the cores of a drone have in a decision, all together, s.
        service_rate: Tasks of mean size that the cores of a drone complete together, 1/s.
    """
    worlds, drones = served.busy.shape
    for w in range(worlds):
        stats.generated[w] += served.generated[w]
        unassigned = served.generated[w]
        for i in range(drones):
            # What the drone did in this decision
            arrived = max(served.arrived[w, i], 1)
            stats.utilisation[w, i] = served.busy[w, i] / core_seconds
            stats.queue[w, i] = served.backlog[w, i] * service_rate
            stats.latency[w, i] = served.latency[w, i] / arrived
            stats.completed[w, i] = served.completed[w, i]
            lost = served.arrived[w, i] - served.completed[w, i]
            stats.delay_completed[w, i] = served.latency[w, i] - deadline * lost
            stats.completed_share[w, i] = served.completed[w, i] / arrived
            # Its part in the totals of the episode
            stats.finished[w] += served.completed[w, i]
            stats.delay[w] += served.latency[w, i]
            unassigned -= served.arrived[w, i]
        # Tasks of users without a drone are lost: they count as the deadline
        stats.delay[w] += deadline * unassigned
        stats.share[w] = stats.finished[w] / max(stats.generated[w] + expected[w], 1.0)
        stats.mean_latency[w] = stats.delay[w] / max(stats.generated[w], 1.0)
