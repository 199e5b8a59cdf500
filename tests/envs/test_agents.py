"""Dictionaries of agents: in C and in Python the same; the unusual is left to a closer look."""

import gc
import sys

import numpy as np
import pytest

from bulletuav.envs import agents as in_use
from bulletuav.envs.agents import share_plainly, take_one_plainly, take_plainly

NAMES = ["drone_0", "drone_1", "drone_2"]
SEEN, TOLD = np.zeros((1, 3, 2)), (np.zeros((1, 3)), *np.zeros((2, 1, 3), bool))
BOTH = pytest.mark.parametrize(
    ("take", "share"), [(take_plainly, share_plainly), (in_use.take, in_use.share)]
)


def test_the_extension_is_in_use_where_it_was_built():
    built = "bulletuav.envs._agents" in sys.modules
    assert (in_use.take is not take_plainly) == built
    assert (in_use.share is not share_plainly) == built


@BOTH
@pytest.mark.parametrize("dtype", ["f8", "f4", "i8", "i4"])
def test_actions_go_to_the_rows_of_their_agents(take, share, dtype):
    rows = np.arange(6).reshape(3, 2).astype(dtype)
    given = np.full((1, 3, 2), -1.0)
    # In any order, and of those who are still there
    assert take({name: rows[i] for i, name in reversed(list(enumerate(NAMES)))}, NAMES, None, given)
    np.testing.assert_array_equal(given[0], rows)
    given[:] = -1
    assert take({"drone_2": rows[2], "drone_1": rows[1]}, ["drone_1", "drone_2"], [1, 2], given)
    np.testing.assert_array_equal(given[0], [(-1, -1), *rows[1:]])
    assert take({}, [], [], given)


@BOTH
@pytest.mark.parametrize(
    "wrong",
    [
        {"drone_0": np.zeros(2), "drone_1": np.zeros(2)},  # one is missing
        {"drone_0": np.zeros(2), "drone_1": np.zeros(2), "drone_9": np.zeros(2)},
        {**dict.fromkeys(NAMES, np.zeros(2)), "drone_9": np.zeros(2)},
        {name: np.zeros(3) for name in NAMES},
        {name: np.zeros((1, 2)) for name in NAMES},
        {name: [0.0, 0.0] for name in NAMES},
        {name: np.zeros(2, dtype=complex) for name in NAMES},
        {name: np.zeros(2, dtype=">f8") for name in NAMES},
        {name: np.array(["a", "b"]) for name in NAMES},
        dict.fromkeys(NAMES),
        [np.zeros(2)] * 3,
        None,
    ],
)
def test_anything_else_is_left_to_a_closer_look(take, share, wrong):
    assert take(wrong, NAMES, None, np.zeros((1, 3, 2))) is False


@pytest.mark.parametrize("take_one", [take_one_plainly, in_use.take_one])
def test_the_action_of_the_only_agent_is_taken_over(take_one):
    for dtype in ("f8", "f4", "i8", "i4"):
        given = np.zeros((1, 1, 2))
        assert take_one(np.array([1, -2], dtype), given) is True
        np.testing.assert_array_equal(given, [[[1.0, -2.0]]])
    for wrong in (None, [1.0, 2.0], np.zeros(3), np.zeros((1, 2)), np.zeros(2, complex)):
        assert take_one(wrong, given) is False


def test_arrays_that_do_not_lie_in_a_row_are_copied_or_left_but_never_wrong():
    strided = np.arange(8.0)[::4]
    taken = []
    for take in (take_plainly, in_use.take):
        given = np.zeros((1, 1, 2))
        taken.append(take({"drone_0": strided}, ["drone_0"], None, given))
        if taken[-1]:
            np.testing.assert_array_equal(given[0, 0], strided)
    assert taken[0]


@pytest.mark.skipif(in_use.take is take_plainly, reason="not built")
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("take", ({}, [], None)),
        ("take", ({}, [], None, 5)),
        ("take", ({}, (), None, np.zeros((1, 3, 2)))),
        ("take", ({}, [], [0], np.zeros((1, 3, 2)))),
        ("take", ({}, [], None, np.zeros((1, 3, 2), np.float32))),
        ("take", ({"drone_0": np.zeros(2)}, ["drone_0"], [7], np.zeros((1, 3, 2)))),
        ("take", ({"drone_0": np.zeros(2)}, ["drone_0"], ["x"], np.zeros((1, 3, 2)))),
        ("share", ([], None)),
        ("take_one", (np.zeros(2),)),
        ("take_one", (np.zeros(2), 5)),
        ("take_one", (np.zeros(2), np.zeros((1, 2, 2)))),
        ("take_one", (np.zeros(2), np.zeros((2, 1, 2)))),
        ("share", (["a"], [-1], SEEN, *TOLD)),
        ("share", (["a"], ["x"], SEEN, *TOLD)),
        ("share", (["a"], None, SEEN, TOLD[0].astype(int), *TOLD[1:])),
        ("share", (["a"], None, SEEN, *TOLD[:2], TOLD[2][:, :2].copy())),
        ("share", (["a"], None, SEEN, TOLD[0][0], *TOLD[1:])),
        ("share", (["a"], None, 5, *TOLD)),
    ],
)
def test_in_c_what_is_not_as_needed_is_an_error(name, arguments):
    with pytest.raises(TypeError):
        getattr(in_use, name)(*arguments)


@BOTH
def test_results_are_shared_in_pythons_own_types(take, share):
    seen = np.arange(6, dtype=np.float32).reshape(1, 3, 2)
    rewards, ended, cut = (
        np.array([[0.5, -1, 2]]),
        np.array([[0, 1, 0]], bool),
        np.array([[1, 0, 0]], bool),
    )
    for rows in (None, [0, 1, 2], [2, 0]):
        names = NAMES if rows is None else [NAMES[row] for row in rows]
        chosen = rows or [0, 1, 2]
        *results, any_ended = share(names, rows, seen, rewards, ended, cut)
        assert [list(one) for one in results] == [names] * 4
        assert any_ended is True
        for name, row in zip(names, chosen, strict=True):
            np.testing.assert_array_equal(results[0][name], seen[0, row])
            assert results[0][name].base is not None  # a view
            assert results[1][name] == rewards[0, row]
            assert results[2][name] is bool(ended[0, row])
            assert results[3][name] is bool(cut[0, row])
            assert type(results[1][name]) is float
    assert share([], [], seen, rewards, ended, cut) == ({}, {}, {}, {}, False)
    # Only of those agents who are still there
    assert share(["drone_2"], [2], seen, rewards, ended, cut)[-1] is False
    assert share(["drone_1"], [1], seen, rewards, ended, cut)[-1] is True


@BOTH
def test_nothing_is_leaked(take, share):
    actions = {name: np.zeros(2) for name in NAMES}
    given, seen = np.zeros((1, 3, 2)), np.zeros((1, 3, 2), np.float32)
    ends = np.zeros((2, 1, 3), bool)

    def turn():
        take(actions, NAMES, None, given)
        share(NAMES, None, seen, given[:, :, 0].copy(), *ends)

    turn()
    gc.collect()
    before = [sys.getrefcount(one) for one in (seen, actions["drone_0"], NAMES[0], None)]
    for _ in range(1000):
        turn()
    gc.collect()
    after = [sys.getrefcount(one) for one in (seen, actions["drone_0"], NAMES[0], None)]
    assert max(np.abs(np.subtract(after, before))) < 100
