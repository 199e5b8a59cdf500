"""Tasks pay for what they want; `bulletuav.analysis.incentives` tells where they do not."""

from typing import ClassVar

import numpy as np
import pytest

from bulletuav import cli
from bulletuav.analysis.incentives import DEGENERATE_POLICIES, incentives, list_degenerate_policies
from bulletuav.tasks.converge import Converge

POINTS = {"dynamics": "single_integrator"}
CASES = ["converge", "pursuit", "formation", "hover", "los", "race"]


@pytest.mark.parametrize("task", CASES)
def test_no_shirker_earns_what_the_baseline_does(task):
    found = list(incentives(task, episodes=3, difficulty="easy", **POINTS))
    assert [one.degenerate_policy for one in found] == list_degenerate_policies(
        task, found[0].baseline
    )
    assert found[0].degenerate_policy == "stay"
    assert found[0].lead > 0
    for one in found:
        assert one.return_difference.low > 0.1 * one.lead, one
        assert one.holds


def test_a_reward_for_nothing_is_found_out():
    """A task that pays for being there, and not for arriving, is told of."""

    class Idle(Converge):
        reward: ClassVar = {**Converge.reward, "alive": 10.0, "time": 0.0}

    found = {one.degenerate_policy: one for one in incentives(Idle, episodes=2, **POINTS)}
    assert not found["stay"].holds
    assert found["stay"].lead < 0


def test_death_never_saves_time():
    """Whoever crashes at once pays the time of the whole episode, as whoever stays."""
    found = {
        one.degenerate_policy: one
        for one in incentives("converge", episodes=2, weights={"collision": 0.0}, **POINTS)
    }
    assert found["dive"].degenerate_return.mean <= found["stay"].degenerate_return.mean + 50.0


def test_clump_is_for_tasks_with_targets():
    assert "clump" in list_degenerate_policies("los", "oracle")
    assert "clump" not in list_degenerate_policies("hover", "straight")
    assert list_degenerate_policies("follow", "straight") == [
        name for name in DEGENERATE_POLICIES if name not in ("straight", "clump")
    ]


def test_the_command_writes_the_table(tmp_path, capsys):
    arguments = ["hover", "--difficulties", "easy", "--episodes", "2", "--out", str(tmp_path)]
    cli.main(["incentives", *arguments, "--dynamics", "single_integrator"])
    rows = (tmp_path / "all.md").read_text().splitlines()
    assert len(rows) == 4 + len(list_degenerate_policies("hover", "straight"))
    worst = (tmp_path / "incentives.md").read_text().splitlines()
    assert len(worst) == 5
    assert worst[4] in rows
    shares = [float(row.split("|")[9]) for row in rows[4:]]
    assert float(worst[4].split("|")[9]) == min(shares)
    assert "yes" in capsys.readouterr().out
    assert np.isfinite(shares).all()
