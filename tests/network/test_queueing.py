import math

import numpy as np
import pytest
from scipy.stats import poisson

from bulletuav.compiled.kernel import kernel
from bulletuav.network.queueing import (
    compute_energy,
    core_power,
    empty_probability,
    erlang_b,
    erlang_c,
    mean_queue_length,
    mean_response,
    mean_wait,
    response_exceeds,
    service_rate,
    utilisation,
    wait_exceeds,
)

# rho, P0, Erlang B, Erlang C, Lq, Wq, W, rounded to nine decimals
TABLE = {
    (1, 0.5, 1): (0.5, 0.5, 0.333333333, 0.5, 0.5, 1.0, 2.0),
    (2, 1.5, 1): (
        0.75,
        0.142857143,
        0.310344828,
        0.642857143,
        1.928571429,
        1.285714286,
        2.285714286,
    ),
    (4, 3, 1): (0.75, 0.037735849, 0.206106870, 0.509433962, 1.528301887, 0.509433962, 1.509433962),
    (4, 3.9, 1): (
        0.975,
        0.002451191,
        0.300939290,
        0.945114164,
        36.859452404,
        9.451141642,
        10.451141642,
    ),
    (8, 6, 1): (0.75, 0.002142376, 0.121875784, 0.356981086, 1.070943258, 0.178490543, 1.178490543),
    (4, 5, 4): (
        0.3125,
        0.285328290,
        0.029413149,
        0.042218319,
        0.019190145,
        0.003838029,
        0.253838029,
    ),
    (4, 15, 4): (
        0.9375,
        0.006561411,
        0.286002407,
        0.865029731,
        12.975445971,
        0.865029731,
        1.115029731,
    ),
    (64, 60, 1): (0.9375, 0.0, 0.060362738, 0.506866271, 7.602994065, 0.126716568, 1.126716568),
}
TIMES = np.array([0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 20.0])


def stationary(servers, arrival_rate, service_rate, states=20000):
    """Chances of 0, 1, 2, ... tasks, from the balance of births and deaths."""
    n = np.arange(1, states)
    growth = np.cumsum(np.log(arrival_rate / (np.minimum(n, servers) * service_rate)))
    weights = np.exp(np.concatenate([[0.0], growth]) - growth.max())
    return weights / weights.sum()


@pytest.mark.parametrize("queue", TABLE)
def test_steady_state(queue):
    servers, arrival_rate, rate = queue
    load = arrival_rate / rate
    found = (
        utilisation(*queue),
        empty_probability(*queue),
        erlang_b(servers, load),
        erlang_c(servers, load),
        mean_queue_length(*queue),
        mean_wait(*queue),
        mean_response(*queue),
    )
    assert found == pytest.approx(TABLE[queue], abs=5.01e-10, rel=0)


def test_exact_fractions():
    assert erlang_c(4, 3.0) == pytest.approx(27 / 53, rel=1e-15)
    assert empty_probability(4, 3.0, 1.0) == pytest.approx(2 / 53, rel=1e-15)


@pytest.mark.parametrize(
    ("function", "queue", "time", "digits"),
    [
        (wait_exceeds, (4, 3, 1), 0.5, "0.308987"),
        (wait_exceeds, (4, 3, 1), 1.0, "0.18741"),
        (wait_exceeds, (4, 3, 1), 2.0, "0.0689444"),
        (response_exceeds, (4, 3, 1), 0.5, "0.761024"),
        (response_exceeds, (4, 3, 1), 1.0, "0.55529"),
        (response_exceeds, (4, 3, 1), 2.0, "0.273224"),
        (response_exceeds, (4, 3, 1), 4.0, "0.0556381"),
        (response_exceeds, (4, 5, 4), 1.0, "0.0187571"),
    ],
)
def test_chances_of_being_late(function, queue, time, digits):
    assert f"{function(*queue, time):.6g}" == digits


@pytest.mark.parametrize("queue", TABLE)
def test_births_and_deaths_balance(queue):
    servers, arrival_rate, _ = queue
    chance = stationary(*queue)
    n = np.arange(len(chance))
    assert empty_probability(*queue) == pytest.approx(chance[0], rel=1e-9)
    assert wait_exceeds(*queue, 0.0) == pytest.approx(chance[servers:].sum(), rel=1e-9)
    assert mean_queue_length(*queue) == pytest.approx(
        (np.maximum(n - servers, 0) * chance).sum(), rel=1e-9
    )
    assert arrival_rate * mean_response(*queue) == pytest.approx(
        (n * chance).sum(), rel=1e-9
    )  # Little's law


@pytest.mark.parametrize("queue", [(1, 0.5, 1.0), (4, 3.0, 1.0), (4, 5.0, 4.0), (64, 60.0, 1.0)])
def test_chances_integrate_to_the_means(queue):
    slowest = min(queue[2], queue[0] * queue[2] - queue[1])
    time, step = np.linspace(0, 40 / slowest, 400001, retstep=True)
    for function, mean in ((wait_exceeds, mean_wait), (response_exceeds, mean_response)):
        chance = function(*queue, time)
        assert (np.diff(chance) < 0).all()
        assert np.trapezoid(chance, dx=step) == pytest.approx(mean(*queue), rel=1e-6)


def test_one_server():
    arrival_rate, rate = 0.7, 1.3
    spare = rate - arrival_rate
    assert erlang_c(1, arrival_rate / rate) == pytest.approx(arrival_rate / rate, rel=1e-15)
    assert empty_probability(1, arrival_rate, rate) == pytest.approx(spare / rate, rel=1e-15)
    assert mean_response(1, arrival_rate, rate) == pytest.approx(1 / spare, rel=1e-14)
    np.testing.assert_allclose(
        response_exceeds(1, arrival_rate, rate, TIMES), np.exp(-spare * TIMES), rtol=1e-13
    )


def test_without_arrivals_only_the_service_takes_time():
    assert (
        erlang_b(4, 0.0),
        erlang_c(4, 0.0),
        mean_wait(4, 0.0, 2.0),
        mean_queue_length(4, 0.0, 2.0),
    ) == (0, 0, 0, 0)
    assert (
        empty_probability(4, 0.0, 2.0),
        mean_response(4, 0.0, 2.0),
        utilisation(4, 0.0, 2.0),
    ) == (1, 0.5, 0)
    np.testing.assert_allclose(
        response_exceeds(4, 0.0, 2.0, TIMES), np.exp(-2.0 * TIMES), rtol=1e-15
    )


def test_full_load_is_approached_and_has_no_steady_state():
    arrival_rate = 4 - 4 * np.array([1e-2, 1e-4, 1e-6])
    assert 1 - erlang_c(4, arrival_rate) == pytest.approx(0, abs=0.03)
    assert (np.diff(erlang_c(4, arrival_rate)) > 0).all()
    assert (4 - arrival_rate[-1]) * mean_wait(4, arrival_rate[-1], 1.0) == pytest.approx(
        1, rel=1e-5
    )
    for arrival_rate in (4.0, 4.1, 100.0):
        queue = (4, arrival_rate, 1.0)
        assert mean_wait(*queue) == mean_response(*queue) == mean_queue_length(*queue) == math.inf
        assert (
            erlang_c(4, arrival_rate)
            == wait_exceeds(*queue, 9.0)
            == response_exceeds(*queue, math.inf)
            == 1
        )
        assert empty_probability(*queue) == 0


@pytest.mark.parametrize(("servers", "load"), [(1000, 900.0), (20000, 19900.0), (1000, 1.0)])
def test_many_servers_stay_exact(servers, load):
    expected = math.exp(poisson.logpmf(servers, load) - poisson.logcdf(servers, load))
    assert erlang_b(servers, load) == pytest.approx(expected, rel=1e-9)
    assert 0 <= erlang_c(servers, load) < 1
    assert empty_probability(servers, load, 1.0) == pytest.approx(
        math.exp(-load), rel=1e-3, abs=1e-300
    )
    assert math.isfinite(mean_response(servers, load, 1.0))


def test_late_chances_meet_where_both_rates_are_equal():
    near = response_exceeds(
        4, 3.0 + np.array([-1e-3, -1e-7, -1e-12, 0.0, 1e-12, 1e-7, 1e-3]), 1.0, 2.0
    )
    assert (np.diff(near) >= 0).all()
    assert near == pytest.approx(near[3], rel=2e-3)
    assert near[[1, 2, 4, 5]] == pytest.approx(near[3], rel=2e-7)
    assert response_exceeds(4, 3.0, 1.0, TIMES[0]) == 1
    assert response_exceeds([4, 1, 200], [3.0, 0.9, 10.0], 1.0, math.inf).tolist() == [0, 0, 0]
    assert response_exceeds([1, 200], [0.999, 10.0], 1.0, 5e3) == pytest.approx(
        [math.exp(-5), 0], rel=1e-12, abs=1e-300
    )


@pytest.mark.parametrize("arrival_rate", [0.4, 2.9995, 3.0005, 3.7])
def test_late_chances_are_those_of_two_exponentials(arrival_rate):
    spare, waiting = 4 - arrival_rate, erlang_c(4, arrival_rate)
    expected = np.exp(-TIMES) + waiting / (spare - 1) * (np.exp(-TIMES) - np.exp(-spare * TIMES))
    np.testing.assert_allclose(response_exceeds(4, arrival_rate, 1.0, TIMES), expected, rtol=1e-10)


def test_units_of_time_do_not_matter():
    assert 60 * mean_wait(4, 60 * 3.0, 60.0) == pytest.approx(mean_wait(4, 3.0, 1.0), rel=1e-14)
    assert response_exceeds(4, 60 * 3.9, 60.0, 0.5) == pytest.approx(
        response_exceeds(4, 3.9, 1.0, 30.0), rel=1e-13
    )


def test_a_faster_or_larger_server_waits_less():
    servers, rate = np.arange(1, 33)[:, None], np.linspace(1.0, 5.0, 9)
    wait = mean_wait(servers, 0.9, rate)
    assert wait.shape == (32, 9)
    assert (np.diff(wait, axis=0) < 0).all()
    assert (np.diff(wait, axis=1) < 0).all()
    assert (
        mean_wait(1, 3.0, 4.0) < mean_wait(4, 3.0, 1.0) + 3 / 4
    )  # one fast server answers before four slow ones


def test_kernels_call_them():
    @kernel
    def longest(servers, arrival_rate, rate):
        worst = 0.0
        for k in range(servers.shape[0]):
            worst = max(worst, mean_response(servers[k], arrival_rate, rate))
        return worst

    assert longest(np.array([4, 5, 8]), 3.0, 1.0) == mean_response(4, 3.0, 1.0)


def test_computing_in_numbers():
    assert service_rate(5e9, 1.25e6, 1000) == pytest.approx(4, rel=1e-15)
    assert service_rate(2e9, 1.25e6, 800) == pytest.approx(2, rel=1e-15)
    assert compute_energy(1e-28, 5e9, 1.25e9) == pytest.approx(3.125, rel=1e-14)
    assert core_power(1e-28, 5e9) == pytest.approx(12.5, rel=1e-14)
    assert 4 * core_power(1e-28, 5_000_000_000) == pytest.approx(
        50, rel=1e-14
    )  # whole numbers do not overflow


def test_energy_is_power_over_the_time_of_the_work():
    frequency, cycles = np.array([1e9, 2e9, 7e9]), 3e9
    np.testing.assert_allclose(
        compute_energy(2e-28, frequency, cycles), core_power(2e-28, frequency) * cycles / frequency
    )


def test_latency_of_a_task_end_to_end():
    upload = 1.25e6 / 74.0618e6
    assert upload == pytest.approx(16.8778e-3, abs=5e-8)
    latency = upload + mean_response(4, 5.0, service_rate(5e9, 1.25e6, 1000.0))
    assert latency == pytest.approx(0.2707158, abs=5.1e-8)


def test_a_setting_that_can_meet_its_deadline():
    rate = service_rate(10e9, 1.25e6, 800.0)
    assert rate == pytest.approx(10)
    assert utilisation(4, 25 / 3, rate) == pytest.approx(0.208, abs=5e-4)
    assert mean_response(4, 25 / 3, rate) == pytest.approx(0.1003, abs=5e-5)
