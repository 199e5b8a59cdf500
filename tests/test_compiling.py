"""Compilation takes less than numba's own, and gives the same functions."""

import gc

import numba
import pytest
from numba.core.registry import cpu_target

from bulletuav.compiled import kernel
from bulletuav.compiled.compiling import OBJECTS, any_number, seldom_collected


def rooted(x):
    if x < 0.0:
        raise ValueError("negative")
    return x**0.5


def callers_of(folder):
    """A function that callers copy, kept in a folder, and one of its callers."""
    copied = kernel.func(rooted)
    copied.keep_in(folder)

    @kernel.kernel
    def caller(x):
        return copied(x) + 1.0

    return copied, caller


def test_what_callers_copy_is_no_machine_code_of_its_own(tmp_path):
    copied, caller = callers_of(tmp_path)
    assert caller(9.0) == 4.0
    (form,) = copied.inner.overloads.values()
    assert not list(form.library.get_defined_functions())
    assert copied(9.0) == 3.0  # for Python it is


def test_it_is_stored_for_other_callers_with_its_errors(tmp_path):
    assert callers_of(tmp_path)[1](9.0) == 4.0
    copied, caller = callers_of(tmp_path)
    assert caller(9.0) == 4.0
    assert sum(copied.inner._cache_hits.values()) == 1
    for compiled in (caller, copied):
        with pytest.raises(ValueError, match="^negative$"):
            compiled(-1.0)


@pytest.mark.parametrize(
    ("usual", "meanwhile"),
    [
        ((700, 10, 10), (OBJECTS, 50, 50)),
        ((0, 10, 10), (0, 10, 10)),  # never
        ((OBJECTS + 1, 3, 2), (OBJECTS + 1, 3, 2)),
    ],
)
def test_garbage_is_looked_for_less_often_meanwhile(usual, meanwhile):
    before = gc.get_threshold()
    try:
        gc.set_threshold(*usual)
        with seldom_collected():
            assert gc.get_threshold() == meanwhile
        assert gc.get_threshold() == usual
    finally:
        gc.set_threshold(*before)


def test_all_numbers_are_of_one_kind_and_others_as_they_are():
    typeof = cpu_target.typing_context.resolve_value_type
    literal = numba.types.literal
    assert any_number(literal(3)) == typeof(3)
    assert any_number(literal(True)) == typeof(True)
    for kind in (literal("word"), numba.types.float64):
        assert any_number(kind) is kind
