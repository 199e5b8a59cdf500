"""What a client asks of a virtual Crazyflie before it flies: tables, logs, parameters, memory."""

import math
import struct

import numpy as np
import pytest
from bridges.crtp_client import entries, read
from scipy.spatial.transform import Rotation

from bulletuav.bridges.crazyflie_toc import LOGS
from bulletuav.bridges.crtp import MalformedError, Packet, pack_data, unpack_data
from bulletuav.bridges.setpoints import euler

ENOENT, E2BIG, ENOEXEC, ENOMEM, EEXIST = 2, 7, 8, 12, 17
X, Y, Z = 0, 1, 2
"""Numbers of stateEstimate.x and the two after it"""


@pytest.fixture(scope="module")
def still():
    """A drone that these tests ask, and never fly far."""
    from bridges.crtp_client import Drone

    from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet

    fleet = CrazyflieFleet(1, seed=0)
    yield Drone(fleet)
    fleet.close()


def test_a_packet_is_its_header_and_its_data():
    packet = Packet.parse(b"\x5d\x01\x02")
    assert packet == (5, 1, b"\x01\x02")
    assert packet.frame() == b"\x5d\x01\x02"
    for port in range(16):
        for channel in range(4):
            assert Packet.parse(Packet(port, channel, b"abc").frame()) == (port, channel, b"abc")


@pytest.mark.parametrize("datagram", [b"", bytes(32), bytes(1000)])
def test_what_is_no_packet_is_refused(datagram):
    with pytest.raises(MalformedError, match=f"{len(datagram)} bytes: from 1 to 31"):
        Packet.parse(datagram)


def test_numbers_are_read_from_the_start():
    assert unpack_data("BH", b"\x07\x34\x12rest") == (7, 0x1234)
    assert pack_data("BH", 7, 0x1234) == b"\x07\x34\x12"
    with pytest.raises(MalformedError, match="2 bytes: 3 are needed"):
        unpack_data("BH", b"\x07\x34")
    for wrong in (math.nan, math.inf):
        with pytest.raises(MalformedError, match="not finite"):
            unpack_data("f", struct.pack("<f", wrong))


# Connecting


def test_a_client_learns_whom_it_talks_to(still):
    assert still.data(15, 1, b"\0") == b"Bitcraze Crazyflie".ljust(30, b"\0")
    assert still.data(13, 1, b"\0") == b"\x00\x0c"
    assert still.data(13, 1, b"\1").startswith(b"\1bulletuav")
    assert still.data(15, 0, b"ping") == b"ping"
    assert still.ask(15, 2, b"sunk") == []
    assert still.ask(6, 0, struct.pack("<fff", 1, 2, 3)) == []


@pytest.mark.parametrize(("port", "layout"), [(5, "BB"), (2, "")])
def test_tables_tell_names_that_fit_into_packets(still, port, layout):
    names = entries(still.data, port, layout)
    assert len(names) > 40
    assert all(len(name) + 1 <= 26 for name in names)
    assert still.data(port, 0, struct.pack("<BH", 2, len(names))) == b"\x02"


def test_what_the_examples_of_cflib_ask_for_is_there(still):
    logs, parameters = entries(still.data, 5, "BB"), entries(still.data, 2, "")
    assert {"kalman.varPX", "stateEstimate.z", "stabilizer.yaw", "pm.vbat", "gyro.z"} <= set(logs)
    assert {"range.front", "range.zrange", "acc.x", "motor.m4"} <= set(logs)
    wanted = {"kalman.resetEstimation", "stabilizer.controller", "led.bitmask", "deck.bcFlow2"}
    assert wanted | {"pid_attitude.pitch_kd", "ring.effect"} <= set(parameters)
    assert parameters["deck.bcFlow2"][1] & 0x40
    assert not parameters["led.bitmask"][1] & 0x50
    assert parameters["ring.effect"][1] & 0x10


# Logs


def block(number, *variables, request=6):
    """A request that makes or extends a block of (type, variable)."""
    return bytes([request, number]) + b"".join(struct.pack("<BH", *one) for one in variables)


def logged(fleet, steps):
    packets = [read(packet.frame()) for _ in range(steps) for _, packet in fleet.step()]
    assert all((port, channel) == (5, 2) for port, channel, _ in packets)
    return [data for _, _, data in packets]


def test_a_block_tells_values_at_its_period(still):
    assert still.data(5, 1, b"\x05") == b"\x05\0\0"
    assert still.data(5, 1, block(3, (0x77, Z), (0x78, Z), (0x75, X))) == b"\x06\x03\0"
    assert logged(still.fleet, 3) == []
    assert still.data(5, 1, b"\x03\x03\x02") == b"\x03\x03\0"
    packets = logged(still.fleet, 6)
    assert len(packets) == 3
    height = still.fleet.airspace.airframes[0].standing_height
    stamps = []
    for packet in packets:
        number, *stamp, whole, half, short = struct.unpack("<B3Bfeh", packet)
        stamps.append(stamp[0] | stamp[1] << 8 | stamp[2] << 16)
        assert number == 3
        assert whole == pytest.approx(height, abs=1e-4)
        assert half == pytest.approx(height, rel=1e-2)
        assert short == 0
    assert np.diff(stamps).tolist() == [20, 20]
    assert still.data(5, 1, b"\x04\x03") == b"\x04\x03\0"
    assert logged(still.fleet, 4) == []
    assert still.data(5, 1, b"\x02\x03") == b"\x02\x03\0"
    assert still.data(5, 1, b"\x03\x03\x02")[2] == ENOENT


def test_blocks_that_cannot_be_are_refused(still):
    still.data(5, 1, b"\x05")
    assert still.data(5, 1, block(1, (7, X)))[2] == 0
    assert still.data(5, 1, block(1, (7, X)))[2] == EEXIST
    assert still.data(5, 1, block(2, (7, 5000)))[2] == ENOENT
    assert still.data(5, 1, block(2, (9, X)))[2] == ENOENT
    assert still.data(5, 1, block(2, *[(7, X)] * 7))[2] == E2BIG
    assert still.data(5, 1, block(1, *[(7, X)] * 6, request=7))[2] == E2BIG
    assert still.data(5, 1, block(1, (7, Y), request=7))[2] == 0
    assert still.data(5, 1, block(9, request=7))[2] == ENOENT
    assert still.data(5, 1, b"\x63\x01")[2] == ENOEXEC
    still.data(5, 1, b"\x05")
    for number in range(14):  # of 9 variables each; there may be 128
        assert still.data(5, 1, block(number, *[(1, X)] * 9))[2] == 0
    assert still.data(5, 1, block(14, *[(1, X)] * 3))[2] == ENOMEM
    assert still.data(5, 1, block(14, *[(1, X)] * 2))[2] == 0
    assert still.data(5, 1, block(0, (1, X), request=7))[2] == ENOMEM
    still.data(5, 1, b"\x05")
    for number in range(16):
        assert still.data(5, 1, block(number))[2] == 0
    assert still.data(5, 1, block(16))[2] == ENOMEM
    still.data(5, 1, b"\x05")


def test_every_variable_can_be_logged_in_every_type(still):
    names = entries(still.data, 5, "BB")
    sizes = {1: "B", 2: "H", 3: "I", 4: "b", 5: "h", 6: "i", 7: "f", 8: "e"}
    for name, (number, kept_as) in names.items():
        still.data(5, 1, b"\x05")
        assert still.data(5, 1, block(0, *((code, number) for code in sizes)))[2] == 0, name
        still.data(5, 1, b"\x03\x00\x01")
        (packet,) = logged(still.fleet, 1)
        values = struct.unpack("<" + "".join(sizes.values()), packet[4:])
        least, most = (-1, 127) if values[6] < 0 else (0, 128)
        # Numbers that fit into all types are the same in all
        if least < values[6] < most:
            np.testing.assert_allclose(values, values[6], atol=1, err_msg=name)
        assert kept_as in sizes
    still.data(5, 1, b"\x05")
    assert set(names) == set(LOGS)


def test_at_rest_the_sensors_tell_gravity_and_nothing_else(still):
    told = still.fleet.vehicles[0].telemetry(lambda height: 101325 - 12 * height)
    values = {name: variable.read(told) for name, variable in LOGS.items()}
    np.testing.assert_allclose([values[f"acc.{axis}"] for axis in "xyz"], (0, 0, 1), atol=1e-3)
    np.testing.assert_allclose([values[f"gyro.{axis}"] for axis in "xyz"], 0, atol=1e-2)
    assert values["baro.pressure"] == pytest.approx(1013.25, abs=0.01)
    assert values["stabilizer.thrust"] == values["motor.m1"] == 0
    assert values["range.zrange"] == pytest.approx(15, abs=0.1)


def test_euler_angles_are_those_of_scipy():
    for k in range(20):
        turn = Rotation.random(random_state=k)
        yaw, pitch, roll = turn.as_euler("ZYX")
        np.testing.assert_allclose(euler(turn.as_quat().tolist()), (roll, pitch, yaw), atol=1e-12)


# Parameters


def test_parameters_are_read_and_written(still):
    names = entries(still.data, 2, "")
    number, code = names["led.bitmask"]
    assert code == 8
    key = struct.pack("<H", number)
    assert still.data(2, 1, key) == key + b"\0\0"
    assert still.data(2, 2, key + b"\xff") == key + b"\xff"
    assert still.data(2, 1, key) == key + b"\0\xff"
    assert still.parameter("led.bitmask", 5) == 0
    assert still.data(2, 1, key) == key + b"\0\x05"
    fixed = struct.pack("<H", names["deck.bcFlow2"][0])
    assert still.data(2, 2, fixed + b"\0") == fixed + b"\x01"
    assert still.data(2, 1, b"\xff\xff") == b"\xff\xff\x02"
    assert still.data(2, 2, b"\xff\xff\0") == b"\xff\xff\x02"
    gain = struct.pack("<H", names["pid_attitude.pitch_kd"][0])
    assert still.data(2, 2, gain + struct.pack("<f", 1.5)) == gain + struct.pack("<f", 1.5)


def test_parameters_set_by_name_tell_what_is_wrong(still):
    assert still.parameter("led.nothing", 1) == ENOENT
    assert still.parameter("deck.bcFlow2", 0) == 13
    assert still.data(2, 3, b"\0led\0bitmask\0\x06" + struct.pack("<f", 1))[-1] == 22


def test_parameters_are_stored_and_forgotten(still):
    names = entries(still.data, 2, "")
    number = names["ring.effect"][0]
    key = struct.pack("<H", number)

    def ask(request, key=key):
        return still.data(2, 3, bytes([request]) + key)[3:]

    assert ask(2) == b"\1"
    assert ask(7) == b"\0\1"
    assert ask(6) == b"\x06"
    assert ask(8) == b"\0\x06"
    assert ask(4) == b"\0\x06"
    still.data(2, 2, key + b"\x0a")
    assert ask(3) == b"\0"
    assert ask(4) == b"\1\x06\x0a"
    assert ask(5) == b"\0"
    assert ask(4) == b"\0\x06"
    plain = struct.pack("<H", names["led.bitmask"][0])
    assert ask(7, plain) == b"\0\0"
    assert ask(3, plain) == ask(4, plain) == b"\x02"
    assert ask(8, b"\xff\xff") == b"\x02"


# Memory


def test_the_memory_keeps_what_is_written(still):
    assert still.data(4, 0, b"\x01") == b"\x01\x01"
    about = still.data(4, 0, b"\x02\x00")
    assert struct.unpack("<BBBI", about[:7]) == (2, 0, 0x12, 4096)
    assert len(about) == 15
    assert still.data(4, 0, b"\x02\x01") == b"\x02\x01"
    written = bytes(range(24))
    where = struct.pack("<BI", 0, 4072)
    assert still.data(4, 2, where + written) == where + b"\0"
    assert still.data(4, 1, where + b"\x18") == where + b"\0" + written
    beyond = struct.pack("<BI", 0, 4073)
    assert still.data(4, 2, beyond + written) == beyond + b"\x05"
    assert still.data(4, 1, beyond + b"\x18") == beyond + b"\x05"
    assert still.data(4, 1, struct.pack("<BIB", 1, 0, 4))[5] == 5


# What cannot be read


MALFORMED = [
    (5, 0, b""),
    (5, 0, b"\x09"),
    (5, 0, b"\x02\x01"),
    (5, 2, b"\x01"),
    (5, 1, b"\x03\x00"),
    (2, 1, b"\x01"),
    (2, 2, b"\x00\x00"),
    (2, 3, b"\x09\x00\x00"),
    (2, 3, b"\x00led"),
    (4, 3, b""),
    (4, 1, b"\x00"),
    (3, 0, b"\x00" * 13),
    (7, 0, b"\x0d"),
    (7, 0, b"\x07\x00"),
    (7, 1, b"\x01"),
    (8, 0, b""),
    (8, 0, b"\x07\x00\x00"),
    (9, 0, b"\x01"),
    (9, 1, b"\x09"),
    (13, 1, b"\x09"),
    (13, 0, b""),
    (7, 0, b"\x08" + struct.pack("<ffff", math.nan, 0, 0, 0)),
]


@pytest.mark.parametrize(("port", "channel", "data"), MALFORMED)
def test_what_cannot_be_read_is_counted_and_changes_nothing(still, port, channel, data):
    vehicle = still.fleet.vehicles[0]
    still.data(5, 1, block(0, (7, X)))  # for the request that lacks a period
    before = vehicle.malformed
    assert still.ask(port, channel, data) == []
    assert vehicle.malformed == before + 1
    still.fleet.step()
    assert still.place[2] == pytest.approx(0.015, abs=1e-3)
