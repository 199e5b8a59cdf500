"""Processing of the tasks of one decision, in two compiled calls on preallocated arrays.

The components are those of `uplink`, `assignment`, `access`, `arrivals`, `server` and
`service_stats`.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.network.access import uplink_rates
from bulletuav.network.arrivals import Tasks, make_tasks
from bulletuav.network.assignment import assign_users
from bulletuav.network.server import serve_steady_state, serve_tasks
from bulletuav.network.service_stats import ServiceStats, update_service_stats


class Strategy(NamedTuple):
    """Parameters of user association.

    Attributes:
        code: One of `bulletuav.network.assignment.STRATEGIES`.
        capacity: Computing capacity of a drone, cycles/s.
        demand: Demand of a task, cycles.
        distance_weight: Weight of the distance in `dtlcm_score`.
    """

    code: int
    capacity: float
    demand: float
    distance_weight: float


class Band(NamedTuple):
    """Parameters of the shared band; see `bulletuav.network.access.uplink_rates`."""

    bandwidth: float
    noise: float
    access: int
    activity: float


class TaskNumbers(NamedTuple):
    """Random numbers of the tasks; see `bulletuav.network.arrivals.make_tasks`.

    Attributes:
        first: Offsets (W + 1,) of the tasks of each world.
        uniform: Uniform random numbers; numbers after those of the last task are unused.
        cumulative: Cumulative arrival rates (U,) of the users, 1/s.
        low: Minimum size of a task, bit.
        high: Maximum size of a task, bit.
    """

    first: np.ndarray
    uniform: np.ndarray
    cumulative: np.ndarray
    low: float
    high: float


class Queue(NamedTuple):
    """Parameters of the edge servers.

    Attributes:
        on_average: Whether waits are those of the steady-state queue; see `serve_steady_state`.
        cycles_per_bit: Cycles per bit of a task.
        core_frequency: Frequency of a core, cycles/s.
        cores: Number of cores of each drone.
        arrival_rate: Arrival rate of each user, 1/s.
        service_rate: Service rate of each core, 1/s.
        deadline: Time from generation within which a task must be completed, s.
        dt: Length of the decision, s.
        duration: Duration of an episode, s.
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
def associate_users(
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
    """Compute user association and uplink rates.

    Args:
        strategy: Parameters of user association.
        band: Parameters of the shared band.
        position: Positions (W, N, 3) of drones, m.
        alive: Drones (W, N) that can serve users, bool.
        users: Positions (W, U, 3) of users, m.
        power: Received power (W, N, U) of users at drones, W.
        utilisation: Utilisation (W, N) of the cores, 0 to 1.
        servers: Written: serving drone (W, U) of each user, or `NO_DRONE`.
        serves: Written: 1 (W, N, U) if the drone serves the user, else 0.
        rates: Written: uplink rate (W, U) of each user, bit/s.
    """
    load = np.empty(utilisation.shape)
    for w in range(utilisation.shape[0]):
        for i in range(utilisation.shape[1]):
            load[w, i] = utilisation[w, i] * strategy.capacity
    code, capacity, demand, weight = strategy
    chosen = assign_users(code, position, alive, users, power, capacity, demand, load, weight)
    bandwidth, noise, access, activity = band
    found = uplink_rates(power, chosen, bandwidth, noise, access, activity)
    for w in range(servers.shape[0]):
        for j in range(servers.shape[1]):
            servers[w, j], rates[w, j] = chosen[w, j], found[w, j]
            for i in range(serves.shape[1]):
                serves[w, i, j] = 1.0 if chosen[w, j] == i else 0.0


@allocating
def process_tasks(
    drawn: TaskNumbers,
    queue: Queue,
    servers: np.ndarray,
    rates: np.ndarray,
    link_free: np.ndarray,
    core_free: np.ndarray,
    time: np.ndarray,
    stats: ServiceStats,
) -> None:
    """Process the tasks of a decision, and update the statistics.

    Args:
        drawn: Random numbers of the tasks.
        queue: Parameters of the edge servers.
        servers: Serving drone (W, U) of each user, or `NO_DRONE`.
        rates: Uplink rate (W, U) of each user, bit/s.
        link_free: Time (W, U) until which uplinks are busy, s; modified unless `on_average`.
        core_free: Time (W, N, C) until which cores are busy, s; modified unless `on_average`.
        time: Time (W,) since the reset of each world, s.
        stats: Statistics of the episode; modified.
    """
    user, begin, bits = make_tasks(
        drawn.first, drawn.uniform, drawn.cumulative, queue.dt, drawn.low, drawn.high
    )
    tasks = Tasks(drawn.first, user, begin, bits)
    cycles, deadline, dt = queue.cycles_per_bit, queue.deadline, queue.dt
    if queue.on_average:
        steady = (queue.cores, queue.arrival_rate, queue.service_rate, deadline, dt)
        served = serve_steady_state(tasks, servers, rates, core_free.shape[1], cycles, *steady)
    else:
        limits = (queue.core_frequency, deadline, dt)
        served = serve_tasks(tasks, servers, rates, cycles, *limits, link_free, core_free)
    # Expected number of tasks in the rest of the episode
    expected = np.empty(time.shape)
    for w in range(time.shape[0]):
        left = max(queue.duration - time[w], 0.0)
        expected[w] = queue.arrival_rate * servers.shape[1] * left
    full_rate = queue.cores * queue.service_rate
    update_service_stats(served, stats, expected, deadline, queue.cores * dt, full_rate)
