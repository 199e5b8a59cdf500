"""SIMD vectors of numbers of several drones: formulas of one drone then compute `WIDTH` drones.

A lane is one drone of several that are computed at once (SIMD).
A compiled function that receives `Lanes` instead of floats adds, multiplies, divides and takes
square roots in each lane, with the same bits as with floats on any processor. `where` replaces
branches. `lanes_row` and `lanes_of` are the counterparts of rows of constants and of arrays. In
memory, the lanes of each number are contiguous.

    lanes_of(lane_zeros(numbers), 0)[k]  # number k of all drones
"""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr_generic
from numba.core.typeconv import Conversion
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    infer_getattr,
    infer_global,
    signature,
)
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

from bulletuav.compiled.plain import LaneNumbers, in_python, select_lanes
from bulletuav.compiled.shipped import target_features
from bulletuav.compiled.stamps import stamp_of

WIDTH = 8 if "+avx512f" in target_features() else 4
"""Drones in a block: eight for AVX-512, whose vectors have eight numbers, else four, as other
processors have half the registers. Results do not depend on it, to the bit."""
_STAMP = f"{WIDTH} {stamp_of(__file__)}"
"""Part of the types' names, so that cached machine code is invalid when this file changes"""
_NUMBER = ir.DoubleType()
VECTOR = ir.VectorType(_NUMBER, WIDTH)
"""LLVM type of lanes"""
BITS = ir.VectorType(ir.IntType(1), WIDTH)
"""LLVM type of a mask"""
_LINE = 8
"""Numbers in a cache line"""
_ALIGNED = 8
"""Alignment of arrays, bytes: that of a number, not of a vector"""


class Lanes(types.Type):  # type: ignore[misc]  # numba has no types
    """Numba type of a vector with one number of each of `WIDTH` drones."""

    def __init__(self) -> None:
        """Create the type."""
        super().__init__(f"Lanes {_STAMP}")

    def can_convert_from(self, _: Any, other: Any) -> Any:
        """Allow the conversion of a number to lanes of equal numbers."""
        return Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, _: Any, other: Any) -> Any:
        """Return the type of a variable that is assigned both lanes and numbers."""
        return self if isinstance(other, types.Number) else None


class Mask(types.Type):  # type: ignore[misc]
    """Numba type of the result of a comparison of lanes."""

    def __init__(self) -> None:
        """Create the type."""
        super().__init__(f"Mask {_STAMP}")


class LanesArray(types.Type):  # type: ignore[misc]
    """Numba type of an array of lanes, represented by its address.

    Attributes:
        columns: Numbers in a row of a two-dimensional array.
    """

    def __init__(self, columns: int) -> None:
        """Create the type for a length of rows."""
        self.columns = columns
        super().__init__(f"LanesArray {columns} {_STAMP}")


class LanesRow(types.Type):  # type: ignore[misc]
    """Numba type of a row of constants whose fields are lanes, represented by its address.

    Attributes:
        record: Numba type of the row of one drone; all its numbers have 8 bytes.
    """

    def __init__(self, record: Any) -> None:
        """Create the type from that of one drone's row."""
        self.record = record
        super().__init__(f"LanesRow {record.name} {_STAMP}")


LANES, MASK = Lanes(), Mask()


def lane_zeros(*shape: int) -> np.ndarray:
    """Return an array (..., `WIDTH`) of zeros, aligned to a cache line.

    Args:
        shape: All axes except the last.
    """
    count = math.prod(shape) * WIDTH
    numbers = np.zeros(count + _LINE)
    first = -numbers.ctypes.data % (8 * _LINE) // 8
    return numbers[first : first + count].reshape(*shape, WIDTH)


def _model(kind: type, llvm_type: Any) -> None:
    """Register the LLVM type of a numba type."""

    @register_model(kind)
    class _Model(models.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, manager: Any, one: Any) -> None:
            super().__init__(manager, one, llvm_type)


_model(Lanes, VECTOR)
_model(Mask, BITS)
_model(LanesArray, _NUMBER.as_pointer())
_model(LanesRow, _NUMBER.as_pointer())


@lower_cast(types.Number, Lanes)  # type: ignore[untyped-decorator]
def _spread(context: Any, builder: Any, kind: Any, _: Any, value: Any) -> Any:
    """Generate code that broadcasts a number to all lanes."""
    nothing = ir.Constant(VECTOR, ir.Undefined)
    number = context.cast(builder, value, kind, types.float64)
    first = builder.insert_element(nothing, number, ir.IntType(32)(0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, nothing, order)


def _of_lanes(operation: Any, count: int, result: Any, write: Callable[..., Any]) -> None:
    """Register the implementation of an operator or function for lanes.

    Args:
        operation: The operator or function.
        count: Number of its arguments, of which at least one is lanes.
        result: Numba type of its result.
        write: Generates the code, from LLVM's builder and the values of the arguments.
    """

    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, arguments: Any, keywords: Any) -> Any:
            fit = all(isinstance(one, (Lanes, types.Number)) for one in arguments)
            if keywords or not fit or len(arguments) != count or LANES not in arguments:
                return None
            return signature(result, *[LANES] * count)

    infer_global(operation)(_Template)

    @lower_builtin(operation, *[Lanes] * count)  # type: ignore[untyped-decorator]
    def _lower(_: Any, builder: Any, __: Any, values: Any) -> Any:
        return write(builder, *values)


def _intrinsic(name: str) -> Callable[..., Any]:
    """Return a function that generates a call of an LLVM intrinsic in each lane."""
    kind = ir.FunctionType(VECTOR, [VECTOR])

    def write(builder: Any, value: Any) -> Any:
        full = f"llvm.{name}.v{WIDTH}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), [value])

    return write


def _of_two(order: str) -> Callable[..., Any]:
    """Return a function that generates a binary LLVM instruction."""
    return lambda builder, one, other: getattr(builder, order)(one, other)


def _compared(sign: str) -> Callable[..., Any]:
    """Return a function that generates a comparison: False for NaN, except for `!=`."""
    order = "fcmp_unordered" if sign == "!=" else "fcmp_ordered"
    return lambda builder, one, other: getattr(builder, order)(sign, one, other)


def _second_if(sign: str) -> Callable[..., Any]:
    """Return a function that generates `second if second sign first else first`."""
    test = _compared(sign)
    return lambda builder, one, other: builder.select(test(builder, other, one), other, one)


for _name, _order in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _of_lanes(getattr(operator, _name), 2, LANES, _of_two(_order))
    _of_lanes(getattr(operator, f"i{_name}"), 2, LANES, _of_two(_order))
for _name, _sign in (
    ("gt", ">"),
    ("lt", "<"),
    ("ge", ">="),
    ("le", "<="),
    ("eq", "=="),
    ("ne", "!="),
):
    _of_lanes(getattr(operator, _name), 2, MASK, _compared(_sign))
_of_lanes(operator.neg, 1, LANES, lambda builder, value: builder.fneg(value))
_of_lanes(abs, 1, LANES, _intrinsic("fabs"))
_of_lanes(math.sqrt, 1, LANES, _intrinsic("sqrt"))
_of_lanes(math.floor, 1, LANES, _intrinsic("floor"))
# As in Python, also for NaN: max(a, b) is b where b > a
_of_lanes(max, 2, LANES, _second_if(">"))
_of_lanes(min, 2, LANES, _second_if("<"))


@in_python(select_lanes)
@intrinsic  # type: ignore[untyped-decorator]
def where(typing: Any, condition: Any, one: Any, other: Any) -> Any:
    """Return `one` where a condition holds, else `other`, for floats or in each lane.

    Both values are evaluated.
    """
    result = LANES if isinstance(condition, Mask) else typing.unify_types(one, other)

    def generate(context: Any, builder: Any, given: Any, values: Any) -> Any:
        pair = [
            context.cast(builder, value, kind, result)
            for value, kind in zip(values[1:], given.args[1:], strict=True)
        ]
        return builder.select(values[0], *pair)

    return result(condition, one, other), generate


@in_python(lambda condition: bool(np.any(condition)))
@intrinsic  # type: ignore[untyped-decorator]
def is_any(_: Any, condition: Any) -> Any:
    """Return True if a condition holds in any lane; a bool is returned unchanged."""

    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        if not isinstance(condition, Mask):
            return values[0]
        word = ir.IntType(WIDTH)
        return builder.icmp_unsigned("!=", builder.bitcast(values[0], word), word(0))

    return types.boolean(condition), generate


class _PlainArray:
    """Python counterpart of `LanesArray`: rows (numbers, `WIDTH`) of an array, copied when read."""

    def __init__(self, numbers: np.ndarray, columns: int = 1) -> None:
        """Wrap the numbers of an array with that many columns."""
        self._numbers, self._columns = numbers, columns

    def _row(self, index: Any) -> Any:
        return index[0] * self._columns + index[1] if isinstance(index, tuple) else index

    def __getitem__(self, index: Any) -> Any:
        return self._numbers[self._row(index)].copy().view(LaneNumbers)

    def __setitem__(self, index: Any, value: Any) -> None:
        self._numbers[self._row(index)] = value


class _PlainRow:
    """Python counterpart of `LanesRow`: fields of a row as attributes."""

    def __init__(self, rows: np.ndarray, packed: np.ndarray, block: int) -> None:
        """Wrap the numbers (numbers, `WIDTH`) of one block."""
        assert rows.dtype.fields is not None
        self._fields, self._numbers = rows.dtype.fields, packed[block]

    def __getattr__(self, name: str) -> Any:
        kind, offset = self._fields[name][:2]
        numbers = self._numbers[offset // 8 :]
        if kind.shape:
            return _PlainArray(numbers, math.prod(kind.shape[1:]))
        if kind.kind == "f":
            return numbers[0].copy().view(LaneNumbers)
        return numbers[0].view(kind)[0]


def _plain_lanes_of(array: np.ndarray, first: int) -> _PlainArray:
    """Python version of `lanes_of`."""
    return _PlainArray(array[first] if array.ndim == 3 else array[first:])


@in_python(_plain_lanes_of)
@intrinsic  # type: ignore[untyped-decorator]
def lanes_of(_: Any, array: Any, first: Any) -> Any:
    """Return an array (numbers, `WIDTH`), or one block of (blocks, numbers, `WIDTH`), as lanes.

    Args:
        array: The array, in C order.
        first: Index along its first axis: the first number, or the block.
    """

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        made = make_array(array)(context, builder, values[0])
        place = values[1]
        for size in cgutils.unpack_tuple(builder, made.shape)[1:]:
            place = builder.mul(place, size)
        return builder.gep(made.data, [place])

    return LanesArray(1)(array, types.intp), generate


@in_python(_PlainRow)
@intrinsic  # type: ignore[untyped-decorator]
def lanes_row(_: Any, rows: Any, packed: Any, block: Any) -> Any:
    """Return the rows of a block of drones as one row of lanes.

    Args:
        rows: An array of such rows; only its type is used.
        packed: (blocks, numbers, `WIDTH`) the numbers of the rows, in C order.
        block: Index of the block.
    """

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        made = make_array(packed)(context, builder, values[1])
        _, numbers, width = cgutils.unpack_tuple(builder, made.shape)
        place = builder.mul(values[2], builder.mul(numbers, width))
        return builder.gep(made.data, [place])

    return LanesRow(rows.dtype)(rows, packed, types.intp), generate


def _load(builder: Any, place: Any) -> Any:
    """Generate code that loads lanes."""
    loaded = builder.load(builder.bitcast(place, VECTOR.as_pointer()))
    loaded.align = _ALIGNED
    return loaded


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    """Types of the fields of a `LanesRow`."""

    key = LanesRow

    def generic_resolve(self, kind: LanesRow, name: str) -> Any:
        if name not in kind.record.fields:
            return None
        field = kind.record.typeof(name)
        if isinstance(field, types.NestedArray):
            return LanesArray(math.prod(field.shape[1:]))
        return LANES if isinstance(field, types.Float) else field


@lower_getattr_generic(LanesRow)  # type: ignore[untyped-decorator]
def _field(context: Any, builder: Any, kind: LanesRow, address: Any, name: str) -> Any:
    """Generate code that reads a field; integers are equal for all drones of a block."""
    field, first = kind.record.typeof(name), kind.record.offset(name) // 8 * WIDTH
    place = builder.gep(address, [ir.IntType(64)(first)])
    if isinstance(field, types.NestedArray):
        return place
    if isinstance(field, types.Float):
        return _load(builder, place)
    return builder.load(builder.bitcast(place, context.get_value_type(field).as_pointer()))


def _is_index(kind: Any) -> bool:
    """Check whether a type is that of an index along one or two axes."""
    parts = tuple(kind) if isinstance(kind, types.BaseTuple) else (kind,)
    return len(parts) <= 2 and all(isinstance(part, types.Integer) for part in parts)


@infer_global(operator.getitem)
class _Getting(AbstractTemplate):  # type: ignore[misc]
    """Types of `array[k]` and `array[row, column]`."""

    def generic(self, arguments: Any, _: Any) -> Any:
        array, index = arguments
        if isinstance(array, LanesArray) and _is_index(index):
            return signature(LANES, array, index)
        return None


@infer_global(operator.setitem)
class _Setting(AbstractTemplate):  # type: ignore[misc]
    """Types of `array[k] = lanes`."""

    def generic(self, arguments: Any, _: Any) -> Any:
        array, index, _value = arguments
        if isinstance(array, LanesArray) and _is_index(index):
            return signature(types.none, array, index, LANES)
        return None


def _place(context: Any, builder: Any, given: Any, values: Any) -> Any:
    """Generate code that computes the address of one number of an array of lanes."""
    (kind, index), word = given.args[:2], ir.IntType(64)
    if isinstance(index, types.BaseTuple):
        parts = zip(cgutils.unpack_tuple(builder, values[1], 2), index, strict=True)
        row, column = (context.cast(builder, one, part, types.intp) for one, part in parts)
        number = builder.add(builder.mul(row, word(kind.columns)), column)
    else:
        number = context.cast(builder, values[1], index, types.intp)
    return builder.gep(values[0], [builder.mul(number, word(WIDTH))])


@lower_builtin(operator.getitem, LanesArray, types.Integer)  # type: ignore[untyped-decorator]
@lower_builtin(operator.getitem, LanesArray, types.BaseTuple)  # type: ignore[untyped-decorator]
def _get(context: Any, builder: Any, given: Any, values: Any) -> Any:
    """Generate code that reads an element of an array of lanes."""
    return _load(builder, _place(context, builder, given, values))


@lower_builtin(operator.setitem, LanesArray, types.Integer, Lanes)  # type: ignore[untyped-decorator]
@lower_builtin(operator.setitem, LanesArray, types.BaseTuple, Lanes)  # type: ignore[untyped-decorator]
def _set(context: Any, builder: Any, given: Any, values: Any) -> Any:
    """Generate code that writes an element of an array of lanes."""
    place = builder.bitcast(_place(context, builder, given, values), VECTOR.as_pointer())
    builder.store(values[2], place).align = _ALIGNED
    return context.get_dummy_value()
