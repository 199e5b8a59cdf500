"""The API of PettingZoo's parallel environments."""

import numpy as np
import placing
import pytest
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test, parallel_seed_test

import bulletuav
from bulletuav.tasks import find_task

TASKS = bulletuav.list_tasks()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
@pytest.mark.parametrize("task", TASKS)
def test_pettingzoo_contract(task, dynamics):
    cities = placing.small_cities(task) if dynamics == "bullet" else {}
    if find_task(task).needs_cables:
        dynamics = "rigid_body"
    env = bulletuav.parallel_env(task, dynamics=dynamics, num_drones=3, **cities)
    assert isinstance(env, ParallelEnv)
    parallel_api_test(env, num_cycles=200)
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_pettingzoo_seeding(task):
    cities = placing.small_cities(task)
    parallel_seed_test(lambda: bulletuav.parallel_env(task, **cities), num_cycles=50)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
@pytest.mark.parametrize(
    ("task", "action"),
    [("hover", "rotor"), ("hover", "rpm"), ("hover", "target_position"), ("crossing", "velocity")],
)
def test_everything_observed_is_float32_finite_and_in_its_space(task, action, dynamics):
    """Thousands of drone steps with random and extreme actions."""
    env = bulletuav.parallel_env(
        task, action=action, dynamics=dynamics, num_drones=4, difficulty="hard"
    )
    rng = np.random.default_rng(0)
    observations, infos = env.reset(seed=0)
    for step in range(600):
        for agent, observation in observations.items():
            assert observation.dtype == np.float32
            assert env.observation_space(agent).contains(observation), observation
            assert np.isfinite(infos[agent]["goal_distance"])
        assert env.state_space.contains(env.state())
        if not env.agents:
            observations, infos = env.reset()
        space = env.action_space("drone_0")
        extreme = rng.choice([space.low[0], space.high[0]], (4, *space.shape)).astype(np.float32)
        random = rng.uniform(space.low, space.high, (4, *space.shape)).astype(np.float32)
        chosen = extreme if step // 50 % 2 else random
        observations, rewards, *_, infos = env.step(
            {agent: chosen[int(agent[6:])] for agent in env.agents}
        )
        assert np.isfinite(list(rewards.values())).all()
    env.close()


def test_agents_leave_one_by_one():
    env = bulletuav.parallel_env("hover", num_drones=3, action="velocity", horizon=100)
    env.reset(seed=0)
    assert env.agents == env.possible_agents == ["drone_0", "drone_1", "drone_2"]
    while "drone_1" in env.agents:
        actions = {
            agent: np.array((0, 0, -1.0 if agent == "drone_1" else 0), np.float32)
            for agent in env.agents
        }
        *_, terminated, truncated, infos = env.step(actions)
    assert (terminated["drone_1"], truncated["drone_1"], infos["drone_1"]["collision"]) == (
        True,
        False,
        1.0,
    )
    assert env.agents == ["drone_0", "drone_2"]
    observations, *_ = env.step({agent: np.zeros(3, np.float32) for agent in env.agents})
    assert list(observations) == ["drone_0", "drone_2"]
    while env.agents:
        *_, terminated, truncated, _ = env.step(
            {agent: np.zeros(3, np.float32) for agent in env.agents}
        )
    assert truncated == {"drone_0": True, "drone_2": True}
    assert not any(terminated.values())
    assert env.step({}) == ({}, {}, {}, {}, {})
    env.close()


def test_infos_have_the_same_numeric_keys_at_reset_and_step():
    env = bulletuav.parallel_env("crossing")
    _, first = env.reset(seed=0)
    *_, later = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert first.keys() == later.keys()
    for agent, info in first.items():
        assert info.keys() == later[agent].keys()
        assert all(type(value) is float for value in (*info.values(), *later[agent].values()))
    env.close()


def test_bad_actions_name_the_agent_and_leave_the_environment_usable():
    env = bulletuav.parallel_env("hover", num_drones=2)
    env.reset(seed=0)
    good = {agent: np.zeros(4, np.float32) for agent in env.agents}
    for bad, said in (
        ({"drone_0": np.zeros(4)}, r"actions lack \['drone_1'\]"),
        ({**good, "drone_7": np.zeros(4)}, "unknown agent in actions: 'drone_7'"),
        ({**good, None: np.zeros(4), 3: 1}, "unknown agent in actions: None"),
        *(
            (wrong, "a dict with an action for each of")
            for wrong in (None, 0, [[1, 2]], np.zeros((2, 4)), {"drone_0"})
        ),
        ({**good, "drone_1": np.zeros(3)}, r"action of drone_1 has shape \(3,\)"),
        ({**good, "drone_1": np.full(4, np.nan)}, "action of drone 1"),
    ):
        with pytest.raises(ValueError, match=said):
            env.step(bad)
    assert env.agents == ["drone_0", "drone_1"]
    assert len(env.step(good)[0]) == 2
    env.close()


def test_state_and_spaces():
    env = bulletuav.parallel_env("crossing", num_drones=3)
    env.reset(seed=0)
    assert env.state().shape == env.state_space.shape == (51,)
    np.testing.assert_allclose(env.state()[:3], env.aviary.swarm.position[0, 0], rtol=1e-6)
    assert env.observation_space("drone_0") is env.observation_space("drone_0")
    assert env.action_space("drone_1") is env.action_space("drone_1")
    assert env.metadata["name"] == "bulletuav_crossing_v2"
    env.close()
