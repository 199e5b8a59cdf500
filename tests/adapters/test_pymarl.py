"""The environment of PyMARL's family, driven as these programs' runners do, which CI does not have.

`run_epymarl` and `run_pymarl` make the calls of the episode runners of both, in their order; the
programs themselves are run by hand, see `tests/clients`.
"""

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import bulletuav
from bulletuav.adapters.pymarl import PymarlEnv, register_pymarl

CALM = {"dynamics": "single_integrator", "difficulty": "easy", "num_drones": 3, "seed": 0}
SHORT = CALM | {"horizon": 5}
BREAK = CALM | {"horizon": 400, "radius": 20.0, "margin": 10.0}
"""Drones that fly at random leave this small arena one after the other"""
BOTH = pytest.mark.parametrize("flavour", ["epymarl", "pymarl"])


def chosen(env, rng):
    """Available actions at random, as the runners' action selectors take them: a tensor."""
    import torch

    available = np.array(env.get_avail_actions())
    assert available.shape == (env.n_agents, env.get_total_actions())
    assert set(available.ravel()) <= {0, 1}
    return torch.tensor([rng.choice(np.flatnonzero(row)) for row in available])


def before(env):
    """What both runners store before a step, in the shapes that their buffers have."""
    told = env.get_env_info()
    state, observations = env.get_state(), np.array(env.get_obs())
    assert state.shape == (told["state_shape"],)
    assert observations.shape == (told["n_agents"], told["obs_shape"])
    assert state.dtype == observations.dtype == np.float32
    assert np.isfinite(state).all()
    assert np.isfinite(observations).all()
    return {"state": state, "obs": observations, "avail": np.array(env.get_avail_actions())}


def run_epymarl(env, rng, render=False):
    """EPyMARL's episode runner: transitions, the last info, and what a step told last."""
    env.reset()
    transitions, over = [], False
    while not over:
        row = before(env)
        actions = chosen(env, rng)
        _, reward, terminated, truncated, info = env.step(actions)
        if render:
            env.render()
        over = terminated or truncated
        row |= {"reward": reward, "terminal": over != info.get("episode_limit", False)}
        transitions.append(row)
    transitions.append(before(env))
    chosen(env, rng)  # "select actions in the last stored state"
    assert len(transitions) <= env.episode_limit + 1
    return transitions, info, (terminated, truncated)


def run_pymarl(env, rng):
    """The same by the episode runner of PyMARL and pymarlzooplus."""
    env.reset()
    transitions, over = [], False
    while not over:
        row = before(env)
        reward, over, info = env.step(chosen(env, rng))
        row |= {"reward": reward, "terminal": over != info.get("episode_limit", False)}
        assert env.get_print_info() is None
        transitions.append(row)
    transitions.append(before(env))
    chosen(env, rng)
    return transitions, info, over


def assert_same(one, other):
    assert len(one) == len(other)
    for mine, its in zip(one, other, strict=True):
        assert mine.keys() == its.keys()
        for name in mine:
            np.testing.assert_array_equal(mine[name], its[name])


def test_it_flies_what_the_batched_environment_flies():
    env = PymarlEnv("converge", "pymarl", **SHORT)
    batch = bulletuav.batch_env("converge", 1, action="discrete", **SHORT)
    env.reset(seed=3)
    observations = batch.reset(seed=3)[0]
    rng = np.random.default_rng(0)
    for _ in range(5):
        np.testing.assert_array_equal(np.array(env.get_obs()), observations[0])
        np.testing.assert_array_equal(env.get_state(), batch.state()[0])
        actions = rng.integers(7, size=3)
        observations, rewards, *_ = batch.step(actions[None])
        assert env.step(actions)[0] == rewards.sum()
    np.testing.assert_array_equal(env.get_obs_agent(1), observations[0, 1])  # seen last
    env.close()
    batch.close()


def test_both_programs_store_the_same_transitions():
    five, three = PymarlEnv("converge", **BREAK), PymarlEnv("converge", "pymarl", **BREAK)
    for k in range(3):
        rngs = np.random.default_rng(k), np.random.default_rng(k)
        one, its_info, _ = run_epymarl(five, rngs[0])
        other, info, _ = run_pymarl(three, rngs[1])
        assert_same(one, other)
        assert info == its_info
    five.close()
    three.close()


def test_the_horizon_is_no_terminal_state():
    env = PymarlEnv("converge", **SHORT)
    transitions, info, (terminated, truncated) = run_epymarl(env, np.random.default_rng(0))
    assert len(transitions) == 6
    assert (terminated, truncated, info["episode_limit"]) == (False, True, True)
    assert not any(row["terminal"] for row in transitions[:-1])
    # Values of the last state count, so all actions are available, and it is seen.
    assert transitions[-1]["avail"].all()
    assert transitions[-1]["obs"].any(axis=1).all()
    env.close()


def test_drones_that_left_stay_put_until_the_last_one_ends():
    env = PymarlEnv("converge", **BREAK)
    transitions, info, (terminated, truncated) = run_epymarl(env, np.random.default_rng(0))
    gone = np.array([~row["obs"].any(axis=1) for row in transitions])
    assert gone[1:-1].any()
    assert not gone[0].any()
    assert (gone[1:] >= gone[:-1]).all()
    for row, away in zip(transitions, gone, strict=True):
        assert row["avail"][~away].all()
        assert (row["avail"][away] == [1, 0, 0, 0, 0, 0, 0]).all()
    # All left the arena: an end of its own, after which nothing can be done.
    assert (terminated, truncated, info["episode_limit"]) == (True, False, False)
    assert [row["terminal"] for row in transitions[:-1]].index(True) == len(transitions) - 2
    with pytest.raises(RuntimeError, match="over: call reset"):
        env.step([0, 0, 0])
    env.close()


def test_an_end_by_both_is_no_terminal_state():
    """One drone leaves the arena, the horizon stops the others."""
    env = PymarlEnv("converge", **BREAK | {"horizon": 25})
    for k in range(20):
        transitions, info, ends = run_epymarl(env, np.random.default_rng(k))
        away = ~transitions[-1]["obs"].any(axis=1)
        if away.any() and not away.all():
            break
    assert ends == (False, True)
    assert info["episode_limit"] is True
    np.testing.assert_array_equal(transitions[-1]["avail"].sum(axis=1), np.where(away, 1, 7))
    env.close()


def test_rewards_are_joined_or_each_drones_own():
    options = {"sum": {}, "mean": {"reward_scalarisation": "mean"}, "own": {"common_reward": False}}
    rewards = {}
    for name, option in options.items():
        env = PymarlEnv("converge", **BREAK, **option)
        transitions, *_ = run_epymarl(env, np.random.default_rng(0))
        rewards[name] = np.array([row["reward"] for row in transitions[:-1]])
        gone = np.array([~row["obs"].any(axis=1) for row in transitions[:-1]])
        env.close()
    assert rewards["own"].shape == (len(gone), 3)
    assert (rewards["own"][gone] == 0).all()
    assert (rewards["own"][~gone] != 0).all()
    np.testing.assert_allclose(rewards["sum"], rewards["own"].sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(rewards["mean"], rewards["own"].mean(axis=1), rtol=1e-12)


@BOTH
def test_the_last_info_has_numbers_that_can_be_added(flavour):
    env = PymarlEnv("converge", flavour, **BREAK)
    run = run_epymarl if flavour == "epymarl" else run_pymarl
    transitions, info, _ = run(env, np.random.default_rng(0))
    assert all(isinstance(value, bool | float) for value in info.values())
    assert sum(info.values()) + 0 == pytest.approx(sum(map(float, info.values())))
    returned = sum(row["reward"] for row in transitions[:-1]) / 3
    terms = sum(value for name, value in info.items() if name.startswith("reward_"))
    assert terms == pytest.approx(returned)
    assert info["reward_out_of_bounds"] == -50.0
    assert (info["success"], info["collision"]) == (0.0, 0.0)
    # And none of it before the end
    env.reset()
    assert env.step([0, 0, 0])[-1] == {"episode_limit": False}
    assert env.get_stats() == {}
    env.close()


def test_success_is_a_share_of_the_drones():
    near = {"goal_radius": 37.0, "half_length": 20.0, "lane_spacing": 10.0}
    env = PymarlEnv("crossing", **CALM | near | {"num_drones": 4, "horizon": 6})
    shares = [run_epymarl(env, np.random.default_rng(k))[1]["success"] for k in range(20)]
    assert set(shares) <= {0.0, 0.25, 0.5, 0.75, 1.0}
    assert any(0 < share < 1 for share in shares)
    env.close()


@BOTH
def test_the_same_seed_gives_the_same_bits(flavour):
    run = run_epymarl if flavour == "epymarl" else run_pymarl
    envs = [PymarlEnv("converge", flavour, **SHORT) for _ in range(2)]
    for env in envs:
        env.seed(7)
    first, again = (run(env, np.random.default_rng(0))[0] for env in envs)
    assert_same(first, again)
    # The seed holds for one reset: what follows goes on with the random numbers
    other = run(envs[0], np.random.default_rng(0))[0]
    assert not np.array_equal(other[0]["state"], first[0]["state"])
    envs[0].seed(7)
    assert_same(run(envs[0], np.random.default_rng(0))[0], first)
    # Another seed, as the parallel runners give each process
    envs[1].seed(8)
    assert not np.array_equal(run(envs[1], np.random.default_rng(0))[0][0]["obs"], first[0]["obs"])
    for env in envs:
        env.close()


def test_what_resets_return():
    five, three = PymarlEnv("converge", **SHORT), PymarlEnv("converge", "pymarl", **SHORT)
    (seen, info), (also, state) = five.reset(), three.reset()
    np.testing.assert_array_equal(seen, also)
    np.testing.assert_array_equal(state, three.get_state())
    assert info == {}
    five.close()
    three.close()


def test_symlog_compresses_observations_and_state():
    plain, small = PymarlEnv("converge", **SHORT), PymarlEnv("converge", symlog=True, **SHORT)
    for env in (plain, small):
        env.reset()
    for what in ("get_obs", "get_state"):
        metres, logs = np.array(getattr(plain, what)()), np.array(getattr(small, what)())
        assert abs(metres).max() > 50 > 6 > abs(logs).max()
        np.testing.assert_allclose(logs, np.sign(metres) * np.log1p(abs(metres)), rtol=1e-6)
        assert logs.dtype == np.float32
    plain.close()
    small.close()


def test_teams_that_observe_less_have_zeros():
    mixed = {"chasers": ["velocity", "room"], "evaders": ["velocity"]}
    options = {"num_drones": 4, "dynamics": "point_mass", "observation": mixed}
    env = PymarlEnv("pursuit_evasion", reward_scalarisation="mean", **options)
    env.reset()
    assert env.get_obs_size() == 9
    seen = np.array(env.get_obs())
    assert seen.shape == (4, 9)
    assert not seen[3, 3:].any()
    assert seen[:3, 3:].all()
    env.close()


def test_all_27_directions():
    env = PymarlEnv("converge", action="discrete_27", **SHORT)
    assert env.get_total_actions() == env.get_env_info()["n_actions"] == 27
    run_epymarl(env, np.random.default_rng(0))
    env.close()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0, 0], "a whole number for each of the 3 drones"),
        ([0.5, 0, 0], "a whole number for each of the 3 drones"),
        (3, "a whole number for each of the 3 drones"),
        ([0, 7, 0], "drone 1 .* is 7: a whole number from 0 to 6"),
        ([0, 0, -1], "drone 2 .* is -1: a whole number from 0 to 6"),
    ],
)
def test_actions_that_cannot_be_fly_nobody(actions, message):
    env = PymarlEnv("converge", **SHORT)
    env.reset()
    state = env.get_state()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    np.testing.assert_array_equal(env.get_state(), state)
    env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "convergence"}, "unknown task 'convergence': did you mean 'converge'"),
        ({"flavour": "pymarl2"}, "unknown flavour 'pymarl2': did you mean 'pymarl'"),
        ({"reward_scalarisation": "max"}, "unknown reward_scalarisation 'max'"),
        ({"dynamic": "bullet"}, "did you mean 'dynamics'"),
        ({"action": "velocity"}, "action is 'velocity': .* MADDPG too; choose 'discrete'"),
        ({"observation_format": "dict"}, "these programs take a vector"),
        ({"flavour": "pymarl", "common_reward": False}, "EPyMARL alone"),
    ],
)
def test_what_these_programs_cannot_take_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PymarlEnv(**{"task": "converge"} | options)


def test_opponents_have_rewards_of_their_own():
    env = PymarlEnv("pursuit_evasion", common_reward=False, horizon=3, seed=0)
    transitions, *_ = run_epymarl(env, np.random.default_rng(0))
    assert len(transitions[0]["reward"]) == env.n_agents > 2
    env.close()


def test_calls_out_of_order():
    env = PymarlEnv("converge", **SHORT)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step([0, 0, 0])
    with pytest.raises(ValueError, match="agent_id is 3"):
        env.get_obs_agent(3)
    with pytest.raises(ValueError, match="seed is -1"):
        env.seed(-1)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_a_registry_makes_environments_of_env_args():
    registry = {}
    register_pymarl(registry)
    register_pymarl(registry, "drones", flavour="pymarl")
    # As the parallel runners do: the recipe goes to another process
    make, make_other = pickle.loads(pickle.dumps((registry["bulletuav"], registry["drones"])))
    common = {"common_reward": False, "reward_scalarisation": "sum"}
    env = make(map_name="converge", **SHORT, **common)
    env.reset()
    assert len(env.step([0, 0, 0])) == 5
    other = make_other(key="converge", **SHORT)
    other.reset()
    assert len(other.step([0, 0, 0])) == 3
    copy = pickle.loads(pickle.dumps(env))
    assert copy.get_env_info() == env.get_env_info()
    for one in (env, other, copy):
        one.close()
    with pytest.raises(ValueError, match="no map_name"):
        make(**SHORT)
    with pytest.raises(ValueError, match="unknown flavour 'smac'"):
        register_pymarl(registry, flavour="smac")


def test_a_replay_is_the_last_episode_in_pictures(tmp_path):
    options = {"render_mode": "rgb_array", "render_size": (64, 48)}
    env = PymarlEnv("converge", **SHORT, **options, replay_dir=tmp_path / "replays")
    with pytest.raises(RuntimeError, match="no images for a replay"):
        env.save_replay()
    for k in range(2):
        run_epymarl(env, np.random.default_rng(k), render=True)
        env.save_replay()
    written = sorted((tmp_path / "replays").iterdir())
    assert [path.name for path in written] == ["converge-001.gif", "converge-002.gif"]
    with Image.open(written[1]) as replay:
        assert (replay.n_frames, replay.size) == (5, (64, 48))
        assert replay.info["duration"] == 100
    env.close()


def test_pictures_are_kept_for_replays_alone():
    env = PymarlEnv("converge", **SHORT, render_mode="rgb_array", render_size=(64, 48))
    env.reset()
    assert env.render().shape == (48, 64, 3)
    with pytest.raises(RuntimeError, match="give the environment replay_dir"):
        env.save_replay()
    env.close()


def test_moves_out_of_the_arena_are_not_available_with_masks():
    """Without masks, random flight leaves this small arena (see `BREAK`)."""
    env = PymarlEnv("converge", action_masks=True, **BREAK)
    transitions, info, _ = run_epymarl(env, np.random.default_rng(0))
    assert len(transitions) == 401
    assert info["collision"] < 1
    available = np.array([row["avail"] for row in transitions])
    assert available[:, :, 0].all()
    assert not available.all()
    env.close()


@pytest.fixture
def example():
    """The example that evaluates agents of these programs."""
    path = Path(__file__).parents[2] / "examples" / "pymarl" / "evaluate.py"
    spec = importlib.util.spec_from_file_location("evaluate_pymarl", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def save_agent(folder, observed, *, recurrent=False):
    """Write the file of an agent as these programs do, and return its network."""
    import torch

    torch.manual_seed(0)
    kind = torch.nn.GRUCell if recurrent else torch.nn.Linear
    layers = {"fc1": torch.nn.Linear(observed, 8), "rnn": kind(8, 8), "fc2": torch.nn.Linear(8, 7)}
    torch.save(torch.nn.ModuleDict(layers).state_dict(), folder / "agent.th")
    order = [layers["fc1"], torch.nn.ReLU(), layers["rnn"], torch.nn.ReLU(), layers["fc2"]]
    return torch.nn.Sequential(*order)


def test_a_saved_agent_flies_its_actions_of_highest_value(example, tmp_path):
    import torch

    network = save_agent(tmp_path, 55)
    seen = np.random.default_rng(0).uniform(-40, 40, (200, 55)).astype(np.float32)
    for compress in (False, True):
        given = np.sign(seen) * np.log1p(np.abs(seen)) if compress else seen
        wanted = network(torch.as_tensor(given)).argmax(dim=1).numpy()
        found = example.load_agent(tmp_path, compress)(seen)
        np.testing.assert_array_equal(found, wanted)
        assert len(set(found)) > 2


def test_agents_with_memory_or_other_inputs_are_named(example, tmp_path):
    save_agent(tmp_path, 55, recurrent=True)
    with pytest.raises(ValueError, match="train with use_rnn=False"):
        example.load_agent(tmp_path, True)
    save_agent(tmp_path, 58)
    with pytest.raises(ValueError, match="takes 58 numbers, a drone observes 55: train with obs_"):
        example.load_agent(tmp_path, True)(np.zeros((3, 55), np.float32))


def test_the_example_evaluates_the_task_of_its_configuration(
    example, tmp_path, monkeypatch, capsys
):
    save_agent(tmp_path, 55)
    monkeypatch.setattr("sys.argv", ["evaluate.py", str(tmp_path), "--episodes", "2"])
    example.main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["trained", "random", "stay"]
    assert all("2 episodes from seed 1000: success 0.000 [" in line for line in lines)
