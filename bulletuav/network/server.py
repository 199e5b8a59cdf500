"""Edge servers on drones: tasks of users, their uploads, and the queues of several cores.

Tasks, see `arrivals`, are simulated one by one. Unlike the formulas of `queueing`, this needs
neither a steady state nor exponential sizes. Times are in s since the decision began, and a
decision takes `dt` s.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.network.arrivals import Tasks
from bulletuav.network.queueing import mean_response


class Served(NamedTuple):
    """What became of the tasks of one decision.

    Whether and when a task completes is settled when it is generated.

    Attributes:
        generated: Number (W,) of tasks.
        arrived: Number (W, N) of tasks from users assigned to each drone.
        completed: Number (W, N) of these that complete within the deadline.
        latency: Sum (W, N) over the tasks that arrived of the time from generation to completion,
            s. A lost task counts as the deadline, and as nothing where that is inf.
        busy: Time (W, N) in which cores worked in this decision, core-seconds.
        backlog: Work (W, N) left at the end of the decision, s per core, mean over the cores.
        cycles: Cycles (W, N) of the tasks completed.
    """

    generated: np.ndarray
    arrived: np.ndarray
    completed: np.ndarray
    latency: np.ndarray
    busy: np.ndarray
    backlog: np.ndarray
    cycles: np.ndarray


class _Server(NamedTuple):
    """Numbers that the servers of all drones share in a decision.

    Attributes:
        cycles_per_bit: Cycles that a bit takes to compute.
        core_frequency: Frequency of a core, cycles/s.
        deadline: Time from generation within which a task must complete, s; may be inf.
        dt: Length of the decision, s.
    """

    cycles_per_bit: float
    core_frequency: float
    deadline: float
    dt: float


@allocating
def serve(
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

    A user sends its tasks one after the other in the order of their generation, at the rate of
    this decision. A drone serves them in the order of their arrival, each by the core that is free
    first.

    A task that would complete later than the deadline is lost, at no cost. A user does not begin an
    upload after which not even an idle core would be in time, and a server turns such a task away.
    Tasks of users without a drone or with rate 0 are lost at once and leave the link as it is.

    Tasks whose upload crosses the end of the decision are in line before all of the next. A core
    that will idle until they come does not keep that time for them. Only work is carried over, so
    that no core's time is lost or counted twice.

    Args:
        tasks: Tasks of the decision.
        assignment: Drone (W, U) of each user, -1 for none.
        uplink: Uplink rate (W, U) of each user, bit/s.
        cycles_per_bit: Cycles that a bit takes to compute.
        core_frequency: Frequency of a core, cycles/s.
        deadline: Time from generation within which a task must complete, s; may be inf.
        dt: Length of the decision, s.
        link_free: Time (W, U) for which uplinks are still taken when the decision begins, s;
            changed. Give zeros first.
        core_free: Time (W, N, C) for which cores are still taken when the decision begins, s;
            changed. Give zeros first.

    Returns:
        What became of the tasks.
    """
    worlds, drones, cores = core_free.shape
    served = _new_served(tasks, drones)
    server = _Server(cycles_per_bit, core_frequency, deadline, dt)
    # Buffers of one world: uploaded tasks, when they arrive, and work left of each core
    most = 0
    for w in range(worlds):
        most = max(most, served.generated[w])
    order = np.empty(most, dtype=np.int64)
    arrival = np.empty(most)
    remaining = np.empty((drones, cores))
    for w in range(worlds):
        link, core, taken = link_free[w], core_free[w], assignment[w]
        _go_on(core, dt, served.busy[w], remaining)
        arrived = served.arrived[w]
        count = _upload(tasks, w, taken, uplink[w], server, link, arrived, order, arrival)
        for k in range(count):
            task = order[k]
            i = taken[tasks.user[task]]
            _compute(tasks, task, arrival[k], server, core[i], remaining[i], served, w, i)
        _carry_over(server, core, link, remaining, served, w)
    return served


@func
def _go_on(core_free: np.ndarray, dt: float, busy: np.ndarray, remaining: np.ndarray) -> None:
    """Let the cores (N, C) of one world go on with the work of earlier decisions."""
    for i in range(core_free.shape[0]):
        for j in range(core_free.shape[1]):
            busy[i] += min(core_free[i, j], dt)
            remaining[i, j] = max(core_free[i, j] - dt, 0.0)


@func
def _compute(
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
    """Give a task that arrived to a core of drone i of world w, unless it would be late.

    Args:
        tasks: Tasks of the decision.
        task: Index of the task.
        arrival: When it arrives, s.
        server: Numbers of every drone's server.
        core_free: Time (C,) until which each core of the drone is taken, s; changed.
        remaining: Work (C,) that each leaves for the next decision, s; changed.
        served: What became of tasks; changed.
        w: Index of the world.
        i: Index of the drone.
    """
    work = tasks.bits[task] * server.cycles_per_bit
    # The core that is free first takes the task, unless it would be late
    j = _first_free(core_free)
    start = max(arrival, core_free[j])
    finish = start + work / server.core_frequency
    if finish > tasks.time[task] + server.deadline:
        return
    # Its time in this decision, and what is left for the next
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
    """Count the tasks that world w lost, and leave only work (N, C) to its next decision."""
    drones, cores = core_free.shape
    # A lost task waited until its deadline; without one nothing is lost
    lost_latency = server.deadline if server.deadline < np.inf else 0.0
    for i in range(drones):
        # Arrived and not completed in this decision
        lost = served.arrived[w, i] - served.completed[w, i]
        served.latency[w, i] += lost_latency * lost
        for j in range(cores):
            # Cores begin the next decision with the work that is left, s
            core_free[i, j] = remaining[i, j]
            served.backlog[w, i] += remaining[i, j] / cores
    # Links are busy for less, as time has gone by
    for j in range(len(link_free)):
        link_free[j] = max(link_free[j] - server.dt, 0.0)


@allocating
def _new_served(tasks: Tasks, drones: int) -> Served:
    """Return the result of a decision before anything is served."""
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
    """Return the index of the core that is free first, the first one where several are equal."""
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
    """Send the tasks of world w, and sort those that reach a server by the time of arrival.

    Equal times keep the order of generation. Tasks are nearly in order when they come, so insertion
    sorts fast.

    Args:
        tasks: Tasks of the decision.
        w: Index of the world.
        assignment: Drone (U,) of each user, -1 for none.
        uplink: Uplink rate (U,) of each user, bit/s.
        server: Numbers of every drone's server.
        link_free: Time (U,) until which each uplink is taken, s; changed.
        arrived: Number (N,) of tasks from users assigned to each drone; changed.
        order: Indices of the tasks that reach a server, in order of arrival; overwritten.
        arrival: Their times of arrival, s; overwritten.

    Returns:
        How many tasks reach a server.
    """
    count = 0
    seconds_per_bit = server.cycles_per_bit / server.core_frequency
    for k in range(tasks.first[w], tasks.first[w + 1]):
        # A user whom nobody serves sends nothing
        user = tasks.user[k]
        if assignment[user] < 0:
            continue
        arrived[assignment[user]] += 1
        # It counts as arrived at the server, and will count as lost
        if uplink[user] <= 0.0:
            continue
        # Begin no upload after which not even an idle core would be in time
        end = max(tasks.time[k], link_free[user]) + tasks.bits[k] / uplink[user]
        if end + tasks.bits[k] * seconds_per_bit > tasks.time[k] + server.deadline:
            continue
        link_free[user] = end
        # Insert the task where it belongs in the order of arrival
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
def serve_on_average(
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
    """Serve the tasks of one decision where they wait for as long as on average.

    The wait is that of the M/M/c queue in steady state, for what the users of a drone offer, see
    `queueing`. In contrast to `serve`, nobody waits for a user's earlier tasks, and nothing is
    carried over. Where the cores cannot keep up nothing completes, and the backlog is inf.

    Args:
        tasks: Tasks of the decision.
        assignment: Drone (W, U) of each user, -1 for none.
        uplink: Uplink rate (W, U) of each user, bit/s.
        drones: Number N of drones.
        cycles_per_bit: Cycles that a bit takes to compute.
        cores: Number of cores of each drone.
        arrival_rate: Tasks that each user generates, 1/s.
        service_rate: Tasks that each core completes, 1/s.
        deadline: Time from generation within which a task must complete, s; may be inf.
        dt: Length of the decision, s.

    Returns:
        What became of the tasks; `busy` is the mean, at most all cores all the time.
    """
    served = _new_served(tasks, drones)
    response = np.empty(drones)
    lost_latency = deadline if deadline < np.inf else 0.0
    for w in range(len(served.generated)):
        # Steady state of every drone under the load of its users
        for i in range(drones):
            users = 0
            for j in range(assignment.shape[1]):
                users += 1 if assignment[w, j] == i else 0
            offered = arrival_rate * users
            response[i] = mean_response(cores, offered, service_rate)
            served.busy[w, i] = min(offered / service_rate, cores) * dt
            # Little's law: as many tasks as arrive within a response
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
