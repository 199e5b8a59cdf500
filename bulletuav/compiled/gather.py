"""Gather numbers of `WIDTH` drones, numbered consecutively over the worlds, and scatter them."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import BITS, LANES, MASK, VECTOR, WIDTH, lanes_of
from bulletuav.compiled.plain import LaneNumbers, in_python


def _require_c_order(function: str, array: np.ndarray) -> None:
    """Raise TypeError for an array in another order, as compilation does."""
    if not array.flags.c_contiguous:
        raise TypeError(f"{function}: an array in C order is needed")


def _gather(array: np.ndarray, first: int, number: int) -> Any:
    """Python version of `gathered`."""
    _require_c_order("gathered", array)
    rows = array.reshape(array.shape[0] * array.shape[1], -1)
    drones = np.minimum(np.arange(first, first + WIDTH), len(rows) - 1)
    return rows[drones, number].view(LaneNumbers)


def _gather_at(array: np.ndarray, places: np.ndarray, row: int, offset: int) -> Any:
    """Python version of `gathered_at`."""
    _require_c_order("gathered_at", array)
    return array.reshape(-1)[places[row] + offset].view(LaneNumbers)


def _scatter(array: np.ndarray, first: int, count: int, value: np.ndarray) -> None:
    """Python version of `scatter`."""
    _require_c_order("scatter", array)
    numbers = np.broadcast_to(value, WIDTH)[:count]
    array.reshape(-1)[first : first + count] = numbers.astype(array.dtype)


@in_python(_gather)
@intrinsic  # type: ignore[untyped-decorator]
def gathered(_: Any, array: Any, first: Any, number: Any) -> Any:
    """Return a number of each of `WIDTH` drones as lanes, or a bool of each as a mask.

    Args:
        array: (W, N, K) float64 or bool, or (W, N); C order.
        first: Number of the first drone, counted over all worlds. Lanes after the last drone of all
            worlds repeat that drone.
        number: Index along the last axis; 0 for an array (W, N).
    """
    if array.layout != "C" or array.dtype not in (types.float64, types.boolean):
        return None
    is_bool = array.dtype == types.boolean

    def generate(context: Any, builder: Any, given: Any, values: Any) -> Any:
        made = make_array(array)(context, builder, values[0])
        sizes = cgutils.unpack_tuple(builder, made.shape)
        drones = builder.mul(sizes[0], sizes[1])
        stride = sizes[2] if array.ndim == 3 else drones.type(1)
        place = builder.mul(values[1], stride)
        vector = ir.Constant(BITS if is_bool else VECTOR, ir.Undefined)
        for lane in range(WIDTH):
            if lane > 0:
                is_there = builder.icmp_signed(
                    "<", builder.add(values[1], stride.type(lane)), drones
                )
                way = builder.select(is_there, stride, stride.type(0))
                place = builder.add(place, way)
            value = builder.load(builder.gep(made.data, [builder.add(place, values[2])]))
            if is_bool:
                value = builder.trunc(value, ir.IntType(1))
            vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
        return vector

    return (MASK if is_bool else LANES)(array, types.intp, types.intp), generate


@in_python(_gather_at)
@intrinsic  # type: ignore[untyped-decorator]
def gathered_at(_: Any, array: Any, places: Any, row: Any, offset: Any) -> Any:
    """Return numbers of an array from any `WIDTH` places as lanes.

    Args:
        array: float64 in C order, with any axes.
        places: (K, `WIDTH`) int64, indices into the flattened array; C order.
        row: Row of `places`.
        offset: Number that is added to all indices.
    """
    if array.layout != "C" or places.layout != "C" or array.dtype != types.float64:
        return None

    def generate(context: Any, builder: Any, given: Any, values: Any) -> Any:
        numbers = make_array(array)(context, builder, values[0]).data
        first = builder.mul(values[2], values[2].type(WIDTH))
        index = builder.gep(make_array(places)(context, builder, values[1]).data, [first])
        vector = ir.Constant(VECTOR, ir.Undefined)
        for lane in range(WIDTH):
            place = builder.load(builder.gep(index, [ir.IntType(64)(lane)]))
            value = builder.load(builder.gep(numbers, [builder.add(place, values[3])]))
            vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
        return vector

    return LANES(array, places, types.intp, types.intp), generate


@in_python(_scatter)
@intrinsic  # type: ignore[untyped-decorator]
def scatter(_: Any, array: Any, first: Any, count: Any, value: Any) -> Any:
    """Write a number of each of the first drones of a block into an array.

    Args:
        array: (W, N) numbers, in C order; for an integer array, numbers are truncated.
        first: Number of the first drone, counted over all worlds.
        count: Number of drones, at most `WIDTH`.
        value: Lanes with the numbers.
    """
    if array.layout != "C":
        return None

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        made = make_array(array)(context, builder, values[0])
        for lane in range(WIDTH):
            with builder.if_then(builder.icmp_signed(">", values[2], values[2].type(lane))):
                number = builder.extract_element(values[3], ir.IntType(32)(lane))
                place = builder.add(values[1], values[1].type(lane))
                number = context.cast(builder, number, types.float64, array.dtype)
                builder.store(number, builder.gep(made.data, [place]))
        return context.get_dummy_value()

    return types.none(array, types.intp, types.intp, LANES), generate


@in_python(lambda: np.arange(float(WIDTH)).view(LaneNumbers))
@intrinsic  # type: ignore[untyped-decorator]
def lane_numbers(_: Any) -> Any:
    """Return the number of each lane: 0, 1, 2, ..."""
    return LANES(), lambda *_: ir.Constant(VECTOR, [float(lane) for lane in range(WIDTH)])


@func
def three(array: np.ndarray, first: int) -> Any:
    """Return the first three numbers of `WIDTH` drones from `first` on as lanes; see `gathered`."""
    return gathered(array, first, 0), gathered(array, first, 1), gathered(array, first, 2)


@func
def four(array: np.ndarray, first: int) -> Any:
    """Return the first four numbers of `WIDTH` drones from `first` on as lanes."""
    return (
        gathered(array, first, 0),
        gathered(array, first, 1),
        gathered(array, first, 2),
        gathered(array, first, 3),
    )


@func
def copy_numbers(source: np.ndarray, drone: int, packed: np.ndarray, block: int) -> None:
    """Copy all numbers (W, N, K) of `WIDTH` drones from `drone` on into a block (B, K, `WIDTH`)."""
    lanes = lanes_of(packed, block)
    for k in range(source.shape[2]):
        lanes[k] = gathered(source, drone, k)


@kernel
def pack_numbers(source: np.ndarray, packed: np.ndarray) -> None:
    """Copy the numbers (W, N, K) of all drones into blocks (B, K, `WIDTH`)."""
    for b in range(packed.shape[0]):
        copy_numbers(source, b * WIDTH, packed, b)
