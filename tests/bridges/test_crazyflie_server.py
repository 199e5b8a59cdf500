"""The server of virtual Crazyflies, spoken to by datagrams: clients, floods, and other bytes."""

import contextlib
import socket
import struct

import numpy as np
import pytest
from bridges.crtp_client import entries, read
from waiting import PATIENCE, until

from bulletuav.bridges.crazyflie import LIMITS, CrazyflieServer
from bulletuav.cli import main

SOURCE = b"\xfd\x00"
"""Request for the link's source, with which clients begin"""


class Client:
    """A socket that talks to one drone."""

    def __init__(self, server, drone=0):
        host, port = server.uris[drone].removeprefix("udp://").split(":")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, int(port)))
        self.socket.settimeout(PATIENCE)

    def send(self, datagram):
        self.socket.send(datagram)

    def receive(self):
        return read(self.socket.recv(100))

    def ask(self, port, channel, data=b""):
        self.send(bytes([port << 4 | 0x0C | channel]) + data)
        told, from_channel, answer = self.receive()
        assert (told, from_channel) == (port, channel)
        return answer

    def silent(self, seconds=0.1):
        """Tell whether nothing comes for a while."""
        self.socket.settimeout(seconds)
        try:
            self.socket.recv(100)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(PATIENCE)
        return False


@pytest.fixture
def serve(make_fleet, keep_running):
    """Runs servers, ten times as fast as real time, until the test ends."""

    def serve(drones=1, speed=10.0, **options):
        return keep_running(CrazyflieServer(make_fleet(drones), port=0, speed=speed, **options))

    return serve


@pytest.fixture
def connect():
    made = []

    def connect(*args):
        made.append(Client(*args))
        return made[-1]

    yield connect
    for client in made:
        client.socket.close()


def test_a_client_finds_drones_connects_and_flies(serve, connect):
    server = serve(2)
    probe = connect(server)
    probe.send(b"\xff")
    assert probe.socket.recv(10)
    assert server._peers == [None, None]
    client = connect(server, 1)
    assert client.ask(15, 1, b"\0").startswith(b"Bitcraze Crazyflie\0")
    names = entries(client.ask, 5, "BB")
    height = names["stateEstimate.z"][0]
    assert client.ask(5, 1, b"\x06\x00" + struct.pack("<BH", 7, height)) == b"\x06\0\0"
    assert client.ask(8, 0, struct.pack("<BBff?f", 7, 0, 0.5, 0.0, True, 1.0))[3] == 0
    assert client.ask(5, 1, b"\x03\x00\x0a") == b"\x03\0\0"
    heights = [struct.unpack("<f", client.receive()[2][4:])[0] for _ in range(20)]
    assert heights[0] < 0.05
    assert heights[-1] == pytest.approx(0.5, abs=0.03)
    assert server.fleet.airspace.swarm.position[0, 2] < 0.02


def test_a_second_client_waits_until_the_first_is_silent(serve, connect, caplog):
    now = [0.0]
    server = serve(clock=lambda: now[0])
    first, second = connect(server), connect(server)
    first.ask(15, 1, b"\0")
    second.send(SOURCE)
    port, _, text = second.receive()
    assert port == 0
    assert text.startswith(b"drone 0 is in use by port")
    second.send(bytes([0x8C]) + struct.pack("<BBff?f", 7, 0, 0.5, 0.0, True, 1.0))
    assert second.silent()
    assert server.refused == 2
    peer = f"127.0.0.1:{second.socket.getsockname()[1]}"
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"client {peer}: connection refused: drone 0 is in use by port")
    first.ask(15, 0, b"ping")
    now[0] = 0.4
    assert second.silent()
    now[0] = 0.6
    assert second.receive()[0] == 15  # once the first has been silent
    assert second.ask(15, 0, b"ping") == b"ping"
    first.send(b"\xfcping")
    assert first.silent()


def test_commands_without_effect_are_logged_once(serve, connect, caplog):
    server = serve(clock=lambda: 0.0)
    client, other = connect(server), connect(server)
    take_off = struct.pack("<BBff?f", 7, 0, 0.5, 0.0, True, 1.0)
    client.ask(9, 1, bytes((1, 0)))
    for _ in range(2):
        client.ask(8, 0, take_off)
        client.send(b"\x3c" + struct.pack("<fffH", 0.0, 0.0, 0.0, 30000))
        client.send(b"\x3c" + bytes(14))  # motors off: nothing that it does not do
        assert client.ask(8, 0, b"\x63\0\0")[3] == 8
        client.send(b"\x9d\x09")
    client.ask(9, 1, bytes((3,)))
    assert client.ask(9, 1, bytes((1, 1)))[1] == 0
    assert client.ask(9, 1, bytes((2,)))[1] == 0
    other.send(SOURCE)
    other.receive()
    until(lambda: len(caplog.records) >= 7)
    port, third = (one.socket.getsockname()[1] for one in (client, other))
    mine = f"client 127.0.0.1:{port}: packet to "
    disarmed = "it cannot fly: it is not armed; arm it first"
    locked = "it is locked by an emergency stop; restart the server"
    assert [record.getMessage() for record in caplog.records] == [
        f"{mine}SETPOINT_HL, channel 0, of drone 0 refused: {disarmed}",
        f"{mine}SETPOINT, channel 0, of drone 0 refused: {disarmed}",
        f"{mine}SETPOINT_HL, channel 0, of drone 0 refused: command 99 returned ENOEXEC",
        f"{mine}SUPERVISOR, channel 1, of drone 0 refused: "
        f"supervisor command 9: from 1 to 4 is needed",
        f"{mine}SUPERVISOR, channel 1, of drone 0 refused: it cannot be armed: {locked}",
        f"{mine}SUPERVISOR, channel 1, of drone 0 refused: "
        f"it cannot recover: {locked}, or there is no space to stand",
        f"client 127.0.0.1:{third}: connection refused: drone 0 is in use by port {port}; "
        f"close that link first",
    ]


def test_a_client_that_closes_its_link_leaves_the_drone_at_once(serve, connect):
    server = serve()
    first, second = connect(server), connect(server)
    first.ask(15, 1, b"\0")
    assert first.ask(5, 1, b"\x06\x00" + struct.pack("<BH", 7, 0)) == b"\x06\0\0"
    first.send(b"\x3c" + bytes(14))
    until(lambda: server._peers[0].has_closed_link)
    assert second.ask(15, 1, b"\0").startswith(b"Bitcraze")
    assert second.ask(5, 1, b"\x03\x00\x01")[2] == 2  # the log blocks went with the first
    assert server.refused == 0


def test_a_client_that_vanished_is_sent_nothing_more(serve, connect):
    now = [0.0]
    server = serve(clock=lambda: now[0])
    client = connect(server)
    client.ask(15, 1, b"\0")
    client.ask(5, 1, b"\x06\x00" + struct.pack("<BH", 7, 0))
    client.ask(5, 1, b"\x03\x00\x01")
    client.socket.close()
    now[0] = LIMITS.max_idle + 1
    until(lambda: server._peers == [None])
    assert server.fleet.vehicles[0].logs.due(10**6) == []
    assert connect(server).ask(15, 0, b"alive") == b"alive"


STUN = b"\x00\x01\x00\x00\x21\x12\xa4\x42" + bytes(12)
"""Request of WebRTC, which a page can have sent to any port"""


@pytest.mark.parametrize("datagram", [b"", b"\xff", STUN, b"\x16\xfe\xfd" + bytes(20), bytes(100)])
def test_what_is_for_no_service_takes_no_drone(datagram, serve, connect):
    server = serve()
    other, client = connect(server), connect(server)
    other.send(datagram)
    assert client.ask(15, 1, b"\0").startswith(b"Bitcraze")
    assert server._peers[0].address == client.socket.getsockname()
    assert server.refused == 0


def test_it_survives_what_is_no_packet(serve, connect):
    server = serve()
    client, rng = connect(server), np.random.default_rng(0)
    client.ask(15, 1, b"\0")
    for _ in range(2000):
        client.send(rng.bytes(rng.integers(0, 40)))
    client.send(bytes(1400))
    client.send(b"\xfcdone")

    def is_done():
        client.send(b"\xfcdone")
        return client.receive()[2] == b"done"

    until(is_done)
    assert server.fleet.vehicles[0].malformed > 100
    assert np.isfinite(server.fleet.airspace.swarm.position).all()


def test_a_flood_does_not_stop_the_flight(serve, connect):
    server = serve(2, speed=1.0)
    flooding, client = connect(server), connect(server, 1)
    before, answers = server.fleet.tick, []
    client.socket.settimeout(1.0)

    def is_enough():
        for _ in range(200):
            flooding.send(b"\xfc" + bytes(30))
        # The system may drop a datagram where many come
        with contextlib.suppress(TimeoutError):
            answers.append(client.ask(15, 0, b"still there"))
        return len(answers) >= 20 and server.fleet.tick - before >= 20

    until(is_enough)
    assert set(answers) == {b"still there"}


def test_a_port_in_use_is_told(serve, make_fleet):
    server = serve()
    port = int(server.uris[0].rsplit(":", 1)[1])
    with pytest.raises(OSError, match=f"port {port} .UDP.: .*another server running"):
        CrazyflieServer(make_fleet(1), port=port)
    with pytest.raises(ValueError, match="port is 65535: "):
        CrazyflieServer(make_fleet(2), port=65535)
    with pytest.raises(OSError, match=r"cannot listen at 203\.0\.113\.1"):
        CrazyflieServer(make_fleet(1), host="203.0.113.1", port=0)


def test_the_command_serves_for_a_time(capsys):
    main(["serve", "crazyflie", "--drones", "2", "--port", "0", "--seconds", "0.05"])
    told = capsys.readouterr().out
    assert "2 drones at udp://127.0.0.1:" in told
    with pytest.raises(SystemExit):
        main(["serve", "crazyfly"])
    assert "did you mean 'crazyflie'" in capsys.readouterr().err
