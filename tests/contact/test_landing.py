"""Drones that land come to rest on the surface, and take off again."""

import numpy as np
import pytest
from bench import MULTIROTORS
from contact.landings import PLACES, land
from contact.rig import Rig, random_attitudes


@pytest.mark.parametrize("airframe", MULTIROTORS)
def test_flat_landings_stop_at_once(airframe):
    landing = land(airframe, flat=True, worlds=8, hz=120, flown=1.6)
    assert not landing.missed()
    assert landing.upright.all()
    assert (landing.rest < 0.05).all()


@pytest.mark.parametrize("hz", [60, 240, 1000])
def test_random_landings_come_to_rest(hz):
    landing = land("cf2x", worlds=20, hz=hz, drops=(0.05, 2.0), flown=2.7)
    assert not landing.missed()
    assert 0 < landing.upright.sum() < 20


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_landings_with_sideways_speed_come_to_rest(place, dynamics):
    landing = land(
        "hummingbird",
        place=place,
        dynamics=dynamics,
        worlds=12,
        hz=120,
        sideways=2.0,
        drops=(0.05, 2.0),
        flown=2.7,
    )
    assert not landing.missed()


@pytest.mark.parametrize("hz", [60, 240])
def test_without_friction_level_ground_pushes_no_drone_aside(hz):
    with Rig(["cf2x"], worlds=20, hz=hz, friction=0.0) as rig:
        rng = np.random.default_rng(0)
        rig.swarm.position[:, 0, 2] = 0.1
        rig.swarm.quaternion[:] = random_attitudes(rng, 20, 1)
        rig.swarm.rates[:] = 5 * rng.normal(size=(20, 1, 3))
        assert len(set(rig.place().fly_for(0.5).world)) == 20
        assert not rig.swarm.velocity[..., :2].any()


def test_a_drone_that_falls_beside_the_roof_reaches_the_ground():
    with Rig(hz=240, boxes=[((1, -5, 0), (9, 5, 20))]) as rig:
        rig.swarm.position[0, 0] = (0.9, 0.0, 20.5)
        contacts = rig.place().fly_for(3.0)
        assert -1 in contacts.other
        assert rig.lowest()[0] == pytest.approx(5e-5, abs=5e-5)
        assert np.linalg.norm(rig.swarm.velocity) < 0.01


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_drone_that_rests_safely_on_a_face_sleeps_soon(dynamics):
    """On its edge a drone does not: there it may still fall over."""
    with Rig(dynamics=dynamics, worlds=2, hz=240, substeps=24) as rig:
        half = rig.airframes[0].shape.half
        rig.swarm.position[:, 0, 2] = half[2] + 5e-5, half[0] + 5e-5
        rig.swarm.quaternion[1, 0] = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
        rig.place().fly()
        assert rig.dynamics.contact.asleep[:, 0].tolist() == [True, False]
