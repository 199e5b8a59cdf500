"""Tasks: what their docstrings tell is true, and rewards, ends and starts by hand."""

import inspect
import re

import numpy as np
import placing
import pytest

import bulletuav
from bulletuav.tasks import find_task

TASKS = bulletuav.list_tasks()


def test_tasks_are_found():
    assert {"hover", "crossing"} <= set(TASKS)
    assert sorted(TASKS) == TASKS


def words(text):
    """The text on one line, without backquotes' line breaks."""
    return " ".join(text.split())


@pytest.fixture(scope="module", params=TASKS)
def usual(request):
    """A task's name, and its aviary as it is without options."""
    aviary = bulletuav.Aviary(request.param)
    yield request.param, aviary
    aviary.close()


def test_the_docstring_tells_the_size_of_observations_and_actions(usual):
    name, aviary = usual
    doc = words(inspect.getdoc(find_task(name)))
    observations = aviary.reset(seeds=0)
    # Tasks with pictures observe a dict
    vector = observations["vector"] if isinstance(observations, dict) else observations
    size = vector.shape[-1]
    assert len(aviary.observer.labels) == size
    assert f"Observation, Box({size}) per drone" in doc
    assert f"Action, by default `{aviary.options.action}`" in doc
    assert f"Box({aviary.action.low.shape[-1]}) per drone" in doc


def test_the_docstring_tells_rates_horizon_weights_and_presets(usual):
    name, aviary = usual
    task = find_task(name)
    own = words(inspect.getdoc(task))
    hz = task.defaults["decision_hz"]
    assert f"{hz} decision{'s' if hz > 1 else ''} a second" in own
    assert f"truncated after {task.defaults['horizon']} decisions" in own.lower()
    for term, weight in aviary.task.weights.items():
        assert not weight or re.search(rf"- {term} {weight:g}:", own), term
    for preset in task.presets:
        assert f"Preset {preset}:" in own


@pytest.mark.parametrize("name", TASKS)
def test_the_docstring_of_a_config_tells_every_option_of_its_own(name):
    for kind in inspect.getmro(find_task(name).Config):
        if kind.__module__.startswith("bulletuav."):
            told = set(re.findall(r"^    (\w+): ", inspect.getdoc(kind), re.MULTILINE))
            assert told == set(kind.__annotations__), kind


@pytest.mark.parametrize("difficulty", ["easy", "medium", "hard", "extreme"])
@pytest.mark.parametrize("name", TASKS)
def test_every_difficulty_starts_clear_of_everything(name, difficulty):
    # Two cities of the usual size for the three worlds, not four.
    cities = {"num_layouts": 2} if placing.small_cities(name) else {}
    options = {"difficulty": difficulty, "dynamics": "rigid_body", **cities}
    aviary = bulletuav.Aviary(name, 3, **options)
    aviary.reset(seeds=0)
    position, radius = aviary.swarm.position, aviary.options.airframe[0].collision_radius
    assert (position[..., 2] > (0.0 if aviary.task.takes_off else radius)).all()
    assert (position > aviary.task.arena_low).all()
    assert (position < aviary.task.arena_high).all()
    assert (aviary.scene.goal < aviary.task.arena_high).all()
    assert not aviary.step(
        np.zeros((*aviary.alive.shape, aviary.action.low.shape[-1]))
    ).terminated.any()
    aviary.close()


# Hover


def test_hover_reward_by_hand():
    aviary = bulletuav.Aviary("hover", dynamics="rigid_body", effects=(), start=((1.0, 0.0, 2.0),))
    aviary.reset(seeds=0)
    hover = (
        2
        * aviary.options.airframe[0].hover_speed() ** 2
        / aviary.options.airframe[0].max_rotor_speed ** 2
        - 1
    )
    step = aviary.step(np.full((1, 1, 4), hover))
    assert step.rewards[0, 0] == pytest.approx(1 - 0.1 * 1.0, abs=1e-6)
    np.testing.assert_allclose(
        [step.info[f"reward/{term}"][0, 0] for term in ("alive", "distance", "speed")],
        (1, -0.1, 0),
        atol=1e-6,
    )
    aviary.close()


def test_hover_ends_on_contact_and_far_away_and_at_the_horizon():
    aviary = bulletuav.Aviary("hover", 3, height=5.0, horizon=90, action="velocity")
    aviary.reset(seeds=0)
    ended = {}
    for step in range(1, 91):
        actions = np.array([(0, 0, -1), (0, 0, 0), (1, 0, 0)], float)[:, None]
        result = aviary.step(actions)
        for w in range(3):
            if result.terminated[w, 0] or result.truncated[w, 0]:
                ended[w] = (
                    step,
                    bool(result.terminated[w, 0]),
                    bool(result.info["collision"][w, 0]),
                )
    assert ended[0][0] < 60
    assert ended[0][1:] == (True, True)
    assert ended[1] == (90, False, False)
    aviary.close()
    aviary = bulletuav.Aviary("hover", action="velocity", max_distance=2.0)
    aviary.reset(seeds=0)
    while aviary.alive.any():
        result = aviary.step(np.array([[(1.0, 0, 0)]]))
    assert result.terminated.all()
    assert not result.info["collision"].any()
    assert result.info["goal_distance"][0, 0] > 2
    aviary.close()


def test_hover_success_and_start_options():
    start = ((0.0, 0.0, 2.0), (2.0, 0.05, 2.0))
    aviary = bulletuav.Aviary("hover", num_drones=2, start=start, action="target_position")
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.swarm.position[0], start)
    # Targets stand at x = -1 and 1.
    assert list(aviary.first_info()["success"][0]) == [
        False,
        False,
    ]
    goal = aviary.action.encode(aviary.scene.goal)
    for _ in range(220):
        result = aviary.step(goal)
    assert result.info["success"].all()
    aviary.close()


def test_hover_disturbances_grow_with_difficulty():
    tilt = {}
    for difficulty in ("easy", "hard"):
        aviary = bulletuav.Aviary("hover", 50, difficulty=difficulty)
        aviary.reset(seeds=0)
        tilt[difficulty] = np.degrees(
            2 * np.arccos(np.clip(aviary.swarm.quaternion[:, 0, 3], -1, 1))
        ).max()
        assert (aviary.swarm.rates != 0).any() == (difficulty == "hard")
        assert (aviary.swarm.velocity != 0).any() == (difficulty == "hard")
        aviary.close()
    assert tilt["easy"] == 0
    assert 40 < tilt["hard"] <= 60


# Crossing


def test_crossing_teams_start_and_end_where_the_scenario_says():
    aviary = bulletuav.Aviary("crossing", num_drones=7, dynamics="rigid_body")
    aviary.reset(seeds=3)
    start, goal = aviary.scene.start[0], aviary.scene.goal[0]
    np.testing.assert_allclose(start[:4, 1], -100, atol=1)
    np.testing.assert_array_equal(goal[:4, 1], 100)
    np.testing.assert_allclose(start[4:, 0], -100, atol=1)
    np.testing.assert_array_equal(goal[4:, 0], 100)
    np.testing.assert_allclose(np.sort(goal[:4, 0]), (-22.5, -7.5, 7.5, 22.5))
    np.testing.assert_allclose(np.sort(goal[4:, 1]), (-15, 0, 15))
    speed = np.linalg.norm(aviary.swarm.velocity[0], axis=1)
    assert ((speed >= 5) & (speed <= 15)).all()
    towards = ((goal - start) * aviary.swarm.velocity[0]).sum(axis=1) / np.linalg.norm(
        goal - start, axis=1
    )
    np.testing.assert_allclose(towards, speed, rtol=1e-9)
    assert (np.abs(start[:, 2] - 40) <= 4).all()
    aviary.close()


def test_large_teams_fly_in_ranks():
    aviary = bulletuav.Aviary("crossing", num_drones=50, jitter=0.0, dynamics="rigid_body")
    aviary.reset(seeds=0)
    start = aviary.scene.start[0, :25]
    np.testing.assert_allclose(np.unique(start[:, 1]), (-130, -115, -100))
    assert len(np.unique(start[:, 0])) == 10
    np.testing.assert_allclose(aviary.scene.goal[0, :25, 1] - start[:, 1], 200)
    aviary.close()


def straight_to_goal(aviary):
    offset = aviary.scene.goal - aviary.swarm.position
    return offset / np.linalg.norm(offset, axis=-1, keepdims=True)


def test_crossing_rewards_by_hand_over_an_episode():
    """One drone: progress adds up to the way made good, the goal counts once.

    Energy is that of the velocity changes.
    """
    aviary = bulletuav.Aviary("crossing", num_drones=1, dynamics="rigid_body", horizon=200)
    aviary.reset(seeds=1)
    first = np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    total, energy = {}, 0.0
    while aviary.alive.any():
        before = aviary.swarm.velocity.copy()
        step = aviary.step(straight_to_goal(aviary))
        energy += ((aviary.swarm.velocity - before) ** 2).sum()
        for name, term in step.info.items():
            total[name] = total.get(name, 0) + float(term[0, 0])
    last = np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    assert last <= 2
    assert total["reward/progress"] == pytest.approx(5 * (first - last), rel=1e-9)
    assert total["reward/goal"] == 50
    assert total["reward/energy"] == pytest.approx(-0.01 * energy, rel=1e-9)
    assert total["success"] == 1
    for name in ("conflict", "warning", "collision", "out_of_bounds"):
        assert total[f"reward/{name}"] == 0
    assert step.terminated.all()
    aviary.close()


def test_standing_still_earns_less_than_reaching_the_goal():
    returns = {}
    for policy in ("still", "straight"):
        aviary = bulletuav.Aviary("crossing", dynamics="rigid_body")
        aviary.reset(seeds=0)
        total = np.zeros(8)
        while aviary.alive.any():
            action = straight_to_goal(aviary) if policy == "straight" else np.zeros((1, 8, 3))
            total += aviary.step(action).rewards[0]
        returns[policy] = total
        aviary.close()
    assert (returns["straight"] > returns["still"]).all()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_conflict_and_collision_are_told_apart(dynamics):
    """Two drones on one crossing point: first in conflict, both told once, then in contact."""
    options = {
        "num_drones": 2,
        "jitter": 0.0,
        "altitude_spread": 0.0,
        "start_speed": (10.0, 10.0),
        "half_length": 20.0,
    }
    aviary = bulletuav.Aviary("crossing", dynamics=dynamics, **options)
    aviary.reset(seeds=0)
    rows = []
    while aviary.alive.any():
        rows.append(aviary.step(straight_to_goal(aviary)))
    conflicts = np.array([row.info["conflicts"][0] for row in rows])
    collision = np.array([row.info["collision"][0] for row in rows])
    np.testing.assert_array_equal(conflicts.sum(axis=0), (1, 1))
    assert np.argmax(conflicts[:, 0]) < np.argmax(collision[:, 0])
    assert collision[-1].all()
    assert rows[-1].terminated.all()
    assert not rows[-1].info["success"].any()
    assert rows[-1].info["reward/collision"][0].tolist() == [-200, -200]
    assert rows[-1].info["separation"].max() < 2 * aviary.options.airframe[0].collision_radius
    aviary.close()


def test_leaving_the_arena_ends_the_episode():
    aviary = bulletuav.Aviary("crossing", num_drones=1, dynamics="rigid_body", horizon=1000)
    aviary.reset(seeds=0)
    while aviary.alive.any():
        step = aviary.step(np.array([[(-1.0, 0, 0)]]))
    assert step.terminated.all()
    assert step.info["reward/out_of_bounds"][0, 0] == -50
    assert aviary.swarm.position[0, 0, 0] < aviary.task.arena_low[0]
    aviary.close()


def test_weights_can_be_changed_by_name():
    aviary = bulletuav.Aviary("crossing", weights={"progress": 1.0})
    assert aviary.task.weights["progress"] == 1
    assert aviary.task.weights["goal"] == 50
    aviary.close()
