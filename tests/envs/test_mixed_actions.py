"""Drones that differ in the kind of their action."""

import json

import numpy as np
import pytest
from gymnasium.spaces import Box

import bulletuav
from bulletuav.adapters.self_play import CentralTeamAviary, team_env
from bulletuav.cli import main
from bulletuav.control.actions import ActionContext, make_action, make_actions
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.common_spaces import common_observation
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.gymnasium import CentralAviary
from bulletuav.policies import find_policy
from bulletuav.vehicle.airframes import load_airframe

HOVER = {"dynamics": "rigid_body", "horizon": 40, "effects": ("lag", "drag", "body_drag")}
PLACES = np.array([(-4.0, 0.0, 2.0), (4.0, 1.0, 3.0)])
VELOCITIES = np.array([(0.5, 0.0, -0.2), (0.0, 0.3, 0.1)])


def fly(actions, rows, **options):
    """Return the swarm and rewards after ten decisions of drones `rows` with `actions` of each."""
    aviary = Aviary("hover", 1, num_drones=len(rows), **{**HOVER, **options})
    places = {"start": PLACES[rows], "goal": PLACES[rows] + 0.5, "velocity": VELOCITIES[rows]}
    aviary.reset(seeds=4, **places)
    for k in range(10):
        step = aviary.step(actions[None, rows, : aviary.action.low.shape[1]] * (-1) ** k)
    swarm = {name: array.copy() for name, array in aviary.swarm._asdict().items()}
    return swarm, step.rewards, aviary.commanded.copy()


@pytest.mark.parametrize("names", [("rates", "velocity"), ("velocity_increment", "rotor")])
def test_drones_fly_as_each_does_alone_with_its_own_action(names):
    actions = np.array([(0.1, -0.2, 0.3, 0.15), (0.4, 0.2, -0.1, 0.0)])
    both, rewards, commanded = fly(actions, [0, 1], action=list(names))
    for i, name in enumerate(names):
        alone, reward, own = fly(actions, [i], action=name)
        for part, array in alone.items():
            np.testing.assert_array_equal(both[part][:, i], array[:, 0], err_msg=part)
        assert rewards[0, i] == reward[0, 0]
        np.testing.assert_array_equal(commanded[:, i], own[:, 0])
    assert np.linalg.norm(both["position"][0] - PLACES, axis=-1).min() > 0.05


def test_setpoints_are_those_of_each_drones_level():
    aviary = Aviary("hover", 1, num_drones=3, action=["velocity", "rates", "rpm"], **HOVER)
    assert aviary.simulation.worlds.state.levels.tolist() == [[1, 4, 5]]
    setpoint = aviary.action.decode(np.full((1, 3, 4), 0.5), np.zeros((1, 3, 3)))[0]
    most = load_airframe("cf2x").max_thrust
    # max_speed 5 m/s: (2.5, 2.5, 2.5) is shorter than it; 360 and 180 degrees/s; rpm as rad/s
    np.testing.assert_allclose(setpoint[0], (2.5, 2.5, 2.5, 0.0))
    np.testing.assert_allclose(setpoint[1], (np.pi, np.pi, np.pi / 2, 0.75 * most))
    np.testing.assert_allclose(setpoint[2], 0.5 * 2 * np.pi / 60)
    aviary.close()


def test_each_agent_has_the_space_of_its_own_action():
    env = bulletuav.parallel_env("hover", num_drones=2, action=["rates", "velocity"], **HOVER)
    assert env.action_space("drone_0") == Box(-1, 1, (4,), np.float32)
    assert env.action_space("drone_1") == Box(-1, 1, (3,), np.float32)
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    with pytest.raises(ValueError, match=r"drone_1 has shape \(4,\): \(3,\) is needed"):
        env.step({"drone_0": np.zeros(4), "drone_1": np.zeros(4)})
    env.close()
    joint = CentralAviary("hover", num_drones=2, action=["rates", "velocity"], **HOVER)
    assert joint.action_space == Box(-1, 1, (7,), np.float32)
    joint.close()


def test_numbers_beyond_those_of_a_drone_are_padding_with_bounds_of_zero():
    batch = bulletuav.batch_env(
        "hover", 2, num_drones=2, action=["velocity", "rpm"], normalise=False, **HOVER
    )
    most = load_airframe("cf2x").max_rotor_speed * 60 / (2 * np.pi)
    low, high = batch.aviary.action.low, batch.aviary.action.high
    np.testing.assert_allclose(low, [(-1, -1, -1, 0), (0, 0, 0, 0)])
    np.testing.assert_allclose(high, [(1, 1, 1, 0), (most,) * 4])
    # The space that all drones share contains the actions of each
    np.testing.assert_allclose(batch.action_space.low, (-1, -1, -1, 0))
    np.testing.assert_allclose(batch.action_space.high, (most,) * 4, rtol=1e-6)
    hashes = []
    for padding in (0.0, 1.0):
        batch.reset(seed=0)
        actions = np.full((2, 2, 4), 0.3)
        actions[:, 0, 3] = padding
        batch.step(actions)
        hashes.append(batch.state_hash())
    assert hashes[0] == hashes[1]
    batch.close()


def test_actions_are_given_by_team():
    mixed = {"chasers": "acceleration", "evaders": "heading_speed"}
    options = {"dynamics": "rigid_body", "evader_speed": 1.0, "action": mixed}
    env = bulletuav.parallel_env("pursuit_evasion", **options)
    for team, name in mixed.items():
        own = make_action(name, _context(1))
        for agent in env.group_map[team]:
            row = int(agent[6:])
            assert env.aviary.action.levels[row] == own.level
    # The same drones with a list
    team = env.aviary.task.team
    names = [("acceleration", "heading_speed")[k] for k in team]
    listed = bulletuav.parallel_env("pursuit_evasion", **{**options, "action": names})
    for one in (env, listed):
        one.reset(seed=0)
        one.step({agent: np.full(3, 0.4) for agent in one.agents})
    assert env.state_hash() == listed.state_hash()
    env.close()
    listed.close()


def test_a_team_learns_with_its_own_action_against_another_one():
    mixed = {"chasers": "rates", "evaders": "velocity"}
    options = {"dynamics": "rigid_body", "evader_speed": 1.0, "action": mixed}
    env = team_env("pursuit_evasion", "evaders", "random", **options)
    assert [space.shape for space in env.action_spaces.values()] == [(3,)]
    env.reset(seed=0)
    env.step({agent: np.full(3, 0.1) for agent in env.agents})
    # The random rates of the chasers have turned them, and velocities hold the yaw
    rates = np.abs(env.env.aviary.swarm.rates[0]).max(axis=1)
    assert (rates[:3] > 0.1).all()
    env.close()
    joint = CentralTeamAviary("pursuit_evasion", "chasers", "random", **options)
    assert joint.action_space.shape == (12,)
    joint.reset(seed=0)
    joint.step(np.full(12, 0.1))
    joint.close()
    with pytest.raises(ValueError, match="'flee' supports velocity .* not 'rates'"):
        team_env("pursuit_evasion", "chasers", "flee", **options).reset(seed=0)


def test_stages_with_other_mixes_are_no_curriculum():
    mixes = (["rates", "velocity"], ["velocity", "rates"])
    specs = [EnvSpec("hover", 1, {"num_drones": 2, "action": one}) for one in mixes]
    with pytest.raises(ValueError, match="'1 x rates, 1 x velocity', '1 x velocity, 1 x rates'"):
        common_observation(specs)


def _context(drones):
    return ActionContext([load_airframe("cf2x")] * drones, 5, 5, -np.ones(3), np.ones(3), 0.1, 9.8)


def test_equal_names_are_one_action():
    for action in (["velocity"] * 2, {"drones": "velocity"}):
        made = EnvSpec("hover", 1, {"num_drones": 2, "action": action}).action
        assert (made.name, made.parts) == ("velocity", ())
    assert make_actions(["rates"] * 2, _context(2)).name == "rates"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action": ["rates"]}, "action has 1 names for 2 drones: give one name, or one for each"),
        ({"action": ["rates", "velo"]}, "unknown action 'velo': did you mean 'velocity'"),
        ({"action": ["rates", "discrete"]}, "'discrete' is a choice, .* drones are rates: choose"),
        ({"action": {}}, r"action lacks the teams \['drones'\]"),
        ({"action": {"drone": "rates"}}, "team of task 'hover' in action: 'drone': did you mean"),
        ({"action": {"drones": "rate"}}, "action of team 'drones' 'rate': did you mean 'rates'"),
        (
            {"action": ["velocity", "rates"], "dynamics": "point_mass"},
            "'rates' gives rates setpoints, but dynamics 'point_mass'",
        ),
        (
            {"action": ["velocity", "rates"], "max_climb": 1.0},
            "limits actions that command velocities, and 'rates' does not",
        ),
        ({"action": ["rpm", "rates"], "gravity": 0}, "action 'rates' needs gravity"),
        (
            {"action": ["velocity", "rates"], "controller": "pid", "effects": ()},
            "'pid' supports no rates",
        ),
    ],
)
def test_impossible_mixes_raise_errors(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("hover", 1, {"num_drones": 2, **options})


def test_a_team_with_a_speed_limit_commands_velocities():
    mixed = {"chasers": "velocity", "evaders": "rates"}
    with pytest.raises(ValueError, match="'rates' does not command velocities"):
        EnvSpec("pursuit_evasion", 1, {"action": mixed, "evader_speed": 0.6})


def test_policies_fly_mixes_of_the_actions_that_they_support():
    names = ["target_position", "velocity", "velocity_increment"]
    aviary = Aviary("crossing", 1, num_drones=3, action=names, dynamics="rigid_body")
    policy = find_policy("straight")(aviary)
    seen = aviary.reset(seeds=1)
    actions = policy.act(seen, aviary.swarm)
    for i, name in enumerate(names):
        alike = Aviary("crossing", 1, num_drones=3, action=name, dynamics="rigid_body")
        own = find_policy("straight")(alike).act(alike.reset(seeds=1), alike.swarm)
        np.testing.assert_array_equal(actions[:, i], own[:, i])
        alike.close()
    with pytest.raises(
        ValueError,
        match="'orca' supports velocity or velocity_increment actions, "
        "not 'target_position': choose action='velocity'",
    ):
        find_policy("orca")(aviary)
    aviary.close()


def test_snapshots_continue_the_flight():
    options = {"num_drones": 2, "action": ["velocity_increment", "rates"], **HOVER}
    env = bulletuav.parallel_env("hover", **options)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    given = [
        {"drone_0": rng.uniform(-1, 1, 3), "drone_1": rng.uniform(-0.2, 0.2, 4)} for _ in range(6)
    ]
    for actions in given[:3]:
        env.step(actions)
    saved = env.save_state()
    for actions in given[3:]:
        env.step(actions)
    other = bulletuav.parallel_env("hover", **options)
    other.reset(seed=1)
    other.load_state(saved)
    for actions in given[3:]:
        other.step(actions)
    assert env.state_hash() == other.state_hash()
    same_size = bulletuav.parallel_env("hover", **{**options, "action": ["velocity", "rates"]})
    same_size.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        same_size.load_state(saved)
    for one in (env, other, same_size):
        one.close()


def test_recordings_store_the_names_and_are_verified(tmp_path, capsys):
    action = "['velocity', 'target_position']"
    flown = ["--drones", "2", "--dynamics", "rigid_body", "--set", f"action={action}"]
    base = ["fly", "crossing", "--policy", "straight", "--horizon", "20", "--out", str(tmp_path)]
    assert main([*base, *flown]) in (0, None)
    (run,) = tmp_path.rglob("run.json")
    assert json.loads(run.read_text())["options"]["action"] == ["velocity", "target_position"]
    assert main(["verify", str(run.parent)]) in (0, None)


def test_evaluations_list_the_names():
    found = bulletuav.evaluate(
        "crossing",
        "straight",
        episodes=1,
        num_drones=2,
        horizon=20,
        dynamics="rigid_body",
        action=["velocity", "target_position"],
    )
    assert found.about["options"]["action"] == ["velocity", "target_position"]
