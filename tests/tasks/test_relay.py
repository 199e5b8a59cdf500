"""Relays succeed only with a contribution of their own."""

import numpy as np
import pytest
from urban import DRONES, TOWER, USERS

import bulletuav
from bulletuav.network.dwell_time import compute_steady_service
from bulletuav.tasks.parts.relay import add_contributions


def test_only_users_that_no_other_drone_sees_are_a_contribution():
    sight = np.zeros((1, 3, 5), dtype=bool)
    sight[0, 0, :3] = sight[0, 1, 2:4] = sight[0, 2] = True
    contribution = np.full((1, 3), 1.0)
    add_contributions(sight, np.array([[True, True, False]]), contribution)
    # Users 0 and 1, and user 3: the third drone has left
    np.testing.assert_allclose(contribution, [[1.4, 1.2, 1.0]])


@pytest.mark.parametrize("task", ["los", "mobile_users"])
@pytest.mark.parametrize(
    ("needed", "success"), [(0.0, [True, True]), (0.2, [True, True]), (0.21, [True, False])]
)
def test_each_drone_has_to_contribute(put_urban, task, needed, success):
    """Of 5 users both drones see the third; only the first sees two, only the second sees one."""
    options = {"users": USERS, "wanted": 0.8, "horizon": 4, "min_contribution": needed}
    aviary = put_urban(task, TOWER, DRONES, mobility="still", **options)
    for decisions in range(1, 5):
        step = aviary.step(np.zeros((1, 2, 3)))
        means = np.array((0.4, 0.2)) * decisions / 4
        np.testing.assert_allclose(step.info["contribution"][0], means)
        assert step.info["success"][0].tolist() == (success if decisions == 4 else [False] * 2)


@pytest.mark.parametrize("value", [-0.1, 1.1])
def test_impossible_contributions_raise(value):
    with pytest.raises(ValueError, match="min_contribution is"):
        bulletuav.Aviary("los", min_contribution=value)


def test_steady_service_saturates_user_by_user():
    """(tanh(1) + tanh(2) + 0) / 3 = 0.5752073: a user in sight for 100 s makes up for no other."""
    dwell_time = np.array([[[10.0, 0.0, 0.0], [5.0, 20.0, 0.0]]])
    np.testing.assert_allclose(compute_steady_service(dwell_time), [[0.5752073] * 2], atol=1e-7)
    dwell_time[0, 0, 0] = 100.0
    np.testing.assert_allclose(compute_steady_service(dwell_time), [[0.6546759] * 2], atol=1e-7)
