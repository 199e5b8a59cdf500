"""Aircraft with wings fly by MAVLink: trainer (fixed wing) and quadplane (VTOL)."""

import math

import numpy as np
import pytest
from bridges.mavlink_client import (
    ACCEPTED,
    DENIED,
    HOLD,
    LAND,
    MISSION,
    NAN,
    OFFBOARD,
    REJECTED,
    RETURN,
    UNSUPPORTED,
    Station,
    common,
    messages,
    texts,
)

from bulletuav.bridges import mavlink_items
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.mavlink_protocol import Mode
from bulletuav.bridges.setpoints import NORTH, Setpoint
from bulletuav.control.fixed_wing import SPEED_RATE
from bulletuav.control.setpoint import SetpointLevel

TRANSITION, TO_ROTORS, TO_WINGS = 3000, 3, 4
POSITION = (3, 0)
STILL = [0.0, 0.0, 0.0]


@pytest.fixture
def trainer(make_vehicles):
    return Station(make_vehicles(1, "trainer"))


@pytest.fixture
def quadplane(make_vehicles):
    return Station(make_vehicles(1, "quadplane"))


def lift(station, height=40.0, speed=11.0):
    """Arm a fixed wing, and place it in level flight to the north; it loiters."""
    low = station.vehicle.site.altitude + 10.0
    assert station.command(22, 0, 0, 0, NAN, NAN, NAN, low)[0] == ACCEPTED
    assert station.command(400, 1)[0] == ACCEPTED
    station.fly(0.1)
    place, velocity = (0.0, 0.0, height), (0.0, speed, 0.0)
    station.fleet.airspace.place(0, place, NORTH, velocity, rotor_speed="hover")
    station.fly(0.5)
    assert station.pilot.mode == Mode.HOLD


def distances(station, north, east, seconds):
    """Return the distances from a point over some time, at 20 Hz."""
    found = []
    station.fly(seconds, lambda: found.append(math.dist(station.place[:2], (north, east))))
    return found


# Steering


def state(x=0.0, y=0.0, velocity=(0.0, 10.0, 0.0)):
    return [x, y, 50.0], list(NORTH), list(velocity), STILL


def test_a_course_leads_to_a_line_at_45_degrees_from_its_width(trainer):
    wings = trainer.vehicle.wings
    width = wings.width(state())
    assert wings.line_course(state(), (0.0, 9.0, 0.0), math.pi / 2) == pytest.approx(math.pi / 2)
    east_of_it = wings.line_course(state(x=width), (0.0, 9.0, 0.0), math.pi / 2)
    assert east_of_it == pytest.approx(3 * math.pi / 4)
    west_of_it = wings.line_course(state(x=-width), (0.0, 9.0, 0.0), math.pi / 2)
    assert west_of_it == pytest.approx(math.pi / 4)


@pytest.mark.parametrize(("radius", "turn"), [(50.0, -1), (-50.0, 1)])
def test_a_course_on_a_circle_leads_its_tangent(trainer, radius, turn):
    """East of the centre, the tangent is south clockwise, and north anticlockwise."""
    wings = trainer.vehicle.wings
    place = state(x=50.0, velocity=(0.0, turn * 10.0, 0.0))
    lead = math.asin(10.0 / (wings._course_rate * 50.0))
    course = wings.circle_course(place, (0.0, 0.0, 50.0), radius)
    assert course == pytest.approx(turn * (math.pi / 2 + lead))


def test_courses_in_wind_keep_the_airspeed(make_vehicles):
    """Wind of 5 m/s across, 13 m/s through the air: 12 m/s over ground."""
    station = Station(make_vehicles(1, "quadplane", wind=(5.0, 0.0, 0.0)))
    station.fly(0.01)
    command = station.vehicle.wings.fly(state(), math.pi / 2, 1.0, 13.0)
    assert command.level == SetpointLevel.VELOCITY
    np.testing.assert_allclose(command.values[:3], (0.0, 12.0, 1.0), atol=1e-12)
    # Flying at 5 m/s against the wind at 13 m/s: the airspeed is too high by 5 m/s
    station = Station(make_vehicles(1, "trainer", wind=(0.0, -8.0, 0.0)))
    station.fly(0.01)
    flying = state(velocity=(0.0, 10.0, 0.0))
    command = station.vehicle.wings.fly(flying, math.pi / 2, 0.0, 13.0)
    assert command.level == SetpointLevel.ACCELERATION
    np.testing.assert_allclose(command.values[:3], (0.0, -5.0 * SPEED_RATE, 0.0), atol=1e-5)


def test_wings_make_headway_in_strong_wind(make_vehicles):
    station = Station(make_vehicles(1, "trainer", wind=(0.0, -12.0, 0.0)))
    station.fly(0.01)
    flying = state(velocity=(0.0, 5.0, 0.0))
    command = station.vehicle.wings.fly(flying, math.pi / 2, 0.0, 10.0)
    np.testing.assert_allclose(command.values[:2], 0.0, atol=1e-5)


# Fixed wing


def test_a_fixed_wing_takes_off_and_loiters(trainer):
    assert trainer.command(400, 1)[0] == ACCEPTED
    assert trainer.command(22, 0, 0, 0, NAN, NAN, NAN, NAN)[0] == ACCEPTED
    heard = trainer.fly(4.0)
    beat = messages(heard, "HEARTBEAT")[-1]
    assert (beat.type, beat.custom_mode) == (common.MAV_TYPE_FIXED_WING, Mode.TAKEOFF)
    assert messages(heard, "VFR_HUD")[-1].throttle > 80
    heard = trainer.fly(16.0)
    assert messages(heard, "HEARTBEAT")[-1].custom_mode == Mode.HOLD
    extended = messages(heard, "EXTENDED_SYS_STATE")[-1]
    assert (extended.vtol_state, extended.landed_state) == (0, 2)
    east, north, _ = trainer.pilot._motion.center
    found = distances(trainer, north, east, 25.0)[200:]
    radius = trainer.vehicle.parameters.values["NAV_LOITER_RAD"]
    np.testing.assert_allclose(found, radius, atol=1.0)
    assert trainer.place[2] == pytest.approx(-25.0, abs=1.0)
    hud = messages(trainer.fly(1.0), "VFR_HUD")[-1]
    assert hud.airspeed == pytest.approx(trainer.vehicle.wings.speed, abs=0.3)
    assert 40 < hud.throttle < 80


def test_a_launcher_helps_without_a_runway(trainer):
    trainer.set_parameter("RWTO_TKOFF", 0)
    trainer.command(22, 0, 0, 0, NAN, NAN, NAN, NAN)
    trainer.command(400, 1)
    trainer.fly(0.5)
    # v = a t: 12 m/s after 0.4 s at 30 m/s^2
    assert trainer.vehicle.wings.airspeed(trainer.pilot.state) == pytest.approx(12.0, abs=1.0)
    trainer.fly(5.0)
    assert -trainer.place[2] > 10.0


def test_waypoints_are_passed_and_turns_counted(trainer):
    lift(trainer, 30.0)
    spots = [(150.0, 0.0, 30.0), (150.0, 150.0, 35.0), (0.0, 150.0, 30.0)]
    items = [trainer.waypoint(*spot) for spot in spots]
    turns = (6, 18, 1.0, 0, -40.0, NAN, *trainer.spot(0.0, 150.0), 30.0)
    assert trainer.upload([*items, turns]) == 0
    assert trainer.mode(MISSION) == ACCEPTED
    least = np.full(3, np.inf)
    times = {}

    def look():
        for k, spot in enumerate(spots):
            least[k] = min(least[k], math.dist(trainer.place[:2], spot[:2]))

    for _ in range(100):
        for one in messages(trainer.fly(1.0, look), "MISSION_ITEM_REACHED"):
            times[one.seq] = trainer.fleet.time
        if trainer.pilot.mode == Mode.HOLD:
            break
    assert sorted(times) == [0, 1, 2, 3]
    assert (least <= 10.0).all()
    # One turn of 40 m after the way to the circle, 40 m at most
    speed = trainer.vehicle.wings.speed
    assert math.tau * 40 / speed < times[3] - times[2] < (math.tau * 40 + 80) / speed
    x, y = trainer.place[:2]
    vy, vx = trainer.pilot.state[2][:2]
    assert x * vy - (y - 150) * vx < 0  # anticlockwise, with north and east


def test_a_landing_ends_near_its_point(trainer):
    lift(trainer, 20.0)
    items = [trainer.waypoint(60.0, 0.0, 20.0), trainer.waypoint(0.0, 420.0, 20.0)]
    land = (6, 21, 0, 0, 0, NAN, *trainer.spot(0.0, 0.0), 0.0)
    assert trainer.upload([*items, land]) == 0
    assert trainer.mode(MISSION) == ACCEPTED
    touched, sink = None, 0.0
    for _ in range(12000):
        trainer.fly(0.01)
        if trainer.pilot._is_touching:
            touched = trainer.place[:2]
            break
        sink = -trainer.pilot.state[2][2]
    assert np.linalg.norm(touched) < 25.0
    assert 0.0 < sink < 0.6
    assert not trainer.pilot.has_landed  # it rolls
    heard = trainer.fly(15.0)
    assert "disarmed after landing" in texts(heard)
    assert np.linalg.norm(trainer.place[:2]) < 80.0


def test_it_holds_goes_to_places_and_changes_height_and_speed(trainer):
    lift(trainer)
    altitude = trainer.vehicle.site.altitude
    assert trainer.command(178, 0, 14.0, -1)[0] == ACCEPTED
    assert trainer.command(186, 45.0, 3)[0] == ACCEPTED
    trainer.fly(15.0)
    assert trainer.place[2] == pytest.approx(-45.0, abs=1.0)
    assert trainer.vehicle.wings.airspeed(trainer.pilot.state) == pytest.approx(14.0, abs=0.5)
    spot = trainer.degrees(80.0, 20.0)
    numbers = (-1, 0, -50.0, NAN, *spot, altitude + 40.0)
    assert trainer.command(192, *numbers)[0] == ACCEPTED
    trainer.fly(25.0)
    np.testing.assert_allclose(distances(trainer, 80.0, 20.0, 10.0), 50.0, atol=1.5)
    assert trainer.command(34, 50.0, NAN, 0, 0, *spot, altitude + 40.0)[0] == ACCEPTED
    trainer.fly(25.0)
    np.testing.assert_allclose(distances(trainer, 80.0, 20.0, 5.0), 50.0, atol=1.5)
    result, more = trainer.command(34, 10.0, NAN, 0, 0, *spot, altitude + 40.0)
    assert result == DENIED
    assert "radius below" in texts(more)[0]


def test_a_return_circles_home_and_lands_if_it_is_to(trainer):
    trainer.set_parameter("RTL_RETURN_ALT", 40.0)
    lift(trainer)
    assert trainer.mode(RETURN) == ACCEPTED
    trainer.fly(50.0)
    np.testing.assert_allclose(
        distances(trainer, 0.0, 0.0, 5.0), trainer.vehicle.wings.radius, atol=1
    )
    assert trainer.pilot.mode == Mode.RETURN
    assert trainer.place[2] == pytest.approx(-30.0, abs=1.0)
    trainer.set_parameter("RTL_LAND_DELAY", 0.0)
    assert trainer.mode(RETURN) == ACCEPTED
    assert "disarmed after landing" in texts(trainer.fly(150.0))


def test_a_breach_of_the_fence_makes_it_loiter(trainer):
    lift(trainer)
    trainer.set_parameter("GF_MAX_HOR_DIST", 60.0)
    trainer.velocity(12.0, 0.0, 0.0)
    assert trainer.mode(OFFBOARD) == ACCEPTED
    heard = trainer.fly(12.0, lambda: trainer.velocity(12.0, 0.0, 0.0))
    assert any("GF_MAX_HOR_DIST" in one for one in texts(heard))
    assert trainer.pilot.mode == Mode.HOLD
    speed = trainer.vehicle.wings.airspeed(trainer.pilot.state)
    assert speed > trainer.vehicle.wings.stall_speed


def test_offboard_positions_are_circled_and_thrust_is_of_the_forward_rotor(trainer):
    lift(trainer)
    goal = (60.0, 0.0, -40.0)
    trainer.position(*goal)
    assert trainer.mode(OFFBOARD) == ACCEPTED
    trainer.fly(20.0, lambda: trainer.position(*goal))
    found = []

    def look():
        trainer.position(*goal)
        found.append(math.dist(trainer.place[:2], goal[:2]))

    trainer.fly(5.0, look)
    np.testing.assert_allclose(found, trainer.vehicle.wings.radius, atol=1.5)
    level = (0, *trainer.target, 0b111, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.5)
    trainer.send("set_attitude_target", *level)
    airframe = trainer.fleet.airspace.airframes[0]
    full = airframe.thrust_coefficient * airframe.max_rotor_speed**2
    setpoint = trainer.pilot._offboard_setpoint
    assert isinstance(setpoint, Setpoint)
    assert setpoint.z == pytest.approx(full / 2)


def test_sticks_bank_climb_and_set_the_airspeed(trainer):
    lift(trainer)
    trainer.fly(20.0)
    trainer.sticks()
    assert trainer.mode(POSITION) == ACCEPTED
    trainer.fly(3.0, lambda: trainer.sticks(pitch=-500))
    height = -trainer.place[2]
    heard = trainer.fly(3.0, lambda: trainer.sticks(pitch=-500))
    assert -trainer.place[2] > height + 3.0  # stick back: it climbs
    assert abs(messages(heard, "ATTITUDE")[-1].roll) < 0.1
    heard = trainer.fly(3.0, lambda: trainer.sticks(roll=800))
    assert messages(heard, "ATTITUDE")[-1].roll > 0.3
    assert "no manual control: hold" in texts(trainer.fly(1.0))


def test_without_gps_it_descends_in_a_turn(trainer):
    trainer.set_parameter("SYS_FAILURE_EN", 1)
    lift(trainer, 12.0)
    assert trainer.command(420, 4, 1, 0)[0] == ACCEPTED
    heard = trainer.fly(35.0)
    assert "GPS failed: land" in texts(heard)
    assert "disarmed after landing" in texts(heard)


def test_what_a_fixed_wing_cannot_do_is_denied(trainer, station):
    assert trainer.command(TRANSITION, TO_ROTORS)[0] == UNSUPPORTED
    assert trainer.command(186, 45.0, 3)[0] == REJECTED  # not flying
    trainer.sticks()
    assert trainer.mode(POSITION) == REJECTED
    assert trainer.pilot.mode == Mode.HOLD
    assert trainer.upload([(2, TRANSITION, 4, 0, 0, 0, 0, 0, 0)]) == mavlink_items.UNSUPPORTED
    small = (6, 18, 1.0, 0, 5.0, NAN, *trainer.spot(0.0, 50.0), 30.0)
    assert trainer.upload([small]) == mavlink_items.INVALID_PARAM3
    lift(trainer)
    result, more = trainer.command(176, 1, 4, 8)
    assert (result, texts(more)) == (DENIED, ["follow denied: on wings"])
    # A multirotor neither turns into an aeroplane nor flies circles of missions
    assert station.command(TRANSITION, TO_WINGS)[0] == UNSUPPORTED
    assert station.upload([small]) == mavlink_items.UNSUPPORTED


# VTOL


def test_a_vtol_flies_on_its_wings_and_back(quadplane):
    altitude = quadplane.vehicle.site.altitude
    assert quadplane.command(TRANSITION, TO_WINGS)[0] == REJECTED  # not flying
    quadplane.command(400, 1)
    assert quadplane.command(22, 0, 0, 0, NAN, NAN, NAN, altitude + 12.0)[0] == ACCEPTED
    heard = quadplane.fly(11.0)
    beat = messages(heard, "HEARTBEAT")[-1]
    assert (beat.type, beat.custom_mode) == (22, Mode.HOLD)
    assert messages(heard, "EXTENDED_SYS_STATE")[-1].vtol_state == common.MAV_VTOL_STATE_MC
    assert quadplane.command(TRANSITION, 2)[0] == DENIED
    assert quadplane.command(TRANSITION, TO_WINGS)[0] == ACCEPTED
    heights = []
    heard = quadplane.fly(12.0, lambda: heights.append(-quadplane.place[2]))
    states = [one.vtol_state for one in messages(heard, "EXTENDED_SYS_STATE")]
    assert states[0] == common.MAV_VTOL_STATE_TRANSITION_TO_FW
    assert states[-1] == common.MAV_VTOL_STATE_FW
    assert messages(heard, "VFR_HUD")[-1].airspeed > quadplane.vehicle.wings.min_speed
    lift_rotors = quadplane.fleet.airspace.swarm.rotor_speed[0, :4]
    np.testing.assert_allclose(lift_rotors, 0.0, atol=1.0)
    assert quadplane.command(TRANSITION, TO_ROTORS)[0] == ACCEPTED
    heard = quadplane.fly(10.0, lambda: heights.append(-quadplane.place[2]))
    states = [one.vtol_state for one in messages(heard, "EXTENDED_SYS_STATE")]
    assert states[0] == common.MAV_VTOL_STATE_TRANSITION_TO_MC
    assert states[-1] == common.MAV_VTOL_STATE_MC
    assert min(heights) > 10.0
    assert np.linalg.norm(quadplane.pilot.state[2]) < 0.5
    assert quadplane.mode(LAND) == ACCEPTED
    assert "disarmed after landing" in texts(quadplane.fly(25.0))


def test_a_vtol_flies_by_sticks_on_its_rotors_and_on_its_wings(quadplane):
    quadplane.take_off(12.0)
    quadplane.fly(6.0)
    quadplane.sticks()
    assert quadplane.mode(POSITION) == ACCEPTED
    assert quadplane.command(TRANSITION, TO_WINGS)[0] == ACCEPTED
    heard = quadplane.fly(12.0, quadplane.sticks)
    assert texts(heard) == []
    assert quadplane.pilot.mode == Mode.POSITION
    heard = quadplane.fly(3.0, lambda: quadplane.sticks(roll=800))
    assert messages(heard, "ATTITUDE")[-1].roll > 0.3
    assert "no manual control: hold" in texts(quadplane.fly(1.0))


def test_a_mission_of_a_vtol_takes_off_and_lands_on_rotors(quadplane):
    here = (0, 0, 12.0)
    items = [
        (6, 84, 0, 0, 0, NAN, *here),
        quadplane.waypoint(150.0, 0.0, 20.0),
        (6, 85, 0, 0, 0, NAN, *quadplane.spot(0.0, 0.0), 0.0),
    ]
    assert quadplane.upload(items) == 0
    quadplane.command(400, 1)
    assert quadplane.mode(MISSION) == ACCEPTED
    fastest = 0.0
    for _ in range(150):
        heard = quadplane.fly(1.0)
        fastest = max(fastest, quadplane.vehicle.wings.airspeed(quadplane.pilot.state))
        if "disarmed after landing" in texts(heard):
            break
    assert fastest > quadplane.vehicle.wings.min_speed
    np.testing.assert_allclose(quadplane.place, 0.0, atol=0.5)


# Other servers


@pytest.mark.parametrize(
    ("make", "name"), [(AirsimWorld, "AirSim"), (CrazyflieFleet, "Crazyflies")]
)
def test_servers_of_hovering_clients_refuse_a_fixed_wing(make, name):
    with pytest.raises(ValueError, match=f"'trainer', which cannot hover, as clients of {name}"):
        make(1, "trainer")


def test_holding_on_wings_is_a_loiter(trainer):
    lift(trainer)
    assert trainer.mode(HOLD) == ACCEPTED
    trainer.fly(20.0)
    assert np.linalg.norm(trainer.pilot.state[2][:2]) > trainer.vehicle.wings.stall_speed
