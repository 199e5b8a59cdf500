import itertools

import numpy as np
import pytest
from scipy.cluster.vq import kmeans2
from scipy.spatial.distance import cdist, pdist

import bulletuav
from bulletuav.city.model import City
from bulletuav.city.streets import Streets
from bulletuav.geometry.solids import Solids
from bulletuav.policies import find_policy
from bulletuav.policies.coverage_geometry import (
    assign_greedily,
    assign_optimally,
    best_responses,
    farthest_first,
    greedy_coverage,
    kmeans,
    local_search,
    ring_positions,
)
from bulletuav.tasks.los import Los

NAMES = ("centroid", "hotspot", "kmeans", "oracle")
LOW, HIGH = np.array((-100.0, -100)), np.array((100.0, 100))
TWO_CLUSTERS = np.array([(-50, -1), (-50, 1), (-49, 0), (-51, 0), (70, 9), (70, 11)], float)
TURN = np.array([(0.6, -0.8), (0.8, 0.6)])
SHIFT = np.array((7.0, -3.0))


def scattered(seed, count=30):
    return np.random.default_rng(seed).uniform(-90, 90, (count, 2))


def scatter(points, centres):
    """Sum of squared distances to the nearest centre."""
    return (cdist(points, centres).min(axis=1) ** 2).sum()


# Places


def test_rings_by_hand():
    np.testing.assert_allclose(ring_positions(SHIFT, 1, 20.0, LOW, HIGH), [SHIFT])
    np.testing.assert_allclose(
        ring_positions(SHIFT, 2, 20.0, LOW, HIGH), SHIFT + [(10, 0), (-10, 0)], atol=1e-12
    )
    np.testing.assert_allclose(
        ring_positions(SHIFT, 4, 20.0, LOW, HIGH),
        SHIFT + np.sqrt(200) * np.array([(1, 0), (0, 1), (-1, 0), (0, -1)]),
        atol=1e-12,
    )


@pytest.mark.parametrize("count", [2, 3, 7, 16])
def test_neighbours_on_a_ring_are_apart_as_asked(count):
    places = ring_positions(np.zeros(2), count, 20.0, LOW, HIGH)
    assert pdist(places).min() == pytest.approx(20.0)


def test_rings_are_moved_and_shrunk_to_fit():
    moved = ring_positions(np.array((99.0, -99.0)), 5, 20.0, LOW, HIGH)
    assert pdist(moved).min() == pytest.approx(20.0)
    assert np.abs(moved).max() <= 100
    shrunk = ring_positions(SHIFT, 6, 150.0, LOW, HIGH)
    np.testing.assert_allclose(np.linalg.norm(shrunk, axis=1), 100)


def test_the_farthest_come_first():
    points = np.array([(0, 0), (1, 0), (10, 0), (0, 20), (-1, 1)], float)
    np.testing.assert_array_equal(
        farthest_first(points, 4), points[[1, 3, 2, 4]]
    )  # the mean is (2, 4.2)
    np.testing.assert_array_equal(farthest_first(points[:2], 3), points[[0, 1, 0]])


def test_two_clusters_have_two_centres():
    centres = kmeans(TWO_CLUSTERS, farthest_first(TWO_CLUSTERS, 2))
    np.testing.assert_allclose(centres[np.argsort(centres[:, 0])], [(-50, 0), (70, 10)])

    start = np.array([(-40.0, 0), (60, 0), (0, 900)])
    np.testing.assert_allclose(
        kmeans(TWO_CLUSTERS, start), [(-50, 0), (70, 10), (0, 900)]
    )  # without points it stays


@pytest.mark.parametrize("seed", range(4))
def test_means_are_those_of_scipy_and_scatter_less_than_their_start(seed):
    points = scattered(seed)
    start = farthest_first(points, 4)
    centres = kmeans(points, start)
    np.testing.assert_allclose(
        centres, kmeans2(points, start, iter=100, minit="matrix")[0], atol=1e-9
    )
    assert scatter(points, centres) < scatter(points, start)


# Places A to D and the targets that they serve
SERVES = np.array(
    [(1, 1, 1, 1, 0, 0), (1, 1, 0, 0, 1, 0), (0, 0, 1, 1, 0, 1), (0, 0, 0, 0, 0, 0)], float
)
PLACES = np.array([(0.0, 0), (10, 0), (0, 10), (50, 50)])


def test_greedy_coverage_by_hand():
    """A adds four; B and C then add one each, and the nearer goes first.

    Then all is served, and A adds most again.
    """
    distance = np.ones(SERVES.shape)
    distance[1, 4] = 2.0
    assert greedy_coverage(SERVES, distance, PLACES, 4, 0.0).tolist() == [0, 2, 1, 0]
    distance[2, 5] = 3.0
    assert greedy_coverage(SERVES, distance, PLACES, 3, 0.0).tolist() == [0, 1, 2]


def test_places_are_apart_while_there_is_room():
    """12 m from A there is D alone; then C is farthest from both, and next B as it is not taken."""
    places = PLACES + [(0, 0), (0, 0), (0, 1), (0, 0)]
    assert greedy_coverage(SERVES, np.ones(SERVES.shape), places, 4, 12.0).tolist() == [0, 3, 2, 1]


@pytest.mark.parametrize("seed", range(5))
def test_greedy_coverage_keeps_its_guarantee(seed):
    rng = np.random.default_rng(seed)
    service = np.where(rng.random((9, 20)) < 0.2, rng.random((9, 20)), 0.0)
    chosen = greedy_coverage(service, np.ones(service.shape), scattered(seed, 9), 3, 0.0)
    best = max(
        service[list(some)].max(axis=0).sum() for some in itertools.combinations(range(9), 3)
    )
    assert (1 - 1 / np.e) * best <= service[chosen].max(axis=0).sum() <= best


def test_a_drone_leaves_its_place_only_for_a_better_one():
    assert best_responses(SERVES, PLACES, np.array([0, 1]), 0.0).tolist() == [
        2,
        1,
    ]  # C adds as much as A and one more
    assert best_responses(SERVES, PLACES, np.array([2, 1]), 0.0).tolist() == [2, 1]
    nearer = PLACES + [(0, 0), (-9, 0), (0, 0), (0, 0)]
    alike = SERVES.copy()
    alike[1] = alike[2]
    assert best_responses(alike, nearer, np.array([3]), 0.0).tolist() == [0]
    assert best_responses(alike[1:], nearer[1:], np.array([2]), 0.0).tolist() == [
        1
    ]  # B and C add as much, C is nearer
    assert best_responses(alike, nearer, np.array([0, 0]), 11.0).tolist() == [
        3,
        0,
    ]  # D alone is as far from A


def test_local_search_repeats_best_responses_until_no_drone_moves():
    # Greedily from D and D: A adds four, B then one; from A and B the first drone leaves A for C
    found = local_search(SERVES, PLACES, np.array([3, 3]), 0.0)
    assert found.tolist() == best_responses(SERVES, PLACES, found, 0.0).tolist()
    assert SERVES[found].max(axis=0).sum() == 6.0
    assert best_responses(SERVES, PLACES, np.array([3, 3]), 0.0).tolist() != found.tolist()


@pytest.mark.parametrize("seed", range(5))
def test_local_search_never_serves_less(seed):
    rng = np.random.default_rng(seed)
    service = np.where(rng.random((9, 20)) < 0.2, rng.random((9, 20)), 0.0)
    start = rng.integers(9, size=3)
    found = local_search(service, scattered(seed, 9), start, 0.0)
    assert service[found].max(axis=0).sum() >= service[start].max(axis=0).sum()


def test_matches_have_the_least_sum_of_ways():
    places, position = scattered(1, 6), scattered(2, 6)
    sums = [
        np.linalg.norm(places[list(order)] - position, axis=1).sum()
        for order in itertools.permutations(range(6))
    ]
    assert np.linalg.norm(
        assign_optimally(places, position) - position, axis=1
    ).sum() == pytest.approx(min(sums))


def test_the_first_takes_the_nearest_even_when_the_next_has_far_to_go():
    places, position = np.array([(0.0, 0), (10, 0)]), np.array([(1.0, 0), (-50, 0)])
    np.testing.assert_array_equal(assign_greedily(places, position), places)
    np.testing.assert_array_equal(assign_greedily(places[::-1], position), places)
    np.testing.assert_array_equal(assign_optimally(places, position), places[::-1])


# Policies


class Walking(Los):
    """Users walk east, all at once."""

    name = "walking"

    def move_scene(self, scene, time, flying, rngs):
        users = scene.memory["users"].copy()
        moved = super().move_scene(scene, time, flying, rngs)
        users[flying, :, 0] += 3.0 * self.context.period
        scene.memory["users"][:] = users
        return moved


def city_of(*boxes, side=300.0):
    """A city made by hand, of boxes (low corner, high corner)."""
    solids = Solids(np.array(boxes, dtype=float).reshape(-1, 2, 3))
    return City(
        "hand",
        side,
        solids,
        np.arange(len(boxes)),
        Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int)),
    )


TOWER = city_of(((-40, -40, 0), (40, 40, 130)))  # higher than the ceiling
OPEN = city_of(((-5, -5, 0), (5, 5, 10)))


@pytest.fixture
def make():
    made = []

    def build(task="los", num_worlds=1, **options):
        made.append(bulletuav.Aviary(task, num_worlds, dynamics="single_integrator", **options))
        return made[-1]

    yield build
    for aviary in made:
        aviary.close()


def begin(aviary, policy, seeds=0, users=None):
    observations = aviary.reset(seeds=seeds)
    if users is not None:
        aviary.scene.memory["users"][:, :, :2] = users
    policy.reset(np.ones(aviary.num_worlds, bool))
    return observations


def fly(aviary, policy, decisions, seeds=0, users=None):
    """Actions (T, W, N, 3), the share served at the end (W,), and whether anybody failed.

    To fail is to collide or to leave the airspace.
    """
    observations, actions, ended = begin(aviary, policy, seeds, users), [], False
    for _ in range(decisions):
        actions.append(policy.act(observations, aviary.swarm))
        step = aviary.step(actions[-1])
        observations, ended = step.observations, ended or step.terminated.any()
        served = step.info["served"].max(axis=1)
    return np.array(actions), served, ended


@pytest.mark.parametrize("name", NAMES)
def test_tasks_without_targets_are_refused(make, name):
    with pytest.raises(
        ValueError,
        match=f"policy '{name}' places drones over a task's targets, and task 'hover' has none",
    ):
        find_policy(name)(make("hover", action="velocity"))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("action", ["velocity", "velocity_increment"])
def test_drones_come_to_rest_at_their_places_below_the_ceiling(make, name, action):
    aviary = make(num_drones=2, city=OPEN, action=action, horizon=400, ceiling=120.0)
    policy = find_policy(name)(aviary)
    _, served, ended = fly(aviary, policy, 300)
    assert not ended
    np.testing.assert_allclose(
        aviary.swarm.position, policy.goals(aviary.swarm), atol=2.0
    )  # one may push the other
    np.testing.assert_allclose(policy.goals(aviary.swarm)[0, :, 2], (111.6, 110.4))
    assert served == 1


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("kmeans", [(70, 10), (-50, 0)]),
        ("hotspot", [(70, 9), (-50, -1)]),
        ("centroid", TWO_CLUSTERS.mean(axis=0) + [(10, 0), (-10, 0)]),  # min_separation is 20 m
    ],
)
def test_places_by_hand(make, name, expected):
    """Four users in the west and two in the east, and a drone at each end."""
    aviary = make(num_drones=2, num_users=6, city=OPEN)
    policy = find_policy(name)(aviary)
    begin(aviary, policy, users=TWO_CLUSTERS)
    aviary.swarm.position[0, :, 0] = 90, -90
    np.testing.assert_allclose(policy.goals(aviary.swarm)[0, :, :2], expected)


@pytest.mark.parametrize(
    ("name", "turn"), [("centroid", np.eye(2)), ("hotspot", TURN), ("kmeans", TURN)]
)
def test_places_turn_and_move_with_targets_and_drones(make, name, turn):
    """The first place of a ring is always in the east."""
    policy = find_policy(name)(make(city=OPEN))
    targets, position = np.insert(scattered(5), 2, 1.5, axis=1), scattered(6, 3)
    moved = np.insert(targets[:, :2] @ turn.T + SHIFT, 2, 1.5, axis=1)
    expected = policy.places(0, targets, position, None) @ turn.T + SHIFT
    np.testing.assert_allclose(
        policy.places(0, moved, position @ turn.T + SHIFT, None), expected, atol=1e-9
    )


def test_places_in_buildings_give_way(make):
    aviary = make(num_drones=1, num_users=2, city=TOWER)
    policy = find_policy("centroid")(aviary)
    begin(aviary, policy, users=[(-100, 5), (120, 5)])
    x, y, _ = policy.goals(aviary.swarm)[0, 0]
    assert 42 < max(abs(x), abs(y)) < 50


def test_the_oracle_looks_behind_the_tower(make):
    """No place has both users in sight: two drones are needed; means of clusters help none."""
    aviary = make(num_drones=2, num_users=2, city=TOWER)
    policy = find_policy("oracle")(aviary)
    begin(aviary, policy, users=[(-44, 0), (44, 0)])
    places = policy.goals(aviary.swarm)[0]
    seen = aviary.line_of_sight(
        np.repeat(places, 2, axis=0), np.tile([(-44, 0, 1.5), (44, 0, 1.5)], (2, 1))
    ).reshape(2, 2)
    assert sorted(seen.tolist()) == [[False, True], [True, False]]


def test_the_oracle_follows_around_the_tower(make):
    aviary = make(num_drones=1, num_users=2, city=TOWER)
    policy = find_policy("oracle")(aviary)
    begin(aviary, policy)
    for decision, x in ((0, -44), (20, 44), (40, -44)):
        aviary.steps[:], aviary.scene.memory["users"][0] = decision, [(x, -9, 1.5), (x, 9, 1.5)]
        assert aviary.line_of_sight(
            policy.goals(aviary.swarm)[0], aviary.scene.memory["users"][0]
        ).all()
        policy.act(None, aviary.swarm)


@pytest.mark.parametrize("name", NAMES)
def test_the_living_share_the_places_anew(make, name):
    aviary = make(num_drones=3, city=OPEN)
    policy = find_policy(name)(aviary)
    policy.act(begin(aviary, policy), aviary.swarm)
    before = policy.goals(aviary.swarm).copy()
    aviary.alive[0, 1] = False
    after = policy.goals(aviary.swarm).copy()
    alone = make(num_drones=2, city=OPEN)
    twin = find_policy(name)(alone)
    begin(alone, twin, users=aviary.scene.memory["users"][:, :, :2])
    alone.swarm.position[0] = aviary.swarm.position[0, [0, 2]]
    np.testing.assert_allclose(after[0, [0, 2], :2], twin.goals(alone.swarm)[0, :, :2], atol=1e-9)
    assert (after[0, [0, 2]] != before[0, [0, 2]]).any() or name in (
        "hotspot",
        "oracle",
    )  # whose last place was left


@pytest.mark.parametrize("name", ["centroid", "kmeans"])
@pytest.mark.parametrize("hertz", [1, 10])
def test_places_follow_users_every_two_seconds(make, name, hertz):
    aviary = make(Walking, num_drones=2, num_users=6, city=OPEN, decision_hz=hertz)
    policy = find_policy(name)(aviary)
    observations = begin(aviary, policy, users=TWO_CLUSTERS)
    first = policy.goals(aviary.swarm).copy()
    for decision in range(1, 6 * hertz + 1):
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
        moved = (policy.goals(aviary.swarm) - first)[0, :, :2]
        np.testing.assert_allclose(
            moved, [(6 * (decision // (2 * hertz)), 0)] * 2, atol=1e-9
        )  # at 3 m/s


def test_places_stay_while_targets_do(make, monkeypatch):
    aviary = make(num_drones=2, num_worlds=2, city=OPEN)
    policy = find_policy("kmeans")(aviary)
    asked, places = [], policy.places
    monkeypatch.setattr(policy, "places", lambda w, *given: asked.append(w) or places(w, *given))
    fly(aviary, policy, 50)
    assert asked == [0, 1]
    policy.reset(np.array((False, True)))
    policy.goals(aviary.swarm)
    assert asked == [0, 1, 1]


@pytest.mark.parametrize("name", NAMES)
def test_actions_follow_from_the_seed_alone(make, name):
    """Whatever was flown before, and whatever flies in other worlds."""
    aviary = make(num_worlds=2, num_drones=2, area=250.0, num_layouts=2)
    policy = find_policy(name)(aviary)
    first, *_ = fly(aviary, policy, 40, seeds=[3, 4])
    fly(aviary, policy, 25, seeds=[8, 9])
    again, *_ = fly(aviary, policy, 40, seeds=[3, 5])
    assert first[:, 0].tobytes() == again[:, 0].tobytes()
    assert (first[:, 1] != again[:, 1]).any()
    alone = make(num_drones=2, area=250.0, num_layouts=2)
    only, *_ = fly(alone, find_policy(name)(alone), 40, seeds=[3])
    assert only[:, 0].tobytes() == first[:, 0].tobytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "options", [{}, {"num_drones": 6}, {"num_drones": 5, "task": Walking, "decision_hz": 1}]
)
def test_nobody_collides(make, name, options):
    """In the easy city, and between towers higher than the ceiling."""
    options = {"num_layouts": 3, "city": "high_rise" if options else "urban", **options}
    aviary = make(num_worlds=3, ceiling=70.0, **options)
    assert (max(solids.bounds[:, 1, 2].max() for solids in aviary.task.layouts()) > 120) == (
        options["city"] == "high_rise"
    )
    assert not fly(aviary, find_policy(name)(aviary), 40 if "task" in options else 200)[2]


def test_placement_serves_more_than_chance_and_the_oracle_most(make):
    """Means of 12 episodes; over 20 they are 0.4, 0.4, 0.6, 0.9, 0.9 and 1, to 0.07 or less."""
    aviary, served = make(num_worlds=12, num_layouts=4, city="urban", ceiling=120.0), {}
    for name in ("random", "straight", *NAMES):
        served[name] = fly(aviary, find_policy(name)(aviary), 250)[1].mean()
    assert max(served["random"], served["straight"]) + 0.05 < served["centroid"]
    assert served["centroid"] + 0.15 < min(served["hotspot"], served["kmeans"])
    assert max(served["hotspot"], served["kmeans"]) + 0.03 < served["oracle"]
    assert served["oracle"] > 0.95


def test_ground_is_covered_too(make):
    options = {"area": 300.0, "min_separation": 60.0, "city": "urban", "ceiling": 120.0}
    aviary, served = make("coverage", num_worlds=2, **options), {}
    for name in ("straight", *NAMES):
        served[name] = fly(aviary, find_policy(name)(aviary), 150)[1].mean()
    assert served["straight"] + 0.1 < served["kmeans"] < served["oracle"]
