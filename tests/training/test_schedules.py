"""Default settings of training runs."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies import find_policy
from bulletuav.policies.run import FAST, RunConfig, shipped_tasks
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.default import Default
from bulletuav.tasks.goal_flight import GoalFlight
from bulletuav.tasks.user_service import UserService
from bulletuav.training import schedules
from bulletuav.training.models import make_model
from bulletuav.training.schedules import (
    FAST_FLIGHT,
    FAST_OWN,
    GOAL_FLIGHT,
    OWN,
    SERVICE,
    USERS,
    default_run,
    shipped_run,
)
from bulletuav.training.trainer import check_algorithm, train

SWARM = {"dynamics": "single_integrator", "observation": ["goal_offset", "intruders"]}
FLIGHTS = [name for name in list_tasks() if issubclass(find_task(name), GoalFlight | Default)]
USER_TASKS = [name for name in list_tasks() if issubclass(find_task(name), UserService)]
SERVICES = [name for name in USER_TASKS if name not in ("mec", *OWN)]


@pytest.mark.parametrize("task", list_tasks())
def test_default_settings_use_the_weights_for_training_and_are_evaluated_by_the_benchmark(
    task, tmp_path
):
    run = default_run(task)
    (tmp_path / "run.yaml").write_text(run.text())
    assert RunConfig.read(tmp_path / "run.yaml").text() == run.text()
    weights = EnvSpec(task, 1, run.evaluated).task.weights
    assert weights == EnvSpec(task, 1, {}).task.weights
    if task in FLIGHTS or task not in shipped_tasks():
        trained = EnvSpec(task, 1, dict(run.options)).task.weights
        named = dict(find_task(task).training_weights)
        if not weights.get("obstacle_warning"):
            named.pop("obstacle_warning", None)  # The task has no obstacles
        assert trained == {**weights, **{one: named[one] for one in named if one in weights}}


@pytest.mark.parametrize("task", FLIGHTS)
def test_goal_flights_observe_offsets_of_goals_and_no_position(task):
    run = default_run(task)
    assert "goal_offset" in run.options["observation"]
    assert not {"position", "goal", "neighbours"} & set(run.options["observation"])
    assert run.worlds == GOAL_FLIGHT["worlds"]
    EnvSpec(task, 1, dict(run.options))


@pytest.mark.parametrize("task", OWN)
def test_settings_of_single_tasks_replace_those_of_their_kind(task):
    run, own = default_run(task), OWN[task]
    assert find_task(task).training_weights
    assert run.options.items() >= {"reward": "training", **own.get("options", {})}.items()
    assert run.model.items() >= own.get("model", {}).items()
    assert run.worlds == own.get("worlds", 64)
    assert run.steps <= 1_200_000
    assert run.staggered


def test_drones_in_los_train_and_are_evaluated_for_the_duration_of_the_benchmark():
    run, usual = default_run("los"), EnvSpec("los", 1, {})
    duration = usual.options.horizon / usual.options.decision_hz
    assert run.options["horizon"] / run.options["decision_hz"] == duration
    assert run.evaluated["horizon"] / run.evaluated["decision_hz"] == duration


@pytest.mark.parametrize("task", SERVICES)
def test_services_share_a_reward_and_observe_users_for_the_network_user_sum(task):
    run = default_run(task)
    assert run.options["observation"] == list(USERS)
    assert run.model["features"] == "user_sum"
    assert run.shared_reward
    assert run.steps == SERVICE["steps"] <= 1_000_000


@pytest.mark.parametrize("task", USER_TASKS)
def test_weights_for_training_reward_the_service_that_decides_success_alone(task):
    weights = EnvSpec(task, 1, {"reward": "training"}).task.weights
    rewarded = {name: weight for name, weight in weights.items() if weight > 0}
    if task == "los":  # and the drone's own part of it
        assert rewarded == {"served": 1.0, "sight": 0.3}
    else:
        assert rewarded == ({"tasks": 3.0} if "tasks" in weights else {"served": 3.0})


def test_lidar_navigation_scales_its_own_term_for_training_too():
    weights = EnvSpec("lidar_navigation", 1, {"reward": "training"}).task.weights
    assert (weights["proximity"], weights["conflict"], weights["progress"]) == (-0.02, -6.0, 0.05)


def test_other_tasks_with_a_policy_in_the_package_keep_its_settings():
    run, known = default_run("mec"), shipped_run("mec")
    assert (run.model, run.steps) == (known.model, known.steps)
    assert "difficulty" not in run.options


@pytest.mark.parametrize(("algo", "is_small"), [("ppo", True), ("a2c", True), ("sac", False)])
def test_swarm_features_of_on_policy_algorithms_begin_small(algo, is_small):
    """The orthogonal initial weights of stable-baselines3 would drown the drone's own numbers."""
    env = DroneVecEnv("crossing", 1, **SWARM)
    buffer = {"n_steps": 8} if is_small else {"buffer_size": 100}
    settings = {"features": "swarm", **buffer}
    models = [
        make_model(RunConfig("crossing", algo, options=SWARM, model=settings), env)
        for _ in range(2)
    ]
    policies = [model.policy for model in models]
    env.close()
    found = getattr(policies[0], "actor", policies[0]).features_extractor
    first, second = (layer for layer in found.each["intruder"] if isinstance(layer, nn.Linear))
    assert (second.weight.abs().max() <= 0.02) == is_small
    assert first.weight.abs().max() <= 1 / np.sqrt(first.in_features)  # PyTorch's own
    for one, other in zip(policies[0].parameters(), policies[1].parameters(), strict=True):
        assert torch.equal(one, other)


@pytest.mark.slow
def test_crossing_is_learned_within_the_default_budget(tmp_path):
    """A few minutes of one core."""
    run = default_run("crossing")
    changes = {"evaluations": 2, "evaluation": {"dynamics": "point_mass"}}
    rows = train(dataclasses.replace(run, **changes), tmp_path)
    assert rows[0]["safe_success"] == 0
    assert rows[-1]["safe_success"] >= 0.9


@pytest.mark.parametrize("task", FAST_OWN)
def test_fast_settings_replace_those_of_ppo(task, tmp_path):
    run, usual, own = default_run(task, FAST), default_run(task), FAST_OWN[task]
    flight = FAST_FLIGHT if issubclass(find_task(task), GoalFlight) else {}
    assert run.algo == FAST
    for name in ("steps", "worlds", "evaluations", "stages"):
        assert getattr(run, name) == {**vars(usual), **flight, **own}[name]
    for name in ("options", "model"):
        layers = (getattr(usual, name), flight.get(name, {}), own.get(name, {}))
        assert getattr(run, name) == {**layers[0], **layers[1], **layers[2]}
    check_algorithm(run)
    (tmp_path / "run.yaml").write_text(run.text())
    assert RunConfig.read(tmp_path / "run.yaml").text() == run.text()
    # The environment accepts the options
    EnvSpec(task, 1, {**run.options, **run.stages[-1]})


def test_fast_settings_of_other_tasks_are_those_of_ppo(monkeypatch):
    monkeypatch.setattr(schedules, "FAST_OWN", {})
    run = default_run("follow", FAST)
    assert dataclasses.replace(run, algo="ppo") == default_run("follow")
    check_algorithm(run)


def test_shipped_runs_of_another_algorithm_are_no_defaults_of_ppo(monkeypatch):
    known = dataclasses.replace(shipped_run("mec"), algo=FAST, model={})
    monkeypatch.setattr(schedules, "shipped_run", lambda task: known)
    assert default_run("mec").algo == "ppo"
    assert default_run("mec").model == {**SERVICE["model"]}


@pytest.mark.parametrize("task", shipped_tasks())
def test_policies_of_the_package_are_those_of_the_default_settings(task):
    run = shipped_run(task)
    if run.algo == FAST:
        assert run.text() == default_run(task, FAST).text()


@pytest.mark.parametrize(("drones", "users"), [(2, 7), (5, 30)])
def test_a_policy_of_services_flies_with_other_numbers_of_drones_and_users(drones, users):
    pilot = find_policy("trained", "mobile_users")
    options = {**pilot.options, "num_drones": drones, "num_users": users}
    aviary = bulletuav.Aviary("mobile_users", 1, **options)
    policy, observations = pilot(aviary), aviary.reset(seeds=0)
    actions = policy.act(observations, aviary.swarm)
    aviary.close()
    assert actions.shape == (1, drones, 3)
    assert np.isfinite(actions).all()
    assert (actions != 0).any(axis=-1).all()
