"""Worlds as rows of bytes: what is written to some of them, whatever is in their arrays."""

import numpy as np

from bulletuav.kernel import kernel
from bulletuav.program import Program


def add_rows(program: Program, mask: np.ndarray, rows: np.ndarray, array: np.ndarray) -> None:
    """Add to a program that the first rows are written to worlds of a mask, in their order.

    Args:
        program: To be added to.
        mask: (W,) bool, worlds that are written.
        rows: (W, ...) one row for each of them, and others that do not count.
        array: (W, ...) of the same form.
    """
    assert (rows.dtype, rows.shape) == (array.dtype, array.shape), (rows.shape, array.shape)
    if array.size:
        program.call(_put, mask, _as_bytes(rows), _as_bytes(array))


def add_value(program: Program, mask: np.ndarray, value: object, array: np.ndarray) -> None:
    """Add to a program that all worlds of a mask (W,) get one value, one for all or for each."""
    if array.size:
        row = np.empty((1, *array.shape[1:]), dtype=array.dtype)
        row[:] = value
        program.call(_fill, mask, _as_bytes(row), _as_bytes(array))


def _as_bytes(array: np.ndarray) -> np.ndarray:
    """Show an array (W, ...) as bytes (W, B), where it is."""
    assert array.flags.c_contiguous
    return array.reshape(len(array), -1).view(np.uint8)


@kernel
def _put(mask: np.ndarray, rows: np.ndarray, array: np.ndarray) -> None:
    """Write the first rows (W, B) to rows of an array (W, B) that are of a mask (W,)."""
    s = 0
    for w in range(mask.shape[0]):
        if mask[w]:
            for k in range(array.shape[1]):
                array[w, k] = rows[s, k]
            s += 1


@kernel
def _fill(mask: np.ndarray, row: np.ndarray, array: np.ndarray) -> None:
    """Write one row (1, B) to all rows of an array (W, B) that are of a mask (W,)."""
    for w in range(mask.shape[0]):
        if mask[w]:
            for k in range(array.shape[1]):
                array[w, k] = row[0, k]


@kernel
def spread(mask: np.ndarray, each: np.ndarray) -> None:
    """Write a mask (W,) of worlds to one of their drones (W, N)."""
    for w in range(each.shape[0]):
        for i in range(each.shape[1]):
            each[w, i] = mask[w]


@kernel
def renew(alive: np.ndarray, fresh: np.ndarray, present: np.ndarray, due: np.ndarray) -> None:
    """Write who can be met after a reset, and what worlds are to be observed anew.

    Args:
        alive: (W, N) bool.
        fresh: (W,) bool, worlds that were reset.
        present: (W, N) bool, drones that can be met; written.
        due: (W,) bool, written: worlds of `fresh`, and those in which somebody is met no more.
    """
    for w in range(alive.shape[0]):
        due[w] = fresh[w]
        for i in range(alive.shape[1]):
            due[w] = due[w] or present[w, i] != alive[w, i]
            present[w, i] = alive[w, i]
