"""The default action of every task in every dynamics."""

import numpy as np
import pytest

import bulletuav
from bulletuav.control.actions import ACTIONS, LEVEL_ACTIONS, ActionContext, make_action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS, find_dynamics
from bulletuav.dynamics.base import Dynamics
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.tasks import find_task


class Placed(Dynamics):
    """Drones are where their setpoint is."""

    consumes = SetpointLevel.POSITION

    def advance_substep(self, swarm, alive, setpoint, air):
        swarm.position[:] = setpoint[..., :3]


class Turned(Placed):
    """Level in the middle of the ladder; only looked at."""

    consumes = SetpointLevel.RATES


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_every_task_can_be_made_in_every_dynamics(task):
    usual = EnvSpec(task, 1, {}).action
    every = ("rigid_body",) if find_task(task).needs_cables else (*DYNAMICS, Placed)
    for dynamics in every:
        consumes = find_dynamics(dynamics).consumes
        action = EnvSpec(task, 1, {"dynamics": dynamics}).action
        if usual.level <= consumes:
            assert action.name == usual.name
        else:
            assert action.name == LEVEL_ACTIONS[consumes]
            assert action.level == consumes


@pytest.mark.parametrize(
    ("dynamics", "action"),
    [
        ("single_integrator", "velocity"),
        ("double_integrator", "acceleration"),
        ("point_mass", "velocity"),
        ("rigid_body", "rotor"),
        (Turned, "rates"),
        (Placed, "target_position"),
    ],
)
def test_the_action_of_hover_is_the_highest_that_the_dynamics_takes(dynamics, action):
    for options in ({}, {"preset": "hover_aviary"}):
        found = resolve_options(
            find_task("hover"), {"dynamics": dynamics, **options}
        ).options.action
        kept = options and action == "rotor"
        assert found == ("hover_rpm" if kept else action)


def test_an_environment_flies_by_the_default_action_of_its_dynamics():
    env = bulletuav.parallel_env("hover", dynamics="double_integrator", horizon=3)
    env.reset(seed=0)
    assert env.aviary.options.action == "acceleration"
    assert env.action_space("drone_0").shape == (3,)
    env.step({"drone_0": np.zeros(3)})
    env.close()


def test_an_action_that_the_user_chose_is_kept_or_refused():
    fly = {"dynamics": "point_mass", "action": "rotor"}
    with pytest.raises(
        ValueError, match="'rotor' gives rotor setpoints, but dynamics 'point_mass'"
    ):
        EnvSpec("hover", 1, fly)
    chosen = EnvSpec("hover", 1, {"dynamics": "point_mass", "action": "target_position"})
    assert chosen.action.name == "target_position"


@pytest.mark.parametrize("name", ACTIONS)
def test_the_level_of_an_action_depends_on_no_speed_or_place(name):
    airframes = (bulletuav.load_airframe("cf2x"), bulletuav.load_airframe("iris"))
    near = ActionContext(airframes, 1.0, 1.0, -np.ones(3), np.ones(3), 1.0, 1.0)
    far = ActionContext(airframes, 9.0, 2.0, np.zeros(3), 1e3 * np.ones(3), 0.1, 9.81)
    assert make_action(name, near).level == make_action(name, far).level


def test_every_level_has_an_action_of_that_level():
    context = ActionContext(
        (bulletuav.load_airframe("cf2x"),), 1.0, 1.0, -np.ones(3), np.ones(3), 1.0, 1.0
    )
    for level in SetpointLevel:
        assert make_action(LEVEL_ACTIONS[level], context).level == level


def test_policies_fly_by_an_action_that_the_dynamics_takes():
    assert find_policy("straight").complete("hover", {"dynamics": "point_mass"}) == {
        "dynamics": "point_mass"
    }
    # The first action of this policy is beyond the dynamics
    placed = find_policy("straight").complete("hover", {"dynamics": Placed})
    assert EnvSpec("hover", 1, placed).action.name == "target_position"


def test_a_policy_whose_actions_the_dynamics_cannot_take_is_refused():
    with pytest.raises(ValueError, match="policy 'trained' supports rates actions, which dynamics"):
        find_policy("trained", "hover").complete("hover", {"dynamics": "point_mass"})


def test_a_run_learns_the_default_action_of_its_dynamics():
    run = RunConfig("hover", options={"dynamics": "point_mass"})
    assert run.action == "velocity"
    assert run.interface["action"] == "velocity"
