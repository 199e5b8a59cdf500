"""PX4's protocol for simulators: a small autopilot of this test's own hovers in lockstep.

No PX4 runs here. The autopilot sends what PX4's SimulatorMavlink sends, in its order: a heartbeat,
a request for HIL_STATE_QUATERNION, and HIL_ACTUATOR_CONTROLS for each HIL_SENSOR.
"""

import contextlib
import math
import socket
import threading
import time

import numpy as np
import pytest
from bridges.mavlink_client import common, random_frame
from waiting import PATIENCE, until

from bulletuav import load_airframe
from bulletuav.bridges import hil
from bulletuav.bridges.hil import HilServer
from bulletuav.bridges.hil_bodies import HilBodies
from bulletuav.bridges.mavlink_protocol import MavlinkCodec, split_frames
from bulletuav.cli import main

IRIS = load_airframe("iris")
HOVER = float(np.max(IRIS.hover_speed())) / IRIS.max_rotor_speed
G, STEP = 9.80665, 0.004
HIL_CONTROLS = common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS
ARMED_AND_LOCKSTEP = (128, 1)


class Autopilot:
    """Knows what sensors tell it, and hovers at a height above where it began."""

    def __init__(self, height=2.0):
        self.height = height
        self.roll = self.pitch = self.yaw = 0.0
        self.place, self.velocity, self.begin = np.zeros(3), np.zeros(3), None

    def feel(self, told):
        """Go on by one measurement of the inertial unit; angles are small."""
        self.rates = np.array((told.xgyro, told.ygyro, told.zgyro))
        x, y, z = told.xacc, told.yacc, told.zacc
        force = (x + self.pitch * z, y - self.roll * z, z - self.pitch * x + self.roll * y)
        acceleration = np.array(force) + (0, 0, G)
        self.roll, self.pitch, self.yaw = (self.roll, self.pitch, self.yaw) + self.rates * STEP
        self.place += self.velocity * STEP
        self.velocity += acceleration * STEP

    def locate(self, told):
        """Correct place and velocity by a measurement of the satellite receiver."""
        scale = (1.1132e-2, 1.1132e-2 * math.cos(math.radians(told.lat / 1e7)), -1e-3)
        place = np.array((told.lat, told.lon, told.alt)) * scale
        self.begin = place if self.begin is None else self.begin
        self.place += 0.3 * (place - self.begin - self.place)
        velocity = np.array((told.vn, told.ve, told.vd)) / 100
        self.velocity += 0.3 * (velocity - self.velocity)

    def controls(self):
        """Shares of four motors: front right, rear left, front left, rear right."""
        north, east = -np.clip(self.place[:2] * 0.8 + self.velocity[:2] * 1.4, -2, 2)
        p, q, r = self.rates
        roll = 0.24 * (east / G - self.roll) - 0.05 * p
        pitch = 0.24 * (-north / G - self.pitch) - 0.05 * q
        yaw = -0.1 * self.yaw - 0.2 * r
        rise = 0.06 * np.clip(self.place[2] + self.height, -1, 1) + 0.08 * self.velocity[2]
        four = (
            HOVER
            + rise
            + np.array(
                (-roll + pitch + yaw, roll - pitch + yaw, roll + pitch - yaw, -roll - pitch - yaw)
            )
        )
        return [*np.clip(four, 0.0, 1.0).tolist(), *[0.0] * 12]


class Connection:
    """An autopilot's end of the wire, as a client of TCP."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
        self.packer, self.rest = common.MAVLink(None, 1, 1), b""
        self.wire = MavlinkCodec(2)
        self.send("heartbeat", 2, 12, 0, 0, 0, 3)
        self.send("command_long", 1, 1, 511, 0, 115, 5000, 0, 0, 0, 0, 0)

    def send(self, name, *fields):
        message = getattr(common, f"MAVLink_{name}_message")(*fields)
        self.socket.sendall(bytes(message.pack(self.packer)))

    def receive(self):
        data = self.socket.recv(4096)
        if not data:
            raise ConnectionError
        frames, self.rest = split_frames(self.rest + data)
        return self.wire.read(frames)

    def answer(self, told, controls, mode=ARMED_AND_LOCKSTEP):
        self.send("hil_actuator_controls", told.time_usec, controls, *mode)


def fly(port, height=2.0, most=math.inf):
    """Fly until the simulator goes, or for a number of measurements."""
    autopilot, connection, heard = Autopilot(height), Connection(port), []
    sensors = 0
    try:
        while sensors < most:
            for told in connection.receive():
                heard.append(told)
                if told.get_type() == "HIL_SENSOR":
                    sensors += 1
                    autopilot.feel(told)
                    connection.answer(told, autopilot.controls())
                elif told.get_type() == "HIL_GPS":
                    autopilot.locate(told)
    except OSError:
        pass
    connection.socket.close()
    return heard


@pytest.fixture
def serve():
    """Makes servers, and closes them."""
    made = []

    def serve(drones=1, speed=100.0, clock=time.monotonic, **options):
        bodies = HilBodies(drones, **options)
        made.append(HilServer(bodies, port=0, speed=speed, patience=5.0, clock=clock))
        return made[-1]

    yield serve
    for server in made:
        server.close()
        server.bodies.close()


@pytest.fixture
def start():
    """Starts functions in threads that end with their servers."""
    threads = []

    def start(function, *arguments):
        threads.append(threading.Thread(target=function, args=arguments))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join(20.0)
        assert not thread.is_alive()


def test_it_hovers_in_lockstep_twice_to_the_last_bit(start, serve):
    hashes = []
    for delay, duration in ((0.0, 12.0), (0.3, 4.0)):  # the autopilot takes its time to start

        def late(delay, port):
            time.sleep(delay)
            fly(port)

        server = serve(seed=5)
        start(late, delay, server.ports[0])
        server.run(4.0)
        hashes.append(server.bodies.airspace.state_hash())
        assert server.bodies.tick == 1000
        if duration > 4.0:
            server.run(duration - 4.0)
            position = server.bodies.airspace.swarm.position[0]
            np.testing.assert_allclose(position, (0, 0, 2 + IRIS.standing_height), atol=0.25)
            assert server.bodies.tick == 3000
        server.close()
    assert hashes[0] == hashes[1]


def test_another_seed_gives_another_noise(start, serve):
    hashes = set()
    for seed in (1, 2):
        server = serve(seed=seed)
        start(fly, server.ports[0])
        server.run(1.0)
        hashes.add(server.bodies.airspace.state_hash())
        server.close()
    assert len(hashes) == 2


def test_sensors_of_a_body_at_rest_tell_gravity_the_field_and_the_air(serve):
    """The field of Zurich by hand from the IGRF: 21.4 uT north, 1.2 east, 43.6 down; within 2 %."""
    bodies = serve(noise=0.0).bodies
    found = [told for _ in range(25) for told in bodies.measure()[0]]
    assert [one.name for one in found].count("hil_gps") == 1
    sensors = [one.fields for one in found if one.name == "hil_sensor"]
    assert [one[0] for one in sensors] == [4000 * (k + 1) for k in range(25)]
    assert [one[-1] for one in sensors[:5]] == [0x3F] * 4 + [0x1FFF]
    _, *felt, _ = sensors[-1]
    np.testing.assert_allclose(felt[:3], (0, 0, -9.80665), atol=1e-9)
    np.testing.assert_allclose(felt[3:6], 0, atol=1e-12)
    np.testing.assert_allclose(felt[6:9], (0.214, 0.012, 0.436), atol=0.01)
    # The standard atmosphere at 488 m: 955.98 hPa, 11.83 C.
    assert felt[9] == pytest.approx(955.98, abs=0.1)
    assert felt[12] == pytest.approx(11.83, abs=0.01)
    gps = found[-1].fields
    assert gps[:5] == (100_000, 3, 473977420, 85455940, 488055)


def test_the_truth_is_told_if_it_is_asked_for(start, serve):
    server, heard = serve(), []
    start(lambda: heard.extend(fly(server.ports[0])))
    server.run(3.0)
    server.close()
    time.sleep(0.2)
    truths = [one for one in heard if one.get_type() == "HIL_STATE_QUATERNION"]
    np.testing.assert_allclose(truths[-1].attitude_quaternion, (1, 0, 0, 0), atol=0.1)
    assert truths[-1].alt > 488_500


def test_motors_are_in_the_order_of_px4_and_stand_still_disarmed(serve):
    bodies = serve().bodies
    controls = [0.1, 0.2, 0.3, 0.4, *[math.nan] * 12]
    message = common.MAVLink_hil_actuator_controls_message(0, controls, 128, 1)
    bodies.command(0, message)
    speeds = np.array(bodies._commands[0].values) / IRIS.max_rotor_speed
    found = {(x > 0, y > 0): share for (x, y, _), share in zip(IRIS.rotors, speeds, strict=True)}
    wanted = {(True, False): 0.1, (False, True): 0.2, (True, True): 0.3, (False, False): 0.4}
    assert found == pytest.approx(wanted)
    message.controls = [math.nan, 7.0, -1.0, 1.0, *[0.0] * 12]
    bodies.command(0, message)
    assert sorted(bodies._commands[0].values) == [0, 0, IRIS.max_rotor_speed, IRIS.max_rotor_speed]
    message.mode = 0
    bodies.command(0, message)
    assert bodies._commands == [None]


def test_two_fly_at_once_and_one_that_goes_falls_alone(start, serve):
    server = serve(2)
    start(fly, server.ports[0])
    start(fly, server.ports[1], 3.0, 1500)
    server.run(5.0)
    assert server.bodies.airspace.swarm.position[1, 2] > 1.5
    server.run(5.0)
    first, second = server.bodies.airspace.swarm.position[:, 2]
    assert first == pytest.approx(2.0, abs=0.3)
    assert second < 0.2


def test_one_that_goes_or_is_silent_or_sends_no_mavlink_is_let_go(start, serve, monkeypatch):
    monkeypatch.setattr(hil, "ANSWER_TIMEOUT", 0.2)
    server = serve()
    port = server.ports[0]

    def many_things():
        fly(port, most=100)  # then it goes
        babbling = Connection(port)
        babbling.socket.sendall(b"no MAVLink at all" * 10)
        with contextlib.suppress(ConnectionError):
            while True:
                babbling.receive()
        babbling.socket.close()
        silent = Connection(port)
        (told, *_) = silent.receive()
        silent.answer(told, [0.0] * 16)
        with contextlib.suppress(ConnectionError):
            while True:
                silent.receive()
        silent.socket.close()
        fly(port)

    start(many_things)

    def is_up():
        server.run(0.1)
        return server.bodies.airspace.swarm.position[0, 2] >= 1.5

    until(is_up)


@pytest.fixture
def step():
    """Turns a server in this thread, until something has happened."""

    def step(server, happens):
        def turn():
            if happens():
                return True
            server._patience = 0.0
            server._step_lockstep()
            return False

        until(turn, every=0.0)

    return step


def ended(one):
    """Return True if the server has closed a connection."""
    one.setblocking(False)
    try:
        while one.recv(4096):
            pass
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    return True


def flies_after(server, step, port=None):
    """Connect an autopilot, and return True once it is the body's."""
    connection = Connection(port or server.ports[0])
    step(server, lambda: server._links[0] is not None)
    is_api_controlled = server._links[0].peer.endswith(f":{connection.socket.getsockname()[1]}")
    return is_api_controlled, connection


def test_a_page_or_a_silent_connection_takes_no_body(serve, step):
    """More silent ones than there are places for; then an autopilot comes."""
    server = serve()
    controls = common.MAVLink_hil_actuator_controls_message(10**9, [1.0] * 16, 128, 1)
    body = bytes(controls.pack(common.MAVLink(None, 1, 1)))
    page = socket.create_connection(("127.0.0.1", server.ports[0]))
    page.sendall(b"POST / HTTP/1.1\r\nOrigin: https://evil.example\r\n\r\n" + body)
    step(server, lambda: ended(page))
    assert server.bodies._commands == [None]
    silent = [socket.create_connection(("127.0.0.1", server.ports[0])) for _ in range(20)]
    step(server, lambda: sum(map(ended, silent)) >= 16)
    is_api_controlled, connection = flies_after(server, step)
    assert is_api_controlled
    for one in (page, *silent, connection.socket):
        one.close()


def test_an_autopilot_that_reads_but_never_answers_is_dropped_in_time(serve, step, caplog):
    """Heartbeats alone do not keep it; the next one gets the body."""
    now = [0.0]
    server = serve(clock=lambda: now[0])
    is_api_controlled, mute = flies_after(server, step)
    assert is_api_controlled
    step(server, lambda: server._links[0].first_sent_time is not None)
    now[0] = hil.START_TIMEOUT - 1
    mute.send("heartbeat", 2, 12, 0, 0, 0, 3)
    for _ in range(5):
        server._step_lockstep()
    assert server._links[0] is not None
    now[0] = hil.START_TIMEOUT + 1
    step(server, lambda: ended(mute.socket))
    assert "has not answered any measurement" in caplog.text
    is_api_controlled, other = flies_after(server, step)
    assert is_api_controlled
    for one in (mute, other):
        one.socket.close()


def test_an_autopilot_waits_for_the_others_as_long_as_it_takes(serve, step):
    """It is sent nothing meanwhile, so that it cannot answer."""
    now = [0.0]
    server = serve(2, clock=lambda: now[0])
    is_api_controlled, connection = flies_after(server, step)
    now[0] = 1e4
    for _ in range(3):
        server._step_lockstep()
    assert is_api_controlled
    assert not ended(connection.socket)
    # Unless another one comes for its body, and it has been silent for a minute
    other = Connection(server.ports[0])
    step(server, lambda: ended(connection.socket))
    for one in (connection, other):
        one.socket.close()


def test_a_second_autopilot_of_a_body_is_told_why_it_is_refused(start, serve):
    server, heard = serve(), []

    def second():
        connection = Connection(server.ports[0])
        with contextlib.suppress(ConnectionError):
            while True:
                heard.extend(connection.receive())
        connection.socket.close()

    start(fly, server.ports[0])
    server.run(0.1)
    start(second)

    def is_heard():
        server.run(0.05)
        return bool(heard)

    until(is_heard)
    assert [one.get_type() for one in heard] == ["STATUSTEXT"]
    assert heard[0].text == "body 0 is flown by another autopilot"
    before = server.bodies.airspace.time
    server.run(0.1)
    assert server.bodies.airspace.time > before
    server.close()


def test_an_autopilot_that_does_not_answer_yet_is_sent_more_and_nothing_flies(start, serve):
    server = serve()
    server._patience = 0.004
    stamps = []

    def slow():
        connection = Connection(server.ports[0])
        while len(stamps) < 20:
            stamps.extend(
                one.time_usec for one in connection.receive() if one.get_type() == "HIL_SENSOR"
            )
        assert server.bodies.airspace.time == 0.0
        connection.socket.close()
        fly(server.ports[0])

    start(slow)
    server.run(0.5)
    assert stamps[:3] == [4000, 8000, 12000]
    assert server.bodies.airspace.time == pytest.approx(0.5)


def test_ports_in_use_and_airframes_of_other_shapes_are_refused(serve):
    server = serve()
    with pytest.raises(OSError, match=r"\(TCP\): .*another server running"):
        HilServer(server.bodies, port=server.ports[0])
    with pytest.raises(ValueError, match="firefly has 6 rotors"):
        HilBodies(1, "firefly")
    with pytest.raises(ValueError, match="hummingbird has 4 rotors at corners"):
        HilBodies(1, "hummingbird")
    with pytest.raises(ValueError, match="decision_hz is fixed at 250"):
        HilBodies(1, decision_hz=100)


def bombard(server, count, seed):
    """Send random messages, with right checksums, beside the answers of an autopilot that flies."""
    rng, sent = np.random.default_rng(seed), []

    def attack():
        connection = Connection(server.ports[0])
        while len(sent) < count:
            for told in connection.receive():
                if told.get_type() == "HIL_SENSOR":
                    packer = connection.packer
                    frames = [random_frame(rng, packer, more=(HIL_CONTROLS,)) for _ in range(20)]
                    connection.socket.sendall(b"".join(frames))
                    sent.extend(map(len, frames))
                    connection.answer(told, [HOVER] * 16)
        connection.socket.close()

    thread = threading.Thread(target=attack)
    thread.start()
    while thread.is_alive():
        server.run(seconds=0.02)
    assert len(sent) >= count  # it was never let go
    assert np.isfinite(server.bodies.airspace.swarm.position).all()


def test_messages_of_random_content_do_no_harm(serve):
    bombard(serve(), 2000, 0)


@pytest.mark.slow
def test_many_messages_of_random_content_do_no_harm(serve):
    import psutil

    server, process = serve(), psutil.Process()
    bombard(server, 10_000, 1)
    before = process.memory_info().rss
    bombard(server, 100_000, 2)
    assert process.memory_info().rss - before < 4e6


def test_streams_are_cut_into_frames_wherever_they_break():
    wire = MavlinkCodec(1)
    frame = bytes(common.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3).pack(common.MAVLink(None)))
    stream = frame * 3
    for cut in range(len(stream) + 1):
        whole, rest = split_frames(stream[:cut])
        assert whole + rest == stream[:cut]
        assert len(rest) < len(frame)
        assert len(wire.read(whole)) == cut // len(frame)
    assert wire.malformed == 0


def test_the_command_waits_for_an_autopilot_and_flies(capsys, monkeypatch):
    made = []
    monkeypatch.setattr(hil.HilServer, "run", lambda self, seconds: made.append((self, seconds)))
    main(["serve", "hil", "--port", "0", "--drones", "2", "--seconds", "0.5"])
    ((server, seconds),) = made
    assert (len(server.ports), seconds) == (2, 0.5)
    first, second = (f"127.0.0.1:{port}" for port in server.ports)
    assert f"wait for autopilots at {first}, {second}\n" in capsys.readouterr().out
