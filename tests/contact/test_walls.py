"""Nothing passes through anything, and every touch is told."""

import numpy as np
import pytest
from contact.shots import TARGETS, Range
from contact.trains import push

from bulletuav.dynamics import DYNAMICS, find_dynamics
from bulletuav.vehicle.airframes import available_airframes


@pytest.fixture(scope="module")
def ranges():
    """Ranges by airframe, dynamics and rate; each is built once."""
    made = {}

    def get(airframe, dynamics="rigid_body", hz=240, shots=60):
        key = airframe, dynamics, hz
        if key not in made:
            made[key] = Range(airframe, dynamics=dynamics, hz=hz, shots=shots)
        return made[key]

    yield get
    for one in made.values():
        one.rig.close()


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("hz", [60, 240, 1000])
def test_no_shot_passes(ranges, name, hz):
    shots = ranges("cf2x", hz=hz).shoot(name)
    assert not shots.missed()
    assert shots.hits.sum() > 30


@pytest.mark.parametrize("name", TARGETS)
def test_nothing_passes_through_drones_that_spin(ranges, name):
    assert not ranges("racer").shoot(name, spin=30.0).missed()


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_moving_obstacles_are_met_by_all_dynamics(ranges, dynamics, name):
    missed = set(ranges("hummingbird", dynamics).shoot(name, drift=10.0).missed())
    if find_dynamics(dynamics).contacts[0] == "stop":
        # An obstacle that moves goes on through a drone that stopped
        missed -= {"beyond", "depth"}
    assert not missed


@pytest.mark.parametrize("airframe", available_airframes())
def test_no_airframe_passes_the_thinnest_wall(ranges, airframe):
    shots = ranges(airframe, hz=120).shoot("wall of 2 mm")
    assert not shots.missed()
    assert np.any(shots.misses)


def test_trains_push_nobody_through_a_wall():
    train = push("cf2x", hz=240, worlds=6, drones=5)
    assert not train.missed()


def test_energy_does_not_grow_after_a_hit_in_bullet(ranges):
    """Errors of the attitude by Bullet's step are no torques that act on after the hit."""
    shots = ranges("iris", dynamics="bullet", hz=60).shoot("corner", spin=30.0)
    assert shots.hits.sum() > 10
    assert shots.gained.max() < 1e-6
