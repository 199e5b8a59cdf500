"""Nearest points that are solved for directly: by hand, against GJK, and certified by planes."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav.geometry.closest_features import UNKNOWN, closest_features, solve_closest_features
from bulletuav.geometry.convex import local_support_point, make_shape_table
from bulletuav.geometry.gjk import gjk_distance, make_scratch
from bulletuav.geometry.rotation import axes
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE, Shape

DISC, WIRE, CRATE, BALL = range(4)
SHAPES = [
    Shape(CYLINDER, (0.06, 0.06, 0.0125)),
    Shape(CYLINDER, (0.02, 0.02, 1.0)),
    Shape(BOX, (0.1, 0.2, 0.3)),
    Shape(SPHERE, (0.1, 0.1, 0.1)),
]
TABLE = make_shape_table(SHAPES)
ROOM = make_scratch()
NO_GUESS = (0.0, 0.0, 0.0)
LEVEL = Rotation.identity()
ON_EDGE = Rotation.from_euler("y", 90, degrees=True)


def posed(turn_a, turn_b, offset):
    turns = axes(tuple(turn_a.as_quat())), axes(tuple(turn_b.as_quat()))
    return *turns, tuple(float(one) for one in offset)


def solved(a, turn_a, b, turn_b, offset, d):
    """`solve_closest_features` along a direction of any length; vectors as arrays."""
    turn_a, turn_b, offset = posed(turn_a, turn_b, offset)
    d = tuple((np.array(d) / np.linalg.norm(d)).tolist())
    distance, *rest = solve_closest_features(TABLE, a, turn_a, b, turn_b, offset, d)
    return distance, *map(np.array, rest)


BY_HAND = {
    # Beside each other: round sides, in the middle of where they overlap
    "sides": (DISC, LEVEL, DISC, LEVEL, (0.3, 0.4, 0.01), (-1, -1, 0), 0.38, (-0.6, -0.8, 0)),
    # A disc on its rim over a flat one, and over a crate
    "rim": (DISC, ON_EDGE, DISC, LEVEL, (0.0, 0.0, -0.2), (0.1, 0, 1), 0.1275, (0, 0, 1)),
    "face": (DISC, LEVEL, CRATE, LEVEL, (0.02, 0.1, -0.5), (0, 0.2, 1), 0.1875, (0, 0, 1)),
    # Wires that cross, one 7 cm above the other
    "wires": (WIRE, LEVEL, WIRE, ON_EDGE, (0.0, 0.07, 0.0), (0.01, -1, 0.02), 0.03, (0, -1, 0)),
    "balls": (BALL, LEVEL, BALL, LEVEL, (0.3, 0.0, 0.4), (-1, 0, -1), 0.3, (-0.6, 0, -0.8)),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_distances_are_those_by_hand(name):
    a, turn_a, b, turn_b, offset, d, distance, normal = BY_HAND[name]
    found = solved(a, turn_a, b, turn_b, offset, d)
    assert found[0] == pytest.approx(distance, abs=1e-15)
    np.testing.assert_allclose(found[1], normal, atol=1e-15)
    np.testing.assert_allclose(found[2] - found[3] - offset, distance * found[1], atol=1e-15)


def test_sides_touch_in_the_middle_of_where_they_are_beside_each_other():
    a, turn_a, b, turn_b, offset, d, *_ = BY_HAND["sides"]
    _, _, on_a, on_b = solved(a, turn_a, b, turn_b, offset, d)
    assert on_a[2] == pytest.approx(0.005)
    assert on_b[2] == pytest.approx(-0.005)


def test_shapes_that_overlap_and_hopeless_directions_are_left_to_gjk():
    assert solved(DISC, LEVEL, DISC, LEVEL, (0.1, 0, 0), (-1, 0, 0))[0] == UNKNOWN
    assert solved(DISC, LEVEL, CRATE, LEVEL, (0.3, 0.4, 0.5), (1, 0, 0))[0] == UNKNOWN


def reach(s, turn, d):
    """How far a shape reaches along a direction, m."""
    swell = SHAPES[s].half[0] if SHAPES[s].kind == SPHERE else 0.0
    local = turn.inv().apply(d)
    return local @ np.array(local_support_point(TABLE, s, tuple(local.tolist()))) + swell


@pytest.mark.parametrize("pair", list(itertools.combinations_with_replacement(range(4), 2)))
def test_answers_agree_with_gjk_and_planes_prove_them(pair):
    """The plane across the normal separates the shapes by the distance: none can be nearer."""
    a, b = pair
    rng = np.random.default_rng(10 * a + b)
    for apart in (1e-4, 1e-3, 0.2) * 20:
        turn_a, turn_b, bent = Rotation.random(3, rng=rng)
        way = bent.apply([1.0, 0.0, 0.0])
        pose = posed(turn_a, turn_b, 5 * way)
        found = gjk_distance(TABLE, a, pose[0], b, pose[1], pose[2], NO_GUESS, ROOM)
        offset = 5 * way + np.array(found[1]) * (found[0] - apart)
        pose = posed(turn_a, turn_b, offset)
        exact = gjk_distance(TABLE, a, pose[0], b, pose[1], pose[2], NO_GUESS, ROOM)
        distance, normal, on_a, on_b = closest_features(
            TABLE, a, pose[0], b, *pose[1:], NO_GUESS, ROOM
        )
        assert distance == pytest.approx(exact[0], abs=1e-10)
        normal, on_a, on_b = map(np.array, (normal, on_a, on_b))
        np.testing.assert_allclose(on_a - on_b - offset, distance * normal, atol=1e-12)
        least = -reach(a, turn_a, -normal) - reach(b, turn_b, normal) - normal @ offset
        assert least == pytest.approx(distance, abs=1e-12)
        # GJK alone would not know the direction of a gap between rims to 1e-6
        again = solved(a, turn_a, b, turn_b, offset, normal)
        assert again[0] == pytest.approx(distance, abs=1e-12)
        assert np.linalg.norm(again[2] - again[3] - offset) == pytest.approx(again[0], abs=2e-13)


def test_a_rim_is_found_against_a_side_that_its_own_side_nearly_faces():
    """Both sides look along the direction, yet of one of them the rim is nearer."""
    lean = Rotation.from_euler("y", 0.03)
    distance, normal, *_ = solved(DISC, lean, WIRE, LEVEL, (-0.09, 0.0, 0.0), (1, 0, 0))
    # The rim reaches to r cos a + h sin a
    assert distance == pytest.approx(0.07 - 0.06 * np.cos(0.03) - 0.0125 * np.sin(0.03), abs=1e-15)
    np.testing.assert_allclose(normal, (1, 0, 0), atol=1e-15)
