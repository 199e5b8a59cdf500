"""Losses and delay of links, and start positions, of servers of datagrams."""

import dataclasses
import itertools
import math
import socket
import time

import numpy as np
import pytest
from bridges.mavlink_client import common

from bulletuav.bridges.crazyflie import CrazyflieServer
from bulletuav.bridges.links import MAX_WAITING, LinkQuality, LossyLink
from bulletuav.bridges.mavlink import MavlinkServer
from bulletuav.bridges.radio_loss import RADIO, STATION, RadioLoss
from bulletuav.bridges.sockets import MAX_UNDELIVERED
from bulletuav.cli import main
from bulletuav.geometry.solids import Solids
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


CALM = dataclasses.replace(RADIO, fading="none")
"""The default radio without fading"""
WALL = Solids(np.array([[(-50.0, 40, 0), (50, 41, 30)]]))
"""A building to the north of the station"""


@pytest.fixture
def radio_loss(make_vehicles):
    """Makes the losses of a vehicle that is at a place."""

    def make(place, config=CALM, station=STATION, seed=0, **options):
        fleet = make_vehicles(1, **options)
        fleet.airspace.place(0, place)
        return RadioLoss(fleet.airspace, station, config, seed)

    return make


def test_losses_are_those_of_the_radio_model(radio_loss):
    """Friis, thermal noise and non-coherent FSK, in decibels and by hand."""
    power, noise = 20.0, -174.0 + 10 * math.log10(2e6) + 18.0
    for distance in (1150.0, 1300.0, 1450.0):
        loss = radio_loss((0.0, distance, 1.5))
        path = 20 * math.log10(4 * math.pi * distance * 2.4e9 / 299792458)
        snr = 10 ** ((power - path - noise) / 10)
        error = 1 - (1 - math.exp(-snr / 2) / 2) ** (8 * 40)
        assert 0.01 < error < 0.99
        assert loss.probability(0, 40) == pytest.approx(error, abs=0.02)
        # More bits, more losses
        assert loss.probability(0, 80) > loss.probability(0, 40) > loss.probability(0, 20)


def test_losses_grow_with_the_distance_and_behind_buildings(make_vehicles):
    fleet = make_vehicles(1, layout=WALL)
    loss = RadioLoss(fleet.airspace, config=CALM)
    chances = []
    for distance in (10, 30, 60, 80, 90, 100, 120, 1000):
        fleet.airspace.place(0, (0.0, distance, 5.0))
        fleet.airspace.step()
        chances.append(loss.probability(0, 40))
    assert chances == sorted(chances)
    assert chances[1] < 1e-9
    assert chances[-1] > 0.99
    # Above the roof is a line of sight
    fleet.airspace.place(0, (0.0, 250.0, 300.0))
    fleet.airspace.step()
    assert loss.probability(0, 40) < 1e-9
    # The station may stand elsewhere
    other = RadioLoss(fleet.airspace, (0.0, 240.0, 2.0), CALM)
    fleet.airspace.place(0, (0.0, 250.0, 5.0))
    fleet.airspace.step()
    assert other.probability(0, 40) < 1e-9
    assert loss.probability(0, 40) > 0.9


def test_fading_is_drawn_in_each_step_and_repeats(radio_loss):
    def draw(seed):
        loss = radio_loss((0.0, 1000.0, 1.5), RADIO, seed=seed)
        drawn = []
        for _ in range(20):
            loss._airspace.step()
            drawn.append(loss.probability(0, 40))
            assert loss.probability(0, 40) == drawn[-1]
        return drawn

    first = draw(1)
    assert len(set(first)) == 20
    assert draw(1) == first
    assert draw(2) != first


def test_datagrams_are_lost_by_the_radio_model(radio_loss):
    near = carry(LinkQuality(radio_loss((0.0, 10.0, 1.5)), seed=0), 300)
    assert len(near) == 300
    loss = radio_loss((0.0, 1700.0, 1.5))
    arrived = carry(LinkQuality(loss, seed=0), 3000)
    # Most numbers have three or four digits
    assert loss.probability(0, 3) - 0.03 < 1 - len(arrived) / 3000 < loss.probability(0, 4) + 0.03


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0, math.nan)])
def test_stations_that_cannot_be_are_refused(place, make_vehicles):
    with pytest.raises(ValueError, match="station"):
        RadioLoss(make_vehicles(1).airspace, place)


def test_servers_lose_datagrams_by_the_radio_model(capsys):
    words = ["--loss", "radio", "--station", "0", "0", "2", "--port", "0", "--seconds", "0.1"]
    for kind in ("crazyflie", "mavlink"):
        main(["serve", kind, *words, "--seed", "0"])
        assert "127.0.0.1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mavlink", "--station", "1", "2", "3"], "--station has no effect without --loss radio"),
        (["mavlink", "--loss", "wire"], "wire: a number, or radio, is needed"),
        (["airsim", "--loss", "radio"], "--loss has no effect on airsim: omit it"),
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
