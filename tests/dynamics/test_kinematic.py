"""The kinematic levels against closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.kinematic import limited

G = 9.80665
KINEMATIC = ("single_integrator", "double_integrator", "point_mass")


def constants(bench):
    """Velocity lag (s), drag (1/s) and most acceleration (m/s^2) of the bench's airframe."""
    gain, airframe = bench.dynamics.flight.cascade.gains[0, 0], bench.airframe
    lag = 1 / (1.6 * gain["position_frequency"])
    drag = airframe.drag_xy * len(airframe.rotors) * airframe.hover_speed() / airframe.mass
    return lag, drag, G * np.tan(np.radians(55))


def test_single_integrator_is_its_command_limited_by_norm(make_bench):
    bench = make_bench("single_integrator", max_speed=5.0)
    bench.fly(SetpointLevel.VELOCITY, (1.0, -2.0, 0.5, 0.0), decisions=3)
    np.testing.assert_allclose(bench.swarm.position[0, 0], (0.3, -0.6, 10.15), atol=1e-12)
    bench.fly(SetpointLevel.VELOCITY, (30.0, 40.0, 0.0, 0.0))
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (3, 4, 0), atol=1e-12)


def test_double_integrator_follows_the_parabola(make_bench):
    bench = make_bench("double_integrator")
    bench.swarm.velocity[:] = 1, 0, 0
    bench.fly(SetpointLevel.ACCELERATION, (0.5, 1.0, -0.25, 0.0), decisions=10)
    np.testing.assert_allclose(bench.swarm.position[0, 0], (1.25, 0.5, 10 - 0.125), atol=1e-12)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (1.5, 1, -0.25), atol=1e-12)


def test_double_integrator_limits_acceleration_and_speed_by_norm(make_bench):
    bench = make_bench("double_integrator", max_speed=6.0)
    _, _, most = constants(bench)
    bench.fly(SetpointLevel.ACCELERATION, (300.0, 400.0, 0.0, 0.0))
    np.testing.assert_allclose(
        bench.swarm.velocity[0, 0], 0.1 * most * np.array((0.6, 0.8, 0)), rtol=1e-12
    )
    bench.fly(SetpointLevel.ACCELERATION, (3.0, 4.0, 0.0, 0.0), decisions=40)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (3.6, 4.8, 0), rtol=1e-12)


def test_double_integrator_reaches_velocities_with_the_lag_of_the_velocity_loop(make_bench):
    bench = make_bench("double_integrator", hz=9600, substeps=960)
    lag, _, _ = constants(bench)
    bench.fly(SetpointLevel.VELOCITY, (2.0, 0.0, 0.0, 0.0), decisions=2)
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(2 * (1 - np.exp(-0.2 / lag)), rel=1e-3)


@pytest.mark.parametrize("airframe", ["cf2x", "hummingbird"])
def test_point_mass_is_the_exact_solution_of_lag_drag_and_wind(make_bench, airframe):
    bench = make_bench("point_mass", airframe, wind=(1.0, -2.0, 0.5))
    lag, drag, _ = constants(bench)
    bench.swarm.velocity[:] = 0.5, 0.2, -0.1
    bench.fly(SetpointLevel.VELOCITY, (2.0, 1.0, 0.3, 0.0), decisions=10)
    command, wind = np.array((2.0, 1.0, 0.3)), np.array((1.0, -2.0, 0.5))

    def slope(t, s):
        return np.concatenate([s[3:], (command - s[3:]) / lag - drag * (s[3:] - wind)])

    end = solve_ivp(slope, (0, 1), (0, 0, 10, 0.5, 0.2, -0.1), rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(bench.swarm.position[0, 0], end[:3], atol=1e-8)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], end[3:], atol=1e-8)


def test_point_mass_starts_no_faster_than_its_acceleration_limit(make_bench):
    bench = make_bench("point_mass", substeps=1)
    _, _, most = constants(bench)
    bench.fly(SetpointLevel.VELOCITY, (20.0, 0.0, 0.0, 0.0))
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(most / 240, rel=1e-9)
    assert bench.swarm.position[0, 0, 0] == pytest.approx(most / 240**2 / 2, rel=1e-9)


def test_point_mass_comes_to_rest_where_lag_and_drag_balance(make_bench):
    bench = make_bench("point_mass", "cf2x")
    lag, drag, _ = constants(bench)
    bench.fly(SetpointLevel.VELOCITY, (5.0, 0.0, 0.0, 0.0), decisions=100)
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(5 / (1 + lag * drag), rel=1e-9)


@pytest.mark.parametrize("dynamics", KINEMATIC)
def test_positions_are_reached_and_yaw_is_shown(make_bench, dynamics):
    bench = make_bench(dynamics)
    bench.fly(SetpointLevel.POSITION, (3.0, -2.0, 12.0, 0.5), decisions=80)
    np.testing.assert_allclose(bench.swarm.position[0, 0], (3, -2, 12), atol=0.01)
    np.testing.assert_allclose(
        bench.swarm.quaternion[0, 0], (0, 0, np.sin(0.25), np.cos(0.25)), atol=1e-12
    )
    assert not bench.swarm.rates.any()


@pytest.mark.parametrize("dynamics", KINEMATIC)
def test_points_start_level_and_the_dead_stay(make_bench, dynamics):
    bench = make_bench(dynamics, drones=2)
    bench.swarm.quaternion[:] = 0.5, 0.5, 0.5, 0.5
    bench.swarm.rates[:] = 1
    bench.place()
    np.testing.assert_array_equal(bench.swarm.quaternion[0, 0], (0, 0, 0, 1))
    assert not bench.swarm.rates.any()
    bench.alive[0, 1] = False
    before = bench.swarm.position[0, 1].copy()
    bench.fly(SetpointLevel.VELOCITY, (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_array_equal(bench.swarm.position[0, 1], before)
    assert bench.swarm.position[0, 0, 0] > 0


def test_limited_keeps_direction():
    np.testing.assert_allclose(limited((3.0, 4.0, 0.0), 1.0), (0.6, 0.8, 0))
    assert limited((0.3, 0.4, 0.0), 1.0) == (0.3, 0.4, 0.0)
    assert limited((0.0, 0.0, 0.0), 1.0) == (0.0, 0.0, 0.0)
