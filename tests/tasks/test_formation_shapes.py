"""Shapes of formations by hand, and the strokes of letters."""

import itertools

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from bulletuav.tasks.parts.formation_shapes import (
    GRID,
    SHAPES,
    STROKES,
    as_shape_list,
    find_places,
    letter_places,
    line_places,
    ring_places,
    wedge_places,
)


def test_a_v_by_hand():
    step = 10 / np.sqrt(2)
    wanted = [(0, 0, 0), (-1, 1, 0), (-1, -1, 0), (-2, 2, 0), (-2, -2, 0)]
    np.testing.assert_allclose(wedge_places(5, 10.0), step * np.array(wanted), atol=1e-12)


def test_a_line_by_hand():
    np.testing.assert_allclose(line_places(3, 4.0), [(0, 4, 0), (0, 0, 0), (0, -4, 0)])
    np.testing.assert_allclose(line_places(2, 4.0), [(0, 2, 0), (0, -2, 0)])


def test_a_ring_by_hand():
    """Six neighbours 10 m apart are as far from the middle."""
    half = 10 * np.sqrt(0.75)
    wanted = [(10, 0), (5, half), (-5, half), (-10, 0), (-5, -half), (5, -half)]
    np.testing.assert_allclose(ring_places(6, 10.0)[:, :2], wanted, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [2, 3, 7, 40])
def test_neighbours_are_as_far_apart_as_is_asked_for(shape, count):
    assert pdist(SHAPES[shape](count, 3.0)).min() == pytest.approx(3.0)


def test_an_i_by_hand():
    """Two ends and two places between them, upright: forward, in the middle."""
    place = letter_places(4, 2.0, "i")
    np.testing.assert_allclose(np.sort(place[:, 0]), (-3, -1, 1, 3), atol=1e-12)
    np.testing.assert_array_equal(place[:, 1:], 0.0)


def test_an_h_by_hand():
    """The six points of an H, on a grid of 2 m: bars 2 grid steps left and right, 4 high."""
    place = letter_places(6, 4.0, "H")
    wanted = [(4, 2), (0, 2), (-4, 2), (4, -2), (0, -2), (-4, -2)]
    found = sorted(map(tuple, place[:, :2].round(9).tolist()))
    assert found == sorted((2 * x / 2, 2 * y / 2) for x, y in wanted)


def test_more_drones_fill_the_longest_gaps():
    """Of an L with four more drones, the upright of 4 steps gets three, the foot of 2 one."""
    place = letter_places(7, 5.0, "L")
    np.testing.assert_allclose(pdist(place).min(), 5.0)
    assert np.sum(np.isclose(place[:, 1], place[:, 1].max())) == 5
    assert np.sum(np.isclose(place[:, 0], place[:, 0].min())) == 3
    gaps = squareform(pdist(place)) + 99 * np.eye(7)
    np.testing.assert_allclose(gaps.min(axis=1), 5.0)


def test_words_are_read_from_above_with_their_top_in_front():
    """What is forward is up on the page, what is left is left: I before T, and the bar on top."""
    place = letter_places(12, 1.0, "I T")
    word_i = place[np.isclose(place[:, 1], place[:, 1].max())]
    assert np.ptp(word_i[:, 0]) > 0
    top = place[np.isclose(place[:, 0], place[:, 0].max())]
    assert len(top) >= 4  # the I's end, and the bar
    assert (place[:, 1].max() + place[:, 1].min()) == pytest.approx(0.0)


@pytest.mark.parametrize("letter", STROKES)
def test_strokes_meet_at_points_of_the_grid_that_both_have(letter):
    """Otherwise drones of one could stand in another, and none where they meet."""
    edges = [
        (np.array(GRID[a], float), np.array(GRID[b], float))
        for stroke in STROKES[letter].split()
        for a, b in itertools.pairwise(stroke)
    ]
    share = np.linspace(0, 1, 201)[:, None]
    for (a, b), (c, d) in itertools.combinations(edges, 2):
        one, other = a + share * (b - a), c + share * (d - c)
        gap = np.linalg.norm(one[:, None] - other, axis=-1)
        ends = {tuple(a), tuple(b)} & {tuple(c), tuple(d)}
        for i, j in np.argwhere(gap < 1e-9):
            assert tuple(one[i].round(9)) in ends, (letter, one[i])
            assert i in (0, 200)
            assert j in (0, 200)


def test_letters_and_digits_all_differ_but_those_that_look_alike():
    assert set(STROKES) == set("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789")
    drawn = {}
    for letter, strokes in STROKES.items():
        edges = frozenset(
            frozenset(pair) for stroke in strokes.split() for pair in itertools.pairwise(stroke)
        )
        drawn.setdefault(edges, []).append(letter)
    assert [same for same in drawn.values() if len(same) > 1] == [["S", "5"]]


def test_one_shape_or_several():
    places = ((0.0, 0.0, 0.0), (9.0, 0.0, 0.0))
    assert as_shape_list("v") == ("v",)
    assert as_shape_list(("v", "ring")) == ("v", "ring")
    assert as_shape_list(places) == (places,)
    assert as_shape_list((places, "v")) == (places, "v")
    assert as_shape_list([places, places]) == (places, places)


def test_places_that_are_given_are_kept():
    given = ((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 0.0, 9.0))
    np.testing.assert_array_equal(find_places(given, 2, 1.0, "A", 5.0), given)
