"""Forms of arguments: what numba's types of them follow from.

Numba takes ten times as long to make a type as this takes to tell a form, and an environment has
hundreds of arguments, most of a few forms.
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
    """What the type of an array follows from; `flags` are numpy's, in bits."""

    dtype: np.dtype[Any]
    ndim: int
    flags: int


class TupleForm(NamedTuple):
    """What the type of a tuple follows from."""

    kind: type
    parts: tuple[Any, ...]


def form_of(value: Any) -> Any:
    """Tell what the type of an argument follows from."""
    if isinstance(value, np.ndarray):
        return ArrayForm(value.dtype, value.ndim, value.flags.num)
    if isinstance(value, tuple):
        return TupleForm(type(value), tuple(map(form_of, value)))
    return _SCALARS.get(type(value)) or numba.typeof(value)


def type_of(form: Any) -> types.Type:
    """Make numba's type of an argument of that form: what `numba.typeof` tells of it."""
    if isinstance(form, ArrayForm):
        layout = "C" if form.flags & _C_ORDER else "F" if form.flags & _F_ORDER else "A"
        readonly = not form.flags & _WRITEABLE
        return types.Array(from_dtype(form.dtype), form.ndim, layout, readonly=readonly)
    if isinstance(form, TupleForm):
        return types.BaseTuple.from_types(tuple(map(type_of, form.parts)), form.kind)
    return form
