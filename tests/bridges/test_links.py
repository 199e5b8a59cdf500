"""Losses and delay of links, and start positions, of servers of datagrams."""

import itertools
import socket
import time

import pytest
from bridges.mavlink_client import common

from bulletuav.bridges.crazyflie import CrazyflieServer
from bulletuav.bridges.links import MAX_WAITING, LinkQuality, LossyLink
from bulletuav.bridges.mavlink import MavlinkServer
from bulletuav.bridges.sockets import MAX_UNDELIVERED
from bulletuav.cli import main
from bulletuav.serving.connections import ConnectionLimits

PERIOD = 0.01
HERE = ("127.0.0.1", 1)


def carry(quality, count, stream=(0, 0)):
    """Send a number in each step; returns the steps at which each arrived."""
    link, arrived = LossyLink(quality, PERIOD, stream), {}
    for step in range(count):
        link.put((b"%d" % step, HERE), step)
        while (received := link.get(step)) is not None:
            arrived[int(received[0])] = step
    return arrived


def test_datagrams_arrive_after_the_delay_in_order():
    arrived = carry(LinkQuality(delay=0.045), 50)
    assert arrived == {k: k + 5 for k in range(45)}
    assert carry(LinkQuality(), 5) == {k: k for k in range(5)}


def test_losses_have_their_probability_and_repeat():
    quality = LinkQuality(loss=0.1, seed=3)
    arrived = carry(quality, 20_000)
    assert len(arrived) / 20_000 == pytest.approx(0.9, abs=0.01)
    assert carry(quality, 20_000) == arrived
    assert carry(quality, 20_000, (1, 0)) != arrived  # another drone
    assert carry(LinkQuality(loss=0.1, seed=4), 20_000) != arrived
    assert carry(LinkQuality(loss=1.0, seed=4), 100) == {}


def test_few_datagrams_wait():
    link = LossyLink(LinkQuality(delay=1.0), PERIOD, (0, 0))
    for _ in range(MAX_WAITING + 5):
        link.put((b"", HERE), 0)
    assert sum(link.get(200) is not None for _ in range(2 * MAX_WAITING)) == MAX_WAITING


@pytest.mark.parametrize(
    ("quality", "said"),
    [
        (LinkQuality(loss=1.5), "loss is 1.5"),
        (LinkQuality(loss=-0.1), "loss is -0.1"),
        (LinkQuality(delay=11.0), "delay is 11"),
        (LinkQuality(delay=float("nan")), "delay is nan"),
    ],
)
def test_qualities_that_cannot_be_are_refused(quality, said, make_fleet, make_vehicles):
    with pytest.raises(ValueError, match=said):
        CrazyflieServer(make_fleet(1), port=0, quality=quality)
    with pytest.raises(ValueError, match=said):
        MavlinkServer(make_vehicles(1), port=0, speed=10, client_port=None, quality=quality)


def test_positional_limits_of_earlier_programs_are_limits(make_fleet, make_vehicles):
    limits = ConnectionLimits(max_clients=2)
    CrazyflieServer(make_fleet(1), "127.0.0.1", 0, 1.0, limits, time.monotonic).close()
    server = MavlinkServer(make_vehicles(1), "127.0.0.1", 0, 1.0, None, limits, time.monotonic)
    server.close()
    assert server.connections[0].limits.max_clients == 2


def test_answers_come_after_both_delays(make_fleet, keep_running):
    server = keep_running(
        CrazyflieServer(make_fleet(1), port=0, quality=LinkQuality(delay=0.1, seed=0))
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(("127.0.0.1", server.ports[0]))
        # The first steps may compile
        client.settimeout(120.0)
        start = time.monotonic()
        client.send(b"\xff")
        assert client.recv(100) == b"\xff"
        assert time.monotonic() - start > 0.18


def test_half_of_the_telemetry_is_lost(make_vehicles, keep_running):
    quality = LinkQuality(loss=0.5, seed=0)
    server = keep_running(
        MavlinkServer(make_vehicles(1), port=0, speed=10, client_port=None, quality=quality)
    )
    packer = common.MAVLink(None, 255, 190)
    heartbeat = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(("127.0.0.1", server.ports[0]))
        client.settimeout(120.0)
        for _ in range(10):
            client.send(heartbeat)
        numbers = []
        while len(numbers) < 400:
            numbers += [one.get_seq() for one in packer.parse_buffer(client.recv(2000)) or ()]
    sent = sum((b - a) % 256 for a, b in itertools.pairwise(numbers))
    assert 0.3 < len(numbers) / sent < 0.7


def test_a_late_server_reads_on_after_a_lost_datagram(make_vehicles):
    quality = LinkQuality(loss=0.5, seed=0)
    # No step of 10 ms takes 10 ns, so that the server is late and reads once per step
    server = MavlinkServer(make_vehicles(1), port=0, speed=1e6, client_port=None, quality=quality)
    heartbeat = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        for _ in range(30):
            client.sendto(
                heartbeat.pack(common.MAVLink(None, 255, 190)), ("127.0.0.1", server.ports[0])
            )
        server.run(0.01)
    server.close()
    assert 8 <= server.received <= 22


def test_a_late_server_without_deliveries_flies_on(make_vehicles):
    quality = LinkQuality(loss=1.0, seed=0)
    server = MavlinkServer(make_vehicles(1), port=0, speed=1e6, client_port=None, quality=quality)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        for _ in range(MAX_UNDELIVERED + 1):
            client.sendto(b"", ("127.0.0.1", server.ports[0]))
        server.run(0.01)
        assert server._sockets[0].recv(10) == b""  # the last one waits
        with pytest.raises(BlockingIOError):
            server._sockets[0].recv(10)
    server.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["airsim", "--loss", "0.1"], "--loss has no effect on airsim: omit it"),
        (["hil", "--delay", "0.1"], "--delay has no effect on hil: omit it"),
        (["crazyflie", "--pictures", "."], "--pictures has no effect on crazyflie: omit it"),
        (["airsim", "--positions", "1", "2"], "--positions has no effect on airsim: omit it"),
        (["crazyflie", "--lidar"], "--lidar has no effect on crazyflie: omit it"),
        (["hil", "--paused"], "--paused has no effect on hil: omit it"),
        (["crazyflie", "--client-port", "1"], "--client-port has no effect on crazyflie: omit it"),
        (["crazyflie", "--positions", "1"], "--positions has 1 numbers"),
        (["mavlink", "--positions", "1", "2", "--drones", "1"], "leave one out"),
    ],
)
def test_options_without_effect_are_errors(words, said, capsys):
    with pytest.raises(SystemExit):
        main(["serve", *words, "--port", "0", "--seconds", "0.1"])
    assert said in capsys.readouterr().err


def test_positions_are_those_of_the_command(capsys):
    main(["serve", "crazyflie", "--positions", "-0.5", "0.5", "1", "2", "--port", "0"]
         + ["--seconds", "0.1"])  # fmt: skip
    assert "2 drones at" in capsys.readouterr().out
