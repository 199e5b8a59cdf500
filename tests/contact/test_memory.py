"""Impulses are remembered with their drone, its point and the other, and taken up once."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav.contact.broad_phase import PAIR
from bulletuav.contact.constraint import CONTACT_POINT
from bulletuav.contact.motion import MOTION
from bulletuav.contact.warm_start import (
    MAX_CACHED_POINTS,
    make_contact_cache,
    store_impulses,
    warm_start_impulses,
)

RADII = np.array([0.1, 0.1, 0.0, 0.0])
IMPULSES = np.array([[3.0, 0.4, -0.2], [1.0, 0.0, 0.1]])


def touching(arms, turn, others=(2, 2), force=9.0):
    """Points of drone 0 with others, after a turn about z; a force acts on the drone, N s."""
    points = np.zeros(len(arms), dtype=CONTACT_POINT).view(np.recarray)
    pairs = np.zeros(len(arms), dtype=PAIR).view(np.recarray)
    motions = np.zeros(2, dtype=MOTION).view(np.recarray)
    motions.quaternion[:] = turn.as_quat()
    motions.inverse_mass[:] = 0.5
    motions.velocity_change[:] = (0.0, 0.0, 0.5 * force)
    points.normal[:] = turn.apply([0, 0, 1])
    points.tangent[:] = turn.apply([1, 0, 0]), turn.apply([0, 1, 0])
    points.arm_a[:] = turn.apply(arms)
    pairs.b[:] = others
    points.pair[:] = np.arange(len(arms))
    points.friction[:] = 0.5
    return points, pairs, motions


ARMS = [(0.09, 0.0, 0.0), (-0.09, 0.0, 0.0)]


def remembered(rest=1.0, force=9.0):
    """A memory of two points of drone 0 with shape 2."""
    points, pairs, motions = touching(ARMS, Rotation.identity(), force=force)
    points.impulse[:] = IMPULSES
    memory = make_contact_cache(1, 2)
    memory = memory._replace(rows=memory.rows.view(np.recarray))
    island = np.array([0])
    store_impulses.py_func(memory, motions, 0, island, 1, points, pairs, 2, rest)
    return memory


def taken(memory, points, pairs, motions, rest=1.0):
    """Impulses with which points begin."""
    warm_start_impulses.py_func(memory, motions, RADII, 0, points, pairs, len(points), rest)
    return points.impulse


@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_points_begin_with_what_they_had_wherever_the_drone_turned(angle):
    turn = Rotation.from_euler("z", angle)
    found = taken(remembered(), *touching(ARMS[::-1], turn))
    np.testing.assert_allclose(found, IMPULSES[::-1], atol=1e-15)


def test_impulses_go_with_the_time_that_is_left():
    found = taken(remembered(rest=0.5), *touching(ARMS, Rotation.identity()), rest=0.25)
    np.testing.assert_allclose(found, 0.5 * IMPULSES)


@pytest.mark.parametrize("rest", [1.0, 0.25])
def test_what_stopped_an_impact_is_remembered_as_far_as_forces_need_it(rest):
    """No force of 1.5 N s can press with 3: the larger impulse is halved, with its friction."""
    found = taken(remembered(rest, 1.5 / rest), *touching(ARMS, Rotation.identity()), rest=rest)
    np.testing.assert_allclose(found, [0.5 * IMPULSES[0], IMPULSES[1]])
    assert not taken(remembered(force=0.0), *touching(ARMS, Rotation.identity())).any()


def test_what_is_far_or_touches_another_begins_with_nothing():
    far = np.add(ARMS, (0.0, 0.05, 0.0))
    assert not taken(remembered(), *touching(far, Rotation.identity())).any()
    assert not taken(remembered(), *touching(ARMS, Rotation.identity(), (3, 3))).any()


def test_each_impulse_is_taken_once():
    near = np.array([ARMS[0], np.add(ARMS[0], (0.001, 0.0, 0.0))])
    found = taken(remembered(), *touching(near, Rotation.identity()))
    np.testing.assert_allclose(found, [IMPULSES[0], (0, 0, 0)])


def test_nothing_is_remembered_of_no_time_and_no_more_than_there_is_room_for():
    assert remembered(rest=0.0).number.tolist() == [[0, 0]]
    assert remembered(rest=1e-5).number.tolist() == [[0, 0]]
    assert remembered(rest=1e-3).number.tolist() == [[2, 0]]
    many = MAX_CACHED_POINTS + 3
    points, pairs, motions = touching([ARMS[0]] * many, Rotation.identity(), 2)
    memory = make_contact_cache(1, 2)
    memory = memory._replace(rows=memory.rows.view(np.recarray))
    store_impulses.py_func(memory, motions, 0, np.array([0]), 1, points, pairs, many, 1.0)
    assert memory.number[0, 0] == MAX_CACHED_POINTS


def test_without_friction_nothing_across_the_normal_is_taken_up():
    memory = remembered()
    points, pairs, motions = touching(ARMS, Rotation.from_euler("z", 0.5))
    points.friction[:] = 0.0, 0.5
    found = taken(memory, points, pairs, motions)
    np.testing.assert_allclose(found[0], (IMPULSES[0, 0], 0.0, 0.0), atol=1e-15)
    np.testing.assert_allclose(found[1], IMPULSES[1], atol=1e-15)
