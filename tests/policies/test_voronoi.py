import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from traffic_around import fly, velocities

from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.voronoi import voronoi_half_space, voronoi_velocities

RULES = AvoidanceParameters(2.0, 4.0, 2.0, 1.0, 5.0)
numbers = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def test_side_of_a_cell_by_hand():
    """12 m to the other one: half-way less 1 m are 5 m, in 2 s; 1 m too near, 0.25 m/s back."""
    n, bound = voronoi_half_space((0.0, 12.0, 0.0), RULES)
    np.testing.assert_allclose((*n, bound), (0, -1, 0, -2.5))
    n, bound = voronoi_half_space((0.0, 0.0, -1.0), RULES)
    np.testing.assert_allclose((*n, bound), (0, 0, 1, 0.25))


@given(numbers)
def test_drones_stay_in_their_cells(rng):
    """At the end of the time for braking all are as far apart as they must be, whoever moves."""
    place = rng.uniform(-12, 12, (7, 3))
    gap = np.linalg.norm(place[:, None] - place, axis=-1)
    if gap[~np.eye(7, dtype=bool)].min() < RULES.separation:
        return
    state = np.concatenate([place, rng.uniform(-5, 5, (7, 6))], axis=1)
    chosen = velocities(voronoi_velocities, state, RULES)
    later = place + RULES.braking_time * chosen
    apart = np.linalg.norm(later[:, None] - later, axis=-1)
    assert apart[~np.eye(7, dtype=bool)].min() >= RULES.separation - 1e-6
    # Nearer to the old place of nobody else than to their own one.
    to_place = np.linalg.norm(later[:, None] - place, axis=-1)
    assert (to_place.argmin(axis=1) == np.arange(7)).all()


def test_far_ones_and_velocities_of_others_do_not_matter():
    """Within 2 + 2 * 5 * 2 = 22 m the half-way plane is in reach."""
    own = (0, 0, 0, 0, 0, 0, 5, 0, 0)
    near, far = (21.9, 0, 0), (22.1, 0, 0)
    free = velocities(voronoi_velocities, [own, (*far, -5, 0, 0, 0, 0, 0)], RULES)[0]
    assert np.linalg.norm(free) == pytest.approx(5)
    slow, fast = (
        velocities(voronoi_velocities, [own, (*near, v, 0, 0, 0, 0, 0)], RULES)[0] for v in (0, -5)
    )
    np.testing.assert_array_equal(slow, fast)
    assert slow[0] == pytest.approx(4.975)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_a_pair_changes_places(axis):
    places = 20 * np.array((axis, -np.array(axis)))
    end, least = fly(voronoi_velocities, places, -places, RULES, 40.0)
    np.testing.assert_allclose(end, -places, atol=0.05)
    assert least >= 2 - 1e-6


@given(numbers)
def test_headings_do_not_matter_nor_do_up_and_down(rng):
    state = np.concatenate([rng.uniform(-9, 9, (6, 3)), rng.uniform(-5, 5, (6, 6))], axis=1)
    expected = velocities(voronoi_velocities, state, RULES)
    c, s = np.cos(1.0), np.sin(1.0)
    for change_of_axes in (((c, -s, 0), (s, c, 0), (0, 0, 1)), np.diag((1, 1, -1))):
        turn = np.array(change_of_axes)
        moved = (state.reshape(-1, 3, 3) @ turn.T).reshape(-1, 9)
        result = velocities(voronoi_velocities, moved, RULES)
        np.testing.assert_allclose(result, expected @ turn.T, atol=1e-6)
