"""Pursuit: schedules, overtaking, pay and success."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.evaluation import evaluate
from bulletuav.policies import find_policy
from bulletuav.tasks.pursuit import count_overtakes

EXACT = {"dynamics": "single_integrator", "randomization": {}}
INVALID = [
    ({"spacing": 6.0}, "start positions may be in conflict"),
    ({"spacing": 60.0}, "do not fit on a circle"),
    ({"speed": (10.0, 30.0)}, "speed is"),
    ({"speed": (0.0, 10.0)}, "speed is"),
    ({"speed": (18.0, 10.0)}, "speed is"),
    ({"altitude": 1.0}, "too low for jitter"),
    ({"laps": 0}, "laps is 0"),
    ({"laps": 2}, "too slow for 754 m of track within 50 s"),
    ({"slack": 40.0}, "slack is 40 m: .* up to 37.7 m, 0.1 of the track, is needed"),
    ({"slack": 1.5}, "slack is 1.5 m: more than 1.73 m, by which jitter offsets starts"),
]


def cruising_speeds(aviary):
    return aviary.scene.memory["cruising_speed"]


def fly_at(factor, num_drones=1, seed=0, **options):
    """Fly on the track at a multiple of the cruising speeds; return all steps."""
    aviary = bulletuav.Aviary("pursuit", num_drones=num_drones, jitter=0.0, **EXACT, **options)
    aviary.reset(seeds=seed)
    speed = factor * cruising_speeds(aviary)
    start = np.arange(num_drones) * aviary.task.config.spacing
    steps = []
    while aviary.alive.any():
        angle = (start - speed * 0.1 * (len(steps) + 1)) / 60
        place = [60 * np.cos(angle), 60 * np.sin(angle), np.full_like(angle, 40.0)]
        velocity = (np.stack(place, axis=-1) - aviary.swarm.position) / 0.1
        steps.append(aviary.step(velocity / aviary.options.max_speed))
    aviary.close()
    return steps


def total(steps, name):
    return sum(step.info[name][0] for step in steps)


@pytest.mark.parametrize(("options", "message"), INVALID)
def test_invalid_options_raise_errors(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary("pursuit", **options)


def test_cruising_speeds_are_drawn_sorted_in_platoons_and_observed():
    aviary = bulletuav.Aviary("pursuit", 50, num_drones=20, observation=("goal_velocity",), **EXACT)
    observations = aviary.reset(seeds=0)
    speed = cruising_speeds(aviary)
    assert speed.min() >= 10
    assert speed.max() <= 18
    np.testing.assert_allclose(speed.mean(), 14, atol=0.3)
    assert speed.std() == pytest.approx(8 / np.sqrt(12), abs=0.2)
    platoons = speed.reshape(50, 2, 10)
    assert (np.diff(platoons, axis=-1) > 0).all()
    assert len(np.unique(speed)) == speed.size
    np.testing.assert_allclose(np.linalg.norm(observations, axis=-1), speed, rtol=1e-6)
    again = aviary.reset(seeds=0)
    np.testing.assert_array_equal(again, observations)
    aviary.close()


def test_goals_fly_clockwise_at_cruising_speed_and_stop_after_the_laps():
    aviary = bulletuav.Aviary("pursuit", num_drones=4, slack=37.0, **EXACT)
    aviary.reset(seeds=0)
    start = aviary.scene.goal[0].copy()
    np.testing.assert_allclose(np.linalg.norm(start[:, :2], axis=1), 60)
    speed = cruising_speeds(aviary)[0]
    angle = np.arctan2(start[:, 1], start[:, 0])
    np.testing.assert_allclose(angle, np.arange(4) * 15 / 60, atol=1e-12)
    for step in range(1, 11):
        aviary.step(np.zeros((1, 4, 3)))
        expected = angle - speed * 0.1 * step / 60
        place = 60 * np.stack([np.cos(expected), np.sin(expected)], axis=1)
        np.testing.assert_allclose(aviary.scene.goal[0, :, :2], place, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(aviary.scene.goal_velocity[0], axis=1), speed)
    late = np.full(1, 45.0)
    aviary.task.move_scene(aviary.scene, late, np.array([True]), [])
    np.testing.assert_allclose(aviary.scene.goal[0], start, atol=1e-9)
    np.testing.assert_array_equal(aviary.scene.goal_velocity[0], 0)
    aviary.close()


@pytest.mark.parametrize(
    ("factor", "success"), [(1.0, True), (0.96, True), (1.04, True), (0.9, False), (1.1, False)]
)
def test_success_needs_the_cruising_speed(factor, success):
    """A drone at 0.9 or 1.1 of its speed is more than 25 m off after 377 m."""
    steps = fly_at(factor, slack=25.0)
    assert steps[-1].terminated.all()
    assert steps[-1].info["success"].all() == success
    lap = total(steps, "reward/lap")[0]
    assert total(steps, "reward/goal")[0] == (500 if success else 0)
    if success:
        assert lap == pytest.approx(500, rel=1e-9)
    else:
        # Paid until it is 25 m off
        assert lap == pytest.approx(500 * 25 / 0.1 / 377, rel=0.03)
        # The remaining decisions cost time
        assert total(steps, "reward/time")[0] == pytest.approx(-0.5 * 500)


def test_all_laps_count():
    steps = fly_at(1.0, laps=2, horizon=1000)
    assert steps[-1].info["success"].all()
    assert total(steps, "reward/lap")[0] == pytest.approx(500, rel=1e-9)
    assert len(steps) * 0.1 * 18 > 2 * 377


def test_a_conflict_denies_success_and_further_pay():
    """Two drones on the track: the faster one flies through the slower one."""
    steps = fly_at(1.0, num_drones=2, seed=0, speed=(10.0, 18.0), contact_ends="drone", d_safe=5.0)
    conflicts = np.array([step.info["conflicts"][0].any() for step in steps])
    assert conflicts.any()
    first = int(np.argmax(conflicts))
    assert not any(step.info["success"].any() for step in steps)
    assert (steps[first - 1].info["reward/lap"] > 0).all()
    for step in steps[first:]:
        assert not step.info["reward/lap"].any()
        assert not step.info["reward/goal"].any()


def test_overtakes_are_counted():
    position = {
        "behind": (np.cos(0.1), np.sin(0.1)),
        "middle": (1.0, 0.0),
        "ahead": (np.cos(0.1), -np.sin(0.1)),
        "opposite": (-1.0, 0.05),
        "opposite later": (-1.0, -0.05),
    }

    def place(*names):
        return np.array([[(*position[name], 0.0) for name in names]])

    def count(before, after, alive=(True, True)):
        counts = np.zeros((1, 2))
        count_overtakes(place(*before), place(*after), np.array([alive]), counts)
        return counts[0].tolist()

    assert count(("behind", "middle"), ("ahead", "middle")) == [1, 0]
    assert count(("middle", "behind"), ("middle", "ahead")) == [0, 1]
    assert count(("behind", "middle"), ("behind", "middle")) == [0, 0]
    assert count(("behind", "middle"), ("ahead", "middle"), (True, False)) == [0, 0]
    # The order changes on the far side of the circle, too
    assert count(("middle", "opposite"), ("middle", "opposite later")) == [0, 0]
    assert count(("middle", "opposite later"), ("middle", "opposite")) == [0, 0]


def test_the_fastest_drone_overtakes_all_others():
    aviary = bulletuav.Aviary("pursuit", speed=(10.0, 18.0), jitter=0.5, **EXACT)
    policy = find_policy("pursuit_oracle")(aviary)
    aviary.reset(seeds=0)
    policy.reset(np.ones(1, dtype=bool))
    np.testing.assert_array_equal(aviary.first_info()["overtakes"], 0)
    success, overtakes = np.zeros((2, 8))
    while aviary.alive.any():
        info = aviary.step(policy.act(np.zeros(0), aviary.swarm)).info
        success += info["success"][0]
        overtakes = np.maximum(overtakes, info["overtakes"][0])
    assert success.all()
    gap = 15 * np.arange(8)
    speed = cruising_speeds(aviary)[0]
    gain = (speed[:, None] - speed) / speed[:, None] * 120 * np.pi
    # Faster drones that start behind and whose goals pass by a wide margin
    passed = ((gain - (gap[:, None] - gap) > 10) & (gap[:, None] > gap)).sum(axis=1)
    assert passed.sum() > 10
    assert (overtakes >= passed).all()
    assert overtakes[0] == 0
    aviary.close()


@pytest.mark.parametrize("difficulty", ["easy", "medium"])
def test_the_oracle_succeeds_and_evasive_policies_earn_less(difficulty):
    task = bulletuav.tasks.find_task("pursuit")
    options = {"seed": 7, "difficulty": difficulty, "dynamics": "point_mass"}

    def measure(name):
        found = evaluate("pursuit", name, 3, action="velocity", **options).estimates()
        return found["safe_success"].mean, found["return"].mean

    success, earned = measure(task.oracle)
    assert success == 1
    baseline_success, baseline = measure(task.baseline)
    assert baseline_success >= 0.8
    assert len(task.shirkers) >= 6
    for name in task.shirkers:
        rate, other = measure(name)
        assert rate <= 0.6
        assert other < baseline - 200
        assert other < earned - 200


def test_policies_of_pursuit_need_pursuit():
    aviary = bulletuav.Aviary("converge", num_drones=2, **EXACT)
    for name in ("pursuit_oracle", "pursuit_convoy"):
        with pytest.raises(ValueError, match=r"supports task 'pursuit', not 'converge'"):
            find_policy(name)(aviary)
    aviary.close()


@pytest.mark.parametrize(("aside", "stays"), [(-15.4, False), (-14.4, True), (15.4, True)])
def test_drones_that_cut_the_track_are_off_their_schedule(aside, stays):
    """The slack is 20 m, but a drone may be no more than 15 m inside the track of 60 m."""
    aviary = bulletuav.Aviary("pursuit", num_drones=1, jitter=0.0, **EXACT)
    aviary.reset(seeds=0)
    aviary.swarm.position[:] += (aside, 0.0, 0.0)
    inward = (aside / 60) * aviary.scene.goal_velocity
    step = aviary.step((aviary.scene.goal_velocity + inward) / aviary.options.max_speed)
    assert bool(aviary.alive[0, 0]) == stays
    assert (step.info["reward/lap"][0, 0] > 0) == stays
    aviary.close()


def test_lanes_far_inside_the_track_are_not_paid_for():
    """They are flown at less speed, and every second one is more than 15 m inside."""
    options = {"difficulty": "medium", "dynamics": "point_mass", "action": "velocity"}
    success = {
        name: evaluate("pursuit", name, 3, **options).estimates()["safe_success"].mean
        for name in ("pursuit_oracle", "pursuit_inner_lanes")
    }
    assert success["pursuit_oracle"] == 1.0
    assert success["pursuit_inner_lanes"] <= 0.5
