import pytest
from bridges.crtp_client import Drone

from bulletuav.bridges.crazyflie_fleet import Fleet


@pytest.fixture
def make_fleet():
    """Makes fleets, and closes them."""
    made = []

    def make(*args, **options):
        made.append(Fleet(*args, **{"seed": 0, **options}))
        return made[-1]

    yield make
    for fleet in made:
        fleet.close()


@pytest.fixture
def drone(make_fleet):
    return Drone(make_fleet(1))


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
