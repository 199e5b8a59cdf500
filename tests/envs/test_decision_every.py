"""Teams that decide less often than others."""

import json

import numpy as np
import pytest

import bulletuav
from bulletuav.cli import main
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.gymnasium import CentralAviary

GAME = {"num_drones": 4, "dynamics": "point_mass", "horizon": 30}
RATES = {"chasers": 1, "evaders": 3}
"""Drones 0 to 2 are chasers, drone 3 is an evader"""


def drawn(count, seed=0, drones=4):
    return np.random.default_rng(seed).uniform(-1, 1, (count, drones, 3))


def held(actions, every=3, row=3):
    """Return actions in which one drone repeats each `every`-th action."""
    kept = actions.copy()
    for t in range(len(kept)):
        kept[t, row] = actions[t - t % every, row]
    return kept


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_a_slower_team_flies_its_last_action_until_it_decides(dynamics):
    options = {**GAME, "dynamics": dynamics}
    slow = Aviary("pursuit_evasion", 2, decision_every=RATES, **options)
    usual = Aviary("pursuit_evasion", 2, **options)
    slow.reset(seeds=0)
    usual.reset(seeds=0)
    actions = drawn(11)
    for given, flown in zip(actions, held(actions), strict=True):
        one = slow.step(np.stack([given] * 2))
        other = usual.step(np.stack([flown] * 2))
        np.testing.assert_array_equal(one.rewards, other.rewards)
        np.testing.assert_array_equal(one.observations, other.observations)
        np.testing.assert_array_equal(slow.current_frame().action, np.stack([flown] * 2))
    assert slow.state_hash() == usual.state_hash()
    slow.close()
    usual.close()


def test_infos_have_the_drones_that_decide_next():
    batch = bulletuav.batch_env("pursuit_evasion", 2, decision_every=RATES, **GAME)
    _, info = batch.reset(seed=0)
    decides = [info["decides"]]
    for _ in range(6):
        decides.append(batch.step(np.zeros((2, 4, 3)))[-1]["decides"])
    decides = np.array(decides)
    assert decides.dtype == bool
    assert decides[:, :, :3].all()
    assert decides[:, 0, 3].tolist() == [True, False, False, True, False, False, True]
    batch.reset(options={"reset_mask": np.array([False, True])})
    _, _, _, _, info = batch.step(np.zeros((2, 4, 3)))
    # World 0 is at its seventh decision, and world 1 at its first
    assert info["decides"][:, 3].tolist() == [False, False]
    _, _, _, _, info = batch.step(np.zeros((2, 4, 3)))
    assert info["decides"][:, 3].tolist() == [False, False]
    _, _, _, _, info = batch.step(np.zeros((2, 4, 3)))
    assert info["decides"][:, 3].tolist() == [True, True]
    batch.close()


def test_a_reset_of_some_worlds_starts_their_phase_only():
    aviary = Aviary("pursuit_evasion", 2, decision_every=RATES, **GAME)
    aviary.reset(seeds=0)
    aviary.step(np.zeros((2, 4, 3)))
    aviary.reset(np.array([False, True]))
    assert aviary.decides[:, 3].tolist() == [False, True]
    aviary.close()


@pytest.mark.parametrize("given", ["list", "float64"])
def test_actions_in_between_are_ignored(given):
    aviary = Aviary("pursuit_evasion", 1, decision_every=RATES, **GAME)
    aviary.reset(seeds=0)
    actions = drawn(1)
    aviary.step(actions)
    first = aviary.current_frame().action[0, 3].copy()
    actions[0, 3] = np.nan
    aviary.step(actions.tolist() if given == "list" else actions)
    np.testing.assert_array_equal(aviary.current_frame().action[0, 3], first)
    actions[0, 2] = np.nan
    with pytest.raises(ValueError, match="action of drone 2"):
        aviary.step(actions.tolist() if given == "list" else actions)
    aviary.close()


def test_agents_read_whether_they_decide():
    env = bulletuav.parallel_env("pursuit_evasion", decision_every=RATES, **GAME)
    turns = bulletuav.aec_env("pursuit_evasion", decision_every=RATES, **GAME)
    _, infos = env.reset(seed=0)
    turns.reset(seed=0)
    actions = drawn(5)
    for t, given in enumerate(actions):
        assert infos["drone_0"]["decides"] == 1.0
        assert infos["drone_3"]["decides"] == float(t % 3 == 0)
        infos = env.step(dict(zip(env.agents, given, strict=True)))[-1]
        for one in given:
            turns.step(one)
    assert env.state_hash() == turns.state_hash()
    saved = env.aviary.current_frame().action[0]
    np.testing.assert_array_equal(saved, held(actions)[-1])
    env.close()
    turns.close()


def test_a_central_agent_reads_it_for_all_drones():
    env = CentralAviary("pursuit_evasion", decision_every=RATES, **GAME)
    _, info = env.reset(seed=0)
    assert info["decides"].tolist() == [True] * 4
    *_, info = env.step(np.zeros(12))
    assert info["decides"].tolist() == [True, True, True, False]
    env.close()


def test_workers_fly_the_same():
    one = bulletuav.batch_env("pursuit_evasion", 3, decision_every=RATES, **GAME)
    two = bulletuav.batch_env("pursuit_evasion", 3, decision_every=RATES, workers=2, **GAME)
    one.reset(seed=1)
    two.reset(seed=1)
    for actions in drawn(5):
        given = np.stack([actions] * 3)
        first, second = one.step(given), two.step(given)
        np.testing.assert_array_equal(first[0], second[0])
        np.testing.assert_array_equal(first[-1]["decides"], second[-1]["decides"])
    assert one.state_hash() == two.state_hash()
    one.close()
    two.close()


def test_snapshots_have_the_held_action_and_its_phase():
    env = bulletuav.parallel_env("pursuit_evasion", decision_every=RATES, **GAME)
    env.reset(seed=0)
    actions = drawn(7)
    for given in actions[:2]:
        env.step(dict(zip(env.agents, given, strict=True)))
    saved = env.save_state()
    other = bulletuav.parallel_env("pursuit_evasion", decision_every=RATES, **GAME)
    other.reset(seed=9)
    other.load_state(saved)
    for given in actions[2:]:
        for one in (env, other):
            one.step(dict(zip(one.agents, given, strict=True)))
    assert env.state_hash() == other.state_hash()
    usual = bulletuav.parallel_env("pursuit_evasion", **GAME)
    usual.reset(seed=0)
    with pytest.raises(ValueError, match="decision_every"):
        usual.load_state(saved)
    for one in (env, other, usual):
        one.close()


def test_debugged_environments_fly_the_same():
    hashes = []
    for debug in (False, True):
        aviary = Aviary("pursuit_evasion", 1, decision_every=RATES, debug=debug, **GAME)
        aviary.reset(seeds=0)
        for given in drawn(4):
            aviary.step(given[None])
        hashes.append(aviary.state_hash())
        aviary.close()
    assert hashes[0] == hashes[1]


def test_choices_are_held():
    options = {**GAME, "action": "discrete"}
    aviary = Aviary("pursuit_evasion", 1, decision_every=RATES, **options)
    aviary.reset(seeds=0)
    for t, choice in enumerate((1, 2, 3, 4)):
        aviary.step(np.full((1, 4, 1), float(choice)))
        flown = aviary.current_frame().action[0, :, 0].tolist()
        assert flown == [choice] * 3 + [1 if t < 3 else 4]
    aviary.close()


def test_recordings_are_verified(tmp_path):
    given = ["--set", f"decision_every={RATES}", "--dynamics", "point_mass", "--horizon", "20"]
    base = ["fly", "pursuit_evasion", "--policy", "lead vs flee", "--out", str(tmp_path)]
    assert main([*base, *given]) in (0, None)
    (run,) = tmp_path.rglob("run.json")
    assert json.loads(run.read_text())["options"]["decision_every"] == RATES
    assert main(["verify", str(run.parent)]) in (0, None)


@pytest.mark.parametrize(
    ("rates", "message"),
    [
        (3, "decision_every is 3: a dict from teams to whole numbers .* decision_hz changes"),
        ({"chasers": 2}, r"decision_every lacks the teams \['evaders'\]"),
        ({"chaser": 2, "evaders": 1}, "in decision_every: 'chaser': did you mean 'chasers'"),
        ({"chasers": 0, "evaders": 1}, "decision_every of team 'chasers' is 0"),
        ({"chasers": 1.5, "evaders": 1}, "decision_every of team 'chasers' is 1.5"),
    ],
)
def test_impossible_rates_raise_errors(rates, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("pursuit_evasion", 1, {"decision_every": rates})
