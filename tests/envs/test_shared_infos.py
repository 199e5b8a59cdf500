"""Infos that processes share come out as they went in; what does not fit is left to be sent."""

import numpy as np
import pytest

from bulletuav.envs.infos import InfoTable, lazy_infos
from bulletuav.envs.shared_infos import SharedInfos

PARTS = [slice(0, 2), slice(2, 3)]
FIRST = {
    "reward/goal": np.zeros((3, 4)),
    "success": np.zeros((3, 4), dtype=bool),
    "conflicts": np.zeros((3, 4), dtype=np.int64),
}


def sides(first=FIRST, room=5):
    """The asking side, and those of two processes, after a reset."""
    array = np.zeros((3, room, 4))
    asking, *working = (SharedInfos(array), *(SharedInfos(array[part]) for part in PARTS))
    asking.set_types(first)
    for one, part in zip(working, PARTS, strict=True):
        one.set_types({name: value[part] for name, value in first.items()})
    return asking, working


def infos_of(rng):
    return {
        "reward/goal": rng.normal(size=(3, 4)),
        "success": rng.random((3, 4)) < 0.5,
        "conflicts": rng.integers(0, 2**53, (3, 4)),
    }


def write(working, infos):
    return [
        one.write({name: value[part] for name, value in infos.items()})
        for one, part in zip(working, PARTS, strict=True)
    ]


def test_they_come_out_as_they_went_in_and_stay():
    asking, working = sides()
    rng = np.random.default_rng(0)
    steps = [infos_of(rng) for _ in range(2)]
    taken = []
    for infos in steps:
        assert write(working, infos) == [True, True]
        taken.append(asking.read([None, None], PARTS))
    for infos, out in zip(steps, taken, strict=True):
        assert list(out) == list(infos)
        for name, value in infos.items():
            np.testing.assert_array_equal(out[name], value)
            assert out[name].dtype == value.dtype


def test_a_process_with_more_to_tell_sends_all_of_it():
    asking, working = sides()
    infos = infos_of(np.random.default_rng(1))
    write(working, infos)
    sent = {name: value[PARTS[1]] for name, value in infos.items()} | {"final": np.ones((1, 4))}
    assert not working[1].write(sent)
    out = asking.read([None, sent], PARTS)
    for name, value in infos.items():
        np.testing.assert_array_equal(out[name], value)
    np.testing.assert_array_equal(out["final"], [[0] * 4, [0] * 4, [1] * 4])


@pytest.mark.parametrize(
    "changed",
    [
        {"success": np.zeros((3, 4))},
        {"conflicts": np.full((3, 4), 2**53 + 1)},
        {"conflicts": np.full((3, 4), -(2**60))},
        {"more": np.zeros((3, 4))},
    ],
)
def test_a_step_unlike_the_reset_is_not_put(changed):
    _, working = sides()
    assert write(working, FIRST | changed) == [False, False]


@pytest.mark.parametrize(
    "first",
    [
        FIRST | {"wide": np.zeros((3, 4, 2))},
        FIRST | {"single": np.zeros((3, 4), dtype=np.float32)},
        FIRST | {"text": np.full((3, 4), "a")},
        {f"info {k}": np.zeros((3, 4)) for k in range(6)},
    ],
)
def test_nothing_is_put_where_not_all_have_room(first):
    _, working = sides(first)
    assert write(working, first) == [False, False]


def test_nothing_is_put_before_a_reset():
    assert not SharedInfos(np.zeros((3, 5, 4))).write(FIRST)


def reported(rng, rows):
    """What a decision of three worlds told, of which nobody has asked for infos."""
    table = rng.integers(0, 2, (len(rows), 3, 4)).astype(float)
    more = {"dwell_time": rng.normal(size=(3, 4))}
    more["dwell_time"].flags.writeable = False
    return InfoTable(table, rows, more)


@pytest.mark.parametrize("name", [None, "goal_distance"])
def test_a_table_of_a_decision_goes_as_the_infos_that_are_made_of_it(name):
    rows = [("reward/goal", float), (name, float), ("success", bool), ("conflicts", np.int64)]
    decision = reported(np.random.default_rng(3), rows)
    infos = lazy_infos(decision)
    shared = SharedInfos(np.zeros((3, 5, 4)))
    shared.set_types(decision())
    assert shared.write(infos)
    assert infos._make is decision  # nobody had to make them
    out = shared.read([None], [slice(0, 3)])
    assert list(out) == list(infos)
    for key, value in infos.items():
        np.testing.assert_array_equal(out[key], value)
        assert out[key].dtype == value.dtype
    # What infos tell can be written into, though the decision's own array cannot
    infos["dwell_time"][:] = 0.0
    assert decision.more["dwell_time"].any()
    assert not shared.write(lazy_infos(reported(np.random.default_rng(4), rows[::-1])))
