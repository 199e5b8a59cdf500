import numpy as np
import pytest

from bulletuav.reproduction.conflict_states import APART, CENTRE, MEETING, ConflictState, fly_state
from bulletuav.reproduction.hand_made import compare_number
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables.uavconflictgym import REPRODUCTION

DEFECTS = {
    "velocity north at the limit",
    "numbers of an observation, as declared",
    "progress, by its code",
    "energy of the other drone",
    "goal in the second decision",
    "warning at 4 m",
    "conflict and warning of a fast pass",
    "drones whose episode ends when all are at goals",
    "decisions of an episode with max_steps 3",
}


@pytest.fixture(scope="module")
def outcome():
    return REPRODUCTION.compute(Settings(size=0.05))


def test_rows_differ_where_theirs_are_wrong_and_only_there(outcome):
    verdicts = {row.name: row.verdict for row in outcome.rows}
    assert len(verdicts) == len(outcome.rows) == 41
    assert {name for name, verdict in verdicts.items() if verdict == "explained"} == DEFECTS
    assert set(verdicts.values()) == {"within", "explained"}
    assert outcome.notes


def test_starts_have_intervals(outcome):
    drawn = {row.name: row for row in outcome.rows if row.low is not None}
    assert len(drawn) == 3
    assert all(row.low < row.ours < row.high for row in drawn.values())


def test_same_numbers_again(outcome):
    again = REPRODUCTION.compute(Settings(size=0.05))
    assert list(again.rows) == list(outcome.rows)


@pytest.mark.parametrize(
    ("theirs", "difference", "verdict"),
    [(0.0, 9e-7, "within"), (-290.0, 2e-4, "within"), (-290.0, 4e-4, "outside")],
)
def test_single_precision_is_no_difference(theirs, difference, verdict):
    assert compare_number("x", theirs + difference, theirs).verdict == verdict


def test_step_of_a_turned_world_is_the_turned_step():
    # A quarter turn about the vertical: (x, y) -> (-y, x)
    turn = np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1)])
    action = np.array([(0.5, -0.25, 0.125), (0.25, 0.5, -1.0)])
    turned = ConflictState(*(np.array(one) @ turn for one in APART))
    one = fly_state(APART, actions=action)
    other = fly_state(turned, actions=action @ turn)
    assert other.position - CENTRE == pytest.approx((one.position - CENTRE) @ turn, abs=1e-12)
    assert other.velocity == pytest.approx(one.velocity @ turn, abs=1e-12)
    assert other.rewards == pytest.approx(one.rewards, abs=1e-9)


def test_conflict_costs_the_drones_of_the_pair_alone():
    conflict = fly_state(MEETING).term("conflict")
    assert conflict.tolist() == [-200.0, -200.0, 0.0]


def test_state_outside_of_the_cube_is_rejected():
    with pytest.raises(ValueError, match="start"):
        fly_state(APART._replace(position=[(0, 0, -130), (60, 0, 0)]))


def test_state_that_is_not_finite_is_rejected():
    with pytest.raises(ValueError, match="finite"):
        fly_state(APART._replace(position=[(np.nan, 0, 0), (60, 0, 0)]))
