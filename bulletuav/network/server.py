"""Edge servers on drones: tasks of users on the ground, their uploads, and queues of several cores, simulated task by task.

Unlike the formulas of `queueing`, this needs neither a steady state nor exponential sizes. Times are in s since the
decision began, and a decision takes `dt` s.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.errors import as_sequence, finite, numbers_of
from bulletuav.kernel import func, kernel
from bulletuav.network.queueing import mean_response


class Tasks(NamedTuple):
    """Tasks of one decision, K in all of W worlds.

    first  (W + 1,) those of world w are first[w] up to first[w + 1]
    user   (K,) whose it is, 0 up to U - 1
    time   (K,) when it was generated, s since the decision began; ascending in each world
    bits   (K,) its size
    """

    first: np.ndarray
    user: np.ndarray
    time: np.ndarray
    bits: np.ndarray


class Served(NamedTuple):
    """What became of the tasks of one decision; whether and when each completes is settled when it is generated.

    generated  (W,) number of tasks
    arrived    (W, N) of them, from users assigned to the drone
    completed  (W, N) of them, within the deadline
    latency    (W, N) sum over those that arrived, s: from generation to completion; a lost task counts as the deadline,
               as nothing where that is inf
    busy       (W, N) core-seconds in which cores worked in this decision
    backlog    (W, N) work left at its end, s per core, mean over the cores
    cycles     (W, N) of the tasks completed
    """

    generated: np.ndarray
    arrived: np.ndarray
    completed: np.ndarray
    latency: np.ndarray
    busy: np.ndarray
    backlog: np.ndarray
    cycles: np.ndarray


class Arrivals:
    """Poisson arrivals of tasks, decision by decision, with sizes uniform between two numbers.

    The users' processes are merged: a task is a user's with the chance of its share of the rate.
    """

    def __init__(self, rates: np.ndarray, dt: float, bits: tuple[float, float]):
        """Users generate `rates` (U,) tasks/s; decisions take `dt` s; `bits` are the least and the greatest size.

        Raises ValueError unless rates are at least 0, and dt and sizes above 0 in ascending order.
        """
        rates = numbers_of("rates are", rates)
        low, high = (finite("bits", value) for value in as_sequence("bits", bits, 2))
        if not 0 < low <= high:
            raise ValueError(
                f"bits are {bits!r}: (low, high) above 0 in ascending order are needed"
            )
        if not finite("dt", dt) > 0:
            raise ValueError(f"dt is {dt!r}: seconds above 0 are needed")
        if rates.ndim != 1 or not rates.size:
            raise ValueError(f"rates have shape {rates.shape}: (users,) is needed")
        if not (np.isfinite(rates) & (rates >= 0)).all():
            raise ValueError(
                f"rates are {rates!r}: finite numbers of tasks per second, at least 0, are needed"
            )
        self._cumulative, self._decision = np.cumsum(rates), (float(dt), low, high)
        self._mean = float(self._cumulative[-1] * dt)

    def draw(self, rng: Sequence[np.random.Generator | None], flying: np.ndarray) -> Tasks:
        """Those of one decision: worlds of `flying` (W,) draw, each from its own of W generators; the others have none."""
        counts, uniform = [0] * (len(flying) + 1), []
        for w in flying.nonzero()[0].tolist():
            generator = rng[w]
            assert generator is not None  # a world that flies was reset
            counts[w + 1] = count = generator.poisson(self._mean)
            if count:
                uniform.append(generator.random(3 * count + 1))
        first = np.array(list(itertools.accumulate(counts)))
        drawn = np.concatenate(uniform) if uniform else np.empty(0)
        return Tasks(first, *_spread(first, drawn, self._cumulative, *self._decision))


@kernel
def _spread(first, uniform, cumulative, dt, low, high):
    """User, time and bits (K,) of tasks, from 3 n + 1 uniform numbers of each world that has n > 0 of them.

    Times are sums of n + 1 exponential gaps, scaled to `dt`: n uniform times in ascending order without sorting
    (L. Devroye, Non-uniform random variate generation, 1986, chapter V).
    """
    user, time, bits = np.empty(first[-1], dtype=np.int64), np.empty(first[-1]), np.empty(first[-1])
    at = 0
    for w in range(len(first) - 1):
        begin, count = first[w], first[w + 1] - first[w]
        if count == 0:
            continue
        passed = 0.0
        for i in range(count):
            passed -= math.log1p(-uniform[at + i])
            time[begin + i] = passed
            share = uniform[at + count + i] * cumulative[-1]
            user[begin + i] = np.searchsorted(cumulative, share, side="right")
            bits[begin + i] = low + (high - low) * uniform[at + 2 * count + i]
        at += 3 * count + 1
        passed -= math.log1p(-uniform[at - 1])
        time[begin : begin + count] *= dt / passed
    return user, time, bits


@kernel
def serve(
    tasks, assignment, uplink, cycles_per_bit, core_frequency, deadline, dt, link_free, core_free
):
    """Simulate uploads and queues of one decision of `dt` s; returns `Served`.

    `tasks` of users with drones `assignment` (W, U), -1 for none, and uplinks of `uplink` (W, U) bit/s; cores do
    `core_frequency` cycles/s. `link_free` (W, U) and `core_free` (W, N, C), changed in place, say how long (s) uplinks and
    cores are still taken when the decision begins: give zeros first.

    A user sends its tasks one after the other in the order of their generation, at the rate of this decision. A drone
    serves them in the order of their arrival, each by the core that is free first. A task that would complete more than
    `deadline` s (may be inf) after its generation is lost, at no cost: a user does not begin an upload after which not even
    an idle core would be in time, and a server turns it away. Tasks of users without a drone or with rate 0 are lost at
    once and leave the link as it is.

    Tasks whose upload crosses the end of the decision are in line before all of the next. A core that will idle until they
    come does not keep that time for them: only work is carried over, so that no core's time is lost or counted twice.
    """
    worlds, drones, cores = core_free.shape
    shape, counts = (worlds, drones), tasks.first[1:] - tasks.first[:-1]
    arrived, completed = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    latency, busy, backlog, cycles = (
        np.zeros(shape),
        np.zeros(shape),
        np.zeros(shape),
        np.zeros(shape),
    )
    order, arrival = np.empty(counts.max(), dtype=np.int64), np.empty(counts.max())
    lost, pace = deadline if deadline < np.inf else 0.0, cycles_per_bit / core_frequency
    left = np.empty((drones, cores))
    for w in range(worlds):
        for n in range(drones):
            for c in range(cores):
                busy[w, n] += min(core_free[w, n, c], dt)
                left[n, c] = max(core_free[w, n, c] - dt, 0.0)
        for i in range(
            _upload(
                tasks,
                w,
                assignment[w],
                uplink[w],
                pace,
                deadline,
                link_free[w],
                arrived[w],
                order,
                arrival,
            )
        ):
            k = order[i]
            n, need = assignment[w, tasks.user[k]], tasks.bits[k] * cycles_per_bit
            c = _first_free(core_free[w, n])
            start = max(arrival[i], core_free[w, n, c])
            finish = start + need / core_frequency
            if finish > tasks.time[k] + deadline:
                continue
            busy[w, n] += max(min(finish, dt) - start, 0.0)
            left[n, c] += max(finish - max(start, dt), 0.0)
            core_free[w, n, c] = finish
            completed[w, n] += 1
            latency[w, n] += finish - tasks.time[k]
            cycles[w, n] += need
        for n in range(drones):
            latency[w, n] += lost * (arrived[w, n] - completed[w, n])
            for c in range(cores):
                core_free[w, n, c] = left[n, c]
                backlog[w, n] += left[n, c] / cores
        for user in range(link_free.shape[1]):
            link_free[w, user] = max(link_free[w, user] - dt, 0.0)
    return Served(counts, arrived, completed, latency, busy, backlog, cycles)


@func
def _first_free(core_free):
    """Which of the cores is free first; the first of those that are."""
    first = 0
    for c in range(1, len(core_free)):
        if core_free[c] < core_free[first]:
            first = c
    return first


@kernel
def _upload(
    tasks, w, assignment, uplink, seconds_per_bit, deadline, link_free, arrived, order, arrival
):
    """Send the tasks of world `w`: how many reach a server, with `order`, which, and `arrival`, when, in order of arrival.

    Equal times keep the order of generation. They are nearly in order when they come, so insertion sorts fast.
    """
    count = 0
    for k in range(tasks.first[w], tasks.first[w + 1]):
        user = tasks.user[k]
        if assignment[user] < 0:
            continue
        arrived[assignment[user]] += 1
        if uplink[user] <= 0.0:
            continue
        end = max(tasks.time[k], link_free[user]) + tasks.bits[k] / uplink[user]
        if end + tasks.bits[k] * seconds_per_bit > tasks.time[k] + deadline:
            continue
        link_free[user] = end
        place = count
        while place > 0 and arrival[place - 1] > end:
            order[place], arrival[place] = order[place - 1], arrival[place - 1]
            place -= 1
        order[place], arrival[place] = k, end
        count += 1
    return count


@kernel
def serve_on_average(
    tasks,
    assignment,
    uplink,
    drones,
    cycles_per_bit,
    cores,
    arrival_rate,
    service_rate,
    deadline,
    dt,
):
    """`Served` where tasks wait for as long as on average: the response of M/M/c to what the users of a drone offer.

    As `serve`, but nobody waits for a user's earlier tasks, and nothing is carried over. Each user generates `arrival_rate`
    tasks/s and each of the `cores` completes `service_rate` 1/s (see `queueing`); where these cannot keep up nothing
    completes, and the backlog is inf. `busy` is the mean, at most all cores all the time.
    """
    worlds = len(tasks.first) - 1
    shape, counts = (worlds, drones), tasks.first[1:] - tasks.first[:-1]
    arrived, completed = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    latency, busy, backlog, cycles = (
        np.zeros(shape),
        np.zeros(shape),
        np.zeros(shape),
        np.zeros(shape),
    )
    response, lost = np.empty(drones), deadline if deadline < np.inf else 0.0
    for w in range(worlds):
        for n in range(drones):
            offered = arrival_rate * (assignment[w] == n).sum()
            response[n] = mean_response(cores, offered, service_rate)
            busy[w, n] = min(offered / service_rate, cores) * dt
            backlog[w, n] = offered * response[n] / (cores * service_rate)  # Little's law
        for k in range(tasks.first[w], tasks.first[w + 1]):
            n, rate = assignment[w, tasks.user[k]], uplink[w, tasks.user[k]]
            if n < 0:
                continue
            arrived[w, n] += 1
            took = tasks.bits[k] / rate + response[n]
            if rate <= 0.0 or took > deadline:
                latency[w, n] += lost
                continue
            completed[w, n] += 1
            latency[w, n] += took
            cycles[w, n] += tasks.bits[k] * cycles_per_bit
    return Served(counts, arrived, completed, latency, busy, backlog, cycles)
