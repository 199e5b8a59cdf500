"""What becomes of the tasks of one decision, in two compiled calls over arrays that stay.

The parts are those of `uplink`, `assignment`, `access`, `arrivals`, `server` and `service_stats`.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.network.access import uplink_rates
from bulletuav.network.arrivals import Tasks, spread
from bulletuav.network.assignment import assign
from bulletuav.network.server import serve, serve_on_average
from bulletuav.network.service_stats import ServiceStats, count


class Strategy(NamedTuple):
    """Numbers by which users find their drones.

    Attributes:
        code: One of `bulletuav.network.assignment.STRATEGIES`.
        capacity: Computing capacity of a drone, cycles/s.
        demand: Demand of a task, cycles.
        distance_weight: Weight of distance in `dtlcm_score`.
    """

    code: int
    capacity: float
    demand: float
    distance_weight: float


class Band(NamedTuple):
    """Numbers of the band that users share; see `bulletuav.network.access.uplink_rates`."""

    bandwidth: float
    noise: float
    access: int
    activity: float


class Drawn(NamedTuple):
    """What tasks are made of; see `bulletuav.network.arrivals.spread`.

    Attributes:
        first: Bounds (W + 1,) of the worlds' tasks.
        uniform: Random numbers; those behind the last task's do not count.
        cumulative: Cumulative rates (U,) of users, 1/s.
        low: Least size of a task, bit.
        high: Greatest size, bit.
    """

    first: np.ndarray
    uniform: np.ndarray
    cumulative: np.ndarray
    low: float
    high: float


class Queue(NamedTuple):
    """Numbers of the servers.

    Attributes:
        on_average: Whether tasks wait for as long as on average; see `serve_on_average`.
        cycles_per_bit: Cycles that a bit takes to compute.
        core_frequency: Frequency of a core, cycles/s.
        cores: Cores of each drone.
        arrival_rate: Tasks of each user, 1/s.
        service_rate: Tasks that each core completes, 1/s.
        deadline: Time from generation within which a task must complete, s.
        dt: Length of the decision, s.
        duration: Of an episode, s.
    """

    on_average: bool
    cycles_per_bit: float
    core_frequency: float
    cores: int
    arrival_rate: float
    service_rate: float
    deadline: float
    dt: float
    duration: float


@allocating
def connect(
    strategy: Strategy,
    band: Band,
    position: np.ndarray,
    alive: np.ndarray,
    users: np.ndarray,
    power: np.ndarray,
    utilisation: np.ndarray,
    servers: np.ndarray,
    serves: np.ndarray,
    rates: np.ndarray,
) -> None:
    """Find who serves whom at which rate.

    Args:
        strategy: How users find drones.
        band: What they share.
        position: Positions (W, N, 3) of drones, m.
        alive: Drones (W, N) that can serve, bool.
        users: Positions (W, U, 3) of users, m.
        power: Power (W, N, U) that drones receive from users, W.
        utilisation: Share (W, N) of their time in which cores worked.
        servers: Written: drone (W, U) of each user, or `NOBODY`.
        serves: Written: 1 (W, N, U) where the drone serves the user, else 0.
        rates: Written: uplink rate (W, U) of each user, bit/s.
    """
    load = np.empty(utilisation.shape)
    for w in range(utilisation.shape[0]):
        for i in range(utilisation.shape[1]):
            load[w, i] = utilisation[w, i] * strategy.capacity
    code, capacity, demand, weight = strategy
    chosen = assign(code, position, alive, users, power, capacity, demand, load, weight)
    bandwidth, noise, access, activity = band
    found = uplink_rates(power, chosen, bandwidth, noise, access, activity)
    for w in range(servers.shape[0]):
        for j in range(servers.shape[1]):
            servers[w, j], rates[w, j] = chosen[w, j], found[w, j]
            for i in range(serves.shape[1]):
                serves[w, i, j] = 1.0 if chosen[w, j] == i else 0.0


@allocating
def work(
    drawn: Drawn,
    queue: Queue,
    servers: np.ndarray,
    rates: np.ndarray,
    link_free: np.ndarray,
    core_free: np.ndarray,
    time: np.ndarray,
    stats: ServiceStats,
) -> None:
    """Compute the tasks of a decision, and enter what became of them into the statistics.

    Args:
        drawn: What they are made of.
        queue: Numbers of the servers.
        servers: Drone (W, U) of each user, or `NOBODY`.
        rates: Uplink rate (W, U) of each user, bit/s.
        link_free: Time (W, U) for which uplinks are still taken, s; changed unless on average.
        core_free: The same (W, N, C) of cores.
        time: Time (W,) since each world's reset, s.
        stats: Statistics of the episode; changed.
    """
    user, begin, bits = spread(
        drawn.first, drawn.uniform, drawn.cumulative, queue.dt, drawn.low, drawn.high
    )
    tasks = Tasks(drawn.first, user, begin, bits)
    cycles, deadline, dt = queue.cycles_per_bit, queue.deadline, queue.dt
    if queue.on_average:
        steady = (queue.cores, queue.arrival_rate, queue.service_rate, deadline, dt)
        served = serve_on_average(tasks, servers, rates, core_free.shape[1], cycles, *steady)
    else:
        limits = (queue.core_frequency, deadline, dt)
        served = serve(tasks, servers, rates, cycles, *limits, link_free, core_free)
    # Tasks that are yet to come, as many as on average
    expected = np.empty(time.shape)
    for w in range(time.shape[0]):
        left = max(queue.duration - time[w], 0.0)
        expected[w] = queue.arrival_rate * servers.shape[1] * left
    full_rate = queue.cores * queue.service_rate
    count(served, stats, expected, deadline, queue.cores * dt, full_rate)
