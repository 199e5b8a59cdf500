"""Signed distances of convex shapes against exact ones, certificates and properties."""

import itertools

import numpy as np
import pytest
from convex_reference import deepest, from_centre, outside, polytopes, separation
from scipy.spatial.transform import Rotation

from bulletuav.geometry.convex import make_hull_shape, make_shape_table
from bulletuav.geometry.gjk import gjk_distance, make_scratch
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE, Shape

ROOM = make_scratch()
NO_GUESS = (0.0, 0.0, 0.0)
UPRIGHT = np.eye(3)
CUBE = np.array(list(itertools.product((-1.0, 1), repeat=3)))


def dented(half, seed):
    """A hull of eight corners, near those of a box."""
    dent = np.random.default_rng(seed).uniform(-0.1, 0.1, CUBE.shape) * min(half)
    return make_hull_shape(CUBE * half + dent)


SHAPES = {
    "sphere": Shape(SPHERE, (0.1, 0.1, 0.1)),
    "cylinder": Shape(CYLINDER, (0.05, 0.05, 0.015)),
    "box": Shape(BOX, (0.2, 0.3, 0.4)),
    "hull": dented((0.1, 0.2, 0.3), 1),
}
SIZES = {
    "grain": Shape(SPHERE, (1e-4, 1e-4, 1e-4)),
    "pin": Shape(CYLINDER, (1e-4, 1e-4, 1e-4)),
    "wire": Shape(CYLINDER, (0.01, 0.01, 10.0)),
    "disc": Shape(CYLINDER, (5.0, 5.0, 0.001)),
    "dice": Shape(BOX, (1e-4, 1e-4, 1e-4)),
    "plate": Shape(BOX, (0.001, 5.0, 5.0)),
    "building": Shape(BOX, (2000.0, 20.0, 100.0)),
    "splinter": dented((1e-4, 1e-4, 1e-4), 2),
    "sheet": dented((0.002, 5.0, 5.0), 3),
}
ALL = {**SHAPES, **SIZES, "ground": Shape(HALF_SPACE, (np.inf, np.inf, np.inf))}
NAMES = list(ALL)
TABLE = make_shape_table(list(ALL.values()))
SOLID = [name for name in NAMES if name != "ground"]
PAIRS = list(itertools.product(SHAPES, repeat=2))
ROUND = [pair for pair in PAIRS if "cylinder" in pair and "sphere" not in pair]


def columns(turn):
    return tuple(map(tuple, turn.T.tolist()))


def measure(pair, turn_a, turn_b, offset, guess=NO_GUESS):
    """`gjk_distance` of one pose; vectors as arrays."""
    a, b = (NAMES.index(name) for name in pair)
    there = tuple(map(float, offset))
    found = gjk_distance(TABLE, a, columns(turn_a), b, columns(turn_b), there, guess, ROOM)
    return found[0], *map(np.array, found[1:])


def measure_all(pair, turn_a, turn_b, offset):
    rows = [measure(pair, *pose) for pose in zip(turn_a, turn_b, offset, strict=True)]
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def random_turns(rng, count):
    """Random turns; a third of them along the axes, or so but for 1e-12 to 0.1 rad."""
    turn = Rotation.random(count, random_state=rng).as_matrix()
    for m in range(0, count, 3):
        bend = rng.normal(size=3) * 10 ** rng.uniform(-12, -1) * (m % 2)
        axes = np.roll(np.eye(3), rng.integers(3), axis=0)
        turn[m] = axes @ Rotation.from_rotvec(bend).as_matrix()
    return rng.permutation(turn)


def poses(pair, count, seed, apart):
    """Random turns and offsets whose distance is about one of `apart`, where that can be."""
    rng = np.random.default_rng(seed)
    turn_a, turn_b = random_turns(rng, count), random_turns(rng, count)
    inside = [rng.uniform(-1, 1, (count, 3)) * ALL[name].half for name in pair]
    offset = np.einsum("mij,mj->mi", turn_a, inside[0]) - np.einsum("mij,mj->mi", turn_b, inside[1])
    wanted = rng.choice(apart, count) * rng.uniform(0.5, 1, count)
    # The depth of deep overlaps is known roughly: the second move corrects it
    for _ in range(2):
        distance, normal = measure_all(pair, turn_a, turn_b, offset)[:2]
        offset = offset + normal * (distance - wanted)[:, None]
    return turn_a, turn_b, offset


APART = [0.0, 1e-9, 1e-7, 1e-5, 1e-3, 0.1, 3.0]


def exact(pair, turn_a, turn_b, offset):
    """Signed distances by other means, or None where a cylinder leaves none."""
    a, b = (ALL[name] for name in pair)
    if a.kind == SPHERE:
        return from_centre(b, turn_b, -offset, a.half[0])
    if b.kind == SPHERE:
        return from_centre(a, turn_a, offset, b.half[0])
    if CYLINDER in (a.kind, b.kind):
        return None
    return polytopes(a, turn_a, b, turn_b, offset)


def check_apart(pair, count, seed, tolerance):
    turn_a, turn_b, offset = poses(pair, count, seed, APART)
    distance, normal, on_a, on_b = measure_all(pair, turn_a, turn_b, offset)
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1, abs=1e-12)
    # The points are as far apart as is said, along the normal
    apart = on_a - on_b - offset
    np.testing.assert_allclose(apart, distance[:, None] * normal, atol=tolerance)
    free = distance > 0
    true = exact(pair, turn_a, turn_b, offset)
    a, b = (ALL[name] for name in pair)
    if true is not None:
        free = true > 0
        np.testing.assert_allclose(distance[free], true[free], atol=tolerance)
    else:
        # What lies between the planes across the normal is a lower bound, what between points of
        # the shapes an upper one
        lower = separation(a, turn_a, b, turn_b, offset, normal)
        assert (distance - lower)[free].max(initial=0) <= tolerance
    assert outside(a, turn_a, on_a)[free].max(initial=0) <= tolerance
    assert outside(b, turn_b, on_b)[free].max(initial=0) <= tolerance


def check_shallow(pair, count, seed):
    turn_a, turn_b, offset = poses(pair, count, seed, [-1e-6, -1e-5, -1e-4, -1e-3])
    distance = measure_all(pair, turn_a, turn_b, offset)[0]
    true = exact(pair, turn_a, turn_b, offset)
    if true is None:
        a, b = (ALL[name] for name in pair)
        true = np.array(
            [
                deepest(a, *pose[:1], b, *pose[1:])
                for pose in zip(turn_a, turn_b, offset, strict=True)
            ]
        )
    overlap = (true < 0) & (true > -1.001e-3)
    assert overlap.mean() > 0.8
    assert (true - distance)[overlap].max() <= 1e-5
    # Never less than the true depth, but for rounding
    assert (true - distance)[overlap].min() >= -1e-9


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_distances_of_shapes_apart_are_exact(pair):
    check_apart(pair, 300, 1, 1e-9)


@pytest.mark.parametrize("pair", [p for p in PAIRS if p not in ROUND], ids="-".join)
def test_shallow_depths_are_exact(pair):
    check_shallow(pair, 200, 2)


@pytest.mark.parametrize("pair", ROUND, ids="-".join)
def test_shallow_depths_of_cylinders_are_those_of_many_normals(pair):
    check_shallow(pair, 12, 3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("shape", SHAPES)
def test_sizes_from_a_tenth_of_a_millimetre_to_kilometres(shape, size):
    # Kilometres leave a cylinder's certificate fewer digits
    tolerance = 1e-6 if size == "building" or shape == "cylinder" else 1e-8
    check_apart((shape, size), 60, 4, tolerance)
    check_apart((size, shape), 60, 5, tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_many_distances(pair):
    for seed in range(20):
        check_apart(pair, 5000, 100 + seed, 1e-8 if pair in ROUND else 1e-9)
    if pair not in ROUND:
        check_shallow(pair, 20_000, 200)


@pytest.mark.slow
@pytest.mark.parametrize("pair", list(itertools.product(SOLID, repeat=2)), ids="-".join)
def test_many_sizes(pair):
    check_apart(pair, 5000, 300, 1e-6)


@pytest.mark.parametrize("pair", list(itertools.product(SOLID, repeat=2)), ids="-".join)
def test_moving_along_the_normal_parts_deep_overlaps(pair):
    turn_a, turn_b, offset = poses(pair, 20, 6, [-0.01, -0.3, -10.0])
    distance, normal = measure_all(pair, turn_a, turn_b, offset)[:2]
    assert np.isfinite(distance).all()
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1, abs=1e-12)
    parted = measure_all(pair, turn_a, turn_b, offset + distance[:, None] * normal)[0]
    size = max(TABLE.radius[NAMES.index(name)] for name in pair)
    assert parted.min() >= -1e-9 * max(size, 1)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_swapped_moved_and_shifted_pairs_agree(pair):
    turn_a, turn_b, offset = poses(pair, 60, 7, [1e-3, 0.1])
    distance, normal = measure_all(pair, turn_a, turn_b, offset)[:2]
    back = measure_all(pair[::-1], turn_b, turn_a, -offset)
    np.testing.assert_allclose(back[0], distance, atol=1e-9)
    np.testing.assert_allclose(back[1], -normal, atol=1e-4)
    move = Rotation.random(random_state=8).as_matrix()
    moved = measure_all(pair, move @ turn_a, move @ turn_b, offset @ move.T)
    np.testing.assert_allclose(moved[0], distance, atol=1e-9)
    np.testing.assert_allclose(moved[1], normal @ move.T, atol=1e-4)
    further = measure_all(pair, turn_a, turn_b, offset - 0.05 * normal)
    np.testing.assert_allclose(further[0], distance + 0.05, atol=1e-9)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_a_guess_changes_last_digits_only_and_the_same_call_none(pair):
    rng = np.random.default_rng(9)
    for pose in zip(*poses(pair, 60, 10, [1e-6, 1e-3, 0.1]), strict=True):
        cold = measure(pair, *pose)
        guess = cold[1] + rng.normal(0, 0.01, 3)
        guess = tuple((guess / np.linalg.norm(guess)).tolist())
        warm = measure(pair, *pose, guess)
        assert warm[0] == pytest.approx(cold[0], abs=1e-9)
        measure(pair, *pose[:2], pose[2] + 0.01)
        again = measure(pair, *pose, guess)
        assert all((one == two).all() for one, two in zip(warm[1:], again[1:], strict=True))


@pytest.mark.parametrize("name", SOLID)
def test_equal_shapes_in_one_place_overlap(name):
    distance, normal, _, _ = measure((name, name), UPRIGHT, UPRIGHT, np.zeros(3))
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
    half = np.array(ALL[name].half)
    assert distance == pytest.approx(-2 * half.min(), rel=0.2)


@pytest.mark.parametrize("pair", list(itertools.product(["cylinder", "box", "disc"], repeat=2)))
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.01, 0.0), (0.01, -0.02)])
def test_faces_that_touch_have_no_distance(pair, shift):
    height = sum(ALL[name].half[2] for name in pair)
    distance, normal, on_a, on_b = measure(pair, UPRIGHT, UPRIGHT, [*shift, -height])
    assert distance == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(on_a - on_b, [*shift, -height], atol=1e-9)


@pytest.mark.parametrize("name", [name for name in SOLID if ALL[name].kind != HULL])
def test_heights_above_a_half_space_are_those_of_the_lowest_point(name):
    rng = np.random.default_rng(11)
    shape = ALL[name]
    for turn, slope in zip(random_turns(rng, 50), random_turns(rng, 50), strict=True):
        offset = rng.uniform(-5, 5, 3)
        distance, normal, on_a, on_b = measure((name, "ground"), turn, slope, offset)
        up = slope[:, 2]
        # Closed forms of how far the shapes reach down
        x, y, z = np.abs(turn.T @ up)
        low = {
            SPHERE: shape.half[0],
            CYLINDER: shape.half[0] * np.hypot(x, y) + shape.half[2] * z,
            BOX: np.dot(shape.half, (x, y, z)),
        }[shape.kind]
        assert distance == pytest.approx(-offset @ up - low, abs=1e-11)
        np.testing.assert_allclose(normal, up)
        assert on_a @ up == pytest.approx(-low, abs=1e-11)
        assert on_b @ up == pytest.approx(0, abs=1e-11)
        np.testing.assert_allclose(on_a - on_b - offset, distance * up, atol=1e-11)


def test_a_hull_rests_on_its_lowest_corner():
    turn = random_turns(np.random.default_rng(12), 1)[0]
    lowest = (np.array(ALL["hull"].corners) @ turn.T)[:, 2].min()
    found = measure(("hull", "ground"), turn, UPRIGHT, [4.0, 5.0, -3.0])[0]
    assert found == pytest.approx(3 + lowest, abs=1e-12)
