"""Options of assignment and interference, and what infos tell of servers."""

import numpy as np
import pytest
from edge_users import BAND, NOISE, STAY, friis, shannon
from placing import OPEN, fly

from bulletuav.network.access import ACCESS, uplink_rates
from bulletuav.network.assignment import dtlcm_score


@pytest.mark.parametrize(
    ("weight", "expected"), [(0.0, 0.5), (0.7, 0.85 * 0.7 + 0.3 / 2), (1, 0.85)]
)
def test_scores_weigh_distance_against_ability(weight, expected):
    """150 m: nearness 0.85; half of the cycles that a task needs: ability 0.5."""
    assert dtlcm_score(150.0, 1e9, 2e9, 0.0, weight) == pytest.approx(expected)


def test_users_follow_distance_or_load_by_its_weight(put):
    """The nearer drone is loaded: with little weight of distance the user leaves it."""
    servers = []
    for weight in (0.0, 1.0):
        aviary = put(
            "mec",
            OPEN,
            [(0, 0, 30), (95, 0, 30)],
            [(0, 9, 1.5)],
            assignment="dtlcm",
            distance_weight=weight,
            arrival_rate=20.0,
        )
        aviary.scene.memory["utilisation"][0, 0] = 0.5
        fly(aviary, STAY)
        completed = aviary.scene.memory["completed"][0]
        assert completed.min() == 0 < completed.max()
        servers.append(int(completed.argmax()))
    assert servers == [1, 0]


def rate(access, activity):
    """Rate of the first of two users of one drone each, at 100 m and 200 m to the other's."""
    power = np.array([[[friis(100.0), friis(200.0)], [friis(200.0), friis(100.0)]]])
    servers = np.array([[0, 1]])
    return uplink_rates(power, servers, BAND, NOISE, ACCESS[access], activity)[0, 0]


@pytest.mark.parametrize("activity", [0.0, 0.1, 1.0])
def test_interference_is_heard_for_the_share_of_the_time_in_which_it_is_sent(activity):
    expected = shannon(friis(100.0) / (NOISE + activity * friis(200.0)))
    for access in ACCESS:
        assert rate(access, activity) == pytest.approx(expected)


def test_a_task_takes_the_activity_that_is_asked_for_or_that_of_its_load(put):
    """0.1 /s tasks of 1 s at most: a tenth of the time."""
    place, users = [(0, 0, 100), (300, 0, 100)], [(0, 0, 1.5), (300, 0, 1.5)]
    shares = []
    for activity in ("load", 0.1, 1.0, 0):
        aviary = put("mec", OPEN, place, users, arrival_rate=0.1, activity=activity, deadline=1.0)
        shares.append(aviary.task.service._activity)
    assert shares == [pytest.approx(0.1), 0.1, 1.0, 0.0]


def test_infos_tell_what_was_dropped_and_how_busy_cores_were(put):
    aviary = put("mec", OPEN, [(0, 0, 30), (90, 0, 30)], [(0, 9, 1.5)], 2, arrival_rate=40.0)
    first = aviary.first_info()
    assert (first["dropped"] == 0).all()
    assert (first["utilisation"] == 0).all()
    memory = aviary.scene.memory
    for _ in range(20):
        step = fly(aviary, STAY)
        lost = memory["generated"] - memory["finished"]
        np.testing.assert_array_equal(step.info["dropped"], np.tile(lost[:, None], 2))
        np.testing.assert_array_equal(step.info["utilisation"], memory["utilisation"])
        np.testing.assert_array_equal(step.info["dwell_time"], memory["mean_dwell_time"])
    assert (step.info["dropped"] > 0).all()
    assert (step.info["utilisation"][:, 0] > 0.5).all()
    assert (step.info["utilisation"][:, 1] == 0).all()
    assert (step.info["dwell_time"] == 20).all()
