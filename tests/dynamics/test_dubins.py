"""Kinematic flights of an aircraft that cannot hover: the Dubins airplane."""

import math

import numpy as np
import pytest

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.envelope import find_climb, find_envelope

LADDER = ("single_integrator", "point_mass", "double_integrator")
VELOCITY, ACCELERATION = SetpointLevel.VELOCITY, SetpointLevel.ACCELERATION
POSITION = SetpointLevel.POSITION
TRAINER = load_airframe("trainer")
LIMITS = find_envelope(TRAINER)
CRUISE = LIMITS.cruise_speed


def full_throttle(speed):
    """Steady climb at full throttle, m/s."""
    return speed * math.sin(find_climb(TRAINER, speed).climb)


def lateral(fraction=1.0):
    """Lateral acceleration at a fraction of the largest turn rate, m/s^2."""
    return fraction * STANDARD_GRAVITY * math.tan(LIMITS.max_bank)


def start(bench, velocity=(CRUISE, 0.0, 0.0)):
    """Put the aircraft in flight 200 m up."""
    bench.swarm.position[..., 2] = 200.0
    bench.swarm.velocity[:] = velocity
    return bench.place()


def ground_speed(velocity):
    """Horizontal speed of velocities (..., 3), m/s."""
    return np.hypot(velocity[..., 0], velocity[..., 1])


@pytest.fixture
def fly_from(make_bench):
    """Builds a bench of the trainer in flight."""

    def make(dynamics, velocity=(CRUISE, 0.0, 0.0), **options):
        return start(make_bench(dynamics, TRAINER, **options), velocity)

    return make


@pytest.mark.parametrize("dynamics", LADDER)
def test_speed_turn_and_climb_stay_within_the_envelope(fly_from, dynamics):
    bench = fly_from(dynamics, substeps=6, hz=240, worlds=4, drones=2)
    rng = np.random.default_rng(5)
    before = bench.swarm.velocity.copy()
    for _ in range(300):
        setpoint = rng.normal(scale=15.0, size=(4, 2, 4))
        setpoint[rng.random((4, 2)) < 0.1] = 0.0
        level = rng.choice([0, 1, 2] if dynamics == "double_integrator" else [0, 1])
        bench.dynamics.fly(
            bench.swarm, bench.alive, SetpointLevel(level), setpoint, bench.wind, bench.motion
        )
        after = bench.swarm.velocity
        speed = ground_speed(after)
        assert speed.min() >= LIMITS.min_speed - 1e-9
        assert np.linalg.norm(after, axis=-1).max() <= min(20.0, LIMITS.max_speed) + 1e-9
        assert after[..., 2].max() <= LIMITS.max_climb + 1e-9
        assert after[..., 2].min() >= -LIMITS.max_sink - 1e-9
        turned = np.arctan2(
            before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0],
            before[..., 0] * after[..., 0] + before[..., 1] * after[..., 1],
        )
        slowest = np.minimum(speed, ground_speed(before)).min()
        if dynamics != "single_integrator":  # there the speed jumps
            slowest = max(LIMITS.min_speed, slowest - 0.1)
        assert np.abs(turned).max() <= 6 / 240 * lateral() / min(slowest, CRUISE) * 1.5
        before = after.copy()


@pytest.mark.parametrize("dynamics", LADDER)
def test_the_tightest_turn_is_a_circle_of_the_radius_by_hand(fly_from, dynamics):
    bench = fly_from(dynamics)
    rate = lateral() / CRUISE
    track = []
    for k in range(120):
        # A command that is always 2 rad ahead
        angle = 2.0 + rate * 0.1 * k
        wanted = (CRUISE * math.cos(angle), CRUISE * math.sin(angle), 0.0, 0.0)
        bench.fly(VELOCITY, wanted)
        track.append(bench.swarm.position[0, 0].copy())
    track = np.array(track)
    radius = CRUISE**2 / lateral()  # V^2 / (g tan bank)
    centre = np.array((0.0, radius, 200.0))  # to the left of the start, which flies east
    np.testing.assert_allclose(np.linalg.norm(track - centre, axis=1), radius, rtol=2e-3)
    assert np.ptp(np.arctan2(*(track - centre).T[:2])) > 6.0


def test_a_turn_of_the_textbook(make_bench):
    # Beard and McLain: psi' = g tan(phi) / V, here 9.80665 / 14 = 0.70048 rad/s at 45 degrees
    from bulletuav.dynamics.dubins import loiter_radius

    bench = make_bench("single_integrator", TRAINER)
    gain = bench.dynamics.flight.cascade.gains[0, 0].copy()
    gain["max_bank"] = 1.0
    # 14^2 / (9.80665 / 2) = 39.9729 m
    assert loiter_radius(14.0, gain, 9.80665) == pytest.approx(39.9729, abs=1e-4)


@pytest.mark.parametrize("dynamics", LADDER)
def test_without_a_speed_it_loiters_to_the_left(fly_from, dynamics):
    bench = fly_from(dynamics, (LIMITS.min_speed, 0.0, 0.0))
    position, velocity = bench.trace(VELOCITY, (0.0, 0.0, 0.0, 0.0), 400)
    radius = LIMITS.min_speed**2 / lateral(0.5)
    centre = np.array((0.0, radius, 200.0))
    np.testing.assert_allclose(np.linalg.norm(position - centre, axis=1), radius, rtol=2e-3)
    np.testing.assert_allclose(ground_speed(velocity), LIMITS.min_speed, rtol=1e-9)


@pytest.mark.parametrize("dynamics", LADDER)
def test_it_circles_around_a_commanded_position(fly_from, dynamics):
    bench = fly_from(dynamics)
    position, velocity = bench.trace(POSITION, (150.0, 80.0, 210.0, 0.0), 600)
    radius = CRUISE**2 / lateral(0.5)
    away = position[300:] - (150.0, 80.0, 210.0)
    # The lag of the heading makes the circle wider
    lag = 1 / (1.6 * bench.dynamics.flight.cascade.gains[0, 0]["position_frequency"])
    wider = 0.0 if dynamics == "single_integrator" else lag * CRUISE
    np.testing.assert_allclose(np.hypot(*away.T[:2]), radius + wider, rtol=0.02)
    assert np.abs(away[:, 2]).max() < 0.1
    np.testing.assert_allclose(ground_speed(velocity[300:]), CRUISE, rtol=1e-6)
    # To the left
    assert (away[:, 0] * velocity[300:, 1] > away[:, 1] * velocity[300:, 0]).all()


def test_a_velocity_within_the_limits_is_flown_as_commanded(fly_from):
    bench = fly_from("single_integrator")
    turn = 0.9 * lateral() / CRUISE / 240  # in the first substep
    for wanted in ((CRUISE, 0.0, 0.0), (1.1 * CRUISE, 0.0, 1.0)):
        c, s = math.cos(turn), math.sin(turn)
        command = np.array((c * wanted[0], s * wanted[0], wanted[2]))
        before = bench.swarm.position[0, 0].copy()
        bench.fly(VELOCITY, (*command, 0.0))
        np.testing.assert_allclose(bench.swarm.velocity[0, 0], command, rtol=1e-12)
        np.testing.assert_allclose(bench.swarm.position[0, 0] - before, 0.1 * command, rtol=1e-9)


@pytest.mark.parametrize("dynamics", LADDER[1:])
def test_speed_and_climb_follow_with_the_lag_of_the_velocity_loop(fly_from, dynamics):
    bench = fly_from(dynamics, hz=9600, substeps=960)
    lag = 1 / (1.6 * bench.dynamics.flight.cascade.gains[0, 0]["position_frequency"])
    bench.fly(VELOCITY, (CRUISE + 0.02, 0.0, 0.5, 0.0), decisions=2)
    grown = 1 - math.exp(-0.2 / lag)
    vx, _, vz = bench.swarm.velocity[0, 0]
    assert vx - CRUISE == pytest.approx(0.02 * grown, rel=2e-3)
    assert vz == pytest.approx(0.5 * grown, rel=2e-3)


@pytest.mark.parametrize("dynamics", LADDER[1:])
def test_it_accelerates_by_its_excess_power(fly_from, dynamics):
    # Without climb V V' = g P(V), so V^2 grows by 2 g P t, with P near the middle of the flight
    bench = fly_from(dynamics)
    bench.fly(VELOCITY, (CRUISE + 5.0, 0.0, 0.0, 0.0), decisions=3)
    power = full_throttle(CRUISE + 0.5)
    speed = math.sqrt(CRUISE**2 + 2 * STANDARD_GRAVITY * power * 0.3)
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(speed, rel=2e-3)


@pytest.mark.parametrize("dynamics", LADDER)
@pytest.mark.parametrize("speed", [10.0, 12.0, 14.2, 16.0, 16.9])
def test_a_steady_climb_is_at_most_that_of_full_throttle(fly_from, dynamics, speed):
    """Trims at the speed itself, not those between which the climb is interpolated."""
    bench = fly_from(dynamics, (speed, 0.0, 0.0))
    bench.fly(VELOCITY, (speed, 0.0, 2 * LIMITS.max_climb, 0.0), decisions=30)
    vx, _, vz = bench.swarm.velocity[0, 0]
    assert vx == pytest.approx(speed, rel=0.02)
    assert vz == pytest.approx(min(full_throttle(vx), LIMITS.max_climb), rel=0.03, abs=0.1)


@pytest.mark.parametrize("dynamics", LADDER[1:])
@pytest.mark.parametrize("climb", [-1.0, 0.0, 2.0, 4.0])
def test_climb_and_acceleration_share_one_budget_of_energy(fly_from, dynamics, climb):
    bench = fly_from(dynamics)
    wanted = (16.5, 0.0, climb, 0.0)
    for _ in range(40):
        before = bench.swarm.velocity[0, 0].copy()
        bench.fly(VELOCITY, wanted)
        after = bench.swarm.velocity[0, 0]
        middle = 0.5 * (before + after)
        rate = middle[2] + (after[0] ** 2 - before[0] ** 2) / (2 * STANDARD_GRAVITY * 0.1)
        assert rate <= full_throttle(middle[0]) + 0.05
    # Steady: the climb is that at the speed reached, and a climb that is not possible costs speed
    assert after[2] == pytest.approx(min(climb, full_throttle(after[0])), abs=0.15)
    assert (after[0] < 16.0) == (climb > full_throttle(16.0))


@pytest.mark.parametrize("climb", [0.0, 2.0])
def test_it_decelerates_faster_in_a_climb(fly_from, climb):
    # V V' = -g (max_sink + c)
    bench = fly_from("point_mass", (15.0, 0.0, climb))
    bench.fly(VELOCITY, (10.0, 0.0, climb, 0.0), decisions=2)
    loss = 2 * STANDARD_GRAVITY * (LIMITS.max_sink + climb) * 0.2
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(math.sqrt(15.0**2 - loss), rel=1e-3)


@pytest.mark.parametrize("dynamics", LADDER)
def test_the_levels_agree_on_a_long_flight(fly_from, dynamics):
    legs = [(0.0, 0.0), (1.5, 1.0), (-2.0, -0.5), (3.0, 0.5)]
    ends = []
    for one in ("single_integrator", dynamics):
        bench = fly_from(one)
        for heading, climb in legs:
            wanted = (CRUISE * math.cos(heading), CRUISE * math.sin(heading), climb, 0.0)
            bench.fly(VELOCITY, wanted, decisions=80)
        ends.append(bench.swarm.position[0, 0].copy())
    # 450 m of flight; each turn is late by the lag of 0.25 s
    np.testing.assert_allclose(*ends, atol=4 * 2 * 0.25 * CRUISE)
    assert np.linalg.norm(ends[0][:2]) > 50.0


def test_a_lateral_acceleration_turns_at_its_own_rate(fly_from):
    bench = fly_from("double_integrator")
    for _ in range(30):
        vx, vy, _ = bench.swarm.velocity[0, 0] / CRUISE
        bench.fly(ACCELERATION, (-2.0 * vy, 2.0 * vx, 0.0, 0.0))
    # Each decision holds the direction of its start, so that the rate is a little less
    angle = math.atan2(bench.swarm.velocity[0, 0, 1], bench.swarm.velocity[0, 0, 0])
    assert angle == pytest.approx(3.0 * 2.0 / CRUISE, rel=2e-3)


@pytest.mark.parametrize("dynamics", LADDER)
def test_mirrored_commands_give_mirrored_turns(fly_from, dynamics):
    tracks = []
    for side in (1.0, -1.0):
        bench = fly_from(dynamics)
        bench.fly(VELOCITY, (1.0, 15.0 * side, 0.5, 0.0), decisions=15)
        tracks.append(np.r_[bench.swarm.position[0, 0], bench.swarm.quaternion[0, 0]])
    # In the mirror, y, roll and yaw change their signs
    signs = np.array((1, -1, 1, -1, 1, -1, 1))
    np.testing.assert_allclose(tracks[0], tracks[1] * signs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dynamics", LADDER)
def test_the_nose_points_along_the_flight_at_the_bank_of_a_coordinated_turn(fly_from, dynamics):
    from bulletuav.geometry.rotation import axes

    bench = fly_from(dynamics)
    bench.fly(VELOCITY, (-CRUISE, 1.0, 1.0, 0.0), decisions=20)
    forward, left, _ = axes(tuple(bench.swarm.quaternion[0, 0]))
    velocity = bench.swarm.velocity[0, 0]
    np.testing.assert_allclose(forward, velocity / np.linalg.norm(velocity), atol=1e-12)
    # In a turn to the left the left wing is down
    sine = -left[2] / math.hypot(*forward[:2])
    assert math.asin(sine) == pytest.approx(LIMITS.max_bank, rel=1e-6)


def test_the_wind_carries_a_point_mass_and_the_limits_apply_in_the_air(fly_from):
    wind = np.array((0.0, 5.0, 0.0))
    bench = fly_from("point_mass", wind=wind)
    position, velocity = bench.trace(VELOCITY, (0.0, 0.0, 0.0, 0.0), 300)
    np.testing.assert_allclose(ground_speed(velocity[50:] - wind), LIMITS.min_speed, rtol=1e-4)
    period = 2 * math.pi * LIMITS.min_speed / lateral(0.5)
    drift = (position[-1] - position[-1 - round(10 * period)]) / round(10 * period) * 10
    np.testing.assert_allclose(drift, wind, atol=0.3)
    # A velocity over ground is kept in a crosswind
    bench.fly(VELOCITY, (CRUISE, 0.0, 0.0, 0.0), decisions=200)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (CRUISE, 0.0, 0.0), atol=1e-6)


def test_a_point_mass_keeps_the_course_where_the_wind_makes_it_faster(fly_from):
    # The air moves to the east and north; the aircraft cannot be as slow as commanded
    bench = fly_from("point_mass", (LIMITS.min_speed + 3.0, 4.0, 0.0), wind=(3.0, 4.0, 0.0))
    bench.fly(VELOCITY, (LIMITS.min_speed, 0.0, 0.0, 0.0), decisions=200)
    vx, vy, _ = bench.swarm.velocity[0, 0]
    assert vy == pytest.approx(0.0, abs=1e-6)
    # Wind triangle by hand: 3 + sqrt(V^2 - 4^2)
    assert vx == pytest.approx(3.0 + math.sqrt(LIMITS.min_speed**2 - 16.0), abs=1e-6)


def test_multirotors_are_unchanged_next_to_an_aeroplane(make_bench):
    quad = load_airframe("hummingbird")
    for dynamics in LADDER[1:]:
        ends = []
        for airframes in ((quad, quad), (quad, TRAINER)):
            bench = make_bench(dynamics, airframes)
            bench.fly(VELOCITY, (3.0, -2.0, 1.0, 0.4), decisions=30)
            ends.append([array[0, 0].copy() for array in bench.swarm[:4]])
        for one, other in zip(*ends, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_speed_limit_below_its_minimum_is_an_error(make_bench):
    with pytest.raises(ValueError, match="max_speed is 5 m/s: airframe 'trainer' needs at least"):
        make_bench("point_mass", TRAINER, max_speed=5.0)


def test_an_airframe_that_hovers_on_lift_rotors_has_no_minimum_speed(make_bench):
    bench = make_bench("single_integrator", "quadplane")
    assert bench.airframe.wings
    bench.fly(VELOCITY, (0.0, 0.0, 0.5, 0.0))
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (0.0, 0.0, 0.5))
