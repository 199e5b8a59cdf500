"""Changes in flight that users of other simulators ask for, against numbers by hand.

Each situation names the public thread that it is from.
"""

import numpy as np
import pytest

import bulletuav
from bulletuav import Airspace, SetpointLevel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY as G
from bulletuav.vehicle.airframes import load_airframe

CF2X = load_airframe("cf2x")
HOVER = CF2X.hover_speed()
SIX = ("bullet", "rigid_body")
DT = 1 / 240


def at_hover_speed(dynamics, effects=(), **options):
    """Return a drone in hover, whose rotors are commanded to turn as they do."""
    places = [(0.0, 0.0, 5.0)]
    airspace = Airspace(
        places, CF2X, dynamics=dynamics, effects=effects, rotor_speed="hover", **options
    )
    airspace.command(0, SetpointLevel.ROTOR, np.full(4, HOVER))
    return airspace


def rotor_fails(dynamics):
    # ethz-asl/rotors_simulator#511: see how a quadrotor responds when a motor fails
    airspace = at_hover_speed(dynamics)
    airspace.set_condition(0, rotor_effectiveness=(0.0, 1.0, 1.0, 1.0))
    airspace.step()
    lost, (x, y, turn) = CF2X.mass * G / 4, CF2X.rotors[0]
    torque = np.array((-y * lost, x * lost, -turn * CF2X.torque_ratio * lost))
    return airspace.swarm.rates[0], torque / CF2X.inertia * DT, 2e-3


def fourth_rotor_is_disabled(dynamics):
    # uzh-rpg/flightmare#124: the thrust of the fourth rotor is set to 0
    airspace = at_hover_speed(dynamics)
    airspace.set_condition(0, rotor_effectiveness=(1.0, 1.0, 1.0, 0.0))
    airspace.step()
    return airspace.swarm.velocity[0, 2], -G / 4 * DT, 1e-4


def failed_motor_spins_down(dynamics):
    # PX4/PX4-SITL_gazebo-classic#141: a motor fails in flight by a message, and then stops
    airspace = at_hover_speed(dynamics, ("lag",))
    airspace.set_condition(0, rotor_effectiveness=(1.0, 1.0, 0.0, 1.0))
    for _ in range(12):
        airspace.step()
    left = np.exp(-12 * DT / CF2X.lag_down)
    return airspace.swarm.rotor_speed[0], HOVER * np.array((1.0, 1.0, left, 1.0)), 1e-9


def rotors_have_70_percent(dynamics):
    # ArduPilot/ardupilot#24911: motors turn as commanded, with a fraction of the thrust
    airspace = at_hover_speed(dynamics)
    airspace.set_condition(0, rotor_effectiveness=(0.7, 0.7, 0.7, 0.7))
    for _ in range(24):
        airspace.step()
    return airspace.swarm.velocity[0, 2], -0.3 * G * 24 * DT, 1e-6


def all_motors_stop(dynamics):
    # microsoft/AirSim#3089: get a particular drone to drop out of the sky
    places = [(0.0, 0.0, 50.0), (20.0, 0.0, 50.0)]
    airspace = Airspace(places, CF2X, dynamics=dynamics, effects=(), rotor_speed="hover")
    airspace.command(None, SetpointLevel.ROTOR, np.full(4, HOVER))
    airspace.set_condition(1, rotor_effectiveness=np.zeros(4))
    for _ in range(48):
        airspace.step()
    return airspace.swarm.velocity[:, 2], np.array((0.0, -G * 48 * DT)), 1e-6


def parcel_is_dropped(dynamics):
    # PX4/PX4-SITL_gazebo-classic#724: a vehicle drops the package that it delivers
    airspace = at_hover_speed(dynamics)
    parcel = 0.008
    airspace.set_condition(0, added_mass=parcel)
    heavy = HOVER * np.sqrt(1 + parcel / CF2X.mass)
    airspace.command(0, SetpointLevel.ROTOR, np.full(4, heavy))
    airspace.step()
    hovers = airspace.swarm.velocity[0, 2]
    airspace.set_condition(0, added_mass=0.0)
    airspace.step()
    climb = airspace.swarm.velocity[0, 2]
    return np.array((hovers, climb)), np.array((0.0, parcel / CF2X.mass * G * DT)), 1e-6


def payload_adds_inertia(dynamics):
    # ArduPilot/ardupilot#26591: a payload fixed to the frame, with its moment of inertia
    airspace = at_hover_speed(dynamics)
    added = np.array((2e-6, 3e-6, 4e-6))
    airspace.set_condition(0, added_mass=0.005, added_inertia=added)
    airspace.apply(0, torque=(1e-5, 1e-5, 1e-5))
    airspace.step()
    return airspace.swarm.rates[0], 1e-5 / (np.array(CF2X.inertia) + added) * DT, 1e-5


def mass_grows_at_hover_rpm(dynamics):
    # learnsyslab/gym-pybullet-drones#225: another mass, while rotors turn at the speed of hover
    airspace = at_hover_speed(dynamics)
    airspace.set_condition(0, added_mass=0.005)
    for _ in range(24):
        airspace.step()
    sinks = -G * 0.005 / (CF2X.mass + 0.005)
    return airspace.swarm.velocity[0, 2], sinks * 24 * DT, 1e-6


def worlds_have_their_own_mass(dynamics):
    # learnsyslab/crazyflow#11: mass and inertia of each world of a batch
    batch = bulletuav.batch_env(
        "hover", 3, dynamics=dynamics, airframe="cf2x", num_drones=1, action="rotor", effects=()
    )
    batch.reset(seed=0)
    masses = CF2X.mass * np.array((0.0, 0.25, 0.5))
    for world, mass in enumerate(masses):
        batch.set_condition(worlds=world, added_mass=mass)
    speeds = []
    for _ in range(2):
        speeds.append(batch.aviary.swarm.velocity[:, 0, 2].copy())
        batch.step(np.full((3, 1, 4), HOVER / CF2X.max_rotor_speed))
    change = speeds[1] - speeds[0]
    period = 1 / batch.aviary.options.decision_hz
    # The same thrust in all worlds
    squares = (batch.aviary.swarm.rotor_speed[:, 0] ** 2).sum(axis=-1)
    climb = CF2X.thrust_coefficient * squares / (CF2X.mass + masses) - G
    batch.close()
    return change, climb * period, 1e-4


def gravity_is_that_of_mars(dynamics):
    # microsoft/AirSim#4192: change gravity in real time, to see the effects in a controller
    airspace = at_hover_speed(dynamics)
    airspace.set_condition(gravity=3.71)
    airspace.command(0, SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    airspace.step()
    return airspace.swarm.velocity[0, 2], (G - 3.71) * DT, 1e-6


def gravity_is_turned_off(dynamics):
    # microsoft/AirSim#4993: turn off gravity for a while
    airspace = at_hover_speed(dynamics)
    airspace.stop()
    heights, drops = [], 0.0
    for gravity in (0.0, G):
        airspace.set_condition(gravity=gravity)
        for _ in range(24):
            airspace.step()
        heights.append(airspace.swarm.velocity[0, 2])
    return np.array(heights), np.array((drops, -G * 24 * DT)), 1e-9


def wind_steps(dynamics):
    # ethz-asl/rotors_simulator#595 and PX4/PX4-SITL_gazebo-classic#812: wind that changes in flight
    airspace = at_hover_speed(dynamics, ("drag",))
    airspace.step()
    before = airspace.swarm.velocity[0].copy()
    airspace.set_wind((5.0, 2.0, 0.0))
    airspace.step()
    push = CF2X.drag_xy * 4 * HOVER * np.array((5.0, 2.0, 0.0)) / CF2X.mass
    return airspace.swarm.velocity[0] - before, push * DT, 2e-2


def battery_is_swapped(dynamics):
    # dronekit/dronekit-python#841: other values of the battery in flight
    aviary = bulletuav.Aviary(
        "hover",
        dynamics=dynamics,
        airframe="cf2x",
        num_drones=1,
        battery_capacity=0.1,
        energy="zeng",
    )
    aviary.reset(seeds=0, charge=[0.5])
    aviary.set_condition(0, charge=1.0)
    aviary.step(np.zeros(aviary.given.shape))
    used = aviary.readings["power"][0, 0] / aviary.options.decision_hz / (0.1 * 3600)
    return aviary.readings["charge"][0, 0], 1.0 - used, 1e-9


@pytest.mark.parametrize("dynamics", SIX)
@pytest.mark.parametrize(
    "situation",
    [
        rotor_fails,
        fourth_rotor_is_disabled,
        failed_motor_spins_down,
        rotors_have_70_percent,
        all_motors_stop,
        parcel_is_dropped,
        payload_adds_inertia,
        mass_grows_at_hover_rpm,
        worlds_have_their_own_mass,
        gravity_is_that_of_mars,
        gravity_is_turned_off,
        wind_steps,
        battery_is_swapped,
    ],
)
def test_the_change_has_the_effect_that_newton_and_euler_say(situation, dynamics):
    measured, by_hand, tolerance = situation(dynamics)
    assert measured == pytest.approx(by_hand, rel=tolerance, abs=1e-6)
