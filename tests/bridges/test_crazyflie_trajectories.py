"""Trajectories of the planner against polynomials of SciPy and of one's own hand."""

import math
import struct

import numpy as np
import pytest
from scipy.interpolate import BPoly

from bulletuav.bridges.crazyflie_trajectories import (
    Spiral,
    TrajectoryStart,
    plan_line,
    plan_polynomial,
    read_compressed,
    read_pieces,
)
from bulletuav.bridges.crtp import MalformedError

BEGIN = TrajectoryStart(
    np.array([1.0, -2.0, 0.5, 0.3]),
    np.array([0.4, 0.2, -0.3, 0.1]),
    np.array([0.5, -1.0, 0.2, 0.0]),
)
GOAL = np.array([2.0, 1.0, 1.5, -1.0])


def pieces(rng, count):
    """Bytes of pieces as cflib writes them, with the numbers."""
    coefficients, durations = rng.normal(size=(count, 4, 8)), rng.uniform(0.5, 1.5, count)
    coefficients = coefficients.astype(np.float32).astype(float)
    durations = durations.astype(np.float32).astype(float)
    rows = [struct.pack("<33f", *coefficients[k].ravel(), durations[k]) for k in range(count)]
    return b"".join(rows), coefficients, durations


@pytest.mark.parametrize("duration", [0.5, 1.0, 3.0])
def test_a_smooth_plan_is_the_polynomial_that_scipy_finds(duration):
    plan = plan_polynomial(BEGIN, GOAL, duration)
    ends = [
        np.stack([BEGIN.position, BEGIN.velocity, BEGIN.acceleration, np.zeros(4)]),
        np.stack([GOAL, *np.zeros((3, 4))]),
    ]
    other = BPoly.from_derivatives([0.0, duration], ends)
    for time in np.linspace(0, duration, 7):
        state = plan.at(time)
        np.testing.assert_allclose([*state.position, state.yaw], other(time), atol=1e-9)
        np.testing.assert_allclose(state.acceleration, other(time, 2)[:3], atol=1e-8)
    assert plan.end == duration


def test_from_rest_to_rest_the_middle_is_half_way_and_fastest():
    plan = plan_polynomial(TrajectoryStart.at_rest(BEGIN.position), GOAL, 2.0)
    middle = plan.at(1.0)
    np.testing.assert_allclose(middle.position, (BEGIN.position + GOAL)[:3] / 2, atol=1e-12)
    # 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 has the slope 35 / 16 at s = 1/2
    np.testing.assert_allclose(middle.velocity, (GOAL - BEGIN.position)[:3] * 35 / 32, atol=1e-12)
    np.testing.assert_allclose(middle.acceleration, 0, atol=1e-12)


def test_a_straight_plan_has_one_speed():
    plan = plan_line(BEGIN.position, GOAL, 4.0)
    for time in (0.0, 1.0, 3.0):
        state = plan.at(time)
        np.testing.assert_allclose(state.velocity, (GOAL - BEGIN.position)[:3] / 4, atol=1e-12)
    np.testing.assert_allclose(plan.at(1.0).position, (0.75 * BEGIN.position + 0.25 * GOAL)[:3])


@pytest.mark.parametrize("sideways", [False, True])
@pytest.mark.parametrize("clockwise", [False, True])
def test_a_spiral_turns_about_its_centre(sideways, clockwise):
    begin = np.array([1.0, 2.0, 0.5, math.radians(30)])
    plan = Spiral(math.pi, 0.5, 1.0, 0.4, sideways, clockwise).plan(begin, 4.0)
    first, last = plan.at(0.0), plan.at(4.0)
    np.testing.assert_allclose([*first.position, first.yaw], begin, atol=1e-9)
    side = -1 if clockwise else 1
    nose = np.array([math.cos(begin[3]), math.sin(begin[3])])
    left = np.array([-nose[1], nose[0]])
    centre = begin[:2] + 0.5 * (nose if sideways else side * left)
    for time in np.linspace(0, 4, 9):
        state = plan.at(time)
        radius = np.linalg.norm(state.position[:2] - centre)
        share = (state.position[2] - 0.5) / 0.4
        assert radius == pytest.approx(0.5 + 0.5 * share, abs=1e-4)
        turn = side * math.pi * share
        assert state.yaw == pytest.approx(begin[3] + turn, abs=1e-6)
    # Half a turn: on the other side of the centre, at the last radius
    np.testing.assert_allclose(last.position[:2], centre - 2 * (begin[:2] - centre), atol=1e-9)
    if not sideways:
        early = plan.at(0.5).velocity[:2]
        assert early @ nose > 0.9 * np.linalg.norm(early)


def test_pieces_are_read_as_they_were_written():
    content, coefficients, durations = pieces(np.random.default_rng(1), 3)
    stored = read_pieces(b"\1\2\3\4" + content, 4, 3)
    np.testing.assert_array_equal(stored.coefficients, coefficients)
    np.testing.assert_array_equal(stored.durations, durations)
    plan = stored.plan()
    time = durations[0] + 0.3
    np.testing.assert_allclose(
        plan.at(time).position,
        [np.polyval(coefficients[1, k, ::-1], 0.3) for k in range(3)],
        atol=1e-9,
    )


def test_backwards_slower_and_elsewhere():
    content, _, durations = pieces(np.random.default_rng(2), 2)
    stored = read_pieces(content, 0, 2)
    ahead, back = stored.plan(), stored.reverse().plan()
    slow = stored.scaled(2.0).plan()
    for time in np.linspace(0.01, ahead.end - 0.01, 7):
        there = ahead.at(time)
        np.testing.assert_allclose(back.at(ahead.end - time).position, there.position, atol=1e-9)
        np.testing.assert_allclose(slow.at(2 * time).velocity, there.velocity / 2, atol=1e-9)
    begin = np.array([5.0, 6.0, 7.0, 1.0])
    moved = stored.moved(begin, True, True)
    np.testing.assert_allclose(moved.evaluate(0, 0.0), begin, atol=1e-12)
    angle = 1.0 - stored.evaluate(0, 0.0)[3]
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    way = stored.evaluate(1, 0.4)[:2] - stored.evaluate(0, 0.0)[:2]
    np.testing.assert_allclose(moved.evaluate(1, 0.4)[:2] - begin[:2], turn @ way, atol=1e-12)
    same = stored.moved(begin, False, False)
    np.testing.assert_array_equal(same.coefficients, stored.coefficients)
    assert durations.sum() == ahead.end


def test_compressed_pieces_are_bezier_curves():
    start = struct.pack("<4h", 1000, -500, 250, 900)
    # x of degree 3, y of degree 1, z stays, yaw of degree 7, in 2 s; then all stay for 1 s
    kinds = 2 | 1 << 2 | 0 << 4 | 3 << 6
    x, y, yaw = (1500, 2500, 3000), (500,), (900, 800, 700, 600, 500, 400, 450)
    first = struct.pack("<BH3h1h7h", kinds, 2000, *x, *y, *yaw)
    stored = read_compressed(start + first + struct.pack("<BH", 0, 1000), 0, 2)
    assert stored.durations.tolist() == [2.0, 1.0]
    curve = BPoly(np.array([[1.0], *([one / 1000] for one in x)]), [0, 2])
    turn = BPoly(np.radians([[90.0], *([one / 10] for one in yaw)]), [0, 2])
    for time in (0.0, 0.7, 2.0):
        state = stored.evaluate(0, time)
        wanted = (curve(time), -0.5 + 0.5 * time, 0.25, turn(time))
        np.testing.assert_allclose(state, wanted, atol=1e-12)
    np.testing.assert_allclose(
        stored.evaluate(1, 0.5), (3.0, 0.5, 0.25, math.radians(45)), atol=1e-9
    )


def test_what_the_memory_holds_may_be_no_trajectory():
    content, _, _ = pieces(np.random.default_rng(3), 1)
    for count, wrong in ((2, content), (1, content[:-1])):
        with pytest.raises(MalformedError, match="bytes"):
            read_pieces(wrong, 0, count)
    for duration in (0.0, -1.0, 1e6):
        with pytest.raises(MalformedError, match="duration"):
            read_pieces(content[:-4] + struct.pack("<f", duration), 0, 1)
    with pytest.raises(MalformedError, match="not finite"):
        read_pieces(struct.pack("<f", math.nan) + content[4:], 0, 1)
    with pytest.raises(MalformedError, match="reach farther"):
        read_pieces(content[:28] + struct.pack("<f", 1e30) + content[32:], 0, 1)
    with pytest.raises(MalformedError, match="duration of zero"):
        read_compressed(bytes(11), 0, 1)
    with pytest.raises(MalformedError, match="bytes"):
        read_compressed(bytes(8), 0, 1)
