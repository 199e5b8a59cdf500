"""Task `flocking`: flight in the flock, the leader, rewards, and invalid options."""

import math

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks.flocking import lattice_radius

POINTS = {"dynamics": "single_integrator", "difficulty": "easy"}
SQUARE = ((-5.0, -5, 40), (5.0, -5, 40), (-5.0, 5, 40), (5.0, 5, 40))
"""Four starts, linked"""


def made(**options):
    given = {**POINTS, "num_drones": 4, "start": SQUARE, "leader_distance": 0.0, **options}
    given["weights"] = {"energy": 0.0}  # random starting velocities
    aviary = bulletuav.Aviary("flocking", **given)
    aviary.reset(seeds=0)
    return aviary


def fly(aviary, velocity):
    """Fly a decision at given velocities, m/s."""
    full = np.broadcast_to(np.asarray(velocity, dtype=float), aviary.swarm.position.shape)
    return aviary.step(aviary.action.encode(full))


def leader_velocity(aviary):
    return aviary.scene.goal_velocity[0, 0].copy()


def test_drones_that_fly_as_the_leader_do_are_in_the_flock():
    aviary = made(leader_turn=0.0)
    step = fly(aviary, leader_velocity(aviary))
    assert step.info["in_place"].all()
    assert step.info["order"][0].tolist() == [1] * 4
    assert step.info["connectivity"][0].tolist() == [1] * 4
    # flocking 2, alignment 0.5, cohesion 0.5, and the leader's speed
    np.testing.assert_allclose(step.rewards[0], 3.0, atol=1e-9)
    aviary.close()


@pytest.mark.parametrize(
    ("factor", "in_flock"), [(0.51, True), (0.49, False), (0.0, False), (2.0, True)]
)
def test_slow_drones_are_not_in_the_flock(factor, in_flock):
    aviary = made(leader_turn=0.0)
    step = fly(aviary, factor * leader_velocity(aviary))
    assert (step.info["in_place"] == in_flock).all()
    assert (step.info["order"] == in_flock).all()
    # time -0.5 outside the flock, and the difference to 6 m/s
    expected = (3.0 if in_flock else 0.5 - 0.5) - 0.1 * abs(factor - 1) * 6
    np.testing.assert_allclose(step.rewards[0], expected, atol=1e-9)
    aviary.close()


def test_drones_in_two_directions_are_not_in_the_flock():
    aviary = made()
    step = fly(aviary, [[(6, 0, 0), (6, 0, 0), (0, 6, 0), (6, 0, 0)]])
    assert step.info["order"][0, 0] == pytest.approx(math.sqrt(10) / 4)
    assert not step.info["in_place"].any()
    aviary.close()


def test_one_drone_that_flies_astray_is_out_of_an_orderly_flock():
    start = [(10.0 * k - 20, 10.0 * m - 20, 40.0) for k in range(5) for m in range(5)]
    aviary = made(num_drones=25, start=start)
    velocity = np.tile((6.0, 0, 0), (1, 25, 1))
    velocity[0, 12] = (0, 6.0, 0)
    step = fly(aviary, velocity)
    # |(24, 1)| / 25; the others' mean cosine is 23 / 24, above min_order, and its own is 0
    assert step.info["order"][0, 0] == pytest.approx(math.hypot(24, 1) / 25)
    assert np.flatnonzero(step.info["in_place"][0] == 0).tolist() == [12]
    aviary.close()


def test_half_of_the_drones_are_no_flock():
    two_and_two = ((0.0, 0, 40), (10.0, 0, 40), (0.0, 40, 40), (10.0, 40, 40))
    aviary = made(start=two_and_two, looseness=100.0)
    step = fly(aviary, leader_velocity(aviary))
    assert not step.info["in_place"].any()
    assert step.info["connectivity"][0].tolist() == pytest.approx([2 / 3] * 4)
    three_and_one = ((0.0, 0, 40), (10.0, 0, 40), (0.0, 10, 40), (10.0, 40, 40))
    other = made(start=three_and_one, looseness=100.0)
    step = fly(other, leader_velocity(other))
    assert step.info["in_place"][0].tolist() == [1, 1, 1, 0]
    aviary.close()
    other.close()


def test_drones_far_from_the_leader_are_not_in_the_flock():
    aviary = made(leader_distance=60.0, leader_turn=0.0)
    step = fly(aviary, leader_velocity(aviary))
    assert not step.info["in_place"].any()
    distance = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
    expected = 0.5 + 0.5 - 0.5 - 0.05 * (distance - aviary.task.flock_radius)
    np.testing.assert_allclose(step.rewards, expected, atol=1e-6)
    aviary.close()


def test_without_a_leader_the_flock_may_fly_anywhere():
    aviary = made(leader=False)
    assert (aviary.scene.goal == (0, 0, 40)).all()
    for _ in range(3):
        step = fly(aviary, (0, 6, 0))
    assert (aviary.scene.goal == (0, 0, 40)).all()
    assert not aviary.scene.goal_velocity.any()
    assert step.info["in_place"].all()
    np.testing.assert_allclose(step.rewards[0], 3.0, atol=1e-9)
    aviary.close()


def test_the_leader_flies_at_its_speed_within_the_arena():
    aviary = bulletuav.Aviary("flocking", 3, leader_turn=0.5, roam=30.0, **POINTS)
    aviary.reset(seeds=1)
    courses = []
    for _ in range(300):
        before = aviary.scene.goal.copy()
        aviary.step(aviary.action.encode(np.zeros(aviary.swarm.position.shape)))
        np.testing.assert_allclose(np.linalg.norm(aviary.scene.goal - before, axis=-1), 0.6)
        reach = np.linalg.norm(aviary.scene.goal[..., :2], axis=-1).max()
        # It starts 40 m away
        assert reach <= max(40.0, aviary.task.wanderer.reach())
        courses.append(aviary.scene.memory["course"].copy())
    assert (np.ptp(courses, axis=0) > 0.5).all()
    assert (aviary.scene.goal[..., 2] == 40).all()
    aviary.close()


@pytest.mark.parametrize("drones", [1, 5, 200])
def test_starts_are_clear_of_each_other_and_in_an_arena_that_grows(drones):
    aviary = bulletuav.Aviary("flocking", 2, **{**POINTS, "num_drones": drones})
    aviary.reset(seeds=2)
    task, position = aviary.task, aviary.swarm.position
    radius = 10 * math.sqrt(math.sqrt(3) * drones / (2 * math.pi))
    assert lattice_radius(drones, 10.0) == pytest.approx(radius)
    assert task.flock_radius == pytest.approx(1.3 * radius)
    assert np.linalg.norm(position[..., :2], axis=-1).max() <= 2 * radius + math.sqrt(2) * 0.5
    gap = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    assert (gap + 1e9 * np.eye(drones)).min() > 10.0
    # 100 m, half a circle of 6 m/s at 3 m/s^2, and the margin
    expected = max(100 + 24 + 1.3 * radius, 2 * radius) + 30
    assert task.arena_high[0] == pytest.approx(expected)
    aviary.close()


def test_success_needs_time_in_the_flock_and_safety():
    aviary = made(leader_turn=0.0, horizon=10)
    for k in range(10):
        step = fly(aviary, leader_velocity(aviary) if k < 6 else (0, 0, 0))
        assert step.info["success"].all() == (k >= 5)
    aviary.close()
    close = ((-5.0, -5, 40), (0.1, -5, 40), (-5.0, 5, 40), (5.0, 5, 40))
    aviary = made(leader_turn=0.0, horizon=10, start=close)
    step = fly(aviary, leader_velocity(aviary))
    towards = np.zeros((1, 4, 3))
    towards[0, 0] = (4.0, 0, 0)
    for _ in range(9):
        step = fly(aviary, leader_velocity(aviary) + towards)
        towards[:] = 0.0
    assert step.info["success"][0].tolist() == [False, False, True, True]
    aviary.close()


def test_starts_of_large_swarms_are_as_dense_as_a_loose_lattice():
    task = bulletuav.Aviary("flocking", num_drones=400, **POINTS).task
    start = task.spawn(np.random.default_rng(0)).position
    radius = np.linalg.norm(start[:, :2], axis=1)
    # 65 m beyond the lattice, plus jitter and the offset of the lattice
    assert radius.max() == pytest.approx(
        math.sqrt(math.sqrt(3) * 400 / (2 * math.pi)) * 10 + 65, 0.03
    )
    assert (radius < radius.max() / 2).mean() == pytest.approx(0.25, abs=0.03)
    gap = np.linalg.norm(start[:, None] - start, axis=-1)[np.triu_indices(400, 1)]
    assert gap.min() > 10  # 2 d_safe


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flock_speed": 20.0}, "flock_speed is 20 m/s: more than 0 and less than max_speed 20"),
        ({"flock_speed": 0.0}, "flock_speed is 0 m/s"),
        ({"spacing": 5.0}, r"spacing is 5 m: more than 5 m \(d_safe\)"),
        ({"spacing": 16.0}, "at most link_range 15 m is needed"),
        ({"start_looseness": 1.0}, "start_looseness is 1: starts 2 d_safe apart need 1.17"),
        ({"min_in_place": 0.0}, "min_in_place is 0"),
        ({"min_order": 1.5}, "min_order"),
        ({"margin": 0.1}, "margin 0.1 m must exceed jitter"),
    ],
)
def test_invalid_options_raise(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary("flocking", **{**POINTS, **options})


def test_the_task_is_complete():
    bulletuav.check_task("flocking", **POINTS)
