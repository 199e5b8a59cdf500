"""Contacts do not depend on other worlds, the order of drones, the past, or the extension."""

import numpy as np
import pytest
from contact.rig import Rig, random_attitudes

from bulletuav.engine import engine as engine_module
from bulletuav.engine.c_extension import Extension
from bulletuav.geometry.obstacle import Obstacle

DRONES = 6
SIZES = [Obstacle("box", (0.4, 0.4, 0.4)), Obstacle("cylinder", (0.1, 1.0))]


def build(dynamics="rigid_body", worlds=3, **options):
    return Rig(
        ["cf2x"] * DRONES, dynamics=dynamics, worlds=worlds, substeps=12, obstacles=SIZES, **options
    )


def start(rig, world, own, order=None):
    """Write the start of world `own` into `world`: a heap about to fall on two obstacles."""
    rng = np.random.default_rng(own)
    order = np.arange(DRONES) if order is None else order
    place = rng.uniform(-0.15, 0.15, (DRONES, 3))
    place[:, 2] = 0.7 + 0.14 * np.arange(DRONES)
    rig.swarm.position[world] = place[order]
    rig.swarm.quaternion[world] = random_attitudes(rng, DRONES)[order]
    rig.swarm.velocity[world] = rng.normal(size=(DRONES, 3))[order]
    rig.swarm.rates[world] = rng.normal(size=(DRONES, 3))[order]
    rig.obstacle[world] = (0.05, 0.0, 0.2), (-0.1, 0.1, 0.5)
    rig.drift[world] = (0.0, 0.0, 0.0), (0.2, 0.0, 0.1)


def trace(rig, decisions=16):
    """Fly; return all states and contacts of each world as arrays."""
    rig.place()
    recorded = [rig.fly() for _ in range(decisions)]
    state = np.concatenate(rig.swarm, axis=-1)
    assert sum(len(one.world) for one in recorded) > DRONES
    return state.copy(), recorded


def rows(recorded, world):
    """Return all columns but the first of one world's contacts."""
    return [
        np.concatenate([one[k][one.world == world] for one in recorded])
        for k in range(1, len(recorded[0]))
    ]


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_other_worlds_do_not_matter(dynamics):
    with build(dynamics) as rig:
        for world in range(3):
            start(rig, world, world)
        together, recorded = trace(rig)
    with build(dynamics, worlds=1, first_world=1) as rig:
        start(rig, 0, 1)
        alone, recorded_alone = trace(rig)
    np.testing.assert_array_equal(alone[0], together[1])
    for one, two in zip(rows(recorded_alone, 0), rows(recorded, 1), strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_order_of_drones_does_not_matter():
    order = np.random.default_rng(1).permutation(DRONES)
    with build(worlds=2) as rig:
        start(rig, 0, 0)
        start(rig, 1, 0, order)
        state, _ = trace(rig)
    np.testing.assert_array_equal(state[0][order], state[1])


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_resets_leave_no_trace(dynamics):
    states = []
    with build(dynamics) as rig:
        for own in (7, 3):
            for world in range(3):
                start(rig, world, own + world)
            states.append(trace(rig)[0])
        for world in range(3):
            start(rig, world, 7 + world)
        again, _ = trace(rig)
    np.testing.assert_array_equal(states[0], again)
    assert (states[0] != states[1]).any()


def test_the_extension_does_not_matter(monkeypatch):
    states = []
    for missing in (False, True):
        if missing:
            without = Extension(None, "", "for comparison")
            monkeypatch.setattr(engine_module, "EXTENSION", without)
        with build("bullet", worlds=1) as rig:
            assert (not rig.engine.ports) == missing
            start(rig, 0, 4)
            states.append(trace(rig)[0])
    np.testing.assert_array_equal(*states)


@pytest.mark.parametrize("seed", [2, 19, 23])
def test_the_order_of_drones_does_not_matter_to_heaps_that_fall_asleep(seed):
    """Nor to budgets, of which the first takes its share first, nor to the order of waking."""
    count = 12
    rng = np.random.default_rng(seed)
    order = rng.permutation(count)
    place = rng.uniform(-0.06, 0.06, (count, 3))
    place[:, 2] = 0.1 + 0.14 * np.arange(count)
    attitude = random_attitudes(rng, count)
    with Rig(["cf2x"] * count, worlds=2, substeps=1) as rig:
        rig.swarm.position[:] = place, place[order]
        rig.swarm.quaternion[:] = attitude, attitude[order]
        rig.place()
        dozed = False
        for _ in range(480):
            rig.fly()
            asleep = rig.dynamics.contact.asleep[0]
            dozed = dozed or (asleep.any() and not asleep.all())
        state = np.concatenate(rig.swarm, axis=-1)
    assert dozed
    np.testing.assert_array_equal(state[0][order], state[1])
