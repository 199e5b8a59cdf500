"""Trajectories go where and when they are told, smoothly; trackers follow them closely."""

import numpy as np
import pytest

from bulletuav import Airspace, SetpointLevel
from bulletuav.control.trajectory import Tracker, Trajectory
from bulletuav.vehicle.airframes import load_airframe

CF2X = load_airframe("cf2x")


def test_two_points_give_the_quintic_of_least_jerk():
    # s = 10 t^3 - 15 t^4 + 6 t^5 from rest to rest (T. Flash and N. Hogan 1985)
    line = Trajectory((0, 1), [(0.0, 0, 1), (2.0, 0, 1)])
    for t in (0.0, 0.2, 0.5, 0.9, 1.0):
        at = line.at(t)
        assert at.position[0] == pytest.approx(2 * (10 * t**3 - 15 * t**4 + 6 * t**5), abs=1e-12)
        assert at.velocity[0] == pytest.approx(2 * (30 * t**2 - 60 * t**3 + 30 * t**4), abs=1e-12)
        assert at.acceleration[0] == pytest.approx(
            2 * (60 * t - 180 * t**2 + 120 * t**3), abs=1e-11
        )
        np.testing.assert_allclose(at.position[1:], (0, 1), atol=1e-14)


def test_waypoints_are_met_smoothly_from_rest_to_rest():
    times = np.array((1.0, 2.0, 2.5, 4.0))
    points = np.array([(0, 0, 1, 0), (1, 0, 1, 0.5), (1, 2, 1.5, 1), (0, 0, 1, 4.0)], float)
    path = Trajectory(times, points)
    for t, point in zip(times, points, strict=True):
        target = path.at(t)
        np.testing.assert_allclose((*target.position, target.yaw), point, atol=1e-12)
        # Nothing jumps there, and derivatives are those of the positions
        before, after = path.at(t - 1e-6), path.at(t + 1e-6)
        np.testing.assert_allclose(before.velocity, after.velocity, atol=1e-3)
        np.testing.assert_allclose(before.acceleration, after.acceleration, atol=1e-2)
    h = 1e-4
    for t in (1.3, 2.2, 3.7):
        low, here, high = path.at(t - h), path.at(t), path.at(t + h)
        slope = (high.position - low.position) / (2 * h)
        bend = (high.velocity - low.velocity) / (2 * h)
        np.testing.assert_allclose(here.velocity, slope, atol=1e-5)
        np.testing.assert_allclose(here.acceleration, bend, atol=1e-4)
    for t in (1.0, 4.0):
        np.testing.assert_allclose(path.at(t).velocity, 0, atol=1e-10)
        np.testing.assert_allclose(path.at(t).acceleration, 0, atol=1e-9)


def test_before_and_after_it_stands_still():
    path = Trajectory((0, 1), [(0.0, 0, 1), (2.0, 0, 1)])
    for t, x in ((-5.0, 0), (7.0, 2)):
        target = path.at(t)
        np.testing.assert_allclose(target.position, (x, 0, 1), atol=1e-12)
        assert not target.velocity.any()
        assert not target.acceleration.any()
    rising = Trajectory.polynomial([1.0], [[[0, 1.0], [0, 0], [0, 0], [0, 0]]])
    assert rising.at(1.0).velocity[0] == 1
    assert rising.at(1.1).velocity[0] == 0


def test_polynomials_are_joined_in_time():
    # x = t^2 for 2 s, then from 4 on with 4 t - t^2; y = 1; the yaw 0.1 t in the second piece
    pieces = np.zeros((2, 4, 3))
    pieces[0, 0], pieces[1, 0] = (0, 0, 1), (4, 4, -1)
    pieces[:, 1, 0] = 1
    pieces[1, 3, 1] = 0.1
    path = Trajectory.polynomial([2.0, 1.5], pieces)
    assert (path.begin, path.end) == (0, 3.5)
    early, late = path.at(1.5), path.at(3.0)
    np.testing.assert_allclose(early.position, (2.25, 1, 0))
    np.testing.assert_allclose(early.velocity, (3, 0, 0))
    np.testing.assert_allclose(late.position, (7, 1, 0))
    np.testing.assert_allclose(late.acceleration, (-2, 0, 0))
    assert late.yaw == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("times", "points", "message"),
    [
        ((0, 1, 1), np.zeros((3, 3)), "above the one before"),
        ((0, np.nan), np.zeros((2, 3)), "above the one before"),
        ((0,), np.zeros((1, 3)), "from 2 to"),
        ((0, 1), np.zeros((2, 2)), r"shape \(2, 2\): \(2, 3\)"),
        ((0, 1), np.zeros((3, 3)), r"shape \(3, 3\): \(2, 3\)"),
        ((0, 1), [(0, 0, 0), (0, 0, np.inf)], "not finite"),
        ("ab", np.zeros((2, 3)), "not numbers"),
    ],
)
def test_points_that_no_curve_goes_through_are_refused(times, points, message):
    with pytest.raises(ValueError, match=message):
        Trajectory(times, points)


@pytest.mark.parametrize(
    ("durations", "coefficients", "message"),
    [
        ([0.0], np.zeros((1, 4, 8)), "above 0"),
        ([], np.zeros((0, 4, 8)), "above 0"),
        ([1.0], np.zeros((2, 4, 8)), r"\(pieces, x y z yaw, powers\)"),
        ([1.0], np.zeros((1, 4, 0)), r"\(pieces, x y z yaw, powers\)"),
        ([1.0], np.full((1, 4, 8), np.nan), "not finite"),
    ],
)
def test_polynomials_that_cannot_be_are_refused(durations, coefficients, message):
    with pytest.raises(ValueError, match=message):
        Trajectory.polynomial(durations, coefficients)


def eight(laps):
    """Times and points of figures of 2.2 m at 1 m/s, on average."""
    turn = np.linspace(0, 2 * np.pi * laps, 64 * laps + 1)
    points = np.column_stack([1.1 * np.sin(turn), 0.55 * np.sin(2 * turn), np.ones(len(turn))])
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return way, points


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_crazyflie_follows_an_eight_of_1_m_s_within_5_cm(dynamics):
    times, points = eight(2)
    path = Trajectory(times + 1, points)
    airspace = Airspace(
        [(0, 0, 1)], dynamics=dynamics, decision_hz=48, rotor_speed=CF2X.hover_speed()
    )
    tracker, off = Tracker(CF2X, path), []
    while airspace.time < path.end:
        state = airspace.swarm.position[0], airspace.swarm.velocity[0]
        airspace.command(0, SetpointLevel.ACCELERATION, tracker.setpoint(airspace.time, *state))
        airspace.step()
        off.append(np.linalg.norm(airspace.swarm.position[0] - path.at(airspace.time).position))
    # The second lap: the first one starts from rest, at 1 m/s a moment later
    second = np.array(off)[-len(off) // 2 :]
    assert 0.001 < np.sqrt((second**2).mean()) < 0.05
    assert np.sqrt(np.square(off).mean()) < 0.12


def test_on_its_trajectory_a_tracker_asks_for_its_acceleration_and_off_it_goes_back():
    hold = Trajectory((0, 1), [(1.0, 2, 3), (1.0, 2, 3)])
    tracker = Tracker(CF2X, hold)
    here = np.array((1.0, 2, 3))
    np.testing.assert_allclose(tracker.setpoint(0.5, here, np.zeros(3)), np.zeros(3), atol=1e-9)
    # w^2 (x_ref - x) and 2 z w (v_ref - v), with w = 1 / (8 lag) and z = 0.8
    w = 1 / (8 * CF2X.lag_up)
    away = tracker.setpoint(0.5, np.array((1.0, 2, 2)), np.array((0.1, 0, 0)))
    np.testing.assert_allclose(away, (-0.16 * w, 0, w * w), atol=1e-9)
    turning = Trajectory((0, 1), [(1.0, 2, 3, 0.5), (1.0, 2, 3, 0.5)])
    assert Tracker("cf2x", turning).setpoint(0.5, here, np.zeros(3))[3] == pytest.approx(0.5)


def test_what_comes_is_asked_for_early_by_the_delay_of_each_axis():
    # x and z alike; sideways the attitude's 2 z / w_R, upwards the rotors' lag. Drag grows too.
    both = Trajectory((0, 1, 2), [(0.0, 0, 0), (1, 0, 1), (0, 0, 0)])
    for name in ("cf2x", "hummingbird"):
        frame = load_airframe(name)
        asked = Tracker(name, both)
        target = both.at(0.6)
        wanted = asked.setpoint(0.6, target.position, target.velocity)
        down = max(frame.lag_up, frame.lag_down)
        sideways = 2 * 0.8 / min(10, 1 / (2 * down))
        hover = len(frame.rotors) * frame.hover_speed() / frame.mass
        more_x, more_z = 1 + hover * frame.drag_xy * sideways, 1 + hover * frame.drag_z * down
        assert wanted[0] == pytest.approx(more_x * both.at(0.6 + sideways).acceleration[0])
        assert wanted[2] == pytest.approx(more_z * both.at(0.6 + down).acceleration[2])


def test_along_points_the_speed_is_about_what_is_asked():
    corners = np.array([(0.0, 0, 1), (1, 0, 1), (2, 0.5, 1), (3, 0.5, 1), (4, 0, 1)])
    path = Trajectory.along(corners, 0.5)
    ways = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert path.end == pytest.approx((ways.sum() + ways[0] + ways[-1]) / 0.5)
    speeds = [np.linalg.norm(path.at(t).velocity) for t in np.linspace(0, path.end, 200)]
    assert np.linalg.norm(path.at(path.end / 2).velocity) == pytest.approx(0.5, abs=0.1)
    assert 0.5 < max(speeds) < 0.7
    assert Trajectory.along(corners[:2], 0.5).end == pytest.approx(4.0)
    for wrong, message in (
        ((corners, 0.0), "speed is 0 m/s"),
        ((corners, np.nan), "speed is nan"),
        ((corners[:1], 1.0), "two rows or more"),
        ((corners[[0, 0, 1]], 1.0), "above the one before"),
    ):
        with pytest.raises(ValueError, match=message):
            Trajectory.along(*wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        (np.nan, np.zeros(3), np.zeros(3)),
        (0.0, np.zeros(2), np.zeros(3)),
        (0.0, np.zeros(3), np.full(3, np.inf)),
    ],
)
def test_a_tracker_refuses_states_that_cannot_be(wrong):
    with pytest.raises(ValueError, match="finite"):
        Tracker("cf2x", Trajectory((0, 1), np.zeros((2, 3)))).setpoint(*wrong)
    with pytest.raises(ValueError, match="did you mean 'cf2x'"):
        Tracker("cf3x", Trajectory((0, 1), np.zeros((2, 3))))
