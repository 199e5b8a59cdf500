"""What edge servers did in the last decision, and in an episode so far."""

from typing import NamedTuple

import numpy as np

from bulletuav.kernel import kernel


class ServiceStats(NamedTuple):
    """What `count` keeps, (W, N); of whole worlds, (W,): generated, finished, delay."""

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
def count(served, books, left, deadline, core_seconds, service_rate):
    """Enter a decision into the books; `left` (W,) tasks are yet to come, drones have `core_seconds` and complete 1/s."""
    worlds, drones = served.busy.shape
    for w in range(worlds):
        books.generated[w] += served.generated[w]
        unassigned = served.generated[w]
        for i in range(drones):
            arrived = max(served.arrived[w, i], 1)
            books.utilisation[w, i] = served.busy[w, i] / core_seconds
            books.queue[w, i] = served.backlog[w, i] * service_rate
            books.latency[w, i] = served.latency[w, i] / arrived
            books.completed[w, i] = served.completed[w, i]
            lost = served.arrived[w, i] - served.completed[w, i]
            books.delay_completed[w, i] = served.latency[w, i] - deadline * lost
            books.completed_share[w, i] = served.completed[w, i] / arrived
            books.finished[w] += served.completed[w, i]
            books.delay[w] += served.latency[w, i]
            unassigned -= served.arrived[w, i]
        books.delay[w] += deadline * unassigned
        books.share[w] = books.finished[w] / max(books.generated[w] + left[w], 1.0)
        books.mean_latency[w] = books.delay[w] / max(books.generated[w], 1.0)
