"""Functions that are compiled when they are first called."""

import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from forking import forking
from numba import types

from bulletuav.compiled import deferred as module
from bulletuav.compiled.deferred import DeferredEntry, compile_deferred, deferred
from bulletuav.compiled.kernel import func, kernel


@deferred(types.float64)
@kernel
def rarely(numbers, k):
    if numbers[k] < 0.0:
        raise ValueError("negative")
    numbers[k] += 1.0
    return 2.0 * numbers[k]


@func
def twice(numbers, k):
    return rarely(numbers, k) + rarely(numbers, 1)


@kernel
def caller(numbers, times):
    total = 0.0
    for _ in range(times):
        total += twice(numbers, 0)
    return total


@deferred(types.none)
@kernel
def grow(numbers):
    numbers[0] *= 10


@kernel
def call_grow(numbers, wanted):
    if wanted:
        grow(numbers)


@deferred(types.int64)
@kernel
def wrong(number):
    return 0.5 * number


@kernel
def call_wrong(number):
    return wrong(number)


@deferred(types.none)
@kernel
def outer(numbers):
    call_grow(numbers, numbers[0] > 1e9)


@kernel
def call_outer(numbers, wanted):
    if wanted:
        outer(numbers)


def be_idle(seconds):
    for _ in range(int(seconds / 0.01)):
        time.sleep(0.01)


def test_they_are_compiled_at_the_first_call_once_for_all_numbers():
    # Of a type that no other test has, whichever comes first
    numbers = np.zeros(2, dtype=np.float32)
    assert caller(numbers, 0) == 0.0

    def forms():
        return [one for one in rarely.inner.overloads if one[0] == types.float32[::1]]

    assert not forms()
    # 2 (1 + 1 + 2 + 2)
    assert caller(numbers, 2) == 12.0
    assert numbers.tolist() == [2.0, 2.0]
    assert len(forms()) == 1
    assert rarely(numbers, 0) == 6.0  # for Python it is as any other


def test_what_they_raise_goes_on_up():
    with pytest.raises(ValueError, match="^negative$"):
        caller(np.array([-1.0, 0.0]), 1)


def test_stored_callers_find_them_and_need_nothing_of_them_before(tmp_path):
    (tmp_path / "seldom.py").write_text(
        "from numba import types\nfrom bulletuav.compiled.deferred import deferred\n"
        "from bulletuav.compiled.kernel import func, kernel\n"
        "@deferred(types.int64)\n@kernel\ndef far(x):\n    return x + 1\n"
        "@func\ndef middle(x):\n    return far(x) if x > 2 else 0\n"
        "@kernel\ndef near(x):\n    return middle(x)\n"
    )
    code = (
        "import seldom as s; a = s.near(1), len(s.far.inner.overloads), s.near(3); "
        "print(*a, *(sum(one._cache_hits.values()) for one in (s.near, s.far.inner)))"
    )
    with forking() as run:
        assert run(tmp_path, code) == ["0 0 4 0 0\n"]
        assert run(tmp_path, code) == ["0 0 4 1 1\n"]


def test_all_can_be_compiled_before_they_are_called():
    # Of a type that no other test has, whichever comes first
    numbers, form = np.ones(1, dtype=np.uint16), (types.uint16[::1],)
    call_outer(numbers, False)
    assert not {form} & {*outer.inner.overloads, *grow.inner.overloads}
    compile_deferred()
    assert form in outer.inner.overloads
    assert form in grow.inner.overloads
    call_grow(numbers, True)
    assert numbers[0] == 10.0


def test_a_wrong_type_of_the_result_is_told(caplog):
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"wrong could not be compiled; see the error that"):
            call_wrong(3)
    texts = [str(one.exc_info[1]) for one in caplog.records]
    assert texts == ["wrong returns float64, but is deferred as int64"] * 2
    # compile_deferred of other tests would meet it again
    for entry in [one for one in module._RESOLVERS if one.name == "wrong"]:
        del module._RESOLVERS[entry]


def give_up(number, _):
    raise TimeoutError(number)


@pytest.mark.parametrize(
    ("number", "handler", "raised", "kind"),
    [
        (signal.SIGINT, signal.default_int_handler, KeyboardInterrupt, np.float32),
        (signal.SIGUSR1, give_up, TimeoutError, np.int32),
    ],
)
def test_a_signal_meanwhile_is_told_after_it(monkeypatch, caplog, number, handler, raised, kind):
    find_address, numbers = DeferredEntry.address, np.ones(1, dtype=kind)

    def interrupted(entry):
        for _ in range(3):
            os.kill(os.getpid(), number)
            be_idle(0.02)
        return find_address(entry)

    def grow_and_wait():
        call_grow(numbers, True)
        be_idle(10.0)

    monkeypatch.setattr(DeferredEntry, "address", interrupted)
    before = signal.signal(number, handler)
    try:
        with pytest.raises(raised):
            grow_and_wait()
    finally:
        signal.signal(number, before)
    assert numbers[0] == 10
    waits = f"{number.name} is delayed until compilation ends"
    assert [one.message for one in caplog.records].count(waits) == 3


def test_whoever_gets_no_answer_asks_again(monkeypatch):
    find_address, asked, returned = DeferredEntry.address, [], []

    def ask(entry):
        asked.append(entry.name)
        if len(asked) == 1:
            raise SystemExit
        return find_address(entry)

    monkeypatch.setattr(DeferredEntry, "address", ask)
    monkeypatch.setattr(sys, "unraisablehook", lambda one: returned.append(one.exc_type))
    numbers = np.ones(1, dtype=np.int16)
    call_grow(numbers, True)
    assert (numbers[0], asked, returned) == (10, ["grow"] * 2, [SystemExit])


def test_threads_compile_them_too():
    numbers = np.ones(1, dtype=np.int64)
    thread = threading.Thread(target=call_grow, args=(numbers, True))
    thread.start()
    thread.join()
    assert numbers[0] == 10
