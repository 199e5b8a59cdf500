import threading

import pytest
from bridges.airsim_world_client import Client
from bridges.crtp_client import Drone
from bridges.mavlink_client import Station

from bulletuav.bridges import airsim_pictures
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.mavlink_fleet import MavlinkFleet


@pytest.fixture
def make_fleet():
    """Makes fleets, and closes them."""
    made = []

    def make(*args, **options):
        made.append(CrazyflieFleet(*args, **{"seed": 0, **options}))
        return made[-1]

    yield make
    for fleet in made:
        fleet.close()


@pytest.fixture
def drone(make_fleet):
    return Drone(make_fleet(1))


@pytest.fixture
def make_vehicles():
    """Makes fleets of MAVLink vehicles, and closes them."""
    made = []

    def make(*args, **options):
        made.append(MavlinkFleet(*args, **{"seed": 0, **options}))
        return made[-1]

    yield make
    for fleet in made:
        fleet.close()


@pytest.fixture
def station(make_vehicles):
    """A ground station of one vehicle, which stands on the ground."""
    return Station(make_vehicles(1))


@pytest.fixture
def keep_running():
    """Runs servers of datagrams in threads, until the test ends."""
    running = []

    def keep_running(server):
        stop = threading.Event()

        def run():
            while not stop.is_set():
                server.run(0.05)

        thread = threading.Thread(target=run)
        thread.start()
        running.append((server, stop, thread))
        return server

    yield keep_running
    for server, stop, thread in running:
        stop.set()
        thread.join()
        server.close()


@pytest.fixture
def fly():
    """Flies a fleet for a time, s; returns what drones sent."""

    def fly(fleet, seconds, each=lambda: None):
        sent = []
        for _ in range(round(seconds * 100)):
            each()
            sent += fleet.step()
        return sent

    return fly


@pytest.fixture
def draw_by(monkeypatch):
    """Lets AirSim's pictures be drawn by something else than the process."""

    def replace(process):
        monkeypatch.setattr(airsim_pictures, "DrawingProcess", process)

    return replace


@pytest.fixture
def make_client():
    """Makes worlds of AirSim's vehicles with a client, and closes them."""
    made = []

    def make(*args, **options):
        made.append(Client(AirsimWorld(*args, **{"seed": 0, **options})))
        return made[-1]

    yield make
    for client in made:
        client.world.close()
