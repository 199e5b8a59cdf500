"""Flights of aircraft with wings: steady flight, modes, energy, invariances, against textbooks."""

import math
from dataclasses import replace

import numpy as np
import pytest
import stability
from scipy.spatial.transform import Rotation
from stability import G

from bulletuav import load_airframe
from bulletuav.vehicle.envelope import air_wrench, find_climb, find_envelope, find_trim
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wings import wing_rows

TRAINER, QUADPLANE = load_airframe("trainer"), load_airframe("quadplane")
BOTH = pytest.mark.parametrize("airframe", [TRAINER, QUADPLANE], ids=["trainer", "quadplane"])
DYNAMICS = ("rigid_body", "bullet")
# A loaded glider of 25 times the weight is fast, so that its pitch settles long before its speed.
# Its controller, which is not used, needs an aircraft that can fly level
FACTOR = 25
THRUST = {"thrust_coefficient": FACTOR * TRAINER.thrust_coefficient, "max_speed": 100.0}
HEAVY = replace(TRAINER, name="heavy", mass=FACTOR * TRAINER.mass, **THRUST)


# Steady flight


@pytest.mark.parametrize("dynamics", DYNAMICS)
@BOTH
@pytest.mark.parametrize("bank", [0.0, -0.5])
def test_trimmed_flights_are_steady(make_bench, dynamics, airframe, bank):
    """Airspeed, climb and turn rate stay for five seconds without any control."""
    trim = find_trim(airframe, 13.0, 0.05, bank)
    bench = make_bench(dynamics, airframe, substeps=240).place_trimmed(trim)
    velocity = bench.swarm.velocity[0, 0]
    begin = math.atan2(velocity[1], velocity[0])
    bench.hold(trim.speed, trim.deflection, 5)
    assert np.linalg.norm(velocity) == pytest.approx(13.0, rel=1e-4)
    assert velocity[2] == pytest.approx(13.0 * math.sin(0.05), rel=1e-3)
    turned = math.atan2(velocity[1], velocity[0]) - begin
    # To the right for a positive bank: g tan(bank) / V
    assert turned == pytest.approx(-5 * G * math.tan(bank) / 13.0, rel=1e-3, abs=1e-4)


def test_a_turn_has_the_load_factor_of_its_bank(make_bench):
    """At 0.7 rad: lift 1 / cos(0.7) = 1.3075 weights, and a circle of V^2 / (g tan) = 20.46 m."""
    trim = find_trim(TRAINER, 13.0, 0.0, 0.7)
    bench = make_bench("rigid_body", TRAINER, hz=480, substeps=1).place_trimmed(trim)
    swarm = bench.swarm
    before = swarm.velocity[0, 0].copy()
    bench.hold(trim.speed, trim.deflection)
    felt = (swarm.velocity[0, 0] - before) * 480 + (0, 0, G)
    assert np.linalg.norm(felt) / G == pytest.approx(1.3075, rel=5e-3)
    bench = make_bench("rigid_body", TRAINER, substeps=24).place_trimmed(trim)
    places = []
    for _ in range(3):
        # About a third of a circle of 9.89 s
        bench.hold(trim.speed, trim.deflection, 33)
        places.append(bench.swarm.position[0, 0, :2].copy())
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(chords / (2 * math.sin(3.3 * math.pi / 9.89)), 20.46, rtol=5e-3)


def test_a_glide_loses_the_height_of_its_drag(make_bench):
    """At 13 m/s lift to drag is 7.1 by the drag polar: 5 s of glide lose 9.08 m."""
    trim = find_climb(TRAINER, 13.0, 0.0)
    bench = make_bench("rigid_body", TRAINER, substeps=240).place_trimmed(trim)
    bench.hold(trim.speed, trim.deflection, 5)
    load = math.cos(trim.climb)
    lift = stability.level_lift(TRAINER, 13.0, load)
    angle = math.atan(stability.drag_polar(TRAINER, lift) / lift)
    lost = 1000 - bench.swarm.position[0, 0, 2]
    assert lost == pytest.approx(5 * 13.0 * math.sin(angle), rel=0.02)
    assert lost == pytest.approx(9.08, rel=0.02)


def test_below_the_stall_speed_it_falls(make_bench):
    """Full up elevator with stopped rotors: the sink is more than in any glide above the stall."""
    trim = find_climb(TRAINER, 8.2, 0.0)
    bench = make_bench("rigid_body", TRAINER, substeps=240).place_trimmed(trim)
    bench.hold(trim.speed, (0.0, 0.0, TRAINER.surfaces[2].low, 0.0), 4)
    sunk = (1000 - bench.swarm.position[0, 0, 2]) / 4
    assert sunk > 1.5 * find_envelope(TRAINER).max_sink


# Modes


def flown_modes(make_bench, airframe, trim, seconds, lateral=False):
    """Eigenvalues (1/s) of small motions about a steady flight, from eight flights.

    Each of the four states (u, w, q, theta, or v, p, r, phi) is changed up and down by a little.
    The matrix of the changes after some seconds is the exponential of the linear model's.
    """
    options = {"substeps": 24, "worlds": 8, "max_speed": airframe.max_speed}
    bench = make_bench("rigid_body", airframe, **options).place_trimmed(trim)
    swarm = bench.swarm
    attitude = Rotation.from_quat(swarm.quaternion[0, 0])
    ahead = attitude.inv().apply(swarm.velocity[0, 0])
    sizes = (1e-3, 1e-3, 1e-3, 1e-4)
    for w in range(8):
        k, change = w // 2, sizes[w // 2] * (1 if w % 2 == 0 else -1)
        state = np.zeros((3, 3))
        place = (
            [(0, 1), (1, 0), (1, 2), (2, 0)][k] if lateral else [(0, 0), (0, 2), (1, 1), (2, 1)][k]
        )
        state[place] = change
        turned = attitude * Rotation.from_rotvec(state[2])
        swarm.velocity[w] = turned.apply(ahead + state[0])
        swarm.rates[w], swarm.quaternion[w] = state[1], turned.as_quat()
    bench.place().hold(trim.speed, trim.deflection, round(10 * seconds))
    ends = []
    for w in range(8):
        turned = Rotation.from_quat(swarm.quaternion[w, 0])
        u, v, w_up = turned.inv().apply(swarm.velocity[w, 0])
        p, q, r = swarm.rates[w, 0]
        _, pitch, roll = turned.as_euler("ZYX")
        ends.append((v, p, r, roll) if lateral else (u, w_up, q, pitch))
    up, down = np.array(ends[::2]), np.array(ends[1::2])
    change = (up - down).T / (2 * np.array(sizes))
    return np.log(np.linalg.eigvals(change).astype(complex)) / seconds


def slow_and_fast(values):
    ordered = sorted(values, key=abs)
    return [(abs(one), -one.real / abs(one)) for one in (ordered[0], ordered[-1])]


@BOTH
def test_longitudinal_modes_are_those_of_the_stability_derivatives(make_bench, airframe):
    """Phugoid and short period in a glide, against the eigenvalues of the textbook's matrix."""
    trim = find_climb(airframe, 13.0, 0.0)
    phugoid, short = slow_and_fast(flown_modes(make_bench, airframe, trim, 0.3))
    matrix = stability.longitudinal_matrix(airframe, 13.0, trim.climb)
    by_hand = stability.modes(matrix)
    assert phugoid == pytest.approx(by_hand[0], rel=0.05)
    assert short == pytest.approx(by_hand[1], rel=0.02)
    # The textbook's approximation of the short period: pitch and plunge at constant speed
    assert short == pytest.approx(stability.short_period(airframe, 13.0), rel=0.03)


def test_the_phugoid_of_a_heavy_glider_is_lanchesters(make_bench):
    """T = pi sqrt(2) V / g = 29.45 s at 65 m/s.

    In a glide gravity acts along the path as well, so the damping ratio is 3 / (2 sqrt(2)) D / L
    instead of D / (sqrt(2) L). The trainer itself is so light that its pitch does not settle
    first: there the approximation is wrong by 47 %.
    """
    airspeed = 13.0 * math.sqrt(FACTOR)
    trim = find_climb(HEAVY, airspeed, 0.0)
    (frequency, damping), _ = slow_and_fast(flown_modes(make_bench, HEAVY, trim, 0.1))
    period = 2 * math.pi / (frequency * math.sqrt(1 - damping**2))
    assert period == pytest.approx(math.pi * math.sqrt(2) * airspeed / G, rel=0.05)
    assert period == pytest.approx(29.45, rel=0.05)
    lift = stability.level_lift(HEAVY, airspeed)
    ratio = stability.drag_polar(HEAVY, lift) / lift
    assert damping == pytest.approx(3 / (2 * math.sqrt(2)) * ratio, rel=0.05)


def test_the_phugoid_is_seen_in_a_long_flight(make_bench):
    """Faster by 0.5 m/s at first: airspeed crosses its mean after half a period, on and on."""
    trim = find_climb(TRAINER, 13.0, 0.0)
    bench = make_bench("rigid_body", TRAINER, substeps=48).place_trimmed(trim)
    bench.swarm.velocity[:] *= 1 + 0.5 / 13.0
    bench.place()
    faster = []
    for _ in range(110):
        bench.hold(trim.speed, trim.deflection)
        faster.append(np.linalg.norm(bench.swarm.velocity[0, 0]) - 13.0)
    crossings = np.flatnonzero(np.diff(np.sign(faster)))
    assert len(crossings) >= 4
    frequency, damping = stability.modes(stability.longitudinal_matrix(TRAINER, 13.0, trim.climb))[
        0
    ]
    half = math.pi / (frequency * math.sqrt(1 - damping**2)) / 0.2
    assert np.diff(crossings[:4]).mean() == pytest.approx(half, rel=0.05)


@BOTH
def test_roll_subsides_as_by_strip_theory(make_bench, airframe):
    """L_p / J_x of wing and tailplane: 30.5 1/s for the trainer."""
    trim = find_climb(airframe, 13.0, 0.0)
    values = flown_modes(make_bench, airframe, trim, 0.1, lateral=True)
    by_hand = stability.roll_damping(airframe, 13.0)
    assert -min(values.real) == pytest.approx(by_hand, rel=0.05)


@BOTH
def test_both_aircraft_are_stable_but_for_a_slow_spiral(make_bench, airframe):
    """The spiral doubles in more than 7 s, all other modes are damped.

    Level 1 of MIL-F-8785C has 0.08 for the damping ratio of the Dutch roll.
    """
    trim = find_trim(airframe, find_envelope(airframe).cruise_speed)
    values = [
        *flown_modes(make_bench, airframe, trim, 0.2),
        *flown_modes(make_bench, airframe, trim, 0.2, lateral=True),
    ]
    assert max(one.real for one in values) < math.log(2) / 7
    dutch = [one for one in values[4:] if abs(one.imag) > 1e-3]
    assert len(dutch) == 2
    assert -dutch[0].real / abs(dutch[0]) > 0.08


# Energy and invariances


def random_flight(make_bench, airframe, seed, dynamics="rigid_body", **options):
    """A bench in random attitudes and rates near cruise speed, and commands."""
    rng = np.random.default_rng(seed)
    bench = make_bench(dynamics, airframe, hz=480, **{"substeps": 48, **options})
    bench.place_trimmed(find_trim(airframe, 14.0))
    swarm, worlds = bench.swarm, len(bench.alive)
    swarm.velocity[:] += rng.normal(0, 3, swarm.velocity.shape)
    swarm.rates[:] = rng.normal(0, 1, swarm.rates.shape)
    swarm.quaternion[:, 0] = Rotation.random(worlds, random_state=seed).as_quat()
    bench.place()
    speed = rng.uniform(100, 700, len(airframe.rotors))
    return bench, speed, rng.uniform(-0.3, 0.3, len(airframe.surfaces))


@BOTH
def test_energy_changes_by_the_work_of_the_air(make_bench, airframe):
    """Kinetic and potential energy over 0.2 s, against the integral of force and torque power."""
    bench, speed, deflection = random_flight(make_bench, airframe, 1, substeps=1)
    row, wing = parameter_rows([airframe])[0], wing_rows([airframe])[0]
    swarm = bench.swarm
    swarm.rotor_speed[:], swarm.deflection[:] = speed, deflection
    bench.place()

    def energy():
        velocity, rates = swarm.velocity[0, 0], swarm.rates[0, 0]
        turning = 0.5 * np.dot(airframe.inertia, rates**2)
        moving = 0.5 * airframe.mass * np.dot(velocity, velocity)
        return turning + moving + airframe.mass * G * swarm.position[0, 0, 2]

    def power():
        body = Rotation.from_quat(swarm.quaternion[0, 0]).inv().apply(swarm.velocity[0, 0])
        rates = swarm.rates[0, 0]
        given = (swarm.rotor_speed[0, 0], swarm.deflection[0, 0], row, wing)
        force, torque = air_wrench(tuple(body), tuple(rates), *given)
        return np.dot(force, body) + np.dot(torque, rates)

    begin, powers = energy(), [power()]
    for _ in range(96):
        bench.hold(speed, deflection)
        powers.append(power())
    work = (sum(powers) - (powers[0] + powers[-1]) / 2) / 480
    assert energy() - begin == pytest.approx(work, rel=2e-3)
    assert abs(work) > 5


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_steady_wind_carries_a_flight_along(make_bench, dynamics):
    wind = np.array((3.0, -2.0, 1.0))
    still, speed, deflection = random_flight(make_bench, TRAINER, 2, dynamics)
    carried, _, _ = random_flight(make_bench, TRAINER, 2, dynamics, wind=wind)
    # The bench starts at the same velocity relative to the air
    np.testing.assert_allclose(carried.swarm.velocity - wind, still.swarm.velocity, atol=1e-12)
    flights = (still, carried)
    for bench in flights:
        bench.hold(speed, deflection, 10)
    np.testing.assert_allclose(carried.swarm.quaternion, still.swarm.quaternion, atol=1e-8)
    np.testing.assert_allclose(carried.swarm.velocity - wind, still.swarm.velocity, atol=1e-7)
    np.testing.assert_allclose(carried.swarm.position - wind, still.swarm.position, atol=1e-6)


@BOTH
def test_one_aircraft_flies_as_one_of_64_to_the_bit(make_bench, airframe):
    many, speed, deflection = random_flight(make_bench, airframe, 3, worlds=64)
    chosen = (0, 5, 31, 63)
    alone = []
    for w in chosen:
        one = make_bench("rigid_body", airframe, hz=480, substeps=48)
        for mine, all_of in zip(one.swarm, many.swarm, strict=True):
            mine[0] = all_of[w]
        one.place().hold(speed, deflection, 5)
        alone.append(one.swarm)
    many.hold(speed, deflection, 5)
    for w, swarm in zip(chosen, alone, strict=True):
        for mine, all_of in zip(swarm, many.swarm, strict=True):
            np.testing.assert_array_equal(mine[0], all_of[w])


@BOTH
def test_bullet_flies_as_rigid_body_does(make_bench, airframe):
    ends = []
    for dynamics in DYNAMICS:
        bench, speed, deflection = random_flight(make_bench, airframe, 4, dynamics)
        bench.hold(speed, deflection, 5)
        ends.append(bench.swarm)
    first, second = ends
    np.testing.assert_allclose(second.velocity, first.velocity, atol=0.1)
    np.testing.assert_allclose(second.position, first.position, atol=0.05)
    np.testing.assert_array_equal(second.deflection, first.deflection)
    np.testing.assert_allclose(second.rotor_speed, first.rotor_speed, rtol=1e-12)


def test_servos_move_at_their_rate(make_bench):
    """4 rad/s for 0.05 s, then the range of 0.4 rad."""
    bench = make_bench("rigid_body", TRAINER, hz=200, substeps=10).place_trimmed(
        find_climb(TRAINER, 13.0, 0.0)
    )
    begin = bench.swarm.deflection[0, 0].copy()
    bench.hold((0.0,), (1.0, -1.0, 0.0, 0.05))
    expected = (begin[0] + 0.2, begin[1] - 0.2, 0.0, 0.05)
    np.testing.assert_allclose(bench.swarm.deflection[0, 0], expected, atol=1e-9)
    bench.hold((0.0,), (1.0, -1.0, 0.0, 0.05), 4)
    np.testing.assert_allclose(bench.swarm.deflection[0, 0, :2], (0.4, -0.4))


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_the_trainer_lands_on_its_wheels_and_stops(make_bench, dynamics):
    """Below 1 m/s the air hardly brakes: friction sqrt(0.02 * 0.5) = 0.1 takes 0.98 m/s^2."""
    trim = find_climb(TRAINER, 8.5, 0.0)
    bench = make_bench(dynamics, TRAINER, substeps=24)
    bench.place_trimmed(trim, height=TRAINER.standing_height + 0.15)
    swarm = bench.swarm
    swarm.quaternion[:] = Rotation.from_euler("ZYX", (0.0, -0.03, 0.0)).as_quat()
    swarm.velocity[:] = 8.5, 0.0, -0.3
    bench.place()
    speeds = []
    for _ in range(95):
        bench.hold(trim.speed, trim.deflection)
        speeds.append(np.linalg.norm(swarm.velocity[0, 0]))
    slow = [one for one in speeds if 0.1 < one < 1.0]
    assert -np.diff(slow).mean() / 0.1 == pytest.approx(0.1 * G, rel=0.05)
    assert speeds[-1] == 0
    assert swarm.position[0, 0, 2] == pytest.approx(TRAINER.standing_height, abs=1e-3)
    assert abs(Rotation.from_quat(swarm.quaternion[0, 0]).as_euler("ZYX")).max() < 0.01


def test_a_quadplane_hovers_on_its_lift_rotors(make_bench):
    """Four rotors at hover speed balance weight and moments; a climb is damped by their inflow.

    Damping of vertical speed: 4 k_z w / m = 4 * 5.561e-4 * 640.3 / 2.5 = 0.57 1/s.
    """
    hover = QUADPLANE.hover_speed()
    speed, level = (*(hover,) * 4, 0.0), (0.0,) * 5
    bench = make_bench("rigid_body", QUADPLANE, substeps=24)
    bench.swarm.rotor_speed[0, 0] = speed
    bench.place().hold(speed, level, 5)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], 0, atol=1e-9)
    np.testing.assert_allclose(bench.swarm.rates[0, 0], 0, atol=1e-9)
    bench.swarm.velocity[..., 2] = 0.01
    bench.place().hold(speed, level, 5)
    assert math.log(0.01 / bench.swarm.velocity[0, 0, 2]) / 0.5 == pytest.approx(0.57, rel=0.03)
