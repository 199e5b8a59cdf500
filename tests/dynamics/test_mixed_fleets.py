"""Fleets of multirotors and aircraft with wings, flown in `rigid_body` and `bullet`."""

from dataclasses import replace

import numpy as np
import pytest

from bulletuav.compiled.lanes import WIDTH
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import CITY

MULTIROTORS = {
    "hummingbird": [(0.0, 0.0, 30.0), (4.0, 0.2, 30.5), (8.0, 0.2, 0.2)],
    "cf2x": [(2.0, 0.0, 31.0), (12.0, 0.2, 0.05)],
}
WINGED = {"trainer": [(300.0, 0.0, 50.0), (300.0, 300.0, 50.0)], "quadplane": [(0.0, 300.0, 50.0)]}


def list_fleet(*parts):
    """Return the airframe and place of each drone, airframes in turn."""
    return sorted(((name, at) for part in parts for name in part for at in part[name]), key=str)


def fly_fleet(fleet, dynamics, decisions=12, **options):
    """Fly velocities that depend on the place of each drone; return the airspace."""
    names, places = zip(*fleet, strict=True)
    options = {"max_speed": 6.0, "decision_hz": 24, "seed": 0, "wind": (1.0, 0.5, 0.0), **options}
    airspace = Airspace(places, airframe=names, dynamics=dynamics, **options)
    for k in range(decisions):
        for i, (x, y, z) in enumerate(places):
            course = 0.1 * k + 0.01 * y
            speed = 4.0 if z < 40.0 else 12.0
            velocity = (speed * np.cos(course), speed * np.sin(course), 1.0 - 0.01 * x)
            airspace.command(i, "velocity", velocity)
        airspace.step()
    return airspace


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_aircraft_with_wings_change_no_bit_of_multirotors(dynamics):
    alone, winged = list_fleet(MULTIROTORS), list_fleet(WINGED)
    # Between multirotors of one block, whose order stays: wakes are summed in it
    mixed = [winged[0], *alone[:2], winged[1], *alone[2:], winged[2]]
    places = [mixed.index(one) for one in alone]
    one = fly_fleet(alone, dynamics).swarm
    other = fly_fleet(mixed, dynamics, max_speed=15.0).swarm
    for name in ("position", "quaternion", "velocity", "rates", "rotor_speed"):
        flown = getattr(one, name)
        expected = getattr(other, name)[places][:, : flown.shape[1]]
        assert flown.tobytes() == expected.tobytes(), name
    assert (one.deflection == 0.0).all()


def test_whole_blocks_of_multirotors_have_no_deflections():
    """Blocks share work arrays, which hold the deflections of other aircraft."""
    multirotors = [(2.0 * i, 0.0, 30.0) for i in range(WIDTH)]
    aeroplanes = [(300.0, 50.0 * i, 50.0) for i in range(WIDTH)]
    names = ["cf2x"] * WIDTH + ["trainer"] * WIDTH
    flown = fly_fleet(
        list(zip(names, multirotors + aeroplanes, strict=True)), "rigid_body", max_speed=15.0
    ).swarm.deflection
    assert flown[WIDTH:].any(axis=1).all()
    assert not flown[:WIDTH].any()


def test_accelerating_lift_rotors_turn_a_vtol_as_they_turn_a_multirotor():
    """J (w1 - w0) per rotor: two rotors of 7e-5 kg m^2 from 0 to 700 rad/s give 0.098 N m s."""
    vtol = load_airframe("quadplane")
    yaw = {}
    for inertia in (0.0, vtol.rotor_inertia):
        airframe = replace(vtol, rotor_inertia=inertia)
        airspace = Airspace([(0.0, 0.0, 300.0)], airframe=airframe, decision_hz=240, seed=0)
        airspace.place(0, (0.0, 0.0, 300.0), rotor_speed=0.0)
        turned = [700.0 * (turn > 0) for _, _, turn in airframe.lift_rotors]
        airspace.command(0, "rotor", [*turned, 0.0, *np.zeros(len(airframe.surfaces))])
        airspace.step()
        wound = airspace.swarm.rotor_speed[0] @ [turn > 0 for *_, turn in airframe.rotors]
        yaw[inertia] = airspace.swarm.rates[0, 2]
    gained = (yaw[vtol.rotor_inertia] - yaw[0.0]) * vtol.inertia[2]
    assert gained == pytest.approx(vtol.rotor_inertia * wound, rel=0.01)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_plain_python_flies_wings_to_the_same_bits(dynamics):
    fleet = list_fleet(WINGED, {"cf2x": MULTIROTORS["cf2x"]})
    options = {"max_speed": 15.0, "decisions": 2}
    compiled = fly_fleet(fleet, dynamics, **options)
    assert np.any(compiled.swarm.deflection)
    assert fly_fleet(fleet, dynamics, debug=True, **options).state_hash() == compiled.state_hash()


def stand(airframe, dynamics="rigid_body", friction=0.5):
    """Place an aircraft at rest on the ground, with motors off."""
    height = load_airframe(airframe).standing_height
    airspace = Airspace(
        [(0.0, 0.0, height)],
        airframe=airframe,
        dynamics=dynamics,
        decision_hz=24,
        friction=friction,
        seed=0,
    )
    airspace.place(0, (0.0, 0.0, height), velocity=(0.0, 0.0, 0.0), rotor_speed=0.0)
    return airspace


def command_rotors(airspace, throttle, deflection):
    """Command all rotors to a fraction of their highest speed, and all surfaces to an angle."""
    airframe = airspace.airframes[0]
    speeds = [throttle * airframe.max_rotor_speed] * len(airframe.rotors)
    surfaces = [deflection] * len(airframe.surfaces)
    airspace.command(0, SetpointLevel.ROTOR, (*speeds, *surfaces))
    airspace.step()


@pytest.mark.parametrize("airframe", ["trainer", "quadplane"])
@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_parked_aircraft_sleep_while_their_surfaces_move(airframe, dynamics):
    airspace = stand(airframe, dynamics)
    contact = airspace.world.dynamics.contact
    for _ in range(24):
        command_rotors(airspace, 0.0, 0.0)
    assert contact.asleep.all()
    position = airspace.swarm.position.copy()
    for _ in range(12):
        command_rotors(airspace, 0.0, 0.2)
    assert contact.asleep.all()
    np.testing.assert_array_equal(airspace.swarm.position, position)
    np.testing.assert_allclose(airspace.swarm.deflection, 0.2, atol=1e-12)


def test_full_throttle_wakes_a_parked_aeroplane():
    airspace = stand("trainer", friction=0.05)
    for _ in range(24):
        command_rotors(airspace, 0.0, 0.0)
    assert airspace.world.dynamics.contact.asleep.all()
    for _ in range(24):
        command_rotors(airspace, 1.0, 0.0)
    assert airspace.swarm.velocity[0, 0] > 1.0


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
@pytest.mark.parametrize("airframe", ["trainer", "quadplane"])
def test_aircraft_with_wings_hit_buildings(dynamics, airframe):
    """Nose first, and by a wing tip."""
    walls = Solids(np.array([[(6.0, -8.0, 0.0), (9.0, 0.0, 40.0)]]))
    places = [(0.0, -4.0, 20.0), (0.0, 0.3, 30.0)]
    airspace = Airspace(places, airframe=airframe, dynamics=dynamics, decision_hz=24, layout=walls)
    hits = set()
    for drone, place in enumerate(places):
        airspace.place(drone, place, velocity=(12.0, 0.0, 0.0))
    for _ in range(24):
        airspace.step()
        hits |= set(airspace.contacts.drone[airspace.contacts.other == CITY].tolist())
    assert hits == {0, 1}
    assert airspace.swarm.position[0, 0] < 6.0
    assert np.isfinite(airspace.swarm.position).all()
