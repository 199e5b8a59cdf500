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

RandomSource = tuple[int, int]
"""Addresses of a generator's C function `next_double`, and of its state"""


def get_random_source(rng: np.random.Generator) -> RandomSource:
    """Return the addresses by which compiled code draws from `rng`, which must outlive its use."""
    bits = rng.bit_generator
    return _next_double_address(type(bits)), bits.ctypes.state_address


@cache
def _next_double_address(kind: type[np.random.BitGenerator]) -> int:
    """Return the address of the C function that draws a number in [0, 1), by kind of generator."""
    return ctypes.cast(kind().ctypes.next_double, ctypes.c_void_p).value or 0


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


@func
def scale_to_range(share: float, low: float, high: float) -> float:
    """Scale a number in [0, 1) to the range from low to high, as `Generator.uniform` does."""
    return low + (high - low) * share


@func
def draw_uniform(source: RandomSource, low: float, high: float) -> float:
    """Draw the number that `Generator.uniform(low, high)` would draw."""
    return scale_to_range(_next(source[0], source[1]), low, high)
