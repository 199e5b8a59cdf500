"""MAVLink vehicles without sockets, told by pymavlink's frames what to do."""

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
from scipy.spatial.transform import Rotation

from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_protocol import Mode

ARMED = common.MAV_MODE_FLAG_SAFETY_ARMED


def test_numbers_are_those_of_the_dialect():
    """Modes by hand from PX4's px4_custom_mode.h: main mode in byte 2, sub-mode in byte 3."""
    from bulletuav.bridges import mavlink_items, mavlink_protocol, mavlink_telemetry

    commands = {
        "RETURN": common.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        "LAND": common.MAV_CMD_NAV_LAND,
        "TAKEOFF": common.MAV_CMD_NAV_TAKEOFF,
        "ORBIT": common.MAV_CMD_DO_ORBIT,
        "SET_MODE": common.MAV_CMD_DO_SET_MODE,
        "CHANGE_SPEED": common.MAV_CMD_DO_CHANGE_SPEED,
        "CHANGE_ALTITUDE": common.MAV_CMD_DO_CHANGE_ALTITUDE,
        "TERMINATE": common.MAV_CMD_DO_FLIGHTTERMINATION,
        "REPOSITION": common.MAV_CMD_DO_REPOSITION,
        "ROI_LOCATION": common.MAV_CMD_DO_SET_ROI_LOCATION,
        "ROI_NONE": common.MAV_CMD_DO_SET_ROI_NONE,
        "PAUSE": common.MAV_CMD_DO_PAUSE_CONTINUE,
        "SET_MISSION_CURRENT": common.MAV_CMD_DO_SET_MISSION_CURRENT,
        "CALIBRATE": common.MAV_CMD_PREFLIGHT_CALIBRATION,
        "MISSION_START": common.MAV_CMD_MISSION_START,
        "ARM": common.MAV_CMD_COMPONENT_ARM_DISARM,
        "INJECT_FAILURE": common.MAV_CMD_INJECT_FAILURE,
        "GET_HOME": common.MAV_CMD_GET_HOME_POSITION,
        "GET_INTERVAL": common.MAV_CMD_GET_MESSAGE_INTERVAL,
        "SET_INTERVAL": common.MAV_CMD_SET_MESSAGE_INTERVAL,
        "REQUEST_MESSAGE": common.MAV_CMD_REQUEST_MESSAGE,
        "SET_CAMERA_MODE": common.MAV_CMD_SET_CAMERA_MODE,
        "START_CAPTURE": common.MAV_CMD_IMAGE_START_CAPTURE,
        "STOP_CAPTURE": common.MAV_CMD_IMAGE_STOP_CAPTURE,
        "GIMBAL_PITCHYAW": common.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
        "GIMBAL_CONFIGURE": common.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
        "REQUEST_CAPABILITIES": common.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        "VTOL_TRANSITION": common.MAV_CMD_DO_VTOL_TRANSITION,
    }
    assert {one.name: int(one) for one in mavlink_protocol.Command} == commands
    assert [int(one) for one in mavlink_protocol.CommandResult] == [
        common.MAV_RESULT_ACCEPTED,
        common.MAV_RESULT_TEMPORARILY_REJECTED,
        common.MAV_RESULT_DENIED,
        common.MAV_RESULT_UNSUPPORTED,
    ]
    assert (Mode.HOLD, Mode.OFFBOARD) == (0x03040000, 0x00060000)
    for number, stream in mavlink_telemetry.STREAMS.items():
        assert common.mavlink_map[number].msgname == stream.name.upper()
    capabilities = common.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    capabilities |= common.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert mavlink_telemetry.CAPABILITIES & capabilities == capabilities
    assert mavlink_items.SUPPORTED_COMMANDS == (
        common.MAV_CMD_NAV_WAYPOINT,
        common.MAV_CMD_NAV_LOITER_UNLIM,
        common.MAV_CMD_NAV_LOITER_TIME,
        common.MAV_CMD_NAV_LAND,
        common.MAV_CMD_NAV_TAKEOFF,
        common.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        common.MAV_CMD_NAV_DELAY,
        common.MAV_CMD_DO_JUMP,
        common.MAV_CMD_DO_CHANGE_SPEED,
    )
    assert mavlink_items.VTOL_COMMANDS[len(mavlink_items.SUPPORTED_COMMANDS) :] == (
        common.MAV_CMD_NAV_LOITER_TURNS,
        common.MAV_CMD_NAV_LOITER_TO_ALT,
        common.MAV_CMD_DO_LAND_START,
        common.MAV_CMD_NAV_VTOL_TAKEOFF,
        common.MAV_CMD_NAV_VTOL_LAND,
        common.MAV_CMD_DO_VTOL_TRANSITION,
    )
    assert mavlink_items.INVALID_PARAM3 == common.MAV_MISSION_INVALID_PARAM3


# Arming and modes


def test_it_arms_takes_off_holds_lands_and_disarms(station):
    beat = messages(station.fly(1.0), "HEARTBEAT")[-1]
    assert (beat.type, beat.autopilot, beat.base_mode & ARMED) == (2, 12, 0)
    assert station.command(400, 1)[0] == ACCEPTED
    assert station.command(22, 0, 0, 0, NAN, NAN, NAN, NAN)[0] == ACCEPTED
    heard = station.fly(1.5)
    assert messages(heard, "HEARTBEAT")[-1].custom_mode == 4 << 16 | 2 << 24
    assert messages(heard, "HEARTBEAT")[-1].base_mode & ARMED
    heard = station.fly(3.0)
    np.testing.assert_allclose(station.place, (0, 0, -2.5), atol=0.1)
    assert messages(heard, "HEARTBEAT")[-1].custom_mode == Mode.HOLD
    assert messages(heard, "EXTENDED_SYS_STATE")[-1].landed_state == 2
    assert station.command(21)[0] == ACCEPTED
    heard = station.fly(8.0)
    assert messages(heard, "EXTENDED_SYS_STATE")[-1].landed_state == 1
    assert not messages(heard, "HEARTBEAT")[-1].base_mode & ARMED
    assert "disarmed after landing" in texts(heard)
    np.testing.assert_allclose(station.place, 0, atol=0.05)


def test_take_off_goes_to_an_altitude_above_the_sea(station):
    station.take_off(4.0)
    np.testing.assert_allclose(station.place, (0, 0, -4), atol=0.1)


def test_who_does_not_take_off_is_disarmed(station):
    station.set_parameter("COM_DISARM_PRFLT", 2.0)
    station.command(400, 1)
    station.fly(1.5)
    assert station.pilot.is_armed
    assert "disarmed: no take-off" in texts(station.fly(1.0))
    assert not station.pilot.is_armed


def test_it_is_not_disarmed_in_the_air_but_by_force(station):
    station.take_off()
    result, more = station.command(400, 0)
    assert (result, texts(more)) == (REJECTED, ["disarming denied: vehicle is flying"])
    assert station.command(400, 0, 21196)[0] == ACCEPTED
    station.fly(2.0)
    assert abs(station.place[2]) < 0.3


def test_who_lies_upside_down_is_disarmed_and_does_not_arm(station):
    station.take_off()
    place = station.pilot.state[0]
    station.fleet.airspace.place(0, (*place[:2], 0.2), (1.0, 0.0, 0.0, 0.0), rotor_speed=0.0)
    assert "upside down: disarmed" in texts(station.fly(2.0))
    result, more = station.command(400, 1)
    assert (result, texts(more)) == (REJECTED, ["arming denied: upside down; restart the server"])


def test_modes_that_are_not_there_are_refused(station):
    for main, sub in ((1, 0), (4, 9), (0, 0), (300, 0), (-1, 0)):
        assert station.mode((main, sub)) == DENIED
    assert station.command(176, 0, 4, 3)[0] == DENIED  # not PX4's own modes
    assert station.mode(MISSION) == REJECTED
    assert station.command(400, 0.5)[0] == DENIED
    assert station.command(400, 2)[0] == DENIED
    answers = station.send("set_mode", 1, 1, 1 << 16)
    assert texts(answers) == ["mode 1/0 is not supported"]


def test_a_mode_that_was_set_before_begins_with_arming(station):
    station.command(22, 0, 0, 0, NAN, NAN, NAN, NAN)
    station.fly(1.0)
    assert station.place[2] == pytest.approx(0, abs=0.01)
    station.command(400, 1)
    station.fly(4.0)
    assert station.place[2] == pytest.approx(-2.5, abs=0.1)


# Offboard


def test_offboard_needs_setpoints_and_holds_when_they_are_lost(station):
    station.take_off()
    assert station.mode(OFFBOARD) == REJECTED
    station.velocity(1.0, 0.0, 0.0)
    assert station.mode(OFFBOARD) == ACCEPTED
    station.fly(2.0, lambda: station.velocity(1.0, 0.0, 0.0))
    assert station.pilot.mode == Mode.OFFBOARD
    assert "no offboard setpoints: hold" in texts(station.fly(1.5))
    assert station.pilot.mode == Mode.HOLD
    station.fly(3.0)
    before = station.place
    station.fly(2.0)
    np.testing.assert_allclose(station.place, before, atol=0.05)


def test_it_flies_to_a_position_with_a_yaw(station):
    station.take_off()
    goal = (2.0, -1.0, -3.0)
    station.position(*goal, yaw=math.pi / 2)
    station.mode(OFFBOARD)
    heard = station.fly(6.0, lambda: station.position(*goal, yaw=math.pi / 2))
    np.testing.assert_allclose(station.place, goal, atol=0.05)
    assert messages(heard, "ATTITUDE")[-1].yaw == pytest.approx(math.pi / 2, abs=0.05)
    told = messages(heard, "LOCAL_POSITION_NED")[-1]
    np.testing.assert_allclose((told.x, told.y, told.z), goal, atol=0.05)


def test_body_velocities_turn_with_the_yaw_and_local_ones_do_not(station):
    station.take_off()
    begin = station.place

    def east():
        station.velocity(0.0, 0.0, 0.0, yaw=math.pi / 2)

    east()
    station.mode(OFFBOARD)
    station.fly(3.0, east)
    # Forward and right of who looks east are east and south.
    station.fly(2.0, lambda: station.velocity(1.0, 0.5, 0.0, frame=8))
    moved = station.place - begin
    assert moved[0] == pytest.approx(-0.5 * moved[1], abs=0.1)
    assert 1.2 < moved[1] < 2.1
    begin = station.place
    station.fly(3.0, lambda: station.velocity(1.0, 0.0, -0.5))
    moved = station.place - begin
    assert moved[0] > 2.0
    assert moved[2] == pytest.approx(-1.5, abs=0.4)


def test_a_yaw_rate_turns_to_the_right(station):
    station.take_off()
    station.velocity(0, 0, 0, yaw_rate=0.5)
    station.mode(OFFBOARD)
    heard = station.fly(2.0, lambda: station.velocity(0, 0, 0, yaw_rate=0.5))
    assert messages(heard, "ATTITUDE")[-1].yawspeed == pytest.approx(0.5, abs=0.05)
    assert 0.6 < messages(heard, "ATTITUDE")[-1].yaw < 1.1


def test_velocities_may_hold_a_height_and_positions_may_move(station):
    station.take_off()

    def level():
        fields = (0, 0, -4.0, 1.0, 0, 0, 0, 0, 0, 0, 0)
        station.send("set_position_target_local_ned", 0, 1, 1, 1, 0xDE3 & ~4, *fields)

    level()
    station.mode(OFFBOARD)
    station.fly(4.0, level)
    assert station.place[2] == pytest.approx(-4.0, abs=0.1)
    assert station.place[0] > 2.5
    begin, at = station.place, [0.0]

    def moving():
        at[0] += 0.05
        fields = (*(begin + (at[0], 0, 0)), 1.0, 0, 0, 0, 0, 0, 0, 0)
        station.send("set_position_target_local_ned", 0, 1, 1, 1, 0xDC0, *fields)

    station.fly(4.0, moving)
    assert station.place[0] == pytest.approx(begin[0] + 4.0, abs=0.15)


def test_accelerations_push(station):
    station.take_off()

    def push():
        fields = (0, 0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0)
        station.send("set_position_target_local_ned", 0, 1, 1, 1, 0xC3F, *fields)

    push()
    station.mode(OFFBOARD)
    station.fly(1.5, push)
    assert station.pilot.state[2][1] == pytest.approx(1.5, abs=0.4)


def test_a_place_on_the_earth_is_flown_to(station):
    station.take_off()
    altitude = station.vehicle.site.altitude

    def go():
        fields = (*station.spot(3.0, 2.0), altitude + 4.0, *[0.0] * 8)
        station.send("set_position_target_global_int", 0, 1, 1, 5, 0xDF8, *fields)

    go()
    station.mode(OFFBOARD)
    heard = station.fly(6.0, go)
    np.testing.assert_allclose(station.place, (3, 2, -4), atol=0.1)
    told = messages(heard, "GLOBAL_POSITION_INT")[-1]
    assert told.relative_alt == pytest.approx(4000, abs=100)
    assert abs(told.lat - station.spot(3.0, 2.0)[0]) < 10
    assert abs(told.lon - station.spot(3.0, 2.0)[1]) < 10


def test_attitudes_and_rates_are_followed(station):
    station.take_off()
    hover = station.vehicle.parameters.values["MPC_THR_HOVER"]
    x, y, z, w = Rotation.from_euler("ZYX", (0.3, -0.1, 0.05)).as_quat()

    def lean():
        fields = (7, [w, x, y, z], 0, 0, 0, hover)
        station.send("set_attitude_target", 0, 1, 1, *fields)

    lean()
    station.mode(OFFBOARD)
    heard = station.fly(1.0, lean)
    told = messages(heard, "ATTITUDE")[-1]
    np.testing.assert_allclose((told.roll, told.pitch, told.yaw), (0.05, -0.1, 0.3), atol=0.02)
    quaternion = messages(heard, "ATTITUDE_QUATERNION")[-1]
    found = Rotation.from_quat((quaternion.q2, quaternion.q3, quaternion.q4, quaternion.q1))
    np.testing.assert_allclose(found.as_euler("ZYX"), (0.3, -0.1, 0.05), atol=0.02)
    assert station.place[0] > 0.2  # nose down: it flies forward
    rates = (128, [1, 0, 0, 0], 0.2, 0.0, 0.0, hover)
    heard = station.fly(0.5, lambda: station.send("set_attitude_target", 0, 1, 1, *rates))
    assert messages(heard, "ATTITUDE")[-1].rollspeed == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize(
    ("frame", "mask", "said"),
    [
        (1, 0xFFF, "setpoint with mask 0xfff unsupported"),
        (1, 0x200, "setpoint: forces are not supported"),
        (7, 0xDF8, "setpoint in frame 7: 1 or 8 is needed"),
        (1, 0xDFD, "setpoint with mask 0xdfd unsupported"),
        (8, 0xC3F, "setpoint with mask 0xc3f unsupported"),
    ],
)
def test_setpoints_that_cannot_be_are_told_once_a_second(frame, mask, said, station):
    station.take_off()
    fields = (0, 1, 1, frame, mask, *[0.5] * 11)
    assert texts(station.send("set_position_target_local_ned", *fields)) == [said]
    assert station.send("set_position_target_local_ned", *fields) == []
    assert station.mode(OFFBOARD) == REJECTED


@pytest.mark.parametrize("mask", [0xDF8, 0xDC7], ids=["position", "velocity"])
def test_global_setpoints_need_a_global_frame(mask, station):
    station.take_off()
    place = (int(47.4 * 1e7), int(8.5 * 1e7), 2.0)

    def send(frame):
        fields = (0, 1, 1, frame, mask, *place, *[0.5] * 8)
        return texts(station.send("set_position_target_global_int", *fields))

    assert send(8) == ["frame 8: 0, 3, 5 or 6 is needed"]
    station.fly(1.1)
    assert all("frame" not in text for text in send(6))


@pytest.mark.parametrize("wrong", [NAN, math.inf, 1e9])
def test_setpoints_that_are_no_numbers_are_refused(wrong, station):
    assert texts(station.position(wrong, 0, -2))
    station.fly(1.1)
    if wrong != 1e9:  # which is cut
        assert texts(station.velocity(wrong, 0, 0)) == ["setpoint: finite numbers are needed"]
        station.fly(1.1)
        attitude = ([wrong, 0, 0, 0], 0, 0, 0, 0.5)
        assert texts(station.send("set_attitude_target", 0, 1, 1, 7, *attitude))
    station.fly(1.1)
    none = ([0, 0, 0, 0], 0, 0, 0, 0.5)
    (said,) = texts(station.send("set_attitude_target", 0, 1, 1, 7, *none))
    assert said == "attitude setpoint: the quaternion has norm 0"


def test_a_second_client_cannot_fly_it_meanwhile(station):
    station.take_off()
    other = Station(station.fleet, link="elsewhere")
    station.velocity(0.5, 0, 0)
    (said,) = texts(other.velocity(-0.5, 0, 0))
    assert said == "setpoints denied: another client sends setpoints"
    station.mode(OFFBOARD)
    station.fly(2.0, lambda: (station.velocity(0.5, 0, 0), other.velocity(-0.5, 0, 0)))
    assert station.place[0] > 0.5
    station.fly(1.5)  # the first is silent
    assert other.velocity(-0.5, 0, 0) == []


# Return, and places


def test_it_returns_and_lands_at_home(station):
    station.set_parameter("RTL_RETURN_ALT", 5.0)
    station.set_parameter("RTL_DESCEND_ALT", 2.0)
    station.take_off()
    latitude, longitude = station.spot(6.0, 3.0)
    site = station.vehicle.site
    place = (latitude, longitude, site.altitude + 3.0)
    fields = (5, 192, 0, 0, -1, 1, 0, NAN, *place)
    (ack,) = station.send("command_int", *station.target, *fields)
    assert ack.result == ACCEPTED
    station.fly(6.0)
    np.testing.assert_allclose(station.place, (6, 3, -3), atol=0.1)
    assert station.mode(RETURN) == ACCEPTED
    highest = [0.0]
    station.fly(20.0, lambda: highest.append(station.place[2]))
    assert min(highest) == pytest.approx(-5.0, abs=0.2)
    np.testing.assert_allclose(station.place, 0, atol=0.1)
    assert not station.pilot.is_armed


def test_a_place_is_refused_to_who_stands(station):
    result, more = station.command(192, -1, 1, 0, NAN, NAN, NAN, NAN)
    assert (result, texts(more)) == (REJECTED, ["not flying: arm and take off first"])


def test_it_pauses_where_it_is(station):
    station.take_off()
    station.mode(LAND)
    station.fly(0.5)
    assert station.command(193, 0)[0] == ACCEPTED
    assert station.pilot.mode == Mode.HOLD
    station.fly(3.0)
    before = station.place
    station.fly(1.0)
    np.testing.assert_allclose(station.place, before, atol=0.02)
    assert station.mode(HOLD) == ACCEPTED
    assert station.command(185, 1)[0] == ACCEPTED  # flight termination
    station.fly(2.0)
    assert station.place[2] > -0.3


# The fence


def test_positions_outside_the_fence_are_refused_and_velocities_stop_there(station):
    station.take_off()
    station.set_parameter("GF_MAX_HOR_DIST", 4.0)
    station.set_parameter("GF_MAX_VER_DIST", 5.0)
    (said,) = texts(station.position(5.0, 0.0, -2.0))
    assert said == "setpoint is outside GF_MAX_HOR_DIST of 4 m"
    result, more = station.command(22, 0, 0, 0, NAN, NAN, NAN, 600.0)
    assert (result, texts(more)) == (DENIED, ["take-off is outside GF_MAX_VER_DIST of 5 m"])
    station.velocity(1.5, 0, 0)
    station.mode(OFFBOARD)
    heard = station.fly(6.0, lambda: station.velocity(1.5, 0, 0))
    assert "vehicle is outside GF_MAX_HOR_DIST of 4 m" in texts(heard)
    assert station.pilot.mode == Mode.HOLD
    assert 3.5 < station.place[0] < 5.0
    # Back inside, it may be flown on.
    station.fly(2.0, lambda: station.velocity(-1.0, 0, 0))
    station.mode(OFFBOARD)
    station.fly(2.0, lambda: station.velocity(-1.0, 0, 0))
    assert station.place[0] < 3.5


def test_the_fence_may_send_it_home(station):
    station.set_parameter("GF_ACTION", 3)
    station.set_parameter("GF_MAX_HOR_DIST", 3.0)
    station.take_off()
    station.velocity(1.5, 0, 0)
    station.mode(OFFBOARD)
    station.fly(4.0, lambda: station.velocity(1.5, 0, 0))
    assert station.pilot.mode == Mode.RETURN


# Two vehicles


def test_vehicles_have_their_own_numbers_and_starts(make_vehicles):
    fleet = make_vehicles(2)
    first, second = Station(fleet), Station(fleet, 1)
    assert second.command(400, 1)[0] == ACCEPTED
    assert not first.pilot.is_armed
    message = common.MAVLink_command_long_message(2, 1, 400, 0, *[0.0] * 7)
    (received,) = first.reader.read(bytes(message.pack(first.packer)))
    assert fleet.take(0, received, first.sender) == []  # it is for the other
    for other in (100, 154):
        message.target_system, message.target_component = 1, other
        (received,) = first.reader.read(bytes(message.pack(first.packer)))
        assert fleet.take(0, received, first.sender) == []  # it is for a camera, or a gimbal
    np.testing.assert_allclose(second.place, 0, atol=0.01)
    (home,) = messages(second.command(410)[1], "HOME_POSITION")
    assert home.latitude == pytest.approx(473977420, abs=1)
    assert home.longitude == pytest.approx(85455940 + 265, abs=2)  # 2 m to the east
    assert (home.altitude - 488000) / 1000 == pytest.approx(0.055, abs=0.01)


def test_the_same_messages_give_the_same_flight():
    def flight():
        fleet = MavlinkFleet(2, turbulence="light", seed=3)
        station = Station(fleet, 1)
        station.take_off()
        station.velocity(1.0, 0.3, 0)
        station.mode(OFFBOARD)
        station.fly(1.0, lambda: station.velocity(1.0, 0.3, 0))
        told = fleet.airspace.state_hash()
        fleet.close()
        return told

    assert flight() == flight()


def test_options_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="decision_hz is 100"):
        MavlinkFleet(1, decision_hz=50)
    with pytest.raises(ValueError, match="number of drones is 251"):
        MavlinkFleet(251)
    with pytest.raises(ValueError, match="latitude"):
        MavlinkFleet(1, home=(100.0, 0.0, 0.0))


def test_unknown_commands_are_unsupported(station):
    for number in (999, 31000, 246, 65535):
        assert station.command(number)[0] == UNSUPPORTED
