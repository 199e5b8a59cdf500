"""Options of a reset, and attributes set by name, that have no effect."""

import gymnasium
import numpy as np
import pytest

import bulletuav
from bulletuav.adapters.pymarl import PymarlEnv

OPTIONS = {"dynamics": "point_mass", "horizon": 3}
SINGLE = {
    "parallel": lambda: bulletuav.parallel_env("crossing", **OPTIONS),
    "aec": lambda: bulletuav.aec_env("crossing", **OPTIONS),
    "central": lambda: gymnasium.make("bulletuav/Crossing-v2", **OPTIONS),
    "curriculum": lambda: bulletuav.curriculum_env("crossing", ({}, {}), **OPTIONS),
    "team": lambda: bulletuav.team_env("pursuit_evasion", "chasers", "stay", **OPTIONS),
    "central team": lambda: bulletuav.team_env(
        "pursuit_evasion", "chasers", "stay", central=True, **OPTIONS
    ),
    "PyMARL": lambda: PymarlEnv("crossing", **OPTIONS),
}
SEVERAL = {
    "batch": lambda: bulletuav.batch_env("crossing", 2, **OPTIONS),
    "workers": lambda: bulletuav.batch_env("crossing", 2, workers=2, **OPTIONS),
    "vector": lambda: gymnasium.make_vec("bulletuav/Crossing-v2", num_envs=2, **OPTIONS),
}
WITHOUT_EFFECT = {
    "num_drones": "num_drones is fixed when the environment is created",
    "wind": "wind is fixed when the environment is created",
    "positions": "start positions are 'start'",
    "init_vel": "velocities at the start are 'velocity'",
    "rpy": "attitudes at the start are 'quaternion'",
    "soc": "charges at the start are 'charge'",
    "obstacles": "obstacles follow from the task's own options",
    "initial_xyzs": "start positions are 'start'",
    "target_pos": "goals of drones are 'goal'",
    "env_index": "reset_mask",
    "goals": "did you mean 'goal'",
    "strat": "did you mean 'start'",
    "seed": "reset\\(seed=...\\)",
    "xyzzy": "all other options are set when the environment is created",
}


@pytest.fixture(params=[*SINGLE, *SEVERAL])
def env(request):
    one = (SINGLE | SEVERAL)[request.param]()
    one.several = request.param in SEVERAL
    yield one
    one.close()


def test_a_reset_takes_no_option_without_effect(env):
    names = "start, goal, velocity, quaternion, rates, charge"
    names += ", reset_mask" if env.several else ""
    for name, remedy in WITHOUT_EFFECT.items():
        with pytest.raises(
            ValueError, match=f"unknown option of a reset '{name}': .*{remedy}"
        ) as e:
            env.reset(options={name: 2})
        listed = str(e.value).rpartition("a reset takes ")[2].split(", ")
        assert sorted(listed) == sorted(names.split(", "))
    for options in (None, {}):
        env.reset(options=options)


def test_the_nearest_option_is_listed_first():
    env = SINGLE["parallel"]()
    for name, first in (("goaal", "goal"), ("strt", "start"), ("rate", "rates")):
        with pytest.raises(ValueError, match=f"a reset takes {first}"):
            env.reset(options={name: 1})
    env.close()


def test_a_single_world_takes_no_mask_and_several_do():
    env = SINGLE["parallel"]()
    with pytest.raises(
        ValueError, match="unknown option of a reset 'reset_mask': worlds of a batch"
    ):
        env.reset(options={"reset_mask": np.array([True])})
    env.close()
    batch = SEVERAL["batch"]()
    batch.reset(seed=0)
    batch.reset(options={"reset_mask": np.array([True, False])})
    batch.close()


def test_gymnasiums_own_vectors_reset_single_worlds_by_a_mask():
    mode = gymnasium.vector.AutoresetMode.DISABLED
    made = [lambda: gymnasium.make("bulletuav/Crossing-v2", **OPTIONS)] * 2
    envs = gymnasium.vector.SyncVectorEnv(made, autoreset_mode=mode)
    envs.reset(seed=0)
    envs.reset(options={"reset_mask": np.array([True, False])})
    envs.close()


def test_options_that_a_wrapper_passes_on_are_left_alone():
    env = SINGLE["central"]()
    env.reset(seed=0, options={"minari_autoseed": False})  # of Minari's `DataCollector`
    env.close()


def test_a_curriculum_goes_on_with_the_same_numbers_after_a_wrong_option():
    one, other = SINGLE["curriculum"](), SINGLE["curriculum"]()
    for env in (one, other):
        env.reset(seed=3)
    with pytest.raises(ValueError, match="unknown option"):
        one.reset(options={"wind": 3.0})
    np.testing.assert_array_equal(*(env.reset()[0]["drone_0"] for env in (one, other)))
    for env in (one, other):
        env.close()


def test_the_drones_of_stable_baselines3_take_no_options():
    from bulletuav.adapters.sb3 import DroneVecEnv

    env = DroneVecEnv("crossing", 2, **OPTIONS)
    env.set_options({})
    env.set_options()
    with pytest.raises(ValueError, match="unknown option of a reset 'wind'"):
        env.set_options({"wind": (1.0, 0.0, 0.0)})
    with pytest.raises(ValueError, match="resets of a DroneVecEnv take none"):
        env.set_options([{"start": np.zeros((4, 3))}])
    with pytest.raises(NotImplementedError, match="setting num_drones has no effect"):
        env.set_attr("num_drones", 3)
    env.close()


NO_ATTRIBUTES = {
    "num_drones": "num_drones .* is an option",
    "wind": "wind .* is an option",
    "d_safe": "d_safe .* is an option",  # of the task
    "max_sped": "did you mean 'max_speed'",
}


def test_stable_baselines3_sets_no_attribute_without_effect():
    from stable_baselines3.common.vec_env import DummyVecEnv

    env = DummyVecEnv([lambda: gymnasium.make("bulletuav/Crossing-v2", **OPTIONS).unwrapped])
    for name, said in NO_ATTRIBUTES.items():
        with pytest.raises(AttributeError, match=f"setting .*{said}"):
            env.set_attr(name, 3)
    env.set_attr("note", "mine")
    assert env.get_attr("note") == ["mine"]
    env.set_options({"wind": 1.0})
    with pytest.raises(ValueError, match="unknown option of a reset 'wind'"):
        env.reset()
    env.close()


@pytest.mark.parametrize("name", ["central", "central team"])
def test_wrappers_pass_on_no_attribute_without_effect(name):
    env = SINGLE[name]()
    wrapped = gymnasium.wrappers.TimeLimit(env, 5)
    with pytest.raises(AttributeError, match="setting max_speed of a Central.* has no effect"):
        wrapped.set_wrapper_attr("max_speed", 3.0)
    with pytest.raises(AttributeError, match="has no effect"):
        env.unwrapped.wind = 3.0
    wrapped.set_wrapper_attr("note", "mine")
    assert wrapped.get_wrapper_attr("note") == "mine"
    env.close()
