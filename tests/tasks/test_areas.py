"""Cities on rectangles: what is built, flown in, walked on and covered."""

import numpy as np
import pytest

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.city.statistics import KINDS, realised

AREA = (400.0, 200.0)


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
@pytest.mark.parametrize("sides", [(3000.0, 1500.0), (1500.0, 3000.0)])
def test_a_city_on_a_rectangle_has_its_statistics(sides, irregularity):
    made = generate("urban", sides, np.random.default_rng(0), irregularity)
    found = realised(made, KINDS["urban"])
    assert found["built-up share"][0] == pytest.approx(0.3, rel=1e-12)
    assert found["buildings per km2"][0] == pytest.approx(500, rel=0.03)
    assert found["Rayleigh scale of heights, m"][0] == pytest.approx(15, rel=0.05)
    reach = np.abs(made.solids.boxes[..., :2]).max(axis=(0, 1))
    assert (reach < made.sides / 2).all()
    assert (reach > made.sides / 2 - 45).all()  # the last block is not left out
    nodes = made.streets.nodes
    np.testing.assert_allclose(np.abs(nodes).max(axis=0), np.array(sides) / 2)
    middles = nodes[made.streets.edges].mean(axis=1)
    assert made.outdoors(middles).all()


def test_a_square_may_be_told_by_one_number_or_two():
    one, two = (generate("dense", side, np.random.default_rng(3)) for side in (400.0, (400.0,) * 2))
    np.testing.assert_array_equal(one.solids.boxes, two.solids.boxes)


@pytest.mark.parametrize("task", ["default", "navigation", "lidar_navigation", "los", "coverage"])
def test_tasks_fly_within_the_rectangle(task):
    aviary = bulletuav.Aviary(task, 10, area=AREA, dynamics="single_integrator", num_layouts=1)
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.task.arena_high[:2], (200, 100))
    np.testing.assert_array_equal(aviary.task.arena_low[:2], (-200, -100))
    places = np.abs(np.concatenate([aviary.swarm.position, aviary.scene.goal])[..., :2])
    assert (places <= np.array(AREA) / 2 - 8).all()
    assert (places.max(axis=(0, 1)) > (150, 60)).all()
    aviary.close()


def test_the_room_to_each_side_is_that_of_the_rectangle():
    aviary = bulletuav.Aviary("navigation", area=AREA, observation="room", max_range=500.0)
    seen = aviary.reset(seeds=0)[0]
    x, y, z = aviary.swarm.position[0].T
    top = aviary.task.config.ceiling
    expected = np.stack([200 - x, 100 - y, top - z, 200 + x, 100 + y, z], axis=1)
    np.testing.assert_allclose(seen, expected, rtol=1e-5)
    aviary.close()


@pytest.mark.parametrize("mobility", ["gauss_markov", "manhattan", "hotspot", "waypoint"])
def test_users_walk_on_all_of_the_rectangle_and_stay_in_it(mobility):
    aviary = bulletuav.Aviary(
        "mobile_users", 4, area=AREA, mobility=mobility, num_users=50, num_layouts=1
    )
    aviary.reset(seeds=0)
    for _ in range(30):
        aviary.step(np.zeros((4, 3, 3)))
        users = aviary.scene.memory["users"]
        assert (np.abs(users[..., :2]) <= np.array(AREA) / 2 + 1e-9).all()
    assert (np.abs(users[..., :2]).max(axis=(0, 1)) > (170, 80)).all()
    aviary.close()


def test_the_squares_of_coverage_fill_the_rectangle():
    aviary = bulletuav.Aviary("coverage", city="urban", area=AREA, num_layouts=1)
    aviary.reset(seeds=0)
    cells = aviary.task.targets(aviary.scene)[0]
    np.testing.assert_allclose(np.abs(cells[:, :2]).max(axis=0), (195, 95))
    assert len(cells) == pytest.approx(0.7 * 400 * 200 / 100, rel=0.05)
    aviary.close()
