"""Task `coverage`: what is covered, and what it costs to be near each other."""

import numpy as np
import pytest
from placing import city_of
from scipy.spatial.distance import pdist
from urban import STAY, TOWER, blocked

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.tasks.parts import city_layouts
from bulletuav.tasks.targets import compute_seen_fraction


def share_seen(drones, city):
    """Share of the 10 m squares that each drone sees (N,), and that any sees, by `blocked`."""
    middle = np.arange(-95.0, 100, 10)
    low, high = city.solids.boxes[0]
    cells = [
        (x, y, 1.5)
        for x in middle
        for y in middle
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1])
    ]
    seen = np.array([[not blocked(drone, cell, (low, high)) for cell in cells] for drone in drones])
    return seen.mean(axis=1), seen.any(axis=0).mean(), seen.shape[1]


def test_everything_is_covered_where_nothing_stands(put_urban):
    step = put_urban("coverage", city_of(), [(13.0, 7, 20)], horizon=1).step(np.zeros((1, 1, 3)))
    assert step.info["reward/covered"][0, 0] == pytest.approx(1)
    assert step.info["success"].all()
    assert step.observations[0, 0, -1] == 1


def test_a_tower_hides_what_lies_behind_it(put_urban):
    drones = [(-60.3, 3.1, 25.7), (-33.7, 62.2, 33.3)]
    own, all_of_them, squares = share_seen(drones, TOWER)
    assert squares == 400 - 4
    assert (own < 0.97).all()
    assert own.max() < all_of_them < 1
    aviary = put_urban("coverage", TOWER, drones, wanted=all_of_them)
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(step.info["reward/covered"][0], all_of_them)
    np.testing.assert_allclose(step.observations[0, :, -1], own, rtol=1e-6)
    alone = put_urban("coverage", TOWER, drones[:1]).step(np.zeros((1, 1, 3)))
    np.testing.assert_allclose(alone.info["reward/covered"][0], own[0])


def test_a_drone_that_left_covers_nothing(put_urban):
    drones = [(-60.3, 3.1, 3.7), (61.7, 2.2, 33.3)]
    aviary = put_urban("coverage", TOWER, drones)
    while aviary.alive.all():
        aviary.step(np.array([[(0, 0, -1.0), STAY]]))
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(
        step.info["reward/covered"][0], (0, share_seen(drones[1:], TOWER)[1])
    )


def test_drones_that_are_near_each_other_all_pay_the_same(put_urban):
    """Three, 42 to 60 m from each other, pay 0.2 for each of the other two.

    The fourth is 120 m away from all.
    """
    drones = [(-90, -50, 3), (-60, -20, 40), (-90, 10, 40), (70, -20, 40)]
    assert (pdist(drones[:3]) < 100).all()
    aviary = put_urban("coverage", TOWER, drones)
    step = aviary.step(np.zeros((1, 4, 3)))
    assert step.info["reward/close"][0].tolist() == [-0.4, -0.4, -0.4, 0]
    while aviary.alive.all():
        aviary.step(np.array([[(0, 0, -1.0), STAY, STAY, STAY]]))
    step = aviary.step(np.zeros((1, 4, 3)))
    assert step.info["reward/close"][0].tolist() == [0, -0.2, -0.2, 0]


@pytest.fixture
def unequal(monkeypatch):
    """Two layouts, with 256 and 396 squares outdoors.

    The drones see the first square, which fills up the shorter list.
    """
    block = city_of(((-60, -60, 0), (60, 60, 30)))
    monkeypatch.setattr(city_layouts, "make_cities", lambda config, drones: (block, TOWER))
    return [(-80.3, -3.1, 25.7)], (block, TOWER)


def test_layouts_of_unequal_size_count_their_own_squares(put_urban, unequal):
    drones, cities = unequal
    aviary = put_urban("coverage", None, drones)
    for layout in (0, 1):
        seed = next(
            k
            for k in range(20)
            if aviary.reset(seeds=k) is not None and aviary.scene.layout[0] == layout
        )
        aviary.reset(seeds=seed)
        assert aviary.task.active_targets(aviary.scene).sum() == (256, 396)[layout]
        step = aviary.step(np.zeros((1, 1, 3)))
        np.testing.assert_allclose(
            step.info["reward/covered"][0], share_seen(drones, cities[layout])[1]
        )


def test_the_share_that_a_drone_sees_is_that_of_the_squares_there_are(put_urban, unequal):
    drones, cities = unequal
    aviary = put_urban("coverage", None, drones)
    for seed in range(10):
        observation = aviary.reset(seeds=seed)
        own = share_seen(drones, cities[aviary.scene.layout[0]])[0]
        np.testing.assert_allclose(observation[0, :, -1], own, rtol=1e-6)


def test_everything_seen_is_all_of_it_exactly():
    """644 squares: 644 times 1 / 644 would be less than 1."""
    task = EnvSpec("coverage", 1, {"area": 300.0, "num_layouts": 1, "wanted": 1.0}).task
    everything = np.ones((1, task.num_targets), dtype=bool)
    nothing = np.zeros_like(everything)
    assert compute_seen_fraction(everything, everything).tolist() == [1.0]
    assert compute_seen_fraction(everything, nothing).tolist() == [0.0]
