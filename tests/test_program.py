"""Programs do what their calls do one by one, with Python's turns in between."""

import ctypes
import math
from typing import NamedTuple

import numba
import numpy as np
import pytest

import bulletuav.compiled.program
from bulletuav.compiled.kernel import allocating, kernel
from bulletuav.compiled.program import Program, by_world
from bulletuav.compiled.specialisation import specialisation_key, type_from_key
from bulletuav.envs.aviary import Aviary

ROW = np.dtype([("mass", "f8"), ("arms", "f8", (3,)), ("count", "i8")])


class Pair(NamedTuple):
    one: np.ndarray
    two: np.ndarray


class Nested(NamedTuple):
    pair: Pair
    rows: np.ndarray
    scale: float


@kernel
def add(one, two, out):
    for i in range(out.shape[0]):
        out[i] = one[i] + two[i]


@kernel
def is_above(array, limit):
    return array[0] > limit


@kernel
def mix(nested, strided, flags, single, whole, positive, vector, out):
    pair, rows = nested.pair, nested.rows
    for i in range(out.shape[0]):
        total = nested.scale * pair.one[i] + pair.two[i, 1] + rows[i].mass * rows[i].arms[2]
        total += rows[i].count + strided[i] + single[i] + whole + vector[1]
        out[i] = total if flags[i] and positive else -total


class Switches(NamedTuple):
    first: bool
    count: int
    second: bool
    third: bool
    pair: Pair


class Deep(NamedTuple):
    before: bool
    switches: Switches
    scale: float
    after: bool
    last: np.ndarray


@kernel
def read_deep(deep, out):
    switches = deep.switches
    given = (deep.before, switches.first, switches.second, switches.third, deep.after)
    for k in range(5):
        out[k] = given[k]
    out[5] = switches.count
    out[6] = deep.scale
    out[7] = switches.pair.one[1] + switches.pair.two[2, 1]
    out[8] = deep.last.size + deep.last[1, 2]


@allocating
def by_sum(array, out):
    room = np.empty(array.shape[0])
    room[:] = array
    out[0] = room.sum()


@kernel
def first(array):
    return array[0]


@kernel
def refuse(array):
    if array[0] > 1.0:
        raise ValueError("more than one")


@kernel
def root(function, array):
    array[0] = function(array[0])


def mixture():
    """Arguments of all kinds for `mix`."""
    rng = np.random.default_rng(0)
    rows = np.zeros(4, ROW)
    rows["mass"], rows["arms"] = rng.normal(size=4), rng.normal(size=(4, 3))
    rows["count"] = rng.integers(-5, 5, 4)
    fixed = rng.normal(size=4)
    fixed.flags.writeable = False
    nested = Nested(Pair(fixed, rng.normal(size=(4, 2))), rows, -0.0)
    strided = rng.normal(size=(4, 5))[:, 3]
    flags = np.array([True, False, True, True])
    return nested, strided, flags, rng.normal(size=4).astype("f4"), -3, True, (1.5, math.pi)


def test_arguments_of_all_kinds_arrive_as_they_are():
    given, expected, got = mixture(), np.zeros(4), np.zeros((4, 2))[:, 0]
    mix(*given, expected)
    program = Program()
    program.call(mix, *given, got)
    program.run()
    np.testing.assert_array_equal(got, expected)
    assert np.isfinite(got).all()


def test_arrays_are_read_and_written_where_they_are():
    one, two, out = np.arange(3.0), np.ones(3), np.zeros(3)
    program = Program()
    program.call(add, one, two, out)
    program.call(add, out, two, out)
    for _ in range(3):
        program.run()
        np.testing.assert_array_equal(out, one + 2 * two)
        one += 10
        two *= -1


def test_types_follow_from_forms():
    """As numba tells them, which takes ten times as long."""
    rows = np.zeros((3, 4), dtype=ROW)
    still = np.zeros(3)
    still.setflags(write=False)
    grid = np.zeros((4, 6))
    arrays = [rows, rows[0], rows["arms"], grid, grid.T, grid[:, ::2], grid[::-1], grid[:0], still]
    arrays += [np.zeros((), np.int32), np.zeros(2, bool), np.zeros(2, np.uint8)]
    scalars = [1.0, True, 3, -(2**40), np.float64(1), np.float32(1), np.int64(2), np.bool_(True)]
    pair = Pair(grid, still)
    tuples = [(), (grid,), (grid, grid), (1.0, (2, True)), pair, Nested(pair, rows, 2.0)]
    for value in [*arrays, *scalars, *tuples, ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 0)]:
        key = specialisation_key(value)
        assert type_from_key(key) == numba.typeof(value), value
        assert hash(key) == hash(specialisation_key(value))


def test_turns_of_python_come_in_their_places():
    said, out = [], np.zeros(1)
    program = Program()
    program.callback(lambda: said.append(("begin", out[0])))
    program.call(add, out, np.ones(1), out)
    program.callback(lambda: said.append(("middle", out[0])))
    program.callback(lambda: said.append(("and on", out[0])))
    program.call(add, out, np.ones(1), out)
    program.callback(lambda: said.append(("end", out[0])))
    program.run()
    assert said == [("begin", 0), ("middle", 1), ("and on", 1), ("end", 2)]
    said.clear()
    program.interpret()
    assert said == [("begin", 2), ("middle", 3), ("and on", 3), ("end", 4)]


@pytest.mark.parametrize("way", ["run", "interpret"])
def test_python_is_asked_where_a_call_returns_true(way):
    said, out = [], np.zeros(1)
    program = Program()
    program.call(is_above, out, 1.5, otherwise=lambda: said.append(out[0]))
    program.call(add, out, np.ones(1), out)
    program.call(is_above, out, 1.5, otherwise=lambda: said.append(-out[0]))
    for _ in range(3):
        getattr(program, way)()
    assert said == [-2, 2, -3]


def test_an_empty_program_does_nothing():
    Program().run()
    Program().interpret()


def test_calls_can_be_added_after_a_run():
    out, program = np.zeros(1), Program()
    program.call(add, out, np.ones(1), out)
    program.run()
    program.call(add, out, np.ones(1), out)
    program.run()
    assert out[0] == 3


def test_an_error_of_a_turn_ends_the_run_and_the_next_one_begins_anew():
    out, program, faults = np.zeros(1), Program(), [1, 0]
    program.call(add, out, np.ones(1), out)
    program.callback(lambda: 1 / (1 - faults.pop(0)))
    program.call(add, out, np.ones(1), out)
    with pytest.raises(ZeroDivisionError):
        program.run()
    assert out[0] == 1
    program.run()
    assert out[0] == 3


def test_an_error_of_a_call_is_raised():
    out, program = np.zeros(1), Program()
    program.call(refuse, out)
    program.call(add, out, np.full(1, 2.0), out)
    program.run()
    with pytest.raises(ValueError, match="more than one"):
        program.run()
    assert out[0] == 2


def test_a_call_that_returns_a_number_is_refused():
    program = Program()
    program.call(first, np.zeros(1))
    with pytest.raises(TypeError, match="first returns float64: a bool, or nothing, is needed"):
        program.run()


def test_arrays_may_be_made_and_functions_of_c_called():
    library = ctypes.CDLL(None)
    library.sqrt.restype, library.sqrt.argtypes = ctypes.c_double, [ctypes.c_double]
    out, program = np.zeros(1), Program()
    program.call(by_sum, np.arange(9.0), out)
    program.call(root, library.sqrt, out)
    program.run()
    assert out[0] == 6


CASES = {
    "hover": {"dynamics": "rigid_body", "num_drones": 3},
    "crossing": {"dynamics": "point_mass", "difficulty": "extreme"},
    "obstacles": {"dynamics": "bullet", "num_drones": 4, "boundary": "soft"},
    "mec": {},
}


@pytest.mark.parametrize("task", CASES)
def test_a_decision_is_the_same_call_by_call(task, monkeypatch):
    results = []
    for way in (Program.run, Program.interpret):
        monkeypatch.setattr(Program, "run", way)
        aviary = Aviary(task, 2, horizon=12, **CASES[task])
        shape = (2, *aviary.action.low.shape)
        rng, rows = np.random.default_rng(1), [aviary.reset(seeds=3)]
        for _ in range(15):
            step = aviary.step(rng.uniform(-1, 1, shape))
            rows += [step.observations, step.rewards, step.terminated, *step.info.values()]
        results.append(np.concatenate([np.ravel(row).astype(float) for row in rows]))
        aviary.close()
    assert results[0].tobytes() == results[1].tobytes()


def test_an_interrupt_while_a_program_is_compiled_leaves_no_call_out(monkeypatch):
    """The next run begins anew; a table without some of the calls would be run in silence."""
    one, out, program = np.ones(3), np.zeros(3), Program()
    program.call(add, one, one, out)
    program.call(add, out, one, out)
    looked_up = bulletuav.compiled.program._addresses
    calls = []

    def interrupted(*given):
        calls.append(given)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return looked_up(*given)

    monkeypatch.setattr(bulletuav.compiled.program, "_addresses", interrupted)
    with pytest.raises(KeyboardInterrupt):
        program.run()
    program.run()
    np.testing.assert_array_equal(out, 3.0)


@kernel
def sum_up(pair, weights, out):
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] += weights[i] * pair.one[w, i] + pair.two[w, 0]


@pytest.mark.parametrize("bits", range(0, 32, 3))
def test_records_of_records_are_in_memory_as_compiled_code_reads_them(bits):
    """Flags beside each other, and before larger numbers: padding counts."""
    flags = [bool(bits >> k & 1) for k in range(5)]
    table = np.arange(24.0).reshape(4, 6)
    pair = Pair(table[0], table[:, ::2])
    deep = Deep(flags[0], Switches(flags[1], -7, *flags[2:4], pair), 0.25, flags[4], table[1:, 1:])
    out, program = np.zeros(9), Program()
    program.call(read_deep, deep, out)
    program.run()
    assert out.tolist() == [*flags, -7, 0.25, 1 + 14, 15 + 15]


def test_worlds_are_not_run_alone_with_a_record_of_records():
    out, program = np.zeros((4, 3)), Program()
    deep = Nested(Pair(np.zeros(3), np.zeros((3, 2))), np.zeros(3, ROW), 1.0)
    program.call(keep_scale, deep, out)
    assert by_world(program, [out]) is None
    program.run()
    assert (out == 1.0).all()


@kernel
def keep_scale(deep, out):
    for w in range(out.shape[0]):
        out[w, 0] = out[w, 1] = out[w, 2] = deep.scale


def by_worlds(given=None):
    """A program over 4 worlds of 3 drones, what it writes, and the same for some worlds alone."""
    rng = np.random.default_rng(0)
    pair = Pair(rng.normal(size=(4, 3)), rng.normal(size=(4, 2))[:, 1:])
    weights, out = rng.normal(size=3) if given is None else given, np.zeros((4, 3))
    program = Program()
    program.call(sum_up, pair, weights, out)
    program.call(sum_up, pair, weights, out)
    return program, out, by_world(program, [pair.one, pair.two, out])


def test_some_worlds_alone_are_the_same_and_others_are_left_alone():
    program, out, alone = by_worlds()
    program.run()
    whole = out.copy()
    out[:] = 0.0
    alone.run(np.array([False, True, False, True]))
    np.testing.assert_array_equal(out[[1, 3]], whole[[1, 3]])
    assert not out[[0, 2]].any()
    alone.run(np.array([True, False, True, False]))
    np.testing.assert_array_equal(out, whole)


def test_worlds_are_not_run_alone_where_that_is_unclear():
    # A constant that is as long as there are worlds may be of worlds, too
    assert by_worlds(np.zeros(4))[2] is None
    program, out, alone = by_worlds()
    assert alone is not None
    # One drone's row in all worlds is no array of worlds that begins with the first of them
    assert by_world(program, [out.T]) is None
    program.callback(lambda: None)
    assert by_world(program, [out]) is None
