"""Observations by the names of their blocks, in every environment class."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import api_test, parallel_api_test

import bulletuav

BLOCKS = {"velocity": 3, "goal": 4, "neighbours": 21}
"""What drones observe, and how many numbers each block has"""
STATE = {
    "position": 3,
    "attitude": 4,
    "velocity": 3,
    "rates": 3,
    "goal_position": 3,
    "alive": 1,
}
WORLDS, DRONES = 2, 3
OPTIONS = {"dynamics": "point_mass", "observation": tuple(BLOCKS), "horizon": 5}


def make_parallel(**options):
    env = bulletuav.parallel_env("crossing", **options)
    return env, env.reset(seed=0)[0]["drone_1"], env.observation_space("drone_1")


def make_turns(**options):
    env = bulletuav.aec_env("crossing", **options)
    env.reset(seed=0)
    return env, env.observe("drone_1"), env.observation_space("drone_1")


def make_curriculum(**options):
    stages = ({"num_drones": 2}, {"num_drones": 3, "half_length": 150.0})
    env = bulletuav.curriculum_env("crossing", stages, **options)
    return env, env.reset(seed=0)[0]["drone_1"], env.observation_space("drone_1")


def make_batch(**options):
    env = bulletuav.batch_env("crossing", WORLDS, **options)
    return env, env.reset(seed=0)[0], env.observation_space


def make_workers(**options):
    return make_batch(workers=2, start_method="fork", **options)


def make_central(**options):
    env = gymnasium.make("bulletuav/Crossing-v2", **options).unwrapped
    return env, env.reset(seed=0)[0], env.observation_space


def make_vector(**options):
    env = gymnasium.make_vec("bulletuav/Crossing-v2", num_envs=WORLDS, **options)
    return env, env.reset(seed=0)[0], env.single_observation_space


CASES = {
    "parallel_env": (make_parallel, DRONES, (), BLOCKS),
    "aec_env": (make_turns, DRONES, (), BLOCKS),
    "curriculum_env": (make_curriculum, DRONES, (), BLOCKS),
    "batch_env": (make_batch, DRONES, (WORLDS, DRONES), BLOCKS),
    "batch_env, workers": (make_workers, DRONES, (WORLDS, DRONES), BLOCKS),
    "gymnasium.make": (make_central, DRONES, (DRONES,), STATE),
    "gymnasium.make, one drone": (make_central, 1, (), BLOCKS),
    "gymnasium.make_vec": (make_vector, DRONES, (WORLDS, DRONES), STATE),
    "gymnasium.make_vec, one drone": (make_vector, 1, (WORLDS,), BLOCKS),
}
"""How environments are made, their drones, axes before the numbers of a block, and the blocks"""


@pytest.mark.parametrize("name", CASES)
def test_labels_tell_the_numbers_of_one_drone(name):
    make, drones, _, blocks = CASES[name]
    env, _, space = make(num_drones=drones, **OPTIONS)
    labels = env.observation_labels
    assert len(labels) == sum(blocks.values())
    assert [label.name for label in labels].count("velocity x") == 1
    low = np.resize([label.low for label in labels], space.shape)
    high = np.resize([label.high for label in labels], space.shape)
    np.testing.assert_allclose(space.low, low, rtol=1e-6)
    np.testing.assert_allclose(space.high, high, rtol=1e-6)
    labels.clear()
    assert env.observation_labels
    env.close()


@pytest.mark.parametrize("name", CASES)
def test_split_gives_views_by_block(name):
    make, drones, axes, blocks = CASES[name]
    env, observation, _ = make(num_drones=drones, **OPTIONS)
    parts = env.split(observation)
    assert {block: part.shape for block, part in parts.items()} == {
        block: (*axes, numbers) for block, numbers in blocks.items()
    }
    assert all(np.shares_memory(part, observation) for part in parts.values())
    together = np.concatenate(list(parts.values()), axis=-1)
    np.testing.assert_array_equal(together.ravel(), np.ravel(observation))
    for wrong in (observation[..., 1:], 3.0):
        with pytest.raises(ValueError, match="numbers are needed, one for each label"):
            env.split(wrong)
    env.close()


@pytest.mark.parametrize("name", CASES)
def test_dicts_are_what_split_gives_of_vectors(name):
    make, drones, _, _ = CASES[name]
    env, vector, _ = make(num_drones=drones, **OPTIONS)
    parts = env.split(vector)
    labels = env.observation_labels
    env.close()
    env, observation, space = make(num_drones=drones, observation_format="dict", **OPTIONS)
    assert env.observation_labels == labels
    assert list(observation) == list(parts)
    for block, part in env.split(observation).items():
        np.testing.assert_array_equal(part, parts[block])
        assert part is observation[block]
    one = observation
    if not space.contains(one):  # arrays of several worlds, or of their drones
        one = {block: part[0] for block, part in one.items()}
    if not space.contains(one):
        one = {block: part[0] for block, part in one.items()}
    assert space.contains(one)
    env.close()


def test_the_parts_are_what_their_names_say():
    env, observation, _ = make_vector(num_drones=DRONES, **OPTIONS)
    parts = env.split(observation)
    scene, swarm = env.aviary.scene, env.aviary.swarm
    np.testing.assert_allclose(parts["position"], swarm.position, rtol=1e-6)
    np.testing.assert_allclose(parts["goal_position"], scene.goal, rtol=1e-6)
    assert (parts["alive"] == 1).all()
    env.close()


def test_pictures_stay_beside_the_blocks():
    env = bulletuav.parallel_env(
        "hover", observation=("rates", "rgb", "position"), camera_size=(16, 12)
    )
    observation = env.reset(seed=0)[0]["drone_0"]
    assert set(observation) == {"vector", "rgb"}
    parts = env.split(observation)
    assert {block: part.shape for block, part in parts.items()} == {
        "rates": (3,),
        "position": (3,),
        "rgb": (12, 16, 3),
    }
    assert len(env.observation_labels) == 6
    env.close()


# The format "dict" in the checks of the APIs


@pytest.mark.parametrize("task", ["hover", "crossing", "lidar_navigation"])
def test_pettingzoo_takes_dicts(task):
    env = bulletuav.parallel_env(task, num_drones=3, observation_format="dict")
    parallel_api_test(env, num_cycles=100)
    env.close()
    stages = ({"d_safe": 5.0}, {"d_safe": 6.0})
    env = bulletuav.curriculum_env(task, stages, window=1, observation_format="dict")
    parallel_api_test(env, num_cycles=50)
    env.close()
    env = bulletuav.aec_env(task, num_drones=2, observation_format="dict")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Observation (is not a NumPy array|space for)")
        api_test(env, num_cycles=30)
    env.close()


@pytest.mark.parametrize("drones", [1, 3])
def test_gymnasium_takes_dicts(drones):
    env = gymnasium.make("bulletuav/Crossing-v2", num_drones=drones, observation_format="dict")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*not within the observation space.*|.*casts.*")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("drones", [1, 3])
def test_vector_environments_give_dicts(drones, mode):
    env, observation, _ = make_vector(
        num_drones=drones, autoreset_mode=mode, observation_format="dict", **OPTIONS
    )
    assert env.observation_space.contains(observation)
    for step in range(1, 6):
        observation, *_, infos = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert ("final_obs" in infos) == (mode == AutoresetMode.SAME_STEP and step == 5)
    if "final_obs" in infos:
        assert env.observation_space.contains(infos["final_obs"])
        assert (infos["final_obs"]["velocity"] != observation["velocity"]).any()
    env.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_workers_give_the_same_dicts(mode):
    options = {**OPTIONS, "observation": ("velocity", "goal", "ray_depth"), "camera_size": (8, 8)}
    envs = [
        make(num_drones=DRONES, autoreset_mode=mode, observation_format="dict", **options)
        for make in (make_batch, make_workers)
    ]
    given = [observation for _, observation, _ in envs]
    actions = np.full((WORLDS, DRONES, 3), 0.5)
    for _ in range(7):
        one, other = given
        assert list(one) == list(other) == ["velocity", "goal", "ray_depth"]
        for block, part in one.items():
            np.testing.assert_array_equal(part, other[block])
            assert part.dtype == other[block].dtype
        steps = [env.step(actions) for env, _, _ in envs]
        given = [step[0] for step in steps]
        infos = [step[-1] for step in steps]
        assert ("final_obs" in infos[0]) == ("final_obs" in infos[1])
        for block, part in infos[0].get("final_obs", {}).items():
            np.testing.assert_array_equal(part, infos[1]["final_obs"][block])
    for env, _, _ in envs:
        env.close()


def test_stages_of_different_dicts_are_refused():
    stages = ({}, {"observation": ("velocity", "identity")})
    with pytest.raises(ValueError, match=r"observations have shapes \[\{"):
        bulletuav.curriculum_env("crossing", stages, observation_format="dict")
