"""One policy for each team."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.policies.versus import joint_actions, joint_options

POINTS = {"dynamics": "single_integrator", "difficulty": "easy"}


def east(rows):
    """Fly east."""
    return np.tile((1.0, 0.0, 0.0), (len(rows), 1))


@pytest.fixture
def aviary():
    one = bulletuav.Aviary("pursuit_evasion", 2, **POINTS)
    one.reset(seeds=0)
    yield one
    one.close()


def acted(source, aviary):
    """Actions of a policy after the first reset."""
    policy = find_policy(source)(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(2, dtype=bool))
    return policy.act(observations, aviary.swarm)


@pytest.mark.parametrize(
    "source",
    [
        "lead vs flee",
        bulletuav.Versus(chasers="lead", evaders="flee"),
        bulletuav.Versus(evaders="flee", chasers="lead"),
    ],
    ids=str,
)
def test_each_team_flies_as_its_own_policy_does(source, aviary):
    actions = acted(source, aviary)
    np.testing.assert_array_equal(actions[:, :3], acted("lead", aviary)[:, :3])
    np.testing.assert_array_equal(actions[:, 3], acted("flee", aviary)[:, 3])


def test_a_function_of_rows_is_a_policy(aviary):
    versus = bulletuav.Versus(chasers=east, evaders="flee")
    actions = acted(versus, aviary)
    assert (actions[:, :3] == (1, 0, 0)).all()
    np.testing.assert_array_equal(actions[:, 3], acted("flee", aviary)[:, 3])
    spec = find_policy(versus)
    assert (spec.name, spec.reads_swarm) == ("east vs flee", True)
    assert (find_policy(east).name, find_policy(east).reads_swarm) == ("east", False)
    assert repr(bulletuav.Versus(a="x", b="y")) == "Versus(a='x', b='y')"


def test_a_function_that_gives_other_rows_is_refused(aviary):
    with pytest.raises(
        ValueError, match=r"returned an array \(3,\) of actions: \(8, 3\) is needed"
    ):
        acted(lambda rows: rows[0, :3], aviary)


def test_versus_is_evaluated():
    versus = bulletuav.Versus(chasers="lead", evaders=east)
    result = bulletuav.evaluate("pursuit_evasion", versus, 3, **POINTS)
    assert result.about["policy"] == "lead vs east"
    assert result.estimates()["captured"].mean == 1


def test_wrong_sides_are_refused(aviary):
    with pytest.raises(ValueError, match="Versus has .*: policies for at least two teams"):
        bulletuav.Versus(chasers="lead")
    with pytest.raises(ValueError, match="unknown policy 'leed'"):
        find_policy("leed vs flee")
    with pytest.raises(ValueError, match="unknown team of task 'pursuit_evasion': 'chaser'"):
        find_policy(bulletuav.Versus(chaser="lead", evaders="flee"))(aviary)
    with pytest.raises(
        ValueError, match="there are policies for 3 teams, and .* has chasers, evad"
    ):
        find_policy("lead vs flee vs flee")(aviary)
    with pytest.raises(ValueError, match="a function, or a Versus is needed"):
        find_policy(3)


def test_actions_and_options_of_sides_must_agree():
    assert joint_actions([(), ()]) == ()
    assert joint_actions([(), ("rpm",)]) == ("rpm",)
    assert joint_actions([("a", "b"), ("b", "a"), ()]) == ("a", "b")
    with pytest.raises(ValueError, match="none is common"):
        joint_actions([("a",), ("b",)])
    assert joint_options([{"x": 1}, {}, {"x": 1, "y": 2}]) == {"x": 1, "y": 2}
    with pytest.raises(ValueError, match="trained with x 1 and 2"):
        joint_options([{"x": 1}, {"x": 2}])


def write_run(folder, action):
    """Write the folder of a run whose network chooses among velocities, not trained."""
    from bulletuav.adapters.sb3 import DroneVecEnv
    from bulletuav.training import checkpoint
    from bulletuav.training.models import make_model

    options = {**POINTS, "action": action}
    config = RunConfig("pursuit_evasion", "dqn", options=options, worlds=1)
    env = DroneVecEnv("pursuit_evasion", 1, **options)
    folder.mkdir()
    checkpoint.save_checkpoint(make_model(config, env), folder)
    env.close()
    (folder / "run.yaml").write_text(config.text())
    return folder


@pytest.fixture
def chooser(tmp_path):
    return write_run(tmp_path / "run", "discrete")


@pytest.mark.parametrize("climb", [None, 0.5])
def test_who_chose_velocities_asks_for_them(chooser, climb):
    """The same velocities where they are asked for as where they are chosen, to the last digits."""
    assert find_policy(chooser).actions == ("discrete", "velocity")
    asked = {}
    for action in ("discrete", "velocity"):
        options = {**POINTS, "action": action, "max_climb": climb, "area": 100.0}
        one = bulletuav.Aviary("pursuit_evasion", 20, **options)
        policy, observations = find_policy(chooser)(one), one.reset(seeds=0)
        asked[action] = one.action.decode(policy.act(observations, one.swarm), one.commanded)
        one.close()
    np.testing.assert_allclose(asked["velocity"], asked["discrete"], atol=1e-12)
    assert len(np.unique(asked["discrete"].reshape(-1, 4), axis=0)) > 3  # not one choice alone


def test_who_chose_velocities_meets_who_asks_for_them(chooser):
    spec = find_policy(f"{chooser} vs flee")
    needed = spec.complete("pursuit_evasion", POINTS)
    assert (spec.actions, needed["action"]) == (("velocity",), "velocity")
    one = bulletuav.Aviary("pursuit_evasion", 2, **needed)
    joint, alone = acted(f"{chooser} vs flee", one), acted(chooser, one)
    np.testing.assert_array_equal(joint[:, :3], alone[:, :3])
    np.testing.assert_array_equal(joint[:, 3], acted("flee", one)[:, 3])
    one.close()
    # Where both sides chose, both choose
    both = find_policy(f"{chooser} vs {chooser}")
    assert both.complete("pursuit_evasion", POINTS)["action"] == "discrete"


def test_who_chose_among_others_flies_by_a_common_action(chooser, tmp_path):
    other = write_run(tmp_path / "other", "discrete_27")
    spec = find_policy(f"{chooser} vs {other}")
    assert (spec.actions, spec.options["action"]) == (("velocity",), "velocity")
