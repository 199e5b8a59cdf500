"""Random numbers for compiled code, one after the other as a generator of NumPy gives them."""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import in_python

Source = tuple[int, int]
"""Addresses of the function that draws, and of the generator's state"""


def source_of(rng: np.random.Generator) -> Source:
    """Tell where compiled code draws from a generator, which has to live meanwhile."""
    bits = rng.bit_generator
    return _drawing(type(bits)), bits.ctypes.state_address


@cache
def _drawing(kind: type[np.random.BitGenerator]) -> int:
    """Look up the function of all generators of a kind that draws one number in [0, 1)."""
    return ctypes.cast(kind().ctypes.next_double, ctypes.c_void_p).value or 0


def _call_drawing(function: int, state: int) -> Any:
    """Do in Python what `_next` does."""
    return np.float64(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(function)(state))


@in_python(_call_drawing)
@intrinsic  # type: ignore[untyped-decorator]
def _next(_: Any, function: Any, state: Any) -> Any:
    """Call a function of C that takes an address and returns a double."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        form = ir.FunctionType(ir.DoubleType(), [ir.IntType(8).as_pointer()])
        drawing = builder.inttoptr(given[0], form.as_pointer())
        return builder.call(drawing, [builder.inttoptr(given[1], form.args[0])])

    return types.float64(function, state), generate


@func
def between(share: float, low: float, high: float) -> float:
    """Turn a number in [0, 1) into one between limits, as `Generator.uniform` does."""
    return low + (high - low) * share


@func
def uniform(source: Source, low: float, high: float) -> float:
    """Draw what `Generator.uniform(low, high)` draws."""
    return between(_next(source[0], source[1]), low, high)
