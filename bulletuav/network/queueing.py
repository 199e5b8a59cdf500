"""Steady-state M/M/c queue of an edge server, and the energy of computing.

Tasks arrive by a Poisson process and wait in one queue for c servers (the cores of a drone) with
exponential service times.

All functions accept numbers or arrays that broadcast, and can be called from kernels. Their
arguments are:

- `servers`: number c of servers, integer, at least 1;
- `arrival_rate`: arrival rate lambda of tasks, 1/s;
- `service_rate`: service rate mu of each server, 1/s, positive;
- `load`: offered load a = lambda / mu, Erlang;
- `time`: a time t, s.

For lambda >= c mu there is no steady state, and waiting times are inf.

References:
    A. K. Erlang, Solution of some problems in the theory of probabilities of significance in
    automatic telephone exchanges, 1917; L. Kleinrock, Queueing Systems, volume 1 (1975), chapter 3.
"""

import math

from bulletuav.compiled.functions import exp, expm1
from bulletuav.compiled.kernel import elementwise


@elementwise
def utilisation(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the utilisation of the servers, rho = lambda / (c mu).

    The queue is stable below 1.
    """
    return arrival_rate / (servers * service_rate)


@elementwise
def erlang_b(servers: float, load: float) -> float:
    """Return the blocking probability of a system without a queue.

    Erlang's loss formula (1917), by the recursion B_k = a B_{k-1} / (k + a B_{k-1}). The recursion
    needs no factorials, so the number of servers is not limited.
    """
    # B_0 = 1: with no servers every task is blocked
    taken = 1.0
    for k in range(1, int(servers) + 1):
        taken = load * taken / (k + load * taken)
    return taken


@elementwise
def erlang_c(servers: float, load: float) -> float:
    """Return the probability that a task has to wait; 1 for a >= c.

    Erlang's delay formula (1917): B_c / (1 - rho (1 - B_c)).
    """
    if load >= servers:
        return 1.0
    taken = erlang_b(servers, load)
    return taken / (1.0 - load / servers * (1.0 - taken))


@elementwise
def empty_probability(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the probability P0 of an empty system; 0 for lambda >= c mu.

    Kleinrock 1975, section 3.5. P0 is that of the system without a queue, times (1 - rho) / (1 -
    rho (1 - B_c)). The former follows from the recursion of Erlang B, whose terms do not overflow,
    unlike a^k / k!.
    """
    if arrival_rate >= servers * service_rate:
        return 0.0
    load = arrival_rate / service_rate
    # Recursion over servers: `empty` is P0 of the system without a queue, `taken` is B_k
    empty = 1.0
    taken = 1.0
    for k in range(1, int(servers) + 1):
        empty *= k / (k + load * taken)
        taken = load * taken / (k + load * taken)
    # Add the queue
    share = load / servers
    return empty * (1.0 - share) / (1.0 - share * (1.0 - taken))


@elementwise
def mean_wait(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean waiting time Wq, s; inf for lambda >= c mu.

    It is C / (c mu - lambda), with Erlang's C (Kleinrock 1975, section 3.5).
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return math.inf
    return erlang_c(servers, arrival_rate / service_rate) / spare


@elementwise
def mean_response(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean response time W from arrival to completion, s; inf for lambda >= c mu.

    It is the sum of waiting and service time, Wq + 1 / mu.
    """
    return mean_wait(servers, arrival_rate, service_rate) + 1.0 / service_rate


@elementwise
def mean_queue_length(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean number Lq of waiting tasks; inf for lambda >= c mu.

    Little's law, Lq = lambda Wq (J. D. C. Little, Operations Research 9(3), 1961).
    """
    return arrival_rate * mean_wait(servers, arrival_rate, service_rate)


@elementwise
def wait_exceeds(servers: float, arrival_rate: float, service_rate: float, time: float) -> float:
    """Return the probability P(Wq > t) that the wait exceeds t >= 0; 1 for lambda >= c mu.

    The probability is C e^-(c mu - lambda) t: the wait of tasks that have to wait is exponentially
    distributed.

    References:
        D. Gross, J. F. Shortle, J. M. Thompson, C. M. Harris, Fundamentals of Queueing Theory, 4th
        edition 2008, section 2.3.
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    return erlang_c(servers, arrival_rate / service_rate) * exp(-spare * time)


@elementwise
def response_exceeds(
    servers: float, arrival_rate: float, service_rate: float, time: float
) -> float:
    """Return the probability P(T > t) that the response time exceeds a time t >= 0.

    It is 1 for lambda >= c mu. The wait of `wait_exceeds` is convolved with an exponential service
    time: e^-mu t + C mu (e^-mu t - e^-s t) / (s - mu) with s = c mu - lambda. The quotient is
    computed as e^-(slower) t (1 - e^-g t) / g with g = |s - mu|, whose limit at g = 0 is t.
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    if time == math.inf:
        return 0.0
    # Quotient without cancellation for similar rates
    gap = abs(spare - service_rate)
    quotient = -expm1(-gap * time) / gap if gap > 0.0 else time
    # Tasks that do not wait, and tasks that wait
    waiting = erlang_c(servers, arrival_rate / service_rate)
    slower = min(spare, service_rate)
    served_late = exp(-service_rate * time)
    return served_late + waiting * service_rate * exp(-slower * time) * quotient


@elementwise
def service_rate(core_frequency: float, bits: float, cycles_per_bit: float) -> float:
    """Return the service rate of one core, 1/s (Mao et al. 2017, section II).

    Args:
        core_frequency: Clock frequency of the core, cycles/s.
        bits: Size of a task, bit.
        cycles_per_bit: Cycles per bit of a task.
    """
    return core_frequency / (bits * cycles_per_bit)


@elementwise
def core_power(kappa: float, core_frequency: float) -> float:
    """Return the power of one active core, kappa f^3, W.

    Args:
        kappa: Effective switched capacitance, W s^3.
        core_frequency: Frequency f of the core, cycles/s; not the sum over cores, as the power is
            not linear in f.

    References:
        Y. Mao, C. You, J. Zhang, K. Huang, K. B. Letaief, A survey on mobile edge computing, IEEE
        Communications Surveys & Tutorials 19(4), 2017, section II.
    """
    return kappa * core_frequency * core_frequency * core_frequency


@elementwise
def compute_energy(kappa: float, core_frequency: float, cycles: float) -> float:
    """Return the energy of a computation, kappa f^2 cycles, J (Mao et al. 2017, section II).

    Args:
        kappa: Effective switched capacitance, W s^3.
        core_frequency: Frequency f of the core, cycles/s.
        cycles: Number of computed cycles.
    """
    return kappa * core_frequency * core_frequency * cycles
