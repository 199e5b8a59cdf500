import numpy as np
import pytest
from swarms import PLACES, place_points
from traffic_around import traffic_of

from bulletuav.geometry.solids import Solids
from bulletuav.policies.half_spaces import AvoidanceParameters, max_conflict_distance
from bulletuav.policies.mvp import mvp_velocities
from bulletuav.policies.orca import orca_velocities
from bulletuav.policies.traffic import FACES, ObstacleClearance

BOX = np.array([[(0.0, 0, 0), (10, 20, 30)]])
PRISM = np.array([(x, y, z) for x, y in ((0, 0), (10, 0), (0, 10)) for z in (0, 30)], float)


def building(place, solids, clear=None):
    """Rows of the buildings about a drone at a place."""
    clear = clear or ObstacleClearance(0.0, 0.0, 50.0)
    return traffic_of([(*place, 0, 0, 0)], solids=solids, clear=clear).surface[0, 0, FACES:]


def test_others_are_seen_from_the_drone():
    state = [(1, 2, 3, 4, 5, 6), (3, 2, 1, -1, 0, 0), (0, 0, 0, 1, 1, 1)]
    traffic = traffic_of(state, balls=[(5, 5, 5, 1, 0, 0, 2)], alive=[True, True, False])
    np.testing.assert_array_equal(traffic.known[0], [[0, 1, 0], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(traffic.offset[0, 0, 1], (2, 0, -2))
    np.testing.assert_array_equal(traffic.other_velocity[0, 0, 1], (-1, 0, 0))
    np.testing.assert_array_equal(traffic.goal[0, 1], (-3, -2, -1))
    np.testing.assert_array_equal(traffic.sphere[0, :, 0], [(4, 3, 2), (2, 3, 4), (5, 5, 5)])
    np.testing.assert_array_equal(traffic.sphere_velocity[0, 2, 0], (1, 0, 0))
    np.testing.assert_array_equal(traffic.sphere_radius[0], [[2], [2], [2]])


def test_faces_of_the_arena_are_as_far_as_the_body_may_go():
    clear = ObstacleClearance(0.5, 9.0, 0.0)
    rows = traffic_of([(1, 2, 3, 0, 0, 0)], box=((-10, -10, 0), (10, 10, 20)), clear=clear).surface
    expected = [
        (1, 0, 0, 10.5), (-1, 0, 0, 8.5), (0, 1, 0, 11.5), (0, -1, 0, 7.5), (0, 0, 1, 2.5),
        (0, 0, -1, 16.5),
    ]  # fmt: skip
    np.testing.assert_allclose(rows[0, 0], expected)


@pytest.mark.parametrize(
    ("place", "surface"),
    [
        ((-5, 10, 10), (-1, 0, 0, 5)),  # of a face
        ((13, 24, 10), (0.6, 0.8, 0, 5)),  # of an edge
        ((12, 22, 31), (2 / 3, 2 / 3, 1 / 3, 3)),  # of a corner
        ((5, 5, 40), (0, 0, 1, 10)),  # of the roof
        ((5, 5, 5), (0, 0, 1, 0)),  # inside, up and out
    ],
)
def test_nearest_surface_of_a_box_by_hand(place, surface):
    np.testing.assert_allclose(building(place, Solids(BOX)), [surface])


@pytest.mark.parametrize(
    ("place", "surface"),
    [
        ((-5, 4, 10), (-1, 0, 0, 5)),
        ((10, 10, 10), (np.sqrt(0.5), np.sqrt(0.5), 0, 10 / np.sqrt(2))),
        ((2, 2, 34), (0, 0, 1, 4)),
        ((-3, -4, 10), (0, -1, 0, 4)),  # at an edge 5 m off, by the plane of the farther face
    ],
)
def test_nearest_face_of_a_prism_by_hand(place, surface):
    solids = Solids(np.zeros((0, 2, 3)), (PRISM,))
    np.testing.assert_allclose(building(place, solids), [surface], atol=1e-12)


def test_buildings_keep_drones_off_by_body_and_margin_within_their_reach():
    solids = Solids(np.concatenate([BOX, BOX + 100]), (PRISM - (40, 0, 0),))
    near = building((-5, 10, 10), solids, ObstacleClearance(0.5, 1.5, 6.0))
    np.testing.assert_allclose(near, [(-1, 0, 0, 3)])
    assert len(building((-5, 10, 10), solids, ObstacleClearance(0.5, 1.5, 4.9))) == 0
    assert len(building((-5, 10, 10), solids)) == 2
    # One row each where another drone has more of them.
    state = [(-5, 10, 10, 0, 0, 0), (500, 0, 10, 0, 0, 0)]
    rows = traffic_of(state, solids=solids).surface[0, 1, FACES:]
    assert np.isinf(rows[:, 3]).all()


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("drones", [199, 300])
def test_orca_has_the_bits_of_all_others_with_only_those_that_are_near(kind, drones):
    rng = np.random.default_rng(drones)
    rules = AvoidanceParameters(1.0, 2.0, 1.0, 1.0, 1.0)
    place = np.round(place_points(rng, kind, drones), 2)
    state = np.stack([place, rng.normal(0.0, 0.5, place.shape)], axis=1)
    alive = rng.random(drones) < 0.9
    wish = rng.normal(0.0, 1.0, (1, drones, 3))
    found = []
    for far in (np.inf, max_conflict_distance(rules)):
        traffic = traffic_of(state, alive=alive, far=far)
        found.append(orca_velocities(traffic, wish, rules))
    assert traffic.known.shape[2] == (drones if drones < 200 else 0)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("kind", PLACES)
def test_mvp_has_the_bits_of_all_others_with_rows_of_those_that_are_near(kind):
    rng = np.random.default_rng(3)
    rules = AvoidanceParameters(1.0, 2.0, 1.0, 1.0, 1.0)
    place = np.round(place_points(rng, kind, 300), 2)
    speed = rng.uniform(-0.5, 0.5, place.shape)
    state = np.stack([place, speed], axis=1)
    alive = rng.random(300) < 0.9
    # Both fly towards each other for the horizon
    reach = rules.separation + rules.horizon * 2.0
    everyone = traffic_of(state, alive=alive)
    near = traffic_of(state, alive=alive, far=reach, searched=False)
    distance = np.linalg.norm(everyone.offset, axis=-1)
    # Rows within the distance, in the order of the indices; rounding is up to the grid
    kept = everyone.known & (distance <= reach)
    assert (near.known.sum(axis=-1) >= kept.sum(axis=-1)).all()
    wish = rng.uniform(-0.5, 0.5, (1, 300, 3))
    found = [mvp_velocities(one, wish, rules) for one in (everyone, near)]
    np.testing.assert_array_equal(*found)
    assert near.position.size == 0


def test_orca_searches_all_drones_if_a_position_is_not_finite():
    rng = np.random.default_rng(0)
    rules = AvoidanceParameters(1.0, 2.0, 1.0, 1.0, 1.0)
    state = rng.uniform(-5.0, 5.0, (250, 2, 3)) * [[[1.0], [0.1]]]
    state[7, 0, 1], state[8, 0, 2] = np.nan, np.inf
    wish = rng.normal(0.0, 1.0, (1, 250, 3))
    found = [
        orca_velocities(traffic_of(state, far=far), wish, rules)
        for far in (np.inf, max_conflict_distance(rules))
    ]
    np.testing.assert_array_equal(*found)
    assert np.isfinite(found[0][0, :7]).all()


@pytest.mark.parametrize("drones", [20, 220])
@pytest.mark.parametrize("step", [0.0, 1e-161, 1e-3])
def test_orca_separates_drones_that_are_nearly_at_one_point(drones, step):
    """The squares of their distances are subnormal numbers, which have no reciprocal."""
    rules = AvoidanceParameters(1.0, 2.0, 1.0, 1.0, 1.0)
    state = np.zeros((drones, 2, 3))
    state[:, 0, 0] = step * np.arange(drones)
    traffic = traffic_of(state, far=max_conflict_distance(rules))
    found = orca_velocities(traffic, np.zeros((1, drones, 3)), rules)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("drones", [20, 220])
@pytest.mark.parametrize("size", [0.5, 20.0])
def test_the_order_of_drones_does_not_matter_to_orca(drones, size):
    """Half-spaces are sorted by distance, also those of a cluster and of one drone far from it."""
    rng = np.random.default_rng(drones)
    rules = AvoidanceParameters(0.1, 2.0, 1.0, 1.0, 30.0)
    state = np.stack([rng.uniform(0, size, (drones, 3)), rng.normal(size=(drones, 3))], axis=1)
    state[3, 0] = (100.0, 0.0, 0.0)
    wish = rng.normal(0.0, 1.0, (1, drones, 3))
    order = rng.permutation(drones)
    far = max_conflict_distance(rules)
    found = orca_velocities(traffic_of(state, far=far), wish, rules)
    shuffled = orca_velocities(traffic_of(state[order], far=far), wish[:, order].copy(), rules)
    np.testing.assert_array_equal(shuffled[0], found[0, order])
