"""The M/M/c queue of an edge server in steady state, and what computing costs.

Tasks arrive by a Poisson process and wait in one line for c servers (the cores of a drone), whose
service times are exponential. Sources: A. K. Erlang, Solution of some problems in the theory of
probabilities of significance in automatic telephone exchanges, 1917; L. Kleinrock, Queueing
Systems, volume 1 (1975), chapter 3.

All functions take numbers, or arrays that broadcast; kernels call them too. Their arguments are:

- `servers`: number c of servers, whole, at least 1;
- `arrival_rate`: arrival rate lambda of tasks, 1/s;
- `service_rate`: tasks mu that each server completes per second, 1/s, above 0;
- `load`: offered load a = lambda / mu, in servers (Erlang);
- `time`: a time t, s.

From lambda = c mu on there is no steady state: waits are inf, never a large number.
"""

import math

from bulletuav.compiled.functions import exp, expm1
from bulletuav.compiled.kernel import elementwise


@elementwise
def utilisation(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the share of the servers' time that is asked for: rho = lambda / (c mu).

    The queue is stable below 1.
    """
    return arrival_rate / (servers * service_rate)


@elementwise
def erlang_b(servers: float, load: float) -> float:
    """Return the probability that all servers are taken where nobody waits.

    Erlang's loss formula (1917), by the recursion B_k = a B_{k-1} / (k + a B_{k-1}). It has no
    factorials, so any number of servers will do.
    """
    # B_0 = 1: without servers every task is blocked
    taken = 1.0
    for k in range(1, int(servers) + 1):
        taken = load * taken / (k + load * taken)
    return taken


@elementwise
def erlang_c(servers: float, load: float) -> float:
    """Return the probability that a task has to wait; 1 where a >= c.

    Erlang's delay formula (1917): B_c / (1 - rho (1 - B_c)).
    """
    if load >= servers:
        return 1.0
    taken = erlang_b(servers, load)
    return taken / (1.0 - load / servers * (1.0 - taken))


@elementwise
def empty_probability(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the probability P0 that there is no task; 0 where lambda >= c mu.

    Kleinrock 1975, section 3.5. It is that of the system where nobody waits, times
    (1 - rho) / (1 - rho (1 - B_c)). The former comes from the recursion of Erlang B, whose terms
    cannot overflow as a^k / k! do.
    """
    if arrival_rate >= servers * service_rate:
        return 0.0
    load = arrival_rate / service_rate
    # Add one server after the other: `empty` is P0 where nobody waits, `taken` is B_k
    empty = 1.0
    taken = 1.0
    for k in range(1, int(servers) + 1):
        empty *= k / (k + load * taken)
        taken = load * taken / (k + load * taken)
    # Let tasks wait
    share = load / servers
    return empty * (1.0 - share) / (1.0 - share * (1.0 - taken))


@elementwise
def mean_wait(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean time Wq in the line, s; inf where lambda >= c mu.

    It is C / (c mu - lambda), with Erlang's C (Kleinrock 1975, section 3.5).
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return math.inf
    return erlang_c(servers, arrival_rate / service_rate) / spare


@elementwise
def mean_response(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean time W from arrival to completion, s; inf where lambda >= c mu.

    It is the wait and the service, Wq + 1 / mu.
    """
    return mean_wait(servers, arrival_rate, service_rate) + 1.0 / service_rate


@elementwise
def mean_queue_length(servers: float, arrival_rate: float, service_rate: float) -> float:
    """Return the mean number Lq of tasks that wait; inf where lambda >= c mu.

    Little's law, Lq = lambda Wq (J. D. C. Little, Operations Research 9(3), 1961).
    """
    return arrival_rate * mean_wait(servers, arrival_rate, service_rate)


@elementwise
def wait_exceeds(servers: float, arrival_rate: float, service_rate: float, time: float) -> float:
    """Return the probability P(Wq > t) of a longer wait than a time t >= 0; 1 where lambda >= c mu.

    C e^-(c mu - lambda) t: who waits at all waits for an exponential time (D. Gross,
    J. F. Shortle, J. M. Thompson, C. M. Harris, Fundamentals of Queueing Theory, 4th edition 2008,
    section 2.3).
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    return erlang_c(servers, arrival_rate / service_rate) * exp(-spare * time)


@elementwise
def response_exceeds(
    servers: float, arrival_rate: float, service_rate: float, time: float
) -> float:
    """Return the probability P(T > t) that wait and service take longer than a time t >= 0.

    It is 1 where lambda >= c mu. The wait of `wait_exceeds` is convolved with an exponential
    service: e^-mu t + C mu (e^-mu t - e^-s t) / (s - mu) with s = c mu - lambda. The quotient is
    taken as e^-(slower) t (1 - e^-g t) / g with g = |s - mu|, whose limit at g = 0 is t.
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    if time == math.inf:
        return 0.0
    # Quotient without cancellation where both rates are close
    gap = abs(spare - service_rate)
    quotient = -expm1(-gap * time) / gap if gap > 0.0 else time
    # Who does not wait, and who waits
    waiting = erlang_c(servers, arrival_rate / service_rate)
    slower = min(spare, service_rate)
    served_late = exp(-service_rate * time)
    return served_late + waiting * service_rate * exp(-slower * time) * quotient


@elementwise
def service_rate(core_frequency: float, bits: float, cycles_per_bit: float) -> float:
    """Return how many tasks one core completes per second, 1/s (Mao et al. 2017, section II).

    Args:
        core_frequency: Clock frequency of the core, cycles/s.
        bits: Size of a task, bit.
        cycles_per_bit: Cycles that a bit takes to compute.
    """
    return core_frequency / (bits * cycles_per_bit)


@elementwise
def core_power(kappa: float, core_frequency: float) -> float:
    """Return the power of one core at work, W: kappa f^3.

    Y. Mao, C. You, J. Zhang, K. Huang, K. B. Letaief, A survey on mobile edge computing, IEEE
    Communications Surveys & Tutorials 19(4), 2017, section II.

    Args:
        kappa: Effective switched capacitance, W s^3.
        core_frequency: Frequency f of the core, cycles/s. It is not that of all cores together:
            the cube does not add up.
    """
    return kappa * core_frequency * core_frequency * core_frequency


@elementwise
def compute_energy(kappa: float, core_frequency: float, cycles: float) -> float:
    """Return the energy of computing, J: kappa f^2 cycles (Mao et al. 2017, section II).

    Args:
        kappa: Effective switched capacitance, W s^3.
        core_frequency: Frequency f of the core, cycles/s.
        cycles: Cycles that are computed.
    """
    return kappa * core_frequency * core_frequency * cycles
