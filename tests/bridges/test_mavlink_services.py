"""Telemetry, parameters, missions and fences of MAVLink vehicles, told by pymavlink's frames."""

import math

import numpy as np
import pytest
from bridges.mavlink_client import (
    ACCEPTED,
    DENIED,
    MISSION,
    NAN,
    REJECTED,
    UNSUPPORTED,
    Station,
    common,
    messages,
    texts,
)

from bulletuav.bridges.mavlink_parameters import PARAMETERS
from bulletuav.bridges.mavlink_protocol import Mode
from bulletuav.bridges.mavlink_telemetry import STREAMS

FENCE = 1
TAKEN, ERROR, BAD_FRAME, NOT_SUPPORTED, NO_SPACE, BAD_X, BAD_SEQUENCE, REFUSED, CANCELLED = (
    common.MAV_MISSION_ACCEPTED,
    common.MAV_MISSION_ERROR,
    common.MAV_MISSION_UNSUPPORTED_FRAME,
    common.MAV_MISSION_UNSUPPORTED,
    common.MAV_MISSION_NO_SPACE,
    common.MAV_MISSION_INVALID_PARAM5_X,
    common.MAV_MISSION_INVALID_SEQUENCE,
    common.MAV_MISSION_DENIED,
    common.MAV_MISSION_OPERATION_CANCELLED,
)


# Telemetry


def rate(station, name, seconds=2.0):
    return len(messages(station.fly(seconds), name)) / seconds


def test_messages_come_at_the_rates_that_were_asked_for(station):
    assert rate(station, "ATTITUDE") == 10
    assert station.command(511, 30, 20000)[0] == ACCEPTED
    assert rate(station, "ATTITUDE") == 50
    (told,) = messages(station.command(510, 30)[1], "MESSAGE_INTERVAL")
    assert (told.message_id, told.interval_us) == (30, 20000)
    assert station.command(511, 30, -1)[0] == ACCEPTED
    assert rate(station, "ATTITUDE") == 0
    (told,) = messages(station.command(510, 30)[1], "MESSAGE_INTERVAL")
    assert told.interval_us == -1
    assert station.command(511, 30, 0)[0] == ACCEPTED
    assert rate(station, "ATTITUDE") == 10
    assert station.command(511, 30, 1)[0] == ACCEPTED
    assert rate(station, "ATTITUDE") == 100  # not more than steps
    assert station.command(511, 30, -2)[0] == DENIED
    assert station.command(511, 30, NAN)[0] == DENIED
    for command in (510, 511, 512):
        assert station.command(command, 77, 1000)[0] == UNSUPPORTED
        assert station.command(command, NAN)[0] == DENIED


def test_every_message_can_be_asked_for(station):
    station.take_off()
    for number, stream in STREAMS.items():
        # Information about the gimbal's manager comes after that about its device
        result, (*_, reply) = station.command(512, number)
        assert (result, reply.get_type()) == (ACCEPTED, stream.name.upper())


def test_the_versions_are_told(station):
    (told,) = station.command(520)[1]
    assert told.flight_sw_version >> 24 == 1
    assert told.capabilities & common.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert told.uid == 1


def test_odometry_tells_velocities_of_the_body(station):
    station.take_off()
    velocity = (0.5, 0.0, 0.0)
    station.velocity(*velocity, yaw=math.pi / 2)
    station.mode((6, 0))
    station.fly(4.0, lambda: station.velocity(*velocity, yaw=math.pi / 2))
    (told,) = station.command(512, 331)[1]
    # Who looks east and flies north goes to the left.
    np.testing.assert_allclose((told.vx, told.vy, told.vz), (0, -0.5, 0), atol=0.03)
    (gps,) = station.command(512, 24)[1]
    assert gps.vel == pytest.approx(50, abs=3)
    assert min(gps.cog, 36000 - gps.cog) < 300
    (hud,) = station.command(512, 74)[1]
    assert hud.heading == pytest.approx(90, abs=3)


def test_clocks_and_pings_are_answered(station):
    station.fly(1.0)
    (told,) = station.send("timesync", 0, 12345)
    assert (told.tc1, told.ts1) == (10**9, 12345)
    assert station.send("timesync", 5, 12345) == []
    (told,) = station.send("ping", 7, 3, 0, 0)
    assert (told.time_usec, told.seq, told.target_system) == (7, 3, 255)


# Parameters


def test_parameters_are_listed_read_and_set(station):
    told = station.send("param_request_list", *station.target)
    assert [one.param_id for one in told] == sorted(PARAMETERS)
    assert [one.param_index for one in told] == list(range(len(PARAMETERS)))
    assert {one.param_count for one in told} == {len(PARAMETERS)}
    (told,) = station.send("param_request_read", *station.target, b"MIS_TAKEOFF_ALT", -1)
    assert (told.param_value, told.param_type) == (2.5, common.MAV_PARAM_TYPE_REAL32)
    (told,) = station.send("param_request_read", *station.target, b"", told.param_index)
    assert told.param_id == "MIS_TAKEOFF_ALT"
    (told,) = station.send("param_set", *station.target, b"MIS_TAKEOFF_ALT", 4.0, 9)
    assert told.param_value == 4.0
    station.take_off()
    assert station.place[2] == pytest.approx(-4.0, abs=0.1)


def test_whole_numbers_are_packed_bit_by_bit(station):
    def packed(number):
        return np.array(number, np.int32).view(np.float32).item()

    (told,) = station.send("param_set", *station.target, b"GF_ACTION", packed(5), 6)
    assert np.array(told.param_value, np.float32).view(np.int32) == 5
    assert told.param_type == common.MAV_PARAM_TYPE_INT32


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        (b"MIS_TAKEOFF_ALT", NAN, 9),
        (b"MIS_TAKEOFF_ALT", 1000.0, 9),
        (b"MIS_TAKEOFF_ALT", 3.0, 6),
        (b"MAV_SYS_ID", 1e-44, 6),
        (b"MPC_THR_HOVER", 0.1, 9),
    ],
)
def test_values_that_cannot_be_are_answered_with_the_old_one(name, value, kind, station):
    (before,) = station.send("param_request_read", *station.target, name, -1)
    (told,) = station.send("param_set", *station.target, name, value, kind)
    assert (told.param_id, told.param_value) == (before.param_id, before.param_value)


def test_unknown_parameters_are_told(station):
    for fields in ((b"NO_SUCH", -1), (b"", 99)):
        (told,) = station.send("param_request_read", *station.target, *fields)
        assert told.get_type() == "STATUSTEXT"
    assert texts(station.send("param_set", *station.target, b"NO_SUCH", 1.0, 9))


# Missions


def test_a_mission_is_uploaded_told_flown_and_over(station):
    items = [
        (6, 22, 0, 0, 0, NAN, 0, 0, 3.0),
        (2, 178, 1, 2.0, -1, 0, 0, 0, 0),
        station.waypoint(4.0, 0.0, 3.0),
        station.waypoint(4.0, 3.0, 4.0, hold=1.0, yaw=90.0),
        (2, 93, 0.5, -1, -1, -1, 0, 0, 0),
    ]
    assert station.upload(items) == TAKEN
    (count,) = station.send("mission_request_list", *station.target)
    assert count.count == 5
    for k, wanted in enumerate(items):
        (told,) = station.send("mission_request_int", *station.target, k)
        found = (told.frame, told.command, told.param1, told.x, told.y, told.z)
        assert found == (wanted[0], wanted[1], wanted[2], *wanted[6:])
        (told,) = station.send("mission_request", *station.target, k)
        assert told.get_type() == "MISSION_ITEM"
        scale = 1e7 if wanted[0] == 6 else 1
        assert told.x == pytest.approx(wanted[6] / scale, abs=1e-5)
    (told,) = station.send("mission_request_int", *station.target, 5)
    assert told.type == BAD_SEQUENCE
    assert station.command(400, 1)[0] == ACCEPTED
    assert station.command(300)[0] == ACCEPTED
    passed = []
    heard = station.fly(22.0, lambda: passed.append(station.place))
    for goal in ((0, 0, -3), (4, 0, -3), (4, 3, -4)):
        assert min(np.linalg.norm(np.array(passed) - goal, axis=1)) < 0.1
    assert [one.seq for one in messages(heard, "MISSION_ITEM_REACHED")] == [0, 1, 2, 3, 4]
    current = messages(heard, "MISSION_CURRENT")
    assert [one.seq for one in current] == sorted(one.seq for one in current)
    assert (current[-1].seq, current[-1].total, current[-1].mission_state) == (4, 5, 5)
    assert station.pilot.mode == Mode.HOLD
    assert messages(heard, "ATTITUDE")[-1].yaw == pytest.approx(math.pi / 2, abs=0.05)
    speeds = [math.hypot(one.vx, one.vy) for one in messages(heard, "LOCAL_POSITION_NED")]
    assert 1.8 < max(speeds) < 2.4  # it speeds up by 2 m/s^2, and overshoots


def test_a_mission_pauses_and_goes_on(station):
    station.upload([station.waypoint(8.0, 0.0, 3.0), station.waypoint(8.0, 4.0, 3.0)])
    station.command(400, 1)
    assert station.mode(MISSION) == ACCEPTED  # it rises first, though no item says so
    station.fly(4.0)
    assert 0 < station.place[0] < 8
    assert station.place[2] == pytest.approx(-3.0, abs=0.2)
    assert station.mode((4, 3)) == ACCEPTED
    station.fly(2.0)
    before = station.place
    heard = station.fly(2.0)
    np.testing.assert_allclose(station.place, before, atol=0.05)
    assert messages(heard, "MISSION_CURRENT")[-1].mission_state in (2, 4)
    assert station.mode(MISSION) == ACCEPTED
    heard = station.fly(10.0)
    assert [one.seq for one in messages(heard, "MISSION_ITEM_REACHED")] == [0, 1]
    np.testing.assert_allclose(station.place, (8, 4, -3), atol=0.1)


def test_it_jumps_to_an_item(station):
    items = [station.waypoint(5.0 * k, 0.0, 3.0) for k in (1, 2, 0)]
    station.upload(items)
    station.take_off()
    (told,) = station.send("mission_set_current", *station.target, 2)
    assert (told.get_type(), told.seq) == ("MISSION_CURRENT", 2)
    assert station.command(224, 1)[0] == ACCEPTED
    assert station.command(224, 3)[0] == DENIED
    assert texts(station.send("mission_set_current", *station.target, 9)) == ["item 9: there are 3"]
    assert station.command(300, 2)[0] == ACCEPTED
    station.fly(5.0)
    assert abs(station.place[0]) < 0.2
    assert station.pilot.mode == Mode.HOLD


@pytest.mark.parametrize("last", ["land", "return"])
def test_a_mission_ends_on_the_ground(last, station):
    station.set_parameter("RTL_RETURN_ALT", 3.0)
    end = station.waypoint(0.0, 3.0, 0.0, command=21) if last == "land" else (2, 20, *[0] * 7)
    station.upload([station.waypoint(3.0, 0.0, 3.0), end])
    station.command(400, 1)
    station.mode(MISSION)
    station.fly(26.0)
    goal = (0, 3, 0) if last == "land" else (0, 0, 0)
    np.testing.assert_allclose(station.place, goal, atol=0.1)
    assert not station.pilot.is_armed
    # It can be flown again.
    station.command(400, 1)
    assert station.mode(MISSION) == ACCEPTED
    station.fly(4.0)
    assert station.place[2] < -2


@pytest.mark.parametrize(
    ("item", "code", "said"),
    [
        ((6, 201, *[0] * 7), NOT_SUPPORTED, "item 0: command 201 unknown"),
        ((1, 16, 0, 0, 0, 0, 1, 1, 5.0), BAD_FRAME, "item 0: frame 1 unknown"),
        ((6, 16, 0, 0, 0, 0, 0, 0, 5.0), BAD_X, "position is more than 100000 m away"),
        ((6, 16, 0, 0, 0, 0, 2**31 - 1, 0, 5.0), BAD_X, "invalid latitude, longitude or altitude"),
        ((6, 16, 0, 0, 0, 0, 2 * 10**9, 0, 5.0), BAD_X, "invalid latitude, longitude or altitude"),
        ((6, 16, 0, 0, 0, 0, 474100000, 85455940, 5.0), BAD_X, "first item is beyond MIS_DIST_1WP"),
        ((6, 22, 0, 0, 0, 0, 0, 0, NAN), BAD_X, "altitude is not a finite number"),
    ],
)
def test_items_that_cannot_be_are_refused(item, code, said, station):
    good = [station.waypoint(1.0, 0.0, 3.0)]
    assert station.upload(good) == TAKEN
    assert station.upload([item]) == code
    assert texts(station.heard)[-1] == said
    (count,) = station.send("mission_request_list", *station.target)
    assert count.count == 1  # the one before stays


def test_uploads_are_asked_for_again_and_given_up(station):
    target = station.target
    assert station.send("mission_count", *target, 2, 0)[0].seq == 0
    heard = station.fly(6.0)
    asked = messages(heard, "MISSION_REQUEST_INT") + messages(heard, "MISSION_REQUEST")
    assert len(asked) == 4
    assert messages(heard, "MISSION_REQUEST")  # for clients that know these alone
    (ack,) = messages(heard, "MISSION_ACK")
    assert (ack.type, ack.target_system) == (CANCELLED, 255)
    assert messages(station.fly(3.0), "MISSION_REQUEST") == []


def test_a_second_client_waits_until_an_upload_is_over(station):
    other = Station(station.fleet, system=254)
    station.send("mission_count", *station.target, 1, 0)
    (ack,) = messages(other.send("mission_count", 1, 1, 1, 0), "MISSION_ACK")
    assert ack.type == REFUSED
    one = other.waypoint(1, 1, 3)
    (ack,) = other.send("mission_item_int", 1, 1, 0, *one[:2], 0, 1, *one[2:], 0)
    assert ack.type == ERROR
    station.send("mission_ack", *station.target, CANCELLED, 0)
    assert other.upload([one]) == TAKEN


def test_items_out_of_order_are_asked_for_anew(station):
    target = station.target
    first, second = station.waypoint(1, 0, 3), station.waypoint(2, 0, 3)

    def item(number, one):
        fields = (*one[:2], 0, 1, *one[2:], 0)
        return station.send("mission_item_int", *target, number, *fields)

    station.send("mission_count", *target, 2, 0)
    assert item(1, second)[0].seq == 0
    assert item(0, first)[0].seq == 1
    assert item(0, first) == []  # it came twice
    assert item(1, second)[0].type == TAKEN


def test_too_many_items_are_refused(station):
    (ack,) = messages(station.send("mission_count", *station.target, 501, 0), "MISSION_ACK")
    assert ack.type == NO_SPACE
    (ack,) = station.send("mission_count", *station.target, 1, 3)
    assert ack.type == NOT_SUPPORTED
    (ack,) = station.send("mission_clear_all", *station.target, 7)
    assert ack.type == NOT_SUPPORTED


def test_a_mission_is_cleared_and_who_flies_it_holds(station):
    station.upload([station.waypoint(8.0, 0.0, 3.0)])
    station.command(400, 1)
    station.mode(MISSION)
    station.fly(3.0)
    (ack,) = station.send("mission_clear_all", *station.target, 255)
    assert ack.type == TAKEN
    assert station.pilot.mode == Mode.HOLD
    assert station.mode(MISSION) == REJECTED


def test_who_listens_to_no_wind_arrives_all_the_same(make_vehicles):
    """A wind keeps it off its place by more than the distance at which it has arrived."""
    station = Station(make_vehicles(1, wind=(8.0, 0.0, 0.0)))
    station.upload([station.waypoint(3.0, 0.0, 3.0), station.waypoint(0.0, 0.0, 3.0)])
    station.command(400, 1)
    station.mode(MISSION)
    heard = station.fly(30.0)
    assert [one.seq for one in messages(heard, "MISSION_ITEM_REACHED")] == [0, 1]


# Fences


def fence(station, *corners, command=5001):
    return [(0, command, len(corners), 0, 0, 0, *station.spot(*one), 0) for one in corners]


def test_missions_outside_a_fence_are_refused(station):
    square = fence(station, (-10, -10), (10, -10), (10, 10), (-10, 10))
    hole = [(0, 5004, 2.0, 0, 0, 0, *station.spot(5, 5), 0)]
    assert station.upload(square + hole, FENCE) == TAKEN
    (count,) = station.send("mission_request_list", *station.target, FENCE)
    assert count.count == 5
    inside, outside = station.waypoint(9, 0, 3), station.waypoint(11, 0, 3)
    assert station.upload([inside, outside]) == BAD_X
    assert texts(station.heard)[-1] == "item 1 is outside the fence"
    assert station.upload([station.waypoint(5, 4, 3)]) == BAD_X
    assert texts(station.heard)[-1] == "item 0 is in an exclusion area of the fence"
    assert station.upload([inside]) == TAKEN
    # A fence that comes later counts, too.
    assert station.upload(fence(station, (0, 0), (5, 0), (0, 5)), FENCE) == TAKEN
    station.command(400, 1)
    assert station.mode(MISSION) == DENIED
    station.send("mission_clear_all", *station.target, FENCE)
    assert station.mode(MISSION) == ACCEPTED


def test_a_circle_without_a_radius_contains_nothing(station):
    """As PX4 takes the fences of MAVSDK's examples: the circle is far away."""
    empty = [(0, 5003, 0.0, 0, 0, 0, 0, 0, 0)]
    assert station.upload([station.waypoint(9, 0, 3)]) == TAKEN
    assert station.upload(empty, FENCE) == TAKEN
    assert station.upload([station.waypoint(9, 0, 3)]) == BAD_X
    square = fence(station, (-10, -10), (10, -10), (10, 10), (-10, 10))
    assert station.upload(square + empty, FENCE) == TAKEN
    assert station.upload([station.waypoint(9, 0, 3)]) == TAKEN


@pytest.mark.parametrize(
    "items",
    [
        [(0, 5001, 3, 0, 0, 0, 473977420, 85455940, 0)] * 2,
        [(0, 5001, 2, 0, 0, 0, 473977420, 85455940, 0)] * 2,
        [(0, 5001, NAN, 0, 0, 0, 473977420, 85455940, 0)] * 3,
        [(0, 5003, -1, 0, 0, 0, 473977420, 85455940, 0)],
        [(0, 5003, NAN, 0, 0, 0, 473977420, 85455940, 0)],
        [(9, 5003, 5, 0, 0, 0, 473977420, 85455940, 0)],
    ],
)
def test_fences_that_cannot_be_are_refused(items, station):
    assert station.upload(items, FENCE) == ERROR
    assert station.upload([(0, 16, *[0] * 7)], FENCE) == NOT_SUPPORTED
    assert station.send("mission_request_list", *station.target, FENCE)[0].count == 0
