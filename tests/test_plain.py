"""Kernels as plain Python, against machine code to the bit."""

import math
import os
import subprocess
import sys
import threading
from typing import NamedTuple

import numpy as np
import pytest

from bulletuav.compiled.dispatcher import plain_kernels
from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import allocating, elementwise, func, kernel
from bulletuav.compiled.plain import record_type
from bulletuav.compiled.program import Program

ROW = record_type([("mass", "f8"), ("arm", "f8", 3), ("count", "i8")])
SCALE = 0.0


class Pair(NamedTuple):
    numbers: np.ndarray
    factor: float


@func
def helper(x):
    return 0.0 if x < 0.5 else x


@func
def powers(x):
    return x**2, x**3, 2.0 ** (-3), (x + 1.0) ** 2, x**0.5


@kernel
def formulas(pair, out):
    for i in range(pair.numbers.shape[0]):
        x = pair.numbers[i]
        out[i, 0] = 1.0 / helper(x)
        out[i, 1] = math.sqrt(x - 0.5)
        out[i, 2], out[i, 3], out[i, 4], out[i, 5], out[i, 6] = powers(x)
        out[i, 7] = max(x, math.nan)
        out[i, 8] = min(math.nan, x, 0.25)
        out[i, 9] = exp(x) / SCALE
        out[i, 10] = x / pair.factor
        out[i, 11] = float(i) / 0.0
        out[i, 12] = math.floor(x * 7.0)
        out[i, 13] = math.log(-x)
        out[i, 14] = math.exp(1e3 * x)


@kernel
def of_records(rows, out):
    for i in range(rows.shape[0]):
        row = rows[i]
        row.mass += 1.0
        row.arm[1] = row.mass * row.count
        out[i] = row.arm[0] + row.arm[1]


@kernel
def at_limits(x, out):
    out[0] = math.sinh(-1e3 * x)
    out[1] = math.exp(1e3 * x)
    out[2] = math.log(0.0 * x)
    out[3] = math.log(-x)
    out[4] = math.log1p(-x)
    out[5] = math.ldexp(-x, 5000)
    out[6] = math.sin(math.inf * x)


def test_functions_beyond_their_range_have_the_sign_of_machine_code():
    compiled, plain = np.zeros((2, 7))
    at_limits(1.0, compiled)
    with plain_kernels():
        at_limits(1.0, plain)
    np.testing.assert_array_equal(plain, compiled)
    inf, nan = math.inf, math.nan
    np.testing.assert_array_equal(plain, [-inf, inf, -inf, nan, -inf, -inf, nan])


def test_plain_python_has_the_bits_of_machine_code():
    numbers = np.concatenate([np.random.default_rng(0).uniform(0.01, 3.0, 500), [0.0, 0.5]])
    compiled, plain = np.zeros((2, numbers.size, 15))
    formulas(Pair(numbers, 0.0), compiled)
    with plain_kernels():
        formulas(Pair(numbers, 0.0), plain)
    np.testing.assert_array_equal(np.isnan(compiled), np.isnan(plain))
    np.testing.assert_array_equal(compiled, plain)
    # Else it would not matter how powers are computed
    assert (np.array([math.pow(x, 3.0) for x in numbers]) != plain[:, 3]).any()


def test_rows_are_written_through_their_fields():
    rows = np.zeros(3, dtype=ROW)
    rows["mass"], rows["arm"], rows["count"] = [1.0, 2.0, 3.0], 0.5, [1, 2, 3]
    again, out, plain = rows.copy(), *np.zeros((2, 3))
    of_records(rows, out)
    with plain_kernels():
        of_records(again, plain)
    assert rows.tobytes() == again.tobytes()
    np.testing.assert_array_equal(out, plain)
    np.testing.assert_array_equal(out, [2.5, 6.5, 12.5])


def test_each_kind_of_function_is_plain_where_it_is_called():
    called = []

    @elementwise
    def square(x):
        called.append(x)
        return x * x

    @allocating
    def ones(n):
        called.append(n)
        return np.ones(n)

    with plain_kernels():
        np.testing.assert_array_equal(square(np.array([2.0, 3.0])), [4.0, 9.0])
        assert square(5.0) == 25.0
        assert ones(3).sum() == 3.0
    assert called == [2.0, 3.0, 5.0, 3]


def test_a_program_calls_plain_functions_and_turns_in_order():
    said = []

    @kernel
    def stop(out):
        said.append("kernel")
        out[0] += 1.0
        return out[0] > 1.5

    program, out = Program(), np.zeros(1)
    program.call(stop, out, otherwise=lambda: said.append("no"))
    program.callback(lambda: said.append("turn"))
    program.call(stop, out, otherwise=lambda: said.append("yes"))
    with plain_kernels():
        program.run()
    assert said == ["kernel", "turn", "kernel", "yes"]


def test_only_the_thread_that_asks_is_plain():
    names = []

    def note():
        out = np.zeros((1, 15))
        formulas(Pair(np.ones(1), 1.0), out)
        names.append(out[0, 4])

    formulas(Pair(np.ones(1), 1.0), np.zeros((1, 15)))
    before = formulas.stats.cache_hits.copy()
    with plain_kernels():
        thread = threading.Thread(target=note)
        traced = []
        threading.settrace(lambda frame, *_: traced.append(frame.f_code.co_name))
        try:
            thread.start()
            thread.join()
        finally:
            threading.settrace(None)
    assert names == [0.125]
    assert "note" in traced
    assert not {"formulas", "powers"} & set(traced)
    assert formulas.stats.cache_hits == before


def test_functions_without_a_source_run_as_they_are():
    space = {"kernel": kernel, "math": math}
    exec("@kernel\ndef cube(x, out):\n    out[0] = math.sqrt(x) * x**3\n", space)
    out = np.zeros(1)
    with plain_kernels():
        space["cube"](4.0, out)
    assert out[0] == 128.0


@pytest.mark.parametrize("source", ["\n", "x = (\n", "def other(x):\n    return x**3\n"])
def test_functions_with_the_source_of_something_else_run_as_they_are(source, monkeypatch):
    """Python 3.13 finds such a source if `exec` in `python -c` defines the function."""
    monkeypatch.setattr("inspect.getsource", lambda function: source)
    test_functions_without_a_source_run_as_they_are()


SESSION = """
import numpy as np
import sys
from bulletuav.compiled.kernel import func, kernel

@func
def inner(x):
    return 2.0 * x

@kernel
def outer(out):
    for k in range(out.size):
        out[k] = inner(out[k])

outer(np.ones(2))
seen = []
sys.settrace(lambda frame, *_: seen.append(frame.f_code.co_name))
outer(np.ones(2))
sys.settrace(None)
print(seen.count("inner"), seen.count("outer"))
"""


@pytest.mark.parametrize(("switch", "calls"), [("1", "2 1"), ("0", "0 0")])
def test_the_switch_of_numba_is_obeyed(tmp_path, switch, calls):
    path = tmp_path / "session.py"
    path.write_text(SESSION)
    environment = {**os.environ, "NUMBA_DISABLE_JIT": switch}
    run = subprocess.run(
        [sys.executable, path], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == calls
