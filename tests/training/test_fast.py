"""PPO without PyTorch: its kernels against PyTorch, its runs, and its settings."""

import dataclasses
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch import nn

import bulletuav
from bulletuav.adapters import c_source
from bulletuav.adapters.deployed import deployed
from bulletuav.adapters.slots import DroneSlots
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.policies.neural_network import Network, read_weights
from bulletuav.policies.run import FAST, RunConfig
from bulletuav.policies.swarm_features import find_layout
from bulletuav.training.fast.dense import adam, draw_orthogonal
from bulletuav.training.fast.learner import FastPPO
from bulletuav.training.fast.ppo import (
    compute_advantages,
    compute_gradient,
    run_networks,
    sample_choices,
)
from bulletuav.training.fast.sets import count_encoded, encode
from bulletuav.training.schedules import default_run
from bulletuav.training.segments import make_slots
from bulletuav.training.store import Store
from bulletuav.training.trainer import check_algorithm, train

OPTIONS = {
    "dynamics": "single_integrator",
    "num_drones": 3,
    "difficulty": "easy",
    "horizon": 12,
    "observation": ["velocity", "goal_offset", "intruders"],
    "num_neighbours": 2,
}
MODEL = {"n_steps": 16, "batch_size": 60, "features": "swarm"}


def config(**changes):
    usual = {
        "algo": FAST,
        "steps": 300,
        "worlds": 2,
        "options": OPTIONS,
        "model": MODEL,
        "evaluations": 3,
        "episodes": 1,
        "evaluation": {"dynamics": "single_integrator", "horizon": 5},
    }
    return RunConfig("converge", **{**usual, **changes})


def collected(**changes):
    """Return a learner with a rollout."""
    run = config(**changes)
    env = make_slots(run, DroneSlots)
    learner = FastPPO(run, env)
    learner.begin_segment(5)
    learner.collect()
    return learner, env


def torch_loss(learner, env, weights, rows, seen, state, masks, losses):
    """Loss of PPO, and the parameters of which it is a function.

    State (B, K) is the input of a central critic, and masks (B, C) are those of choices.
    """
    parameters = {name: torch.tensor(array, requires_grad=True) for name, array in weights.items()}
    settings = learner._settings
    if settings.features == "swarm":
        features = SwarmFeatures(env.observation_space, find_layout(env.labels), settings.size)
        named = {
            name.removeprefix("features_extractor."): value
            for name, value in parameters.items()
            if name.startswith("features_extractor")
        }
        known = torch.func.functional_call(features, named, (seen,))
    else:
        known = seen

    def network(kind, last, values):
        k = 0
        while f"mlp_extractor.{kind}_net.{k}.weight" in parameters:
            name = f"mlp_extractor.{kind}_net.{k}"
            values = torch.tanh(
                nn.functional.linear(
                    values, parameters[f"{name}.weight"], parameters[f"{name}.bias"]
                )
            )
            k += 2
        return nn.functional.linear(
            values, parameters[f"{last}.weight"], parameters[f"{last}.bias"]
        )

    actions, before, advantages, returns = rows
    outputs = network("policy", "action_net", known)
    if "log_std" in parameters:
        normal = torch.distributions.Normal(outputs, parameters["log_std"].exp())
        log_prob, entropy = normal.log_prob(actions).sum(1), normal.entropy().sum(1).mean()
    else:
        if masks.shape[1]:
            outputs = torch.where(masks, outputs, torch.tensor(-1e8))
        choices = torch.distributions.Categorical(logits=outputs)
        log_prob, entropy = choices.log_prob(actions[:, 0]), choices.entropy().mean()
    ratio = (log_prob - before).exp()
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    clipped = ratio.clamp(1 - losses.clip, 1 + losses.clip)
    policy = -torch.minimum(ratio * advantages, clipped * advantages).mean()
    known = torch.cat([known, state.sign() * state.abs().log1p()], 1)
    value = (network("value", "value_net", known)[:, 0] - returns).square().mean()
    loss = policy + losses.value * value - losses.entropy * entropy
    is_clipped = (ratio - clipped != 0).float().mean()
    kl = (ratio - 1 - (log_prob - before)).mean()
    parts = (policy, value, -entropy, is_clipped, kl)
    return loss, parameters, [part.item() for part in parts]


MASKED = {"action": "discrete_27", "action_masks": True, "decision_hz": 1}
SHAPES = {
    "swarm": {},
    "no features": {"model": {**MODEL, "features": None}},
    "one layer, entropy": {
        "model": {
            **MODEL,
            "features": None,
            "ent_coef": 0.1,
            "policy_kwargs": {"net_arch": {"pi": [7], "vf": []}},
        }
    },
    "central critic": {"model": {**MODEL, "critic": "state"}},
    "choices, entropy": {
        "options": {**OPTIONS, "action": "discrete"},
        "model": {**MODEL, "ent_coef": 0.3},
    },
    "masks, central critic": {
        "options": {**OPTIONS, **MASKED},
        "model": {**MODEL, "features": None, "ent_coef": 0.3, "critic": "state"},
    },
}


def minibatch(learner):
    """Change the weights, and return the indices of samples, their gradient and their losses."""
    rollout, rng = learner._rollout, np.random.default_rng(0)
    learner.parameters[:] += 0.1 * rng.standard_normal(len(learner.parameters), np.float32)
    # Without saturated units, whose derivatives are rounding errors
    learner.parameters[:] *= 0.5
    compute_advantages(rollout, 0.9, 0.9)
    # Ratios that are clipped on both sides
    rollout.log_densities[:] += 0.3 * rng.standard_normal(rollout.rewards.shape)
    flown = rng.permutation(np.flatnonzero(~np.isnan(rollout.rewards)))[:75]
    found = np.zeros(5)
    compute_gradient(
        learner.parameters,
        learner._gradient,
        learner.networks,
        learner._work,
        rollout,
        flown,
        learner._settings.losses,
        found,
    )
    return flown, learner._gradient, found


@pytest.mark.parametrize("changes", SHAPES.values(), ids=SHAPES)
def test_gradients_are_those_of_pytorch(changes):
    learner, env = collected(**changes)
    seen, states = _observations(learner, changes)
    flown, own_gradient, found = minibatch(learner)
    rollout = learner._rollout
    t, m = np.divmod(flown, env.num_envs)
    arrays = (rollout.actions, rollout.log_densities, rollout.advantages, rollout.returns)
    rows = [torch.tensor(array[t, m]) for array in arrays]
    seen, masks = torch.tensor(seen[t, m]), torch.tensor(rollout.masks[t, m])
    state = torch.tensor(states[t, m // env.num_drones])
    weights = {name: array.copy() for name, array in learner.named_weights().items()}
    loss, parameters, parts = torch_loss(
        learner, env, weights, rows, seen, state, masks, learner._settings.losses
    )
    loss.backward()
    learner.parameters[:] = own_gradient
    for name, gradient in learner.named_weights().items():
        expected = parameters[name].grad.numpy()
        np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(found, parts, rtol=1e-4, atol=1e-6)


def numpy_loss(parameters, learner, chosen):
    """Loss of PPO with choices and a central critic, without features, in double precision."""
    networks, rollout, losses = learner.networks, learner._rollout, learner._settings.losses
    slots = rollout.rewards.shape[1]
    t, m = np.divmod(chosen, slots)
    seen = rollout.encoded[t, m, : networks.actor[0]].astype(float)
    state = rollout.states[t, m * rollout.states.shape[1] // slots].astype(float)

    def network(start, widths, values):
        for k, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
            end = start + inputs * outputs
            weight = parameters[start:end].reshape(outputs, inputs)
            values = (np.tanh(values) if k else values) @ weight.T + parameters[end : end + outputs]
            start = end + outputs
        return values

    logits = network(networks.actor_start, networks.actor, seen)
    logits = np.where(rollout.masks[t, m], logits, -1e8)
    logs = logits - np.log(np.exp(logits).sum(1, keepdims=True))
    entropy = -(np.exp(logs) * logs).sum(1).mean()
    log_prob = logs[np.arange(len(t)), rollout.actions[t, m, 0].astype(int)]
    ratio = np.exp(log_prob - rollout.log_densities[t, m])
    gain = rollout.advantages[t, m].astype(float)
    gain = (gain - gain.mean()) / (gain.std(ddof=1) + 1e-8)
    clipped = ratio.clip(1 - losses.clip, 1 + losses.clip)
    critic = network(networks.critic_start, networks.critic, np.concatenate([seen, state], 1))
    value = ((critic[:, 0] - rollout.returns[t, m]) ** 2).mean()
    policy = -np.minimum(ratio * gain, clipped * gain).mean()
    return policy + losses.value * value - losses.entropy * entropy


def test_gradients_are_finite_differences_of_the_loss():
    learner, _ = collected(**SHAPES["masks, central critic"])
    chosen, gradient, _ = minibatch(learner)
    t, m = np.divmod(chosen, learner._rollout.rewards.shape[1])
    assert not learner._rollout.masks[t, m].all()
    parameters = learner.parameters.astype(float)
    for k in np.random.default_rng(1).permutation(len(parameters))[:200]:
        around = []
        for change in (1e-5, -1e-5):
            moved = parameters.copy()
            moved[k] += change
            around.append(numpy_loss(moved, learner, chosen))
        difference = (around[0] - around[1]) / 2e-5
        assert gradient[k] == pytest.approx(difference, rel=1e-3, abs=1e-5)


def test_choices_are_drawn_by_their_probabilities():
    # Probabilities 1/6, 2/6, 3/6; and 1/4, 0, 3/4 where the second choice is masked
    uniform = np.linspace(0.0, 0.99, 100, dtype=np.float32)
    for valid, bounds in (([], [1 / 6, 3 / 6, 1.0]), ([True, False, True], [0.25, 0.25, 1.0])):
        logits = np.tile(np.log(np.array([1, 2, 3], np.float32)), (100, 1))
        masks = np.tile(np.array(valid, bool), (100, 1))
        actions, logs = np.zeros((100, 1), np.float32), np.zeros(100, np.float32)
        sample_choices(uniform, logits, masks, actions, logs)
        expected = np.searchsorted(bounds, uniform, side="right")
        np.testing.assert_array_equal(actions[:, 0], expected)
        shares = np.diff([0.0, *bounds])[expected]
        np.testing.assert_allclose(np.exp(logs), shares, rtol=1e-6)


def _observations(learner, changes):
    """Observations and states of the rollout, from a second one with the same seed."""
    again, other = collected(**changes)
    seen, states = [], []
    step = other.step_async
    size = learner._rollout.states.shape[2]

    def spy(actions):
        seen.append(again._seen)
        states.append(other.state()[:, :size])
        step(actions)

    other.step_async = spy
    again.begin_segment(5)
    again.num_steps = 0
    again.collect()
    np.testing.assert_array_equal(again._rollout.actions, learner._rollout.actions)
    return np.array(seen), np.array(states)


def test_advantages_are_sums_of_discounted_errors_of_an_episode():
    learner, _ = collected()
    rollout, rng = learner._rollout, np.random.default_rng(1)
    shape = rollout.rewards.shape
    rollout.rewards[:] = rng.standard_normal(shape)
    rollout.values[:] = rng.standard_normal(rollout.values.shape)
    rollout.done[:] = rng.random(shape) < 0.2
    rollout.rewards[5:9, 1] = np.nan
    rollout.done[4, 1] = 1
    compute_advantages(rollout, 0.9, 0.8)
    for m in range(shape[1]):
        for t in range(shape[0]):
            total, factor = 0.0, 1.0
            for k in range(t, shape[0]):
                if np.isnan(rollout.rewards[k, m]):
                    break
                goes_on = 1 - rollout.done[k, m]
                after = 0.9 * goes_on * rollout.values[k + 1, m]
                total += factor * (rollout.rewards[k, m] + after - rollout.values[k, m])
                factor *= 0.9 * 0.8 * goes_on
            assert rollout.advantages[t, m] == pytest.approx(total, abs=1e-5)
            if not np.isnan(rollout.rewards[t, m]):
                value = rollout.values[t, m]
                assert rollout.returns[t, m] == pytest.approx(total + value, abs=1e-5)


@pytest.mark.parametrize("max_norm", [0.5, 1e6])
def test_the_optimizer_is_adam_with_a_clipped_gradient(max_norm):
    rng = np.random.default_rng(2)
    own = rng.standard_normal(50).astype(np.float32)
    other = torch.tensor(own.copy(), requires_grad=True)
    optimizer = torch.optim.Adam([other], lr=0.01, eps=1e-5)
    mean, square = np.zeros((2, 50), np.float32)
    for step in range(1, 20):
        gradient = rng.standard_normal(50).astype(np.float32)
        other.grad = torch.tensor(gradient.copy())
        nn.utils.clip_grad_norm_([other], max_norm)
        optimizer.step()
        adam(own, gradient, mean, square, step, 0.01, max_norm)
    np.testing.assert_allclose(own, other.detach().numpy(), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("outputs", "inputs"), [(5, 9), (9, 5), (4, 4), (1, 6)])
def test_initial_weights_are_orthogonal(outputs, inputs):
    drawn = draw_orthogonal(np.random.default_rng(3), outputs, inputs, 2.0).astype(float)
    product = drawn @ drawn.T if outputs <= inputs else drawn.T @ drawn
    np.testing.assert_allclose(product, 4.0 * np.eye(len(product)), atol=1e-5)


def test_values_of_truncated_episodes_are_added_to_the_last_reward():
    # All episodes end after three decisions, without termination
    learner, _ = collected(options={**OPTIONS, "horizon": 3})
    rewards = []
    for value in (0.0, 10.0):
        learner.parameters[:] = 0.0
        learner.named_weights()["value_net.bias"][:] = value
        learner.begin_segment(5)
        learner.collect()
        rewards.append(learner._rollout.rewards.copy())
    truncated = np.zeros(16, dtype=bool)
    truncated[2::3] = True
    np.testing.assert_array_equal(learner._rollout.done.astype(bool).all(1), truncated)
    expected = 0.99 * 10.0 * truncated[:, None] * np.ones(6)
    np.testing.assert_allclose(rewards[1] - rewards[0], expected, atol=1e-5)


def test_values_of_truncated_episodes_are_of_the_state_before_the_reset():
    options = {**OPTIONS, "horizon": 3}
    linear = {"net_arch": {"pi": [8], "vf": []}}
    model = {**MODEL, "n_steps": 3, "critic": "state", "policy_kwargs": linear}
    learner, env = collected(options=options, model=model)
    names = [label.name for label in env.aviary.global_state.labels]
    height = names.index("position z of drone_1")
    rewards = []
    learner.parameters[:] = 0.0
    for weight in (0.0, 1.0):
        # The critic returns the logarithm of the height of the second drone
        critic = learner.named_weights()["value_net.weight"]
        critic[0, learner.networks.actor[0] + height] = weight
        learner.begin_segment(5)
        learner.collect()
        rewards.append(learner._rollout.rewards.copy())
    other = bulletuav.batch_env("converge", 2, **options)
    other.reset(seed=5)
    for actions in np.clip(learner._rollout.actions, -1, 1):
        other.step(actions.reshape(2, 3, -1))
    expected = 0.99 * np.log1p(other.state()[:, height]).repeat(3)
    np.testing.assert_allclose(rewards[1][2] - rewards[0][2], expected, atol=1e-5)
    np.testing.assert_array_equal(rewards[1][:2], rewards[0][:2])


def weights(folder):
    found = read_weights(folder / "policy.safetensors")
    return np.concatenate([found[name].ravel() for name in sorted(found)])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    return folder, train(config(), folder)


def test_a_run_has_the_files_and_columns_of_the_others(run):
    folder, rows = run
    assert [row["steps"] for row in rows] == [0, 192, 288, 384]
    assert rows[-1]["decisions"] > 300
    assert (folder / "curve.csv").read_text().count("\n") == 5
    assert (folder / "updates.csv").read_text().startswith("steps,rollout/return,")
    assert "train/value_loss" in (folder / "updates.csv").read_text()
    assert "torch" not in (folder / "run.yaml").read_text()
    assert len(list(folder.glob("checkpoints/*/training.safetensors"))) == 1
    assert len(list(folder.glob("checkpoints/*/policy.safetensors"))) == 4


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(run, tmp_path):
    train(RunConfig.read(run[0] / "run.yaml"), tmp_path / "again")
    np.testing.assert_array_equal(weights(tmp_path / "again"), weights(run[0]))
    train(config(seed=1), tmp_path / "other")
    assert not np.array_equal(weights(tmp_path / "other"), weights(run[0]))


def test_an_interrupted_run_goes_on_to_the_weights_of_one_that_was_not(run, tmp_path):
    def progress(done):
        if done > 250:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config(), tmp_path, progress)
    assert len(Store(tmp_path, config()).rows) == 2
    train(config(), tmp_path)
    np.testing.assert_array_equal(weights(tmp_path), weights(run[0]))
    rows = [(folder / "updates.csv").read_text() for folder in (run[0], tmp_path)]
    assert rows[0] == rows[1]


OTHERS = {
    "central critic": {"model": {**MODEL, "critic": "state"}},
    "choices": {"options": {**OPTIONS, "action": "discrete"}},
    "masks": {"options": {**OPTIONS, **MASKED}},
}


@pytest.mark.parametrize("changes", OTHERS.values(), ids=OTHERS)
def test_runs_with_other_critics_and_actions_are_resumed_and_flown(changes, tmp_path):
    def progress(done):
        if done > 250:
            raise KeyboardInterrupt

    run = config(**changes)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train(run, whole)
    with pytest.raises(KeyboardInterrupt):
        train(run, cut, progress)
    train(run, cut)
    np.testing.assert_array_equal(weights(cut), weights(whole))
    # The policy flies as the learner, which then chooses the action of the largest output
    env = make_slots(run, DroneSlots)
    learner = FastPPO(run, env)
    learner.restore(max(whole.glob("checkpoints/*")))
    learner.begin_segment(0)
    learner._observe(0)
    outputs, rollout = learner._outputs, learner._rollout
    learner._run(rollout.encoded[0], rollout.states[0], outputs, rollout.values[0])
    network = Network(read_weights(whole / "policy.safetensors"), FAST, run.settings, env.labels)
    masks = env.action_masks() if run.action_masks else None
    acted = network(learner._seen, masks)
    if learner.networks.choices:
        outputs[masks == np.False_] = -np.inf
        expected = outputs.argmax(1)[:, None]
    else:
        expected = np.clip(outputs, -1, 1)
    np.testing.assert_allclose(acted, expected, atol=1e-5)


def test_a_central_critic_has_the_names_of_stable_baselines3(tmp_path):
    learner, env = collected(**OTHERS["central critic"])
    learner.save(tmp_path)
    found = read_weights(tmp_path / "policy.safetensors")
    features = found["mlp_extractor.policy_net.0.weight"].shape[1]
    assert found["mlp_extractor.value_net.0.weight"].shape == (64, features + env.state_size)


def test_a_policy_of_choices_is_exported(tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    from bulletuav.adapters.onnx import run_onnx, write_onnx

    train(config(**OTHERS["choices"]), tmp_path / "run")
    policy = deployed(tmp_path / "run")
    rows = policy.observations()
    (path,) = write_onnx(policy, tmp_path / "pilot.onnx", "double")
    np.testing.assert_allclose(run_onnx(path, rows, policy, "double"), policy.act(rows), atol=1e-6)
    if c_source.find_compiler() is not None:
        source, _ = c_source.write_c(policy, tmp_path / "pilot.c", "double")
        given = c_source.run_c(source, rows, policy, "double")
        np.testing.assert_allclose(given, policy.act(rows), atol=1e-6)


def test_a_damaged_checkpoint_is_refused(run, tmp_path):
    learner, _ = collected()
    with pytest.raises(ValueError, match="holds no checkpoint of this run"):
        learner.restore(tmp_path)
    other, _ = collected(model={**MODEL, "policy_kwargs": {"net_arch": [8]}})
    last = max(run[0].glob("checkpoints/*"))
    with pytest.raises(ValueError, match="parameters have another size"):
        other.restore(last)


UPDATE = """
from bulletuav.adapters.slots import DroneSlots
from bulletuav.policies.run import RunConfig
from bulletuav.training.fast.learner import FastPPO
from bulletuav.training.segments import make_slots

options = {"dynamics": "single_integrator", "action": "velocity", "horizon": 6}
model = {"n_steps": 8, "batch_size": 8, "n_epochs": 1, "policy_kwargs": {"net_arch": [4]}}
run = RunConfig("hover", algo="fast_ppo", steps=16, worlds=2, options=options, model=model)
learner = FastPPO(run, make_slots(run, DroneSlots))
learner.begin_segment(5)
learner.collect()
learner.update()
print(*learner.parameters.tolist())
"""


def test_an_update_is_the_same_in_plain_python():
    def update(**variables):
        environment = {**os.environ, **variables}
        command = [sys.executable, "-c", UPDATE]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        return np.array(done.stdout.split(), dtype=float)

    # Plain numbers are rounded to single precision in other places
    np.testing.assert_allclose(update(NUMBA_DISABLE_JIT="1"), update(), rtol=1e-4, atol=1e-6)


def test_a_policy_acts_as_the_learner_does(run):
    folder, _ = run
    env = bulletuav.batch_env("converge", 2, **OPTIONS)
    learner, _ = collected()
    learner.restore(max(folder.glob("checkpoints/*")))
    seen, _ = env.reset(seed=0)
    rows = seen.reshape(6, -1).astype(np.float32)
    encoded = np.zeros((6, count_encoded(learner.networks.sets)), np.float32)
    encode(rows, learner.networks.sets, encoded)
    means, values = np.zeros((6, 3), np.float32), np.zeros(6, np.float32)
    states = np.zeros((6, 0), np.float32)
    run_networks(
        learner.parameters, learner.networks, learner._work, encoded, states, means, values
    )
    network = Network(
        read_weights(folder / "policy.safetensors"),
        FAST,
        config().settings,
        env.observation_labels,
    )
    np.testing.assert_allclose(network(rows), np.clip(means, -1, 1), atol=1e-5)


@pytest.mark.skipif(c_source.find_compiler() is None, reason="needs a C compiler")
def test_a_policy_is_exported_to_c(run, tmp_path):
    policy = deployed(run[0])
    source, _ = c_source.write_c(policy, tmp_path / "pilot.c", "double")
    rows = policy.observations()
    given = c_source.run_c(source, rows, policy, "double")
    np.testing.assert_allclose(given, policy.act(rows), atol=1e-6)


def test_a_policy_is_exported_to_onnx(run, tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    from bulletuav.adapters.onnx import run_onnx, write_onnx

    policy = deployed(run[0])
    (path,) = write_onnx(policy, tmp_path / "pilot.onnx", "double")
    rows = policy.observations()
    given = run_onnx(path, rows, policy, "double")
    np.testing.assert_allclose(given, policy.act(rows), atol=1e-6)


WITHOUT = """
import sys
from pathlib import Path

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "stable_baselines3", "tensorboard", "filelock"):
            raise ImportError(name)

sys.meta_path.insert(0, Blocked())
from bulletuav.cli import main

sys.argv = ["bulletuav", "train", "converge", "--algo", "fast_ppo", "--steps", "100", "--worlds",
    "1", "--evaluations", "1", "--episodes", "1", "--horizon", "5", "--out", sys.argv[1]]
sys.exit(main())
"""


def test_training_needs_no_extra(tmp_path):
    command = [sys.executable, "-c", WITHOUT, str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, None), done.stderr
    assert (tmp_path / "run" / "policy.safetensors").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": {"n_step": 5}}, "fast_ppo has no setting 'n_step': did you mean 'n_steps'"),
        ({"model": {"use_sde": True}}, "choose --algo ppo"),
        ({"model": {"n_steps": 0}}, "n_steps is 0"),
        ({"model": {"gamma": 1.5}}, "gamma is 1.5"),
        ({"model": {"learning_rate": [1, 2, 3]}}, "learning_rate is"),
        ({"model": {"features": "user_sum"}}, "fast_ppo: unknown features 'user_sum'"),
        ({"model": {"critic": "stat"}}, "unknown critic 'stat': did you mean 'state'"),
        ({"model": {"policy_kwargs": {"activation_fn": 1}}}, "policy_kwargs: fast_ppo has no"),
        ({"model": {"policy_kwargs": 3}}, "policy_kwargs is 3"),
        ({"model": {"policy_kwargs": {"net_arch": [0]}}}, "net_arch is 0"),
        ({"model": {"policy_kwargs": {"net_arch": {"qf": [4]}}}}, "net_arch: fast_ppo has no"),
        (
            {"model": {"policy_kwargs": {"features_extractor_kwargs": {"scales": 4}}}},
            "did you mean 'scale'",
        ),
        # They have an effect with other features only
        (
            {"model": {"policy_kwargs": {"features_extractor_kwargs": {"size": 4}}}},
            "features_extractor_kwargs: fast_ppo has no setting 'size'",
        ),
        (
            {
                "model": {
                    "features": None,
                    "policy_kwargs": {"features_extractor_kwargs": {"scale": 4.0}},
                }
            },
            "features_extractor_kwargs: fast_ppo has no setting 'scale': leave it out",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        check_algorithm(config(**changes))


def test_pictures_are_refused(tmp_path):
    options = {**OPTIONS, "observation": ["goal_offset", "depth"]}
    with pytest.raises(ValueError, match="not from pictures: choose --algo ppo"):
        train(config(options=options, model={}), tmp_path)


def test_a_central_critic_of_stages_with_other_states_is_refused(tmp_path):
    stages = [{"num_drones": 2}, {"num_drones": 4}]
    run = config(stages=stages, model={**MODEL, "critic": "state"})
    with pytest.raises(ValueError, match="critic is 'state': the global states of the stages have"):
        train(run, tmp_path)


def test_a_curriculum_with_other_numbers_of_drones_is_learned_and_resumed(tmp_path):
    stages = [{"num_drones": 2}, {"num_drones": 4}]
    run = config(stages=stages, curriculum={"up": 0.01, "down": 0.0, "window": 1})
    rows = train(run, tmp_path)
    assert rows[-1]["steps"] >= 300


def test_hover_is_learned_in_seconds(tmp_path):
    run = default_run("hover", FAST)
    changes = {"options": {**run.options, "difficulty": "medium"}, "evaluations": 1, "episodes": 50}
    rows = train(dataclasses.replace(run, **changes), tmp_path)
    assert rows[-1]["success"] >= 0.9
