"""RLlib's environments; where Ray is not installed, with stand-ins of the classes they derive from.

Ray itself trains with them by hand, see `tests/clients`.
"""

import importlib
import importlib.util
import itertools
import pickle
import socket
import sys
import types

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

import bulletuav

CALM = {"dynamics": "single_integrator", "difficulty": "easy", "num_drones": 3}
SHORT = {"task": "converge", **CALM, "horizon": 5}
BREAK = {"task": "converge", **CALM, "horizon": 400, "radius": 20.0, "margin": 10.0}
"""Drones that fly at random leave this small arena one after the other"""
MODULES = ("bulletuav.adapters.rllib", "bulletuav.adapters.rllib_vector")


class Base:
    """What `MultiAgentEnv` and `VectorMultiAgentEnv` are, as far as ours use them."""

    @property
    def unwrapped(self):
        return self


def stand_ins():
    """Modules of Ray with the names that ours import."""
    names = {
        "ray": {},
        "ray.rllib": {},
        "ray.rllib.callbacks": {},
        "ray.rllib.callbacks.utils": {"make_callback": None},
        "ray.rllib.env": {},
        "ray.rllib.env.multi_agent_env": {"MultiAgentEnv": Base},
        "ray.rllib.env.multi_agent_env_runner": {"MultiAgentEnvRunner": object},
        "ray.rllib.env.vector": {},
        "ray.rllib.env.vector.vector_multi_agent_env": {"VectorMultiAgentEnv": Base},
    }
    modules = {}
    for name, held in names.items():
        modules[name] = types.ModuleType(name)
        vars(modules[name]).update(held)
    return modules


@pytest.fixture(scope="module")
def rllib():
    """The adapter's modules, one after the other."""
    with pytest.MonkeyPatch.context() as patch:
        if importlib.util.find_spec("ray") is None:
            for name, module in stand_ins().items():
                patch.setitem(sys.modules, name, module)
        yield [importlib.import_module(name) for name in MODULES]
        for name in MODULES:
            sys.modules.pop(name)


@pytest.fixture
def make(rllib):
    """Makes an environment, or with `worlds` a vector, and closes it."""
    made = []

    def make_it(worlds=None, **config):
        if worlds is None:
            made.append(rllib[0].DroneMultiAgentEnv(config))
        else:
            made.append(rllib[1].DroneVectorEnv(config, worlds))
        return made[-1]

    yield make_it
    for env in made:
        env.close()


def random_actions(env, rng):
    """An action for each of the agents that fly, and numbers for the others all the same."""
    if isinstance(env.action_spaces["drone_0"], Discrete):
        choices = {agent: rng.integers(7) for agent in sorted(env.possible_agents)}
        return {agent: choices[agent] for agent in env.agents}
    actions = {
        agent: rng.uniform(-1, 1, 3).astype(np.float32) for agent in sorted(env.possible_agents)
    }
    return {agent: actions[agent] for agent in env.agents}


def episode(env, rng, **reset):
    """Results of all steps of an episode."""
    env.reset(**reset)
    steps = []
    while not steps or not (steps[-1][2]["__all__"] or steps[-1][3]["__all__"]):
        steps.append(env.step(random_actions(env, rng)))
    return steps


@pytest.mark.parametrize("module", MODULES)
def test_without_ray_an_error_names_the_extra(module, monkeypatch):
    for name in MODULES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "ray", None)
    message = r"RLlib needs the extra 'rllib': pip install -c \S+/constraints/rllib\.txt"
    with pytest.raises(ImportError, match=message):
        importlib.import_module(module)


def test_it_flies_what_the_pettingzoo_environment_flies(make):
    env, options = make(**SHORT), {k: v for k, v in SHORT.items() if k != "task"}
    other = bulletuav.parallel_env("converge", **options)
    assert env.possible_agents == env.agents == other.possible_agents
    seen, infos = env.reset(seed=3)
    np.testing.assert_equal(seen, other.reset(seed=3)[0])
    assert infos == {agent: {} for agent in seen}
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions = random_actions(env, rng)
        seen, rewards, terminated, *_ = env.step(actions)
        expected = other.step(actions)
        np.testing.assert_equal(seen, expected[0])
        assert rewards == expected[1]
        assert list(seen) == env.possible_agents
        for agent in seen:
            assert env.observation_spaces[agent].contains(seen[agent])
            assert terminated[agent] == expected[2][agent]
    other.close()


def test_the_horizon_is_told_of_the_episode_alone(make):
    """RLlib 2.60 calls agents terminated if all were truncated one by one."""
    env = make(**SHORT)
    *before, last = episode(env, np.random.default_rng(0), seed=0)
    assert len(before) == 4
    agents = dict.fromkeys(env.possible_agents, False)
    for _, _, terminated, truncated, infos in before:
        assert terminated == agents | {"__all__": False}
        assert truncated == {"__all__": False}
        assert infos == {agent: {} for agent in agents}
    assert last[2:4] == (agents | {"__all__": False}, {"__all__": True})
    assert env.agents == env.possible_agents  # of whom the last step told
    for agent in agents:
        assert last[4][agent]["success"] == 0
        assert last[0][agent].any()


def test_of_drones_that_left_nothing_is_told(make):
    env = make(**BREAK)
    steps = episode(env, np.random.default_rng(0), seed=0)
    flown = [list(seen) for seen, *_ in steps]
    assert len(flown[0]) == 3 > len(flown[-1])
    for seen, rewards, terminated, truncated, infos in steps:
        assert list(seen) == list(rewards) == list(infos)
        assert list(terminated) == [*seen, "__all__"]
        assert truncated == {"__all__": False}
        left = [agent for agent in seen if terminated[agent]]
        assert [agent for agent in seen if infos[agent]] == left
        for agent in left:
            assert infos[agent]["reward/out_of_bounds"] == -50.0
    assert steps[-1][2]["__all__"]
    for now, after in itertools.pairwise(steps):
        assert list(after[0]) == [agent for agent in now[0] if not now[2][agent]]


def test_where_ends_are_mixed_each_drone_is_told_its_own(make):
    env = make(**BREAK | {"horizon": 25})
    for k in range(40):
        steps = episode(env, np.random.default_rng(k), seed=k)
        _, _, terminated, truncated, _ = steps[-1]
        if truncated["__all__"] and any(terminated.values()):
            break
    assert not terminated["__all__"]
    assert not all(terminated[agent] for agent in steps[-1][0])


def test_outcomes_are_those_of_whole_episodes(make, rllib):
    env = make(**BREAK)
    steps = episode(env, np.random.default_rng(0), seed=0)
    totals = {}
    for _, rewards, *_ in steps:
        for agent, reward in rewards.items():
            totals[agent] = totals.get(agent, 0.0) + reward
    terms = {name: value for name, value in env.outcome.items() if name.startswith("reward/")}
    assert sum(terms.values()) == pytest.approx(np.mean(list(totals.values())))
    assert terms["reward/out_of_bounds"] == -50.0
    assert (env.outcome["success"], env.outcome["collision"]) == (0.0, 0.0)

    class Logger:
        values = {}  # noqa: RUF012

        def log_value(self, name, value, reduce, window):
            assert (reduce, window) == ("mean", 100)
            self.values[name] = value

    vector = types.SimpleNamespace(envs=[None, types.SimpleNamespace(unwrapped=env)])
    rllib[0].log_outcomes(metrics_logger=Logger(), env=vector, env_index=1, episode=None)
    assert Logger.values == env.outcome


def test_the_same_seed_gives_the_same_bits(make):
    one, other = make(**BREAK), make(**BREAK)
    np.testing.assert_equal(
        episode(one, np.random.default_rng(0), seed=5),
        episode(other, np.random.default_rng(0), seed=5),
    )
    assert not np.array_equal(one.reset()[0]["drone_0"], one.reset()[0]["drone_0"])


def test_symlog_compresses_observations_and_their_bounds(make):
    plain, small = make(**SHORT), make(**SHORT, symlog=True)
    metres, logs = plain.reset(seed=0)[0]["drone_1"], small.reset(seed=0)[0]["drone_1"]
    np.testing.assert_allclose(logs, np.sign(metres) * np.log1p(abs(metres)), rtol=1e-6)
    space = small.observation_spaces["drone_1"]
    assert space.contains(logs)
    assert space.high.max() < 7 < plain.observation_spaces["drone_1"].high.max()
    seen, *_ = small.step(random_actions(small, np.random.default_rng(0)))
    assert space.contains(seen["drone_1"])


@pytest.mark.parametrize("worlds", [None, 2])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": None}, "env_config has no task"),
        ({"task": "convergence"}, "did you mean 'converge'"),
        ({"action_masks": True}, "action_masks"),
        (
            {"action": "discrete", "action_masks": True, "observation_format": "dict"},
            "action_masks with RLlib is for vectors",
        ),
        ({"seed": 3}, r"env_config has a seed.*config\.debugging\(seed="),
        ({"dynamic": "bullet"}, "did you mean 'dynamics'"),
        ({"symlog": True, "observation_format": "dict"}, "symlog is for vectors"),
    ],
)
def test_configurations_that_cannot_be(worlds, change, message, make):
    with pytest.raises(ValueError, match=message):
        make(worlds, **SHORT | change)


def test_masks_are_next_to_observations(make):
    config = BREAK | MASKED
    env = make(**config)
    other = bulletuav.parallel_env(**config)
    space = env.observation_spaces["drone_1"]
    assert list(space.spaces) == ["action_mask", "observations"]
    seen, _ = env.reset(seed=1)
    expected, infos = other.reset(seed=1)
    rng, invalid = np.random.default_rng(0), 0
    for _ in range(40):
        for agent, one in seen.items():
            assert space.contains(one)
            np.testing.assert_equal(one["observations"], expected[agent])
            np.testing.assert_equal(one["action_mask"], infos[agent]["action_mask"])
            invalid += int((one["action_mask"] == 0).sum())
        if not other.agents:
            break
        actions = random_actions(env, rng)
        seen, *_ = env.step(actions)
        expected, _, _, _, infos = other.step(actions)
    assert invalid > 0
    other.close()


def test_stages_and_teams(make):
    env = make(**SHORT | {"num_drones": 4, "stages": [{"num_drones": 2}, {}]})
    assert len(env.possible_agents) == 4
    assert len(env.reset(seed=0)[0]) == 2
    steps = episode(env, np.random.default_rng(0))
    assert steps[-1][3] == {"__all__": True}
    chase = {"task": "pursuit_evasion", "team": "chasers", "opponents": "flee", "horizon": 3}
    team = make(**chase, dynamics="single_integrator")
    assert len(team.possible_agents) == len(team.reset(seed=0)[0]) == 3
    assert episode(team, np.random.default_rng(0))[-1][3] == {"__all__": True}
    for name in ("stages", "team"):
        with pytest.raises(ValueError, match=f"has '{name}'.*leave env_runner_cls out"):
            make(2, **SHORT | {name: []})


def vector_actions(steps_of, rng):
    """The actions that `random_actions` gives each environment, of all."""
    return [random_actions(env, one) for env, one in zip(steps_of, rng, strict=True)]


def step_each(envs, actions, over):
    """What RLlib's own vector does: worlds whose episode was over start anew instead."""
    told = []
    for env, own, done in zip(envs, actions, over, strict=True):
        if done:
            seen, infos = env.reset()
            nothing = dict.fromkeys(seen, False) | {"__all__": False}
            told.append((seen, dict.fromkeys(seen, 0.0), nothing, {"__all__": False}, infos))
        else:
            told.append(env.step(own))
    return [list(one) for one in zip(*told, strict=True)]


MASKED = {"action": "discrete", "action_masks": True}


@pytest.mark.parametrize("more", [{}, {"symlog": True}, MASKED, MASKED | {"symlog": True}])
def test_worlds_at_once_are_the_same_as_one_by_one(make, more):
    config = BREAK | {"horizon": 30} | more
    vector, envs = make(3, **config), [make(**config) for _ in range(3)]
    seen, infos = vector.reset(seed=4)
    each = [env.reset(seed=4 + k) for k, env in enumerate(envs)]
    np.testing.assert_equal((seen, infos), tuple(map(list, zip(*each, strict=True))))
    rngs = [np.random.default_rng(k) for k in range(3)]
    over, count = [False] * 3, 0
    for _ in range(100):
        actions = vector_actions(envs, rngs)
        expected = step_each(envs, actions, over)
        results = vector.step(
            [{} if done else own for own, done in zip(actions, over, strict=True)]
        )
        np.testing.assert_equal(list(results), expected)
        ends = zip(results[2], results[3], strict=True)
        over = [one["__all__"] or other["__all__"] for one, other in ends]
        count += sum(over)
        for k in np.flatnonzero(over):
            assert vector.envs[k].unwrapped.outcome == pytest.approx(envs[k].outcome)
    assert count > 6


def test_what_rllib_asks_of_a_vector(make):
    vector = make(2, **SHORT | {"render_mode": "rgb_array", "render_size": (32, 24)})
    vector.reset(seed=[1, 2])
    assert vector.num_envs == len(vector.envs) == 2
    agents = ["drone_0", "drone_1", "drone_2"]
    assert list(vector.single_observation_spaces) == vector.envs[0].possible_agents == agents
    assert list(vector.single_action_space.spaces) == agents
    assert vector.envs[1].unwrapped.action_spaces["drone_0"] == Box(-1, 1, (3,))
    assert [picture.shape for picture in vector.render()] == [(24, 32, 3)] * 2
    copy = pickle.loads(pickle.dumps(vector))
    assert copy.num_envs == 2
    copy.close()


def test_choices_and_wrong_actions_of_a_vector(make):
    vector = make(2, **SHORT | {"action": "discrete"})
    assert vector.single_action_spaces["drone_2"] == Discrete(7)
    vector.reset(seed=0)
    rows = [dict.fromkeys(vector.envs[0].possible_agents, np.int64(2)) for _ in range(2)]
    results = vector.step(rows)
    assert all(len(rewards) == 3 for rewards in results[1])
    with pytest.raises(ValueError, match="actions of world 1 lack 'drone_1'"):
        vector.step([rows[0], {"drone_0": 0}])
    with pytest.raises(ValueError, match=r"drone_2' in world 0 has shape \(2,\): \(1,\) is needed"):
        vector.step([rows[0] | {"drone_2": np.zeros(2)}, rows[1]])


@pytest.mark.parametrize("symlog", [False, True])
def test_agents_observe_the_blocks_of_their_team(make, rllib, symlog):
    mixed = {"chasers": ["velocity", "room"], "evaders": ["velocity"]}
    game = {"num_drones": 4, "dynamics": "point_mass", "horizon": 5, "observation": mixed}
    config = {"task": "pursuit_evasion", "symlog": symlog, **game}
    vector, env = make(2, **config), make(**config)
    assert {agent: one.shape[0] for agent, one in env.observation_spaces.items()} == {
        **dict.fromkeys(("drone_0", "drone_1", "drone_2"), 9),
        "drone_3": 3,
    }
    assert vector.single_observation_spaces == env.observation_spaces
    first, _ = vector.reset(seed=4)
    alone, _ = env.reset(seed=4)
    for agent, space in env.observation_spaces.items():
        assert space.contains(first[0][agent])
        np.testing.assert_array_equal(first[0][agent], alone[agent])
    # A policy for all would have one size
    with pytest.raises(ValueError, match="teams observe different blocks: choose by='team'"):
        rllib[0].policies("pursuit_evasion", **game)
    assert rllib[0].policies("pursuit_evasion", by="team", **game)["policies"] == {
        "chasers",
        "evaders",
    }


def test_who_shares_a_policy(rllib):
    policies = rllib[0].policies
    shared = policies("crossing", num_drones=4)
    assert shared["policies"] == {"drones"}
    assert shared["policy_mapping_fn"]("drone_3", None, worker=1) == "drones"
    teams = policies("crossing", by="team", train=["east"], num_drones=4)
    assert teams["policies"] == {"north", "east"}
    assert teams["policies_to_train"] == ["east"]
    mapping = teams["policy_mapping_fn"]
    assert [mapping(f"drone_{i}", None) for i in range(4)] == ["north", "north", "east", "east"]
    each = policies("crossing", by="drone", num_drones=2)
    assert each["policies"] == {"drone_0", "drone_1"}
    assert each["policy_mapping_fn"]("drone_1", None) == "drone_1"
    with pytest.raises(ValueError, match="unknown by 'teams': did you mean 'team'"):
        policies("crossing", by="teams")
    with pytest.raises(ValueError, match="unknown policy 'west'"):
        policies("crossing", by="team", train=["west"])


def test_a_missing_cluster_is_told_in_one_line(rllib):
    connect = rllib[0].connect
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ConnectionError, match=f"no Ray cluster at '{address}': start") as error:
            connect(address)
    assert "\n" not in str(error.value)
    for wrong in ("cluster", "head:port", ":6379"):
        with pytest.raises(ValueError, match="HOST:PORT or 'auto' is needed"):
            connect(wrong)
