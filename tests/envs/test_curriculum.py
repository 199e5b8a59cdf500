"""Stages that follow the success of episodes."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from bulletuav import curriculum_env
from bulletuav.envs.curriculum import Curriculum

FAST = {"dynamics": "single_integrator", "horizon": 150, "randomization": {}}


def test_stages_follow_the_success_rate():
    curriculum = Curriculum(3, up=0.75, down=0.25, window=4)
    assert np.isnan(curriculum.success_rate)
    for success in (1, 1, 0):
        curriculum.record(success)
        assert curriculum.stage == 0
    curriculum.record(1)
    assert curriculum.stage == 1  # 3 of 4
    assert np.isnan(curriculum.success_rate)  # a new window
    for success in (0, 1, 0, 1):
        curriculum.record(success)
    assert curriculum.stage == 1
    for success in (0, 0, 0):  # with the last 1 they are 1 of 4, which is not below down
        curriculum.record(success)
    assert curriculum.stage == 1
    curriculum.record(0)
    assert curriculum.stage == 0
    for _ in range(8):
        curriculum.record(0)
    assert curriculum.stage == 0
    for _ in range(20):
        curriculum.record(1)
    assert curriculum.stage == 2


@pytest.mark.parametrize(
    "options",
    [
        {"count": 0},
        {"count": 2, "up": 0.2, "down": 0.8},
        {"count": 2, "window": 0},
        {"count": 2, "up": float("nan")},
    ],
)
def test_what_cannot_be_is_refused(options):
    with pytest.raises(ValueError, match=r"is needed"):
        Curriculum(**options)


STAGES = ({"num_drones": 2}, {"num_drones": 4})


def actions_of(env, stay):
    """Actions that hold still, or fly to the goal with each drone on its own altitude."""
    if stay:
        return {agent: np.zeros(3, dtype=np.float32) for agent in env.agents}
    aviary = env.env.aviary
    wanted = np.clip((aviary.scene.goal - aviary.swarm.position)[0] / 10, -1, 1)
    if aviary.steps[0] < 45:  # until they have passed each other
        wanted[:, 2] = np.linspace(-0.2, 0.2, len(wanted))
    return {agent: wanted[int(agent.split("_")[1])].astype(np.float32) for agent in env.agents}


def fly(env, stay=False, seed=None):
    """Fly an episode; how many drones took part, and the last infos."""
    env.reset(seed=seed)
    count = len(env.agents)
    while env.agents:
        *_, infos = env.step(actions_of(env, stay))
    return count, infos


def test_the_environment_grows_with_success_and_shrinks_without():
    env = curriculum_env("converge", STAGES, window=2, **FAST)
    assert len(env.possible_agents) == 4
    counts = [fly(env, seed=0)[0], *(fly(env)[0] for _ in range(3))]
    assert counts == [2, 2, 4, 4]
    _, infos = fly(env)
    assert {info["stage"] for info in infos.values()} == {1.0}
    for _ in range(3):
        fly(env, stay=True)
    assert fly(env, stay=True)[0] == 2
    assert env.state().shape == (17 * 4,)
    assert not env.state()[17 * 2 :].any()
    assert env.render() is None
    env.close()


def test_the_seed_is_an_option_and_nothing_works_before_the_first_reset():
    first = []
    for _ in range(2):
        env = curriculum_env("converge", STAGES, seed=3, **FAST)
        for ask in (env.state, env.render, lambda env=env: env.step({})):
            with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
                ask()
        assert env.render_mode is None
        first.append(env.reset()[0]["drone_0"])
        env.close()
    np.testing.assert_array_equal(*first)


def test_an_episode_that_is_left_early_is_not_counted():
    env = curriculum_env("converge", STAGES, window=1, **FAST)
    for _ in range(3):
        env.reset(seed=0)
        env.step(actions_of(env, stay=True))
    assert np.isnan(env.curriculum.success_rate)
    env.close()


def test_where_the_next_stage_finds_no_start_the_episode_goes_on():
    """The places of six drones, 100 m apart, do not fit into the streets of so small a city."""
    env = curriculum_env(
        "coverage", [{"num_drones": 2}, {"num_drones": 6}], area=250.0, dynamics="point_mass"
    )
    env.reset(seed=0)
    actions = {agent: np.zeros(3, np.float32) for agent in env.agents}
    env.step(actions)
    before = env.state_hash()
    env.curriculum.restore({**env.curriculum.state(), "stage": 1})
    with pytest.raises(ValueError, match="no places for 6 drones"):
        env.reset()
    assert env.state_hash() == before
    assert set(env.step(actions)[0]) == set(actions)
    env.close()


def test_it_is_a_pettingzoo_environment_and_its_spaces_hold_all_stages():
    env = curriculum_env(
        "crossing", ({"num_drones": 4}, {"num_drones": 4, "half_length": 150.0}), window=1, **FAST
    )
    parallel_api_test(env, num_cycles=300)
    space = env.observation_space("drone_0")
    for _ in range(3):
        observations, _ = env.reset()
        assert all(space.contains(row) for row in observations.values())
    env.close()
    parallel_seed_test(lambda: curriculum_env("converge", STAGES, window=1, **FAST), num_cycles=50)


@pytest.mark.parametrize(
    ("stages", "options", "said"),
    [
        (STAGES, {"observation": ("goal", "identity")}, r"have shapes \[\(6,\), \(8,\)\]"),
        (
            ({}, {"observation": ("goal", "velocity")}),
            {"observation": ("velocity", "goal")},
            r"stage 0 observes velocity \(3\), goal \(4\), and stage 1 observes goal \(4\), veloc",
        ),
        (
            ({}, {}, {"num_neighbours": 1, "num_beams": 23}),
            {"observation": ("neighbours", "lidar"), "num_neighbours": 2, "num_beams": 16},
            r"neighbours \(14\), lidar \(16\), and stage 2 observes neighbours \(7\), lidar \(23\)",
        ),
        (
            ({"observation": "rates"}, {"observation": "velocity"}),
            {},
            r"stage 0 observes rates \(3\), and stage 1 observes velocity \(3\): the same blocks",
        ),
        (({"action": "velocity"}, {"action": "velocity_increment"}), {}, "one kind for all"),
        (({"difficulty": "esy"},), {}, "did you mean 'easy'"),
        ((), {}, "stages is 0"),
    ],
)
def test_stages_that_no_agent_can_fly_alike_are_refused(stages, options, said):
    with pytest.raises(ValueError, match=said):
        curriculum_env("converge", stages, **FAST | options)
