"""Planes that keep a pair apart: their bounds against ways in closed form; and small turns."""

import numpy as np
import pytest
from contact.rig import random_attitudes, random_directions
from scipy.spatial.transform import Rotation

from bulletuav.contact.separating_planes import (
    bound_fixed_plane,
    bound_planes,
    bound_rotating_plane,
    compute_safe_time,
)
from bulletuav.contact.spin import bound_angle, rotate_by_fraction

SHARES = np.linspace(0, 1, 1001)
RADII = (0.07, 0.2)


def ways(rng, together=False):
    """Draw how two drones move: normal, move, turns, and the way from b to a; lists of numbers."""
    normal, between = random_directions(rng, 2) * np.array([[1.0], [0.25]])
    turn_a, turn_b = 10 ** rng.uniform(-3, -0.3, (2, 1)) * random_directions(rng, 2)
    move = 10 ** rng.uniform(-4, -1) * random_directions(rng, 1)[0]
    if together:
        turn_a, move = turn_b, np.cross(turn_b, between)
    return [tuple(one.tolist()) for one in (normal, move, turn_a, turn_b, between)]


def heights(rng, normal, move, turn_a, turn_b, between):
    """Heights of points of a over a plane through b that turns with it, at all shares."""
    arms = RADII[0] * random_directions(rng, 50)
    turned_arms = [Rotation.from_rotvec(share * np.array(turn_a)).apply(arms) for share in SHARES]
    place = np.array(between) + SHARES[:, None, None] * np.array(move) + turned_arms
    normals = Rotation.from_rotvec(SHARES[:, None] * np.array(turn_b)).apply(normal)
    return np.einsum("tmk,tk->mt", place, normals)


@pytest.mark.parametrize("seed", range(20))
def test_points_move_against_a_turning_plane_no_faster_than_it_says(seed):
    rng = np.random.default_rng(seed)
    normal, move, turn_a, turn_b, between = ways(rng)
    bound, growth, bend, turn = bound_rotating_plane(
        RADII[0], normal, move, turn_a, turn_b, between
    )
    assert turn == turn_b
    assert bend == growth / 8
    height = heights(rng, normal, move, turn_a, turn_b, between)
    fallen = height[:, :1] - height
    assert (fallen <= SHARES * (bound + 0.5 * growth * SHARES) + 1e-12).all()
    bent = np.abs(np.diff(height, 2)) / SHARES[1] ** 2
    assert bent.max() <= growth
    # No more than a few times what is needed
    assert growth < 60 * bent.max() + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_pair_that_turns_as_one_does_not_close_against_a_plane_that_does_too(seed):
    normal, move, turn_a, turn_b, between = ways(np.random.default_rng(seed), together=True)
    planes = bound_planes(RADII, normal, move, turn_a, turn_b, between, 3)
    size = np.linalg.norm(turn_b)
    assert planes[0][0] < 1e-15
    # Centres go straight on, which differs from a circle by half the square
    assert planes[0][1] < 4 * size**2
    still = bound_fixed_plane(RADII, normal, move, turn_a, turn_b)
    assert planes[2] == still
    left = 1e-4 * size**2
    assert compute_safe_time(planes[0], left) > 2 * compute_safe_time(still, left)


def test_a_and_b_may_change_places():
    normal, move, turn_a, turn_b, between = ways(np.random.default_rng(1))
    there = bound_planes(RADII, normal, move, turn_a, turn_b, between, 3)
    back = [tuple(-x for x in one) for one in (normal, move, between)]
    here = bound_planes(RADII[::-1], back[0], back[1], turn_b, turn_a, back[2], 3)
    np.testing.assert_allclose(there[0][:3], here[1][:3], rtol=1e-14)
    np.testing.assert_allclose(there[1][:3], here[0][:3], rtol=1e-14)
    np.testing.assert_allclose(there[2][:3], here[2][:3], rtol=1e-14)


def test_attitudes_after_a_turn_are_those_of_scipy():
    """Small turns are series, larger ones are not."""
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-3, 0.3, 0.999, 1.001, 3.0):
        turn = size * random_directions(rng, 1)[0]
        attitude = random_attitudes(rng, 1)[0]
        for share in (0.5, 1.0):
            found = rotate_by_fraction(tuple(turn.tolist()), share, tuple(attitude.tolist()))
            expected = Rotation.from_rotvec(share * turn) * Rotation.from_quat(attitude)
            np.testing.assert_allclose(found, expected.as_quat(), atol=2e-15)


@pytest.mark.parametrize(
    ("angle", "most"), [(0.0, 0.0), (1e-6, 1.001e-6), (0.1, 0.101), (1.5, 1.9), (3.1, np.pi)]
)
def test_angles_are_bounded(angle, most):
    before = Rotation.from_rotvec([0.3, -0.2, 0.9])
    after = Rotation.from_rotvec(angle * np.array([0.6, 0.0, -0.8])) * before
    for one in (after.as_quat(), -after.as_quat()):
        found = bound_angle(tuple(before.as_quat().tolist()), tuple(one.tolist()))
        assert angle - 1e-12 <= found <= most + 1e-12
