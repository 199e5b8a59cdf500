"""Rewards, ends and options that the tasks of a shared airspace have in common."""

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks.rewards.airspace import CLEAR, CONFLICT, update_encounters, variance_nearby
from bulletuav.vehicle.swarm import Swarm

AIRSPACES = ("crossing", "converge", "pursuit", "obstacles")
CALM = {"dynamics": "rigid_body", "randomization": {}}
ASKED = {
    "efficiency": 1.0,
    "speed_keeping": 0.5,
    "time": -0.1,
    "shaping": 1.0,
    "fairness": -0.1,
    "concession": 2.0,
}


def towards_goal(aviary):
    speed = aviary.options.max_speed
    wanted = aviary.scene.goal - aviary.swarm.position + aviary.scene.goal_velocity
    return np.clip(wanted / speed, -1, 1)


def fly(aviary, act=towards_goal, seeds=0):
    """All steps of an episode."""
    aviary.reset(seeds=seeds)
    steps = []
    while aviary.alive.any():
        steps.append(aviary.step(act(aviary)))
    aviary.close()
    return steps


def column(steps, name):
    return np.array([step.info[name][0] for step in steps])


@pytest.mark.parametrize("task", AIRSPACES)
def test_the_reward_is_the_sum_of_its_terms_every_one_in_info(task):
    aviary = bulletuav.Aviary(task, num_drones=3, weights=ASKED, **CALM)
    steps = fly(aviary)
    terms = [name for name in steps[0].info if name.startswith("reward/")]
    weights = aviary.task.weights.items()
    # Without obstacles there is no warning of them, whatever it weighs. Goals of pursuit run ahead.
    unpaid = {"obstacle_warning", "progress"} if task == "pursuit" else {"obstacle_warning"}
    left = {name for name, weight in weights if weight or name == "fairness"}
    assert {name.removeprefix("reward/") for name in terms} == left
    assert set(aviary.task.weights) - left <= unpaid
    for step in steps:
        np.testing.assert_allclose(
            sum(step.info[name] for name in terms), step.rewards, rtol=1e-12, atol=1e-9
        )


@pytest.mark.parametrize("task", [*AIRSPACES, "formation"])
def test_terms_without_weight_are_left_out(task):
    aviary = bulletuav.Aviary(task, num_drones=2, **CALM)
    aviary.reset(seeds=0)
    info = aviary.step(np.zeros((1, 2, 3))).info
    for term, weight in aviary.task.weights.items():
        assert (f"reward/{term}" in info) == (weight != 0)
    assert set(aviary.first_info()) == set(info)
    aviary.close()


@pytest.mark.parametrize("task", AIRSPACES)
def test_progress_is_positive_when_approaching_and_reaching_the_goal_beats_standing_still(task):
    returns = {}
    for name, act in (("reach", towards_goal), ("still", lambda aviary: np.zeros((1, 1, 3)))):
        aviary = (
            bulletuav.Aviary(task, num_drones=1, num_obstacles=1, num_moving=0, **CALM)
            if task == "obstacles"
            else None
        )
        aviary = aviary or bulletuav.Aviary(task, num_drones=1, **CALM)
        steps = fly(aviary, act)
        returns[name] = sum(step.rewards[0, 0] for step in steps)
        if name == "reach":
            assert steps[-1].info["success"].all()
            paid = "lap" if task == "pursuit" else "progress"
            # After it has turned towards it
            assert (column(steps[5:], f"reward/{paid}") > 0).all()
    assert returns["reach"] > returns["still"] + 40


def test_optional_terms_by_hand():
    """One drone that flies straight on at 10 m/s."""
    options = {"num_drones": 1, "jitter": 0.0, "altitude_spread": 0.0, "start_speed": (10.0, 10.0)}
    aviary = bulletuav.Aviary(
        "crossing", weights=ASKED, **options, **(CALM | {"dynamics": "single_integrator"})
    )
    aviary.reset(seeds=0)
    info = aviary.step(np.array([[(0.0, 0.5, 0.0)]])).info  # 200 m to go, 1 m flown
    assert info["reward/efficiency"][0, 0] == pytest.approx(1 / 200)
    assert info["reward/speed_keeping"][0, 0] == 0.5
    assert info["reward/time"][0, 0] == -0.1
    assert info["reward/shaping"][0, 0] == pytest.approx(200 - 0.99 * 199)
    assert info["reward/fairness"][0, 0] == 0
    info = aviary.step(np.array([[(0.0, 0.9, 0.0)]])).info
    assert info["reward/speed_keeping"][0, 0] == 0  # 18 m/s is more than 0.8 of 20
    aviary.close()


@pytest.mark.parametrize(
    ("task", "options", "more"),
    [
        ("crossing", {}, 0.0),
        ("converge", {"at_goal": "land"}, 40.0),
        ("pursuit", {"start_speed": (9.0, 9.0)}, 120 * np.pi),
    ],
)
def test_shaping_telescopes_to_the_potential_of_the_start_whatever_was_done(task, options, more):
    """The discounted sum over an episode that terminates is -Phi(start), whatever was done.

    So it cannot change which policy is best. Phi counts how far goals move on, too: 40 m down to
    the ground, once round the circle.
    """
    for seed in (0, 1):
        rng = np.random.default_rng(seed)

        def wander(aviary, rng=rng):
            return np.clip(towards_goal(aviary) + rng.normal(0, 0.3, (1, 2, 3)), -1, 1)

        options |= {"weights": {"shaping": 1.0, "efficiency": 1.0}, "altitude": 40.0}
        aviary = bulletuav.Aviary(task, num_drones=2, **options, **CALM)
        aviary.reset(seeds=seed)
        first = aviary.first_info()["goal_distance"][0] + more
        steps = fly(aviary, wander, seed)
        discounts = 0.99 ** np.arange(len(steps))
        assert steps[-1].terminated.any()
        np.testing.assert_allclose(discounts @ column(steps, "reward/shaping"), first, rtol=1e-9)
        efficiency = column(steps, "reward/efficiency")
        assert (np.abs(efficiency) <= 1).all()
        assert efficiency.max() > 0.97


def test_fairness_is_the_variance_of_the_rewards_nearby():
    reward = np.array([[1.0, 2.0, 6.0, 9.0]])
    position = np.array([[(0.0, 0, 0), (10, 0, 0), (0, 20, 0), (100, 0, 0)]])
    alive = np.array([[True, True, True, True]])
    found = variance_nearby(reward, position, alive, 50.0)
    np.testing.assert_allclose(found[0, :3], np.var([1, 2, 6]))
    assert found[0, 3] == 0
    alive[0, 2] = False
    np.testing.assert_allclose(
        variance_nearby(reward, position, alive, 50.0)[0], [0.25, 0.25, 0, 0]
    )


def test_concession_pays_the_drone_that_made_way():
    """Two on a collision course: drone 0 climbs over drone 1, which flies straight on."""
    options = {
        "num_drones": 2,
        "jitter": 0.0,
        "altitude_spread": 0.0,
        "start_speed": (10.0, 10.0),
        "half_length": 50.0,
    }

    def climb(aviary):
        action = towards_goal(aviary)
        if aviary.steps[0] < 20:
            action[0, 0, 2] = 1.0
        return action

    steps = fly(bulletuav.Aviary("crossing", weights={"concession": 7.0}, **options, **CALM), climb)
    assert not column(steps, "conflicts").any()
    np.testing.assert_array_equal(column(steps, "reward/concession").sum(axis=0), (7, 0))
    steps = fly(bulletuav.Aviary("crossing", weights={"concession": 7.0}, **options, **CALM))
    assert column(steps, "conflicts").any()
    assert not column(steps, "reward/concession").any()  # no one is paid for a conflict


def test_encounters_by_hand():
    def swarm(x, v):
        one = Swarm.zeros(1, 2, 4)
        one.position[0, :, 0], one.velocity[0, :, 0] = x, v
        return one

    encounter, effort = np.zeros((2, 1, 2, 2))
    alive = np.ones((1, 2), dtype=bool)
    update_encounters(
        encounter, effort, swarm((0, 250), (10, -10)), swarm((1, 249), (10, -10)), 5.0, alive
    )
    assert not encounter.any()  # they would meet, in 12.5 s
    update_encounters(
        encounter, effort, swarm((0, 100), (10, -10)), swarm((1, 99), (10, -7)), 5.0, alive
    )
    assert encounter[0, 0, 1] == encounter[0, 1, 0] == CLEAR
    assert (effort[0, 0, 1], effort[0, 1, 0]) == (0, 3)
    update_encounters(
        encounter, effort, swarm((0, 100), (-10, 10)), swarm((-1, 101), (0, 10)), 5.0, alive
    )
    assert effort[0, 0, 1] == 0  # they part
    update_encounters(
        encounter, effort, swarm((0, 100), (10, -10)), swarm((48, 52), (10, -10)), 5.0, alive
    )
    assert encounter[0, 0, 1] == CONFLICT
    update_encounters(
        encounter, effort, swarm((0, 100), (10, -10)), swarm((1, 99), (10, -10)), 5.0, ~alive
    )
    assert encounter[0, 0, 1] == CONFLICT


# Ends


def test_hold_ends_when_all_are_at_their_goals_and_pays_each_once():
    aviary = bulletuav.Aviary("converge", num_drones=2, at_goal="hold", altitude=40.0, **CALM)

    def pass_below(aviary):
        action = towards_goal(aviary)
        if aviary.steps[0] < 60:
            action[0, 1, 2] = -0.6 if aviary.steps[0] < 20 else 0.0
        return action

    steps = fly(aviary, pass_below)
    assert steps[-1].terminated.all()
    assert steps[-1].info["success"].all()
    assert column(steps, "success")[:-1].any()  # one waited for the other
    np.testing.assert_array_equal(column(steps, "reward/goal").sum(axis=0), (50, 50))


def test_land_asks_to_go_down_to_the_ground_first():
    aviary = bulletuav.Aviary("converge", num_drones=1, at_goal="land", altitude=20.0, **CALM)
    steps = fly(aviary, lambda one: np.clip(towards_goal(one) - (0.0, 0.0, 0.02), -1, 1))
    assert steps[-1].info["success"].all()
    assert not steps[-1].info["collision"].any()
    assert aviary.swarm.position[0, 0, 2] <= 1.0
    assert np.linalg.norm((aviary.swarm.position - aviary.scene.goal)[0, 0, :2]) <= 2
    reached = int(np.argmax(column(steps, "reward/goal")[:, 0]))
    assert reached < len(steps) - 10
    assert column(steps, "reward/goal").sum() == 50


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
@pytest.mark.parametrize(("boundary", "rebound"), [("soft", 0.8), ("hard", 0.0)])
def test_walls_throw_back_or_stop(boundary, rebound, dynamics):
    options = {
        "num_drones": 1,
        "start_speed": (15.0, 15.0),
        "dynamics": dynamics,
        "randomization": {},
    }
    aviary = bulletuav.Aviary("converge", boundary=boundary, action="velocity_increment", **options)
    aviary.reset(seeds=0)
    while True:
        before = aviary.swarm.velocity[0, 0].copy()
        step = aviary.step(np.array([[(0.5, 0.0, 0.0)]]))
        if aviary.swarm.position[0, 0, 0] == aviary.task.arena_high[0]:
            break
        assert not step.terminated.any()
    assert not step.terminated.any()
    after = aviary.swarm.velocity[0, 0]
    assert after[0] <= 0
    # It still sped up a little in this decision.
    assert after[0] == pytest.approx(-rebound * before[0], rel=0.2)
    np.testing.assert_allclose(after[1:], before[1:], atol=0.3)
    assert aviary.commanded[0, 0, 0] <= 0
    assert step.info["reward/out_of_bounds"][0, 0] == -50
    aviary.step(np.zeros((1, 1, 3)))
    assert aviary.swarm.position[0, 0, 0] <= aviary.task.arena_high[0]
    aviary.close()


def test_open_bounds_end_nothing():
    aviary = bulletuav.Aviary("converge", num_drones=1, boundary="open", horizon=150, **CALM)
    steps = fly(aviary, lambda aviary: np.array([[(1.0, 0.0, 0.0)]]))
    assert len(steps) == 150
    assert steps[-1].truncated.all()
    assert aviary.swarm.position[0, 0, 0] > aviary.task.arena_high[0]


HEAD_ON = {
    "num_drones": 3,
    "lanes": 1,
    "jitter": 0.0,
    "altitude_spread": 0.0,
    "start_speed": (10.0, 10.0),
    "half_length": 20.0,
}


@pytest.mark.parametrize(
    ("whose", "ended"), [("drone", (True, False, True)), ("world", (True, True, True))]
)
@pytest.mark.parametrize("what", ["contact_ends", "conflict_ends"])
def test_contact_and_conflict_end_whose_episode_they_should(what, whose, ended):
    steps = fly(bulletuav.Aviary("crossing", **{what: whose}, **HEAD_ON, **CALM))
    sign = "collision" if what == "contact_ends" else "conflicts"
    when = int(np.argmax(column(steps, sign).any(axis=1)))
    np.testing.assert_array_equal(steps[when].terminated[0], ended)


# Preset


@pytest.mark.parametrize("task", AIRSPACES)
def test_uavconflict_takes_the_sizes_and_constants_of_the_gym(task):
    aviary = bulletuav.Aviary(task, preset="uavconflict")
    options = aviary.options
    assert (options.num_drones, options.max_speed, options.decision_hz, options.horizon) == (
        8,
        20.0,
        10,
        500,
    )
    assert options.action == "velocity_increment"
    assert aviary.reset(seeds=0).shape == (1, 8, 6 + 4 + 8 + 6 * 7)
    weights = aviary.task.weights
    assert [weights[name] for name in ("progress", "goal", "conflict", "warning", "energy")] == [
        10,
        50,
        -200,
        -5,
        -0.01,
    ]
    assert weights["speed_keeping"] == 0.5
    assert aviary.task.config.d_safe == 5
    aviary.close()


def test_a_preset_and_weights_of_ones_own_go_together():
    aviary = bulletuav.Aviary("converge", preset="uavconflict", weights={"goal": 1.0})
    assert aviary.task.weights["goal"] == 1
    assert aviary.task.weights["progress"] == 10
    aviary.close()


def test_a_conflict_ends_the_episode_of_uavconflict_for_all():
    aviary = bulletuav.Aviary(
        "converge", preset="uavconflict", dynamics="point_mass", action="velocity"
    )
    steps = fly(aviary)
    assert steps[-1].terminated.all()
    assert steps[-1].info["conflicts"].any()
    assert len(steps) < 100
