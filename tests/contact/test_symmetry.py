"""Frictionless elastic impacts are the same in a mirror, turned round, and backwards in time."""

import numpy as np
import pytest
from contact.rig import Rig, random_attitudes, random_directions
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

PAIRS = 6
SUBSTEPS = 60
CLOSE = 5e-3
"""Relative to speed, spin and size.

Wanted is 1e-9. Most impacts are within 1e-6, but the direction of a gap of .1 mm between two rims
is known to about 1e-3 at worst.
"""
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def rig():
    """Twice as many worlds as pairs: the second half is transformed."""
    with Rig(
        ["cf2x", "racer"], worlds=2 * PAIRS, hz=1000, gravity=0.0, friction=0.0, restitution=1.0
    ) as one:
        yield one


def scatter(rig, seed):
    """Draw oblique pairs that meet within 40 substeps, for both halves."""
    rng = np.random.default_rng(seed)
    swarm = rig.swarm
    reach = sum(one.collision_radius for one in rig.airframes)
    way = random_directions(rng, PAIRS)
    speed = rng.uniform(1.0, 3.0, (PAIRS, 1))
    gap = reach + rng.uniform(0, 0.02, (PAIRS, 1)) * speed
    aside = 0.3 * reach * np.cross(way, random_directions(rng, PAIRS))
    for half in (slice(0, PAIRS), slice(PAIRS, None)):
        swarm.position[half, 0] = (0, 0, 50)
        swarm.position[half, 1] = swarm.position[half, 0] + gap * way + aside
        swarm.velocity[half, 0] = 0.5 * speed * way
        swarm.velocity[half, 1] = -0.5 * speed * way
        swarm.rates[half] = 0
    swarm.quaternion[:PAIRS] = random_attitudes(rng, PAIRS, 2)
    swarm.quaternion[PAIRS:] = swarm.quaternion[:PAIRS]
    return swarm


def fly(rig):
    rig.place()
    for _ in range(SUBSTEPS):
        rig.fly()


def matrices(quaternion):
    shape = quaternion.shape[:-1]
    return Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix().reshape(*shape, 3, 3)


@settings(max_examples=12)
@given(seed=SEEDS)
def test_a_mirror_changes_nothing(rig, seed):
    swarm = scatter(rig, seed)
    mirror = np.array([-1.0, 1.0, 1.0])
    for array in (swarm.position, swarm.velocity):
        array[PAIRS:] *= mirror
    swarm.quaternion[PAIRS:] *= (1, -1, -1, 1)
    fly(rig)
    for array in (swarm.position, swarm.velocity):
        np.testing.assert_allclose(array[PAIRS:] * mirror, array[:PAIRS], rtol=0, atol=CLOSE)
    np.testing.assert_allclose(
        swarm.rates[PAIRS:] * -mirror, swarm.rates[:PAIRS], rtol=CLOSE, atol=50 * CLOSE
    )


@settings(max_examples=12)
@given(seed=SEEDS)
def test_a_turn_changes_nothing(rig, seed):
    swarm = scatter(rig, seed)
    turn = Rotation.random(rng=np.random.default_rng(seed))
    middle = np.array([0.0, 0.0, 50.0])
    swarm.position[PAIRS:] = (swarm.position[PAIRS:] - middle) @ turn.as_matrix().T + middle
    swarm.velocity[PAIRS:] = swarm.velocity[PAIRS:] @ turn.as_matrix().T
    turned = turn * Rotation.from_quat(swarm.quaternion[PAIRS:].reshape(-1, 4))
    swarm.quaternion[PAIRS:] = turned.as_quat().reshape(PAIRS, 2, 4)
    fly(rig)
    back = (swarm.position[PAIRS:] - middle) @ turn.as_matrix() + middle
    np.testing.assert_allclose(back, swarm.position[:PAIRS], rtol=0, atol=CLOSE)
    back = swarm.velocity[PAIRS:] @ turn.as_matrix()
    np.testing.assert_allclose(back, swarm.velocity[:PAIRS], rtol=0, atol=CLOSE)
    np.testing.assert_allclose(
        swarm.rates[PAIRS:], swarm.rates[:PAIRS], rtol=CLOSE, atol=50 * CLOSE
    )


@settings(max_examples=12)
@given(seed=SEEDS)
def test_time_may_run_backwards(rig, seed):
    swarm = scatter(rig, seed)
    start = swarm.copy()
    fly(rig)
    assert np.abs(swarm.velocity - start.velocity).max() > 0.1
    swarm.velocity[:] *= -1
    swarm.rates[:] *= -1
    fly(rig)
    np.testing.assert_allclose(swarm.position, start.position, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(swarm.velocity, -start.velocity, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(swarm.rates, 0, atol=50 * CLOSE)
    turned = matrices(swarm.quaternion) - matrices(start.quaternion)
    np.testing.assert_allclose(turned, 0, atol=CLOSE)
