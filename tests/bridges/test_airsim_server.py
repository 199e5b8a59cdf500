"""The server of AirSim's calls, spoken to by bytes: clients, floods, and what is no request."""

import contextlib
import socket
import struct
import sys
import threading
import time

import msgpack
import numpy as np
import pytest

from bulletuav.bridges import airsim
from bulletuav.bridges.airsim import AirsimServer
from bulletuav.bridges.airsim_world import World
from bulletuav.cli import main

FREE = (0, {"is_rate": True, "yaw_or_rate": 0.0})


class Client:
    """A socket that sends requests."""

    def __init__(self, server):
        self.socket = socket.create_connection(("127.0.0.1", server.port), timeout=20)
        self._unpacker, self._count = msgpack.Unpacker(), 0

    def send(self, name, *arguments):
        """Send a request; returns its number."""
        self._count += 1
        self.socket.sendall(msgpack.packb([0, self._count, name, list(arguments)]))
        return self._count

    def receive(self):
        """Take the next answer: its number, error and result."""
        while True:
            for kind, *answer in self._unpacker:
                assert kind == 1
                return answer
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionError
            self._unpacker.feed(data)

    def ask(self, name, *arguments):
        """Send a request and take its answer; returns error and result."""
        number = self.send(name, *arguments)
        told, error, result = self.receive()
        assert told == number
        return error, result

    def get(self, name, *arguments):
        error, result = self.ask(name, *arguments)
        assert error is None
        return result


@pytest.fixture
def serve():
    """Runs servers in threads, until the test ends."""
    running = []

    def serve(drones=1, speed=20.0, **options):
        world = World(drones, seed=0, **options)
        server = AirsimServer(world, port=0, speed=speed)
        thread = threading.Thread(target=server.run)
        thread.start()
        running.append((server, thread))
        return server

    yield serve
    for server, thread in running:
        server.stop()
        thread.join()
        server.world.close()


@pytest.fixture
def connect():
    made = []

    def connect(server):
        made.append(Client(server))
        return made[-1]

    yield connect
    for client in made:
        client.socket.close()


def ready(client, vehicle=""):
    assert client.get("enableApiControl", True, vehicle) is None
    assert client.get("armDisarm", True, vehicle) is True


def test_the_bytes_of_a_call(serve, connect):
    """[0, 7, "ping", []] as hand-made bytes, and [1, 7, nil, true]."""
    client = connect(serve())
    client.socket.sendall(b"\x94\x00\x07\xa4ping\x90")
    assert client.socket.recv(100) == b"\x94\x01\x07\xc0\xc3"
    assert client.get("getServerVersion") == 4
    assert client.get("getMinRequiredClientVersion") == 1


def test_what_is_no_request_is_not_answered(serve, connect):
    """A lone number, a list too short, a number that is a text, arguments that are none."""
    client = connect(serve())
    for probe in (7, [0, 1, "ping"], [0, "1", "ping", []], [0, 1, "ping", 5], [2, 1, "ping", []]):
        client.socket.sendall(msgpack.packb(probe))
    assert client.get("ping") is True


def test_motions_are_answered_when_they_end(serve, connect):
    client = connect(serve())
    ready(client)
    take_off = client.send("takeoff", 20.0, "")
    state = client.send("getMultirotorState", "")
    number, error, told = client.receive()
    assert (number, error) == (state, None)
    assert told["landed_state"] in (0, 1)
    assert client.receive() == [take_off, None, True]
    height = client.get("getMultirotorState", "")["kinematics_estimated"]["position"]["z_val"]
    assert height == pytest.approx(-3, abs=0.4)
    older = client.send("moveByVelocity", 1.0, 0.0, 0.0, 60.0, *FREE, "")
    newer = client.send("hover", "")
    assert client.receive() == [older, None, False]
    assert client.receive() == [newer, None, True]


def test_time_stands_still_until_it_is_let_go(serve, connect):
    client = connect(serve())
    client.get("simPause", True)
    ready(client)
    client.get("reset")
    ready(client)
    client.send("takeoff", 20.0, "")
    before = client.send("getMultirotorState", "")
    number, _, first = client.receive()
    assert number == before
    time.sleep(0.1)
    assert client.get("getMultirotorState", "")["timestamp"] == first["timestamp"]
    assert client.get("simContinueForTime", 0.5) is None
    after = client.get("getMultirotorState", "")
    assert after["timestamp"] - first["timestamp"] == 500_000_000
    assert after["kinematics_estimated"]["position"]["z_val"] < 0
    assert client.get("simContinueForFrames", 3) is None
    assert client.get("simIsPaused") is True


def test_what_is_wrong_is_told_to_who_sent_it(serve, connect):
    client = connect(serve())
    error, result = client.ask("getMultirotorStat", "")
    assert "did you mean 'getMultirotorState'" in error
    assert result is None
    assert "enableApiControl" in client.ask("takeoff", 20.0, "")[0]
    assert "seconds is" in client.ask("simContinueForTime", 1e9)[0]
    assert "unknown call 5" in client.ask(5)[0]
    assert client.get("ping") is True


def test_two_clients_fly_one_drone_and_the_newer_motion_counts(serve, connect):
    server = serve()
    first, second = connect(server), connect(server)
    ready(first)
    older = first.send("moveByVelocity", 0.0, 0.0, -1.0, 600.0, *FREE, "")
    second.get("ping")
    while not server.world.vehicle("")[1].flies:
        time.sleep(0.01)
    assert second.get("hover", "") is True
    assert first.receive() == [older, None, False]


def test_a_client_that_vanishes_leaves_the_drone_flying(serve, connect):
    server = serve()
    client = connect(server)
    ready(client)
    client.send("takeoff", 20.0, "")
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.socket.close()
    other = connect(server)
    while len(server._clients) > 1:
        time.sleep(0.01)
    end = time.perf_counter() + 20
    while other.get("getMultirotorState", "")["kinematics_estimated"]["position"]["z_val"] > -2.5:
        assert time.perf_counter() < end


def survive(server, connect, messages):
    """Send bytes that are no requests, on connections that may be closed for it."""
    rng = np.random.default_rng(messages)
    names = [*server._calls.names(), "x", "", 5, None]
    odd = [None, True, -1, 2**63, 1.5, float("nan"), "", "Drone1", b"\xff", [], {}, [1, {"x": []}]]
    odd += [{"x_val": 1.0, "y_val": 2.0, "z_val": -3.0}, FREE[1], 3e38]
    client = connect(server)
    for count in range(messages):
        try:
            if rng.random() < 0.05:
                client.socket.sendall(rng.bytes(rng.integers(1, 60)))
                client.socket.close()
                client = connect(server)
                continue
            name = names[rng.integers(len(names))]
            given = [odd[k] for k in rng.integers(0, len(odd), rng.integers(0, 9))]
            if name in ("simContinueForTime", "simContinueForFrames", "simGetImages"):
                given = given[:1]
            client.socket.sendall(msgpack.packb([0, count, name, given]))
            if count % 50 == 0:
                last = client.send("ping")
                while client.receive()[0] != last:
                    pass
        except OSError:
            client = connect(server)
    assert connect(server).get("ping") is True
    assert all(np.isfinite(array).all() for array in server.world.airspace.swarm)


def test_it_survives_any_calls_and_bytes(serve, connect, caplog):
    survive(serve(2), connect, 600)
    assert not caplog.records


@pytest.mark.slow
def test_it_survives_a_hundred_thousand_calls_and_bytes(serve, connect, caplog):
    survive(serve(2), connect, 100_000)
    assert not caplog.records


def test_a_request_that_is_too_long_ends_its_connection_alone(serve, connect):
    server = serve()
    client, other = connect(server), connect(server)
    with pytest.raises(ConnectionError):
        client.ask("ping", "x" * 3_000_000)
    assert other.get("ping") is True


def test_a_flood_does_not_stop_others(serve, connect):
    server = serve(speed=1.0)
    flooding, client = connect(server), connect(server)
    flood = msgpack.packb([0, 1, "getMultirotorState", [""]]) * 200

    def read():
        with contextlib.suppress(OSError):
            while flooding.socket.recv(2**20):
                pass

    threading.Thread(target=read, daemon=True).start()
    end, before, answered = time.perf_counter() + 0.6, server.world.time, 0
    while time.perf_counter() < end:
        flooding.socket.sendall(flood)
        answered += client.get("ping")
    assert answered > 2
    assert server.world.time - before > 0.1
    flooding.socket.shutdown(socket.SHUT_RDWR)


def test_there_is_an_end_of_clients(serve, connect, monkeypatch):
    monkeypatch.setattr(airsim, "MOST_CLIENTS", 2)
    server = serve()
    kept = [connect(server), connect(server)]
    assert [one.get("ping") for one in kept] == [True, True]
    with pytest.raises(ConnectionError):
        connect(server).get("ping")


def test_who_reads_nothing_is_let_go(serve, connect, monkeypatch):
    monkeypatch.setattr(airsim, "MOST_WAITING", 1000)
    server = serve()
    client = connect(server)

    def send():
        while True:  # pictures of 110 KB each
            client.send("simGetImages", [{"camera_name": "0", "image_type": 0}], "")
            time.sleep(0.001)

    with pytest.raises(ConnectionError):
        send()
    assert connect(server).get("ping") is True


def test_a_port_in_use_is_told(serve):
    server = serve()
    world = World(seed=0)
    with pytest.raises(OSError, match=f"port {server.port} .TCP.: .*another server running"):
        AirsimServer(world, port=server.port)
    with pytest.raises(ValueError, match="port is 70000"):
        AirsimServer(world, port=70000)
    other = AirsimServer(world, port=0)
    other.close()
    with pytest.raises(RuntimeError, match="closed"):
        other.run(1.0)
    world.close()


def test_without_msgpack_the_remedy_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "msgpack", None)
    world = World(seed=0)
    with pytest.raises(ImportError, match=r"bulletuav\[airsim\]|\[airsim\]"):
        AirsimServer(world)
    world.close()


def test_the_command_serves_for_a_time(capsys):
    main(["serve", "airsim", "--drones", "2", "--port", "0", "--seconds", "0.05", "--paused"])
    assert "Drone1, Drone2 at 127.0.0.1:" in capsys.readouterr().out
