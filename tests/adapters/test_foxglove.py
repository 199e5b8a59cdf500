"""Live topics for Foxglove: a client of another library reads what is advertised, and messages."""

import contextlib
import json
import re
import shlex
import socket
import struct
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from waiting import PATIENCE, until

import bulletuav
from bulletuav.cli import main
from bulletuav.serving.refusals import MAX_LINES

websockets = pytest.importorskip("websockets.sync.client", reason="needs websockets")
foxglove = pytest.importorskip(
    "bulletuav.adapters.foxglove", reason="needs the extra foxglove", exc_type=ImportError
)
closed = pytest.importorskip("websockets.exceptions").ConnectionClosed

FREE = "127.0.0.1:0"
SHORT = {"num_drones": 2, "dynamics": "point_mass", "horizon": 20, "observation": ("goal", "imu")}
MESSAGE = 1
"""First byte of data: 4 bytes of the subscription and 8 of nanoseconds follow"""


class Client:
    """Foxglove, as far as a server knows."""

    def __init__(self, address):
        self.stack = contextlib.ExitStack()
        self.socket = self.stack.enter_context(
            websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_queue=None)
        )
        self.sessions, self.channels, self.store = [], {}, get_typestore(Stores.EMPTY)

    def next(self):
        """Next message as (topic, ns, message); what the server tells about itself is kept."""
        while True:
            told = self.socket.recv(timeout=PATIENCE)
            if isinstance(told, bytes):
                kind, channel, stamp = struct.unpack_from("<BIQ", told)
                assert kind == MESSAGE
                topic, name = self.channels[channel]
                return topic, stamp, self.store.deserialize_cdr(told[13:], name)
            self._note(json.loads(told))

    def _note(self, told):
        if told["op"] == "serverInfo":
            self.sessions.append(told["sessionId"])
            return
        assert told["op"] == "advertise"
        for one in told["channels"]:
            assert (one["encoding"], one["schemaEncoding"]) == ("cdr", "ros2msg")
            known = get_types_from_msg(one["schema"], one["schemaName"])
            self.store.register({k: v for k, v in known.items() if k not in self.store.types})
            self.channels[one["id"]] = one["topic"], one["schemaName"]

    def advertised(self, topic):
        """Identifier of a topic, once it is advertised."""
        while True:
            for channel, (name, _) in self.channels.items():
                if name == topic:
                    return channel
            self._note(json.loads(self.socket.recv(timeout=PATIENCE)))

    def subscribe(self, *topics):
        # A subscription has the channel's number here.
        wanted = [{"id": k, "channelId": k} for k in map(self.advertised, topics)]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@pytest.fixture
def env(turns):
    env = bulletuav.Aviary("crossing", render_mode="foxglove", render_address=FREE, **SHORT)
    yield env
    env.close()


def actions(env, row):
    return np.random.default_rng(row).uniform(-1, 1, env.given.shape)


def test_a_client_reads_what_is_flown_to_the_bit(env, turns):
    server = env.viewer.topics
    assert not server.is_watched
    env.reset(seeds=3)
    env.step(actions(env, 0))
    assert turns == []
    client = Client(server.address)
    client.subscribe("/tf")
    assert server.wait(PATIENCE)
    until(lambda: server.is_watched)

    env.reset(seeds=3)
    env.step(actions(env, 0))
    stamps = [client.next()[1] for _ in range(2)]
    assert stamps == [0, 100_000_000]
    assert len(set(client.sessions)) == 2  # what was shown of the flight before is forgotten
    topics = ("odometry", "velocity", "goal", "imu", "reward", "info/reward/progress")
    client.subscribe(*(f"/drone_1/{name}" for name in topics))
    until(lambda: server._channels["/drone_1/info/reward/progress"].has_sinks())
    step = env.step(actions(env, 1))
    told = {}
    for _ in range(len(topics) + 1):
        name, stamp, message = client.next()
        assert stamp == 200_000_000
        told[name] = message
    swarm = env.swarm
    place = told["/drone_1/odometry"].pose.pose.position
    assert [place.x, place.y, place.z] == swarm.position[0, 1].tolist()
    velocity = told["/drone_1/velocity"].vector
    assert [velocity.x, velocity.y, velocity.z] == swarm.velocity[0, 1].tolist()
    assert told["/drone_1/reward"].data == step.rewards[0, 1]
    assert [one.child_frame_id for one in told["/tf"].transforms] == [
        "drone_0/base_link",
        "drone_1/base_link",
    ]
    assert turns == [0.1, 0.1]


def test_who_leaves_stops_nothing_and_nothing_is_kept_then(env, turns):
    server = env.viewer.topics
    clients = [Client(server.address) for _ in range(2)]
    for client in clients:
        client.subscribe("/time")
    until(lambda: server._channels["/time"].has_sinks())
    env.reset(seeds=0)
    env.step(actions(env, 0))
    polite, rude = clients
    polite.stack.close()
    rude.socket.socket.shutdown(socket.SHUT_RDWR)
    until(lambda: not server.is_watched)
    for row in range(3):
        env.step(actions(env, row))
    assert env.viewer._recorder is None
    assert len(turns) == 1


def test_a_late_client_sees_the_flight_from_then_on(env):
    env.reset(seeds=0)
    env.step(actions(env, 0))
    client = Client(env.viewer.topics.address)
    client.subscribe("/time")
    until(lambda: env.viewer.topics.is_watched)
    for row in range(1, 4):
        env.step(actions(env, row))
    assert [client.next()[2].data for _ in range(2)] == [0.3, 0.4]
    env.close()
    with pytest.raises(closed):
        client.next()


def refused(words, capsys):
    """The one line of an error."""
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_what_cannot_be_is_one_line(capsys, tmp_path, monkeypatch):
    words = ["fly", "crossing", "--dynamics", "point_mass", "--out", str(tmp_path), "--foxglove"]
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        line = refused([*words, f"127.0.0.1:{port}"], capsys)
        assert f"Foxglove at 127.0.0.1, port {port}: Address already in use; if" in line
    assert "nowhere.invalid" in refused([*words, "nowhere.invalid:0"], capsys)
    assert "host:port is needed" in refused([*words, "here"], capsys)
    assert "give one of them" in refused([*words, FREE, "--live", FREE], capsys)
    stages = [{"num_drones": 2}, {"num_drones": 3}]
    with pytest.raises(ValueError, match="'foxglove', and there are 2 stages"):
        bulletuav.curriculum_env("crossing", stages, render_mode="foxglove")
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.foxglove")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    line = refused([*words, FREE], capsys)
    assert "needs the extra 'foxglove': pip install" in line


def read_and_leave(client, stamps, count):
    """Read the stamps of messages in a thread, which then closes the connection."""

    def read():
        with contextlib.suppress(closed):
            stamps.extend(client.next()[1] for _ in range(count))
        client.stack.close()

    thread = threading.Thread(target=read)
    thread.start()
    return thread


def test_closing_sends_viewers_all_that_is_queued(monkeypatch):
    """Foxglove's library itself drops it."""
    monkeypatch.setattr(foxglove, "CLOSE_TIMEOUT", PATIENCE)
    server, stamps = foxglove.FoxgloveServer("127.0.0.1", 0), []
    client = Client(server.address)
    client.subscribe("/time")
    until(lambda: server.is_watched)
    kind = "std_msgs/msg/Float64"
    data = bytes(server._store.serialize_cdr(server._store.types[kind](data=1.0), kind))
    for k in range(500):
        server._channels["/time"].log(data, log_time=k)
    thread = read_and_leave(client, stamps, 500)
    server.close()
    thread.join()
    assert stamps == list(range(500))
    server.close()


def test_a_viewer_that_stays_holds_up_the_end_for_a_time_alone(monkeypatch):
    monkeypatch.setattr(foxglove, "CLOSE_TIMEOUT", 0.1)
    server = foxglove.FoxgloveServer("127.0.0.1", 0)
    client = Client(server.address)
    client.subscribe("/time")
    until(lambda: server.is_watched)
    server.close()
    with pytest.raises(closed):
        client.next()


def test_flying_for_foxglove_waits_for_a_viewer(turns, tmp_path, monkeypatch, capsys):
    came, stamps = [], []

    def come(self, seconds=None):
        client = Client(self.address)
        client.subscribe("/time")
        until(lambda: self.is_watched)
        came.append(read_and_leave(client, stamps, 6))

    monkeypatch.setattr(foxglove, "CLOSE_TIMEOUT", PATIENCE)
    monkeypatch.setattr("bulletuav.adapters.foxglove.FoxgloveServer.wait", come)
    page = Path(__file__).parents[2] / "docs" / "howto" / "export.md"
    (line,) = re.findall(r"bulletuav (fly .*--foxglove.*)", page.read_text())
    line = line.replace("--foxglove", f"--foxglove {FREE}")
    monkeypatch.chdir(tmp_path)
    short = ["--drones", "2", "--dynamics", "point_mass", "--horizon", "5", "--animation", "none"]
    main([*shlex.split(line, comments=True), *short])
    assert "connect Foxglove to ws://127.0.0.1:" in capsys.readouterr().out
    came[0].join()
    assert stamps == [k * 100_000_000 for k in range(6)]


def test_a_flood_of_odd_messages_does_not_fill_the_log(caplog):
    server = foxglove.FoxgloveServer("127.0.0.1", 0)
    client = Client(server.address)
    client.advertised("/tf")
    wrong = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 77}]}
    for _ in range(5 * MAX_LINES):
        client.socket.send(json.dumps(wrong))
    client.subscribe("/time")
    until(lambda: server.is_watched)
    assert 0 < sum("77" in record.getMessage() for record in caplog.records) <= MAX_LINES
    client.stack.close()
    server.close()


def test_viewers_can_do_nothing_but_subscribe():
    """What they may ask for besides is not offered, and changes nothing."""
    from bulletuav.adapters.foxglove import FoxgloveServer

    server = FoxgloveServer("127.0.0.1", 0)
    address = server.address
    with websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as viewer:
        told = json.loads(viewer.recv(timeout=PATIENCE))
        assert told["op"] == "serverInfo"
        assert told["capabilities"] == []
        channel = {"id": 1, "topic": "/cmd", "encoding": "json", "schemaName": ""}
        for message in (
            {"op": "advertise", "channels": [channel]},
            {"op": "setParameters", "parameters": [{"name": "speed", "value": 1}]},
            {"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1},
        ):
            viewer.send(json.dumps(message))
        viewer.send(b"\x01\x01\x00\x00\x00{}")
        with contextlib.suppress(TimeoutError, closed):
            while True:
                answer = viewer.recv(timeout=0.3)
                assert b"root:" not in (answer if isinstance(answer, bytes) else answer.encode())
    assert not server.is_watched
    server.close()
