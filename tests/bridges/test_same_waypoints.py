"""The same six waypoints by the paths of three bridges: cflib's, AirSim's and MAVLink's packets."""

import math

import numpy as np
import pytest
from bridges.airsim_world_client import FREE, Client
from bridges.crtp_client import Drone
from bridges.mavlink_client import MISSION, Station

from bulletuav.bridges.airsim_world import AirsimWorld

WAYPOINTS = [(2, 0, 1), (2, 2, 1), (0, 2, 1.5), (-2, 2, 1), (-2, 0, 1.5), (0, 0, 1)]
"""Forward, left and up of the start, m"""
SPEED, HEIGHT = 0.5, 1.0
LENGTHS = [math.dist(*pair) for pair in zip([(0, 0, HEIGHT), *WAYPOINTS], WAYPOINTS, strict=False)]


def by_cflib(make_fleet):
    """A go-to for each that takes distance over speed, as those of `PositionHlCommander`."""
    fleet = make_fleet(1)
    drone, track = Drone(fleet), []

    def fly(seconds):
        for _ in range(round(seconds * 100)):
            fleet.step()
            track.append(fleet.airspace.swarm.position[0].copy())

    drone.take_off(HEIGHT, 2.0)
    fly(3.0)
    track.clear()
    for (x, y, z), length in zip(WAYPOINTS, LENGTHS, strict=True):
        assert drone.go_to(x, y, z, 0.0, length / SPEED) == 0
        fly(length / SPEED)
    return np.array(track), len(track) / 100


def by_airsim(make_fleet):
    """A `moveToPosition` for each; the next when it has answered."""
    world = AirsimWorld(1, "cf2x", seed=0)
    client, track = Client(world), []
    step = world.step

    def noted():
        step()
        track.append(world.airspace.swarm.position[0].copy())

    world.step = noted
    client.ready()
    client.join("takeoff", 20.0, "")
    client.join("moveToZ", -HEIGHT, 1.0, 20.0, FREE[1], -1, 1, "")
    client.fly(2.0)
    track.clear()
    for x, y, z in WAYPOINTS:
        # It looks north: forward is north, left is west.
        assert client.join("moveToPosition", x, -y, -z, SPEED, 30.0, *FREE, -1, 1, "")[0]
    world.close()
    return _turned(track), len(track) / 100


def by_mavlink(make_vehicles):
    """A mission."""
    station = Station(make_vehicles(1, "cf2x"))
    speed = (2, 178, 1, SPEED, -1, 0, 0, 0, 0)
    items = [station.waypoint(x, -y, z, yaw=0.0) for x, y, z in WAYPOINTS]
    assert station.upload([speed, *items]) == 0
    station.take_off(HEIGHT)
    station.mode(MISSION)
    track = []
    while not station.pilot.route.is_over:
        station.fleet.step()
        track.append(station.fleet.airspace.swarm.position[0].copy())
        assert len(track) < 6000
    return _turned(track), len(track) / 100


def _turned(track):
    """Turn the track of who looks north to that of who looks east."""
    x, y, z = np.array(track).T
    return np.stack([y, -x, z], axis=1)


PATHS = {"cflib": by_cflib, "airsim": by_airsim, "mavlink": by_mavlink}


@pytest.fixture
def flights(make_fleet, make_vehicles):
    return {
        name: path(make_vehicles if name == "mavlink" else make_fleet)
        for name, path in PATHS.items()
    }


def test_six_waypoints_are_passed_by_each_bridge_in_the_same_time(flights):
    for name, (track, _) in flights.items():
        first = 0
        for goal in WAYPOINTS:  # in their order
            away = np.linalg.norm(track[first:] - goal, axis=1)
            assert away.min() < 0.1, (name, goal, away.min())
            first += int(np.argmax(away < 0.1))
    times = [seconds for _, seconds in flights.values()]
    assert min(times) > sum(LENGTHS) / SPEED - 0.1
    assert max(times) / min(times) < 1.1, times
