import numpy as np
import pytest
import sensing

from bulletuav.sensors.radio import MEMORY, Radio

PERIOD = 0.1


def line(t, drones=3):
    """Drones in a row, 10 m apart, all at 5 m/s along x: (N, 6) at time t."""
    known = np.zeros((drones, 6))
    known[:, 0], known[:, 1], known[:, 3] = 5 * t, 10 * np.arange(drones), 5.0
    return known


def radio_with(longest=0.0):
    return sensing.sensor_of(Radio, (1, 3), period=PERIOD, longest_delay=longest)


def hear(radio, known, rng, flying=(True, True, True)):
    """One decision later drones know (N, 6) of themselves, and are there."""
    swarm = sensing.swarm_of(1, 3, known[:, :3], known[:, 3:])
    sensing.measure(radio, swarm, mask=[flying], rngs=[rng])


def listen(radio, steps, rng, flying=(True, True, True)):
    sensing.start(radio, 0, sensing.swarm_of(1, 3, line(0)[:, :3], line(0)[:, 3:]), rng)
    for k in range(1, steps + 1):
        hear(radio, line(k * PERIOD), rng, flying)


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.05, 0.1, 0.23])
def test_what_is_heard_is_as_old_as_the_delay(delay):
    radio = radio_with(delay)
    radio.delay[:] = delay
    listen(radio, 20, np.random.default_rng(0))
    others = ~np.eye(3, dtype=bool)
    np.testing.assert_array_equal(radio.heard[0], others)
    np.testing.assert_allclose(radio.message[0][others][:, 0], 5 * (2.0 - delay), atol=1e-9)
    np.testing.assert_allclose(radio.message[0][others][:, 3], 5)
    np.testing.assert_array_equal(radio.received[0], 2)


def test_all_within_range_have_heard_of_each_other_at_the_start():
    radio = radio_with()
    radio.range[:], radio.loss[:] = 15.0, 1.0
    listen(radio, 0, np.random.default_rng(0))
    np.testing.assert_array_equal(radio.heard[0], [[0, 1, 0], [1, 0, 1], [0, 1, 0]])
    np.testing.assert_array_equal(radio.message[0, 0, 1], line(0)[1])


def test_messages_are_lost_as_often_as_asked_and_the_last_one_stays():
    radio = radio_with()
    radio.loss[:] = 0.3
    rng = np.random.default_rng(0)
    listen(radio, 0, rng)
    count = 0
    for k in range(1, 5001):
        before, known = radio.message.copy(), line(k * PERIOD)
        hear(radio, known, rng)
        count += radio.received.sum()
        unheard = (radio.message == before).all(axis=-1)[0] & ~np.eye(3, dtype=bool)
        assert unheard.sum() + radio.received.sum() == 6
    assert count / 30000 == pytest.approx(0.7, abs=0.01)


def test_who_was_not_heard_for_a_second_is_forgotten():
    radio = radio_with()
    listen(radio, 1, np.random.default_rng(0))
    radio.loss[:] = 1.0
    for k in range(1, 13):
        assert radio.heard[0].any() == ((k - 1) * PERIOD <= MEMORY + 1e-9)
        hear(radio, line(0), np.random.default_rng(0))


def test_who_has_landed_neither_speaks_nor_hears():
    radio = radio_with()
    listen(radio, 5, np.random.default_rng(0), (True, False, True))
    np.testing.assert_array_equal(radio.received[0], (1, 0, 1))
