import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.vehicle.aerodynamics import downwash, ground_effect, rotor_drag, wakes
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.wrench import wrench

G = 9.80665
NAMES = ("cf2x", "hummingbird", "cf2p", "racer", "iris", "firefly")


def row_of(name, effects=None):
    airframe = load_airframe(name)
    return airframe, parameter_rows([airframe], *([] if effects is None else [effects]))[0]


def still_air(surface=-np.inf, wind=(0.0, 0.0, 0.0)):
    return np.array(wind), surface, G, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


# Rotors


def after(speed, command, elapsed, row):
    return lagged(speed, command, lag_decay(elapsed, row))


def test_lag_is_the_exact_step_response_up_and_down():
    _, row = row_of("hummingbird")
    assert after(100.0, 200.0, 0.0125, row) == pytest.approx(200 - 100 * math.exp(-1), rel=1e-14)
    assert after(200.0, 100.0, 0.025, row) == pytest.approx(100 + 100 * math.exp(-1), rel=1e-14)
    halves = after(after(100.0, 200.0, 0.004, row), 200.0, 0.006, row)
    assert halves == pytest.approx(after(100.0, 200.0, 0.010, row), rel=1e-14)


def test_without_lag_the_command_is_the_speed():
    _, row = row_of("cf2x", ())
    assert after(5.0, 900.0, 1e-3, row) == 900.0
    assert after(900.0, 5.0, 1e-3, row) == 5.0


@pytest.mark.parametrize("name", NAMES)
def test_hover_balances_weight_to_1e9(name):
    airframe, row = row_of(name)
    speed = np.full(len(airframe.rotors), airframe.hover_speed())
    force, torque = wrench(
        (0.0, 0.0, 0.0, 1.0), np.zeros(3), 1e9, rotor_wrench(speed, row), still_air(), 0.0, row
    )
    np.testing.assert_allclose(force, 0, atol=1e-9)
    np.testing.assert_allclose(torque, 0, atol=1e-9)


def test_torques_of_single_rotors_by_hand():
    airframe, row = row_of("cf2x")
    for r, (x, y, turn) in enumerate(airframe.rotors):
        speed = np.zeros(4)
        speed[r] = 1000.0
        thrust, torque, total = rotor_wrench(speed, row)
        assert (thrust, total) == (pytest.approx(0.028816), 1000.0)
        np.testing.assert_allclose(
            torque, (y * 0.028816, -x * 0.028816, turn * 0.028816 * 0.00596), rtol=1e-12
        )


def test_faster_clockwise_rotors_turn_the_crazyflie_to_the_left():
    _, row = row_of("cf2x")
    _, torque, _ = rotor_wrench(np.array([1000.0, 1100.0, 1000.0, 1100.0]), row)
    np.testing.assert_allclose(torque[:2], 0, atol=1e-12)
    assert torque[2] > 0


# Drag


@pytest.mark.parametrize(
    ("name", "tilt", "speed"),
    [
        ("cf2x", 23.95, 1601.4),
        ("cf2p", 23.95, 1601.4),
        ("racer", 39.69, 2059.3),
        ("hummingbird", 21.86, 436.6),
        ("iris", 15.66, 647.9),
        ("firefly", 18.75, 526.3),
    ],
)
def test_level_flight_at_20_m_s_needs_the_published_tilt_and_rotor_speed(name, tilt, speed):
    airframe, row = row_of(name)
    pitch = Rotation.from_euler("y", tilt, degrees=True).as_quat()
    speeds = np.full(len(airframe.rotors), speed)
    force, _ = wrench(
        pitch, np.array([20.0, 0, 0]), 1e9, rotor_wrench(speeds, row), still_air(), 0.0, row
    )
    np.testing.assert_allclose(np.array(force) / (airframe.mass * G), 0, atol=4e-4)


vector = st.tuples(*[st.floats(-30, 30)] * 3)


@given(vector, st.tuples(*[st.floats(-3, 3)] * 3))
def test_drag_takes_power_and_turns_with_the_body(v, turn):
    _, row = row_of("cf2x")
    q = Rotation.from_rotvec(turn)
    drag = np.array(rotor_drag(q.as_quat(), v, 6000.0, row))
    assert drag @ v <= 1e-12
    body = np.array(rotor_drag((0.0, 0.0, 0.0, 1.0), q.inv().apply(v), 6000.0, row))
    np.testing.assert_allclose(drag, q.apply(body), atol=1e-10)


def test_drag_is_relative_to_the_air_and_linear_in_rotor_speed():
    _, row = row_of("hummingbird")
    speeds, q = np.full(4, 450.0), (0.0, 0.0, 0.0, 1.0)
    with_wind, _ = wrench(
        q,
        np.array([3.0, 0, 0]),
        1e9,
        rotor_wrench(speeds, row),
        still_air(wind=(3.0, 0, 0)),
        0.0,
        row,
    )
    np.testing.assert_allclose(with_wind[:2], 0, atol=1e-15)
    np.testing.assert_allclose(
        rotor_drag(q, (1.0, 2.0, 3.0), 1800.0, row), (-8.06428e-5 * 1800, -2 * 8.06428e-5 * 1800, 0)
    )


# Ground effect


@pytest.mark.parametrize(
    ("name", "figures"),
    [
        ("cf2x", (1.1521, 1.0380, 1.0095, 1.0015)),
        ("cf2p", (1.1521, 1.0380, 1.0095, 1.0015)),
        ("racer", (1.1008, 1.0252, 1.0063, 1.0010)),
        ("hummingbird", (1.2500, 1.0625, 1.0156, 1.0025)),
        ("iris", (1.2667, 1.1024, 1.0256, 1.0041)),
        ("firefly", (1.2500, 1.0625, 1.0156, 1.0025)),
    ],
)
def test_ground_effect_figures(name, figures):
    _, row = row_of(name)
    for height, figure in zip((0.05, 0.1, 0.2, 0.5), figures, strict=True):
        assert 1 + ground_effect(height, 1.0, row) == pytest.approx(figure, abs=5e-5)


@pytest.mark.parametrize("name", NAMES)
def test_ground_effect_is_bounded_falls_with_height_and_fades_with_tilt(name):
    _, row = row_of(name)
    gains = [ground_effect(h, 1.0, row) for h in (-1.0, 0.0, 1e-9, 0.01, 0.1, 1.0, 100.0, np.inf)]
    assert gains[0] == pytest.approx(4 / 15, rel=1e-12)
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] == 0
    assert ground_effect(0.1, 0.5, row) == pytest.approx(0.5 * ground_effect(0.1, 1.0, row))
    assert ground_effect(0.1, -1.0, row) == 0
    assert ground_effect(0.1, 1.0, row_of(name, ())[1]) == 0


def test_thrust_grows_near_the_surface_wherever_it_is():
    airframe, row = row_of("hummingbird")
    speed, q = np.full(4, airframe.hover_speed()), (0.0, 0.0, 0.0, 1.0)
    force, _ = wrench(
        q, np.zeros(3), 30.1, rotor_wrench(speed, row), still_air(surface=30.0), 0.0, row
    )
    assert force[2] == pytest.approx(0.0625 * airframe.mass * G, rel=1e-9)


# Downwash


@pytest.mark.parametrize(
    ("aside", "figures"), [(0.0, (0.26478, 0.07584, 0.01896)), (0.1, (0.07463, 0.02138, 0.01693))]
)
def test_downwash_figures_of_the_crazyflie(aside, figures):
    _, row = row_of("cf2x")
    for drop, figure in zip((0.5, 1.0, 2.0), figures, strict=True):
        assert downwash(aside**2, drop, G, row) == pytest.approx(figure, abs=6e-6)


@pytest.mark.parametrize("name", NAMES)
def test_downwash_has_no_singularity_and_never_exceeds_the_weight_above(name):
    airframe, row = row_of(name)
    for drop in (1e-300, 1e-3, 0.6875, 0.69, 10.0, 1e6):
        for aside in (0.0, 0.5, 5.0, 1e6):
            force = downwash(aside**2, drop, G, row)
            assert 0 <= force <= airframe.mass * G
    assert (
        downwash(0.25, 1e-3, G, row_of("cf2x")[1]) < 1e-6
    )  # the unbounded formula gives nine weights here
    assert downwash(0.0, 0.0, G, row) == downwash(0.0, -1.0, G, row) == 0
    assert downwash(0.0, 0.5, G, row_of(name, ())[1]) == 0


def wakes_of(position, alive, parameters):
    total = np.full(alive.shape[1], np.nan)
    wakes(0, position, alive, parameters, G, total)
    return total


def test_downwash_adds_up_over_living_drones_above():
    _, row = row_of("cf2x")
    parameters = np.array([[row] * 4])
    position = np.array([[(0, 0, 1), (0, 0, 2), (0.1, 0, 3), (0, 0, 0)]], dtype=float)
    alive = np.ones((1, 4), dtype=bool)
    expected = downwash(0.0, 1.0, G, row) + downwash(0.01, 2.0, G, row)
    assert wakes_of(position, alive, parameters)[0] == pytest.approx(expected, rel=1e-12)
    alive[0, 1] = False
    assert wakes_of(position, alive, parameters)[0] == pytest.approx(
        downwash(0.01, 2.0, G, row), rel=1e-12
    )
    assert wakes_of(position, alive, parameters)[2] == 0


def test_the_edge_of_wakes_leaves_nothing_out():
    """Against every pair of a mixed swarm by the published fit, without an edge."""
    rng = np.random.default_rng(0)
    for height in (0.5, 5.0, 60.0):
        airframes = [load_airframe(name) for name in rng.choice(NAMES, 40)]
        position = rng.uniform(0, 1, (1, 40, 3)) * (10, 10, height)
        expected = np.zeros(40)
        for lower, upper in itertools.permutations(range(40), 2):
            dx, dy, drop = position[0, upper] - position[0, lower]
            if drop > 0:
                above = airframes[upper]
                strength = min(2267.18 * (above.propeller_radius / (4 * drop)) ** 2, above.mass * G)
                width = max(0.16 * drop - 0.11, above.arm + above.propeller_radius)
                expected[lower] += strength * np.exp(-0.5 * (dx**2 + dy**2) / width**2)
        got = wakes_of(position, np.ones((1, 40), dtype=bool), parameter_rows(airframes)[None])
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-14)
        assert (got > 1e-3).sum() > 3
