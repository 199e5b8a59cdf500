"""Copies of selected worlds between arrays and rows of bytes."""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.plain import in_python
from bulletuav.compiled.program import Program


def add_rows(program: Program, mask: np.ndarray, rows: np.ndarray, array: np.ndarray) -> None:
    """Add to a program that the first rows are copied to the selected worlds, in their order.

    Args:
        program: Program that is extended.
        mask: (W,) bool, worlds that are written.
        rows: (W, ...) one row for each selected world; further rows are ignored.
        array: (W, ...) of the same shape and type.
    """
    assert (rows.dtype, rows.shape) == (array.dtype, array.shape), (rows.shape, array.shape)
    if array.size:
        program.call(_scatter_rows, mask, as_bytes(rows), 0, as_bytes(array))


class Rows:
    """Buffer with the bytes of several arrays of W worlds side by side, a row for each world.

    Attributes:
        mask: (W,) bool, worlds that are copied, in their order, to and from the first rows.
        data: (W, B) uint8.
        gather: Program that copies the worlds of all arrays to rows.
        scatter: Program that copies rows to the worlds of all arrays.
    """

    def __init__(self, arrays: Sequence[np.ndarray]) -> None:
        """Allocate the buffer for C-contiguous arrays (W, ...)."""
        every = [as_bytes(array) for array in arrays]
        worlds = len(every[0])
        self.mask = np.zeros(worlds, dtype=bool)
        self.data = np.empty((worlds, sum(one.shape[1] for one in every)), dtype=np.uint8)
        self.gather, self.scatter = Program(), Program()
        begin = 0
        for one in every:
            self.gather.call(_gather_rows, self.mask, one, self.data, begin)
            self.scatter.call(_scatter_rows, self.mask, self.data, begin, one)
            begin += one.shape[1]


def add_value(program: Program, mask: np.ndarray, value: object, array: np.ndarray) -> None:
    """Add to a program that the worlds of a mask (W,) are set to a value, which is broadcast."""
    if array.size:
        row = np.empty((1, *array.shape[1:]), dtype=array.dtype)
        row[:] = value
        program.call(_fill, mask, as_bytes(row), as_bytes(array))


def as_bytes(array: np.ndarray) -> np.ndarray:
    """Return an array (W, ...) as a view of bytes (W, B)."""
    assert array.flags.c_contiguous
    return array.reshape(len(array), -1).view(np.uint8)


@in_python(ctypes.memmove)
@intrinsic  # type: ignore[untyped-decorator]
def _copy(_: Any, target: Any, source: Any, count: Any) -> Any:
    """Copy bytes from one address to another."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        to, start = (builder.inttoptr(address, byte) for address in given[:2])
        cgutils.raw_memcpy(builder, to, start, given[2], 1)
        return context.get_dummy_value()

    return types.void(target, source, count), generate


@kernel
def _scatter_rows(mask: np.ndarray, rows: np.ndarray, begin: int, array: np.ndarray) -> None:
    """Copy the first rows, from byte `begin` on, to the worlds of a mask (W,) of an array."""
    s = 0
    for w in range(mask.shape[0]):
        if mask[w]:
            target = array.ctypes.data + w * array.strides[0]
            _copy(target, rows.ctypes.data + s * rows.strides[0] + begin, array.shape[1])
            s += 1


@kernel
def _gather_rows(mask: np.ndarray, array: np.ndarray, rows: np.ndarray, begin: int) -> None:
    """Copy the worlds of a mask (W,) of an array to the first rows, from byte `begin` on."""
    s = 0
    for w in range(mask.shape[0]):
        if mask[w]:
            target = rows.ctypes.data + s * rows.strides[0] + begin
            _copy(target, array.ctypes.data + w * array.strides[0], array.shape[1])
            s += 1


@kernel
def _fill(mask: np.ndarray, row: np.ndarray, array: np.ndarray) -> None:
    """Copy one row (1, B) to the rows of a mask (W,) of an array (W, B)."""
    for w in range(mask.shape[0]):
        if mask[w]:
            target = array.ctypes.data + w * array.strides[0]
            _copy(target, row.ctypes.data, array.shape[1])


@kernel
def expand_mask(mask: np.ndarray, each: np.ndarray) -> None:
    """Expand a mask (W,) of worlds to their drones (W, N)."""
    for w in range(each.shape[0]):
        for i in range(each.shape[1]):
            each[w, i] = mask[w]


@kernel
def update_present(
    alive: np.ndarray, fresh: np.ndarray, present: np.ndarray, due: np.ndarray
) -> None:
    """Update which drones are present after a reset, and which worlds are observed again.

    Args:
        alive: (W, N) bool.
        fresh: (W,) bool, worlds that were reset.
        present: (W, N) bool, drones that others observe; written.
        due: (W,) bool, written: worlds of `fresh`, and worlds in which a drone is not present any
            more.
    """
    for w in range(alive.shape[0]):
        due[w] = fresh[w]
        for i in range(alive.shape[1]):
            due[w] = due[w] or present[w, i] != alive[w, i]
            present[w, i] = alive[w, i]
