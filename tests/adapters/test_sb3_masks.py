"""MaskablePPO of sb3-contrib with masks of discrete actions."""

import dataclasses
import sys

import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO

import bulletuav
from bulletuav.adapters.deployed import deployed
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.adapters.sb3_masks import LivingMaskableRollouts
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.training.models import check_settings
from bulletuav.training.trainer import train

CALM = {
    **{"dynamics": "point_mass", "num_drones": 3, "horizon": 60, "radius": 20.0, "margin": 10.0},
    **{"action": "discrete", "action_masks": True, "difficulty": "hard"},
}


def test_maskable_ppo_learns_from_active_drones_and_picks_valid_actions():
    torch.set_num_threads(1)
    env = DroneVecEnv("converge", 2, **CALM)
    buffer = {"rollout_buffer_class": LivingMaskableRollouts}
    model = MaskablePPO("MlpPolicy", env, n_steps=64, batch_size=64, seed=0, **buffer)
    model.learn(64 * 6)
    buffer = model.rollout_buffer
    assert not buffer.action_masks.all()
    assert 0 < len(buffer.flown) < 64 * 6
    assert len(buffer.action_masks) == len(buffer.flown)
    chosen = buffer.actions.astype(int)[:, 0]
    assert buffer.action_masks[np.arange(len(chosen)), chosen].all()
    assert all(torch.isfinite(one).all() for one in model.policy.parameters())
    env.close()


# Training runs

RUN = {
    **{"task": "converge", "steps": 384, "worlds": 2, "evaluations": 2, "episodes": 2},
    **{"options": CALM, "model": {"n_steps": 32}, "evaluation": {"horizon": 60}},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A training run with masks."""
    folder = tmp_path_factory.mktemp("run")
    train(RunConfig.of(RUN), folder)
    return folder


def test_training_runs_learn_with_masks(run, tmp_path):
    # With the same weights after an interrupt
    class InterruptError(Exception):
        pass

    def interrupt(steps):
        if steps > 200:
            raise InterruptError

    with pytest.raises(InterruptError):
        train(RunConfig.of(RUN), tmp_path, interrupt)
    train(RunConfig.of(RUN), tmp_path)
    name = "policy.safetensors"
    assert (run / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("action", ["discrete", "velocity"])
@pytest.mark.parametrize("torch_layers", [False, True])
def test_their_policies_choose_valid_moves_with_and_without_the_option(
    run, action, torch_layers, monkeypatch
):
    if torch_layers:
        monkeypatch.setattr("bulletuav.policies.trained.is_plain", lambda *_: False)
    has_masks = action == "discrete"
    options = {**CALM, "action": action, "action_masks": has_masks, "normalise": False}
    masked = bulletuav.Aviary("converge", 4, **{**CALM, "action": "discrete"})
    aviary = bulletuav.Aviary("converge", 4, **options)
    observations = aviary.reset(seeds=0)
    masked.reset(seeds=0)
    policy = find_policy(str(run))(aviary)
    # East of the bound nothing but staying, and what leads back, is valid
    for one in (aviary, masked):
        one.swarm.position[..., 0] = one.task.arena_high[0] - 0.5
    masks = masked.action_masks().astype(bool)
    assert not masks.all()
    chosen = policy.act(observations, aviary.swarm)
    if has_masks:
        chosen = chosen.astype(int)
        assert np.take_along_axis(masks, chosen, axis=-1).all()
    else:
        # Velocities of valid moves
        velocities = masked.worlds.masks.velocity[0] / 20.0
        near = np.linalg.norm(chosen[:, :, None] - velocities, axis=-1).argmin(axis=-1)
        assert np.take_along_axis(masks, near[..., None], axis=-1).all()
    aviary.close()
    masked.close()


def test_the_mask_decides_between_the_best_moves(run):
    aviary = bulletuav.Aviary("converge", **CALM)
    policy = find_policy(str(run))(aviary)
    observations = aviary.reset(seeds=0)
    network, rows = policy._choose_rows, observations.reshape(3, -1)
    valid = np.ones((3, aviary.action.choices), dtype=bool)
    order = []
    for _ in range(aviary.action.choices):
        order.append(network(rows, valid)[:, 0])
        valid[np.arange(3), order[-1]] = False
    # Each choice once, in the order of their preference
    np.testing.assert_array_equal(np.sort(order, axis=0), np.arange(len(order))[:, None] + [0] * 3)
    np.testing.assert_array_equal(order[0], network(rows)[:, 0])
    aviary.close()


def test_where_masks_would_have_no_effect_an_error_names_the_remedy(run, monkeypatch):
    with pytest.raises(ValueError, match="'a2c' ignores masks: choose 'ppo' or 'fast_ppo', or"):
        RunConfig.of({**RUN, "algo": "a2c", "model": {}})
    with pytest.raises(ValueError, match="stages: action_masks is the same in all stages"):
        RunConfig.of({**RUN, "stages": [{"action_masks": False}, {"difficulty": "easy"}]})
    with pytest.raises(ValueError, match="trained with action_masks, which are computed from"):
        deployed(run)
    config = dataclasses.replace(RunConfig.of(RUN), model={"use_sde": True})
    with pytest.raises(ValueError, match="unknown setting of MaskablePPO: 'use_sde'"):
        check_settings(config)
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.sb3_masks")
    with pytest.raises(ImportError, match=r"\[contrib\]"):
        check_settings(RunConfig.of(RUN))
