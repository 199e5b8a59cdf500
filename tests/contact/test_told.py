"""Recorded contacts: bodies, position, velocity, impulse and normal."""

import numpy as np
import pytest
from contact.rig import Rig

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Contacts

TIGHT = {"rtol": 1e-9, "atol": 1e-12}


def first_touch(rig: Rig, most: int = 400) -> Contacts:
    """Fly until a contact is recorded."""
    for _ in range(most):
        contacts = rig.fly()
        if len(contacts.world):
            return contacts
    raise AssertionError("nothing was touched")


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("surface", [GROUND, CITY, FIRST_OBSTACLE - 1])
def test_a_flat_landing_is_recorded(surface, restitution):
    obstacles = [Obstacle("sphere", (0.2,)), Obstacle("box", (4, 4, 1), restitution=restitution)]
    top = {GROUND: 0.0, CITY: 3.0, FIRST_OBSTACLE - 1: 7.0}[surface]
    boxes = [((-2, -2, 0), (2, 2, 3))] if surface == CITY else []
    with Rig(
        gravity=0.0, obstacles=obstacles, boxes=boxes, friction=0.0, restitution=restitution
    ) as rig:
        if surface == FIRST_OBSTACLE - 1:
            rig.obstacle[0, 1] = (0, 0, 6.5)
        mass, half = rig.airframes[0].mass, rig.airframes[0].shape.half
        rig.swarm.position[0, 0] = (0.1, -0.2, top + half[2] + 0.02)
        rig.swarm.velocity[0, 0] = (1.0, 0.5, -4.0)
        recorded = first_touch(rig.place())
        # Without rebound the last of the approach, half a touch, takes a few substeps more
        whole = recorded.impulse.sum() + rig.fly_for(0.1).impulse.sum()
    assert recorded.other.tolist() == [surface]
    np.testing.assert_allclose(recorded.normal, [[0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(recorded.velocity, [[1.0, 0.5, -4.0]], **TIGHT)
    np.testing.assert_allclose(whole, 4.0 * (1 + restitution) * mass, rtol=1e-6)
    assert recorded.point[0, 2] == pytest.approx(top, abs=1e-4)
    # Below the drone, which drifts less than a centimetre until the touch
    assert np.linalg.norm(recorded.point[0, :2] - (0.1, -0.2)) < half[0] + 0.01


def test_a_contact_is_recorded_for_both_drones():
    with Rig(["cf2x", "iris"], gravity=0.0, friction=0.0) as rig:
        rig.swarm.position[0] = (0, 0, 10), (0.5, 0, 10.01)
        rig.swarm.velocity[0, 0] = (3, 0, 0)
        before = rig.momentum()[0].copy()
        recorded = first_touch(rig.place())
        change = rig.momentum()[0] - before
    assert recorded.drone.tolist() == [0, 1]
    assert recorded.other.tolist() == [1, 0]
    assert recorded.impulse[0] == recorded.impulse[1] > 0
    np.testing.assert_array_equal(recorded.normal[0], -recorded.normal[1])
    np.testing.assert_array_equal(recorded.velocity[0], -recorded.velocity[1])
    np.testing.assert_array_equal(recorded.point[0], recorded.point[1])
    np.testing.assert_allclose(recorded.velocity[0], (3, 0, 0), **TIGHT)
    np.testing.assert_allclose(recorded.normal[0], (-1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(recorded.point[0, 0], 0.5 - 0.384, atol=2e-4)
    # Newton: without friction all momentum goes along the normal
    np.testing.assert_allclose(change, recorded.impulse[:, None] * recorded.normal, atol=1e-9)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
@pytest.mark.parametrize("hz", [60, 240])
def test_impulses_are_changes_of_momentum(dynamics, hz):
    worlds = 16
    rng = np.random.default_rng(3)
    with Rig(dynamics=dynamics, worlds=worlds, hz=hz, substeps=6) as rig:
        rig.swarm.position[:, 0, 2] = 0.5
        rig.swarm.velocity[:, 0] = rng.normal(size=(worlds, 3)) * (1.0, 1.0, 2.0)
        rig.swarm.rates[:, 0] = rng.normal(size=(worlds, 3))
        before = rig.momentum()[:, 0, 2].copy()
        recorded = rig.place().fly_for(1.5)
        # On level ground all impulses along normals are upright
        np.testing.assert_allclose(recorded.normal[:, 2], 1.0, atol=1e-12)
        fallen = rig.airframes[0].mass * rig.gravity * rig.time
        gained = rig.momentum()[:, 0, 2] - before + fallen
        np.testing.assert_allclose(recorded.impulse, gained, rtol=1e-5)


def test_flight_nearby_records_no_contact():
    with Rig(gravity=0.0, worlds=2) as rig:
        half = rig.airframes[0].shape.half[2]
        rig.swarm.position[:, 0, 2] = half + np.array([0.9e-4, 1.1e-4])
        rig.swarm.velocity[:, 0, 0] = 5.0
        recorded = rig.place().fly_for(0.1)
    assert 1 not in recorded.world


def test_overlaps_of_moved_drones_are_found():
    with Rig(["cf2x", "cf2x"]) as rig:
        rig.swarm.position[0] = (0, 0, 5), (0.1, 0, 5)
        rig.place()
        recorded = rig.dynamics.overlaps(rig.swarm, rig.alive, rig.alive)
    assert recorded.drone.tolist() == [0, 1]
    assert recorded.other.tolist() == [1, 0]
    assert not recorded.impulse.any()
