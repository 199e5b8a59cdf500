"""Edge servers on drones: uploads of tasks, and multi-core queues.

Tasks, see `arrivals`, are simulated individually. Unlike the formulas of `queueing`, the simulation
requires neither a steady state nor exponential sizes. Times are in s since the start of the
decision, and a decision takes `dt` s.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.network.arrivals import Tasks
from bulletuav.network.queueing import mean_response


class Served(NamedTuple):
    """Results of the tasks of one decision.

    Completion and completion time of a task are determined when the task is generated.

    Attributes:
        generated: Number (W,) of tasks.
        arrived: Number (W, N) of tasks from users assigned to each drone.
        completed: Number (W, N) of these tasks that complete within the deadline.
        latency: Sum (W, N) of the latencies from generation to completion, s, over the arrived
            tasks. A lost task contributes the deadline, or 0 if the deadline is inf.
        busy: Busy time (W, N) of the cores in this decision, core-seconds.
        backlog: Remaining work (W, N) at the end of the decision, s per core, mean over the cores.
        cycles: Cycles (W, N) of the completed tasks.
    """

    generated: np.ndarray
    arrived: np.ndarray
    completed: np.ndarray
    latency: np.ndarray
    busy: np.ndarray
    backlog: np.ndarray
    cycles: np.ndarray


class _Server(NamedTuple):
    """Parameters that the servers of all drones share in a decision.

    Attributes:
        cycles_per_bit: Cycles per bit of a task.
        core_frequency: Frequency of a core, cycles/s.
        deadline: Time from generation within which a task must be completed, s; may be inf.
        dt: Length of the decision, s.
    """

    cycles_per_bit: float
    core_frequency: float
    deadline: float
    dt: float


@allocating
def serve_tasks(
    tasks: Tasks,
    assignment: np.ndarray,
    uplink: np.ndarray,
    cycles_per_bit: float,
    core_frequency: float,
    deadline: float,
    dt: float,
    link_free: np.ndarray,
    core_free: np.ndarray,
) -> Served:
    """Simulate the uploads and queues of one decision.

    A user uploads its tasks sequentially in the order of generation, at the rate of this decision.
    A drone serves tasks first come, first served, each on the core that becomes idle first.

    A task that would miss its deadline is lost, at no cost: a user does not start an upload that
    even an idle core could not complete in time, and a server rejects such a task. Tasks of users
    without a drone or with rate 0 are lost immediately and do not occupy the link.

    Tasks whose upload crosses the end of the decision are queued before all tasks of the next
    decision. A core that idles until their arrival is not reserved for them. Only remaining work is
    carried over, so that no core time is lost or counted twice.

    Args:
        tasks: Tasks of the decision.
        assignment: Serving drone (W, U) of each user, -1 for none.
        uplink: Uplink rate (W, U) of each user, bit/s.
        cycles_per_bit: Cycles per bit of a task.
        core_frequency: Frequency of a core, cycles/s.
        deadline: Time from generation within which a task must be completed, s; may be inf.
        dt: Length of the decision, s.
        link_free: Time (W, U) until which uplinks are busy, relative to the start of the decision,
            s; modified. Initially zeros.
        core_free: Time (W, N, C) until which cores are busy, relative to the start of the decision,
            s; modified. Initially zeros.

    Returns:
        Results of the tasks.
    """
    worlds, drones, cores = core_free.shape
    served = _new_served(tasks, drones)
    server = _Server(cycles_per_bit, core_frequency, deadline, dt)
    # Buffers of one world: uploaded tasks, their arrival times, and remaining work of each core
    size = 0
    for w in range(worlds):
        size = max(size, served.generated[w])
    order = np.empty(size, dtype=np.int64)
    arrival = np.empty(size)
    remaining = np.empty((drones, cores))
    for w in range(worlds):
        link, core, taken = link_free[w], core_free[w], assignment[w]
        _continue_work(core, dt, served.busy[w], remaining)
        arrived = served.arrived[w]
        count = _upload(tasks, w, taken, uplink[w], server, link, arrived, order, arrival)
        for k in range(count):
            task = order[k]
            i = taken[tasks.user[task]]
            _run_task(tasks, task, arrival[k], server, core[i], remaining[i], served, w, i)
        _carry_over(server, core, link, remaining, served, w)
    return served


@func
def _continue_work(
    core_free: np.ndarray, dt: float, busy: np.ndarray, remaining: np.ndarray
) -> None:
    """Continue the work of earlier decisions on the cores (N, C) of one world."""
    for i in range(core_free.shape[0]):
        for j in range(core_free.shape[1]):
            busy[i] += min(core_free[i, j], dt)
            remaining[i, j] = max(core_free[i, j] - dt, 0.0)


@func
def _run_task(
    tasks: Tasks,
    task: int,
    arrival: float,
    server: _Server,
    core_free: np.ndarray,
    remaining: np.ndarray,
    served: Served,
    w: int,
    i: int,
) -> None:
    """Run an arrived task on a core of drone i in world w, unless it would miss its deadline.

    Args:
        tasks: Tasks of the decision.
        task: Index of the task.
        arrival: Arrival time, s.
        server: Parameters of the servers.
        core_free: Time (C,) until which each core of the drone is busy, s; modified.
        remaining: Work (C,) that each core carries over to the next decision, s; modified.
        served: Results of the tasks; modified.
        w: Index of the world.
        i: Index of the drone.
    """
    work = tasks.bits[task] * server.cycles_per_bit
    # The task runs on the core that becomes idle first
    j = _first_free(core_free)
    start = max(arrival, core_free[j])
    finish = start + work / server.core_frequency
    if finish > tasks.time[task] + server.deadline:
        return
    # Busy time in this decision, and work for the next decision
    busy_until = min(finish, server.dt)
    left_from = max(start, server.dt)
    served.busy[w, i] += max(busy_until - start, 0.0)
    remaining[j] += max(finish - left_from, 0.0)
    core_free[j] = finish
    served.completed[w, i] += 1
    served.latency[w, i] += finish - tasks.time[task]
    served.cycles[w, i] += work


@func
def _carry_over(
    server: _Server,
    core_free: np.ndarray,
    link_free: np.ndarray,
    remaining: np.ndarray,
    served: Served,
    w: int,
) -> None:
    """Count the lost tasks of world w, and carry its remaining work (N, C) over."""
    drones, cores = core_free.shape
    # A lost task contributes its deadline; without a deadline no task is lost
    lost_latency = server.deadline if server.deadline < np.inf else 0.0
    for i in range(drones):
        lost = served.arrived[w, i] - served.completed[w, i]
        served.latency[w, i] += lost_latency * lost
        for j in range(cores):
            core_free[i, j] = remaining[i, j]
            served.backlog[w, i] += remaining[i, j] / cores
    # Shift the busy times of links to the start of the next decision
    for j in range(len(link_free)):
        link_free[j] = max(link_free[j] - server.dt, 0.0)


@allocating
def _new_served(tasks: Tasks, drones: int) -> Served:
    """Allocate the results of a decision."""
    generated = tasks.first[1:] - tasks.first[:-1]
    shape = (len(generated), drones)
    arrived = np.zeros(shape, dtype=np.int64)
    completed = np.zeros(shape, dtype=np.int64)
    latency = np.zeros(shape)
    busy = np.zeros(shape)
    backlog = np.zeros(shape)
    cycles = np.zeros(shape)
    return Served(generated, arrived, completed, latency, busy, backlog, cycles)


@func
def _first_free(core_free: np.ndarray) -> int:
    """Return the index of the core that becomes idle first, the lowest in case of ties."""
    first = 0
    for j in range(1, len(core_free)):
        if core_free[j] < core_free[first]:
            first = j
    return first


@kernel
def _upload(
    tasks: Tasks,
    w: int,
    assignment: np.ndarray,
    uplink: np.ndarray,
    server: _Server,
    link_free: np.ndarray,
    arrived: np.ndarray,
    order: np.ndarray,
    arrival: np.ndarray,
) -> int:
    """Upload the tasks of world w, and sort those that reach a server by arrival time.

    Ties keep the order of generation. Insertion sort is fast, as tasks are nearly sorted.

    Args:
        tasks: Tasks of the decision.
        w: Index of the world.
        assignment: Serving drone (U,) of each user, -1 for none.
        uplink: Uplink rate (U,) of each user, bit/s.
        server: Parameters of the servers.
        link_free: Time (U,) until which each uplink is busy, s; modified.
        arrived: Number (N,) of tasks from users assigned to each drone; modified.
        order: Indices of the tasks that reach a server, sorted by arrival time; overwritten.
        arrival: Arrival times of these tasks, s; overwritten.

    Returns:
        The number of tasks that reach a server.
    """
    count = 0
    seconds_per_bit = server.cycles_per_bit / server.core_frequency
    for k in range(tasks.first[w], tasks.first[w + 1]):
        # Users without a drone do not transmit
        user = tasks.user[k]
        if assignment[user] < 0:
            continue
        arrived[assignment[user]] += 1
        # Counted as arrived, and later as lost
        if uplink[user] <= 0.0:
            continue
        # Skip an upload if even an idle core could not complete the task in time
        end = max(tasks.time[k], link_free[user]) + tasks.bits[k] / uplink[user]
        if end + tasks.bits[k] * seconds_per_bit > tasks.time[k] + server.deadline:
            continue
        link_free[user] = end
        # Insertion sort by arrival time
        place = count
        while place > 0 and arrival[place - 1] > end:
            order[place] = order[place - 1]
            arrival[place] = arrival[place - 1]
            place -= 1
        order[place] = k
        arrival[place] = end
        count += 1
    return count


@allocating
def serve_steady_state(
    tasks: Tasks,
    assignment: np.ndarray,
    uplink: np.ndarray,
    drones: int,
    cycles_per_bit: float,
    cores: int,
    arrival_rate: float,
    service_rate: float,
    deadline: float,
    dt: float,
) -> Served:
    """Serve the tasks of one decision with steady-state response times.

    The wait is that of the M/M/c queue in steady state under the offered load of a drone's users,
    see `queueing`. Unlike in `serve_tasks`, tasks do not wait for uploads of the same user, and
    nothing is carried over. If the queue is unstable, no task completes, and the backlog is inf.

    Args:
        tasks: Tasks of the decision.
        assignment: Serving drone (W, U) of each user, -1 for none.
        uplink: Uplink rate (W, U) of each user, bit/s.
        drones: Number N of drones.
        cycles_per_bit: Cycles per bit of a task.
        cores: Number of cores of each drone.
        arrival_rate: Arrival rate of each user, 1/s.
        service_rate: Service rate of each core, 1/s.
        deadline: Time from generation within which a task must be completed, s; may be inf.
        dt: Length of the decision, s.

    Returns:
        Results of the tasks; `busy` is the mean, at most the total core time.
    """
    served = _new_served(tasks, drones)
    response = np.empty(drones)
    lost_latency = deadline if deadline < np.inf else 0.0
    for w in range(len(served.generated)):
        # Steady state of each drone under the offered load of its users
        for i in range(drones):
            users = 0
            for j in range(assignment.shape[1]):
                users += 1 if assignment[w, j] == i else 0
            offered = arrival_rate * users
            response[i] = mean_response(cores, offered, service_rate)
            served.busy[w, i] = min(offered / service_rate, cores) * dt
            # Little's law: number of tasks that arrive within a response time
            served.backlog[w, i] = offered * response[i] / (cores * service_rate)
        for k in range(tasks.first[w], tasks.first[w + 1]):
            i = assignment[w, tasks.user[k]]
            rate = uplink[w, tasks.user[k]]
            if i < 0:
                continue
            served.arrived[w, i] += 1
            latency = tasks.bits[k] / rate + response[i]
            if rate <= 0.0 or latency > deadline:
                served.latency[w, i] += lost_latency
                continue
            served.completed[w, i] += 1
            served.latency[w, i] += latency
            served.cycles[w, i] += tasks.bits[k] * cycles_per_bit
    return served
