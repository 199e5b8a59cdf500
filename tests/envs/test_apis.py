"""Batches, and the APIs of Gymnasium and PettingZoo's AEC."""

import contextlib
import warnings

import gymnasium
import numpy as np
import pettingzoo
import placing
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import api_test, seed_test

import bulletuav
from bulletuav.envs.gymnasium import environment_id

TASKS = bulletuav.list_tasks()
IDS = [environment_id(task) for task in TASKS]


def test_ids():
    assert environment_id("lidar_navigation") == "bulletuav/LidarNavigation-v2"
    for name in IDS:
        assert name in gymnasium.registry


@pytest.mark.parametrize("drones", [1, 3])
@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_and_stable_baselines_check_every_id(task, drones):
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    cities = placing.small_cities(task) if drones > 1 else {}
    env = gymnasium.make(environment_id(task), num_drones=drones, **cities)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*not within the observation space.*|.*casts.*")
        check_env(env.unwrapped, skip_render_check=True)
        warnings.simplefilter("ignore")
        sb3_check_env(env.unwrapped)
    env.close()


def test_ids_by_module():
    env = gymnasium.make("bulletuav:bulletuav/Hover-v2")
    env.reset(seed=0)
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_pettingzoo_makes_every_id(name):
    for kind, base in (("parallel", pettingzoo.ParallelEnv), ("aec", pettingzoo.AECEnv)):
        with contextlib.closing(pettingzoo.make(kind, name, num_drones=3)) as env:
            assert isinstance(env, base)
            assert len(env.possible_agents) == 3


@pytest.mark.parametrize("task", TASKS)
def test_stable_baselines_checks_discrete_actions(task):
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    options = {"action": "discrete", **placing.small_cities(task)}
    for drones in (1, 2):
        env = gymnasium.make(environment_id(task), num_drones=drones, **options)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sb3_check_env(env.unwrapped)
        env.close()


def test_the_central_environment_commands_all_drones():
    env = gymnasium.make("bulletuav/Crossing-v2", num_drones=3).unwrapped
    reference = bulletuav.Aviary("crossing", num_drones=3)
    state, _ = env.reset(seed=4)
    reference.reset(seeds=4)
    np.testing.assert_array_equal(state, reference.state()[0])
    assert env.action_space.shape == (9,)
    action = np.linspace(-1, 1, 9, dtype=np.float32)
    state, reward, terminated, truncated, info = env.step(action)
    step = reference.step(action.astype(float).reshape(1, 3, 3))
    np.testing.assert_array_equal(state, reference.state()[0])
    assert reward == pytest.approx(step.rewards.mean())
    assert (terminated, truncated) == (False, False)
    assert info["goal_distance"].shape == (3,)
    env.close()
    reference.close()


def test_with_one_drone_it_is_that_drones_own_environment():
    env = gymnasium.make("bulletuav/Hover-v2", horizon=5).unwrapped
    own = bulletuav.parallel_env("hover", horizon=5)
    first, _ = env.reset(seed=1)
    observations, _ = own.reset(seed=1)
    np.testing.assert_array_equal(first, observations["drone_0"])
    for k in range(5):
        action = np.full(4, -0.1, np.float32)
        one = env.step(action)
        other = own.step({"drone_0": action})
        np.testing.assert_array_equal(one[0], other[0]["drone_0"])
        assert one[1] == other[1]["drone_0"]
        assert one[2:4] == (False, k == 4)
    env.close()


def test_the_episode_is_cut_when_time_ends_it_for_one_and_over_when_all_crashed():
    env = gymnasium.make(
        "bulletuav/Hover-v2", num_drones=2, action="velocity", horizon=60
    ).unwrapped
    for second, expected in ((0.0, (False, True)), (-1.0, (True, False))):
        env.reset(seed=0)
        over = (False, False)
        while not any(over):
            over = env.step(np.array((0, 0, -1.0, 0, 0, second), np.float32))[2:4]
        assert over == expected
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_the_aec_environment_passes_pettingzoos_checks(task):
    options = {"num_drones": 2, **placing.small_cities(task)}
    if task == "pad_landing":  # PettingZoo warns of dicts
        options["observation"] = ("velocity", "pad_clue")
    env = bulletuav.aec_env(task, **options)
    api_test(env, num_cycles=60)
    env.close()
    seed_test(lambda: bulletuav.aec_env(task, **options))


# Batches


def flight_to_the_end(mode, **options):
    """Fly two worlds of one drone, of which world 1 dives and ends first.

    Returns the environment and rows of (observations, rewards, terminated, truncated, infos).
    """
    env = bulletuav.batch_env(
        "hover", 2, autoreset_mode=mode, action="velocity", horizon=30, height=1.5, **options
    )
    first, _ = env.reset(seed=0)
    rows = [(first, None, None, None, None)]
    for _ in range(40):
        rows.append(env.step(np.array([(0, 0, 0), (0, 0, -1.0)])[:, None]))
    return env, rows


def test_next_step_returns_the_first_observation_in_the_step_after_the_last():
    env, rows = flight_to_the_end(AutoresetMode.NEXT_STEP)
    end = next(k for k, row in enumerate(rows[1:], 1) if row[2][1, 0])
    assert end < 30
    assert rows[end][4]["collision"][1, 0]
    after = rows[end + 1]
    assert after[1][1, 0] == 0
    assert not after[2][1, 0]
    assert not after[3][1, 0]
    fresh = bulletuav.Aviary("hover", 2, action="velocity", height=1.5, horizon=30)
    fresh.reset(seeds=0)
    # The world goes on with its own random numbers.
    np.testing.assert_array_equal(after[0][1], fresh.reset()[1])
    assert rows[30][3][0, 0]  # truncated
    assert rows[31][1][0, 0] == 0
    assert env.alive.all()
    env.close()


def test_same_step_gives_the_end_apart():
    env, rows = flight_to_the_end(AutoresetMode.SAME_STEP)
    _, disabled = flight_to_the_end(AutoresetMode.DISABLED)
    end = next(k for k, row in enumerate(rows[1:], 1) if row[2][1, 0])
    observation, reward, _, _, info = rows[end]
    np.testing.assert_array_equal(info["_final_obs"], (False, True))
    np.testing.assert_array_equal(info["final_obs"][1], disabled[end][0][1])
    assert reward[1, 0] == disabled[end][1][1, 0]
    assert info["final_info"]["collision"][1, 0]
    assert (observation[1] != info["final_obs"][1]).any()
    assert info["final_state"].shape == (2, 17)
    assert not rows[end + 1][2][1, 0]
    env.close()


def test_disabled_waits_for_the_caller():
    env, _ = flight_to_the_end(AutoresetMode.DISABLED)
    assert not env.alive.any()
    before = env.aviary.swarm.position.copy()
    env.step(np.full((2, 1, 3), np.nan))  # nobody reads it
    np.testing.assert_array_equal(env.aviary.swarm.position, before)
    env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(env.alive[:, 0], (True, False))
    env.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_infos_and_observations_of_a_new_episode_belong_together(mode):
    _, rows = flight_to_the_end(mode)
    for observation, _, _, _, info in rows[1:]:
        np.testing.assert_allclose(
            np.linalg.norm(observation[..., 4:7], axis=-1), info["goal_distance"], rtol=1e-5
        )
    ends = [row for row in rows[1:] if row[2].any() or row[3].any()]
    assert any(row[4].get("final_info", row[4])["collision"].any() for row in ends)


def test_make_knows_the_render_modes(recwarn):
    env = gymnasium.make("bulletuav/Hover-v2", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (480, 640, 3)
    assert not [warning for warning in recwarn if "render_mode" in str(warning.message)]
    env.close()


def test_a_world_goes_on_until_its_last_drone():
    env = bulletuav.batch_env(
        "hover", 1, num_drones=2, action="velocity", horizon=60, autoreset_mode="NextStep"
    )
    env.reset(seed=0)
    for k in range(60):
        *_, terminated, truncated, _ = env.step(np.array([[(0, 0, -1.0), (0, 0, 0)]]))
        assert not env.ended[0] or k == 59
    assert (terminated[0].tolist(), truncated[0].tolist()) == ([False, False], [False, True])
    env.step(np.zeros((1, 2, 3)))
    assert env.alive.all()
    env.close()


def test_batch_shapes_seeds_and_state():
    env = bulletuav.batch_env("crossing", num_envs=3, num_drones=4)
    first, infos = env.reset(seed=5)
    assert first.shape == (3, 4, 55)
    assert infos["separation"].shape == (3, 4)
    np.testing.assert_array_equal(env.reset(seed=[5, 6, 7])[0], first)
    assert env.state().shape == (3, 68)
    observations, rewards, terminated, truncated, _ = env.step(np.zeros((3, 4, 3)))
    assert observations.shape == (3, 4, 55)
    assert rewards.shape == terminated.shape == truncated.shape == (3, 4)
    assert env.observation_space.contains(observations[1, 2])
    assert env.render() is None
    env.close()


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(("task", "drones"), [("hover", 1), ("crossing", 2), ("follow", 1)])
def test_vector_environments(task, drones, mode):
    env = gymnasium.make_vec(
        environment_id(task),
        num_envs=3,
        num_drones=drones,
        horizon=7,
        vector_kwargs=None,
        autoreset_mode=mode,
    )
    assert env.metadata["autoreset_mode"] == mode
    first, _ = env.reset(seed=3)
    assert env.observation_space.contains(first)
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)
    env.action_space.seed(0)
    for k in range(1, 9):
        observation, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        assert truncated.all() == (k == 7)
        assert not terminated.any()
        if mode == AutoresetMode.SAME_STEP and k == 7:
            assert infos["final_obs"].shape == observation.shape
            assert (infos["final_obs"] != observation).any(axis=1).all()
        if mode == AutoresetMode.NEXT_STEP and k == 8:
            assert not rewards.any()
        if mode == AutoresetMode.DISABLED and k == 7:
            env.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    env.close()


def test_vector_and_single_environments_agree():
    vector = gymnasium.make_vec("bulletuav/Hover-v2", num_envs=2, dynamics="rigid_body")
    single = gymnasium.make("bulletuav/Hover-v2", dynamics="rigid_body").unwrapped
    batch, _ = vector.reset(seed=0)
    alone, _ = single.reset(seed=1)
    np.testing.assert_array_equal(batch[1], alone)
    actions = np.full((2, 4), -0.1, np.float32)
    np.testing.assert_array_equal(vector.step(actions)[0][1], single.step(actions[1])[0])
    assert vector.render() == (None, None)
    vector.close()
    single.close()


# Discrete actions, mixed swarms


def test_discrete_actions_in_every_environment_class():
    env = bulletuav.parallel_env("hover", action="discrete", num_drones=2)
    env.reset(seed=0)
    assert env.action_space("drone_0") == gymnasium.spaces.Discrete(7)
    env.step({"drone_0": 5, "drone_1": 0})
    assert env.aviary.swarm.velocity[0, 0, 2] > 0.05
    for bad in (7, -1, 1.5):
        with pytest.raises(ValueError, match="a whole number from 0 to 6"):
            env.step({"drone_0": bad, "drone_1": 0})
    batch = bulletuav.batch_env("hover", 3, action="discrete_27", num_drones=2)
    batch.reset(seed=0)
    batch.step(np.zeros((3, 2), dtype=int))
    central = gymnasium.make("bulletuav/Hover-v2", action="discrete", num_drones=2).unwrapped
    central.reset(seed=0)
    assert central.action_space == gymnasium.spaces.MultiDiscrete([7, 7])
    central.step(np.array([1, 2]))
    vector = gymnasium.make_vec("bulletuav/Hover-v2", num_envs=2, action="discrete")
    vector.reset(seed=0)
    vector.step(np.array([1, 2]))
    for one in (env, batch, central, vector):
        one.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_mixed_swarms_fly_each_by_its_own_constants(dynamics):
    fleet = ("cf2x", "firefly", "hummingbird")
    env = bulletuav.parallel_env(
        "hover", airframe=fleet, dynamics=dynamics, spacing=4.0, action="rotor"
    )
    env.reset(seed=0)
    assert [env.action_space(agent).shape for agent in env.agents] == [(4,), (6,), (4,)]
    hover = {}
    for agent, airframe in zip(env.agents, env.aviary.options.airframe, strict=True):
        share = (airframe.hover_speed() / airframe.max_rotor_speed) ** 2
        hover[agent] = np.full(len(airframe.rotors), 2 * share - 1)
    for _ in range(15):
        env.step(hover)
    assert np.abs(env.aviary.swarm.velocity[..., 2]).max() < 0.02  # a little ground effect
    assert (env.aviary.swarm.rotor_speed[0, 0, 4:] == 0).all()
    with pytest.raises(ValueError, match=r"action of drone_1 has shape \(4,\): \(6,\)"):
        env.step({agent: np.zeros(4) for agent in env.agents})
    central = gymnasium.make("bulletuav/Hover-v2", airframe=fleet, spacing=4.0).unwrapped
    assert central.action_space.shape == (14,)
    central.reset(seed=0)
    central.step(np.concatenate([hover[agent] for agent in env.possible_agents]))
    np.testing.assert_allclose(central.aviary.swarm.velocity, 0, atol=0.01)
    with pytest.raises(ValueError, match="actions have shape"):
        central.step(np.zeros(12))
    env.close()
    central.close()


# Pictures as observations


def test_pictures_are_observed_as_uint8_and_metres():
    options = {"observation": ("rates", "rgb", "depth"), "camera_size": (32, 24)}
    env = bulletuav.parallel_env(
        "hover", num_drones=2, start=((-1.0, 0, 2), (1.0, 0, 2)), action="velocity", **options
    )
    observations, _ = env.reset(seed=0)
    one = observations["drone_0"]
    assert (one["rgb"].shape, one["rgb"].dtype) == ((24, 32, 3), np.uint8)
    assert (one["depth"].shape, one["depth"].dtype) == ((24, 32), np.float32)
    assert env.observation_space("drone_0").contains(one)
    # Straight ahead stands drone 1: its rim is 2 m less both radii away from the lens, its body at
    # most a radius more.
    radius = env.aviary.options.airframe[0].collision_radius
    ahead = one["depth"][11:13, 15:17].min()
    assert 2 - 2 * radius - 0.02 < ahead < 2 - radius
    # The last row looks down by 45 degrees at its edge, a little less inside.
    assert one["depth"][-1, 16] == pytest.approx(2.04, abs=0.06)
    assert one["depth"][0, 0] == 2000  # sky
    only = bulletuav.parallel_env("hover", observation="depth", camera_size=(16, 12))
    assert set(only.reset(seed=0)[0]["drone_0"]) == {"depth"}
    env.close()


def test_pictures_are_taken_at_their_own_rate():
    env = bulletuav.batch_env(
        "hover", 2, observation=("rgb",), camera_size=(16, 12), camera_hz=10, action="velocity"
    )
    before, _ = env.reset(seed=0)
    changed = []
    for _ in range(6):
        after, *_ = env.step(np.full((2, 1, 3), 0.5))
        changed.append(bool((after["rgb"] != before["rgb"]).any()))
        before = after
    assert changed == [False, False, True] * 2
    env.close()


def test_pictures_go_through_gymnasium():
    env = gymnasium.make(
        "bulletuav/Hover-v2", observation=("attitude", "rgb"), camera_size=(16, 12)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()
    vector = gymnasium.make_vec(
        "bulletuav/Hover-v2", num_envs=2, observation=("attitude", "rgb"), camera_size=(16, 12)
    )
    first, _ = vector.reset(seed=0)
    assert vector.observation_space.contains(first)
    vector.close()
