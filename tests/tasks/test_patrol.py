"""Task `patrol`: idleness, visits, reward, success, and its observation."""

import contextlib

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.patrol import find_tour
from bulletuav.tasks.patrol import visit

OPEN = {
    "city": "open",
    "area": 120.0,
    "num_drones": 2,
    "dynamics": "single_integrator",
    "min_separation": 5.0,
    "charging_pads": ((0.0, 0.0),),
}
"""16 squares of 30 m, with centres at -45, -15, 15 and 45 m"""
STAY = np.zeros((1, 2, 3))


def aviary_of(start=((-45.0, -45.0, 20.0), (45.0, 45.0, 20.0)), **options):
    aviary = bulletuav.Aviary("patrol", 1, start=start, **{**OPEN, **options})
    aviary.reset(seeds=0)
    return aviary


def test_idleness_is_the_time_since_the_last_visit():
    with contextlib.closing(aviary_of()) as aviary:
        for k in range(1, 9):
            step = aviary.step(STAY)
            idle = aviary.scene.memory["idleness"][0]
            # Two squares of 16 are visited; a decision takes 0.5 s
            assert sorted(idle) == [0.0, 0.0, *([0.5 * k] * 14)]
            assert step.info["idleness"][0, 0] == pytest.approx(0.5 * k * 14 / 16)
            expected = 1 - 0.5 * k / 180 * 14 / 16
            assert step.info["reward/freshness"][0, 1] == pytest.approx(expected)
        mean = np.mean([0.5 * k * 14 / 16 for k in range(1, 9)])
        assert step.info["average_idleness"][0, 0] == pytest.approx(mean)


def test_squares_that_are_overdue_cost_reward():
    with contextlib.closing(aviary_of(max_idleness=1.25)) as aviary:
        # Idleness of 0.5, 1.0 and 1.5 s
        shown = [aviary.step(STAY).info["reward/overdue"][0].tolist() for _ in range(3)]
        assert shown == [[0.0, 0.0], [0.0, 0.0], [-0.25, -0.25]]


def test_visits_need_sight_and_nearness_and_are_shared():
    cells = np.array([[(0.0, 0.0, 1.5), (30.0, 0.0, 1.5), (60.0, 0.0, 1.5), (0.0, 0.0, 1.5)]])
    position = np.array([[(12.0, 16.0, 40.0), (19.0, 0.0, 40.0), (60.0, 20.1, 5.0)]])
    seen = np.ones((1, 3, 4), dtype=bool)
    active = np.array([[True, True, True, False]])
    idle, visited = np.full((1, 4), 59.5), np.full((1, 3), 9.0)
    idle[0, 3] = 0.0
    limits = (20.0, 50.0, 0.5)
    visit(position, seen, np.ones(1, dtype=bool), cells, active, *limits, idle, visited)
    np.testing.assert_array_equal(idle, [[0.0, 0.0, 60.0, 0.0]])
    # 50 of 60 s count, of each of three squares; the first is shared by two drones
    np.testing.assert_allclose(visited, [[1 / 6, 1 / 6 + 1 / 3, 0.0]])
    seen[0, :, 1] = False
    visit(position, seen, np.ones(1, dtype=bool), cells, active, *limits, idle, visited)
    np.testing.assert_array_equal(idle, [[0.0, 0.5, 60.5, 0.0]])
    visit(position, seen, np.zeros(1, dtype=bool), cells, active, *limits, idle, visited)
    np.testing.assert_array_equal(idle, [[0.0, 0.5, 60.5, 0.0]])


def test_idleness_is_observed():
    with contextlib.closing(aviary_of()) as aviary:
        for _ in range(4):
            step = aviary.step(STAY)
        mean, *rows = step.observations[0, 0, aviary.observer.slices["idleness"]]
        squares = np.reshape(rows, (13, 3))
        assert mean == pytest.approx(2.0 * 14 / 16)
        # The most idle square, then the nearest ones: the own one, and two at 30 m
        assert squares[0, 2] == 2.0
        # Viewpoints are the places nearest to the centres on a raster of 4 m: 1 m beside them
        np.testing.assert_allclose(squares[1], (-1.0, -1.0, 0.0))
        assert sorted(map(tuple, squares[2:4].tolist())) == [(-1.0, 31.0, 2.0), (31.0, -1.0, 2.0)]
        distance = np.linalg.norm(squares[1:, :2], axis=1)
        assert (np.diff(distance) >= -1e-5).all()


@pytest.mark.parametrize(
    ("options", "succeeds"),
    [
        ({}, True),
        ({"max_idleness": 19.0}, False),
        ({"battery_capacity": 0.2}, False),
        ({"battery_capacity": 0.05}, False),
    ],
)
def test_success_is_no_old_square_and_all_drones_at_the_end(options, succeeds):
    """70 W empty 0.2 W h in 10.3 s; squares are 20 s old at the end."""
    with contextlib.closing(aviary_of(horizon=40, **options)) as aviary:
        while aviary.alive.any():
            step = aviary.step(STAY)
            if aviary.steps[0] < 40:
                assert not step.info["success"].any()
        assert step.info["success"].all() == succeeds
        assert step.info["success"].any() == succeeds


def test_the_first_half_is_not_judged():
    with contextlib.closing(aviary_of(horizon=40)) as aviary:
        for _ in range(19):
            step = aviary.step(STAY)
        assert step.info["worst_idleness"][0, 0] == 0.0
        step = aviary.step(STAY)
        assert step.info["worst_idleness"][0, 0] == 10.0


def test_an_empty_battery_is_paid_for():
    with contextlib.closing(aviary_of(battery_capacity=0.02)) as aviary:
        earned = 0.0
        while aviary.alive.any():
            step = aviary.step(STAY)
            earned += step.info["reward/empty"]
        np.testing.assert_array_equal(earned, [[-100.0, -100.0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"visit_radius": 0.0}, "visit_radius is 0: it must be above 0"),
        ({"max_idleness": 0.0}, "max_idleness is 0: it must be above 0"),
        ({"cell": 500.0}, "cell is 500 m: it must be above 0 and at most the side"),
    ],
)
def test_wrong_options_are_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        aviary_of(**options)


def test_tours_are_short():
    side = np.arange(4.0)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    order = find_tour(distance)
    assert sorted(order) == list(range(16))
    length = distance[order, np.roll(order, -1)].sum()
    assert length <= 16 + 2 * (np.sqrt(2) - 1) + 1e-9  # the shortest tour is 16 long


def test_policies_need_pads():
    without = aviary_of(charging_pads=0)
    with pytest.raises(ValueError, match="there are none: set charging_pads to 1"):
        find_policy("patrol_reactive", "patrol")(without)
    without.close()
    other = bulletuav.Aviary("hover", 1, action="velocity")
    with pytest.raises(ValueError, match="supports task 'patrol', not 'hover'"):
        find_policy("patrol_reactive", "hover")(other)
    other.close()


@pytest.mark.parametrize("name", ["patrol_reactive", "patrol_cyclic", "patrol_oracle"])
def test_drones_patrol_and_charge(name):
    with contextlib.closing(aviary_of(battery_capacity=1.2)) as aviary:
        policy = find_policy(name, "patrol")(aviary)
        policy.reset(np.ones(1, dtype=bool))
        observations = aviary.observations()
        charged = np.zeros((1, 2), dtype=bool)
        for _ in range(300):
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
            charged |= step.info["charging"]
        assert charged.all()
        assert aviary.alive.all()
        assert aviary.scene.memory["violations"].max() == 0
        assert aviary.scene.memory["idleness"].max() < 80.0


def test_the_oracle_leaves_squares_and_pads_to_drones_that_fly_to_them():
    with contextlib.closing(aviary_of()) as aviary:
        policy = find_policy("patrol_oracle", "patrol")(aviary)
        policy.reset(np.ones(1, dtype=bool))
        policy.act(aviary.observations(), aviary.swarm)
        here = aviary.swarm.position[0]
        policy._mode[0], policy._square[0, 1] = [1, 0], [30.0, 40.0]
        np.testing.assert_allclose(policy.others(0, 0), [[30.0, 40.0] - here[0, :2]])
        assert policy.others(0, 1).size == 0  # the other one charges
        assert len(policy.squares(0, 0)) == aviary.task.active_targets(aviary.scene)[0].sum()
        pads = policy._pads(0, 0)
        assert not pads[:, 3].any()
        policy._mode[0, 1] = 1
        policy._target[0, 1] = here[0] + pads[0, :3]
        np.testing.assert_array_equal(policy._pads(0, 0)[:, 3], [1.0] + [0.0] * (len(pads) - 1))
        policy._target[0, 1, 2] = policy.height[1]  # waits above it
        assert not policy._pads(0, 0)[:, 3].any()


def test_those_that_never_charge_fall_down_in_the_end():
    with contextlib.closing(aviary_of(battery_capacity=0.4)) as aviary:
        policy = find_policy("patrol_reckless", "patrol")(aviary)
        policy.reset(np.ones(1, dtype=bool))
        observations = aviary.observations()
        for _ in range(100):
            observations = aviary.step(policy.act(observations, aviary.swarm)).observations
        assert not aviary.alive.any()
