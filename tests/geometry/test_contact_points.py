"""Contact points: known landings, and properties of random ones."""

import itertools
import math

import numpy as np
import pytest
from convex_reference import outside, reach
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from shapely.geometry import Polygon

from bulletuav.geometry.contact_points import MAX_POINTS, contact_points
from bulletuav.geometry.convex import (
    MAX_FACE_CORNERS,
    NUM_RIM_POINTS,
    make_hull_shape,
    make_shape_table,
)
from bulletuav.geometry.gjk import gjk_distance, make_scratch
from bulletuav.geometry.minkowski import SCRATCH_ROWS
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, SPHERE, Shape

ROOM = make_scratch()
UPRIGHT = Rotation.identity()
LYING = Rotation.from_euler("x", 90, degrees=True)
MANY = 40
RING = 2 * np.pi * np.arange(MANY) / MANY
SHAPES = {
    "sphere": Shape(SPHERE, (0.1, 0.1, 0.1)),
    "drone": Shape(CYLINDER, (0.05, 0.05, 0.015)),
    "wire": Shape(CYLINDER, (0.01, 0.01, 10.0)),
    "roof": Shape(BOX, (2.0, 3.0, 4.0)),
    "plate": Shape(BOX, (0.04, 0.05, 0.001)),
    "prism": make_hull_shape(
        np.array([(x, y, z) for x, y in [(0, 0), (1, 0), (0, 1)] for z in (0, 1)])
    ),
    "column": make_hull_shape(
        np.array([(np.cos(t), np.sin(t), z) for t in RING for z in (-1.0, 1)])
    ),
    "ground": Shape(HALF_SPACE, (np.inf, np.inf, np.inf)),
}
NAMES = list(SHAPES)
TABLE = make_shape_table(list(SHAPES.values()))
SOLID = NAMES[:-1]


def columns(turn):
    return tuple(map(tuple, turn.as_matrix().T.tolist()))


def contacts(pair, turn_a, turn_b, offset, most=0.01, rows=MAX_POINTS):
    """Distance, normal, and the points (M, 4) of one pose."""
    a, b = (NAMES.index(name) for name in pair)
    there = tuple(map(float, offset))
    pose = (TABLE, a, columns(turn_a), b, columns(turn_b), there)
    distance, normal, on_a, on_b = gjk_distance(*pose, (0.0, 0.0, 0.0), ROOM)
    points = np.full((rows, 4), np.nan)
    count = contact_points(*pose, normal, on_a, on_b, most, points, ROOM)
    assert np.isnan(points[count:]).all()
    # The witness comes first, midway, and all lie in its plane
    middle = (np.array(on_a) + on_b + offset) / 2
    np.testing.assert_allclose(points[0], [*middle, distance], atol=1e-9)
    normal = np.array(normal)
    np.testing.assert_allclose((points[:count, :3] - middle) @ normal, 0.0, atol=1e-9)
    return distance, normal, points[:count]


def sorted_places(points):
    return np.array(sorted(points[:, :3].round(9).tolist()))


def same_places(points, expected):
    """Whether the points after the witness are at places, in any order."""
    expected = np.array(sorted(np.round(expected, 9).tolist()))
    np.testing.assert_allclose(sorted_places(points[1:]), expected, atol=1e-8)


def test_a_level_drone_stands_on_its_rim():
    distance, _, points = contacts(("drone", "ground"), UPRIGHT, UPRIGHT, [0, 0, -0.016])
    assert distance == pytest.approx(0.001)
    angle = 2 * np.pi * np.arange(NUM_RIM_POINTS) / NUM_RIM_POINTS
    rim = np.stack(
        [0.05 * np.cos(angle), 0.05 * np.sin(angle), np.full(NUM_RIM_POINTS, -0.0155)], axis=1
    )
    same_places(points, rim)
    np.testing.assert_allclose(points[:, 3], 0.001)


def test_body_axes_place_the_rim_of_a_level_drone_whichever_way_it_leans():
    for lean in (1e-5, -1e-5, 3e-4):
        turn = Rotation.from_euler("zy", [0.7, lean])
        points = contacts(("drone", "ground"), turn, UPRIGHT, [0, 0, -0.0151])[2]
        ahead = turn.apply([0.05, 0, -0.015])[:2]
        assert np.abs(points[:, :2] - ahead).max(axis=1).min() <= 1e-6


@pytest.mark.parametrize("lean", [0.002, 0.05, 0.7])
def test_the_rim_of_a_leaning_drone_begins_at_its_lowest_point(lean):
    turn = Rotation.from_rotvec([lean, 0, 0])
    distance, _, points = contacts(("drone", "ground"), turn, UPRIGHT, [0, 0, -0.1], most=1.0)
    # The lowest point is the witness, the others are the rest of the rim
    assert len(points) == NUM_RIM_POINTS
    assert points[:, 3].min() == points[0, 3] == distance
    local = turn.inv().apply(points[:, :3] + (points[:, 3:] - 0.5 * distance) * [0, 0, 1])
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), 0.05, atol=1e-12)
    np.testing.assert_allclose(local[:, 2], -0.015, atol=1e-12)


def test_a_lying_drone_touches_along_a_line():
    points = contacts(("drone", "ground"), LYING, UPRIGHT, [0, 0, -0.05])[2]
    # The witness is one of its ends
    np.testing.assert_allclose(np.sort(points[:, 1]), [-0.015, 0.015], atol=1e-12)
    np.testing.assert_allclose(points[:, [0, 2]], [[0, -0.05]] * 2, atol=1e-12)


def test_a_drone_over_the_edge_of_a_roof_has_points_on_the_roof_only():
    points = contacts(("drone", "roof"), UPRIGHT, UPRIGHT, [-1.98, 0, -4.016])[2]
    assert points[:, 0].max() == pytest.approx(0.02, abs=1e-9)
    # Shapely clips the same octagon
    angle = 2 * np.pi * np.arange(NUM_RIM_POINTS) / NUM_RIM_POINTS
    octagon = Polygon(0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    left = octagon.intersection(Polygon([(-1, -1), (0.02, -1), (0.02, 1), (-1, 1)]))
    corners = {tuple(np.round(place, 8)) for place in left.exterior.coords}
    found = {tuple(np.round(place, 8)) for place in points[:, :2]}
    assert corners <= {(x + 0.0, y + 0.0) for x, y in found}


@pytest.mark.parametrize("shift", [(0.03, 0.02), (0.0, 0.0), (-0.07, 0.09)])
@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4])
def test_plates_on_each_other_are_clipped_as_shapely_does(shift, yaw):
    turn = Rotation.from_euler("z", yaw)
    points = contacts(("plate", "plate"), UPRIGHT, turn, [*shift, -0.003])[2]
    square = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * [0.04, 0.05]
    other = turn.apply(np.pad(square, ((0, 0), (0, 1))))[:, :2] + shift
    left = Polygon(square).intersection(Polygon(other))
    for place in left.exterior.coords:
        assert np.linalg.norm(points[:, :2] - place, axis=1).min() <= 2e-6
    for x, y in points[1:, :2]:
        assert min(math.dist((x, y), place) for place in left.exterior.coords) <= 1e-9
    np.testing.assert_allclose(points[:, 3], 0.001, atol=1e-12)
    np.testing.assert_allclose(points[:, 2], -0.0015, atol=1e-12)


def test_swapped_shapes_have_the_same_points():
    lean = Rotation.from_euler("xz", [0.01, 0.4])
    for pair in (("drone", "roof"), ("prism", "plate"), ("wire", "roof"), ("roof", "plate")):
        turn = LYING if "wire" in pair else lean
        height = reach(SHAPES[pair[0]], turn.as_matrix()[None], np.array([[0, 0, -1.0]]))[0]
        height += SHAPES[pair[1]].half[2]
        offset = np.array([0.01, -0.02, -height - 0.001])
        points = contacts(pair, turn, UPRIGHT, offset, most=1.0)[2]
        back = contacts(pair[::-1], UPRIGHT, turn, -offset, most=1.0)[2]
        back[:, :3] += offset
        # Each finds the corners of the same overlap; where on it the witness is may differ
        for one, two in ((points, back), (back, points)):
            apart = np.linalg.norm(one[1:, None, :3] - two[None, :, :3], axis=2).min(axis=1)
            assert np.sort(apart)[: len(apart) - 1].max() <= 1e-5


def test_parallel_wires_touch_along_their_overlap():
    points = contacts(("wire", "wire"), LYING, LYING, [0, 3.0, -0.021])[2]
    ends = points[1:, 1]
    assert min(ends) == pytest.approx(-7)
    assert max(ends) == pytest.approx(10)
    np.testing.assert_allclose(points[:, 3], 0.001, atol=1e-12)


def test_crossing_wires_touch_in_one_point():
    across = Rotation.from_euler("xz", [math.pi / 2, 0.5])
    assert len(contacts(("wire", "wire"), LYING, across, [0, 0, -0.021])[2]) == 1


def test_a_wire_over_a_roof_touches_between_the_edges():
    points = contacts(("wire", "roof"), LYING, UPRIGHT, [0, 0, -4.01])[2]
    assert {round(y, 9) for y in points[1:, 1]} <= {-3.0, 3.0}
    assert np.ptp(points[:, 1]) >= 3


def test_a_sphere_touches_in_one_point():
    for pair in (("sphere", "roof"), ("roof", "sphere"), ("sphere", "ground")):
        assert len(contacts(pair, UPRIGHT, UPRIGHT, [0, 0, -4.2])[2]) == 1


@pytest.mark.parametrize("apart", [0.01, 0.05, 0.08, 0.099])
@pytest.mark.parametrize("angle", [0.0, 0.2, 2.0])
def test_points_of_two_discs_reach_as_far_as_what_they_share(apart, angle):
    """By hand: a lens from `apart` - radius to the radius, along the line of their middles."""
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    leans = Rotation.from_rotvec([0.7, 0.4, 0.0])
    offset = leans.apply(apart * along + (0.0, 0.0, -0.03))
    points = contacts(("drone", "drone"), leans, leans, offset)[2]
    reached = points[:, :3] @ leans.apply(along)
    assert (reached.min(), reached.max()) == pytest.approx((apart - 0.05, 0.05), abs=1e-6)


def test_far_points_are_left_out():
    turn = Rotation.from_rotvec([0, 0.1, 0])
    pose = (("drone", "roof"), turn, UPRIGHT, [0, 0, -4.021])
    every, near = (contacts(*pose, most=most)[2] for most in (1.0, 0.004))
    assert len(near) == (every[:, 3] <= 0.004).sum() < len(every)
    assert len(contacts(*pose, most=-1.0)[2]) == 1


def test_of_too_many_points_some_from_all_around_are_kept():
    points = contacts(("column", "ground"), UPRIGHT, UPRIGHT, [0, 0, -1.0])[2]
    assert MAX_POINTS - 1 <= len(points) <= MAX_POINTS
    angle = np.sort(np.arctan2(points[1:, 1], points[1:, 0]))
    assert np.diff(angle).max() <= 3 * 2 * np.pi / MANY + 1e-9
    few = contacts(("column", "ground"), UPRIGHT, UPRIGHT, [0, 0, -1.0], rows=5)[2]
    assert 4 <= len(few) <= 5


@pytest.mark.parametrize("pair", list(itertools.product(SOLID, NAMES)), ids="-".join)
def test_random_contacts_are_sensible(pair):
    rng = np.random.default_rng(1)
    turns = Rotation.random(25, random_state=rng), Rotation.random(25, random_state=rng)
    a, b = (SHAPES[name] for name in pair)
    for turn_a, turn_b in zip(*turns, strict=True):
        lean = Rotation.from_rotvec(rng.normal(size=3) * 10 ** rng.uniform(-6, 0))
        turn_b = lean * turn_a if rng.random() < 0.5 else turn_b
        offset = rng.normal(size=3) * 0.01
        for _ in range(2):
            distance, normal, _ = contacts(pair, turn_a, turn_b, offset)
            offset = offset + normal * (distance - rng.choice([-1e-4, 1e-6, 1e-3]))
        distance, normal, points = contacts(pair, turn_a, turn_b, offset)
        assert points[1:, 3].max(initial=0) <= 0.01
        # None is deeper than the shapes reach into each other along the normal
        assert points[:, 3].min() >= distance - 1e-8
        # No two are the same
        apart = np.linalg.norm(points[:, None, :3] - points[None, :, :3], axis=2)
        assert (apart + np.eye(len(points))).min() > 1e-6
        # Along the normal through a point there is no space between the shapes but its distance
        slack = 3e-3 * a.half[0] if CYLINDER in (a.kind, b.kind) else 1e-8
        # Normals of overlaps are those of the least depth to 5e-4 rad
        slack += 5e-4 * max(0.0, -distance)
        for place, far in zip(points[:, :3], points[:, 3], strict=True):
            pose = (a, turn_a, place, b, turn_b, place - far * normal - offset, normal)
            # Most often one of the shapes is level
            guesses = (0.5 * distance, far - 0.5 * distance, 0.5 * far)
            if min(_space(up, *pose) for up in guesses) > slack:
                wide = 0.5 * abs(distance) + abs(far)
                found = minimize_scalar(
                    _space, bounds=(-wide, wide), args=pose, options={"xatol": 1e-10}
                )
                assert found.fun <= slack + 1e-9


def _space(up, a, turn_a, on_a, b, turn_b, on_b, normal):
    """How far two places are out of two shapes, both moved up along the normal."""
    out = _outside(a, turn_a, on_a + up * normal)
    return out if b.kind == HALF_SPACE else max(out, _outside(b, turn_b, on_b + up * normal))


def _outside(shape, turn, place):
    return outside(shape, turn.as_matrix()[None], place[None])[0]


def test_scratch_holds_two_faces_of_most_corners():
    """Two plates, one turned by half a corner: all their sides cross, in 512 points."""
    assert 2 * MAX_FACE_CORNERS <= SCRATCH_ROWS
    angle = 2 * np.pi * np.arange(MAX_FACE_CORNERS) / MAX_FACE_CORNERS
    plate = make_hull_shape(
        np.array([(np.cos(t), np.sin(t), z) for t in angle for z in (-0.1, 0.1)])
    )
    table = make_shape_table([plate, plate])
    half = np.pi / MAX_FACE_CORNERS
    pose = (0, columns(UPRIGHT), 1, columns(Rotation.from_euler("z", half)), (0.0, 0.0, -0.201))
    distance, normal, on_a, on_b = gjk_distance(table, *pose, (0.0, 0.0, 0.0), ROOM)
    points = np.zeros((MAX_POINTS, 4))
    count = contact_points(table, *pose, normal, on_a, on_b, 0.01, points, ROOM)
    assert distance == pytest.approx(0.001)
    assert count == MAX_POINTS
    crossing = np.cos(half) / np.cos(half / 2)
    np.testing.assert_allclose(np.hypot(*points[1:, :2].T), crossing, atol=1e-9)
    np.testing.assert_allclose(points[:, 2:], [(-0.1005, 0.001)] * count, atol=1e-9)
    # From all around
    sectors = np.floor(np.arctan2(points[1:, 1], points[1:, 0]) / (np.pi / 4))
    assert len(set(sectors.tolist())) == 8
