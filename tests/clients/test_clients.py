"""Other people's trainers on our environments.

Their calls are made always, the trainers themselves run by hand (`-m slow`).
"""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import supersuit
from clients.swarm import HORIZON, make_env

import bulletuav

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
EMPTY = ({}, {}, {}, {}, {})


def random_actions(rng, agents):
    return {agent: rng.uniform(-1, 1, 3).astype(np.float32) for agent in agents}


def episodes(env, chosen, count=40):
    """Fly episodes with actions for the agents that `chosen` names.

    Yields the last results of each episode, and the agents before them.
    """
    rng = np.random.default_rng(0)
    for _ in range(count):
        env.reset(seed=None, options=None)
        while env.agents:
            flown = list(env.agents)
            results = env.step(random_actions(rng, chosen(env)))
            assert all(list(result) == flown for result in results)
        yield results, flown


def test_rllib_asks_for_one_more_step_where_the_last_mixed_ends():
    """`ParallelPettingZooEnv` writes "__all__" into the results.

    It goes on until one of both ends is true for all.
    """
    env, mixed, early = make_env(), 0, 0
    for (_, _, terminated, truncated, _), flown in episodes(env, lambda env: reversed(env.agents)):
        early += len(flown) < len(env.possible_agents)
        for ends in (terminated, truncated):
            ends["__all__"] = all(ends.values())
        if not (terminated["__all__"] or truncated["__all__"]):
            mixed += 1
            assert env.agents == []
            nobody = env.step({})
            assert nobody == EMPTY
            nobody[2]["__all__"] = True
            assert env.step({}) == EMPTY  # not what was written into
    assert mixed > 5
    assert early > 5
    env.close()


def test_torchrl_sends_actions_of_all_possible_agents():
    env, alone = make_env(), make_env()
    sent, early = episodes(env, lambda env: env.possible_agents), 0
    for results, flown in sent:
        early += len(flown) < len(env.possible_agents)
        assert results[0].keys() == set(flown)
    assert early > 5
    for one in (env, alone):
        one.reset(seed=3)
    while env.agents:
        actions = {agent: np.full(3, 0.5, np.float32) for agent in env.agents}
        gone = {
            agent: np.full(7, np.nan) for agent in env.possible_agents if agent not in env.agents
        }
        for mine, other in zip(env.step(actions | gone), alone.step(actions), strict=True):
            np.testing.assert_equal(mine, other)
    with pytest.raises(ValueError, match="unknown agent in actions: 'drone_7': did you mean"):
        env.step({"drone_7": np.zeros(3)})
    for one in (env, alone):
        one.close()


def test_supersuit_steps_nobody_after_every_episode():
    env = make_env()
    for _ in episodes(env, lambda env: env.agents, 10):
        assert env.step(dict.fromkeys(env.agents)) == EMPTY
    env.close()


def test_a_curriculum_takes_the_same_calls():
    stages = ({"num_drones": 2}, {"num_drones": 4})
    env = bulletuav.curriculum_env(
        "crossing", stages, dynamics="point_mass", horizon=HORIZON, seed=0
    )
    for results, flown in episodes(env, lambda env: env.possible_agents, 2):
        assert set(results[1]) == set(flown)
        assert env.step({}) == EMPTY
    with pytest.raises(ValueError, match="unknown agent"):
        env.step({"drone_9": np.zeros(3)})
    env.close()


@pytest.mark.parametrize(
    "make", [make_env, lambda: bulletuav.curriculum_env("crossing", dynamics="point_mass")]
)
def test_before_the_first_reset_and_after_close_a_step_is_refused(make):
    env = make()
    with pytest.raises(RuntimeError, match="call reset"):
        env.step({})
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions lack \['drone_0'"):
        env.step({})
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step({})


def test_torchrls_gymenv_finds_out_that_there_is_no_frameskip():
    """It passes the option, and looks for Python's own words in a TypeError."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        gymnasium.make("bulletuav/Hover-v2", frameskip=1, disable_env_checker=True)
    with pytest.raises(ValueError, match="did you mean 'dynamics'"):
        bulletuav.batch_env("hover", 2, workers=2, dynamic="bullet")


@pytest.fixture
def client(monkeypatch):
    """Imports a client as its program does: client(name)."""
    monkeypatch.syspath_prepend(HERE)
    return lambda name: importlib.import_module(f"{name}_client")


def test_supersuit_makes_vectors_of_a_swarm(client):
    supersuit = client("supersuit")
    assert supersuit.fly("alone", supersuit.make(), 1).startswith("alone ")
    both = supersuit.make(2, num_cpus=0, base_class="gymnasium")
    assert supersuit.fly("two", both, 2).startswith("two ")


def drawn_skips(make_env):
    """Fly a frame skip that draws its lengths, and return what it gave."""
    env = supersuit.frame_skip_v0(make_env(), (1, 4))
    with pytest.raises(RuntimeError, match="reset"):
        env.unwrapped.np_random  # noqa: B018  # as nothing is seeded yet
    env.reset(seed=5)
    told = []
    while env.agents:
        told.append(env.step({agent: np.full(3, 0.1, np.float32) for agent in env.agents}))
    env.close()
    return told


@pytest.mark.parametrize(
    "make_env",
    [
        lambda: bulletuav.parallel_env("crossing", horizon=20),
        lambda: bulletuav.team_env("pursuit_evasion", "chasers", opponents="flee", horizon=20),
        lambda: bulletuav.curriculum_env("crossing", [{"num_drones": 2}], horizon=20),
    ],
)
def test_supersuit_draws_its_frame_skips_from_the_seed(make_env):
    first, again = drawn_skips(make_env), drawn_skips(make_env)
    assert 20 / 4 <= len(first) < 20
    np.testing.assert_equal(first, again)


def test_torchrl_wraps_a_swarm_and_a_gymnasium_environment(client, monkeypatch):
    torchrl = client("torchrl")
    monkeypatch.setattr(torchrl, "EPISODES", 15)
    early, mixed = torchrl.fly_swarm()
    assert early > 0
    assert mixed > 0
    assert torchrl.fly_hover() > torchrl.fly_hover(frame_skip=2)


@pytest.fixture(scope="session")
def python(tmp_path_factory):
    """Interpreter of an environment with the clients, made in some minutes and two gigabytes."""
    place = tmp_path_factory.mktemp("clients") / "venv"
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    pip = [place / "bin" / "pip", "install", "-q"]
    subprocess.run([*pip, "-r", HERE / "requirements.txt", "gymnasium==1.2.2"], check=True)
    subprocess.run([*pip, "-e", ROOT], check=True)
    return place / "bin" / "python"


@pytest.mark.slow
def test_benchmarl_trains_with_each_algorithm(tmp_path):
    """In an environment of its own: BenchMARL needs an older TorchRL."""
    place = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    pip = [place / "bin" / "pip", "install", "-q", "-c", ROOT / "constraints" / "benchmarl.txt"]
    subprocess.run([*pip, "torch==2.13.0"], check=True)
    subprocess.run([*pip, "-e", f"{ROOT}[benchmarl]"], check=True)
    subprocess.run([place / "bin" / "pip", "check"], check=True)
    variables = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [place / "bin" / "python", HERE / "benchmarl_client.py"]
    subprocess.run(command, check=True, env=variables, cwd=tmp_path)


@pytest.fixture(scope="session")
def ray_python(tmp_path_factory):
    """Interpreter of an environment with the extra rllib, made in a minute or two."""
    place = tmp_path_factory.mktemp("ray") / "venv"
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    pip = [place / "bin" / "pip", "install", "-q", "-c", ROOT / "constraints" / "rllib.txt"]
    subprocess.run([*pip, "-e", f"{ROOT}[rllib]"], check=True)
    return place / "bin" / "python"


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["ray_cluster.py", "--episodes", "100"],
        ["rllib_cluster.py", "--nodes", "2", "--iterations", "1"],
    ],
)
def test_work_goes_on_when_nodes_are_killed(ray_python, words):
    """At small size; .ci/run runs this."""
    variables = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([ray_python, HERE / words[0], *words[1:]], check=True, env=variables)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rllib", "rllib_adapter", "torchrl", "supersuit"])
def test_the_client_itself_flies(python, name):
    variables = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([python, HERE / f"{name}_client.py"], check=True, env=variables)
