"""The server of AirSim's calls, spoken to by bytes: clients, floods, and what is no request."""

import asyncio
import contextlib
import itertools
import logging
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import msgpack
import numpy as np
import pytest
from PIL import Image
from waiting import PATIENCE, until

from bulletuav.bridges import airsim, airsim_drawing, airsim_recording
from bulletuav.bridges.airsim import AirsimServer, TurnScheduler
from bulletuav.bridges.airsim_recording import AirsimRecorder
from bulletuav.bridges.airsim_settings import VehicleSettings, parse_settings
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.cli import main
from bulletuav.serving.connections import ConnectionLimits
from bulletuav.serving.streams import SWEEP_PERIOD

FREE = (0, {"is_rate": True, "yaw_or_rate": 0.0})


class Client:
    """A socket that sends requests."""

    def __init__(self, server):
        self.socket = socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE)
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
        world = AirsimWorld(drones, seed=0, settings=options.pop("settings", None))
        # On a busy machine a client of a test may take long to send its first request
        options.setdefault("limits", ConnectionLimits(handshake=PATIENCE))
        server = AirsimServer(world, port=0, speed=speed, **options)
        thread = threading.Thread(target=server.run)
        server.is_running = thread.is_alive
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


MOVES = b"".join(
    msgpack.packb([0, number, *call])
    for number, call in enumerate(
        [("enableApiControl", [True, ""]), ("armDisarm", [True, ""]), ("takeoff", [20.0, ""])]
    )
)
"""Requests that make a drone fly"""
HEADERS = b"Host: 127.0.0.1\r\nOrigin: https://evil.example\r\nContent-Length: 200\r\n"
CHUNKED = b"Transfer-Encoding: chunked\r\n\r\n%x\r\n" % len(MOVES)
FORM = b"--b\r\nContent-Disposition: form-data; name=x\r\n\r\n"
NO_REQUESTS = {
    "GET": b"GET / HTTP/1.1\r\n" + HEADERS + b"\r\n",
    "POST": b"POST / HTTP/1.1\r\n" + HEADERS + b"\r\n",
    "POST a form": b"POST / HTTP/1.1\r\n" + HEADERS + b"\r\n" + FORM,
    "PUT": b"PUT / HTTP/1.1\r\n" + HEADERS + b"\r\n",
    "OPTIONS": b"OPTIONS / HTTP/1.1\r\n" + HEADERS + b"\r\n",
    "POST chunks": b"POST / HTTP/1.1\r\n" + HEADERS + CHUNKED,
    "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "WebSocket": b"GET / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n\x82\x7e\x00\x80",
    "TLS": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    "TURN": b"\x00\x03\x00\x08\x21\x12\xa4\x42" + bytes(12),
    "ICE over TCP": b"\x00\x94\x00\x01\x00\x80\x21\x12\xa4\x42",
    "number": msgpack.packb(7),
    "nil": msgpack.packb(None),
    "text": msgpack.packb("ping"),
    "map": msgpack.packb({0: 1, 1: "ping"}),
    "short list": msgpack.packb([0, 1, "ping"]),
    "text as number": msgpack.packb([0, "1", "ping", []]),
    "truth as number": msgpack.packb([0, True, "ping", []]),
    "truth as kind": msgpack.packb([False, 1, "ping", []]),
    "no arguments": msgpack.packb([0, 1, "ping", 5]),
    "answer": msgpack.packb([1, 1, None, True]),
    "notification": msgpack.packb([2, "ping", []]),
    "no msgpack": b"\xc1",
}
"""First bytes of what browsers can be made to send, and of other messages that are no requests"""


@pytest.fixture(scope="module")
def still():
    """A server that waits for a client to fly; tests of no requests share it."""
    world = AirsimWorld(1, seed=0)
    server = AirsimServer(world, port=0, speed=20.0)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.stop()
    thread.join()
    world.close()


@pytest.mark.parametrize("in_pieces", [False, True], ids=["whole", "in pieces"])
@pytest.mark.parametrize("kind", NO_REQUESTS)
def test_a_connection_ends_with_the_first_message_that_is_no_request(kind, in_pieces, still):
    """Also where requests follow, so that no page in a browser can fly a drone."""
    data = NO_REQUESTS[kind] + MOVES
    with socket.create_connection(("127.0.0.1", still.port), timeout=PATIENCE) as one:
        answer = b""
        with contextlib.suppress(ConnectionError):
            for piece in [data[k : k + 1] for k in range(len(data))] if in_pieces else [data]:
                one.sendall(piece)
            while more := one.recv(65536):
                answer += more
    assert answer == b""
    vehicle = still.world.vehicle("")[1]
    assert not vehicle.is_api_controlled
    assert not vehicle.is_flying


def test_requests_before_one_that_is_none_are_answered(still, connect):
    client = connect(still)
    client.socket.sendall(msgpack.packb([0, 1, "ping", []]) + NO_REQUESTS["POST"] + MOVES)
    assert client.receive() == [1, None, True]
    with pytest.raises(ConnectionError):
        client.receive()
    assert not still.world.vehicle("")[1].is_api_controlled


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


def test_an_answer_does_not_wait_until_the_one_before_is_acknowledged(serve, connect):
    """Peers delay acknowledgements by 40 ms, as long as other delays of a busy machine."""
    server = serve()
    connect(server).get("ping")
    (stream,) = server._streams._talks.values()
    accepted = stream._transport.get_extra_info("socket")
    assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


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
    # As in AirSim, whose clients cannot show an error of a motion
    assert client.ask("takeoff", 20.0, "") == (None, False)
    assert client.ask("armDisarm", True, "") == (None, False)
    assert "seconds is" in client.ask("simContinueForTime", 1e9)[0]
    assert "unknown call 5" in client.ask(5)[0]
    assert client.get("ping") is True


def test_two_clients_fly_one_drone_and_the_newer_motion_counts(serve, connect):
    server = serve()
    first, second = connect(server), connect(server)
    ready(first)
    older = first.send("moveByVelocity", 0.0, 0.0, -1.0, 600.0, *FREE, "")
    second.get("ping")
    until(lambda: server.world.vehicle("")[1].is_flying)
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
    until(lambda: len(server.connections) == 1)

    def height():
        return other.get("getMultirotorState", "")["kinematics_estimated"]["position"]["z_val"]

    until(lambda: height() < -2.5)


def survive(server, connect, messages):
    """Send bytes that are no requests, on connections that may be closed for it."""
    rng = np.random.default_rng(messages)
    names = [*server._calls.list_names(), "x", "", 5, None]
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


def failures(caplog):
    """What was logged, but for requests that were refused."""
    return [one for one in caplog.records if one.levelno > logging.WARNING]


def test_it_survives_any_calls_and_bytes(serve, connect, caplog):
    survive(serve(2), connect, 600)
    assert not failures(caplog)


@pytest.mark.slow
def test_it_survives_a_hundred_thousand_calls_and_bytes(serve, connect, caplog):
    survive(serve(2), connect, 100_000)
    assert not failures(caplog)


def test_a_request_that_is_too_long_ends_its_connection_alone(serve, connect):
    server = serve()
    client, other = connect(server), connect(server)
    with pytest.raises(ConnectionError):
        client.ask("ping", "x" * 3_000_000)
    assert other.get("ping") is True


@contextlib.contextmanager
def flooding(client, name, *arguments):
    """Sends a request without end, and reads the answers, until the end of the block."""
    flood = msgpack.packb([0, 1, name, list(arguments)]) * 200
    client.socket.settimeout(None)

    def send():
        with contextlib.suppress(OSError):
            while True:
                client.socket.sendall(flood)

    def read():
        with contextlib.suppress(OSError):
            while client.socket.recv(2**20):
                pass

    threads = [threading.Thread(target=one) for one in (send, read)]
    for thread in threads:
        thread.start()
    try:
        yield
        assert all(thread.is_alive() for thread in threads)
    finally:
        client.socket.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("getMultirotorState", [""]),
        ("simContinueForFrames", [60_000]),
        ("simGetImages", [[{"camera_name": "0", "image_type": 0}] * 32, ""]),
    ],
)
def test_a_flood_does_not_stop_others(serve, connect, name, arguments):
    server = serve(speed=1.0)
    client = connect(server)
    with flooding(connect(server), name, *arguments):
        for _ in range(20):
            before = server.world.time
            assert client.get("ping") is True
            until(lambda before=before: server.world.time > before)


def worker_of(server):
    """The number of the process that draws pictures."""
    return server._pictures._process.pid


ONE = {"camera_name": "0", "image_type": 0}


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="stops a process by a signal")
def test_the_flight_and_others_do_not_wait_for_pictures(serve, connect):
    """While the process that draws stands still, all else goes on; answers keep their order."""
    server = serve(speed=1.0)
    client, other = connect(server), connect(server)
    assert len(client.get("simGetImages", [ONE], "")) == 1
    os.kill(worker_of(server), signal.SIGSTOP)
    try:
        numbers = [client.send("simGetImages", [ONE] * 2, ""), client.send("ping")]
        before = server.world.time
        for _ in range(50):
            assert other.get("ping") is True
        until(lambda: server.world.time > before + 0.2)
        # Its owner waits, also with requests that come after pictures
        assert not select.select([client.socket], [], [], 0)[0]
    finally:
        os.kill(worker_of(server), signal.SIGCONT)
    assert [client.receive()[0] for _ in numbers] == numbers


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="stops a process by a signal")
def test_a_process_that_hangs_is_killed_and_replaced(serve, connect, monkeypatch, caplog):
    server = serve()
    client, other = connect(server), connect(server)
    assert len(client.get("simGetImages", [ONE], "")) == 1
    hung = worker_of(server)
    os.kill(hung, signal.SIGSTOP)
    monkeypatch.setattr(airsim_drawing, "PICTURE_TIMEOUT", 0.2)
    error, result = client.ask("simGetImages", [ONE] * 2, "")
    assert "it hung for 0.2 s and was killed" in error
    assert "the next request starts it again" in error
    assert result is None
    monkeypatch.undo()
    assert len(other.get("simGetImages", [ONE], "")) == 1
    assert worker_of(server) != hung
    until(lambda: [one.busy for one in server.connections._entries.values()] == [0, 0])
    assert "hung" in caplog.text


def test_a_start_that_hangs_is_an_error(serve, connect, draw_by, monkeypatch):
    draw_by(airsim_drawing.DrawingProcess)
    monkeypatch.setattr(airsim_drawing, "CHILD_PROGRAM", "import time; time.sleep(1e6)")
    monkeypatch.setattr(airsim_drawing, "START_TIMEOUT", 0.2)
    client = connect(serve())
    assert "it hung for 0.2 s and was killed" in client.ask("simGetImages", [ONE], "")[0]
    assert client.get("ping") is True


def test_clients_that_wait_hold_their_places_for_a_time_alone(serve, connect):
    """Each flies the world for long; one of them makes room, and its flight ends with it."""
    now = [0.0]
    server = serve(limits=ConnectionLimits(max_clients=3, max_wait=600.0), clock=lambda: now[0])
    waiting = [connect(server) for _ in range(3)]
    for client in waiting:
        client.send("simContinueForFrames", 60_000)
    until(lambda: [one.busy for one in server.connections._entries.values()] == [1] * 3)
    now[0] = 599.0
    late = connect(server)
    assert "this server is full" in late.ask("ping")[0]
    now[0] = 601.0
    assert connect(server).get("ping") is True
    with pytest.raises(ConnectionError):
        waiting[0].receive()
    until(lambda: len(server._streams._talks) == 3)


def test_the_start_of_the_process_stops_nobody(serve, connect, draw_by, monkeypatch):
    """Neither does a start that never ends, and the server ends nevertheless."""
    draw_by(airsim_drawing.DrawingProcess)
    monkeypatch.setattr(airsim_drawing, "CHILD_PROGRAM", "import time; time.sleep(1e6)")
    server = serve()
    client, other = connect(server), connect(server)
    client.send("simGetImages", [ONE], "")
    until(lambda: server._pictures._process is not None)
    before = server.world.time
    assert other.get("ping") is True
    until(lambda: server.world.time > before + 0.2)


def test_a_picture_that_cannot_be_drawn_is_an_error(serve, connect, draw_by):
    def refuse():
        raise OSError("no room for a process")

    draw_by(refuse)
    client = connect(serve())
    error, result = client.ask("simGetImages", [ONE], "")
    assert "the process that draws pictures ended (no room for a process)" in error
    assert result is None
    assert client.get("ping") is True


class Large:
    """In place of the process that draws: each picture is a million bytes."""

    def prepare(self, setup):
        assert setup

    def draw(self, poses, exposure, is_list):
        return msgpack.packb(bytes(10**6))

    def kill(self):
        assert self

    def close(self):
        return 0


@pytest.fixture
def large_pictures(draw_by):
    """Pictures are a million bytes each: sockets hold few of them."""
    draw_by(Large)


@pytest.fixture
def sending(serve, connect, large_pictures):
    """A server, and a client whose answer of 32 MB is under way, as it reads nothing yet."""
    server = serve()
    client = connect(server)
    ready(client)
    motion = client.send("moveByVelocity", 0.0, 0.0, -0.1, 600.0, *FREE, "")
    pictures = client.send("simGetImages", [ONE] * 32, "")
    (stream,) = server.connections.all()
    sizes = []

    def is_stuck():
        sizes.append(stream.unread)
        return sizes[-1] > 0 and len(sizes) > 50 and len(set(sizes[-50:])) == 1

    until(is_stuck)
    return server, client, motion, pictures


def test_a_motion_that_ends_does_not_cut_into_pictures(sending, connect):
    server, client, motion, pictures = sending
    assert connect(server).get("cancelLastTask", "") is None
    number, error, result = client.receive()
    assert (number, error) == (pictures, None)
    assert result == [bytes(10**6)] * 32
    assert client.receive() == [motion, None, False]
    assert client.get("ping") is True


def test_a_server_stops_though_a_client_reads_no_pictures(sending):
    server, *_ = sending
    server.stop()
    until(lambda: not server.is_running())


def test_more_than_a_client_may_leave_unread_is_sent_to_one_that_reads(
    serve, connect, large_pictures, caplog
):
    """32 pictures of a million bytes, to a client that is busy but reads: it is not dropped."""
    server = serve(limits=ConnectionLimits(max_unread=2 * 10**6))
    client = connect(server)
    for _ in range(2):
        assert client.get("simGetImages", [ONE] * 32, "") == [bytes(10**6)] * 32
    assert not caplog.records


def test_a_client_that_waits_for_pictures_is_not_idle(serve, connect, draw_by):
    """It keeps its place, however long they take; one that waits for nothing makes room."""
    may_draw, now = threading.Event(), [0.0]

    class Slow(Large):
        def draw(self, poses, exposure, is_list):
            assert may_draw.wait(PATIENCE)
            return msgpack.packb(b"drawn")

    draw_by(Slow)
    limits = ConnectionLimits(max_clients=2, grace=60.0, max_idle=1000.0)
    server = serve(limits=limits, clock=lambda: now[0])
    client, idle = connect(server), connect(server)
    assert client.get("ping") is True
    number = client.send("simGetImages", [ONE] * 2, "")
    until(lambda: [one.busy for one in server.connections._entries.values()].count(1) == 1)
    now[0] = 100.0
    assert idle.get("ping") is True
    now[0] = 1050.0
    other = connect(server)
    assert other.get("ping") is True
    with pytest.raises(ConnectionError):
        idle.receive()
    may_draw.set()
    assert client.receive() == [number, None, [b"drawn"] * 2]
    assert client.get("ping") is True


@pytest.mark.parametrize("is_sending", [False, True], ids=["while drawn", "while sent"])
def test_a_client_dropped_before_its_pictures_came_leaves_nothing(
    is_sending, serve, connect, draw_by, caplog
):
    may_draw, drawn = threading.Event(), []

    class Slow(Large):
        def draw(self, poses, exposure, is_list):
            drawn.append(None)
            assert is_sending or may_draw.wait(PATIENCE)
            return msgpack.packb(bytes(10**6))

    draw_by(Slow)
    now = [0.0]
    server = serve(clock=lambda: now[0])
    client, other = connect(server), connect(server)
    ready(client)
    client.send("moveByVelocity", 0.0, 0.0, -0.1, 600.0, *FREE, "")
    client.send("simGetImages", [ONE] * 32, "")
    stream = server.connections.clients()[0]
    if is_sending:
        until(lambda: stream.unread > 0)

        def is_dropped():
            now[0] += 1.0
            return not stream.is_open

        assert other.get("ping") is True
        until(is_dropped)
    else:
        until(lambda: drawn)
        assert other.get("ping") is True
        reset = struct.pack("ii", 1, 0)
        client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
        client.socket.close()
        until(lambda: not stream.is_open)
        may_draw.set()
    until(lambda: len(server.connections) == 1)
    assert is_sending or len(drawn) == 1
    until(lambda: len(server._streams._talks) == 1)  # a task is removed just after it ends
    assert other.get("cancelLastTask", "") is None  # the end of its motion is no answer to it
    assert other.get("simGetImages", [ONE], "") == [bytes(10**6)]
    assert not failures(caplog)


SERVE_ONE = """
import socket, msgpack, threading
from bulletuav.bridges.airsim import AirsimServer
from bulletuav.bridges.airsim_world import World
server = AirsimServer(World(seed=0), port=0)
threading.Thread(target=server.run, daemon=True).start()
client = socket.create_connection(("127.0.0.1", server.port))
client.sendall(msgpack.packb([0, 1, "simGetImage", ["0", 0, ""]]))
client.recv(1)
print("drawn", flush=True)
threading.Event().wait()
"""


def test_the_process_that_draws_ends_with_a_server_that_is_killed():
    """It holds the server's stderr: that ends only with the last process that has it."""
    command = [sys.executable, "-c", SERVE_ONE]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as server:
        assert server.stdout.readline().strip() == b"drawn"
        server.kill()
        server.communicate(timeout=PATIENCE)


def test_refused_motions_are_logged_with_the_remedy(serve, connect, caplog):
    server = serve(2)
    client, other = connect(server), connect(server)
    motion = (1.0, 0.0, 0.0, 1.0, *FREE)
    for _ in range(3):
        assert client.ask("takeoff", 20.0, "") == (None, False)
        client.get("enableApiControl", True, "Drone2")
        client.get("armDisarm", False, "Drone2")
        client.ask("moveByVelocity", *motion, "Drone2")
        client.ask("moveByVelocity", *motion, "Drone9")
        client.ask("moveByVelocite", *motion, "Drone2")
        client.get("armDisarm", True, "Drone2")
        client.ask("moveByVelocity", float("nan"), *motion[1:], "Drone2")
    client.ask("getMultirotorState", "a\nclient 1.2.3.4:5: \x1b[31m" + "x" * 5000)
    other.ask("takeoff", 20.0, "")
    lines = [record.getMessage() for record in caplog.records]
    mine, theirs = (f"client 127.0.0.1:{one.socket.getsockname()[1]}: " for one in (client, other))
    control = (
        "vehicle 'Drone1' is not under API control; call enableApiControl(True, 'Drone1') first"
    )
    assert lines[0] == f"{mine}takeoff refused: {control}"
    assert lines[1] == (
        f"{mine}moveByVelocity refused: vehicle 'Drone2' is not armed; "
        f"call armDisarm(True, 'Drone2') first"
    )
    assert lines[2].startswith(f"{mine}moveByVelocity refused: unknown vehicle 'Drone9': did you")
    assert lines[3].startswith(f"{mine}moveByVelocite refused: unknown call 'moveByVelocite'")
    assert lines[4].startswith(f"{mine}moveByVelocity refused: velocity is nan")
    assert lines[5].startswith(f"{mine}getMultirotorState refused: unknown vehicle 'a")
    assert len(lines[5]) < 500
    assert lines[6:] == [f"{theirs}takeoff refused: {control}"]
    assert all(line.isprintable() for line in lines)
    client.socket.close()
    until(lambda: len(server._refusals._kinds) == 1)


def test_turns_end_by_time_not_by_a_number_of_requests(monkeypatch):
    """Of two clients one sends requests of a whole turn each, the other ten times as quick ones."""
    monkeypatch.setattr(airsim, "MAX_TURN_TIME", 10)
    now, order = [0], []
    scheduler = TurnScheduler(lambda: now[0])

    def work(name, cost, count):
        for _ in range(count):
            now[0] += cost
            order.append(name)
            yield None

    async def later():
        order.append("later")

    def waits():
        yield later()
        order.append("after")
        yield None

    async def both():
        await asyncio.gather(
            scheduler.run(work("slow", 10, 3)), scheduler.run(work("quick", 1, 15))
        )

    asyncio.run(both())
    assert order == ["slow", *["quick"] * 10, "slow", *["quick"] * 5, "slow"]
    # What takes longer than a turn is awaited outside of it, before the client's next request
    order.clear()
    asyncio.run(scheduler.run(waits()))
    assert order == ["later", "after"]


def test_time_that_is_continued_is_flown_in_turns(monkeypatch):
    """Others run between any two steps that take a turn each."""
    world, now, seen = AirsimWorld(seed=0), [0.0], []
    server = AirsimServer(world, port=0)
    server._scheduler = TurnScheduler(lambda: now[0])

    def step():
        now[0] += airsim.MAX_TURN_TIME
        seen.append("step")

    async def others():
        while seen.count("step") < 5:
            seen.append("others")
            await asyncio.sleep(0)

    async def both():
        await asyncio.gather(server.advance(5), others())

    monkeypatch.setattr(world, "step", step)
    asyncio.run(both())
    assert "step, step" not in ", ".join(seen)
    server.close()
    world.close()


def test_silent_connections_lock_nobody_out(serve, connect):
    """Many more than there are places; the client that flies is not disconnected for them."""
    server = serve(limits=ConnectionLimits(max_clients=2, max_pending=8))
    client = connect(server)
    ready(client)
    silent = [connect(server) for _ in range(30)]
    assert client.get("ping") is True
    assert connect(server).get("ping") is True
    closed = sum(one.socket.recv(1) == b"" for one in silent[:20])
    assert closed == 20
    assert client.get("ping") is True


def test_connections_without_a_request_are_closed_in_time(serve, connect):
    now = [0.0]
    server = serve(limits=ConnectionLimits(handshake=10.0), clock=lambda: now[0])
    client, silent, partial = connect(server), connect(server), connect(server)
    assert client.get("ping") is True
    partial.socket.sendall(b"\x94\x00")
    until(lambda: len(server.connections) == 3)
    now[0] = 9.0
    partial.socket.sendall(b"\x01")
    time.sleep(2 * SWEEP_PERIOD)
    assert len(server.connections) == 3
    now[0] = 11.0
    for one in (silent, partial):
        with pytest.raises(ConnectionError):
            one.receive()
    now[0] = 1e6  # a client may be idle as long as nobody needs its place
    time.sleep(2 * SWEEP_PERIOD)
    assert client.get("ping") is True


def test_a_client_too_many_is_told_so(serve, connect, caplog):
    now = [0.0]
    server = serve(limits=ConnectionLimits(max_clients=2, grace=60.0), clock=lambda: now[0])
    first, second = connect(server), connect(server)
    assert [one.get("ping") for one in (first, second)] == [True, True]
    third = connect(server)
    error, result = third.ask("ping")
    assert (
        error == "this server is full: 2 others are connected, which is the limit; try again later"
    )
    assert result is None
    with pytest.raises(ConnectionError):
        third.get("ping")
    assert sum("connection refused" in record.message for record in caplog.records) == 1
    # The one that is idle longest makes room, unless it waits for an answer
    ready(first)
    first.send("moveByVelocity", 0.0, 0.0, -1.0, 1e6, *FREE, "")
    first.send("ping")
    first.receive()
    now[0] = 50.0
    second.get("ping")
    now[0] = 120.0
    fourth = connect(server)
    assert fourth.get("ping") is True
    with pytest.raises(ConnectionError):
        second.receive()
    assert first.get("ping") is True


def test_a_client_that_reads_nothing_is_dropped(serve, connect, caplog):
    server = serve(limits=ConnectionLimits(max_unread=1000))
    client = connect(server)

    states = msgpack.packb([0, 1, "getMultirotorState", [""]]) * 100

    def send():
        while True:
            client.socket.sendall(states)

    with pytest.raises(ConnectionError):
        send()
    assert connect(server).get("ping") is True
    assert "bytes unread" in caplog.text


def test_a_client_that_stops_reading_is_dropped_in_time(serve, connect, large_pictures, caplog):
    now = [0.0]
    server = serve(limits=ConnectionLimits(max_stall=30.0), clock=lambda: now[0])
    client = connect(server)
    client.send("simGetImages", [ONE] * 32, "")
    until(lambda: [one.unread > 0 for one in server.connections.all()] == [True])

    def later():
        now[0] += 31.0
        time.sleep(SWEEP_PERIOD)
        return len(server.connections) == 0

    until(later)
    assert "read nothing for 30 s" in caplog.text


@pytest.mark.parametrize("goes", [False, True])
def test_a_client_that_reads_nothing_holds_up_neither_the_end_nor_memory(
    goes, serve, connect, large_pictures
):
    """It may have closed its own side, too."""
    server = serve(limits=ConnectionLimits(linger=0.1, max_stall=1.0 if goes else 1e6))
    client = connect(server)
    client.send("simGetImages", [ONE] * 32, "")
    until(lambda: [one.unread > 0 for one in server.connections.all()] == [True])
    if goes:
        client.socket.shutdown(socket.SHUT_WR)
        until(lambda: len(server.connections) == 0)
    server.stop()
    until(lambda: not server.is_running())


def test_a_client_that_closes_its_own_side_reads_its_answers(serve, connect, large_pictures):
    client = connect(serve())
    client.send("simGetImages", [ONE] * 32, "")
    client.socket.shutdown(socket.SHUT_WR)
    assert client.receive()[2] == [bytes(10**6)] * 32


def test_a_port_in_use_is_told(serve):
    server = serve()
    world = AirsimWorld(seed=0)
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
    world = AirsimWorld(seed=0)
    with pytest.raises(ImportError, match=r"bulletuav\[airsim\]|\[airsim\]"):
        AirsimServer(world)
    world.close()


def test_the_command_serves_for_a_time(capsys):
    main(["serve", "airsim", "--drones", "2", "--port", "0", "--seconds", "0.05", "--paused"])
    assert "Drone1, Drone2 at 127.0.0.1:" in capsys.readouterr().out


def recorded(folder):
    """Rows of the only recording below a folder, and its folder."""
    (path,) = folder.glob("*/airsim_rec.txt")
    header, *rows = [line.split("\t") for line in path.read_text().splitlines()]
    return [dict(zip(header, row, strict=True)) for row in rows], path


def test_clients_record_states_and_images(serve, connect, tmp_path):
    cameras = [
        {"CameraName": "0", "ImageType": 1, "PixelsAsFloat": True},
        {"CameraName": "3", "ImageType": 0, "Compress": False},
    ]
    capture = {
        "CaptureSettings": [{"ImageType": kind, "Width": 32, "Height": 16} for kind in (0, 1)]
    }
    settings = parse_settings(
        {
            "Recording": {"RecordInterval": 0.1, "Cameras": cameras},
            "CameraDefaults": capture,
            "Vehicles": {"../Ann": {}},
        }
    )
    server = serve(speed=1.0, settings=settings, recordings=tmp_path / "new")
    client = connect(server)
    assert client.get("isRecording") is False
    ready(client)
    client.get("startRecording")
    assert client.get("isRecording") is True
    until(lambda: recorded(tmp_path / "new")[0])
    assert client.get("takeoff", 20.0, "") is True
    client.get("stopRecording")
    assert client.get("isRecording") is False
    rows, path = recorded(tmp_path / "new")
    assert {row["VehicleName"] for row in rows} == {"../Ann"}
    times = [int(row["TimeStamp"]) for row in rows]
    assert min(b - a for a, b in itertools.pairwise(times)) >= 100
    assert float(rows[-1]["POS_Z"]) < -2 < -0.5 < float(rows[0]["POS_Z"])
    depth, scene = rows[-1]["ImageFile"].split(";")
    assert depth.startswith("img_0_0_.._Ann_0_1_")
    content = (path.parent / "images" / depth).read_bytes()
    assert content.startswith(b"Pf\n32 16\n-1\n")
    assert len(content) == len(b"Pf\n32 16\n-1\n") + 4 * 32 * 16
    with Image.open(path.parent / "images" / scene) as image:
        assert image.size == (32, 16)


def test_a_recording_can_start_with_the_server_and_skip_still_rows(serve, tmp_path):
    settings = parse_settings(
        {
            "Recording": {
                "Enabled": True,
                "RecordOnMove": True,
                "RecordInterval": 0.01,
                "Cameras": [],
            }
        }
    )
    server = serve(settings=settings, recordings=tmp_path)
    until(lambda: server.world.time > 1.0)
    server.stop()
    until(lambda: not server.is_running())
    rows, _ = recorded(tmp_path)
    assert 1 <= len(rows) < 20
    assert rows[0]["ImageFile"] == ""


def make_recorder(folder, values):
    """A recorder of a world with these settings, and the pictures that it needs."""
    small = {"CaptureSettings": [{"ImageType": 0, "Width": 16, "Height": 16}]}
    world = AirsimWorld(settings=parse_settings({"CameraDefaults": small, **values}))
    return AirsimRecorder(world, folder), Pictures(world)


class Pictures:
    """Queue that answers without rendering, and calls a function before each answer."""

    def __init__(self, world):
        self.world, self.before, self.num_calls = world, lambda: None, 0

    async def draw(self, call):
        self.num_calls += 1
        self.before()
        image = {"width": 1, "height": 1, "pixels_as_float": False, "compress": True}
        image |= {"image_data_uint8": b"%d" % self.num_calls, "time_stamp": 7}
        return [msgpack.packb([image])]


def test_a_default_name_of_a_recorded_vehicle_stays_valid_when_another_is_added(tmp_path):
    values = {"Vehicles": {"Ann": {}}, "Recording": {"Cameras": [{"VehicleName": "SimpleFlight"}]}}
    recorder, pictures = make_recorder(tmp_path, values)
    recorder.start()
    pictures.world.add_vehicle("Bob", VehicleSettings())
    asyncio.run(recorder.record(pictures))
    recorder.stop()
    rows, _ = recorded(tmp_path)
    assert [(row["VehicleName"], row["ImageFile"] != "") for row in rows] == [
        ("Ann", True),
        ("Bob", False),
    ]
    pictures.world.close()


def test_images_of_similar_names_have_files_of_their_own(tmp_path):
    camera = {"CaptureSettings": [{"ImageType": 0, "Width": 16, "Height": 16}]}
    values = {
        "Vehicles": {"a b": {"Cameras": {"c d": camera, "c_d": camera}}, "a_b": {"X": 2}},
        "Recording": {
            "Cameras": [
                {"VehicleName": "a b", "CameraName": "c d"},
                {"VehicleName": "a b", "CameraName": "c_d"},
                {"VehicleName": "a_b"},
            ]
        },
    }
    recorder, pictures = make_recorder(tmp_path, values)
    recorder.start()
    asyncio.run(recorder.record(pictures))
    recorder.stop()
    rows, path = recorded(tmp_path)
    names = [name for row in rows for name in row["ImageFile"].split(";")]
    contents = [(path.parent / "images" / name).read_bytes() for name in names]
    assert contents == [b"1", b"2", b"3"]
    pictures.world.close()


def test_rows_of_a_stopped_recording_are_not_written_into_the_next(tmp_path):
    cameras = [{"CameraName": "0"}, {"CameraName": "1"}]
    recorder, pictures = make_recorder(tmp_path, {"Recording": {"Cameras": cameras}})

    def restart():
        recorder.stop()
        recorder.start()
        pictures.before = lambda: None

    recorder.start()
    pictures.before = restart
    asyncio.run(recorder.record(pictures))
    assert recorder.is_recording
    recorder.stop()
    first, second = sorted(tmp_path.iterdir(), key=lambda path: (len(path.name), path.name))
    assert [len((one / "airsim_rec.txt").read_text().splitlines()) for one in (first, second)] == [
        1,
        1,
    ]
    assert list((second / "images").iterdir()) == []
    pictures.world.close()


def test_recordings_are_limited_in_number(tmp_path, monkeypatch):
    monkeypatch.setattr(airsim_recording, "MAX_RECORDINGS", 2)
    recorder, pictures = make_recorder(tmp_path, {})
    for _ in range(2):
        recorder.start()
        recorder.stop()
    with pytest.raises(ValueError, match="started 2 recordings, which is the maximum: restart"):
        recorder.start()
    assert not recorder.is_recording
    assert len(list(tmp_path.iterdir())) == 2
    pictures.world.close()


def test_a_camera_that_cannot_be_recorded_any_more_ends_the_recording(serve, tmp_path, caplog):
    settings = parse_settings({"Recording": {"Cameras": [{"CameraName": "1"}]}})
    server = serve(settings=settings, recordings=tmp_path)
    server.world.vehicle("")[1].cameras.pop("front_right")
    with caplog.at_level(logging.WARNING):
        server._recorder.start()
        until(lambda: not server._recorder.is_recording)
    assert sum("the recording ended: " in record.getMessage() for record in caplog.records) == 1


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        ({"Enabled": True}, "start the server with --recordings FOLDER"),
        ({"Cameras": [{"CameraName": "9"}]}, "unknown camera '9'"),
        ({"Cameras": [{"VehicleName": "Ann"}]}, "unknown vehicle 'Ann'"),
        ({"Cameras": [{"ImageType": 7}]}, "image_type is 7"),
    ],
)
def test_a_recording_that_cannot_be_is_an_error(recording, message):
    world = AirsimWorld(settings=parse_settings({"Recording": recording}))
    with pytest.raises(ValueError, match=message):
        AirsimServer(world, port=0)
    world.close()
