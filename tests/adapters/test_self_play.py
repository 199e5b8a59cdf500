"""Environments of one team, whose opponents fly by policies."""

import copy
import pickle
import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig, shipped

POINTS = {"dynamics": "single_integrator", "difficulty": "easy", "horizon": 40}


@pytest.fixture
def make():
    """Builds environments of one team and closes them."""
    made = []

    def make_one(team="chasers", opponents="flee", **options):
        made.append(bulletuav.team_env("pursuit_evasion", team, opponents, **POINTS, **options))
        return made[-1]

    yield make_one
    for one in made:
        one.close()


@pytest.mark.parametrize(("team", "agents"), [("chasers", [0, 1, 2]), ("evaders", [3])])
def test_it_shows_the_agents_of_the_team_alone(team, agents, make):
    env = make(team, "random")
    names = [f"drone_{i}" for i in agents]
    assert env.possible_agents == names
    assert env.metadata["group_map"] == {team: names}
    seen, infos = env.reset(seed=0)
    assert list(seen) == list(infos) == names
    results = env.step({name: np.zeros(3, np.float32) for name in names})
    assert [list(one) for one in results] == [names] * 5


@pytest.mark.filterwarnings("ignore:.*")
def test_pettingzoo_checks_it(make):
    parallel_api_test(make(), num_cycles=60)
    parallel_api_test(make("evaders", "lead"), num_cycles=60)


def test_opponents_fly_as_in_a_versus(make):
    """The same bits as of one policy for each team, to the end of the episode."""
    env = make("chasers", "flee_gap")
    aviary = bulletuav.Aviary("pursuit_evasion", **POINTS)
    policy = find_policy("lead vs flee_gap")(aviary)
    observations = aviary.reset(seeds=5)
    seen, _ = env.reset(seed=5)
    chaser = find_policy("lead")(env.env.aviary)
    while env.agents:
        for name in seen:
            np.testing.assert_array_equal(seen[name], observations[0, int(name[-1])])
        given = chaser.act(observations, env.env.aviary.swarm)[0]
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        seen, rewards, *_ = env.step({name: given[int(name[-1])] for name in env.agents})
        for name, reward in rewards.items():
            assert reward == step.rewards[0, int(name[-1])]
    assert not aviary.alive.any()
    aviary.close()


def test_a_function_is_asked_anew_at_every_decision(make):
    ways = {"east": 1.0}

    def learner(rows):
        return np.tile((ways["east"], 0.0, 0.0), (len(rows), 1))

    env = make("chasers", learner)
    env.reset(seed=0)
    still = {name: np.zeros(3) for name in env.agents}
    env.step(still)
    assert env.env.aviary.swarm.velocity[0, 3, 0] > 0
    ways["east"] = -1.0
    env.step(still)
    assert env.env.aviary.swarm.velocity[0, 3, 0] < 0


@pytest.mark.parametrize("central", [False, True])
def test_other_opponents_fly_from_the_next_reset_on(central, make):
    env = make("chasers", "stay", central=central)
    aviary = (env.env if central else env).env.aviary
    still = np.zeros(9, np.float32) if central else {f"drone_{i}": np.zeros(3) for i in range(3)}
    env.reset(seed=0)
    env.opponents = {"evaders": "climb"}
    env.step(still)
    assert not aviary.swarm.velocity[0, 3].any()
    env.reset(seed=0)
    env.step(still)
    assert aviary.swarm.velocity[0, 3, 2] > 0
    assert env.opponents == {"evaders": "climb"}


@pytest.mark.parametrize("central", [False, True])
@pytest.mark.parametrize("opponents", ["wander", "flee", "random"])
def test_flights_go_on_from_a_snapshot_with_what_policies_remember(opponents, central, make):
    def flown(env, decisions):
        told = []
        for k in range(decisions):
            push = np.full(3, 0.1 * (k % 5))
            agents = env.env.agents if central else env.agents
            results = env.step(np.tile(push, 3) if central else dict.fromkeys(agents, push))
            told.append(results[0] if central else dict(results[0]))
        return told, env.state_hash()

    env, other = (make("chasers", opponents, central=central) for _ in range(2))
    env.reset(seed=4)
    flown(env, 3)
    saved, hashed = pickle.loads(pickle.dumps(env.save_state())), env.state_hash()
    first = flown(env, 25)
    other.reset(seed=9)
    for one in (env, other):
        seen = one.load_state(saved)
        assert one.state_hash() == hashed
        assert len(seen) == (one.observation_space.shape[0] if central else 3)
        np.testing.assert_equal(flown(one, 25), first)


def test_a_snapshot_of_other_opponents_or_options_changes_nothing(make):
    env, other = make(opponents="wander"), make(opponents="flee")
    more = make(opponents="wander", num_drones=5)
    for one in (env, other, more):
        one.reset(seed=0)
    hashed, memory = env.state_hash(), repr(env.save_state().beside["0: Wander"]["_way"])
    with pytest.raises(ValueError, match=r"policies \['0: Flee', .*'0: Wander'"):
        env.load_state(other.save_state())
    with pytest.raises(ValueError, match="of another simulation"):
        env.load_state(more.save_state())
    with pytest.raises(ValueError, match="a result of save_state is needed"):
        env.load_state(env.save_state().flight)
    assert env.state_hash() == hashed
    assert repr(env.save_state().beside["0: Wander"]["_way"]) == memory


@pytest.mark.parametrize("format_", [{"observation_format": "dict"}, {"action": "discrete"}])
def test_other_spaces(format_, make):
    env = make("evaders", "random", **format_)
    env.reset(seed=0)
    while env.agents:
        actions = {name: env.action_space(name).sample() for name in env.agents}
        seen, *_ = env.step(actions)
        assert all(env.observation_space(name).contains(one) for name, one in seen.items())


def test_one_agent_commands_the_team(make):
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    env = make(central=True)
    team = make()
    observation, _ = env.reset(seed=1)
    seen, _ = team.reset(seed=1)
    np.testing.assert_array_equal(observation, np.concatenate(list(seen.values())))
    action = np.linspace(-1, 1, 9, dtype=np.float32)
    parts = {name: action[3 * i : 3 * i + 3] for i, name in enumerate(seen)}
    observation, reward, *_ = env.step(action)
    seen, rewards, *_ = team.step(parts)
    np.testing.assert_array_equal(observation, np.concatenate(list(seen.values())))
    assert reward == pytest.approx(np.mean(list(rewards.values())))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
        sb3_check_env(env)


def test_an_episode_of_the_one_agent_ends(make):
    ends = []
    for opponents, action in (("stay", 0.0), ("crash", 0.0)):
        env = make("chasers", opponents, central=True)
        env.reset(seed=0)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(np.full(9, action, np.float32))
            over = terminated or truncated
        ends.append((terminated, truncated))
    assert ends == [(False, True), (True, False)]


def test_what_cannot_be_is_refused(make):
    with pytest.raises(ValueError, match="unknown team 'chaser': did you mean 'chasers'"):
        make("chaser")
    with pytest.raises(ValueError, match="unknown policy 'fleee'"):
        make("chasers", "fleee")
    with pytest.raises(ValueError, match=r"opponents are \['chasers'\]: a policy for each of evad"):
        make("chasers", {"chasers": "lead"})
    with pytest.raises(ValueError, match="central=True joins vectors of numbers"):
        make("chasers", "random", central=True, action="discrete")
    env = make()
    with pytest.raises(RuntimeError, match="reset"):
        env.step({})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions lack"):
        env.step({"drone_0": np.zeros(3)})
    with pytest.raises(ValueError, match="unknown agent in actions: 'drone_3'"):
        env.step({f"drone_{i}": np.zeros(3) for i in range(4)})
    central = make(central=True)
    central.reset(seed=0)
    with pytest.raises(ValueError, match=r"action has shape \(3,\): \(9,\) is needed"):
        central.step(np.zeros(3))


def test_what_an_opponent_learned_with_is_what_all_see():
    """The policy that comes with `converge` flies opponents of teams that it has never seen."""
    from bulletuav.tasks.converge import Converge

    class Duel(Converge):
        name = "duel"
        team_names = ("one", "other")

        def __init__(self, config, context):
            super().__init__(config, context)
            self.team[1:] = 1

    run = str(shipped("converge"))
    config = RunConfig.read(shipped("converge") / "run.yaml")
    env = bulletuav.team_env(Duel, "one", run, num_drones=2, dynamics="single_integrator")
    env.reset(seed=0)
    assert env.env.aviary.options.action == config.action
    env.step({"drone_0": np.zeros(3)})
    assert env.env.aviary.swarm.velocity[0, 1].any()
    env.close()


def test_a_copy_is_made_anew():
    env = bulletuav.team_env("pursuit_evasion", "evaders", "lead", **POINTS)
    other = copy.deepcopy(env)
    first, _ = env.reset(seed=0)
    second, _ = other.reset(seed=0)
    np.testing.assert_array_equal(first["drone_3"], second["drone_3"])
    assert env.observation_labels == other.observation_labels
    env.close()
    other.close()
