import math

import numpy as np
import pytest
from bench import MULTIROTORS
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.vehicle.aerodynamics import drag, ground_effect, ground_wrench, num_lifted_rotors
from bulletuav.vehicle.parameters import EFFECTS, parameter_rows
from bulletuav.vehicle.rotors import (
    lag_decay,
    lag_rates,
    rotor_acceleration,
    rotor_speed_after,
    rotor_wrench,
)
from bulletuav.vehicle.wrench import body_acceleration, compute_wrench, damping_torque

G = 9.80665
NAMES = MULTIROTORS
LEVEL = (0.0, 0.0, 0.0, 1.0)
ZERO = (0.0, 0.0, 0.0)


def row_of(name, effects=None):
    airframe = load_airframe(name)
    return airframe, parameter_rows([airframe], *([] if effects is None else [effects]))[0]


def still_air(surface=-np.inf, wind=ZERO):
    return np.array(wind), surface, G, ZERO, ZERO


def wrench_of(row, speed, quaternion=LEVEL, velocity=ZERO, altitude=1e9, **air):
    speed = np.asarray(speed, float)
    rotors = rotor_wrench(speed, 0.0, row)
    around = still_air(**air)
    lifted = num_lifted_rotors(altitude - around[1], velocity[2], 0.0, row)
    force, torque = compute_wrench(
        quaternion, np.array(velocity), altitude, speed, rotors, around, lifted, row
    )
    return np.array(force), np.array(torque)


# Rotors


def after(speed, command, elapsed, row):
    return rotor_speed_after(speed, command, lag_decay(elapsed, row))


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
    assert rotor_acceleration(5.0, 900.0, lag_rates(row)) == 0


@pytest.mark.parametrize("name", NAMES)
def test_hover_balances_weight_to_1e9(name):
    airframe, row = row_of(name)
    force, torque = wrench_of(row, np.full(len(airframe.rotors), airframe.hover_speed()))
    np.testing.assert_allclose(force, 0, atol=1e-9)
    np.testing.assert_allclose(torque, 0, atol=1e-9)


def test_torques_of_single_rotors_by_hand():
    """k_f w^2 is 0.021885 N at 1000 rad/s, the drag torque 0.00596 m times that."""
    airframe, row = row_of("cf2x")
    for r, (x, y, turn) in enumerate(airframe.rotors):
        speed = np.zeros(4)
        speed[r] = 1000.0
        thrust, torque, total, momentum = rotor_wrench(speed, 0.0, row)
        assert (thrust, total) == (pytest.approx(0.021885), 1000.0)
        assert momentum == pytest.approx(-turn * 2.697e-8 * 1000)
        np.testing.assert_allclose(
            torque, (y * 0.021885, -x * 0.021885, turn * 0.021885 * 0.00596), rtol=1e-12
        )


def test_faster_clockwise_rotors_turn_the_crazyflie_to_the_left():
    _, row = row_of("cf2x")
    _, torque, _, _ = rotor_wrench(np.array([1000.0, 1100.0, 1000.0, 1100.0]), 0.0, row)
    np.testing.assert_allclose(torque[:2], 0, atol=1e-12)
    assert torque[2] > 0


def test_rotors_that_speed_up_turn_the_body_by_their_own_momentum():
    """2.697e-8 kg m^2 at 100 rad/s in 0.065 s: 4.149e-5 N m at first, against the rotor's spin."""
    _, row = row_of("cf2x")
    first = rotor_acceleration(1700.0, 1800.0, lag_rates(row))
    assert first == pytest.approx(100 / 0.065)
    calm = rotor_wrench(np.full(4, 1700.0), 0.0, row)
    faster = rotor_wrench(np.full(4, 1700.0), first, row)
    assert faster[1][2] - calm[1][2] == pytest.approx(4.149e-5, rel=1e-3)
    assert faster[0] == calm[0]
    assert rotor_wrench(np.full(4, 1700.0), first, row_of("cf2x", ("lag",))[1])[1] == calm[1]


# Rates


def test_damping_is_the_share_that_the_airframe_tells_at_hover():
    airframe, row = row_of("cf2x")
    total = 4 * airframe.hover_speed()
    slowed = body_acceleration((1.0, -2.0, 0.5), ZERO, total, 0.0, row)
    gyroscopic = body_acceleration((1.0, -2.0, 0.5), ZERO, 0.0, 0.0, row)
    np.testing.assert_allclose(np.subtract(slowed, gyroscopic), (-3.0, 6.0, -1.25), rtol=1e-12)
    assert damping_torque((1.0, 1.0, 1.0), 0.0, row) == (0, 0, 0)


spin = st.tuples(*[st.floats(-30, 30)] * 3)


@given(spin, st.floats(0, 1e4), st.floats(-1e-4, 1e-4))
def test_rotors_that_spin_take_energy_by_damping_only(rates, total, momentum):
    """The gyroscope and the body's own precession do no work; damping never gives any."""
    airframe, row = row_of("cf2x")
    power = np.dot(
        np.multiply(airframe.inertia, rates),
        body_acceleration(rates, ZERO, total, momentum, row),
    )
    lost = np.dot(damping_torque(rates, total, row), rates)
    assert lost >= 0
    assert power == pytest.approx(-lost, abs=1e-12 * (1 + np.dot(rates, rates)))


def test_a_gyroscope_precesses_by_hand():
    """h = -1e-5 N m s about z, rolling at 2 rad/s: M_y = 2 h, over 1.68e-5 kg m^2."""
    _, row = row_of("cf2x", ())
    assert body_acceleration((2.0, 0.0, 0.0), ZERO, 0.0, -1e-5, row) == (
        0,
        pytest.approx(-2e-5 / 1.68e-5),
        0,
    )


# Drag

ROTORS_ONLY = tuple(effect for effect in EFFECTS if effect != "body_drag")


@pytest.mark.parametrize(
    ("name", "tilt", "rotor_speed", "v"),
    [
        ("cf2x", 11.966, 1753.64, 5.0),
        ("cf2x", 23.488, 1797.90, 10.0),
        ("cf2x", 43.821, 1985.18, 20.0),
        ("racer", 39.69, 2059.3, 20.0),
        ("hummingbird", 21.86, 436.6, 20.0),
        ("iris", 15.66, 647.9, 20.0),
        ("firefly", 18.75, 526.3, 20.0),
    ],
)
def test_level_flight_needs_the_tilt_that_the_rotors_drag_tells(name, tilt, rotor_speed, v):
    """Without body drag: m g sin t = k_xy sum(w) v cos t, m g cos t + k_z sum(w) v sin t = T."""
    airframe, row = row_of(name, ROTORS_ONLY)
    pitch = Rotation.from_euler("y", tilt, degrees=True).as_quat()
    speeds = np.full(len(airframe.rotors), rotor_speed)
    force, _ = wrench_of(row, speeds, pitch, (v, 0, 0))
    np.testing.assert_allclose(force / (airframe.mass * G), 0, atol=4e-4)


vector = st.tuples(*[st.floats(-30, 30)] * 3)


@given(vector, st.tuples(*[st.floats(-3, 3)] * 3))
def test_drag_takes_power_and_turns_with_the_body(v, turn):
    _, row = row_of("cf2x")
    q = Rotation.from_rotvec(turn)
    force, torque = drag(q.as_quat(), v, 6000.0, row)
    assert np.dot(force, v) <= 1e-12
    body, same = drag(LEVEL, q.inv().apply(v), 6000.0, row)
    np.testing.assert_allclose(force, q.apply(body), atol=1e-10)
    np.testing.assert_allclose(torque, same, atol=1e-12)


def test_drag_by_hand():
    """At 4 m/s forwards and 3 m/s up: 1.6e-6 * 7000 * 4 and 1.4e-6 * 7000 * 3 of the rotors.

    The body adds 1.225 / 2 * 5e-4 * 5 * 4 and 1.225 / 2 * 35e-4 * 5 * 3. That of the rotors acts
    34 mm above the centre of mass and pitches the nose up.
    """
    _, row = row_of("cf2x")
    force, torque = drag(LEVEL, (4.0, 0.0, 3.0), 7000.0, row)
    np.testing.assert_allclose(force, (-0.0448 - 0.006125, 0, -0.0294 - 0.03215625), rtol=1e-12)
    np.testing.assert_allclose(torque, (0, -0.0448 * 0.034, 0), rtol=1e-12)
    _, torque = drag(LEVEL, (0.0, 2.0, 0.0), 7000.0, row)
    np.testing.assert_allclose(torque, (0.0224 * 0.034, 0, 0), rtol=1e-12)


def test_drag_is_relative_to_the_air_and_linear_in_rotor_speed():
    _, row = row_of("hummingbird", ROTORS_ONLY)
    with_wind, torque = wrench_of(row, np.full(4, 450.0), velocity=(3.0, 0, 0), wind=(3.0, 0, 0))
    np.testing.assert_allclose(with_wind[:2], 0, atol=1e-15)
    np.testing.assert_allclose(torque, 0, atol=1e-15)
    force, _ = drag(LEVEL, (1.0, 2.0, 3.0), 1800.0, row)
    np.testing.assert_allclose(force, (-8.06428e-5 * 1800, -2 * 8.06428e-5 * 1800, 0))


@pytest.mark.parametrize("name", NAMES)
def test_a_drone_with_stopped_rotors_falls_at_a_terminal_speed(name):
    airframe, row = row_of(name)
    terminal = math.sqrt(2 * airframe.mass * G / (1.225 * airframe.body_drag[1]))
    assert 8 < terminal < 30
    force, _ = wrench_of(row, np.zeros(len(airframe.rotors)), velocity=(0, 0, -terminal))
    np.testing.assert_allclose(force, 0, atol=1e-12)


# Ground effect


def test_ground_effect_figures():
    """0.27 (1 - h / 6.2 R)^3, by hand: R is 0.0231348 m and 0.1 m."""
    heights = (0.0, 0.03, 0.1, 0.3)
    for name, shares in (
        ("cf2x", (0.27, 0.1335492, 0.007497798, 0.0)),
        ("hummingbird", (0.27, 0.2326723, 0.1592937, 0.03712262)),
    ):
        _, row = row_of(name)
        for height, share in zip(heights, shares, strict=True):
            assert ground_effect(height, row) == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_ground_effect_is_bounded_and_falls_with_height(name):
    _, row = row_of(name)
    gains = [ground_effect(h, row) for h in (-1.0, 0.0, 1e-9, 0.01, 0.1, 1.0, 100.0, np.inf)]
    assert gains[:2] == [0.27, 0.27]
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] == 0
    assert ground_effect(0.1, row_of(name, ())[1]) == 0


@pytest.mark.parametrize("name", NAMES)
def test_ground_effect_lifts_the_lower_side_of_a_tilted_drone(name):
    airframe, row = row_of(name)
    speed = np.full(len(airframe.rotors), airframe.hover_speed())
    for axis, k in (("x", 0), ("y", 1)):
        for tilt in (-0.2, 0.2):
            q = Rotation.from_euler(axis, tilt).as_quat()
            near = wrench_of(row, speed, q, altitude=2 * airframe.propeller_radius, surface=0.0)[1]
            assert near[k] * tilt < 0
            assert abs(near[2]) < 1e-9


def test_the_levelling_torque_by_hand():
    """Two rotors 0.17 m ahead and behind, pitched by 0.2 rad at 0.2 m: 0.166 and 0.234 m high."""
    airframe, row = row_of("hummingbird")
    lean = (-math.sin(0.2), 0.0, math.cos(0.2))
    speed = np.full(4, airframe.hover_speed())
    thrust, torque_x, torque_y = ground_wrench(0.2, lean, speed, 4, row)
    each = airframe.mass * G / 4
    share = [0.27 * (1 - h / 0.62) ** 3 * math.cos(0.2) for h in (0.166226, 0.2, 0.2, 0.233774)]
    assert thrust == pytest.approx(each * sum(share), rel=1e-5)
    assert torque_x == pytest.approx(0, abs=1e-12)
    assert torque_y == pytest.approx(-0.17 * each * (share[0] - share[3]), rel=1e-4)


def test_ground_effect_fades_with_tilt_and_ends_where_nothing_is_left():
    airframe, row = row_of("cf2x")
    speed = np.full(4, airframe.hover_speed())
    assert ground_wrench(0.05, (0.0, 0.0, -1.0), speed, 4, row) == (0, 0, 0)
    assert ground_wrench(0.05, (1.0, 0.0, 0.0), speed, 4, row) == (0, 0, 0)
    edge = airframe.ground_effect_reach
    assert ground_wrench(edge, (0.0, 0.0, 1.0), speed, 4, row) == (0, 0, 0)
    just_below = ground_wrench(0.999 * edge, (0.0, 0.0, 1.0), speed, 4, row)[0]
    assert 0 < just_below < 1e-9 * airframe.mass * G
    # The lower side of a drone that leans is reached from higher up
    aside = ground_wrench(edge + 0.01, (0.6, 0.0, 0.8), speed, 4, row)
    assert aside[0] > 0
    assert aside[2] != 0
    assert ground_wrench(0.05, (0.0, 0.0, 1.0), speed, 4, row_of("cf2x", ())[1]) == (0, 0, 0)


@given(st.floats(0, 0.4), st.floats(-5, 5), st.tuples(*[st.floats(-2, 2)] * 3))
def test_rotors_that_are_left_out_have_no_ground_effect(height, climb, turn):
    airframe, row = row_of("cf2x")
    speed = np.full(4, airframe.hover_speed())
    lean = tuple(Rotation.from_rotvec(turn).as_matrix()[2])
    lifted = num_lifted_rotors(height, climb, 0.01, row)
    for now in (height, height + 0.01 * climb):
        whole = ground_wrench(now, lean, speed, 4, row)
        assert ground_wrench(now, lean, speed, lifted, row) == whole


def test_a_surface_lifts_all_rotors_or_none():
    airframe, row = row_of("firefly")
    edge = airframe.ground_effect_reach + airframe.arm
    assert num_lifted_rotors(edge + 0.001, 0.0, 0.01, row) == 0
    assert num_lifted_rotors(edge - 0.001, 0.0, 0.01, row) == 6
    assert num_lifted_rotors(edge + 0.001, -1.0, 0.01, row) == 6
    assert num_lifted_rotors(0.01, 0.0, 0.01, row_of("firefly", ())[1]) == 0


def test_thrust_grows_near_the_surface_wherever_it_is():
    airframe, row = row_of("hummingbird")
    force, _ = wrench_of(row, np.full(4, airframe.hover_speed()), altitude=30.1, surface=30.0)
    assert force[2] == pytest.approx(0.1592937 * airframe.mass * G, rel=1e-6)
