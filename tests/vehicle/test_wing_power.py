"""Power of aircraft with wings: the drag polar against steady flights, hand numbers and limits."""

import math

import numpy as np
import pytest

from bulletuav import Aviary
from bulletuav.vehicle.airframe import STANDARD_GRAVITY as G
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.envelope import find_envelope, find_trim
from bulletuav.vehicle.power import W20, airframe_wing, propulsion_power
from bulletuav.vehicle.wing_power import (
    NO_WINGS,
    forward_power,
    propeller_speed,
    wing_power,
    wing_share,
    winged_power,
)

TRAINER, QUADPLANE = load_airframe("trainer"), load_airframe("quadplane")
BOTH = pytest.mark.parametrize("airframe", [TRAINER, QUADPLANE], ids=lambda one: one.name)


def power_of(airframe, velocity, acceleration=(0.0, 0.0, 0.0), gravity=G):
    """Return the electrical power, W, at a velocity through the air and an acceleration."""
    east, north, up = acceleration
    force = tuple(airframe.mass * one for one in (east, north, up + gravity))
    rotary = airframe_wing(airframe, gravity) if airframe.can_hover else W20
    return winged_power(velocity, force, wing_power(airframe), rotary)


def power_of_trim(airframe, trim):
    """Return the electrical power of the forward rotors in a steady flight, W."""
    torque = airframe.thrust_coefficient * airframe.torque_ratio
    shafts = sum(torque * trim.speed[k] ** 3 for k in airframe.forward_rotors)
    return shafts / airframe.efficiency + airframe.electronics


@BOTH
@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_level_flight_takes_the_power_of_the_simulated_rotors(airframe, fraction):
    limits = find_envelope(airframe)
    speed = limits.min_speed + fraction * (limits.max_speed - limits.min_speed)
    expected = power_of_trim(airframe, find_trim(airframe, speed))
    assert power_of(airframe, (0.0, speed, 0.0)) == pytest.approx(expected, rel=0.004)


@BOTH
@pytest.mark.parametrize("climb", [-0.05, 0.1, 0.2])
def test_climbs_take_the_power_of_the_simulated_rotors(airframe, climb):
    speed = find_envelope(airframe).cruise_speed
    expected = power_of_trim(airframe, find_trim(airframe, speed, climb))
    velocity = (speed * math.cos(climb), 0.0, speed * math.sin(climb))
    assert power_of(airframe, velocity) == pytest.approx(expected, rel=0.015)


@BOTH
@pytest.mark.parametrize("bank", [-0.6, 0.3, 0.6])
def test_turns_take_the_power_of_the_simulated_rotors(airframe, bank):
    """The lift is 1 / cos(bank) times the weight."""
    speed = find_envelope(airframe).cruise_speed
    expected = power_of_trim(airframe, find_trim(airframe, speed, 0.0, bank))
    across = (0.0, -G * math.tan(bank), 0.0)
    assert power_of(airframe, (speed, 0.0, 0.0), across) == pytest.approx(expected, rel=0.006)


def test_endurance_of_the_trainer_by_hand():
    """Drag 1.160 N, rotor speed 559 rad/s and 27.4 W at the shaft give 30.1 minutes at 11.3 m/s.

    Areas times drag coefficients of wing, tailplane, fin and fuselage are 0.01114 m^2; the induced
    drag is that of the wing alone, without slipstream. The Parrot Disco (0.75 kg, 30 W h) flies 45
    minutes, 5.4 W per N of weight, and this trainer with its landing gear takes 5.0.
    """
    speed = 11.295
    areas = 0.234 * 0.014 + 0.0484 * 0.012 + 0.0234 * 0.012 + 0.007
    parasite = 0.5 * 1.225 * areas * speed**2
    lift = G / (0.5 * 1.225 * speed**2 * 0.234)
    induced = 0.5 * 1.225 * speed**2 * 0.234 * lift**2 / (math.pi * 0.8 * 7.22)
    assert parasite + induced == pytest.approx(1.160, abs=1e-3)
    loss = 5.561e-4 * speed
    rotor = (loss + math.sqrt(loss**2 + 4 * 1.495e-5 * 1.160)) / (2 * 1.495e-5)
    assert rotor == pytest.approx(559.0, abs=0.5)
    power = 1.495e-5 * 0.01048 * rotor**3 / 0.6 + 3.0
    minutes = 60 * 24.4 / power
    assert minutes == pytest.approx(30.1, abs=0.1)
    found = 60 * TRAINER.pack.capacity / power_of(TRAINER, (speed, 0.0, 0.0))
    assert found == pytest.approx(minutes, rel=0.02)


@pytest.mark.parametrize(("airspeed", "expected"), [(0.0, 278.553), (11.295, 558.959)])
def test_a_propeller_turns_at_the_speed_of_its_thrust(airspeed, expected):
    """At rest, 1.160 N need sqrt(T / k_f); the other speed is that of the endurance above."""
    factor, loss = 1.495e-5, 5.561e-4 * airspeed
    speed = propeller_speed(1.160, loss, factor)
    assert speed == pytest.approx(expected, abs=1e-3)
    assert factor * speed**2 - loss * speed == pytest.approx(1.160, rel=1e-12)
    assert propeller_speed(1.160 / factor, loss / factor, 1.0) == pytest.approx(speed, rel=1e-12)
    assert propeller_speed(-1e-9, loss, factor) == 0.0


def test_rotors_stand_still_in_a_glide():
    limits = find_envelope(TRAINER)
    glide = (limits.cruise_speed, 0.0, -1.2 * limits.max_sink)
    assert power_of(TRAINER, glide) == TRAINER.electronics
    assert power_of(TRAINER, (0.0, 0.0, 0.0)) == TRAINER.electronics


def test_power_is_at_most_that_of_full_throttle():
    wing = wing_power(TRAINER)
    full = TRAINER.thrust_coefficient * TRAINER.torque_ratio * TRAINER.max_rotor_speed**3
    assert power_of(TRAINER, (10.0, 0.0, 0.0), (200.0, 0.0, 0.0)) == pytest.approx(
        full / TRAINER.efficiency + TRAINER.electronics
    )
    assert forward_power(1e9, 10.0, wing) == pytest.approx(full)
    assert forward_power(-1.0, 10.0, wing) == 0.0


def test_a_vtol_hovers_and_climbs_with_the_power_of_a_multirotor():
    rotary = airframe_wing(QUADPLANE)
    for climb in (-1.0, 0.0, 2.0):
        expected = propulsion_power((0.0, 0.0, climb), rotary)
        assert power_of(QUADPLANE, (0.0, 0.0, climb)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("gravity", [3.71, G, 12.0])
def test_a_vtol_hovers_with_the_power_of_its_weight(gravity):
    """Rotors at sqrt(m g / (4 k_f)) take k_m w^3 each."""
    rotor = math.sqrt(2.5 * gravity / (4 * 1.495e-5))
    shafts = 4 * 1.495e-5 * QUADPLANE.torque_ratio * rotor**3
    expected = shafts / QUADPLANE.efficiency + QUADPLANE.electronics
    found = power_of(QUADPLANE, (0.0, 0.0, 0.0), gravity=gravity)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("speed", [3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0])
def test_a_slow_vtol_takes_the_power_of_the_simulated_rotors(speed):
    powers = []
    for dynamics in ("point_mass", "rigid_body"):
        options = {"decision_hz": 10, "half_length": 900.0, "horizon": 2000}
        aviary = made(dynamics, ("quadplane", "quadplane"), **options)
        action = np.zeros(aviary.given.shape)
        action[..., 0] = speed / aviary.options.max_speed
        for _ in range(200):
            aviary.step(action)
        assert aviary.swarm.velocity[0, 0, 0] == pytest.approx(speed, rel=0.05)
        powers.append(aviary.readings["power"][0, 0])
        aviary.close()
    assert powers[0] == pytest.approx(powers[1], rel=0.16)


def test_a_vtol_with_its_nose_level_has_little_lift():
    """At 5 m/s, below half of the transition speed of 10.05 m/s: 0.119 of the weight.

    The trims have angles of attack of 0.06252 rad at 10.963 m/s and of -0.03483 rad at 19 m/s.
    """
    slope = (0.06252 + 0.03483) / (10.963**-2 - 19.0**-2)
    zero_lift = -0.03483 - slope / 19.0**2
    carried = -zero_lift / slope * 25.0
    assert carried == pytest.approx(0.119, abs=1e-3)
    wing = wing_power(QUADPLANE)
    assert wing.flat_lift * 25.0 / (QUADPLANE.mass * G) == pytest.approx(carried, rel=1e-3)
    assert wing_share(5.0, wing.transition_speed) == 0.0
    assert wing_share(0.75 * 1.1 * 9.1357508, wing.transition_speed) == pytest.approx(0.5)
    assert wing_share(30.0, wing.transition_speed) == 1.0


def test_power_of_a_vtol_has_no_step():
    speeds = np.linspace(0.0, 19.0, 2000)
    powers = np.array([power_of(QUADPLANE, (speed, 0.0, 0.0)) for speed in speeds])
    assert np.abs(np.diff(powers)).max() < 0.01 * powers.max()
    # Wings carry most of the weight in cruise
    assert powers[0] > 2 * power_of(QUADPLANE, (find_envelope(QUADPLANE).cruise_speed, 0.0, 0.0))


@BOTH
def test_power_does_not_depend_on_the_heading(airframe):
    powers = []
    for heading in (0.0, 1.0, 4.0):
        c, s = math.cos(heading), math.sin(heading)
        velocity = (12.0 * c, 12.0 * s, 0.5)
        powers.append(power_of(airframe, velocity, (-2.0 * s, 2.0 * c, 0.1)))
    assert powers == pytest.approx([powers[0]] * 3, rel=1e-12)


def test_multirotors_have_no_wing_power():
    assert wing_power(load_airframe("iris")) == NO_WINGS


@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
def test_a_multirotor_with_a_fin_flies_with_the_power_of_a_multirotor(finned, dynamics):
    airframe = load_airframe(finned)
    assert wing_power(airframe) == NO_WINGS
    assert airframe_wing(airframe) == airframe_wing(load_airframe("hummingbird"))
    aviary = made(dynamics, (airframe, airframe))
    before = aviary.swarm.velocity[0].copy()
    for _ in range(20):
        before = aviary.swarm.velocity[0].copy()
        aviary.step(np.full(aviary.given.shape, 0.1))
    assert np.linalg.norm(aviary.swarm.velocity[0], axis=1).min() > 0.1
    expected = [
        propulsion_power(tuple(one), airframe_wing(airframe))
        for one in 0.5 * (before + aviary.swarm.velocity[0])
    ]
    assert aviary.readings["power"][0] == pytest.approx(expected, rel=1e-9)
    aviary.close()


FLEET = ("trainer", "iris", "quadplane")


def made(dynamics, airframe, **options):
    aviary = Aviary(
        "crossing", num_drones=len(airframe), airframe=airframe, dynamics=dynamics, **options
    )
    aviary.reset(seeds=0)
    return aviary


@pytest.mark.parametrize("energy", ["zeng", "actuator"])
def test_simulated_rotors_take_torque_times_speed(energy):
    aviary = made("rigid_body", FLEET, energy=energy, battery_capacity="airframe")
    for _ in range(3):
        before = aviary.swarm.rotor_speed[0].copy()
        aviary.step(np.zeros(aviary.given.shape))
        after = aviary.swarm.rotor_speed[0].copy()
    for i in (0, 2):
        airframe = aviary.options.airframe[i]
        cubes = 0.5 * (before[i] ** 3 + after[i] ** 3).sum()
        shafts = airframe.thrust_coefficient * airframe.torque_ratio * cubes
        expected = shafts / airframe.efficiency + airframe.electronics
        assert aviary.readings["power"][0, i] == pytest.approx(expected, rel=1e-12)
    aviary.close()


def test_multirotors_of_mixed_fleets_take_the_power_of_the_rotary_wing():
    aviary = made("point_mass", ("trainer", "iris"))
    before = aviary.swarm.velocity[0, 1].copy()
    aviary.step(np.zeros(aviary.given.shape))
    velocity = tuple(0.5 * (before + aviary.swarm.velocity[0, 1]))
    expected = propulsion_power(velocity, airframe_wing(load_airframe("iris")))
    assert aviary.readings["power"][0, 1] == pytest.approx(expected, rel=1e-12)
    aviary.close()


def test_points_take_the_power_of_the_drag_polar():
    aviary = made("point_mass", ("trainer", "trainer"), wind=(1.0, 2.0, 0.5))
    before = aviary.swarm.velocity[0].copy()
    aviary.step(np.zeros(aviary.given.shape))
    after = aviary.swarm.velocity[0].copy()
    acceleration = (after - before) * aviary.options.decision_hz
    air = 0.5 * (before + after) - (1.0, 2.0, 0.5)
    expected = [power_of(TRAINER, tuple(air[i]), tuple(acceleration[i])) for i in range(2)]
    assert aviary.readings["power"][0] == pytest.approx(expected, rel=1e-9)
    aviary.close()


@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
def test_a_trainer_flies_thirty_minutes_on_its_battery(dynamics):
    """By hand 30.1 minutes, see above; from the charge that 5 s of cruise take."""
    aviary = made(dynamics, ("trainer", "trainer"), battery_capacity="airframe", decision_hz=10)
    way = aviary.scene.goal[0, :, :2] - aviary.swarm.position[0, :, :2]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    action = np.zeros(aviary.given.shape)
    cruise = find_envelope(TRAINER).cruise_speed
    action[0, :, :2] = way * cruise / aviary.options.max_speed
    charges = [aviary.step(action) and aviary.readings["charge"][0].copy() for _ in range(60)]
    assert np.linalg.norm(aviary.swarm.velocity[0], axis=1) == pytest.approx([cruise] * 2, rel=1e-3)
    minutes = 5.0 / (charges[9] - charges[59]) / 60
    assert minutes == pytest.approx([30.1] * 2, rel=0.01)
    aviary.close()
