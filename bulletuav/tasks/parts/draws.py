"""Random numbers for compiled code, drawn from the stream of a NumPy generator."""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import in_python

RandomSource = tuple[int, int, int]
"""Addresses of a generator's C function `next_double`, of its state, and of `next_uint32`"""


_WORD = 0xFFFFFFFF
"""Largest integer of 32 bits"""


def get_random_source(rng: np.random.Generator) -> RandomSource:
    """Return the addresses by which compiled code draws from `rng`, which must outlive its use."""
    bits = rng.bit_generator
    next_double, next_word = _find_addresses(type(bits))
    return next_double, bits.ctypes.state_address, next_word


@cache
def _find_addresses(kind: type[np.random.BitGenerator]) -> tuple[int, int]:
    """Return the addresses of `next_double` and `next_uint32`, by kind of generator."""
    functions = kind().ctypes
    double, word = (
        ctypes.cast(one, ctypes.c_void_p).value or 0
        for one in (functions.next_double, functions.next_uint32)
    )
    return double, word


def _next_in_python(function: int, state: int) -> Any:
    """Implement `_next` in Python."""
    return np.float64(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(function)(state))


@in_python(_next_in_python)
@intrinsic  # type: ignore[untyped-decorator]
def _next(_: Any, function: Any, state: Any) -> Any:
    """Call a C function that takes an address and returns a double."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        form = ir.FunctionType(ir.DoubleType(), [ir.IntType(8).as_pointer()])
        drawing = builder.inttoptr(given[0], form.as_pointer())
        return builder.call(drawing, [builder.inttoptr(given[1], form.args[0])])

    return types.float64(function, state), generate


def _next_word_in_python(function: int, state: int) -> Any:
    """Implement `_next_word` in Python."""
    return np.int64(ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)(function)(state))


@in_python(_next_word_in_python)
@intrinsic  # type: ignore[untyped-decorator]
def _next_word(_: Any, function: Any, state: Any) -> Any:
    """Call a C function that takes an address and returns an unsigned integer of 32 bits."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        form = ir.FunctionType(ir.IntType(32), [ir.IntType(8).as_pointer()])
        drawing = builder.inttoptr(given[0], form.as_pointer())
        word = builder.call(drawing, [builder.inttoptr(given[1], form.args[0])])
        return builder.zext(word, ir.IntType(64))

    return types.int64(function, state), generate


@func
def scale_to_range(share: float, low: float, high: float) -> float:
    """Scale a number in [0, 1) to the range from low to high, as `Generator.uniform` does."""
    return low + (high - low) * share


@func
def draw_uniform(source: RandomSource, low: float, high: float) -> float:
    """Draw the number that `Generator.uniform(low, high)` would draw."""
    return scale_to_range(_next(source[0], source[1]), low, high)


@func
def draw_integer(source: RandomSource, count: int) -> int:
    """Draw the integer from 0 to count - 1 that `Generator.integers(count)` would draw.

    Args:
        source: Source of random numbers.
        count: Number of integers, at least 1 and at most 2^31.

    References:
        Lemire (2019), "Fast random integer generation in an interval", algorithm 5.
    """
    if count == 1:
        return 0
    product = _next_word(source[2], source[1]) * count
    # Products whose lower half is below this number would make some integers more likely
    if product & _WORD < count:
        lowest = (_WORD + 1 - count) % count
        while product & _WORD < lowest:
            product = _next_word(source[2], source[1]) * count
    return int(product >> 32)
