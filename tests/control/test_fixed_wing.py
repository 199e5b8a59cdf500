"""Aeroplanes follow setpoints of all levels within their limits, and never stall."""

import math

import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.control.autopilot import (
    AUTOPILOT_MEMORY,
    PITCH_INTEGRAL,
    THRUST_INTEGRAL,
    autopilot_rows,
)
from bulletuav.control.setpoint import SetpointLevel, is_flying_speed
from bulletuav.geometry.rotation import axes, from_euler
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.envelope import find_envelope, find_trim
from tests.bench import Bench

TRAINER = load_airframe("trainer")
ENVELOPE = find_envelope(TRAINER)
CRUISE = ENVELOPE.cruise_speed
POSITION, VELOCITY, ACCELERATION, ATTITUDE, RATES, ROTOR = SetpointLevel
DECISION = 10 / 240


def cruising(wind=(0, 0, 0), drones=1, worlds=1, speed=CRUISE):
    """Aeroplanes in level flight to the east at 1,000 m."""
    bench = Bench(
        "rigid_body", airframe="trainer", drones=drones, worlds=worlds, substeps=10, wind=wind
    )
    return bench.place_trimmed(find_trim(TRAINER, speed))


def trace(bench, level, setpoint, seconds):
    """Position, velocity, air velocity along the body axes, and bank to the left, (T, ...)."""
    rows = []
    for _ in range(round(seconds / DECISION)):
        bench.fly(level, setpoint)
        swarm = bench.swarm
        x, y, z = map(np.array, axes(tuple(swarm.quaternion[0, 0].tolist())))
        air = swarm.velocity[0, 0] - bench.wind[0, 0]
        body = (x @ air, y @ air, z @ air)
        bank = math.atan2(-y[2], z[2])
        rows.append((swarm.position[0, 0].copy(), swarm.velocity[0, 0].copy(), body, bank))
    return tuple(map(np.array, zip(*rows, strict=True)))


def courses(velocity):
    return np.degrees(np.arctan2(velocity[:, 1], velocity[:, 0]))


def angles_of_attack(body):
    return np.degrees(np.arctan2(-body[:, 2], body[:, 0]))


def settled(values, seconds):
    """The last part of a trace."""
    return values[-round(seconds / DECISION) :]


def test_level_flight_stays_trimmed():
    position, velocity, _, _ = trace(cruising(), VELOCITY, (CRUISE, 0, 0, 0), 10)
    np.testing.assert_allclose(velocity, np.tile((CRUISE, 0, 0), (len(velocity), 1)), atol=0.05)
    assert np.ptp(position[:, 2]) < 0.1


@pytest.mark.parametrize("side", [1, -1])
def test_a_course_change_of_90_degrees_settles_without_overshoot(side):
    bench = cruising()
    position, velocity, body, bank = trace(bench, VELOCITY, (0, side * CRUISE, 0, 0), 10)
    course = side * courses(velocity)
    # Hand calculation: 90 degrees at g tan(bank) / V
    fastest = STANDARD_GRAVITY * math.tan(ENVELOPE.max_bank) / CRUISE
    reached = DECISION * np.argmax(course > 85)
    assert math.pi / 2 / fastest < reached < 2 * math.pi / 2 / fastest
    assert course.max() < 95
    np.testing.assert_allclose(settled(course, 4), 90, atol=1)
    assert np.degrees(side * bank).max() < np.degrees(ENVELOPE.max_bank) + 3
    assert np.ptp(position[:, 2]) < 0.5
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), CRUISE, atol=0.5)


@pytest.mark.parametrize("climb", [0.9 * ENVELOPE.max_climb, 2.0, -1.0])
def test_a_climb_is_followed_at_constant_airspeed(climb):
    _, velocity, body, _ = trace(cruising(), VELOCITY, (CRUISE, 0, climb, 0), 20)
    assert np.abs(np.linalg.norm(body, axis=1) - CRUISE).max() < 1.0
    np.testing.assert_allclose(settled(velocity[:, 2], 15), climb, atol=0.12 * abs(climb) + 0.2)
    np.testing.assert_allclose(settled(velocity[:, 2], 2), climb, atol=0.1)


def test_a_climb_beyond_the_limit_is_the_largest_climb():
    _, velocity, body, _ = trace(cruising(), VELOCITY, (CRUISE, 0, 9.0, 0), 25)
    np.testing.assert_allclose(settled(velocity[:, 2], 3), ENVELOPE.max_climb, atol=0.25)
    assert np.linalg.norm(body, axis=1).min() > ENVELOPE.min_speed


def test_speeds_are_reached_and_limited():
    bench = cruising()
    for commanded, flown in ((15.0, 15.0), (30.0, ENVELOPE.max_speed), (10.0, 10.0)):
        position, _, body, _ = trace(bench, VELOCITY, (commanded, 0, 0, 0), 25)
        speed = np.linalg.norm(body, axis=1)
        np.testing.assert_allclose(settled(speed, 3), flown, atol=0.25)
        assert speed.max() < ENVELOPE.max_speed + 0.5
        assert np.ptp(position[:, 2]) < 1.5


@pytest.mark.parametrize("commanded", [(0, 0, 0, 0), (5.0, 3.0, 0, 0)])
def test_below_the_minimum_speed_it_loiters_to_the_left(commanded):
    bench = cruising()
    trace(bench, VELOCITY, commanded, 15)
    position, velocity, body, _ = trace(bench, VELOCITY, commanded, 20)
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), ENVELOPE.min_speed, atol=0.3)
    # Half of the largest turn rate
    turn = np.unwrap(np.radians(courses(velocity)))
    rate = (turn[-1] - turn[0]) / (DECISION * (len(turn) - 1))
    fastest = STANDARD_GRAVITY * math.tan(ENVELOPE.max_bank) / ENVELOPE.min_speed
    assert rate == pytest.approx(0.5 * fastest, rel=0.05)
    assert np.ptp(position[:, 2]) < 0.5


@pytest.mark.parametrize("wind", [(0, 0, 0), (5, 0, 0)])
def test_it_flies_to_a_position_and_circles_it(wind):
    bench, goal = cruising(wind), np.array((150.0, 80.0, 1010.0))
    trace(bench, POSITION, (*goal, 0), 40)
    position, velocity, _, bank = trace(bench, POSITION, (*goal, 0), 20)
    away = position - goal
    # V^2 / (g tan(bank) / 2)
    radius = 2 * CRUISE**2 / (STANDARD_GRAVITY * math.tan(ENVELOPE.max_bank))
    np.testing.assert_allclose(np.hypot(away[:, 0], away[:, 1]), radius, atol=0.5)
    np.testing.assert_allclose(away[:, 2], 0, atol=0.3)
    # To the left
    assert (away[:, 0] * velocity[:, 1] - away[:, 1] * velocity[:, 0] > 0).all()
    if wind == (0, 0, 0):
        assert np.tan(bank) == pytest.approx(math.tan(ENVELOPE.max_bank) / 2, rel=0.03)


def test_the_velocity_is_that_over_ground_in_wind():
    bench = cruising((4, 3, 0))
    trace(bench, VELOCITY, (0, 13, 0, 0), 10)
    _, velocity, body, _ = trace(bench, VELOCITY, (0, 13, 0, 0), 10)
    np.testing.assert_allclose(settled(velocity, 1), [(0, 13, 0)] * 24, atol=0.2)
    # The wind triangle: 13 - 3 along, 4 across
    np.testing.assert_allclose(
        np.linalg.norm(settled(body, 1), axis=1), math.hypot(10, 4), atol=0.1
    )


def test_with_the_wind_it_keeps_the_minimum_airspeed_and_the_course():
    bench = cruising((0, 6, 0))
    trace(bench, VELOCITY, (0, 10, 0, 0), 20)
    _, velocity, body, _ = trace(bench, VELOCITY, (0, 10, 0, 0), 5)
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), ENVELOPE.min_speed, atol=0.3)
    np.testing.assert_allclose(courses(velocity), 90, atol=1)


def test_an_acceleration_turns_climbs_and_speeds_up():
    turned = trace(cruising(), ACCELERATION, (0, 3.0, 0, 0), 0.8)
    # The lateral acceleration is g tan(bank)
    assert math.tan(turned[3][-1]) == pytest.approx(3 / STANDARD_GRAVITY, rel=0.1)
    faster = trace(cruising(), ACCELERATION, (1.0, 0, 0, 0), 3)
    assert faster[1][-1, 0] == pytest.approx(CRUISE + 3, abs=0.8)
    up = trace(cruising(), ACCELERATION, (0, 0, 0.5, 0), 3)
    assert up[1][-1, 2] == pytest.approx(1.5, abs=0.7)


def test_an_attitude_is_held_in_a_coordinated_turn():
    # In FLU axes a left bank is a negative roll, and a raised nose a negative pitch
    bench = cruising()
    _, velocity, body, bank = trace(bench, ATTITUDE, (-0.5, -0.05, 2.0, 2.5), 6)
    assert settled(bank, 2) == pytest.approx(0.5, abs=0.03)
    assert np.degrees(np.arctan2(body[-1, 1], body[-1, 0])) == pytest.approx(0, abs=1)
    turn = np.unwrap(np.radians(settled(courses(velocity), 2)))
    rate = (turn[-1] - turn[0]) / (DECISION * (len(turn) - 1))
    airspeed = np.linalg.norm(body[-1])
    assert rate == pytest.approx(STANDARD_GRAVITY * math.tan(0.5) / airspeed, rel=0.05)


def test_rates_are_followed():
    bench = cruising()
    bench.fly(RATES, (1.0, 0, 0, 2.5), 12)
    assert bench.swarm.rates[0, 0, 0] == pytest.approx(1.0, abs=0.15)
    bench = cruising()
    bench.fly(RATES, (0, -0.3, 0, 2.5), 12)
    assert bench.swarm.rates[0, 0, 1] == pytest.approx(-0.3, abs=0.1)


def test_rotor_speeds_and_deflections_are_passed_through():
    bench = cruising()
    bench.fly(ROTOR, (600.0, 0.1, -0.1, -9.0, 0.2), 30)
    low = [one.low for one in TRAINER.surfaces][2]
    np.testing.assert_allclose(bench.swarm.deflection[0, 0], (0.1, -0.1, low, 0.2))
    assert bench.swarm.rotor_speed[0, 0, 0] == pytest.approx(600, rel=1e-3)


def test_random_velocities_never_stall():
    """Property: the airspeed and the angle of attack stay within the limits."""
    wing = TRAINER.wings[0]
    stall = wing.stall + wing.zero_lift - wing.incidence
    rng, bench = np.random.default_rng(3), cruising(worlds=16, drones=4)
    for _ in range(20):
        wanted = np.zeros((16, 4, 4))
        wanted[..., :3] = rng.uniform(-18, 18, (16, 4, 3))
        wanted[..., 2] /= 3
        for _ in range(24):
            bench.dynamics.fly(bench.swarm, bench.alive, VELOCITY, wanted, bench.wind, bench.motion)
            airspeed = np.linalg.norm(bench.swarm.velocity, axis=-1)
            assert airspeed.min() > ENVELOPE.stall_speed
            for w in range(16):
                for i in range(4):
                    x, _, z = map(np.array, axes(tuple(bench.swarm.quaternion[w, i].tolist())))
                    air = bench.swarm.velocity[w, i]
                    assert math.atan2(-(z @ air), x @ air) < stall


@pytest.mark.parametrize(
    ("rotation", "loss"),
    [((math.pi, 0, 0), 6), ((math.pi, 1.0, 0), 24), ((0, 1.5, 0), 26), ((1.5, 0, 0), 3)],
    ids=["inverted", "inverted and nose down", "nose down", "knife edge"],
)
def test_it_recovers_from_an_upset(rotation, loss):
    bench = cruising()
    quaternion = from_euler(*rotation)
    bench.swarm.quaternion[0, 0] = quaternion
    bench.swarm.velocity[0, 0] = 14.0 * np.array(axes(quaternion)[0])
    bench.place()
    position, velocity, body, bank = trace(bench, VELOCITY, (CRUISE, 0, 0, 0), 8)
    assert position[:, 2].min() > 1000 - loss
    assert np.abs(np.degrees(settled(bank, 4))).max() < 5
    assert np.abs(settled(velocity[:, 2], 4)).max() < 1
    assert angles_of_attack(body).max() < 12


def test_integrals_learn_a_heavier_aircraft():
    bench = cruising()
    bench.dynamics.flight.parameters["mass"] *= 1.1
    _, velocity, body, _ = trace(bench, VELOCITY, (CRUISE, 0, 2.0, 0), 30)
    np.testing.assert_allclose(settled(velocity[:, 2], 3), 2.0, atol=0.15)
    np.testing.assert_allclose(np.linalg.norm(settled(body, 3), axis=1), CRUISE, atol=0.3)
    first = bench.dynamics.flight.cascade.memory.shape[-1] - AUTOPILOT_MEMORY
    memory = bench.dynamics.flight.cascade.memory[0, 0, first:]
    assert abs(memory[THRUST_INTEGRAL]) > 0.1
    assert abs(memory[PITCH_INTEGRAL]) > 1e-3


@pytest.mark.parametrize(
    ("level", "setpoint"),
    [
        (ATTITUDE, (0, 0, 0, 3.0)),
        (RATES, (0, 0, 0, 3.0)),
        (ROTOR, (700.0, 0, 0, 0, 0)),
    ],
)
def test_a_pause_of_the_outer_loops_leaves_no_stale_airspeed(level, setpoint):
    bench = cruising()
    for _ in range(24):
        bench.fly(VELOCITY, (CRUISE, 0, 0, 0))
    for _ in range(6):
        bench.fly(level, setpoint)
    bench.swarm.velocity[0, 0] *= 1.3
    bench.fly(level, setpoint)
    bench.fly(VELOCITY, (1.3 * CRUISE, 0, 0, 0))
    memory = bench.dynamics.flight.cascade.memory[0, 0]
    assert abs(memory[len(memory) - AUTOPILOT_MEMORY + PITCH_INTEGRAL]) < 0.02


def test_the_minimum_speed_itself_is_flown_in_all_directions():
    slowest = ENVELOPE.min_speed
    headings = np.linspace(-math.pi, math.pi, 64)
    wanted = np.zeros((16, 4, 4))
    wanted[..., 0] = (slowest * np.cos(headings)).reshape(16, 4)
    wanted[..., 1] = (slowest * np.sin(headings)).reshape(16, 4)
    bench = cruising(worlds=16, drones=4)
    for _ in range(240):
        bench.dynamics.fly(bench.swarm, bench.alive, VELOCITY, wanted, bench.wind, bench.motion)
    np.testing.assert_allclose(bench.swarm.velocity[..., :2], wanted[..., :2], atol=0.5)


def test_rounding_is_no_slow_command():
    assert is_flying_speed(3.0, 4.0, 5.0)
    assert is_flying_speed(5.0 * (1 - 1e-7), 0.0, 5.0)
    assert not is_flying_speed(5.0 * (1 - 1e-5), 0.0, 5.0)


def test_the_stall_protection_keeps_a_level_nose_in_a_climb():
    """At a low angle of attack, far from the stall, it does not push the nose down."""
    bench = cruising()
    bench.swarm.velocity[0, 0] = (0.8 * CRUISE, 0, 0.3 * CRUISE)
    lowest = 1.0
    for _ in range(24):
        bench.fly(ATTITUDE, (0, 0, 0, 3.0))
        lowest = min(lowest, axes(tuple(bench.swarm.quaternion[0, 0].tolist()))[0][2])
    assert lowest > -0.02


def test_one_aircraft_alone_flies_as_one_of_64():
    alone, many = cruising(), cruising(worlds=16, drones=4)
    for bench in (alone, many):
        bench.fly(VELOCITY, (5.0, 12.0, 1.0, 0), 40)
        bench.fly(POSITION, (0.0, 0.0, 990.0, 0), 40)
    for one, other in zip(alone.swarm, many.swarm, strict=True):
        np.testing.assert_array_equal(one[0, 0], other[7, 0])


def test_constants_match_hand_calculations():
    row = autopilot_rows([TRAINER], 50.0)[0]
    trim = find_trim(TRAINER, CRUISE)
    assert row["alpha"][0] + row["alpha"][1] / CRUISE**2 == pytest.approx(trim.alpha, abs=2e-3)
    # Thrust of the trim: k_f w^2 - k_z w V
    speed = trim.speed[0]
    thrust = TRAINER.thrust_coefficient * speed**2 - TRAINER.drag_z * speed * CRUISE
    drag = row["drag"][0] * CRUISE**2 + row["drag"][1] / CRUISE**2
    assert drag == pytest.approx(thrust, rel=0.02)
    elevator = row["trim"][2]
    assert elevator[0] + elevator[1] / CRUISE**2 == pytest.approx(trim.deflection[2], abs=3e-3)
    # Slow options slow flights to positions down, to the minimum speed at least
    speeds = [autopilot_rows([TRAINER], most)[0]["cruise_speed"] for most in (50.0, 10.0, 5.0)]
    assert speeds == [CRUISE, 10.0, ENVELOPE.min_speed]
    # Roll damping of a rectangular wing by strip theory: q S b^2 a / (12 V)
    slope = TRAINER.wings[0].lift_slope
    span, chord = 2 * TRAINER.wings[0].span, TRAINER.wings[0].chord
    strip = 0.5 * 1.225 * span**3 * chord * slope / 12
    assert row["rate_damping"][0] == pytest.approx(strip, rel=0.05)
    # The allocation gives torques about one axis only
    ailerons = row["mixer"][:2, 0]
    assert ailerons[0] == pytest.approx(-ailerons[1], rel=1e-6)
    np.testing.assert_allclose(
        row["mixer"][
            2,
            (0, 2),
        ],
        0,
        atol=1e-9,
    )


def test_multirotors_have_no_autopilot():
    assert autopilot_rows([load_airframe("cf2x")], 5.0) is None
    mixed = autopilot_rows([load_airframe("cf2x"), TRAINER], 20.0)
    assert mixed["is_winged"].tolist() == [0, 1]
