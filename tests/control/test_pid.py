"""The Crazyflie's PID: by hand, and in flight."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.control.gains import gain_rows
from bulletuav.control.pid import pid_rotors, pid_torque
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.parameters import parameter_rows

G = 9.80665


def test_one_step_of_the_crazyflies_pid_by_hand():
    cf2x = load_airframe("cf2x")
    row, gain = parameter_rows([cf2x])[0], gain_rows([cf2x], 20.0)[0]
    q = Rotation.from_euler("xyz", (0.05, -0.1, 0.2)).as_quat()
    rates, away, slow = (
        np.array((0.1, -0.2, 0.3)),
        np.array((0.3, -0.2, 0.5)),
        np.array((-0.1, 0.2, 0.05)),
    )
    command, dt, none = np.empty(4), 1 / 240, (0.0, 0.0, 0.0)
    integrals = pid_rotors(away, slow, 0.0, q, rates, (none, none), dt, G, row, gain, command)

    R = Rotation.from_quat(q).as_matrix()
    integral = away * dt
    force = (
        np.array((0.4, 0.4, 1.25)) * away
        + 0.05 * integral
        + np.array((0.2, 0.2, 0.5)) * slow
        + (0, 0, cf2x.mass * G)
    )
    base = (np.sqrt(force @ R[:, 2] / (4 * 2.40e-10)) - 4670.5) / 0.30809
    z = force / np.linalg.norm(force)
    y = np.cross(z, (1, 0, 0))
    y /= np.linalg.norm(y)
    Rd = np.array((np.cross(y, z), y, z)).T
    matrix = Rd.T @ R - R.T @ Rd
    error = np.array((matrix[2, 1], matrix[0, 2], matrix[1, 0]))
    torque = -np.array((7e4, 7e4, 6e4)) * error - np.array((2e4, 2e4, 1.2e4)) * rates
    torque += np.array((0, 0, 500)) * -error * dt
    mixer = np.array([(-0.5, -0.5, -1), (-0.5, 0.5, 1), (0.5, 0.5, -1), (0.5, -0.5, 1)])
    pwm = np.clip(base + mixer @ np.clip(torque, -3200, 3200), 20000, 65535)
    np.testing.assert_allclose(command * 60 / (2 * np.pi), 0.30809 * pwm + 4670.5, rtol=1e-5)
    np.testing.assert_allclose(integrals, (integral, -error * dt), rtol=1e-9, atol=1e-12)


def test_integrals_and_torques_are_bounded():
    cf2x = load_airframe("cf2x")
    row, gain = parameter_rows([cf2x])[0], gain_rows([cf2x], 20.0)[0]
    q = Rotation.from_euler("x", 90, degrees=True).as_quat()
    integrals = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for _ in range(10000):
        integrals = pid_rotors(
            (9.0, 9.0, 9.0),
            (0.0,) * 3,
            2.0,
            q,
            (0.0,) * 3,
            integrals,
            0.1,
            G,
            row,
            gain,
            np.empty(4),
        )
    np.testing.assert_array_equal(integrals[0], (2.0, 2.0, 0.15))
    assert np.abs(integrals[1][:2]).max() <= 1.0
    assert 1.0 < abs(integrals[1][2]) <= 1500
    assert np.abs(pid_torque((9.0, -9.0, 9.0), (0.0, 0.0, 0.0), integrals[1])).max() == 3200


def test_step_of_one_metre_as_known_without_lag(make_bench):
    """10.6 % overshoot, settled to 5 % in 3.5 s at 240 Hz."""
    bench = make_bench("bullet", "cf2x", substeps=1, effects=(), controller="pid")
    position, _ = bench.place().trace(SetpointLevel.POSITION, (1.0, 0.0, 10.0, 0.0), 240 * 10)
    error = position[:, 0] - 1
    assert error.max() == pytest.approx(0.106, abs=0.01)
    assert np.flatnonzero(np.abs(error) > 0.05)[-1] / 240 == pytest.approx(3.475, abs=0.35)
    assert np.abs(position[-1] - (1, 0, 10)).max() < 0.03


def test_with_the_real_motor_lag_it_cannot_hold_the_drone(make_bench):
    bench = make_bench("rigid_body", "cf2x", substeps=1, effects=("lag",), controller="pid")
    tilt = 0.0
    for _ in range(240 * 4):
        bench.fly(SetpointLevel.POSITION, (1.0, 0.0, 10.0, 0.0))
        tilt = max(tilt, Rotation.from_quat(bench.swarm.quaternion[0, 0]).magnitude())
    assert tilt > np.radians(90)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_velocity_setpoints(make_bench, dynamics):
    bench = make_bench(dynamics, "cf2x", effects=(), controller="pid")
    bench.place().fly(SetpointLevel.VELOCITY, (0.5, 0.0, 0.0, 0.0), decisions=60)
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(0.5, abs=0.1)
