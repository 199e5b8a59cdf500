"""Keys of specialisations: hashable descriptions of arguments that determine their numba types.

To compute a key takes a tenth of the time of `numba.typeof`, and the hundreds of arguments of an
environment share a few keys.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.np.numpy_support import from_dtype

_SCALARS = {float: types.float64, bool: types.boolean}
_C_ORDER, _F_ORDER, _WRITEABLE = 1, 2, 0x400
"""Bits of an array's `flags.num`"""


class ArrayForm(NamedTuple):
    """Key of an array's numba type; `flags` are the bits of NumPy's `flags.num`."""

    dtype: np.dtype[Any]
    ndim: int
    flags: int


class TupleForm(NamedTuple):
    """Key of a tuple's numba type."""

    kind: type
    parts: tuple[Any, ...]


def form_of(value: Any) -> Any:
    """Return the key of an argument: two arguments with equal keys have the same numba type."""
    if isinstance(value, np.ndarray):
        return ArrayForm(value.dtype, value.ndim, value.flags.num)
    if isinstance(value, tuple):
        return TupleForm(type(value), tuple(map(form_of, value)))
    return _SCALARS.get(type(value)) or numba.typeof(value)


def type_of(form: Any) -> types.Type:
    """Return the numba type of arguments with a key, equal to `numba.typeof` of the argument."""
    if isinstance(form, ArrayForm):
        layout = "C" if form.flags & _C_ORDER else "F" if form.flags & _F_ORDER else "A"
        readonly = not form.flags & _WRITEABLE
        return types.Array(from_dtype(form.dtype), form.ndim, layout, readonly=readonly)
    if isinstance(form, TupleForm):
        return types.BaseTuple.from_types(tuple(map(type_of, form.parts)), form.kind)
    return form
