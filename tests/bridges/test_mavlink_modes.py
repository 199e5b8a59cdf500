"""Orbit, following, manual control, rally points, failures and the shell of MAVLink vehicles."""

import logging
import math

import numpy as np
import pytest
from bridges.mavlink_client import (
    ACCEPTED,
    DENIED,
    HOLD,
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
from PIL import Image

from bulletuav.bridges.mavlink_failures import BATTERY, GPS, MOTOR
from bulletuav.bridges.mavlink_protocol import Mode

POSITION, ALTITUDE, FOLLOW = (3, 0), (2, 0), (4, 8)
RALLY = 2


def heading(station):
    """Heading of a vehicle, degrees clockwise from north."""
    (hud,) = station.command(512, 74)[1]
    return hud.heading


# Orbit


def orbit(station, radius, speed, behavior, north, east, altitude=NAN, angle=0.0):
    place = station.degrees(north, east)
    return station.command(34, radius, speed, behavior, angle, *place, altitude)


@pytest.mark.parametrize("radius", [5.0, -5.0])
def test_an_orbit_is_round_and_faces_its_centre(radius, station):
    station.take_off(4.0)
    assert orbit(station, radius, 2.0, 0, 8.0, 0.0)[0] == ACCEPTED
    station.fly(4.0)
    assert station.pilot.mode == Mode.ORBIT
    angles = []
    for _ in range(10):
        station.fly(0.5)
        north, east, down = station.place
        assert math.hypot(north - 8, east) == pytest.approx(5.0, abs=0.25)
        assert down == pytest.approx(-4.0, abs=0.15)
        bearing = math.degrees(math.atan2(0 - east, 8 - north))
        assert abs(math.remainder(heading(station) - bearing, 360)) < 12
        angles.append(math.atan2(east, north - 8))
    # 2 m/s on a radius of 5 m; seen from above, clockwise is from north to east
    turn = (np.unwrap(angles)[-1] - angles[0]) / 4.5
    assert turn == pytest.approx(math.copysign(0.4, radius), abs=0.02)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ((0.5, 2.0, 0), "radius"),
        ((5000.0, 2.0, 0), "radius"),
        ((NAN, 2.0, 0), "radius"),
        ((5.0, 0.0, 0), "speed"),
        ((5.0, 4.0, 0), "speed"),
        ((5.0, 2.0, 4), "yaw behaviour"),
    ],
)
def test_orbits_that_cannot_be_are_denied(fields, said, station):
    station.take_off(4.0)
    result, more = orbit(station, *fields, 8.0, 0.0)
    assert result == DENIED
    assert said in texts(more)[0]


def test_an_orbit_has_no_end(station):
    station.take_off(4.0)
    result, more = orbit(station, 5.0, 2.0, 0, 8.0, 0.0, angle=math.pi)
    assert (result, texts(more)) == (DENIED, ["orbit: angle 0 (without end) is needed"])
    assert orbit(station, 5.0, 2.0, 0, 8.0, 0.0, angle=NAN)[0] == ACCEPTED


def test_an_orbit_needs_a_flying_vehicle_and_a_circle_inside_the_fence(station):
    assert orbit(station, 5.0, 2.0, 0, 8.0, 0.0)[0] == REJECTED
    station.take_off(4.0)
    station.set_parameter("GF_MAX_HOR_DIST", 20.0)
    assert orbit(station, 5.0, 2.0, 0, 40.0, 0.0)[0] == DENIED
    # The nearest point of the circle is inside, the farthest is not
    result, more = orbit(station, 6.0, 2.0, 0, 15.0, 0.0)
    assert (result, texts(more)) == (DENIED, ["circle is outside GF_MAX_HOR_DIST of 20 m"])
    assert orbit(station, 4.0, 2.0, 0, 15.0, 0.0)[0] == ACCEPTED
    assert station.mode((3, 1)) == DENIED


# Following


def follow_target(station, north, east, altitude, velocity=(0.0, 0.0, 0.0)):
    nothing = [0.0] * 3
    fields = (3, *station.spot(north, east), altitude, velocity, nothing, [1.0, 0, 0, 0])
    return station.send("follow_target", 0, *fields, nothing, nothing, 0)


def test_it_follows_behind_a_moving_target_and_faces_it(station):
    station.take_off(8.0)
    station.fly(3.0)
    station.set_parameter("FLW_TGT_DST", 4.0)
    assert station.mode(FOLLOW) == ACCEPTED
    station.fly(1.0)
    np.testing.assert_allclose(station.place, (0, 0, -8), atol=0.2)  # no target yet
    clock = iter(range(10_000))

    def move():
        k = next(clock)
        follow_target(station, 6.0, 0.05 * k, 480.0, (0.0, 1.0, 0.0))

    station.fly(12.0, move)
    target_east = 0.05 * next(clock)
    np.testing.assert_allclose(station.place, (6, target_east - 4, -8), atol=0.6)
    assert abs(math.remainder(heading(station) - 90, 360)) < 10
    # Above a target of that altitude, and never on the ground
    station.set_parameter("FLW_TGT_ALT_M", 2)
    station.fly(8.0, move)
    assert station.place[2] == pytest.approx(-1.0, abs=0.2)
    assert station.mode(HOLD) == ACCEPTED


def test_it_waits_for_a_target_that_is_lost(station):
    station.take_off(8.0)
    station.set_parameter("FLW_TGT_DST", 4.0)
    station.mode(FOLLOW)
    follow_target(station, 4.0, 0.0, 480.0, (3.0, 0.0, 0.0))
    assert texts(station.fly(2.9)) == []
    assert texts(station.fly(9.0)) == ["target lost: waiting at its last position"]
    # 3 s at 3 m/s beyond the last position, and 4 m behind
    np.testing.assert_allclose(station.place, (9, 0, -8), atol=0.3)
    assert station.pilot.mode == Mode.FOLLOW
    follow_target(station, 20.0, 0.0, 480.0, (1.0, 0.0, 0.0))
    assert texts(station.fly(2.0)) == []
    assert station.place[0] > 12
    assert len(texts(station.fly(2.0))) == 1


# Manual control


def test_sticks_take_off_fly_hold_and_land(station):
    assert station.mode(POSITION) == REJECTED  # no sticks yet
    station.sticks()
    assert station.mode(POSITION) == ACCEPTED
    assert station.command(400, 1)[0] == ACCEPTED
    station.fly(3.0, lambda: station.sticks(throttle=1000))
    assert station.place[2] < -4
    station.fly(3.0, lambda: station.sticks(pitch=300))
    assert 3 < station.place[0] < 8
    station.fly(3.0, station.sticks)  # brakes
    stop = station.place
    station.fly(2.0, station.sticks)
    np.testing.assert_allclose(station.place, stop, atol=0.05)
    station.fly(1.0, lambda: station.sticks(yaw=300))
    assert 25 < heading(station) < 60
    station.fly(12.0, lambda: station.sticks(throttle=0))
    assert station.pilot.has_landed
    assert not station.pilot.is_armed


def test_it_holds_when_sticks_are_lost(station):
    station.take_off(4.0)
    station.sticks()
    station.mode(POSITION)
    heard = station.fly(1.0)
    assert "no manual control: hold" in texts(heard)
    assert station.pilot.mode == Mode.HOLD


def test_altitude_mode_tilts_and_keeps_its_height(make_vehicles):
    station = Station(make_vehicles(1, wind=(2.0, 0.0, 0.0)))
    station.take_off(4.0)
    station.sticks()
    assert station.mode(ALTITUDE) == ACCEPTED
    start = station.place
    station.fly(4.0, station.sticks)
    assert station.place[1] > start[1] + 0.5  # drifts with the wind
    assert station.place[2] == pytest.approx(start[2], abs=0.3)
    station.fly(1.0, lambda: station.sticks(roll=500))
    (attitude,) = station.command(512, 30)[1]
    assert math.degrees(attitude.roll) == pytest.approx(17.5, abs=2)


def test_sticks_beyond_their_range_count_as_centred(station):
    station.take_off(4.0)
    station.sticks()
    station.mode(POSITION)
    station.fly(2.0, lambda: station.sticks(pitch=2000, roll=-(2**15), yaw=2**15 - 1))
    np.testing.assert_allclose(station.place, (0, 0, -4), atol=0.2)


def test_a_second_client_does_not_fly_meanwhile(station):
    station.take_off(4.0)
    other = Station(station.fleet, system=254, link="there")
    station.sticks()
    (said,) = texts(other.sticks(pitch=1000))
    assert said == "setpoints denied: another client sends setpoints"
    assert station.pilot.sticks.pitch == 0
    station.fly(1.0)
    assert other.sticks(pitch=1000) == []
    assert station.pilot.sticks.pitch == 1


# Rally points


def test_it_returns_to_the_nearest_rally_point(station):
    points = [(3, 5100, 0, 0, 0, 0, *station.spot(north, 0.0), 5.0) for north in (12.0, 60.0)]
    assert station.upload(points, RALLY) == 0
    (count,) = station.send("mission_request_list", *station.target, RALLY)
    assert count.count == 2
    station.set_parameter("RTL_RETURN_ALT", 5.0)
    station.set_parameter("RTL_DESCEND_ALT", 5.0)
    station.take_off(4.0)
    station.send("set_mode", 1, 1, 4 << 16 | 3 << 24)
    station.command(192, -1, 0, 0, NAN, *station.degrees(8.0, 0.0), NAN)
    station.fly(6.0)
    assert station.mode(RETURN) == ACCEPTED
    station.fly(20.0)
    assert station.pilot.has_landed
    np.testing.assert_allclose(station.place[:2], (12, 0), atol=0.3)


def test_rally_points_are_rally_points_inside_the_fence(station):
    assert station.upload([station.waypoint(3.0, 0.0, 3.0)], RALLY) == 3
    station.set_parameter("GF_MAX_HOR_DIST", 20.0)
    assert station.upload([(3, 5100, 0, 0, 0, 0, *station.spot(30.0, 0.0), 5.0)], RALLY) == 1
    assert station.pilot.rally_points == []


# Failures


def test_failures_need_a_parameter_and_a_unit_that_can_fail(station):
    assert station.command(420, MOTOR, 1, 1)[0] == DENIED
    station.set_parameter("SYS_FAILURE_EN", 1)
    assert station.command(420, 102, 1, 0)[0] == UNSUPPORTED  # a servo
    assert station.command(420, MOTOR, 2, 1)[0] == UNSUPPORTED  # stuck
    assert station.command(420, MOTOR, 1, 5)[0] == DENIED
    assert station.command(420, MOTOR, 1, -1)[0] == DENIED
    assert station.command(420, NAN, 1, 1)[0] == DENIED
    assert (station.fleet.airspace.rotor_effectiveness == 1).all()


def test_a_motor_that_fails_stops_and_is_repaired(station):
    station.set_parameter("SYS_FAILURE_EN", 1)
    station.take_off(4.0)
    assert station.command(420, MOTOR, 1, 2)[0] == ACCEPTED
    frame, speeds = station.fleet.airspace.airframes[0], station.fleet.airspace.swarm.rotor_speed
    # PX4's motor 2 is at the rear left
    (rotor,) = [k for k, (x, y, _) in enumerate(frame.rotors) if x < 0 < y]
    station.fly(0.5)
    assert speeds[0, rotor] < 0.05 * frame.max_rotor_speed
    assert station.command(420, MOTOR, 0, 0)[0] == ACCEPTED
    assert (station.fleet.airspace.rotor_effectiveness == 1).all()
    station.fly(1.0)
    assert station.place[2] > -4  # it has fallen


def test_without_gps_it_lands_where_the_wind_takes_it(make_vehicles):
    station = Station(make_vehicles(1, wind=(2.0, 0.0, 0.0)))
    station.set_parameter("SYS_FAILURE_EN", 1)
    station.take_off(4.0)
    start = station.place[1]
    result, _ = station.command(420, GPS, 1, NAN)
    assert result == ACCEPTED
    heard = station.fly(9.0)
    assert "GPS failed: land" in texts(heard)
    assert station.pilot.has_landed
    assert station.place[1] > start + 1.0
    (gps,) = station.command(512, 24)[1]
    assert (gps.fix_type, gps.satellites_visible) == (0, 0)
    (status,) = station.command(512, 1)[1]
    missing = status.onboard_control_sensors_present & ~status.onboard_control_sensors_health
    assert missing & common.MAV_SYS_STATUS_SENSOR_GPS
    result, more = station.command(400, 1)
    assert (result, texts(more)) == (REJECTED, ["hold denied: GPS failed"])
    assert station.command(420, GPS, 0, 0)[0] == ACCEPTED
    assert station.command(400, 1)[0] == ACCEPTED


@pytest.mark.parametrize(("action", "mode"), [(0, Mode.HOLD), (2, Mode.LAND), (3, Mode.RETURN)])
def test_an_empty_battery_does_what_a_parameter_says(action, mode, station):
    station.set_parameter("SYS_FAILURE_EN", 1)
    station.set_parameter("COM_LOW_BAT_ACT", action)
    station.take_off(4.0)
    assert station.command(420, BATTERY, 1, 0)[0] == ACCEPTED
    assert "battery is empty" in texts(station.fly(0.1))
    assert station.pilot.mode == mode
    (battery,) = station.command(512, 147)[1]
    assert (battery.battery_remaining, battery.charge_state) == (0, 5)


def test_an_empty_battery_prevents_arming(station):
    station.set_parameter("SYS_FAILURE_EN", 1)
    assert station.command(420, BATTERY, 1, 0)[0] == ACCEPTED
    result, more = station.command(400, 1)
    assert (result, texts(more)) == (REJECTED, ["arming denied: battery is empty"])
    assert not station.pilot.is_armed
    assert station.command(420, BATTERY, 0, 0)[0] == ACCEPTED
    assert station.command(400, 1)[0] == ACCEPTED


# Sensors, calibration, shell


def test_the_imu_measures_gravity_and_the_field_of_the_earth(station):
    assert station.command(511, 105, 10000)[0] == ACCEPTED
    reply = messages(station.fly(1.0), "HIGHRES_IMU")
    assert len(reply) == 100
    last = reply[-1]
    np.testing.assert_allclose((last.xacc, last.yacc), 0, atol=0.02)
    assert last.zacc == pytest.approx(-9.80665, abs=0.05)
    # At PX4's home the field is 0.48 gauss strong, 63 degrees down; the vehicle faces north
    assert math.hypot(last.xmag, last.ymag, last.zmag) == pytest.approx(0.48, abs=0.02)
    assert math.degrees(math.atan2(last.zmag, last.xmag)) == pytest.approx(63, abs=2)
    assert last.abs_pressure == pytest.approx(956.0, abs=2)


@pytest.mark.parametrize(
    ("place", "value", "name"), [(1, 1, "gyro"), (2, 1, "mag"), (5, 1, "accel"), (5, 2, "level")]
)
def test_calibrations_are_done_without_waiting(place, value, name, station):
    result, more = station.command(241, *[0] * (place - 1), value)
    assert result == ACCEPTED
    assert texts(more)[-1] == f"[cal] calibration done: {name}"
    assert station.command(241, 1, 1)[0] == UNSUPPORTED
    station.take_off(4.0)
    assert station.command(241, *[0] * (place - 1), value)[0] == REJECTED


def command_int(station, number, *params, x=0, y=0, z=0.0):
    """Send a command as COMMAND_INT; return its result."""
    params = (*params, *[0.0] * (4 - len(params)))
    ack, *_ = station.send("command_int", *station.target, 0, number, 0, 0, *params, x, y, z)
    return ack.result


def test_integers_of_commands_without_a_position_have_no_scale(station):
    assert command_int(station, 241, x=1) == ACCEPTED
    assert command_int(station, 241, x=10_000_000) == UNSUPPORTED
    locked = common.GIMBAL_MANAGER_FLAGS_YAW_LOCK
    assert command_int(station, 1000, -30.0, 90.0, NAN, NAN, x=locked) == ACCEPTED
    (reply,) = station.command(512, 285)[1]
    assert reply.flags & common.GIMBAL_DEVICE_FLAGS_YAW_LOCK


def shell(station, line):
    data = [*line.encode(), *[0] * 70][:70]
    reply = station.send("serial_control", 10, 2, 0, 0, len(line), data)
    assert {one.get_type() for one in reply} <= {"SERIAL_CONTROL"}
    return "".join(bytes(one.data[: one.count]).decode() for one in reply)


def test_the_shell_answers(station):
    assert shell(station, "ver\n").startswith("bulletuav ")
    assert shell(station, "param show MIS_TAKEOFF_ALT\n") == "MIS_TAKEOFF_ALT: 2.5\nnsh> "
    assert len(shell(station, "param show\n").splitlines()) > 20
    assert shell(station, "param show NO_SUCH\n") == "no parameter NO_SUCH\nnsh> "
    assert "param show" in shell(station, "help\n")
    assert shell(station, "reb") == ""
    assert shell(station, "oot\r\n") == "nsh: reboot: command not found\nnsh> nsh> "
    assert station.send("serial_control", 0, 2, 0, 0, 2, [10] * 70) == []  # another port


# Gimbal


def gimbal_angles(station):
    """Pitch (up) and yaw (clockwise from the heading) of the gimbal, degrees."""
    (reply,) = station.command(512, 285)[1]
    assert reply.flags & common.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
    w, x, y, z = reply.q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    assert roll == pytest.approx(0, abs=1e-6)
    pitch, yaw = (
        math.asin(2 * (w * y - x * z)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    return math.degrees(pitch), math.degrees(yaw)


def point(station, pitch=NAN, yaw=NAN, pitch_rate=NAN, yaw_rate=NAN, flags=0):
    return station.command(1000, pitch, yaw, pitch_rate, yaw_rate, flags, 0, 1)[0]


def test_the_gimbal_is_described_with_one_request(station):
    """MAVSDK 3 asks for the manager first, and warns if that arrives before the device."""
    result, (device, manager) = station.command(512, 280)
    assert result == ACCEPTED
    assert manager.get_type() == "GIMBAL_MANAGER_INFORMATION"
    assert manager.cap_flags & common.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
    assert device.get_type() == "GIMBAL_DEVICE_INFORMATION"
    assert device.gimbal_device_id == manager.gimbal_device_id == 1
    assert (device.vendor_name, device.model_name) == ("bulletuav", "gimbal")
    assert (device.pitch_min, device.pitch_max) == (manager.pitch_min, manager.pitch_max)
    assert [one.get_type() for one in station.command(512, 283)[1]] == [device.get_type()]


def test_the_gimbal_points_turns_and_keeps_its_limits(station):
    assert point(station, -30.0, 90.0) == ACCEPTED
    assert gimbal_angles(station) == pytest.approx((-30, 90), abs=0.01)
    assert point(station, 90.0, 200.0) == ACCEPTED
    assert gimbal_angles(station) == pytest.approx((45, -160), abs=0.01)
    point(station, 0.0, 0.0)
    assert point(station, pitch_rate=5.0, yaw_rate=-10.0) == ACCEPTED
    station.fly(2.0)
    assert gimbal_angles(station) == pytest.approx((10, -20), abs=0.2)
    station.send("gimbal_manager_set_pitchyaw", *station.target, 0, 1, 0.1, 0.2, NAN, NAN)
    assert gimbal_angles(station) == pytest.approx(np.degrees((0.1, 0.2)), abs=0.01)


def test_a_locked_yaw_stays_while_the_vehicle_turns(station):
    station.take_off(4.0)
    point(station, 0.0, 45.0, flags=common.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
    station.fly(4.0, lambda: station.position(0, 0, -4, math.pi / 2))
    station.mode(OFFBOARD)
    station.fly(4.0, lambda: station.position(0, 0, -4, math.pi / 2))
    assert gimbal_angles(station)[1] == pytest.approx(45 - 90, abs=2)


def test_the_gimbal_looks_at_a_position(station):
    station.take_off(10.0)
    station.fly(4.0)
    x, y = station.degrees(0.0, 10.0)
    assert station.command(195, 0, 0, 0, 0, x, y, station.fleet.origin.altitude)[0] == ACCEPTED
    station.fly(0.1)
    assert gimbal_angles(station) == pytest.approx((-45, 90), abs=1.5)
    assert station.command(195, 0, 0, 0, 0, NAN, y, 0)[0] == DENIED
    assert station.command(197)[0] == ACCEPTED
    assert gimbal_angles(station) == pytest.approx((0, 0), abs=0.01)


def test_systems_take_control_of_the_gimbal(station):
    def controls():
        (reply,) = station.command(512, 281)[1]
        return reply.primary_control_sysid, reply.primary_control_compid

    assert controls() == (0, 0)
    assert station.command(1001, -2, -2, -1, -1, 0, 0, 1)[0] == ACCEPTED
    assert controls() == (255, 190)
    assert station.command(1001, 7, 1, -1, -1)[0] == ACCEPTED
    assert controls() == (7, 1)
    assert station.command(1001, -3, -3, -3, -3)[0] == ACCEPTED
    assert controls() == (0, 0)
    for fields in ((300, 1), (-4, 1), (NAN, 1), (1, 1, 0, 0, 0, 0, 5)):
        assert station.command(1001, *fields)[0] == DENIED
    assert station.command(1000, 0, 0, 0, 0, 0, 0, 5)[0] == DENIED


# Camera

CAMERA = 100


@pytest.fixture
def camera(make_vehicles, tmp_path):
    """A vehicle with a camera; returns its station and a function that commands the camera."""
    station = Station(make_vehicles(1, pictures=tmp_path))

    def command(number, *numbers):
        numbers = (*numbers, *[0.0] * (7 - len(numbers)))
        ack, *more = station.send("command_long", 1, CAMERA, number, 0, *numbers)
        assert (ack.command, ack.get_srcComponent()) == (number, CAMERA)
        return ack.result, more

    return station, command


def test_the_camera_describes_itself(camera):
    station, command = camera
    beats = [one for one in messages(station.fly(2.0), "HEARTBEAT") if one.type == 30]
    assert [one.get_srcComponent() for one in beats] == [CAMERA] * 2
    for number, name in (
        (259, "CAMERA_INFORMATION"),
        (260, "CAMERA_SETTINGS"),
        (261, "STORAGE_INFORMATION"),
        (262, "CAMERA_CAPTURE_STATUS"),
    ):
        result, (reply,) = command(512, number)
        assert (result, reply.get_type()) == (ACCEPTED, name)
    assert command(512, 33)[0] == UNSUPPORTED
    assert command(530, 0, 0)[0] == ACCEPTED
    assert command(530, 0, 1)[0] == UNSUPPORTED  # video
    assert command(400, 1)[0] == UNSUPPORTED
    assert station.command(512, 259)[0] == UNSUPPORTED  # the autopilot is none


def test_pictures_show_where_the_gimbal_points(camera, tmp_path):
    station, command = camera
    station.take_off(10.0)
    point(station, 30.0, 0.0)
    assert command(2000, 0, 0, 1)[0] == ACCEPTED
    (up,) = messages(station.fly(0.1), "CAMERA_IMAGE_CAPTURED")
    point(station, -90.0, 0.0)
    assert command(2000, 0, 0, 1)[0] == ACCEPTED
    (down,) = messages(station.fly(0.1), "CAMERA_IMAGE_CAPTURED")
    assert [up.image_index, down.image_index] == [0, 1]
    assert down.relative_alt == pytest.approx(7000, abs=1500)
    sky, ground = (
        np.asarray(Image.open(tmp_path / one.file_url)).astype(int) for one in (up, down)
    )
    assert sky.shape == (480, 640, 3)
    assert sky[:, :, 2].mean() > sky[:, :, 1].mean()  # blue above, green below
    assert ground[:, :, 2].mean() < ground[:, :, 1].mean()
    result, (reply,) = command(512, 263, 0)
    assert (result, reply.file_url) == (ACCEPTED, "vehicle1_0000.png")
    assert command(512, 263, 2)[0] == DENIED


def test_pictures_are_taken_at_an_interval_until_they_are_stopped(camera, tmp_path):
    station, command = camera
    assert command(2000, 0, 0.5, 3)[0] == ACCEPTED
    station.fly(3.0)
    assert len(list(tmp_path.iterdir())) == 3
    assert command(2000, 0, 0.5, 0)[0] == ACCEPTED
    (status,) = command(512, 262)[1]
    assert (status.image_status, status.image_count) == (3, 3)
    station.fly(0.8)
    assert command(2001)[0] == ACCEPTED
    station.fly(2.0)
    assert len(list(tmp_path.iterdir())) == 5
    for fields in ((0.1, 3), (NAN, 3), (1.0, -1), (1.0, 1e9), (1.0, NAN), (1.0, 1.5)):
        result, (reply,) = command(2000, 0, *fields)
        assert (result, reply.get_srcComponent()) == (DENIED, CAMERA)
        assert "is needed" in reply.text


def test_pictures_of_earlier_starts_are_kept(make_vehicles, tmp_path):
    names = ["vehicle1_0007.png", "vehicle2_0020.png", "vehicle1_0030.txt", "vehicle1_.png"]
    for name in names:
        (tmp_path / name).write_text("earlier")
    station = Station(make_vehicles(1, pictures=tmp_path))
    for number in (8, 9):
        station.send("command_long", 1, CAMERA, 2000, 0, 0, 0, 1, 0, 0, 0, 0)
        (reply,) = messages(station.fly(0.1), "CAMERA_IMAGE_CAPTURED")
        assert (reply.image_index, reply.file_url) == (number - 8, f"vehicle1_{number:04d}.png")
        assert np.asarray(Image.open(tmp_path / reply.file_url)).shape == (480, 640, 3)
    assert [(tmp_path / name).read_text() for name in names] == ["earlier"] * 4


def test_a_picture_that_cannot_be_written_is_reported(camera, tmp_path):
    station, command = camera
    tmp_path.rmdir()
    command(2000, 0, 1.0, 0)
    assert any("cannot be written" in one for one in texts(station.fly(1.0)))
    (status,) = command(512, 262)[1]
    assert (status.image_status, status.image_count) == (0, 0)


def test_pictures_need_a_folder(make_vehicles, tmp_path):
    with pytest.raises(NotADirectoryError, match="create it for pictures"):
        make_vehicles(1, pictures=tmp_path / "none")


# Setpoints


def test_a_position_of_zeros_besides_a_velocity_is_logged_once(station, caplog):
    station.take_off(3.0)

    def fly(mask=0x0C00):
        fields = (0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0)
        station.send("set_position_target_local_ned", 0, *station.target, 1, mask, *fields)

    with caplog.at_level(logging.WARNING):
        fly(0x0DC0)  # without the acceleration, and so with a chosen position
        assert not caplog.records
        fly()
        station.mode(OFFBOARD)
        station.fly(1.0, fly)
    (record,) = caplog.records
    assert "mask 0x0C07" in record.getMessage()
