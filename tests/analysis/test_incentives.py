"""Tasks pay for what they want; `bulletuav.analysis.incentives` finds those that do not."""

from typing import ClassVar

import numpy as np
import pytest

from bulletuav import cli
from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.incentives import (
    BLIND_POLICIES,
    DEGENERATE_POLICIES,
    Incentive,
    assign_roles,
    find_reversals,
    incentives,
)
from bulletuav.analysis.metrics import Estimate
from bulletuav.commands.incentives import select_worst
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.converge import Converge

POINTS = {"dynamics": "single_integrator"}
CASES = ["converge", "hover", "los"]
OWN = {
    "pad_landing": {"dynamics": "rigid_body", "camera_hz": 10, "camera_size": (48, 48)},
    "transport": {"dynamics": "rigid_body"},
}
"""Options of tasks that need bodies to be done, and cheaper pictures"""
SERVICES = ("los", "mobile_users", "mec", "mec_advanced")


def exactly(value):
    return Estimate(value, value, value, 20)


def make_incentive(role="shirker", success=0.0, gap=50.0, success_gap=0.9, **changes):
    values = {
        "task": "converge",
        "difficulty": "easy",
        "policy": "some",
        "role": role,
        "success": exactly(success),
        "earned": exactly(100.0 - gap),
        "success_gap": exactly(success_gap),
        "gap": exactly(gap),
        "lead": 100.0,
        "is_game": False,
        "conditions": Conditions("converge", "easy", "point_mass", 20, 0),
    }
    return Incentive(**{**values, **changes})


@pytest.mark.parametrize("task", CASES)
def test_the_easy_difficulty_can_be_done_and_not_be_gamed(task):
    found = list(incentives(task, episodes=3, difficulty="easy", **POINTS))
    roles = {one.policy: one.role for one in found[1:]}
    assert roles == assign_roles(task, find_task(task).baseline)
    assert found[0].role == "baseline"
    assert not [one for one in found if one.fault]


@pytest.mark.slow
@pytest.mark.parametrize("task", list_tasks())
def test_every_difficulty_can_be_done_and_not_be_gamed(task):
    dynamics = "single_integrator" if task in SERVICES else "point_mass"
    found = []
    for difficulty in find_task(task).difficulties:
        episodes = 5 if difficulty == "extreme" else 10
        options = {"difficulty": difficulty, "dynamics": dynamics, **OWN.get(task, {})}
        found += incentives(task, None, episodes, **options)
    faults = [f"{one.difficulty}, {one.policy}: {one.fault}" for one in found if one.fault]
    assert not [*faults, *find_reversals(found)]


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"lead": 0.0}, "staying earns as much as the baseline"),
        ({"gap": 10.0}, "pays to avoid the task"),
        ({"gap": 10.1}, ""),
        # As successful as the baseline, it does the task
        ({"gap": 1.0, "success": 0.9, "success_gap": 0.0}, ""),
        # Both fail
        ({"gap": 1.0, "success": 0.0, "success_gap": 0.0}, "pays to avoid the task"),
        ({"role": "oracle", "success": 0.9, "gap": 0.0}, ""),
        ({"role": "oracle", "success": 0.89, "gap": 0.0}, "too hard"),
        ({"role": "oracle", "success": 0.5, "gap": 0.0, "is_game": True}, ""),
        ({"role": "blind", "success": 0.1}, ""),
        ({"role": "blind", "success": 0.11}, "done blindly"),
        ({"role": "blind", "success": 0.11, "is_game": True}, ""),
        ({"role": "blind", "gap": 5.0}, "pays to avoid the task"),
        ({"role": "other", "gap": -1.0}, "pays more for less success"),
        ({"role": "other", "gap": 1.0}, ""),
        ({"role": "other", "gap": -1.0, "success_gap": -0.1}, ""),
    ],
)
def test_faults(changes, fault):
    assert make_incentive(**changes).fault == fault


def test_a_harder_difficulty_is_not_easier():
    levels = {"easy": 1.0, "medium": 0.9, "hard": 0.95}
    found = [make_incentive("oracle", success, difficulty=name) for name, success in levels.items()]
    assert find_reversals(found) == [
        "converge: the oracle succeeds more often at hard (0.95) than at medium (0.90)"
    ]
    assert not find_reversals(found[:2])
    assert not find_reversals([one._replace(role="baseline") for one in found])
    wide = [one._replace(success=Estimate(one.success.mean, 0.0, 1.0, 20)) for one in found]
    assert not find_reversals(wide)


def test_a_reward_for_nothing_is_found():
    """A task that pays for being in flight, and not for arriving, has a fault."""

    class Idle(Converge):
        reward: ClassVar = {**Converge.reward, "alive": 10.0, "time": 0.0}

    found = {one.policy: one for one in incentives(Idle, episodes=2, **POINTS)}
    assert found["stay"].fault
    assert found["stay"].lead < 0


def test_an_early_end_saves_no_time():
    """Drones that crash pay the time of the whole episode, as those do that stay."""
    found = {
        one.policy: one
        for one in incentives("converge", episodes=2, weights={"collision": 0.0}, **POINTS)
    }
    assert found["dive"].earned.mean <= found["stay"].earned.mean + 50.0


def test_roles_of_policies():
    assert assign_roles("los", "oracle")["clump"] == "shirker"
    assert "clump" not in assign_roles("hover", "straight")
    roles = assign_roles("hover", "straight")
    oracle = find_task("hover").oracle or "straight"
    assert roles[oracle] == "oracle"
    assert [name for name, role in roles.items() if role == "blind"] == [*BLIND_POLICIES]
    shirkers = [name for name in DEGENERATE_POLICIES if name not in ("straight", "clump")]
    shirkers += find_task("hover").shirkers
    assert [name for name, role in roles.items() if role == "shirker"] == shirkers


@pytest.mark.parametrize("task", list_tasks())
def test_every_task_declares_shirkers_of_its_own(task):
    kind = find_task(task)
    assert len(kind.shirkers) >= 3
    for name in (*kind.shirkers, *([kind.oracle] if kind.oracle else [])):
        assert find_policy(name, task).name == name


def test_learned_policies_are_compared_too():
    *_, one = incentives("converge", None, 2, others=["mvp"], difficulty="easy", **POINTS)
    assert (one.policy, one.role, one.fault) == ("mvp", "other", "")


def test_the_command_writes_the_table(tmp_path, capsys):
    arguments = ["hover", "--difficulties", "easy", "--episodes", "2", "--out", str(tmp_path)]
    arguments += ["--others", "random"]
    cli.main(["incentives", *arguments, "--dynamics", "single_integrator"])
    rows = (tmp_path / "all.md").read_text().splitlines()[4:]
    assert len(rows) == 2 + len(assign_roles("hover", "straight"))
    worst = (tmp_path / "incentives.md").read_text().splitlines()[4:]
    assert [row.split("|")[4].strip() for row in worst] == [
        *("baseline", "oracle", "blind", "shirker", "other")
    ]
    assert set(worst) < set(rows)
    shares = [float(row.split("|")[8]) for row in rows if row.split("|")[4] == " shirker "]
    assert float(worst[3].split("|")[8]) == min(shares)
    assert np.isfinite(shares).all()
    assert capsys.readouterr().out.count(" yes |") == len(worst)


def test_the_table_shows_faults_first():
    held, fault = make_incentive(gap=20.0), make_incentive(gap=5.0, policy="worse")
    blind = make_incentive("blind", success=0.05), make_incentive("blind", success=0.2)
    assert select_worst([held, fault, *blind]) == [fault, blind[1]]


def test_the_command_names_faults(tmp_path, capsys):
    arguments = ["converge", "--difficulties", "easy", "--episodes", "2", "--out", str(tmp_path)]
    cli.main(["incentives", *arguments, "--dynamics", "single_integrator", "--policy", "circle"])
    assert "converge, easy, circle: too hard" in capsys.readouterr().out
