"""Task `search`: sightings, finds, searched squares, radio, rewards and ends."""

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks.search import HALF_HEIGHT, make_grid

FLAT = {"dynamics": "single_integrator", "sight_noise": 0.0}


def made(start=None, **options):
    aviary = bulletuav.Aviary("search", **FLAT, start=start, **options)
    aviary.reset(seeds=0)
    return aviary


def top_of(**options):
    """Return the tops of the victims of the first episode."""
    aviary = made(**options)
    tops = aviary.task.tops(aviary.scene)[0].copy()
    aviary.close()
    return tops


def at(offsets, **options):
    """Return an aviary whose drones start at offsets from the top of the first victim."""
    drones = len(offsets)
    top = top_of(num_drones=drones, **options)[0]
    return made(start=tuple(map(tuple, top + np.array(offsets))), num_drones=drones, **options)


def stay(aviary, decisions=1):
    for _ in range(decisions):
        step = aviary.step(np.zeros((*aviary.alive.shape, 3)))
    return step


def blocks(aviary, step):
    return aviary.observer.split(step.observations)


def test_a_hover_of_two_seconds_finds_the_victim_and_ends_the_episode():
    aviary = at([(0.6, 0.6, 3.0)])  # 0.85 m aside
    step = stay(aviary, 19)
    assert not step.terminated.any()
    assert step.info["found"] == 0
    step = stay(aviary)
    assert step.terminated.all()
    assert step.info["success"].all()
    assert step.info["found"] == step.info["finds"] == 1
    assert step.info["find_time"] == step.info["find_1"] == pytest.approx(2.0)
    assert step.rewards[0, 0] == pytest.approx(100.0 - 0.1)
    aviary.close()


@pytest.mark.parametrize(
    "offset", [(0.0, 0.0, 1.9), (0.0, 0.0, 4.1), (0.8, 0.8, 3.0)], ids=("low", "high", "aside")
)
def test_a_hover_elsewhere_finds_nothing(offset):
    aviary = at([offset])
    step = stay(aviary, 40)
    assert step.info["found"] == 0
    assert not step.terminated.any()
    aviary.close()


def test_an_interrupted_hover_starts_again():
    aviary = at([(0.0, 0.0, 3.9)])
    stay(aviary, 15)
    for climb in (0.5, -0.5):  # 0.5 m up, out of the hover, and down again
        step = aviary.step(np.array([[[0.0, 0.0, climb]]]))
    step = stay(aviary, 18)
    assert step.info["found"] == 0
    assert stay(aviary).info["found"] == 1
    aviary.close()


def test_a_touch_is_a_collision_without_success():
    aviary = at([(0.0, 0.0, 1.5)])
    while aviary.alive.any():
        step = aviary.step(np.array([[[0.0, 0.0, -0.5]]]))
    assert step.info["collision"].all()
    assert not step.info["success"].any()
    left = aviary.options.horizon - int(aviary.steps[0])
    assert left > 500
    assert step.rewards[0, 0] == pytest.approx(-50 - 0.1 * (1 + left))
    aviary.close()


@pytest.mark.parametrize(("aside", "is_seen"), [(9.9, True), (10.1, False)])
def test_victims_are_seen_within_the_radius(aside, is_seen):
    aviary = at([(aside, 0.0, 5.0)])
    seen = blocks(aviary, stay(aviary))["sighting"][0, 0]
    expected = (1.0, -aside, 0.0, -5.0) if is_seen else (0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(seen, expected, atol=1e-5)
    aviary.close()


def test_the_noise_of_a_sighting_grows_with_its_distance():
    errors = []
    for height in (2.5, 12.5):
        top = top_of(num_drones=1)[0]
        aviary = bulletuav.Aviary(
            "search", 200, dynamics="single_integrator", start=(tuple(top + (0.0, 0.0, height)),)
        )
        aviary.reset(seeds=0)  # the same victim nowhere but in the first world
        step = stay(aviary)
        seen = blocks(aviary, step)["sighting"][:, 0]
        true = aviary.task.tops(aviary.scene)[:, 0] - aviary.swarm.position[:, 0]
        is_seen = seen[:, 0] > 0
        distance = np.linalg.norm(true[is_seen], axis=1, keepdims=True)
        errors.append((seen[is_seen, 1:] - true[is_seen]) / distance)
        aviary.close()
    assert np.concatenate(errors).std() == pytest.approx(0.05, rel=0.15)


def test_a_square_is_searched_within_reach_and_counts_once():
    aviary = made(start=((0.0, 0.0, 10.0),), weights={"time": 0.0})
    step = stay(aviary)
    memory = aviary.scene.memory
    # A square of 7.5 m, all of which is within 10 m of the drone: 10 - 7.5 / sqrt(2)
    gap = np.linalg.norm(memory["cell"][0, :, :2], axis=1)
    expected = (gap <= 10 - 7.5 / np.sqrt(2)) & (memory["has_ground"][0] > 0)
    np.testing.assert_array_equal(memory["own_cells"][0, 0] > 0, expected)
    fraction = expected.sum() / memory["has_ground"][0].sum()
    assert step.rewards[0, 0] == pytest.approx(10 * fraction)
    assert stay(aviary).rewards[0, 0] == 0
    known = blocks(aviary, step)["searched_cells"][0, 0]
    np.testing.assert_array_equal(known > 0.5, expected | (memory["has_ground"][0] == 0))
    aviary.close()


def test_squares_that_two_drones_search_together_are_shared_and_overlap():
    places = ((0.0, 0.0, 10.0), (0.0, 0.0, 20.0))
    aviary = made(start=places, num_drones=2, weights={"time": 0.0})
    step = stay(aviary)
    memory = aviary.scene.memory
    count = memory["own_cells"][0, 0].sum() / memory["has_ground"][0].sum()
    np.testing.assert_allclose(step.rewards[0], [5 * count, 5 * count])
    np.testing.assert_array_equal(step.info["overlap"], [[float(count > 0)] * 2])
    aviary.close()


@pytest.mark.parametrize("radio_range", [20.0, 5.0])
def test_drones_share_finds_and_squares_within_the_range_of_the_radio(radio_range):
    aviary = at([(0.0, 0.0, 3.0), (12.0, 0.0, 3.0)], num_victims=2, radio_range=radio_range)
    step = stay(aviary, 20)
    assert (step.info["found"] == 0.5).all()
    memory = aviary.scene.memory
    np.testing.assert_array_equal(memory["known_found"][0].sum(axis=1), [1.0, 0.0])
    step = stay(aviary)  # a message takes one decision
    shares = radio_range > 12
    np.testing.assert_array_equal(memory["known_found"][0].sum(axis=1), [1.0, float(shares)])
    np.testing.assert_allclose(blocks(aviary, step)["victims_found"][0, 1], 0.5 * shares)
    own = memory["own_cells"][0]
    assert (own[0] != own[1]).any()
    both = own.max(axis=0) if shares else own[1]
    np.testing.assert_array_equal(memory["known_cells"][0, 1], both)
    aviary.close()


def test_a_drone_that_lost_its_radio_learns_nothing():
    lossy = {"radio_loss": 1.0}
    aviary = at([(0.0, 0.0, 3.0), (12.0, 0.0, 3.0)], num_victims=2, randomization=lossy)
    stay(aviary, 40)  # hears the start, which it keeps for a second
    np.testing.assert_array_equal(aviary.scene.memory["known_found"][0].sum(axis=1), [1.0, 0.0])
    aviary.close()


def test_approach_is_paid_for_the_victim_in_sight_alone():
    options = {"weights": {"approach": 1.0, "time": 0.0, "searched": 0.0}}
    aviary = at([(6.0, 0.0, 3.0)], **options)
    west = np.array([[[-0.5, 0.0, 0.0]]])
    rewards = [aviary.step(west).rewards[0, 0], aviary.step(west).rewards[0, 0]]
    np.testing.assert_allclose(rewards, [0.0, 0.5], atol=1e-9)  # first seen after the first
    assert aviary.step(-west).rewards[0, 0] == pytest.approx(-0.5)
    aviary.close()


@pytest.mark.parametrize("city", ["open", "forest", "wooded_hills", "urban"])
def test_victims_are_near_the_clue_on_free_ground(city):
    aviary = bulletuav.Aviary(
        "search", 4, city=city, num_victims=4, num_drones=2, dynamics="point_mass", num_layouts=2
    )
    aviary.reset(seeds=1)
    for w, layout in enumerate(aviary.scene.layout.tolist()):
        ground = aviary.task.city_layouts.cities[layout]
        body, clue = aviary.scene.obstacle[w], aviary.scene.memory["clue"][w]
        away = np.linalg.norm(body[:, :2] - clue[:2], axis=1)
        assert away.max() <= 30
        assert ground.outdoors(body, 1.0).all()
        np.testing.assert_allclose(body[:, 2] - HALF_HEIGHT, ground.surface(body))
        gaps = np.linalg.norm(body[:, None, :2] - body[None, :, :2], axis=-1)
        assert gaps[np.triu_indices(4, 1)].min() >= 8
        start = np.linalg.norm(aviary.swarm.position[w, :, :2] - clue[:2], axis=1)
        assert (start >= 20).all()
        assert (start <= 50).all()
    aviary.close()


def test_squares_divide_the_ground_around_the_clue():
    grid = make_grid(30.0, 8.0)
    assert len(grid) == 64
    np.testing.assert_allclose(grid[0], (-26.25, -26.25))
    np.testing.assert_allclose(grid[1], (-26.25, -18.75))
    np.testing.assert_allclose(grid.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_obstacles": 3}, "unknown option of task 'search'.*'num_obstacles'"),
        ({"hover_height": (4.0, 2.0)}, "hover_height"),
        ({"hover_time": 0.0}, "hover_time"),
        ({"hover_radius": 11.0}, "hover_radius"),
        ({"cell": 15.0}, "cell is 15"),
        ({"clue_radius": 200.0}, "clue_radius"),
        ({"area": 70.0}, "area is 70"),
        ({"start_distance": (50.0, 20.0)}, "start_distance"),
        ({"num_victims": 64}, "64 victims"),
    ],
)
def test_invalid_options_raise_errors_with_a_remedy(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary("search", dynamics="point_mass", **options).reset(seeds=0)


def test_the_baseline_finds_victims_from_its_observation_and_the_oracle_sooner():
    found = {
        policy: bulletuav.evaluate(
            "search", policy, 2, dynamics="point_mass", difficulty="medium", num_layouts=1
        ).rows
        for policy in ("sweep", "rescue_oracle")
    }
    assert all(row["safe_success"] == 1 for rows in found.values() for row in rows)
    times = {policy: np.mean([row["find_time"] for row in rows]) for policy, rows in found.items()}
    assert times["rescue_oracle"] < times["sweep"]


@pytest.mark.parametrize(
    "policy", ["search_at_clue", "search_from_above", "search_map", "search_touch"]
)
def test_policies_that_avoid_the_task_find_nothing(policy):
    rows = bulletuav.evaluate("search", policy, 2, dynamics="point_mass").rows
    assert all(row["found"] == row["safe_success"] == 0 for row in rows)
    assert all(row["return"] < -45 for row in rows)
