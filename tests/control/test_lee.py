"""Lee's controller: by hand, and in flight."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.control import lee
from bulletuav.control.gains import gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.rotors import rotor_wrench

G = 9.80665
NAMES = ("cf2x", "hummingbird", "cf2p", "racer", "iris", "firefly")


def rows(name, effects=("lag", "drag")):
    airframe = load_airframe(name)
    return airframe, parameter_rows([airframe], effects)[0], gain_rows([airframe], 20.0)[0]


def test_the_published_control_law_numerically():
    """Force and moment by hand for one state, with w = 2.5 and w_R = 10 on all axes."""
    _, row, gain = rows("hummingbird", effects=())
    gain["attitude_frequency"], gain["position_frequency"] = 10.0, 2.5
    gain["max_deceleration"] = gain["max_speed"] = np.inf  # the published law knows no limits
    q = np.array((-0.06407135, 0.09115755, 0.1534393, 0.98185617))
    rates, position, velocity = (
        np.array((0.5, -0.4, 0.2)),
        np.array((1.0, 2, 3)),
        np.array((0.1, -0.2, 0.3)),
    )
    towards = np.array(lee.velocity_setpoint(position, (0.0, 0.0, 5.0), gain)) + (1, 0, 0)
    acceleration = np.array(lee.acceleration_setpoint(velocity, towards, gain)) + (0, 0.5, 0)
    force = lee.force_setpoint(acceleration, q, velocity, 0.0, G, row, gain)
    desired = lee.desired_axes(force, 0.0)
    torque = lee.torque_setpoint(rates, lee.rates_setpoint(q, desired, gain), 0.0, row, gain)
    assert np.dot(force, Rotation.from_quat(q).as_matrix()[:, 2]) == pytest.approx(
        13.201496, abs=2e-6
    )
    np.testing.assert_allclose(torque, (0.323162, -0.185980, -0.357685), atol=2e-6)


def test_gains_follow_the_slower_motor_lag():
    for name, frequency in (("cf2x", 1 / 0.13), ("hummingbird", 10.0)):
        _, _, gain = rows(name)
        np.testing.assert_allclose(
            gain["attitude_frequency"], (frequency, frequency, frequency / 2)
        )
        assert gain["position_frequency"] == pytest.approx(frequency / 4)


@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(0.5, 0.9))
def test_mixing_is_the_inverse_of_the_rotors(roll, pitch, yaw, share):
    for name in NAMES:
        airframe, row, gain = rows(name)
        room = 0.09 * airframe.max_thrust * airframe.arm
        torque = np.array(
            (roll * room, pitch * room, yaw * 0.09 * airframe.max_thrust * airframe.torque_ratio)
        )
        command = np.empty(len(airframe.rotors))
        lee.mix(share * airframe.max_thrust * 0.8, torque, row, gain, command)
        assert (command <= airframe.max_rotor_speed).all()
        thrust, produced, _, _ = rotor_wrench(command, 0.0, row)
        assert thrust == pytest.approx(share * airframe.max_thrust * 0.8, rel=1e-9)
        np.testing.assert_allclose(produced, torque, atol=1e-9)


def test_yaw_gives_way_to_thrust_roll_and_pitch():
    airframe, row, gain = rows("firefly")
    command = np.empty(6)
    weight = airframe.mass * G
    lee.mix(weight, (0.3, -0.2, 50.0), row, gain, command)
    thrust, produced, _, _ = rotor_wrench(command, 0.0, row)
    assert thrust == pytest.approx(weight, rel=1e-9)
    np.testing.assert_allclose(produced[:2], (0.3, -0.2), atol=1e-9)
    assert 0.05 < produced[2] < 50


def test_rotors_are_never_asked_for_more_than_they_can_do():
    airframe, row, gain = rows("cf2x")
    command = np.empty(4)
    lee.mix(1e3, (1.0, 1.0, 1.0), row, gain, command)
    assert command.max() == pytest.approx(airframe.max_rotor_speed)
    lee.mix(-1.0, (0.0, 0.0, 0.0), row, gain, command)
    assert not command.any()


@given(st.tuples(*[st.floats(-500, 500)] * 3), st.floats(-3.1, 3.1))
def test_the_desired_force_is_flyable_and_its_axes_right_handed(acceleration, yaw):
    airframe, row, gain = rows("cf2x")
    force = np.array(
        lee.force_setpoint(acceleration, (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, G, row, gain)
    )
    assert np.linalg.norm(force) <= 0.9 * airframe.max_thrust * (1 + 1e-12)
    assert np.hypot(*force[:2]) <= np.tan(np.radians(55)) * force[2] * (1 + 1e-12)
    R = np.array(lee.desired_axes(force, yaw)).T
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(R[:, 2] * np.linalg.norm(force), force, atol=1e-12)
    assert R[:, 1] @ (np.cos(yaw), np.sin(yaw), 0) == pytest.approx(
        0, abs=1e-12
    )  # the nose in the plane of the yaw


@given(st.floats(0, 500))
def test_a_far_target_is_approached_at_a_speed_that_can_be_braked(distance):
    _, _, gain = rows("hummingbird")
    velocity = lee.velocity_setpoint(np.zeros(3), (0.0, distance, 0.0), gain)
    assert velocity[0] == velocity[2] == 0
    rate = gain["position_frequency"] / 1.6
    assert 0 <= velocity[1] <= min(20.0, rate * distance) * (1 + 1e-12)
    assert velocity[1] ** 2 / (2 * 5.0) <= distance + 1e-9


# Flight


def settle(trace, target, axis, hz):
    """Overshoot (share of the step of 1 m) and time (s) after which the error stays below 5 %."""
    error = trace[:, axis] - target
    outside = np.flatnonzero(np.abs(error) > 0.05)
    return max(0.0, error.max()), (outside[-1] + 2) / hz


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("name", "limit"), [(name, 1.75 if name.startswith("cf2") else 1.5) for name in NAMES]
)
def test_step_of_one_metre(make_bench, name, limit, axis, dynamics):
    bench = make_bench(dynamics, name, substeps=2)
    target = np.array((0.0, 0, 10, 0))
    target[axis] += 1
    position, _ = bench.place().trace(SetpointLevel.POSITION, target, 360)
    overshoot, settling = settle(position, target[axis], axis, 120)
    assert overshoot < 0.02
    assert settling < limit
    assert np.abs(position[-1] - target[:3]).max() < 0.006


@pytest.mark.parametrize("name", NAMES)
def test_recovery_from_sixty_degrees(make_bench, name):
    bench = make_bench("rigid_body", name, substeps=2)
    bench.swarm.quaternion[:] = Rotation.from_euler("x", 60, degrees=True).as_quat()
    position, _ = bench.trace(SetpointLevel.POSITION, (0.0, 0.0, 10.0, 0.0), 480)
    assert 0.1 < 10 - position[:, 2].min() < 0.46
    np.testing.assert_allclose(position[-1], (0, 0, 10), atol=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_the_greatest_speed_is_reached_and_held_level(make_bench, name):
    fastest = load_airframe(name).max_speed
    bench = make_bench("rigid_body", name)
    _, velocity = bench.trace(SetpointLevel.VELOCITY, (fastest, 0.0, 0.0, 0.0), 120)
    np.testing.assert_allclose(velocity[-1], (fastest, 0, 0), atol=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_a_fast_target_is_followed_with_a_small_lag(make_bench, name):
    """Position and velocity setpoints together; drag is fed forward, so no lag remains."""
    bench = make_bench("rigid_body", name, substeps=1)
    fast = 0.9 * bench.airframe.max_speed
    rate = gain_rows([bench.airframe], 20.0)[0]["position_frequency"] / 1.6
    for step in range(240 * 15):
        ahead = np.array((fast * step / 240, 0, 10)) - bench.swarm.position[0, 0]
        bench.fly(SetpointLevel.VELOCITY, (*(np.array((fast, 0, 0)) + rate * ahead), 0.0))
    lag = fast * 15 - bench.swarm.position[0, 0, 0]
    assert abs(lag) < 0.01


@pytest.mark.parametrize("yaw", [-2.0, 1.0, 3.0])
def test_yaw_is_turned_to_and_held(make_bench, yaw):
    bench = make_bench("rigid_body", "cf2x")
    bench.fly(SetpointLevel.POSITION, (0.0, 0.0, 10.0, yaw), decisions=60)
    measured = Rotation.from_quat(bench.swarm.quaternion[0, 0]).as_euler("ZYX")[0]
    assert measured == pytest.approx(yaw, abs=0.01)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_every_level_of_the_staircase_flies(make_bench, dynamics):
    hover = load_airframe("hummingbird").mass * G
    cases = (
        (SetpointLevel.ACCELERATION, (1.0, 0.0, 0.0, 0.0), lambda s: s.velocity[0, 0, 0] > 0.5),
        (
            SetpointLevel.ATTITUDE,
            (0.1, 0.0, 0.0, hover),
            lambda s: Rotation.from_quat(s.quaternion[0, 0]).as_euler("xyz")[0] > 0.08,
        ),
        (SetpointLevel.RATES, (0.0, 0.0, 0.5, hover), lambda s: abs(s.rates[0, 0, 2] - 0.5) < 0.05),
    )
    for level, setpoint, check in cases:
        bench = make_bench(dynamics)
        bench.place().fly(level, setpoint, decisions=10)
        assert check(bench.swarm), level.name
