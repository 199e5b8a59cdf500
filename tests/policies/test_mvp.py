import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from traffic_around import fly, velocities

from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.mvp import mvp_velocities, resolve_conflict

RULES = AvoidanceParameters(5.0, 20.0, 2.0, 1.0, 10.0)
numbers = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def test_change_of_a_pass_by_hand():
    """Passing 3 m to the north of one 50 m off, at 5 m/s: in 10 s.

    sin a = 5 / sqrt(2509), sin b = 3 / sqrt(2509): cos(a - b) = 0.99920494..., so 2.0039785 m
    more are needed, in 10 s.
    """
    cosine = np.cos(np.arcsin(5 / np.sqrt(2509)) - np.arcsin(3 / np.sqrt(2509)))
    np.testing.assert_allclose(
        resolve_conflict((50.0, -3.0, 0.0), (5.0, 0.0, 0.0), RULES),
        (0, (5 / cosine - 3) / 10, 0),
        atol=1e-12,
    )
    assert (5 / cosine - 3) / 10 == pytest.approx(0.2004, abs=1e-4)


@given(numbers)
def test_changed_velocities_pass_at_the_separation(rng):
    """Closest approach of the changed relative velocity, in closed form."""
    gap = rng.normal(size=3)
    gap *= rng.uniform(6, 60) / np.linalg.norm(gap)
    relative = gap / 5 + rng.normal(0, 0.3, 3)
    time = gap @ relative / (relative @ relative)
    added = np.array(resolve_conflict(tuple(gap), tuple(relative), RULES))
    least = np.linalg.norm(gap - time * relative)
    if least >= 5:
        assert (added == 0).all()
    else:
        after = relative + added
        passed = gap - gap @ after / (after @ after) * after
        assert np.linalg.norm(passed) == pytest.approx(5, rel=1e-9)
        assert added @ relative == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("gap", "relative"),
    [
        ((50.0, 0, 0), (-1.0, 0, 0)),  # going away
        ((50.0, 0, 0), (0.0, 0, 0)),  # at rest
        ((50.0, 0, 0), (2.4, 0, 0)),  # in 20.8 s
        ((50.0, 5.0, 0), (5.0, 0, 0)),  # passing at 5 m
    ],
)
def test_nothing_is_changed_without_a_conflict_ahead(gap, relative):
    assert resolve_conflict(gap, relative, RULES) == (0, 0, 0)


def test_conflicts_that_are_there_are_left():
    """3 m apart, 2 m too near, to be made up for in 1 s."""
    np.testing.assert_allclose(resolve_conflict((0.0, 0, 3.0), (9.0, 0, 0), RULES), (0, 0, -2))


def test_head_on_both_turn_right():
    one = resolve_conflict((50.0, 0, 0), (10.0, 0, 0), RULES)
    other = resolve_conflict((-50.0, 0, 0), (-10.0, 0, 0), RULES)
    assert one[1] < 0
    np.testing.assert_allclose(other, -np.array(one))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_a_pair_changes_places(axis):
    places = 40 * np.array((axis, -np.array(axis)))
    end, least = fly(mvp_velocities, places, -places, RULES._replace(horizon=4.0), 24.0)
    np.testing.assert_allclose(end, -places, atol=0.05)
    assert least >= 4.9  # at ten decisions a second


@given(numbers)
def test_headings_do_not_matter_nor_do_up_and_down(rng):
    state = np.concatenate([rng.uniform(-30, 30, (6, 3)), rng.uniform(-5, 5, (6, 6))], axis=1)
    expected = velocities(mvp_velocities, state, RULES)
    c, s = np.cos(1.0), np.sin(1.0)
    for change_of_axes in (((c, -s, 0), (s, c, 0), (0, 0, 1)), np.diag((1, 1, -1))):
        turn = np.array(change_of_axes)
        moved = (state.reshape(-1, 3, 3) @ turn.T).reshape(-1, 9)
        result = velocities(mvp_velocities, moved, RULES)
        np.testing.assert_allclose(result, expected @ turn.T, atol=1e-6)
