"""Drones that differ from team to team in the blocks that they observe."""

import json

import numpy as np
import pytest
from gymnasium.spaces import Box
from pettingzoo.test import parallel_api_test

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.adapters.self_play import CentralTeamAviary, team_env
from bulletuav.cli import main
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies import find_policy
from bulletuav.policies.versus import RowsPolicy, TeamPolicies
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.base import Label
from bulletuav.tasks.pursuit_evasion import PursuitEvasion

GAME = {"num_drones": 4, "dynamics": "point_mass", "horizon": 30}
MIXED = {"chasers": ["velocity", "opponents"], "evaders": ["room", "velocity"]}
"""Blocks of the teams; drones 0 to 2 are chasers, drone 3 is an evader"""
SIZES = (3 + 3 * 8, 3 + 3 * 8, 3 + 3 * 8, 6 + 3)
UNION = ["velocity", "opponents", "room"]


def team_of(row):
    return "evaders" if row == 3 else "chasers"


def expected(uniform, row, vector):
    """Return the numbers of a drone's own blocks from a vector of all blocks."""
    parts = uniform.split(vector)
    return np.concatenate([parts[name] for name in MIXED[team_of(row)]], axis=-1)


@pytest.mark.parametrize("more", [{}, {"normalise": True}, {"dynamics": "rigid_body"}], ids=str)
def test_each_agent_observes_the_blocks_of_its_team(more):
    env = bulletuav.parallel_env("pursuit_evasion", observation=MIXED, **{**GAME, **more})
    uniform = bulletuav.parallel_env("pursuit_evasion", observation=UNION, **{**GAME, **more})
    seen, both = env.reset(seed=5)[0], uniform.reset(seed=5)[0]
    rng = np.random.default_rng(0)
    for _ in range(12):
        for row, agent in enumerate(env.agents):
            assert seen[agent].shape == (SIZES[row],)
            assert seen[agent].dtype == np.float32
            np.testing.assert_array_equal(seen[agent], expected(uniform, row, both[agent]))
            assert env.observation_space(agent).contains(seen[agent])
        actions = {agent: rng.uniform(-1, 1, 3) for agent in env.agents}
        seen, both = env.step(actions)[0], uniform.step(actions)[0]
    assert env.state_hash() == uniform.state_hash()
    saved = env.save_state()
    again = env.load_state(saved)
    assert {agent: len(vector) for agent, vector in again.items()} == {
        f"drone_{i}": size for i, size in enumerate(SIZES)
    }
    env.close()
    uniform.close()


def test_pettingzoo_accepts_the_environment():
    env = bulletuav.parallel_env("pursuit_evasion", observation=MIXED, **GAME)
    parallel_api_test(env, num_cycles=40)
    turns = bulletuav.aec_env("pursuit_evasion", observation=MIXED, **GAME)
    turns.reset(seed=0)
    assert turns.observe("drone_3").shape == (9,)
    for one in (env, turns):
        one.close()


def test_spaces_have_the_bounds_of_the_teams_blocks():
    env = bulletuav.parallel_env("pursuit_evasion", observation=MIXED, **GAME)
    task = env.aviary.task
    speed = np.full(3, 2 * task.context.max_speed)
    size = np.repeat(task.arena_high - task.arena_low, 2)
    evader = env.observation_space("drone_3")
    np.testing.assert_allclose(evader.high[6:], env.observation_space("drone_0").high[:3])
    own = env.aviary.observer.of(3)
    assert [own.labels[k].unit for k in (0, 6)] == ["m", "m/s"]
    assert list(own.slices) == ["room", "velocity"]
    assert evader.high.shape == (9,)
    assert evader.high[:6].max() <= size.max() + 1e-3
    assert evader.high[6:].max() <= speed.max()
    assert env.observation_space("drone_0") == env.observation_space("drone_2")
    env.close()


def test_batches_are_padded_with_zeros():
    batch = bulletuav.batch_env("pursuit_evasion", 5, observation=MIXED, **GAME)
    uniform = bulletuav.batch_env("pursuit_evasion", 5, observation=UNION, **GAME)
    kinds = [batch.aviary.observer.of(i).space() for i in (0, 3)]
    low, high = (
        np.array([np.pad(getattr(one, side), (0, 27 - one.shape[0])) for one in kinds])
        for side in ("low", "high")
    )
    assert batch.observation_space == Box(low.min(axis=0), high.max(axis=0), dtype=np.float32)
    seen, both = batch.reset(seed=1)[0], uniform.reset(seed=1)[0]
    rng = np.random.default_rng(1)
    for _ in range(40):  # with resets of worlds whose episode ended
        assert seen.shape == (5, 4, 27)
        for row in range(4):
            own = expected(uniform, row, both[:, row])
            np.testing.assert_array_equal(seen[:, row, : SIZES[row]], own)
            assert not seen[:, row, SIZES[row] :].any()
        actions = rng.uniform(-1, 1, (5, 4, 3))
        seen, both = batch.step(actions)[0], uniform.step(actions)[0]
    assert batch.state_hash() == uniform.state_hash()
    batch.close()
    uniform.close()


def test_workers_share_padded_vectors():
    one = bulletuav.batch_env("pursuit_evasion", 4, observation=MIXED, **GAME)
    two = bulletuav.batch_env("pursuit_evasion", 4, observation=MIXED, workers=2, **GAME)
    assert one.observation_space == two.observation_space
    np.testing.assert_array_equal(one.reset(seed=3)[0], two.reset(seed=3)[0])
    actions = np.random.default_rng(3).uniform(-1, 1, (4, 4, 3))
    np.testing.assert_array_equal(one.step(actions)[0], two.step(actions)[0])
    one.close()
    two.close()


def test_debugged_environments_observe_the_same():
    aviaries = [
        Aviary("pursuit_evasion", 2, observation=MIXED, debug=debug, **GAME)
        for debug in (False, True)
    ]
    first = [one.reset(seeds=2) for one in aviaries]
    np.testing.assert_array_equal(*first)
    steps = [one.step(np.full((2, 4, 3), 0.5)).observations for one in aviaries]
    np.testing.assert_array_equal(*steps)
    for one in aviaries:
        one.close()


def test_views_and_resets_of_some_worlds_keep_the_padding():
    aviary = Aviary("pursuit_evasion", 3, observation=MIXED, copy=False, **GAME)
    aviary.reset(seeds=2)
    aviary.step(np.full((3, 4, 3), 0.5))
    seen = aviary.reset(np.array([False, True, False]), seeds=[0, 7, 0])
    fresh = Aviary("pursuit_evasion", 3, observation=MIXED, **GAME)
    np.testing.assert_array_equal(seen[1], fresh.reset(seeds=[0, 7, 0])[1])
    assert not seen[:, 3, 9:].any()
    aviary.close()
    fresh.close()


def test_a_team_has_its_own_labels_and_width_in_self_play():
    env = team_env("pursuit_evasion", "evaders", "lead", observation=MIXED, **GAME)
    assert [one.shape for one in env.observation_spaces.values()] == [(9,)]
    assert len(env.observation_labels) == 9
    seen, _ = env.reset(seed=0)
    assert set(env.split(seen["drone_3"])) == {"room", "velocity"}
    env.step({"drone_3": np.zeros(3)})
    env.close()
    joint = CentralTeamAviary("pursuit_evasion", "chasers", "flee", observation=MIXED, **GAME)
    assert joint.observation_space.shape == (3 * 27,)
    assert joint.reset(seed=0)[0].shape == (81,)
    assert joint.step(np.zeros(9))[0].shape == (81,)
    joint.close()


def test_functions_fly_opponents_from_the_numbers_of_their_own_team():
    given = []

    def chase(rows):
        given.append(rows)
        return np.zeros((len(rows), 3))

    env = team_env("pursuit_evasion", "evaders", chase, observation=MIXED, **GAME)
    seen = env.env.aviary.reset(seeds=4)
    env.reset(seed=4)
    env.step({"drone_3": np.zeros(3)})
    np.testing.assert_array_equal(given[0][:3], seen[0, :3])
    env.close()
    aviary = Aviary("pursuit_evasion", 2, observation=MIXED, **GAME)
    shapes = []

    def flee(rows):
        shapes.append(rows.shape)
        return np.zeros((len(rows), 3))

    policy = TeamPolicies(
        aviary, [find_policy("lead"), lambda one: RowsPolicy(one, flee)], ("chasers", "evaders")
    )
    policy.act(aviary.reset(seeds=0), aviary.swarm)
    assert shapes == [(8, 9)]
    aviary.close()


def test_one_observation_for_all_teams_is_no_mix():
    for given in ({"drones": ["velocity"]}, ["velocity"]):
        spec = EnvSpec("hover", 1, {"num_drones": 2, "observation": given})
        assert spec.observer.kinds == (spec.observer,)
        assert spec.observer.of(1) is spec.observer
    same = {"chasers": "velocity", "evaders": ("velocity",)}
    assert EnvSpec("pursuit_evasion", 1, {"observation": same}).observer.space().shape == (3,)


@block([Label("height", "m", 0.0, 50.0)])
def height(position):
    return position[2]


class Scouts(PursuitEvasion):
    """A game in which evaders observe their height only."""

    name = "scouts"
    observation = {"chasers": ("velocity",), "evaders": (height,)}  # noqa: RUF012


def test_tasks_declare_observations_of_teams():
    env = bulletuav.parallel_env(Scouts, **GAME)
    seen, _ = env.reset(seed=0)
    assert [len(vector) for vector in seen.values()] == [3, 3, 3, 1]
    assert seen["drone_3"][0] == np.float32(env.aviary.swarm.position[0, 3, 2])
    env.close()
    bulletuav.check_task(Scouts, **GAME)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({"chasers": ["velocity"]}, r"observation lacks the teams \['evaders'\]"),
        ({"chaser": ["velocity"]}, "in observation: 'chaser': did you mean 'chasers'"),
        ({"chasers": ["velocty"], "evaders": ["room"]}, "'velocty': did you mean 'velocity'"),
        ({"chasers": [], "evaders": ["room"]}, "observation is empty"),
        ({"chasers": 3, "evaders": ["room"]}, "observation is 3: a list or tuple is needed"),
        (
            {"chasers": ["depth"], "evaders": ["room"]},
            "differs by team, and has the picture 'depth': leave pictures out",
        ),
    ],
)
def test_impossible_observations_raise_errors(observation, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("pursuit_evasion", 1, {"observation": observation})


def test_blocks_of_the_same_name_are_the_same_block():
    @block([Label("height", "m", 0.0, 50.0)])
    def own(position):
        return position[2] + 1.0

    own.__name__ = "height"
    mixed = {"chasers": [height], "evaders": [own]}
    with pytest.raises(ValueError, match="different blocks of the name 'height'"):
        EnvSpec("pursuit_evasion", 1, {"observation": mixed})


def test_dicts_are_for_one_observation():
    with pytest.raises(ValueError, match="observation_format is 'dict': choose 'vector'"):
        EnvSpec("pursuit_evasion", 1, {"observation": MIXED, "observation_format": "dict"})


def test_what_needs_one_observation_names_the_remedy():
    env = bulletuav.parallel_env("pursuit_evasion", observation=MIXED, **GAME)
    seen, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"aviary\.observer\.of\(i\)\.split"):
        env.split(seen["drone_0"])
    with pytest.raises(ValueError, match=r"aviary\.observer\.of\(i\)\.labels"):
        _ = env.observation_labels
    with pytest.raises(ValueError, match="give one observation for all"):
        find_policy("orca_observed")(env.aviary)
    stages = [{"num_drones": 4}, {"num_drones": 8}]
    common = {"observation": MIXED, "dynamics": "point_mass"}
    with pytest.raises(ValueError, match="give one observation for all"):
        bulletuav.curriculum_env("pursuit_evasion", stages, **common)
    with pytest.raises(ValueError, match="give one observation for all"):
        DroneVecEnv("pursuit_evasion", 2, **common)
    env.close()


def test_snapshots_of_other_observations_are_refused():
    env = bulletuav.parallel_env("pursuit_evasion", observation=MIXED, **GAME)
    env.reset(seed=0)
    other = {**MIXED, "evaders": ["velocity", "room"]}
    swapped = bulletuav.parallel_env("pursuit_evasion", observation=other, **GAME)
    swapped.reset(seed=0)
    with pytest.raises(ValueError, match="observation"):
        swapped.load_state(env.save_state())
    env.close()
    swapped.close()


def test_recordings_store_the_names_and_are_verified(tmp_path):
    given = ["--set", f"observation={MIXED}", "--dynamics", "point_mass", "--horizon", "20"]
    base = ["fly", "pursuit_evasion", "--policy", "lead vs flee", "--out", str(tmp_path)]
    assert main([*base, *given]) in (0, None)
    (run,) = tmp_path.rglob("run.json")
    assert json.loads(run.read_text())["options"]["observation"] == MIXED
    assert main(["verify", str(run.parent)]) in (0, None)


def test_the_table_of_numbers_names_the_teams(capsys):
    main(["tasks", "pursuit_evasion", "--observation", "--set", f"observation={MIXED}"])
    listed = capsys.readouterr().out
    assert "chasers 26" in listed
    assert "evaders 8" in listed
    assert "evaders 9" not in listed
