"""Sleeping drones support others; drones at the impact limit lose the speed that held them."""

import numpy as np
import pytest
from contact.heaps import drop_heap
from contact.test_memory import ARMS, remembered, taken, touching
from scipy.spatial.transform import Rotation

from bulletuav.contact.clamping import remove_forces
from bulletuav.contact.motion import MAX_IMPACTS, MOTION
from bulletuav.contact.resting_support import SUPPORT, can_carry_load
from bulletuav.contact.warm_start import store_impulses
from bulletuav.vehicle.parameters import PARAMETERS

GRAVITY = (0.0, 0.0, -9.81)
STILL = (0.0, 0.0, 0.0)
DT = 0.01


def resting(span=0.0, mass=0.5, friction=0.4):
    """What a drone rests on, its parameters, and no load."""
    support = np.zeros(1, dtype=SUPPORT).view(np.recarray)[0]
    support.normal[:] = (0, 0, 1)
    support.height, support.span, support.friction = 0.02, span, friction
    row = np.zeros(1, dtype=PARAMETERS).view(np.recarray)[0]
    row.mass, row.friction = mass, friction
    return support, row, np.zeros((2, 3))


@pytest.mark.parametrize("laid", [0.0, 2.0, 20.0])
def test_a_drone_on_several_supports_carries_what_friction_holds(laid):
    support, row, load = resting()
    weight = row.mass * 9.81
    load[0, 2] = -laid * DT
    for share, expected in ((0.999, True), (1.001, False)):
        load[0, 0] = share * row.friction * (weight + laid) * DT
        assert can_carry_load(support, row, GRAVITY, STILL, load, DT) is expected
    load[0] = 0.0, 0.0, 1.01 * weight * DT
    assert not can_carry_load(support, row, GRAVITY, STILL, load, DT)


def test_a_drone_on_a_face_carries_half_of_what_tips_it():
    support, row, load = resting(span=0.05)
    weight = row.mass * 9.81
    # Off its centre by x, a load p tips it where p x exceeds the share of (weight + p) span
    laid = 3.0
    edge = 0.5 * support.span * (weight + laid) / laid
    load[0, 2] = -laid * DT
    for share, expected in ((0.999, True), (1.001, False)):
        load[1, 1] = share * edge * laid * DT
        assert can_carry_load(support, row, GRAVITY, STILL, load, DT) is expected


def motion_of(velocity):
    """A drone in the middle of a substep, which gravity pulls."""
    motion = np.zeros(1, dtype=MOTION).view(np.recarray)[0]
    motion.velocity[:] = velocity
    motion.velocity_change[:] = np.multiply(GRAVITY, DT)
    return motion


def test_what_held_a_drone_up_does_not_send_it_up():
    motion = motion_of((0.3, 0.0, 0.25 * 9.81 * DT))
    remove_forces(motion, 0.75)
    np.testing.assert_allclose(motion.velocity, (0.3, 0.0, 0.0), atol=1e-15)
    assert not motion.velocity_change.any()


@pytest.mark.parametrize("time", [0.0, 0.4, 1.0])
def test_forces_only_slow_clamped_drones(time):
    rng = np.random.default_rng(0)
    for velocity in rng.normal(size=(100, 3)) * 0.1:
        motion = motion_of(velocity)
        remove_forces(motion, time)
        assert np.linalg.norm(motion.velocity) <= np.linalg.norm(velocity)
        np.testing.assert_array_equal(motion.velocity[:2], velocity[:2])
        if velocity[2] <= 0.0:
            assert motion.velocity[2] == velocity[2]


def test_clamped_drones_keep_their_cached_impulses():
    memory = remembered()
    points, pairs, motions = touching(ARMS, Rotation.identity())
    motions.impacts[:] = MAX_IMPACTS
    assert not taken(memory, points, pairs, motions).any()
    island = np.array([0])
    store_impulses.py_func(memory, motions, 0, island, 1, points, pairs, 2, 0.5)
    motions.impacts[:] = 0
    assert taken(memory, points, pairs, motions).any(axis=1).all()


def test_a_large_heap_falls_asleep_from_below():
    heap = drop_heap(40, seconds=4.0, seed=1)
    assert heap.speed.max() == heap.spin.max() == 0.0
    assert heap.depth < 5e-4
