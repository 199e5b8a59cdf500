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


class ArrayKey(NamedTuple):
    """Key of an array's numba type; `flags` are the bits of NumPy's `flags.num`."""

    dtype: np.dtype[Any]
    ndim: int
    flags: int


class TupleKey(NamedTuple):
    """Key of a tuple's numba type."""

    kind: type
    parts: tuple[Any, ...]


def specialisation_key(value: Any) -> Any:
    """Return the key of an argument: two arguments with equal keys have the same numba type."""
    if isinstance(value, np.ndarray):
        return ArrayKey(value.dtype, value.ndim, value.flags.num)
    if isinstance(value, tuple):
        return TupleKey(type(value), tuple(map(specialisation_key, value)))
    return _SCALARS.get(type(value)) or numba.typeof(value)


def type_from_key(key: Any) -> types.Type:
    """Return the numba type of arguments with a key, equal to `numba.typeof` of the argument."""
    if isinstance(key, ArrayKey):
        layout = "C" if key.flags & _C_ORDER else "F" if key.flags & _F_ORDER else "A"
        readonly = not key.flags & _WRITEABLE
        return types.Array(from_dtype(key.dtype), key.ndim, layout, readonly=readonly)
    if isinstance(key, TupleKey):
        return types.BaseTuple.from_types(tuple(map(type_from_key, key.parts)), key.kind)
    return key
