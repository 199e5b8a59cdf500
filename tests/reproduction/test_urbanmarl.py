import json
import math

import numpy as np
import pytest

from bulletuav.network.queueing import mean_response
from bulletuav.reproduction.table import Settings, record_outcome
from bulletuav.reproduction.tables.urbanmarl import REPRODUCTION
from bulletuav.reproduction.urban_states import HOVER, USERS, WALL, fly_over, steer_to
from bulletuav.reproduction.urbanmarl_models import their_gain
from bulletuav.reproduction.urbanmarl_offloading import measure_offloading, offloading

DEFECTS = {
    "collision with the ground",
    "position east with decisions of 0.1 s",
    "sight over a roof of 42 m",
    "observation: battery after 10 s of hover",
    "observation: battery after 1 s of 12 m/s",
    "observation: beam of 20 m / 60 m",
    "uav_ue_los, documented: the sum",
    "coverage: two near drones, second drone",
    "coverage: two near drones, third drone",
    "uav_navigation, 10 m nearer, documented",
    "drones that an empty battery of one of three ends",
    "gain 50 m below, straight below",
    "gain 50 m below, 0.5 m east",
    "gain 50 m below, 0.5 m west",
    "gain 50 m below, 0.5 m north",
    "response, 15.9/s",
    "power of busy cores",
    "power at 49 m/s",
    "power of a climb at 2 m/s",
    "power of a descent at 12 m/s",
    "user after a second, east, as coded",
    "built-up fraction, as generated",
}


@pytest.fixture(scope="module")
def outcome():
    return REPRODUCTION.compute(Settings(size=0.01))


def test_rows_differ_where_theirs_are_wrong_and_only_there(outcome):
    verdicts = {row.name: row.verdict for row in outcome.rows}
    assert len(verdicts) == len(outcome.rows) == 73
    assert {name for name, verdict in verdicts.items() if verdict == "explained"} == DEFECTS
    assert set(verdicts.values()) == {"within", "explained"}


def test_record_is_plain_json(outcome):
    record = record_outcome("urbanmarl", REPRODUCTION, outcome, 0.01)
    json.dumps([row["ours"] for row in record["rows"]], allow_nan=False)


def test_pictures_show_exact_ranges_of_ours(outcome):
    errors = outcome.figure.axes[0].lines
    assert np.abs(errors[1].get_ydata()).max() < 1e-5
    assert 1.0 < np.abs(errors[0].get_ydata()).max() <= 2.0


@pytest.mark.parametrize(
    ("user", "gain"),
    [((0.5, 0.0), 14.9990677), ((-0.5, 0.0), -15.0), ((0.0, 0.5), -8.0068495)],
)
def test_gain_of_theirs(user, gain):
    """Numbers of `compute_3d_antenna_gain` in version 0.3.1."""
    assert their_gain(*user, -50.0) == pytest.approx(gain, abs=1e-6)


def test_hidden_users_are_not_completed_by_the_offloading_term():
    drones = [(0, 0, 100), (60, 0, 100)]
    term = {"offloading": (offloading, 1.0)}
    flown = fly_over("mec", [WALL], drones, USERS, reward=term)
    # The last two users are nearer to the first drone, and behind the wall
    service = measure_offloading(flown.aviary.current_frame())
    assert service.assigned[0].tolist() == [0.4, 0.2]
    assert (service.completed <= service.assigned).all()
    expected = mean_response(4, np.array([[2.0, 1.0]]), 4.0)
    np.testing.assert_allclose(service.response, expected, rtol=1e-12)


@pytest.mark.parametrize("heading", [-150.0, -90.0, 0.0, 60.0, 180.0])
def test_motion_turns_with_the_heading(heading):
    moved = fly_over("los", [], [(0, 0, 100)], USERS, actions=steer_to(15.0, heading, -4.0))
    angle = math.radians(heading)
    expected = (15 * math.cos(angle), 15 * math.sin(angle), 96.0)
    assert moved.position[0] == pytest.approx(expected, abs=1e-9)


def test_wall_hides_users_on_its_other_side_alone():
    drones = [(0, 0, 100), (-150, 0, 100)]
    seen = fly_over("los", [WALL], drones, USERS).aviary.sight[0]
    assert seen.tolist() == [[True] * 3 + [False] * 2, [False] * 3 + [True] * 2]


def test_drone_that_hovers_stays():
    assert fly_over("los", [], [(1, 2, 50)], USERS, actions=HOVER).position.tolist() == [[1, 2, 50]]


def test_start_that_is_not_finite_is_rejected():
    with pytest.raises(ValueError, match="finite"):
        fly_over("los", [WALL], [(0, 0, math.nan)], USERS)


def test_users_without_height_are_rejected():
    with pytest.raises(ValueError, match="users"):
        fly_over("los", [WALL], [(0, 0, 100)], [(10, 10)])


def test_unknown_task_is_rejected():
    with pytest.raises(ValueError, match="uav_ue_los"):
        fly_over("uav_ue_los", [], [(0, 0, 50)], USERS)
