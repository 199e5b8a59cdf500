import numpy as np
import pytest
from traffic_around import traffic_of

from bulletuav.policies.half_spaces import (
    MAX_TURN,
    AvoidanceParameters,
    add_obstacle_half_spaces,
    choose_turn,
    find_nearest_drones,
    horizontal_right,
    orca_half_space,
    solve_with_right_turn,
    turn_right,
)
from bulletuav.policies.linear_program import DEPTH

RULES = AvoidanceParameters(1.0, 2.0, 2.0, 0.1, 5.0)


def permitted(wish, **around):
    """The velocity that is chosen for one drone at the origin that moves at 1 m/s to the east."""
    traffic = traffic_of([(0, 0, 3, 1, 0, 0)], **around)
    rows = np.empty((DEPTH, 16, 4))
    count = add_obstacle_half_spaces(rows, 0, traffic, RULES, 0, 0)
    return solve_with_right_turn(rows, np.empty_like(rows), count, wish, RULES.max_speed), rows[
        0, :count
    ]


def test_half_space_of_a_head_on_pair_by_hand():
    """10 m apart, to stay 1 m apart for 2 s: together 4.5 m/s, so 2.25 m/s each."""
    n, bound = orca_half_space((10.0, 0, 0), (1.0, 0, 0), (-1.0, 0, 0), 1.0, RULES, 0.5)
    np.testing.assert_allclose((*n, bound), (-1, 0, 0, -2.25))


@pytest.mark.parametrize(("axis", "sideways"), [((1, 0, 0), (0, -1, 0)), ((0, 0, 1), (0, 1, 0))])
def test_fast_head_on_pair_turns_to_its_right(axis, sideways):
    """Nearest to the cone, equally far from all of it; on a vertical one goes north, one south."""
    gap, own, back = (tuple(size * np.array(axis)) for size in (8.0, 3.0, -3.0))
    rules = AvoidanceParameters(2.0, 8.0, 1.0, 0.1, 3.0)
    n, bound = orca_half_space(gap, own, back, 2.0, rules, 0.5)
    expected = -0.25 * np.array(axis) + np.sqrt(1 - 0.25**2) * np.array(sideways)
    np.testing.assert_allclose(n, expected, atol=1e-12)
    assert bound == pytest.approx(-0.25 * 3 + 0.5 * 0.25 * 6)
    other, same = orca_half_space(tuple(-8.0 * np.array(axis)), back, own, 2.0, rules, 0.5)
    np.testing.assert_allclose((*other, same), (*(-np.array(n)), bound))


@pytest.mark.parametrize(
    ("way", "right"),
    [
        ((2.0, 0.0, 0.0), (0, -1, 0)),
        ((0.0, 3.0, 4.0), (1, 0, 0)),
        ((0.0, 0.0, 5.0), (0, 1, 0)),
        ((0.0, 0.0, -5.0), (0, -1, 0)),
    ],
)
def test_right_by_hand(way, right):
    np.testing.assert_allclose(horizontal_right(way), right, atol=1e-15)
    quarter = np.linalg.norm(way) * np.array(right)
    np.testing.assert_allclose(turn_right(way, np.pi / 2), quarter, atol=1e-12)
    np.testing.assert_allclose(
        turn_right(way, np.pi / 6), np.sqrt(0.75) * np.array(way) + quarter / 2, atol=1e-12
    )


def test_wishes_turn_by_what_is_not_given():
    assert turn_right((0.0, 0.0, 0.0), 1.0) == (0.0, 0.0, 0.0)
    assert choose_turn((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) == 0
    assert choose_turn((4.0, 0.0, 0.0), (4.0, 0.0, 0.0)) == 0
    assert choose_turn((4.0, 0.0, 0.0), (3.0, 9.0, 0.0)) == pytest.approx(MAX_TURN / 4)
    assert choose_turn((4.0, 0.0, 0.0), (-1.0, 0.0, 0.0)) == MAX_TURN


def test_balls_leave_all_the_avoiding_to_the_drone():
    """Ball of 1 m, 10 m off, coming at 1 m/s: in 2 s they may close 9 m: at 3.5 m/s."""
    ball = (10, 0, 3, -1, 0, 0, 1)
    _, spaces = permitted((5.0, 0.0, 0.0), balls=[ball])
    np.testing.assert_allclose(spaces, [(-1, 0, 0, -3.5)])
    assert len(permitted((5.0, 0, 0), balls=[(10, 0, 3, -1, 0, 0, 0)])[1]) == 0


def test_walls_stop_drones_and_let_them_go_along():
    """With 2 s to a wall: half its distance a second, and back from outside."""
    best, spaces = permitted((0.0, 4.0, 0.0), box=((-10, -9, 4), (10, 4, 20)))
    # The other walls are so far off that no speed is too fast.
    expected = [(0, 1, 0, -4.5), (0, -1, 0, -2), (0, 0, 1, 0.5)]
    np.testing.assert_allclose(spaces, expected)
    assert best[1] == pytest.approx(2)
    assert best[2] >= 0.5 - 1e-9
    assert best[0] > 1  # to its right


def test_the_nearest_come_first_and_the_far_ones_not_at_all():
    traffic = traffic_of([(x, 0, 0, 0, 0, 0) for x in (0, 7, -3, 12, 5)])
    near, distance = np.zeros(5, np.int64), np.zeros(5)
    found = find_nearest_drones(traffic, 0, 0, 7.0, near, distance)
    assert near[:found].tolist() == [2, 4, 1]
    np.testing.assert_array_equal(distance[:found], (9, 25, 49))
