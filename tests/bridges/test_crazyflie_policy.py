"""Virtual Crazyflies that the policy `foundation` flies, as an out-of-tree controller."""

import math
import struct

import numpy as np
import pytest
from bridges.crtp_client import Drone

from bulletuav import SetpointLevel, load_airframe

CONTROLLER = "stabilizer.controller"
LEE, OUT_OF_TREE = 1, 6


def select(drone, controller):
    """Set the parameter, and return its value as the drone then has it."""
    assert drone.parameter(CONTROLLER, controller) == 0
    return drone.fleet.vehicles[drone.index].parameters.values[CONTROLLER]


def level(drone):
    return SetpointLevel(drone.fleet.airspace.levels[drone.index])


def in_the_air(drone, height=1.0):
    drone.fleet.airspace.place(drone.index, (0.0, 0.0, height), rotor_speed="hover")
    drone.fleet.step()


@pytest.mark.parametrize("airframe", ["cf2x", "cf21B", "racer", "hummingbird"])
def test_the_policy_takes_off_goes_to_a_point_and_lands(airframe, make_fleet, fly):
    fleet = make_fleet(1, airframe)
    drone, standing = Drone(fleet), load_airframe(airframe).standing_height
    assert select(drone, OUT_OF_TREE) == OUT_OF_TREE
    levels = []
    assert drone.take_off(1.0, 2.0) == 0
    fly(fleet, 3.0, lambda: levels.append(level(drone)))
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.05)
    assert drone.go_to(1.0, 0.5, 1.2, 0.0, 2.0) == 0
    fly(fleet, 3.0, lambda: levels.append(level(drone)))
    np.testing.assert_allclose(drone.place, (1, 0.5, 1.2), atol=0.05)
    assert drone.land(2.0) == 0
    fly(fleet, 3.0, lambda: levels.append(level(drone)))
    assert drone.place[2] == pytest.approx(standing, abs=0.01)
    np.testing.assert_allclose(drone.place[:2], (1, 0.5), atol=0.1)
    assert set(levels) == {SetpointLevel.ROTOR}
    assert fleet.airspace.swarm.rotor_speed.max() < 10


def test_rotor_commands_are_held_for_30_ms(drone, fly):
    select(drone, OUT_OF_TREE)
    drone.take_off(1.0, 1.0)
    held = []
    fly(drone.fleet, 0.3, lambda: held.append(drone.fleet.airspace.setpoint[0, :4].copy()))
    # The first one is from before the flight
    changes = np.any(np.diff(held[1:], axis=0) != 0, axis=1)
    assert np.flatnonzero(changes).tolist() == list(range(2, 28, 3))


def test_setpoints_of_positions_and_velocities_are_followed(drone, fly):
    select(drone, OUT_OF_TREE)
    in_the_air(drone)
    fly(drone.fleet, 3.0, lambda: drone.setpoint(7, "ffff", 0.4, -0.3, 1.2, 0.0))
    np.testing.assert_allclose(drone.place, (0.4, -0.3, 1.2), atol=0.05)
    fly(drone.fleet, 2.0, lambda: drone.setpoint(8, "ffff", 0.0, 0.5, 0.1, 0.0))
    np.testing.assert_allclose(drone.velocity, (0, 0.5, 0.1), atol=0.1)
    fly(drone.fleet, 2.0, lambda: drone.setpoint(10, "ffff", 0.0, 0.0, 0.0, 1.2))
    np.testing.assert_allclose(drone.velocity, (0, 0, 0), atol=0.1)
    assert drone.place[2] == pytest.approx(1.2, abs=0.05)
    assert level(drone) == SetpointLevel.ROTOR


def test_a_full_state_is_followed_with_its_velocity(drone, fly):
    select(drone, OUT_OF_TREE)
    in_the_air(drone)
    fly(drone.fleet, 3.0, drone.swing())
    np.testing.assert_allclose(drone.place, (0.5 * (1 - math.cos(3)), 0, 1), atol=0.1)


def test_attitudes_are_flown_by_the_usual_controller(drone, fly):
    select(drone, OUT_OF_TREE)
    in_the_air(drone)
    fly(drone.fleet, 0.5, lambda: drone.setpoint(9, "ffff", 0.0, 10.0, 0.0, 1.0))
    assert level(drone) == SetpointLevel.ATTITUDE
    assert drone.velocity[0] < -0.3
    drone.ask(7, 1, struct.pack("<BI", 0, 0))
    assert drone.go_to(0.0, 0.0, 1.0, 0.0, 2.0) == 0
    fly(drone.fleet, 3.5)
    assert level(drone) == SetpointLevel.ROTOR
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.05)


def test_the_controller_changes_in_flight(drone, fly):
    drone.take_off(1.0, 1.0)
    fly(drone.fleet, 2.0)
    assert level(drone) == SetpointLevel.POSITION
    select(drone, OUT_OF_TREE)
    fly(drone.fleet, 2.0)
    assert level(drone) == SetpointLevel.ROTOR
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.05)
    select(drone, LEE)
    fly(drone.fleet, 2.0)
    assert level(drone) == SetpointLevel.POSITION
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.02)


def test_an_airframe_that_the_policy_cannot_fly_keeps_its_controller(make_fleet):
    drone = Drone(make_fleet(1, "firefly"))
    assert select(drone, OUT_OF_TREE) == LEE
    assert "has 6 rotors, and this policy flies 4" in drone.fleet.vehicles[0].refusal


def test_drones_of_a_fleet_have_hidden_states_of_their_own(make_fleet, fly):
    ends = []
    for count in (1, 2):
        fleet = make_fleet([(2.0 * i, 0.0) for i in range(count)])
        for i in range(count):
            select(Drone(fleet, i), OUT_OF_TREE)
        Drone(fleet, 0).take_off(1.0, 1.0)
        fly(fleet, 0.1)
        if count == 2:
            Drone(fleet, 1).take_off(0.7, 1.0)
        fly(fleet, 1.0)
        ends.append(fleet.airspace.setpoint[0, :4].copy())
    np.testing.assert_array_equal(*ends)
