"""What SECURITY.md says of servers, each sentence by somebody who tries the opposite.

Connections have tests of their own: `test_airsim_server.py` (pages, silence, floods, unread
answers), `test_hil.py`, `test_mavlink_server.py` (many ports), and `report/test_live.py`.
"""

import argparse
import contextlib
import errno
import itertools
import math
import socket
import struct
import threading
import time
import tracemalloc

import msgpack
import numpy as np
import pytest
from bridges.mavlink_client import NAN, Station, common, messages
from waiting import PATIENCE, until

import bulletuav
from bulletuav.bridges import sockets
from bulletuav.bridges.airsim import MAX_ITEMS, MAX_REQUEST_BYTES, AirsimServer, _MessageReader
from bulletuav.bridges.airsim_calls import AirsimCalls
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.crazyflie import MAX_PACKETS_PER_READ, SERVICES, CrazyflieServer
from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.crtp import MalformedError, Packet
from bulletuav.bridges.hil import LIMITS as HIL_LIMITS
from bulletuav.bridges.hil import HilServer
from bulletuav.bridges.hil_bodies import HilBodies
from bulletuav.bridges.mavlink import LIMITS, MAX_DATAGRAM_SIZE, MavlinkServer
from bulletuav.bridges.mavlink_commands import COMMANDS
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_missions import MAX_MISSION_ITEMS
from bulletuav.bridges.mavlink_protocol import Command, MavlinkCodec
from bulletuav.bridges.sockets import LATE_READ_FRACTION
from bulletuav.cli import main
from bulletuav.commands import serve as command
from bulletuav.commands.parsers.serve import add_arguments
from bulletuav.dynamics import DYNAMICS
from bulletuav.report.feed import Feed
from bulletuav.serving.connections import ACCEPT_RETRY, EVICTED_FOR_RESOURCES

ODD = (0.0, -1.0, 1.0, 1e-45, 3e38, -3e38, math.inf, -math.inf, math.nan)
"""Numbers that no program means"""
FARTHEST = 1e4
"""Where no drone gets in the few seconds of a test, m"""


def udp(port, *datagrams):
    """Send datagrams to a port of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        for datagram in datagrams:
            one.sendto(datagram, ("127.0.0.1", port))


def unharmed(airspace):
    """Return True if all that flies is finite, and not far away."""
    swarm = airspace.swarm
    return all(np.isfinite(array).all() for array in swarm) and bool(
        (np.abs(swarm.position) < FARTHEST).all()
    )


# "It listens to this machine alone unless `--host` says otherwise"


@pytest.fixture(scope="module")
def world():
    world = AirsimWorld(1, seed=0)
    yield world
    world.close()


def ports_of_tcp(world):
    """Make one of each server of TCP with its defaults, but for the port; give their ports."""
    bodies = HilBodies(1)
    hil = HilServer(bodies, port=0)
    feed = Feed("127.0.0.1", 0, str)
    airsim = AirsimServer(world, port=0)
    yield airsim.port
    yield hil.ports[0]
    yield int(feed.address.rpartition(":")[2])
    airsim.close()
    hil.close()
    feed.close()
    bodies.close()


def test_servers_of_tcp_are_not_reached_by_other_addresses(world):
    for port in ports_of_tcp(world):
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE).close()
        with pytest.raises(OSError):  # noqa: PT011 as its kind depends on the system
            socket.create_connection(("127.0.0.2", port), timeout=1)


def test_servers_of_udp_are_not_reached_by_other_addresses(make_fleet, make_vehicles):
    crazyflie = CrazyflieServer(make_fleet(1), port=0)
    mavlink = MavlinkServer(make_vehicles(1), port=0, client_port=None)
    for server in (crazyflie, mavlink):
        assert [one.getsockname()[0] for one in server._sockets] == ["127.0.0.1"]
        server.close()


def test_the_commands_serve_this_machine_alone_unless_they_are_told():
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert {parser.parse_args([kind]).host for kind in command.KINDS} == {"127.0.0.1"}
    assert bulletuav.envs.viewer.DEFAULT_ADDRESS.startswith("127.0.0.1:")
    with pytest.raises(SystemExit):
        main(["serve", "airsim", "--port", "0", "--host", "203.0.113.1", "--seconds", "0.1"])


@pytest.mark.parametrize(
    ("host", "ports", "said"),
    [
        ("127.0.0.1", [4560], "127.0.0.1:4560"),
        ("::1", [4560, 4561], "[::1]:4560, [::1]:4561"),
        ("127.0.0.1", [4560, 4561, 4562], "127.0.0.1:4560 to 127.0.0.1:4562"),
        ("127.0.0.1", [40, 99, 7], "127.0.0.1:40, 127.0.0.1:99, 127.0.0.1:7"),
    ],
)
def test_the_commands_list_addresses_that_programs_can_open(host, ports, said):
    """Free ports, which the system chooses, are not consecutive."""
    assert command._format_addresses(host, ports) == said


# Crazyflie: "datagrams of up to 31 bytes", "at most 16 of a drone in one go", "numbers are checked
# and cut to a range"


def test_longer_datagrams_are_no_packets(make_fleet):
    server = CrazyflieServer(make_fleet(1), port=0)
    udp(server.ports[0], *[b"\xfc" + bytes(size) for size in (31, 32, 1000, 60_000)])
    while server.fleet.vehicles[0].malformed < 4:
        server._read(0)
    assert server._peers == [None]
    server.close()


def test_few_packets_are_taken_in_one_go(make_fleet, monkeypatch):
    server, counts = CrazyflieServer(make_fleet(1), port=0), []
    monkeypatch.setattr(server, "_handle_datagram", lambda *one: counts.append(one))
    udp(server.ports[0], *[b"\xfcping"] * 100)
    taken = []
    while len(counts) < 100:
        before = len(counts)
        server._read(0)
        taken.append(len(counts) - before)
    assert max(taken) == MAX_PACKETS_PER_READ == 16
    server.close()


@pytest.mark.parametrize("kind", [CrazyflieServer, MavlinkServer])
def test_a_flood_to_all_drones_takes_a_fraction_of_a_late_step(
    kind, make_fleet, make_vehicles, monkeypatch
):
    """However long packets take; drones take turns."""
    make = make_fleet if kind is CrazyflieServer else make_vehicles
    server, now, reads = kind(make(20), port=0), [0.0], []

    def read(i):
        now[0] += 0.001
        reads.append(i)

    for port in server.ports:
        udp(port, b"\xff")
    until(lambda: len(server._selector.select(0.0)) == 20)
    monkeypatch.setattr(sockets.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(server, "_read", read)
    for _ in range(20):
        before = now[0]
        server._serve_packets(0.0)
        assert now[0] - before <= LATE_READ_FRACTION * server.pacer.period + 0.001
    assert reads == [*range(20)] * 3
    before = now[0]
    server._serve_packets(0.008)  # one that is in time answers until the end, and no longer
    assert now[0] - before == pytest.approx(0.008, abs=0.0011)
    monkeypatch.undo()
    server.close()


def test_messages_that_were_received_are_taken_without_new_ones(make_vehicles):
    """One datagram may hold more messages than are taken in one go."""
    server = MavlinkServer(make_vehicles(1), port=0, client_port=None)
    frame = bytes(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None, 9)))
    udp(server.ports[0], frame * 60)
    until(lambda: server._serve_packets(0.001) or server.received == 60)
    server.close()


def test_no_numbers_send_a_crazyflie_out_of_this_world(make_fleet):
    fleet, rng = make_fleet(1), np.random.default_rng(0)
    for k in range(3000):
        if k % 200 == 0:  # so that it flies
            fleet.take(0, Packet(9, 1, b"\x02"))
            fleet.take(0, Packet(8, 0, struct.pack("<BBff?f", 7, 0, 0.5, 0.0, True, 1.0)))
        port = int(rng.choice(sorted(SERVICES)))
        head = rng.integers(0, 14, rng.integers(1, 4)).astype(np.uint8).tobytes()
        numbers = struct.pack("<6f", *rng.choice(ODD, 6).astype(np.float32))
        try:
            packet = Packet.parse(bytes([port << 4 | rng.integers(4)]) + head + numbers)
        except MalformedError:
            continue
        if (packet.port, packet.channel, packet.data[0]) != (9, 1, 3):  # stops it for good
            fleet.take(0, packet)
        if k % 10 == 0:
            fleet.step()
    for _ in range(100):
        fleet.step()
    assert unharmed(fleet.airspace)


def test_what_servers_cannot_fly_is_refused_before_their_port_is_open(capsys):
    """Otherwise the first step, or a client's first command, would end the server."""
    for make in (AirsimWorld, CrazyflieFleet, MavlinkFleet, HilBodies):
        for name in DYNAMICS:
            if name in ("rigid_body", "bullet"):
                make(1, dynamics=name, seed=0).close()
                continue
            with pytest.raises(ValueError, match=f"dynamics is '{name}', .*'rigid_body' or"):
                make(1, dynamics=name, seed=0)
        if make is not HilBodies:  # whose autopilots command rotors alone
            with pytest.raises(ValueError, match="need gravity"):
                make(1, gravity=0.0, seed=0)
            with pytest.raises(ValueError, match="controller 'pid' supports no"):
                make(1, "cf2x", controller="pid", effects=("drag",), seed=0)
    with pytest.raises(SystemExit):
        main(["serve", "airsim", "--port", "0", "--dynamics", "point_mass", "--seconds", "0.1"])
    assert "which has no motors" in capsys.readouterr().err


@pytest.fixture
def exhausted(monkeypatch):
    """Makes the system refuse connections, as it does without room for files, until it is cleared;
    and counts how often it was asked."""
    accept, is_exhausted, asked = socket.socket.accept, threading.Event(), []

    def refuse(self):
        asked.append(None)
        if is_exhausted.is_set():
            raise OSError(errno.EMFILE, "Too many open files")
        return accept(self)

    monkeypatch.setattr(socket.socket, "accept", refuse)
    is_exhausted.asked = asked
    is_exhausted.set()
    return is_exhausted


def test_servers_on_asyncio_wait_for_room_for_connections(exhausted, world, speak, caplog):
    """All of them have one accept loop: AirSim's calls, and live pages."""
    answers = []
    thread = threading.Thread(target=lambda: answers.extend(speak(PING)))
    thread.start()
    until(lambda: exhausted.asked)
    exhausted.clear()
    thread.join()
    assert answers == [[1, 1, None, True]]
    (line,) = [one.getMessage() for one in caplog.records]
    assert line.startswith("server: no connection can be accepted (Too many open files): retrying")
    assert "ulimit -n" in line


def test_silent_connections_make_room_where_the_system_has_none(exhausted, world, speak, caplog):
    exhausted.clear()
    with socket.create_connection(("127.0.0.1", speak.port), timeout=PATIENCE) as silent:
        until(lambda: len(speak.server.connections) == 1)
        exhausted.set()
        speak.now[0] += 2 * ACCEPT_RETRY
        with socket.create_connection(("127.0.0.1", speak.port), timeout=PATIENCE):
            assert silent.recv(1) == b""
        exhausted.clear()
    assert EVICTED_FOR_RESOURCES in caplog.text


def test_bodies_wait_for_room_for_connections(exhausted, caplog):
    """The socket stays ready: asking it again and again would take all of a processor."""
    now, bodies = [0.0], HilBodies(1)
    server = HilServer(bodies, port=0, clock=lambda: now[0])
    with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=PATIENCE):
        until(lambda: server._listen(0.01) or exhausted.asked)
        for _ in range(50):
            server._listen(0.0)
        assert len(exhausted.asked) == 1
        for count in (2, 3, 4):
            now[0] += 2 * ACCEPT_RETRY
            server._accept_again()
            until(lambda: server._listen(0.01) or len(exhausted.asked) == count)  # noqa: B023
        assert len(server._connections[0]) == 0
        assert EVICTED_FOR_RESOURCES not in caplog.text
        exhausted.clear()
        now[0] += 2 * ACCEPT_RETRY
        until(lambda: server._step_lockstep() or len(server._connections[0]) == 1)
        # A connection that is silent makes room for another one
        exhausted.set()
        now[0] += 2 * ACCEPT_RETRY
        with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=PATIENCE):
            until(lambda: server._listen(0.01) or len(server._connections[0]) == 0)
    assert EVICTED_FOR_RESOURCES in caplog.messages[1]
    assert "no connection can be accepted (Too many open files)" in caplog.messages[0]
    server.close()
    bodies.close()


# AirSim: "requests of up to 1 MiB", "msgpack makes numbers, texts, bytes, lists, maps and times
# alone; calls are those of a table, and check what they are given"


@pytest.fixture
def speak(world, monkeypatch):
    """Send bytes to a server that answers but does not fly; return its answers."""

    async def stand(self):
        import asyncio

        while not self._stopped:
            await asyncio.sleep(0.01)

    monkeypatch.setattr(AirsimServer, "_fly", stand)
    now = [0.0]
    server = AirsimServer(world, port=0, clock=lambda: now[0])
    thread = threading.Thread(target=server.run)
    thread.start()

    def speak(data):
        unpacker, answers = msgpack.Unpacker(), []
        with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as one:
            try:
                one.sendall(data)
                one.shutdown(socket.SHUT_WR)
                while more := one.recv(65536):
                    unpacker.feed(more)
                    answers.extend(unpacker)
            except OSError:  # it may be closed before it is shut down
                pass
        return answers

    speak.port, speak.server, speak.now = server.port, server, now
    yield speak
    server.stop()
    thread.join()


def request(body, name="ping"):
    """Make a request whose arguments are given as bytes."""
    return b"\x94\x00\x01" + msgpack.packb(name) + body


PING = request(b"\x90")


@pytest.mark.parametrize(
    "body",
    [
        b"\x91\xd4\x05\x00",  # a type of one's own
        b"\x91\xc7\x03\xff\x00\x00\x00",  # a time of no length that there is
        b"\x91\x81\x90\x01",  # a list as key
        b"\x91\xc1",
        b"\x91" * 5000 + b"\x01",
        b"\x91" + b"\x81\xa1x" * 5000 + b"\x01",
        b"\x91\xdd\xff\xff\xff\xff",
        b"\x91\xdf\xff\xff\xff\xff",
        b"\x91\xc9\xff\xff\xff\xff\x05",
        b"\x91\xdb\xff\xff\xff\xff" + b"x" * 2 * MAX_REQUEST_BYTES,
        b"\x91\xc6\x00\x20\x00\x00" + bytes(2**21),
        b"\x91" + b"\xdd\x00\x10\x00\x00" * 900,  # lists that claim a million items
        b"\x91" + b"\xdf\x00\x08\x00\x00" * 900,
    ],
    ids=str,
)
def test_bytes_that_make_no_plain_values_end_their_connection_alone(body, speak, caplog):
    assert speak(PING + request(body) + PING) in ([], [[1, 1, None, True]])
    assert speak(PING) == [[1, 1, None, True]]
    assert not [one for one in caplog.records if one.name == "asyncio"]


@pytest.mark.parametrize("item", [b"\x90", b"\x80", b"\xa0", b"\x01"], ids=str)
def test_a_request_that_never_ends_is_bounded(item, speak, caplog):
    """In pieces that are read at once: what has become objects counts too."""
    piece = b"\xdc\x10\x00" + item * 4096
    assert speak(PING + request(b"\xdc\x10\x00") + piece * 1000) in ([], [[1, 1, None, True]])
    assert speak(PING) == [[1, 1, None, True]]
    assert any("not msgpack, or too many" in one.message for one in caplog.records)


def read_all(reader, data, size=60_000):
    """Read bytes in pieces; return the messages."""
    pieces = [data[k : k + size] for k in range(0, len(data), size)]
    return [one for piece in pieces for one in reader.read(piece)]


@pytest.mark.parametrize("kind", ["list", "map"])
def test_lists_and_maps_have_so_many_items_together_and_no_more(kind):
    """However they are nested."""
    for count, is_read in ((MAX_ITEMS - 5, True), (MAX_ITEMS - 4, False)):
        items = [0] * count if kind == "list" else dict.fromkeys(range(count), 0)
        reader = _MessageReader(msgpack)
        messages = read_all(reader, msgpack.packb([0, 1, "ping", [items]]))
        assert messages == ([[0, 1, "ping", [items]]] if is_read else [])
        assert reader.is_broken is not is_read
    # One more than all together
    half = [0] * (MAX_ITEMS // 2)
    reader = _MessageReader(msgpack)
    assert read_all(reader, msgpack.packb([0, 1, "ping", [half, half]])) == []
    assert reader.is_broken


FULL = b"\xdc\x20\x00"
"""Head of a list of 8192"""


@pytest.mark.parametrize(
    "body",
    [
        FULL + (FULL + b"\x90" * 8192) * 127,
        FULL + (FULL + b"\x80" * 8192) * 127,
        FULL * 1000,
        b"\x91\xdd\x00\x0f\x00\x00" + b"\x90" * 0xF0000,
        b"\x91" + b"\xdf\x00\x08\x00\x00" * 900,
    ],
    ids=["empty lists", "empty maps", "claims", "a whole list", "claims of maps"],
)
def test_requests_take_little_more_memory_than_their_bytes(body):
    """Before they are whole, and when they are read; a list of an empty list takes 64 times."""
    data = request(body)[: MAX_REQUEST_BYTES - 1]
    reader = _MessageReader(msgpack)
    tracemalloc.start()
    try:
        assert read_all(reader, data) == []
        kept, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 3 * MAX_REQUEST_BYTES
    assert most < 6 * MAX_REQUEST_BYTES


def test_requests_are_bounded_one_by_one():
    """Many long ones in a row are no long one, however they are cut."""
    body = b"\x91\xc6" + (MAX_REQUEST_BYTES // 2).to_bytes(4) + bytes(MAX_REQUEST_BYTES // 2)
    reader = _MessageReader(msgpack)
    assert len(read_all(reader, request(body) * 5)) == 5
    assert not reader.is_broken


@pytest.mark.parametrize(
    "name", ["__init__", "__class__", "world.reset", "_pause", "eval", "", "\0"]
)
def test_calls_are_those_of_a_table(name, speak):
    ((_, _, error, result),) = speak(request(b"\x90", name))
    assert error.startswith("unknown call")
    assert result is None


@pytest.mark.parametrize("depth", [10, 400, 900])
def test_arguments_are_checked_however_deep_they_are(depth, speak, world, caplog):
    names = AirsimCalls(world).list_names()
    nested = [b"\x91" + b"\x91" * depth + b"\x01", b"\x92" + b"\x81\xa1x" * depth + b"\x01\xa0"]
    data = b"".join(request(body, name) for name, body in itertools.product(names, nested))
    answers = speak(data + PING)
    assert not [one for one in caplog.records if one.name == "asyncio"]
    if depth < 500:
        assert len(answers) == 2 * len(names) + 1
        assert answers[-1] == [1, 1, None, True]


def test_numbers_that_no_program_means_are_errors_or_cut(world):
    calls = AirsimCalls(world)
    calls.call("enableApiControl", [True, ""])
    calls.call("armDisarm", [True, ""])
    free = {"is_rate": True, "yaw_or_rate": 0.0}
    huge = (*ODD, 10**30, -(10**30), 2**63, True, None, "1", b"1")
    for odd, k in itertools.product(huge, range(4)):
        numbers = [1.0, 0.0, -1.0, 1.0]
        numbers[k] = odd
        place = dict(zip(("x_val", "y_val", "z_val"), numbers, strict=False))
        for name, given in (
            ("moveByVelocity", [*numbers, 0, free, ""]),
            ("moveToPosition", [*numbers, 5.0, 0, free, -1.0, 1.0, ""]),
            ("moveToZ", [*numbers[:3], free, -1.0, 1.0, ""]),
            ("moveByAngleRatesThrottle", [*numbers, 1.0, ""]),
            ("moveOnPath", [[place], 1.0, 5.0, 0, free, -1.0, 1.0, ""]),
        ):
            try:
                calls.start_motion(name, given, lambda done: None)
            except ValueError:
                continue
            for _ in range(3):
                world.step()
        with contextlib.suppress(ValueError):
            calls.call("simSetWind", [place])
        calls.call("simSetWind", [{"x_val": 0.0, "y_val": 0.0, "z_val": 0.0}])
    assert unharmed(world.airspace)


# MAVLink: "datagrams of up to 1400 bytes", "frames with a checksum", "each is checked and cut to a
# range", "8 clients and 500 items of a mission", "signatures are not checked"


def test_longer_datagrams_and_wrong_checksums_are_no_messages(make_vehicles):
    server = MavlinkServer(make_vehicles(1), port=0, client_port=None)
    arm = common.MAVLink_command_long_message(1, 1, Command.ARM, 0, 1, *[0.0] * 6)
    frame = bytes(arm.pack(common.MAVLink(None, 9)))
    broken = [frame[:k] + bytes([frame[k] ^ 1]) + frame[k + 1 :] for k in range(len(frame))]
    long = bytes(MAX_DATAGRAM_SIZE) + frame
    udp(server.ports[0], *broken, long)
    while server.malformed < len(broken) - 3:  # but for those whose number is no message's
        server._read(0)
    for _ in range(5):
        server._read(0)
    assert server.received == 0
    assert len(server.connections[0]) == 0
    assert not server.fleet.services[0].vehicle.pilot.is_armed
    udp(server.ports[0], frame)
    while not server.received:
        server._read(0)
    assert server.fleet.services[0].vehicle.pilot.is_armed
    server.close()


def test_signatures_are_not_checked():
    """As the sentence warns: whoever signs with another key is read."""
    packer = common.MAVLink(None, 9)
    packer.signing.secret_key, packer.signing.sign_outgoing = bytes(32), True
    frame = bytes(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer))
    assert frame[2] & 1
    assert len(MavlinkCodec(1).read(frame)) == 1


def test_no_numbers_send_a_vehicle_out_of_this_world(make_vehicles):
    fleet, rng = make_vehicles(1), np.random.default_rng(0)
    station = Station(fleet)
    kinds = {
        "set_position_target_local_ned": (0, 1, 1, 1),
        "set_position_target_global_int": (0, 1, 1, 5),
        "set_attitude_target": (0, 1, 1),
        "param_set": (1, 1, b"MPC_XY_VEL_MAX"),
    }

    def numbers(count):
        return [float(one) for one in rng.choice(ODD, count)]

    for k in range(1500):
        if k % 300 == 0:
            station.command(Command.ARM, 1, 21196)
            station.command(Command.TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN)
            station.fly(0.5)
        if k % 50 == 0:
            station.velocity(0.0, 0.0, 0.0)
            station.mode((6, 0))
        number = int(rng.choice(list(COMMANDS)))
        if number != Command.TERMINATE:  # which lets it fall, as it should
            station.command(number, *numbers(7))
        mask = int(rng.choice([0xDC7, 0xDF8, 0xC00, 0x000, 0xE00]))
        for name, head in kinds.items():
            if name == "set_position_target_local_ned":
                rest = (mask, *numbers(11))
            elif name == "set_position_target_global_int":
                places = rng.choice([0, -(2**31), 2**31 - 1, 473977420], 2).tolist()
                rest = (mask, *places, *numbers(9))
            elif name == "set_attitude_target":
                rest = (mask & 0xE7, numbers(4), *numbers(4))
            else:
                rest = (*numbers(1), 9)
            station.send(name, *head, *rest)
        if k % 5 == 0:
            station.fly(0.02)
        station.heard.clear()
    station.fly(1.0)
    assert unharmed(fleet.airspace)


def test_missions_and_peers_have_their_limits(make_vehicles):
    station = Station(make_vehicles(1))
    for count in (MAX_MISSION_ITEMS + 1, 65535):
        (ack,) = messages(station.send("mission_count", *station.target, count, 0), "MISSION_ACK")
        assert ack.type == common.MAV_MISSION_NO_SPACE
    assert MAX_MISSION_ITEMS == 500
    assert (LIMITS.max_clients, LIMITS.max_pending) == (8, 8)


def test_messages_of_other_dialects_are_left_out():
    """Nobody can check their sums, so that any bytes could be one."""
    wire = MavlinkCodec(1)
    frame = bytes(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None, 9)))
    other = frame[:7] + b"\xff\xff\x7f" + frame[10:]
    assert [one.get_type() for one in wire.read(other + frame)] == ["HEARTBEAT"]
    assert wire.malformed == 0


# HIL: "one autopilot a body", "what is no frame"


def test_bodies_have_one_autopilot_and_few_connections():
    assert (HIL_LIMITS.max_clients, HIL_LIMITS.max_pending) == (1, 4)


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01", b"\xfd" + bytes(11)])
@pytest.mark.parametrize("in_pieces", [False, True])
def test_what_is_no_frame_ends_its_connection(data, in_pieces):
    bodies = HilBodies(1)
    server = HilServer(bodies, port=0)
    controls = common.MAVLink_hil_actuator_controls_message(10**9, [1.0] * 16, 128, 1)
    data += bytes(controls.pack(common.MAVLink(None, 1, 1)))
    with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=PATIENCE) as one:
        pieces = [data[k : k + 1] for k in range(len(data))] if in_pieces else [data]
        ended, end = False, time.perf_counter() + PATIENCE
        one.setblocking(False)
        while not ended and time.perf_counter() < end:
            try:
                if pieces:
                    one.sendall(pieces.pop(0))
                    server._listen(0.01)
                else:
                    server._listen(0.01)
                    ended = one.recv(100) == b""
            except BlockingIOError:
                continue
            except ConnectionError:
                ended = True
        assert ended
    assert bodies._commands == [None]
    server.close()
    bodies.close()
