"""What teams earn, and whether their tasks pay them for what is wanted."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.incentives import assign_roles, incentives

POINTS = {"dynamics": "single_integrator", "difficulty": "easy"}
TEAMS = tuple(f"team_{k}_{name}" for name in ("return", "success") for k in (0, 1))


def test_returns_of_teams_are_means_of_their_drones():
    options = {**POINTS, "num_drones": 4, "teams": (3, 1)}
    result = bulletuav.evaluate("pursuit_evasion", "lead vs flee", 3, metrics=TEAMS, **options)
    for row in result.rows:
        first, second = row["team_0_return"], row["team_1_return"]
        assert (3 * first + second) / 4 == pytest.approx(row["return"])
        assert first > 0 > second
        share = (3 * row["team_0_success"] + row["team_1_success"]) / 4
        assert share == row["drone_success"] == 0.75
    alone = bulletuav.evaluate("converge", "straight", 1, metrics=TEAMS, **POINTS)
    assert alone.rows[0]["team_0_return"] == pytest.approx(alone.rows[0]["return"])
    assert np.isnan(alone.rows[0]["team_1_return"])
    assert alone.rows[0]["team_1_success"] == 0


def test_chasers_that_shirk_earn_less_than_the_baseline():
    found = list(incentives("pursuit_evasion", episodes=3, **POINTS))
    roles = {one.policy: one.role for one in found[1:]}
    assert roles == assign_roles("pursuit_evasion", "lead vs flee_weighted")
    assert "straight" not in roles
    assert "oracle" not in roles.values()
    assert found[0].policy == "lead vs flee_weighted"
    assert found[0].success.mean == 1
    assert not [one for one in found if one.fault]
    assert found[1].earned.mean < 0 < found[0].earned.mean
