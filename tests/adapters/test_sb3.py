import importlib
import sys

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict, Discrete
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.buffers import RolloutBuffer

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv, LivingReplay, LivingRollouts
from bulletuav.envs.curriculum import Curriculum
from bulletuav.tasks import find_task

CALM = {"dynamics": "single_integrator", "difficulty": "easy", "num_drones": 3}
SHORT = CALM | {"horizon": 5}
BREAK = {**CALM, "horizon": 400, "radius": 20.0, "margin": 10.0}
"""Drones that fly at random leave this small arena one after the other"""


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def rolled(env, steps, rng):
    """Observations, rewards, dones and infos of so many decisions."""
    env.seed(0)
    observations = [env.reset()]
    rest = []
    for _ in range(steps):
        after, *others = env.step(rng.uniform(-1, 1, (env.num_envs, *env.action_space.shape)))
        observations.append(after)
        rest.append(others)
    return observations, *zip(*rest, strict=True)


def test_slots_are_the_drones_of_the_batched_aviary():
    env, batch = DroneVecEnv("converge", 2, **SHORT), bulletuav.batch_env("converge", 2, **SHORT)
    rng = np.random.default_rng(1)
    env.seed(0)
    np.testing.assert_array_equal(env.reset(), batch.reset(seed=0)[0].reshape(6, -1))
    for _ in range(4):
        action = rng.uniform(-1, 1, (2, 3, 3))
        observations, rewards, dones, infos = env.step(action.reshape(6, 3))
        expected, expected_rewards, *_ = batch.step(action)
        np.testing.assert_array_equal(observations, expected.reshape(6, -1))
        np.testing.assert_array_equal(rewards, expected_rewards.reshape(6).astype(np.float32))
        assert not dones.any()
        assert infos == [{}] * 6
    env.close()
    batch.close()


def test_the_horizon_truncates_and_tells_what_was_seen_last():
    env, batch = DroneVecEnv("converge", 2, **SHORT), bulletuav.batch_env("converge", 2, **SHORT)
    batch.reset(seed=0)
    observations, _, dones, infos = rolled(env, 5, np.random.default_rng(1))
    rng = np.random.default_rng(1)
    for _ in range(5):
        last = batch.step(rng.uniform(-1, 1, (6, 3)).reshape(2, 3, 3))[0]
    assert dones[-1].all()
    for slot, info in enumerate(infos[-1]):
        assert info["TimeLimit.truncated"]
        np.testing.assert_array_equal(info["terminal_observation"], last[slot // 3, slot % 3])
        assert info["episode"]["l"] == 5
        assert info["episode"]["t"] == pytest.approx(0.5)
    assert not np.array_equal(observations[-1], last.reshape(6, -1))  # but of new episodes
    env.close()
    batch.close()


def test_a_drone_that_left_has_no_reward_until_its_world_starts_anew():
    env = DroneVecEnv("converge", 2, **BREAK)
    observations, rewards, dones, infos = map(np.array, rolled(env, 300, np.random.default_rng(0)))
    absent = np.isnan(rewards)
    left = dones & np.array([["episode" in info for info in row] for row in infos])
    assert absent.any()
    assert left.sum() > 6
    for slot in range(6):
        for t in np.flatnonzero(left[:-1, slot]):
            assert not absent[t, slot]
            assert absent[t + 1, slot] == (not observations[t + 1, slot].any())
    assert not observations[:-1][absent].any()
    assert dones[1:][absent[1:] & ~absent[:-1]].sum() < absent.sum()  # and is not done in each step
    again = absent[:-1] & ~absent[1:]
    assert again.any()
    assert dones[:-1][again].all()  # the transition before a new episode ends the old one
    env.close()


def test_episodes_are_told_of_each_drone_alone():
    env = DroneVecEnv("converge", 2, **BREAK)
    _, rewards, _, infos = rolled(env, 300, np.random.default_rng(0))
    total, count = np.zeros(6), np.zeros(6)
    ended = 0
    for reward, info in zip(rewards, infos, strict=True):
        flown = ~np.isnan(reward)
        total[flown] += reward[flown]
        count += flown
        for slot, one in enumerate(info):
            if "episode" not in one:
                continue
            ended += 1
            episode = one["episode"]
            assert episode["r"] == pytest.approx(total[slot], rel=1e-5)
            assert episode["l"] == count[slot]
            terms = sum(value for name, value in episode.items() if name.startswith("reward/"))
            assert terms == pytest.approx(episode["r"])
            assert not one["TimeLimit.truncated"]  # leaving the arena is an event
            assert episode["reward/out_of_bounds"] == -50.0
            total[slot] = count[slot] = 0
    assert ended > 6
    assert env.decisions == sum((~np.isnan(reward)).sum() for reward in rewards)
    env.close()


def filled(kind, rewards, starts, values, last_done, gamma=0.9):
    """A rollout of slots whose observation is (step, slot)."""
    steps, slots = rewards.shape
    space = Box(-np.inf, np.inf, (2,), np.float32)
    buffer = kind(steps, space, Box(-1, 1, (1,)), "cpu", gae_lambda=0.8, gamma=gamma, n_envs=slots)
    for t in range(steps):
        seen = np.stack([np.full(slots, t), np.arange(slots)], axis=1).astype(np.float32)
        estimate = torch.tensor(values[t], dtype=torch.float32)
        buffer.add(
            seen, np.zeros((slots, 1)), rewards[t].copy(), starts[t], estimate, torch.zeros(slots)
        )
    buffer.compute_returns_and_advantage(torch.tensor(values[-1], dtype=torch.float32), last_done)
    return buffer


def test_rollouts_give_what_was_flown_and_advantages_as_without_empty_slots():
    """Slot 0 flies on; slot 1 ends at step 2, is empty for two steps and starts anew at step 5."""
    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=(8, 2)).astype(np.float32), rng.normal(size=(9, 2))
    starts = np.zeros((8, 2))
    starts[0] = 1
    starts[3, 1] = starts[5, 1] = 1  # dones of steps 2 and 4
    done = np.array([False, True])
    expected = filled(RolloutBuffer, rewards, starts, values, done).advantages
    empty = rewards.copy()
    empty[3:5, 1] = np.nan
    living = filled(LivingRollouts, empty, starts, values, done)
    batches = list(living.get(4))
    assert [len(batch.actions) for batch in batches] == [4, 4, 3, 3]
    seen = torch.cat([batch.observations for batch in batches]).numpy().astype(int)
    assert sorted(map(tuple, seen)) == [
        (t, s) for t in range(8) for s in range(2) if not (s == 1 and t in (3, 4))
    ]
    advantages = torch.cat([batch.advantages for batch in batches]).numpy()
    np.testing.assert_allclose(advantages, expected[seen[:, 0], seen[:, 1]], rtol=1e-6)
    by_hand = rewards[2, 1] - values[2, 1]  # the last of an episode that an event ended
    assert advantages[(seen == (2, 1)).all(axis=1)][0] == pytest.approx(by_hand, rel=1e-5)
    assert len(next(iter(living.get())).actions) == 14


def test_replay_keeps_what_was_flown_in_order_and_forgets_the_oldest():
    space = Box(-np.inf, np.inf, (1,), np.float32)
    replay = LivingReplay(5, space, Discrete(3), "cpu", n_envs=4)
    empty = {"TimeLimit.truncated": True}
    for t in range(2):
        seen = np.arange(4.0).reshape(4, 1) + 10 * t
        reward, done = np.array([0.0, np.nan, 2.0, 3.0]), np.array([False, True, True, False])
        replay.add(seen, seen + 1, np.arange(4) % 3, reward, done, [{}, empty, empty, {}])
    assert replay.full
    assert replay.pos == 1
    np.testing.assert_array_equal(replay.observations.ravel(), [13, 2, 3, 10, 12])
    np.testing.assert_array_equal(replay.next_observations.ravel(), [14, 3, 4, 11, 13])
    np.testing.assert_array_equal(replay.actions.ravel(), [0, 2, 0, 0, 2])
    np.testing.assert_array_equal(replay.rewards.ravel(), [3, 2, 3, 0, 2])
    sample = replay.sample(64)
    assert set(sample.dones.numpy().ravel()) == {0.0}  # the horizon is no terminal state


def test_without_the_buffers_empty_slots_are_an_error():
    torch.manual_seed(0)
    env = DroneVecEnv("converge", 2, **BREAK)
    with pytest.raises(ValueError, match="nan"):
        PPO("MlpPolicy", env, seed=0, device="cpu", n_steps=64, batch_size=384).learn(1000)
    env.close()


def trained(seed):
    env = DroneVecEnv("converge", 2, **BREAK)
    model = PPO(
        "MlpPolicy",
        env,
        seed=seed,
        device="cpu",
        n_steps=64,
        batch_size=128,
        rollout_buffer_class=LivingRollouts,
    )
    model.learn(800)
    env.close()
    return torch.cat([weights.detach().ravel() for weights in model.policy.parameters()])


def test_the_same_seed_gives_the_same_weights_and_another_seed_others():
    first = trained(0)
    assert torch.isfinite(first).all()
    assert torch.equal(first, trained(0))
    assert not torch.equal(first, trained(1))


def test_a_model_is_saved_and_goes_on_with_another_environment(tmp_path):
    env = DroneVecEnv("converge", 2, action="discrete", **BREAK)
    model = DQN(
        "MlpPolicy", env, seed=0, device="cpu", learning_starts=50, replay_buffer_class=LivingReplay
    )
    model.learn(200)
    model.save(tmp_path / "model")
    observation = env.reset()
    env.close()
    fresh = DroneVecEnv("converge", 2, action="discrete", **BREAK)
    loaded = DQN.load(tmp_path / "model", fresh, device="cpu")
    np.testing.assert_array_equal(loaded.predict(observation)[0], model.predict(observation)[0])
    loaded.learn(100, reset_num_timesteps=False)
    fresh.close()


def test_success_leads_through_the_levels_and_a_change_truncates():
    stages = [{"num_drones": 1, "horizon": 3}, {"num_drones": 2, "horizon": 6}]
    options = {"dynamics": "single_integrator", "action": "velocity", "min_in_place": 0.1}
    env = DroneVecEnv("hover", 2, stages, Curriculum(2, window=2), **options)
    assert env.num_envs == 4
    env.seed(0)
    observations = env.reset()
    assert observations[[0, 2]].any(axis=1).all()
    assert not observations[[1, 3]].any()
    for _ in range(3):
        assert env.curriculum.stage == 0
        goal = observations[:, 4:7]
        observations, rewards, dones, infos = env.step(6.0 * goal)
        np.testing.assert_array_equal(np.isnan(rewards), [False, True, False, True])
    assert env.curriculum.stage == 1
    assert dones.all()
    assert [info.get("is_success") for info in infos] == [True, None, True, None]
    assert observations.any(axis=1).all()
    rewards = env.step(np.zeros((4, 3)))[1]
    assert np.isfinite(rewards).all()
    env.close()


def test_levels_are_not_passed_over_when_many_worlds_end_at_once():
    easy = {
        "dynamics": "single_integrator",
        "action": "velocity",
        "horizon": 2,
        "goal_radius": 10.0,
    }
    env = DroneVecEnv("hover", 8, [{}] * 4, Curriculum(4, window=2), **easy)
    env.reset()
    told = []
    for _ in range(8):
        env.step(np.zeros((8, 3)))
        told.append(env.curriculum.stage)
    assert told == [0, 1, 1, 2, 2, 3, 3, 3]
    env.close()


def test_a_reward_that_is_not_finite_is_an_error_and_no_empty_slot():
    class Undefined(find_task("hover")):
        name = "undefined"

        def reward_terms(self, frame):
            return super().reward_terms(frame) | {"speed": np.full(frame.alive.shape, np.nan)}

    env = DroneVecEnv(Undefined, 1, dynamics="single_integrator", action="velocity")
    env.reset()
    with pytest.raises(ValueError, match="reward of drone 0 in world 0 is nan"):
        env.step(np.zeros((1, 3)))
    env.close()


def test_a_seed_waits_for_a_reset_while_single_worlds_start_again():
    env, other = (DroneVecEnv("converge", 2, **BREAK) for _ in range(2))
    env.reset()
    env.seed(5)
    # The drones of one world leave the arena, and the world starts again
    for _ in range(100):
        dones = env.step(np.float32([[1.0, 0.0, 0.0]] * 3 + [[0.0, 0.0, 0.0]] * 3))[2]
        if dones[:3].all():
            break
    assert dones.tolist() == [True] * 3 + [False] * 3
    other.seed(5)
    np.testing.assert_array_equal(env.reset(), other.reset())
    env.close()
    other.close()


def test_levels_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="observations have shapes"):
        DroneVecEnv("converge", 2, [{}, {"observation": "goal"}], **CALM)
    with pytest.raises(ValueError, match="has 3 stages, and 1 are given"):
        DroneVecEnv("converge", 2, curriculum=Curriculum(3), **CALM)
    with pytest.raises(ValueError, match="num_worlds is 0"):
        DroneVecEnv("converge", 0, **CALM)


def test_a_seed_starts_the_same_worlds_and_zero_is_one():
    env, other = (DroneVecEnv("converge", 2, **CALM) for _ in range(2))
    assert env.seed(0) == [0, 0, 0, 1, 1, 1]
    other.reset()  # whatever it did before
    other.seed(0)
    np.testing.assert_array_equal(env.reset(), other.reset())
    assert not np.array_equal(env.reset(), other.step(np.zeros((6, 3)))[0])
    assert env.seed() == [None] * 6
    with pytest.raises(ValueError, match="seed is -1"):
        env.seed(-1)
    env.close()
    other.close()


def test_what_slots_share_they_share():
    env = DroneVecEnv("converge", 2, render_mode="rgb_array", render_size=(32, 24), **CALM)
    env.reset()
    assert env.get_attr("num_drones") == [3] * 6
    assert env.get_attr("render_mode", [0, 1]) == ["rgb_array"] * 2
    assert env.env_is_wrapped(object) == [False] * 6
    assert env.render().shape == (48, 32, 3)  # a picture of each world
    for call in (lambda: env.set_attr("seed", 0), lambda: env.env_method("render")):
        with pytest.raises(NotImplementedError, match="share one environment"):
            call()
    env.close()
    env.close()


def test_pictures_come_slot_by_slot():
    options = {
        "num_drones": 1,
        "observation": ("goal_offset", "rgb"),
        "camera_size": (16, 12),
        "action": "velocity",
    }
    env = DroneVecEnv("hover", 2, horizon=2, **options)
    assert isinstance(env.observation_space, Dict)
    observations = env.reset()
    assert observations["rgb"].shape == (2, 12, 16, 3)
    assert observations["rgb"].dtype == np.uint8
    env.step(np.zeros((2, 3)))
    infos = env.step(np.zeros((2, 3)))[3]
    assert infos[1]["terminal_observation"]["vector"].shape == (3,)
    env.close()


def test_a_shared_reward_is_the_mean_of_the_world():
    own, shared = (
        DroneVecEnv("converge", 2, shared_reward=share, **BREAK) for share in (False, True)
    )
    alone, together = (
        np.array(rolled(env, 200, np.random.default_rng(0))[1]) for env in (own, shared)
    )
    np.testing.assert_array_equal(np.isnan(alone), np.isnan(together))
    mean = (
        np.nan_to_num(alone)
        .reshape(200, 2, 3)
        .mean(axis=2, keepdims=True)
        .repeat(3, axis=2)
        .reshape(200, 6)
    )
    flown = ~np.isnan(alone)
    assert not flown.all()
    np.testing.assert_allclose(together[flown], mean[flown], rtol=1e-4, atol=1e-4)
    own.close()
    shared.close()


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    names = ("sb3", "sb3_buffers", "features")
    for name in names:
        monkeypatch.delitem(sys.modules, f"bulletuav.adapters.{name}")
    for name in ("", ".common.torch_layers", ".common.buffers"):
        monkeypatch.setitem(sys.modules, f"stable_baselines3{name}", None)
    for name in names:
        with pytest.raises(ImportError, match=r"\[sb3\]'"):
            importlib.import_module(f"bulletuav.adapters.{name}")


def test_staggered_worlds_cut_their_first_episodes_at_different_times():
    env = DroneVecEnv("converge", 5, staggered=True, **SHORT)
    env.seed(0)
    env.reset()
    ends = []
    for _ in range(11):
        _, _, dones, infos = env.step(np.zeros((15, 3)))
        ends.append(dones.reshape(5, 3).all(axis=1).tolist())
        for done, info in zip(dones, infos, strict=True):
            assert ("terminal_observation" in info) == done
    # World w of 5 is cut after w + 1 of 5 decisions, and again at the horizon from there on
    expected = [[(step - (w + 1)) % 5 == 0 and step > w for w in range(5)] for step in range(1, 12)]
    assert ends == expected
    env.close()


def test_cut_episodes_are_truncated_and_do_not_count():
    env = DroneVecEnv("converge", 2, [{}, {}], Curriculum(2, window=1), staggered=True, **SHORT)
    env.seed(0)
    env.reset()
    for _ in range(2):
        *_, infos = env.step(np.zeros((6, 3)))
    assert [set(info) for info in infos[:3]] == [
        {"terminal_observation", "TimeLimit.truncated"}
    ] * 3
    assert all(info["TimeLimit.truncated"] for info in infos[:3])
    assert env.curriculum.state() == Curriculum(2, window=1).state()
    for _ in range(3):
        *_, infos = env.step(np.zeros((6, 3)))
    assert infos[:3] == [{}] * 3
    assert all("episode" in info for info in infos[3:])
    env.close()


# Masks of discrete actions


MASKED = {"action": "discrete", "action_masks": True}


def test_slots_have_the_masks_of_their_drones():
    env = DroneVecEnv("converge", 2, [{"num_drones": 2}, {"num_drones": 3}], **BREAK | MASKED)
    env.seed(0)
    env.reset()
    masks = np.stack(env.env_method("action_masks"))
    assert masks.shape == (6, 7)
    # The first stage has two drones in each world
    assert masks[[2, 5]].tolist() == 2 * [[True] + 6 * [False]]
    of_drones = env.aviary.action_masks().astype(bool).reshape(4, 7)
    np.testing.assert_array_equal(masks[[0, 1, 3, 4]], of_drones)
    np.testing.assert_array_equal(env.env_method("action_masks", indices=[4]), masks[[4]])
    assert env.has_attr("action_masks")
    env.close()
