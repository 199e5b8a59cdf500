"""Frictionless elastic impacts are the same in a mirror, turned round, and backwards in time."""

import numpy as np
import pytest
from contact.rig import Rig, random_attitudes, random_directions
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

PAIRS = 6
SUBSTEPS = 60
CLOSE = 1e-9
"""Relative to speed, spin and size, of pairs that touch in one decision alone"""
REVERSED = 1e-6
"""The same backwards: free flight with spin is no more exact"""
OFTEN = 5e-3
"""The same of pairs that touch in several decisions: each touch grows the difference"""
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
        swarm.position[half, 0] = (0, 0, 1)
        swarm.position[half, 1] = swarm.position[half, 0] + gap * way + aside
        swarm.velocity[half, 0] = 0.5 * speed * way
        swarm.velocity[half, 1] = -0.5 * speed * way
        swarm.rates[half] = 0
    swarm.quaternion[:PAIRS] = random_attitudes(rng, PAIRS, 2)
    swarm.quaternion[PAIRS:] = swarm.quaternion[:PAIRS]
    return swarm


def fly(rig):
    """Fly; return in how many decisions each world had a contact."""
    rig.place()
    touched = np.zeros(2 * PAIRS, dtype=int)
    for _ in range(SUBSTEPS):
        touched += rig.fly().mask(rig.alive.shape).any(axis=1)
    return touched


def assert_same(arrays, others, touched, close, often=OFTEN):
    """Compare by worlds; spins (last of the arrays) by the speed that they give a rim."""
    for array, other, size in zip(arrays, others, (1.0, 1.0, 0.1), strict=True):
        far = size * np.abs(array - other).max(axis=(1, 2))
        assert (far <= np.where(touched > 1, often, close)).all()


def matrices(quaternion):
    shape = quaternion.shape[:-1]
    return Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix().reshape(*shape, 3, 3)


@settings(max_examples=12)
@given(seed=SEEDS)
@example(seed=38)
def test_a_mirror_changes_nothing(rig, seed):
    swarm = scatter(rig, seed)
    mirror = np.array([-1.0, 1.0, 1.0])
    for array in (swarm.position, swarm.velocity):
        array[PAIRS:] *= mirror
    swarm.quaternion[PAIRS:] *= (1, -1, -1, 1)
    touched = fly(rig)
    state = (swarm.position, swarm.velocity, swarm.rates)
    there = [
        array[PAIRS:] * sign for array, sign in zip(state, (mirror, mirror, -mirror), strict=True)
    ]
    assert_same(there, [array[:PAIRS] for array in state], touched[:PAIRS], CLOSE)


@settings(max_examples=12)
@given(seed=SEEDS)
@example(seed=38)
def test_a_turn_changes_nothing(rig, seed):
    swarm = scatter(rig, seed)
    turn = Rotation.random(rng=np.random.default_rng(seed))
    middle = np.array([0.0, 0.0, 1.0])
    swarm.position[PAIRS:] = (swarm.position[PAIRS:] - middle) @ turn.as_matrix().T + middle
    swarm.velocity[PAIRS:] = swarm.velocity[PAIRS:] @ turn.as_matrix().T
    turned = turn * Rotation.from_quat(swarm.quaternion[PAIRS:].reshape(-1, 4))
    swarm.quaternion[PAIRS:] = turned.as_quat().reshape(PAIRS, 2, 4)
    touched = fly(rig)
    back = (swarm.position[PAIRS:] - middle) @ turn.as_matrix() + middle
    there = [back, swarm.velocity[PAIRS:] @ turn.as_matrix(), swarm.rates[PAIRS:]]
    here = [array[:PAIRS] for array in (swarm.position, swarm.velocity, swarm.rates)]
    assert_same(there, here, touched[:PAIRS], CLOSE)


@settings(max_examples=12)
@given(seed=SEEDS)
def test_time_may_run_backwards(rig, seed):
    swarm = scatter(rig, seed)
    start = swarm.copy()
    touched = fly(rig)
    assert np.abs(swarm.velocity - start.velocity).max() > 0.1
    swarm.velocity[:] *= -1
    swarm.rates[:] *= -1
    touched = np.maximum(touched, fly(rig))
    there = [swarm.position, -swarm.velocity, swarm.rates]
    here = [start.position, start.velocity, start.rates]
    assert_same(there, here, touched, REVERSED, often=np.inf)
    turned = matrices(swarm.quaternion) - matrices(start.quaternion)
    once = touched <= 1
    assert np.abs(turned[once]).max() <= REVERSED
