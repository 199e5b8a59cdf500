"""The M/M/c queue of an edge server in steady state, and what computing costs.

Tasks come by a Poisson process of `arrival_rate` lambda (1/s) and wait in one line for `servers` c (whole, at least 1), of
which each completes `service_rate` mu (1/s, above 0), with exponential times of service. A. K. Erlang, Solution of some
problems in the theory of probabilities of significance in automatic telephone exchanges, 1917; L. Kleinrock, Queueing
Systems, volume 1 (1975), chapter 3. From lambda = c mu on there is no steady state: waits are inf, never a large number.
"""

import math

from bulletuav.kernel import elementwise


@elementwise
def utilisation(servers, arrival_rate, service_rate):
    """Share of the servers' time that is asked for, rho = lambda / (c mu); the queue is stable below 1."""
    return arrival_rate / (servers * service_rate)


@elementwise
def erlang_b(servers, load):
    """Chance that all of c servers are taken where nobody waits, at a `load` a = lambda / mu.

    Erlang's loss formula (1917) by the recursion B_k = a B_{k-1} / (k + a B_{k-1}): no factorials, so any c will do.
    """
    taken = 1.0
    for k in range(1, int(servers) + 1):
        taken = load * taken / (k + load * taken)
    return taken


@elementwise
def erlang_c(servers, load):
    """Chance that a task has to wait, at a `load` a = lambda / mu; 1 where a >= c.

    Erlang's delay formula (1917): B_c / (1 - rho (1 - B_c)).
    """
    if load >= servers:
        return 1.0
    taken = erlang_b(servers, load)
    return taken / (1.0 - load / servers * (1.0 - taken))


@elementwise
def empty_probability(servers, arrival_rate, service_rate):
    """Chance P0 that no task is there; 0 where lambda >= c mu (Kleinrock 1975, section 3.5).

    That of the system where nobody waits, by the recursion of Erlang B, whose terms cannot overflow as a^k / k! do, times
    (1 - rho) / (1 - rho (1 - B_c)).
    """
    if arrival_rate >= servers * service_rate:
        return 0.0
    load = arrival_rate / service_rate
    empty, taken = 1.0, 1.0
    for k in range(1, int(servers) + 1):
        empty *= k / (k + load * taken)
        taken = load * taken / (k + load * taken)
    share = load / servers
    return empty * (1.0 - share) / (1.0 - share * (1.0 - taken))


@elementwise
def mean_wait(servers, arrival_rate, service_rate):
    """Mean time Wq in the line, s: C / (c mu - lambda) (Kleinrock 1975, section 3.5); inf where lambda >= c mu."""
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return math.inf
    return erlang_c(servers, arrival_rate / service_rate) / spare


@elementwise
def mean_response(servers, arrival_rate, service_rate):
    """Mean time W from arrival to completion, s: wait and service, Wq + 1 / mu; inf where lambda >= c mu."""
    return mean_wait(servers, arrival_rate, service_rate) + 1.0 / service_rate


@elementwise
def mean_queue_length(servers, arrival_rate, service_rate):
    """Mean number Lq of tasks that wait, lambda Wq (J. D. C. Little, Operations Research 9(3), 1961)."""
    return arrival_rate * mean_wait(servers, arrival_rate, service_rate)


@elementwise
def wait_exceeds(servers, arrival_rate, service_rate, time):
    """P(Wq > t), the chance of a wait above `time` s, at least 0; 1 where lambda >= c mu.

    C e^-(c mu - lambda) t: who waits at all waits for an exponential time (D. Gross, J. F. Shortle, J. M. Thompson,
    C. M. Harris, Fundamentals of Queueing Theory, 4th edition 2008, section 2.3).
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    return erlang_c(servers, arrival_rate / service_rate) * math.exp(-spare * time)


@elementwise
def response_exceeds(servers, arrival_rate, service_rate, time):
    """P(T > t), the chance that wait and service take more than `time` s, at least 0; 1 where lambda >= c mu.

    The wait of `wait_exceeds` plus an exponential service, convolved: e^-mu t + C mu (e^-mu t - e^-s t) / (s - mu) with
    s = c mu - lambda. The quotient is taken as e^-(slower) t (1 - e^-g t) / g, g = |s - mu|: its limit at g = 0 is t.
    """
    spare = servers * service_rate - arrival_rate
    if spare <= 0.0:
        return 1.0
    if time == math.inf:
        return 0.0
    gap = abs(spare - service_rate)
    span = -math.expm1(-gap * time) / gap if gap > 0.0 else time
    waiting = erlang_c(servers, arrival_rate / service_rate)
    return (
        math.exp(-service_rate * time)
        + waiting * service_rate * math.exp(-min(spare, service_rate) * time) * span
    )


@elementwise
def service_rate(core_frequency, bits, cycles_per_bit):
    """Tasks of `bits` that one core of `core_frequency` cycles/s completes per second (Mao et al. 2017, section II)."""
    return core_frequency / (bits * cycles_per_bit)


@elementwise
def core_power(kappa, core_frequency):
    """Power of one core at work, W: kappa f^3, at f cycles/s, with the effective switched capacitance kappa (W s^3).

    Y. Mao, C. You, J. Zhang, K. Huang, K. B. Letaief, A survey on mobile edge computing, IEEE Communications Surveys &
    Tutorials 19(4), 2017, section II. f is that of the core, not of all cores together: the cube does not add up.
    """
    return kappa * core_frequency * core_frequency * core_frequency


@elementwise
def compute_energy(kappa, core_frequency, cycles):
    """Energy of `cycles` on cores of f cycles/s, J: kappa f^2 cycles (Mao et al. 2017, section II)."""
    return kappa * core_frequency * core_frequency * cycles
