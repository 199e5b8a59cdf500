"""Success in hover, follow and formation depends on the time in place."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task
from bulletuav.tasks.parts.holding import Holding, count_in_place, count_near

POINTS = {"dynamics": "single_integrator", "action": "velocity", "randomization": {}}
TASKS = ["hover", "follow", "formation"]


def fly(aviary, is_in_place):
    """Move all drones to their goals, or 5 m off, in each decision; return the last infos."""
    aviary.reset(seeds=0)
    info = None
    for k in range(aviary.options.horizon):
        if not aviary.alive.any():
            break
        velocity = aviary.scene.goal_velocity / aviary.options.max_speed
        aviary.swarm.position[:] = aviary.scene.goal + (0.0, 0.0, 0.0 if is_in_place(k) else 5.0)
        info = aviary.step(velocity).info
    aviary.close()
    return info


def made(task, **options):
    usual = {"num_drones": 1, "horizon": 20, "difficulty": "easy"}
    usual |= {"turn": 0.0} if task == "follow" else {}
    usual |= {"exchange": 0.0} if task == "formation" else {}
    return bulletuav.Aviary(task, **{**POINTS, **usual, **options})


@pytest.mark.parametrize("task", TASKS)
def test_success_needs_most_of_the_episode_in_place(task):
    needed = round(20 * find_task(task).Config().min_in_place)
    assert needed > 10
    assert fly(made(task), lambda k: k < needed)["success"].all()
    assert not fly(made(task), lambda k: k < needed - 1)["success"].any()


@pytest.mark.parametrize("task", TASKS)
def test_arriving_at_the_end_is_no_success(task):
    info = fly(made(task), lambda k: k >= 18)
    assert not info["success"].any()
    np.testing.assert_allclose(info["in_place"], 0.1)


@pytest.mark.parametrize("task", TASKS)
def test_the_fraction_is_an_option(task):
    assert fly(made(task, min_in_place=0.1), lambda k: k >= 18)["success"].all()
    assert not fly(made(task, min_in_place=1.0), lambda k: k > 0)["success"].any()
    assert fly(made(task, min_in_place=1.0), lambda k: True)["success"].all()


@pytest.mark.parametrize("fraction", [0.0, 1.5])
@pytest.mark.parametrize("task", TASKS)
def test_impossible_fractions_raise(task, fraction):
    with pytest.raises(ValueError, match=f"min_in_place is {fraction:g}: a fraction above 0"):
        made(task, min_in_place=fraction)


def test_a_function_instead_of_a_radius_is_refused():
    context = bulletuav.Aviary("hover", **POINTS).task.context
    with pytest.raises(ValueError, match="goal_radius is a function: pass it to HoldingWhere"):
        Holding(0.5, context, lambda frame: frame.landed)


def test_only_active_drones_in_place_count():
    held = np.ones((1, 3))
    alive, in_place = np.array([[True, True, False]]), np.array([[True, False, True]])
    count_in_place(alive, in_place, held)
    np.testing.assert_array_equal(held, [[2.0, 1.0, 1.0]])


def test_the_fraction_is_that_of_the_time_so_far():
    aviary = made("hover", start_offset=0.0)
    aviary.reset(seeds=0)
    assert not aviary.first_info()["in_place"].any()
    for _ in range(4):
        info = aviary.step(np.zeros((1, 1, 3))).info
    assert info["in_place"] == pytest.approx(1.0)
    assert not info["success"].any()
    aviary.close()


@pytest.mark.parametrize(
    ("task", "level"), [("hover", "extreme"), ("follow", "easy"), ("follow", "extreme")]
)
def test_the_baseline_succeeds_and_a_late_arrival_or_an_early_departure_does_not(task, level):
    success = {}
    for name in (find_task(task).baseline, f"{task}_late", f"{task}_half"):
        aviary = bulletuav.Aviary(
            task, 4, dynamics="point_mass", action="velocity", difficulty=level
        )
        policy = find_policy(name)(aviary)
        observations = aviary.reset(seeds=0)
        policy.reset(np.ones(4, dtype=bool))
        while aviary.alive.any():
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
        success[name] = step.info["success"].mean()
        aviary.close()
    assert list(success.values()) == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(("lands", "counted"), [(False, [1, 1, 0, 0]), (True, [1, 0, 0, 0])])
def test_active_drones_near_their_goals_count_where_they_land_only_on_the_ground(lands, counted):
    held, alive = np.zeros((1, 4)), np.array([[True, True, True, False]])
    landed = np.array([[True, False, True, True]])
    count_near(alive, np.array([[0.5, 0.2, 0.6, 0.1]]), 0.5, landed, lands, held)
    np.testing.assert_array_equal(held, [counted])
