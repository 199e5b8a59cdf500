"""Loops in real time, by a clock that only moves when somebody works or sleeps."""

import time

import numpy as np
import pytest

from bulletuav.envs.pacer import Pacer


class Clock:
    """A clock that stands still but for `work` and `sleep`."""

    def __init__(self, start=1000.0):
        self.now = start
        self.oversleeps = 0.0

    def read(self):
        return self.now

    def work(self, seconds):
        self.now += seconds

    def sleep(self, seconds):
        assert seconds >= 0
        self.now += seconds + self.oversleeps


def paced(clock, period, speed=1.0):
    return Pacer(period, speed, _clock=clock.read, _sleep=clock.sleep)


@pytest.mark.parametrize(("period", "speed", "turn"), [(0.1, 1, 0.1), (0.1, 4, 0.025), (2, 0.5, 4)])
def test_turns_that_are_on_time_end_at_their_deadlines(period, speed, turn):
    clock = Clock(0.0)
    pacer = paced(clock, period, speed)
    rng = np.random.default_rng(0)
    for k in range(1, 1001):
        clock.work(rng.uniform(0, 0.99 * turn))
        assert pacer.wait() == 0
        assert clock.now == pytest.approx(k * turn, rel=1e-12)
    assert (pacer.late, pacer.latest) == (0, 0.0)
    assert (pacer.period, pacer.speed) == (period, speed)


def test_a_missed_deadline_does_not_shift_later_ones():
    clock = Clock(0.0)
    pacer = paced(clock, 0.1)
    clock.work(0.25)
    assert pacer.wait() == pytest.approx(0.15)
    assert clock.now == 0.25
    assert pacer.wait() == pytest.approx(0.05)
    assert pacer.wait() == 0
    assert clock.now == pytest.approx(0.3)
    assert pacer.wait() == 0
    assert clock.now == pytest.approx(0.4)
    assert pacer.late == 2
    assert pacer.latest == pytest.approx(0.15)


def test_being_called_at_the_deadline_is_on_time():
    clock = Clock(0.0)
    pacer = paced(clock, 0.5)
    clock.work(0.5)
    assert pacer.wait() == 0
    assert (clock.now, pacer.late) == (0.5, 0)


def test_sleeping_too_long_is_made_good():
    """The deadline of turn k stays at k periods, however much each sleep is too long."""
    clock = Clock(0.0)
    clock.oversleeps = 0.01
    pacer = paced(clock, 0.1)
    for k in range(1, 101):
        assert pacer.wait() == 0
        assert clock.now == pytest.approx(0.1 * k + 0.01)
    assert pacer.late == 0


@pytest.mark.parametrize(
    ("period", "delay", "anew"),
    [(0.1, 0.95, False), (0.1, 1.05, True), (5, 4.9, False), (5, 5.1, True)],
)
def test_after_a_pause_it_starts_anew_and_does_not_race(period, delay, anew):
    """Later than 1 s and a turn is a pause; less is caught up."""
    clock = Clock(0.0)
    pacer = paced(clock, period)
    clock.work(period + delay)
    late = clock.now
    assert pacer.wait() == pytest.approx(delay)
    assert clock.now == late
    pacer.wait()
    # A whole turn after the pause, or not at all
    assert clock.now == pytest.approx(late + period if anew else max(late, 2 * period))
    assert pacer.late == (2 if delay > period and not anew else 1)
    assert pacer.latest == pytest.approx(delay)


def test_a_restart_begins_a_turn_and_keeps_counts():
    clock = Clock(0.0)
    pacer = paced(clock, 0.1)
    clock.work(0.3)
    pacer.wait()
    clock.work(0.55)
    pacer.restart()
    assert pacer.wait() == 0
    assert clock.now == pytest.approx(0.95)
    assert pacer.late == 1


def test_the_real_clock_is_kept():
    pacer = Pacer(0.01, speed=2)
    start = time.perf_counter()
    for _ in range(20):
        pacer.wait()
    # At least this, however busy the machine is
    assert time.perf_counter() - start >= 20 * 0.005


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0,), "period is 0 s: a number above 0 is needed"),
        ((-0.1,), "period is -0.1 s"),
        ((np.nan,), "period is nan: a finite number"),
        ((np.inf,), "period is inf"),
        (("0.1",), "period is '0.1'"),
        ((0.1, 0), "speed is 0 times real time: a number above 0"),
        ((0.1, -1), "speed is -1"),
        ((0.1, np.inf), "speed is inf"),
        ((1e-300, 1e300), "period / speed is 0 s"),
        ((1e300, 1e-300), "period / speed is inf"),
    ],
)
def test_what_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Pacer(*arguments)
