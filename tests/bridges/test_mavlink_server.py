"""The server of MAVLink vehicles, spoken to by pymavlink's own connections, and by other bytes."""

import socket
import time
from dataclasses import replace

import numpy as np
import pytest
from bridges.mavlink_client import NAN, VELOCITY_ONLY, Station, common, random_frame
from pymavlink import mavutil
from waiting import PATIENCE, until

from bulletuav.bridges.mavlink import LIMITS, MAX_MESSAGES_PER_READ, MavlinkServer
from bulletuav.bridges.mavlink_protocol import MavlinkCodec, Mode, OutgoingMessage
from bulletuav.bridges.setpoints import NORTH
from bulletuav.cli import main
from bulletuav.earth import pressure


@pytest.fixture
def serve(make_vehicles, keep_running):
    """Runs servers, ten times as fast as real time, until the test ends."""

    def serve(drones=1, speed=10.0, client_port=None, **options):
        fleet = make_vehicles(drones)
        return keep_running(MavlinkServer(fleet, "127.0.0.1", 0, speed, client_port, **options))

    return serve


@pytest.fixture
def connect():
    """Connects clients of pymavlink to vehicles."""
    made = []

    def connect(server, drone=0, source=255):
        link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{server.ports[drone]}", source_system=source
        )
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        link.target_system, link.target_component = drone + 1, 1
        made.append(link)
        return link

    yield connect
    for link in made:
        link.close()


def expect(link, kind, wanted=lambda message: True):
    """Wait for a message."""
    while True:
        message = link.recv_match(type=kind, blocking=True, timeout=PATIENCE)
        assert message is not None, f"no {kind} came"
        if wanted(message):
            return message


def command(link, number, *numbers):
    """Send a command; return how it was answered."""
    numbers = (*numbers, *[0.0] * (7 - len(numbers)))
    link.mav.command_long_send(link.target_system, 1, number, 0, *numbers)
    return expect(link, "COMMAND_ACK", lambda ack: ack.command == number).result


def go_offboard(link, setpoint):
    """Send a setpoint and change the mode, until both have come within a second of the flight."""
    for _ in range(100):
        link.mav.set_position_target_local_ned_send(*setpoint)
        link.set_mode_px4("OFFBOARD", 0, 0)
        if expect(link, "COMMAND_ACK", lambda ack: ack.command == 176).result == 0:
            return
    raise AssertionError("the mode did not change")


def test_a_client_of_pymavlink_flies(serve, connect):
    """As scripts do it, but for the speed of the server."""
    server = serve(2)
    link = connect(server, 1)
    beat = link.wait_heartbeat(timeout=PATIENCE)
    assert (beat.get_srcSystem(), beat.autopilot) == (2, common.MAV_AUTOPILOT_PX4)
    assert link.flightmode == "LOITER"
    link.arducopter_arm()
    link.motors_armed_wait()
    assert command(link, 22, 0, 0, 0, NAN, NAN, NAN, NAN) == 0
    expect(link, "LOCAL_POSITION_NED", lambda report: report.z < -2.3)
    expect(link, "HEARTBEAT", lambda report: report.custom_mode == Mode.HOLD)
    fields = (0, 2, 1, 8, VELOCITY_ONLY, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0)
    go_offboard(link, fields)
    expect(link, "LOCAL_POSITION_NED", lambda report: report.x > 0.5)
    assert command(link, 21) == 0
    link.motors_disarmed_wait()
    assert abs(server.fleet.airspace.swarm.position[0, 2]) < 0.1  # the other one still stands


def test_what_is_denied_is_logged_once(serve, connect, caplog):
    limits = replace(LIMITS, max_clients=1, max_pending=1)
    server = serve(limits=limits, clock=lambda: 0.0)
    link = connect(server)
    for _ in range(2):
        assert command(link, 192, -1, 1, 0, NAN, NAN, NAN, NAN) == 1
        assert command(link, 31000) == 3
        link.mav.mission_request_int_send(1, 1, 7)
        expect(link, "MISSION_ACK")
        link.mav.param_request_read_send(1, 1, b"NO_SUCH\n", -1)
        expect(link, "STATUSTEXT", lambda report: "no parameter" in report.text)
    others = connect(server), connect(server)
    for other in others:
        other.mav.command_long_send(1, 1, 512, 0, 148, *[0.0] * 6)
        other.mav.command_long_send(1, 1, 512, 0, 148, *[0.0] * 6)
    until(lambda: server.refused >= 5)
    port = link.port.getsockname()[1]
    report = [
        "COMMAND_LONG REPOSITION to vehicle 1 refused: result TEMPORARILY_REJECTED; "
        "not flying: arm and take off first",
        "COMMAND_LONG 31000 to vehicle 1 refused: result UNSUPPORTED",
        "MISSION_REQUEST_INT to vehicle 1 refused: mission result 13",
        "PARAM_REQUEST_READ to vehicle 1 refused: no parameter NO_SUCH\\n",
    ]
    expected = [f"client 127.0.0.1:{port}: {line}" for line in report]
    room = "connection refused by vehicle 1: 1 others are connected, which is the limit"
    ports = [other.port.getsockname()[1] for other in others]
    expected += [f"client 127.0.0.1:{one}: {room}; close one first" for one in ports]
    assert sorted(record.getMessage() for record in caplog.records) == sorted(expected)


def test_it_sends_to_the_clients_port_without_being_asked(serve):
    listener = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    port = listener.port.getsockname()[1]
    serve(client_port=port)
    assert listener.wait_heartbeat(timeout=PATIENCE).type == common.MAV_TYPE_QUADROTOR
    listener.target_system = 1
    assert command(listener, 512, 148) == 0
    assert expect(listener, "AUTOPILOT_VERSION").uid == 1
    listener.close()


def test_frames_of_the_older_mavlink_are_read_and_several_of_a_datagram(serve, connect):
    server = serve()
    link = connect(server)
    old = common.MAVLink_command_long_message(1, 1, 512, 0, 148, *[0.0] * 6)
    frames = bytes(old.pack(link.mav, force_mavlink1=True)) + bytes(old.pack(link.mav))
    link.write(frames)
    for _ in range(2):
        expect(link, "AUTOPILOT_VERSION")


def test_clients_that_vanish_are_sent_nothing_more_and_the_vehicle_holds(serve, connect):
    skipped = [0.0]
    server = serve(speed=5.0, clock=lambda: time.monotonic() + skipped[0])
    link = connect(server)
    command(link, 400, 1)
    command(link, 22, 0, 0, 0, NAN, NAN, NAN, NAN)
    expect(link, "LOCAL_POSITION_NED", lambda report: report.z < -2.3)
    go_offboard(link, (0, 1, 1, 1, VELOCITY_ONLY, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0))
    link.close()
    skipped[0] = LIMITS.max_idle
    pilot = server.fleet.services[0].vehicle.pilot
    until(lambda: not len(server.connections[0]) and pilot.mode == Mode.HOLD)
    sent = server.sent
    time.sleep(0.2)
    assert server.sent == sent
    assert pilot.is_armed


def test_two_clients_both_hear_it_and_only_one_flies_it(serve, connect):
    server = serve(speed=1.0)
    first, second = connect(server), connect(server, source=254)
    for link in (first, second):
        link.wait_heartbeat(timeout=PATIENCE)
    fields = (0, 1, 1, 1, VELOCITY_ONLY, *[0.0] * 11)
    first.mav.set_position_target_local_ned_send(*fields)
    time.sleep(0.1)
    second.mav.set_position_target_local_ned_send(*fields)
    report = expect(second, "STATUSTEXT")
    assert report.text == "setpoints denied: another client sends setpoints"
    assert command(second, 512, 242) == 0  # commands are everybody's


def test_more_peers_than_there_is_room_for_are_told_so(serve, connect, caplog):
    server = serve(limits=replace(LIMITS, max_pending=2, pending_grace=1e9))
    for _ in range(2):
        connect(server).wait_heartbeat(timeout=PATIENCE)
    third = connect(server)
    text = "refused: too many clients, try later"
    assert third.recv_match(blocking=True, timeout=PATIENCE).text == text
    for _ in range(5):
        third.mav.heartbeat_send(6, 8, 0, 0, 4)
    until(lambda: server.refused > 1)
    assert third.wait_heartbeat(timeout=0.3) is None
    port = third.port.getsockname()[1]
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"client 127.0.0.1:{port}: connection refused by vehicle 1: ")


def test_a_flood_from_many_ports_does_not_disconnect_a_client_that_flies(serve, connect):
    """Nor do clients that are there keep others out for ever."""
    now = [0.0]
    server = serve(limits=replace(LIMITS, max_clients=2), clock=lambda: now[0])
    link = connect(server)
    assert command(link, 512, 148) == 0
    flyer = ("127.0.0.1", link.port.getsockname()[1])
    now[0] = 4.0
    beat = bytes(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None, 9)))
    for k in range(60):
        now[0] += 0.05
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.sendto(beat, ("127.0.0.1", server.ports[0]))
        until(lambda k=k: server.received + server.refused >= k + 2)
    assert flyer in server.connections[0].clients()
    assert len(server.connections[0].all()) <= 9
    assert command(connect(server), 512, 148) == 0


def test_it_survives_what_is_no_frame(serve, connect):
    server = serve()
    link, rng = connect(server), np.random.default_rng(0)
    link.wait_heartbeat(timeout=PATIENCE)
    for k in range(2000):
        data = bytearray(rng.bytes(rng.integers(0, 300)))
        if len(data) > 3 and k % 2:
            data[0], data[1] = (0xFE, len(data) - 8 & 255) if k % 4 == 1 else (0xFD, 5)
        link.port.sendto(bytes(data), link.destination_addr)
        if k % 50 == 0:
            time.sleep(0.01)
    link.port.sendto(bytes(60000), link.destination_addr)
    assert command(link, 512, 148) == 0
    assert server.malformed > 1000
    assert np.isfinite(server.fleet.airspace.swarm.position).all()


def test_few_messages_are_taken_in_one_go_and_none_is_lost(make_vehicles):
    """A datagram of 1400 bytes has room for many more."""
    server = MavlinkServer(make_vehicles(1), port=0, client_port=None)
    packer = common.MAVLink(None, 9)
    ping = b"".join(bytes(common.MAVLink_ping_message(0, k, 0, 0).pack(packer)) for k in range(50))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.settimeout(PATIENCE)
        for _ in range(3):
            one.sendto(ping, ("127.0.0.1", server.ports[0]))
        counts = []
        while server.received < 150:
            server._read(0)
            counts.append(server.received)
    assert max(np.diff([0, *counts])) == MAX_MESSAGES_PER_READ
    server.close()


def test_a_flood_does_not_stop_the_flight(serve, connect):
    server = serve(2, speed=1.0)
    flooding, link = connect(server), connect(server, 1)
    many = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(flooding.mav) * 60
    before, answers = server.fleet.tick, []
    ask = common.MAVLink_command_long_message(2, 1, 512, 0, 148, *[0.0] * 6)

    def is_enough():
        for _ in range(50):
            flooding.port.sendto(bytes(many), flooding.destination_addr)
        # The system may drop a datagram where many come
        link.mav.send(ask)
        answer = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0)
        answers.extend([] if answer is None else [answer.result])
        return len(answers) >= 20 and server.fleet.tick - before >= 20

    until(is_enough)
    assert set(answers) == {0}


def test_a_port_in_use_is_told(serve, make_vehicles):
    server = serve()
    (port,) = server.ports
    with pytest.raises(OSError, match=f"port {port} .UDP.: .*another server running"):
        MavlinkServer(make_vehicles(1), port=port)
    with pytest.raises(ValueError, match="port is 65535: "):
        MavlinkServer(make_vehicles(2), port=65535)
    with pytest.raises(ValueError, match="client_port is 65535: "):
        MavlinkServer(make_vehicles(2), client_port=65535)
    with pytest.raises(OSError, match=r"cannot listen at 203\.0\.113\.1"):
        MavlinkServer(make_vehicles(1), host="203.0.113.1", port=0)


def test_the_command_serves_for_a_time(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.settimeout(PATIENCE)
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        options = ["--port", "0", "--client-port", str(port), "--seconds", "0.2"]
        main(["serve", "mavlink", *options])
        assert listener.recv(300)[0] == common.PROTOCOL_MARKER_V2
    assert f"they send to ports {port} to {port}" in capsys.readouterr().out


def test_without_pymavlink_the_extra_is_named(make_vehicles, monkeypatch):
    import sys

    from bulletuav.bridges import mavlink_protocol

    mavlink_protocol.dialect.cache_clear()
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with pytest.raises(ImportError, match="needs the extra 'mavlink'"):
        MavlinkServer(make_vehicles(1), port=0)


# Frames


def test_frames_are_numbered_and_read_again():
    wire = MavlinkCodec(7)
    frames = [wire.pack(OutgoingMessage("heartbeat", (2, 12, 1, 5, 3, 3))) for _ in range(300)]
    listener = common.MAVLink(None)
    found = [listener.decode(bytearray(one)) for one in frames]
    assert [one.get_seq() for one in found] == [k % 256 for k in range(300)]
    assert {one.get_srcSystem() for one in found} == {7}
    assert len(wire.read(b"".join(frames))) == 300
    assert wire.malformed == 0


def test_what_follows_a_broken_frame_is_dropped():
    wire = MavlinkCodec(1)
    frame = wire.pack(OutgoingMessage("heartbeat", (2, 12, 1, 5, 3, 3)))
    assert len(wire.read(frame + b"\x00" + frame)) == 1
    assert len(wire.read(frame + frame[:-1])) == 1
    assert wire.read(b"\xfd") == wire.read(b"\xfe") == wire.read(b"\xfd\x00") == []
    assert wire.malformed == 5


def bombard(fleet, count, seed):
    """Send random messages, with right checksums, to a vehicle that flies; return its modes."""
    rng, station = np.random.default_rng(seed), Station(fleet)
    modes = set()
    for k in range(count):
        if k % 2000 == 0:
            station.command(400, 0, 21196)
            # Upright again, if it has crashed
            fleet.airspace.place(0, fleet.services[0].vehicle.site.start, NORTH)
            fleet.step()
            station.take_off()
        for message in station.reader.read(random_frame(rng, station.packer)):
            station.hear(fleet.take(0, message, station.sender))
        if k % 10 == 0:
            station.hear(fleet.step()[0])
        station.heard.clear()
        modes.add(station.pilot.mode)
    assert np.isfinite(fleet.airspace.swarm.position).all()
    assert sum(map(len, fleet.services[0].vehicle.missions.lists.values())) < 10
    return modes


def test_messages_of_random_content_do_no_harm(make_vehicles):
    assert len(bombard(make_vehicles(1), 8000, 0)) >= 5


@pytest.mark.slow
def test_many_messages_of_random_content_do_no_harm(make_vehicles):
    import psutil

    fleet, process = make_vehicles(1), psutil.Process()
    # Functions of arrays are compiled after many calls, which takes memory once
    many = fleet.origin.to_geodetic(np.ones((100_000, 3)))
    pressure(fleet.origin.to_local(many)[:, 2])
    bombard(fleet, 10_000, 1)
    before = process.memory_info().rss
    bombard(fleet, 100_000, 2)
    assert process.memory_info().rss - before < 4e6
