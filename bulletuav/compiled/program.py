"""Programs: compiled calls one after the other, which run as one call.

Calling compiled code from Python looks at the type of every array each time, which takes longer
than a substep of a drone. A program looks once: it keeps where arrays are, and runs its calls
without Python in between. Where a call needs Python, its turn comes right there.
"""

import ctypes
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from bulletuav.compiled.compiling import invoke
from bulletuav.compiled.dispatcher import Dispatcher
from bulletuav.compiled.forms import TupleForm, form_of, type_of
from bulletuav.compiled.kernel import InMemory, kernel
from bulletuav.compiled.plain import SWITCH

Turn = Callable[[], None]
"""What Python does when its turn comes"""
_WORD = types.int64
_KIND = types.TypeRef(_WORD)
"""A type as an argument; it takes no room, so that any stands for all"""


class _Call(NamedTuple):
    """A compiled call, or Python's turn.

    Attributes:
        kernel: The compiled function; None where it is always Python's turn.
        arguments: What it is called with.
        turns: What Python does where the function returns True, or where there is none.
    """

    kernel: Callable[..., Any] | None
    arguments: tuple[Any, ...]
    turns: list[Turn]


class Program:
    """Compiled calls, and turns of Python between them, in the order in which they were added.

    Arrays are read and written where they are: they must not be replaced.

    Attributes:
        table: (K, 2) addresses of each call, for `run_calls`; made by the first run.
    """

    def __init__(self) -> None:
        """Make an empty program."""
        self._calls: list[_Call] = []
        self._words: list[np.ndarray] = []
        self.table = np.zeros((0, 2), dtype=np.int64)

    def call(
        self, kernel: Callable[..., Any], *arguments: Any, otherwise: Turn | None = None
    ) -> None:
        """Add a call of a function compiled by `bulletuav.compiled.kernel`.

        Args:
            kernel: The function; it returns nothing, or a bool.
            *arguments: Arrays, numbers, and tuples of them.
            otherwise: What Python does right after it if it returns True.
        """
        self._calls.append(_Call(kernel, arguments, [] if otherwise is None else [otherwise]))

    def turn(self, turn: Turn) -> None:
        """Add a turn of Python; turns that follow each other are one."""
        if self._calls and self._calls[-1].kernel is None:
            self._calls[-1].turns.append(turn)
        else:
            self._calls.append(_Call(None, (), [turn]))

    @property
    def calls(self) -> Sequence[tuple[Callable[..., Any] | None, tuple[Any, ...], list[Turn]]]:
        """The calls: function (None where it is always Python's turn), arguments and turns."""
        return self._calls

    @property
    def names(self) -> list[str]:
        """Names of the calls; "" for turns of Python."""
        return [getattr(call.kernel, "__name__", "") for call in self._calls]

    def run(self) -> None:
        """Run all calls and turns; an exception of a turn ends it."""
        if SWITCH.is_on:
            self.interpret()
            return
        if len(self.table) != len(self._calls):
            self.compile()
        last = len(self._calls) - 1
        k = run_calls(self.table, 0)
        while k >= 0:
            for turn in self._calls[k].turns:
                turn()
            k = run_calls(self.table, k + 1) if k < last else -1

    def interpret(self) -> None:
        """Do what `run` does, call by call through Python: to debug, or to run once."""
        for function, arguments, turns in self._calls:
            if function is None or function(*arguments):
                for turn in turns:
                    turn()

    def compile(self) -> None:
        """Look up the addresses of all functions and arguments; the first run does it otherwise."""
        if SWITCH.is_on:
            return
        table = np.zeros((len(self._calls), 2), dtype=np.int64)
        kept: list[np.ndarray] = []
        # Most calls are given the same tuples and arrays, which live as long as the calls
        forms: dict[int, Any] = {}
        known: dict[int, list[int]] = {}
        records: dict[int, np.ndarray] = {}
        for row, (made, arguments, _) in zip(table, self._calls, strict=True):
            if made is not None:
                for one in arguments:
                    if id(one) not in forms:
                        forms[id(one)] = form_of(one)
                function, caller = _addresses(made, tuple(forms[id(one)] for one in arguments))
                numbers = [function]
                for one in arguments:
                    if is_nested(one):
                        if id(one) not in records:
                            records[id(one)] = _record(one)
                        numbers.append(records[id(one)].ctypes.data)
                    else:
                        numbers += _flat(one, known)
                words = np.array(numbers, dtype=np.int64)
                row[:] = caller, words.ctypes.data
                kept.append(words)
        # At once: an interrupt before it leaves no table without some of the calls
        self._words, self.table = [*kept, *records.values()], table


class ByWorld:
    """A program that can run for some worlds alone: its calls look at one world at a time."""

    def __init__(self, table: np.ndarray, words: np.ndarray, steps: np.ndarray) -> None:
        """Keep its calls.

        Args:
            table: (K, 2) addresses of each call, for `run_calls`.
            words: (B,) what the calls are given of world 0, to which the table points.
            steps: (B,) by how much each number grows from one world to the next.
        """
        self._table, self._words, self._steps = table, words, steps
        self._first = words.copy()

    def run(self, worlds: np.ndarray) -> None:
        """Run all calls for each world of a mask (W,)."""
        _run_by_world(self._table, self._words, self._first, self._steps, worlds)


def by_world(program: Program, arrays: Iterable[np.ndarray]) -> ByWorld | None:
    """Make a program that runs for some worlds alone.

    Args:
        program: Compiled calls of which each does the same in all worlds, one after the other.
        arrays: Those that have a first axis of W worlds.

    Returns:
        None where Python has a turn, or a call is given an array that may be of worlds, too, or a
        record of records; and where kernels run as plain Python.
    """
    if SWITCH.is_on:
        return None
    known = [_span(array) for array in arrays if array.size]
    steps: list[int] = []
    words: list[int] = []
    begins: list[int] = []
    for function, arguments, turns in program.calls:
        parts = list(_arrays_in(arguments))
        strides = [_world_stride(array, known) for array in parts]
        if function is None or turns or None in strides or any(map(is_nested, arguments)):
            return None
        begins.append(len(words))
        address, _ = _addresses(function, tuple(map(form_of, arguments)))
        words.append(address)
        steps.append(0)
        for value, is_first in _of_one_world(arguments, iter(strides)):
            words.append(value)
            steps.append(is_first)
    if len(program.table) != len(program.calls):
        program.compile()
    kept, table = np.array(words, dtype=np.int64), program.table.copy()
    table[:, 1] = kept.ctypes.data + kept.itemsize * np.array(begins, dtype=np.int64)
    return ByWorld(table, kept, np.array(steps, dtype=np.int64))


def _arrays_in(value: Any) -> Iterator[np.ndarray]:
    """List the arrays of an argument, in order."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _arrays_in(part)


class _Span(NamedTuple):
    """Where an array of worlds lies: first byte, the one after its last, one world, and W."""

    low: int
    high: int
    stride: int
    worlds: int


def _span(array: np.ndarray) -> _Span:
    """Tell where an array of worlds lies."""
    low = array.ctypes.data
    reach = sum((n - 1) * stride for n, stride in zip(array.shape, array.strides, strict=True))
    return _Span(low, low + reach + array.itemsize, array.strides[0], len(array))


NO_WORLDS = -1
"""Stride of an array whose first axis is not that of worlds"""


def _world_stride(array: np.ndarray, known: list[_Span]) -> int | None:
    """Tell how far one world is from the next, bytes, or `NO_WORLDS`; None if that is unclear."""
    worlds = known[0].worlds
    if not array.size:
        return array.strides[0] if len(array) == worlds else NO_WORLDS
    for span in known:
        if array.ndim and span.low <= array.ctypes.data < span.high:
            is_same = len(array) == worlds and array.strides[0] == span.stride
            return span.stride if is_same and array.ctypes.data < span.low + span.stride else None
    return None if array.ndim and len(array) == worlds else NO_WORLDS


def _of_one_world(value: Any, strides: Iterator[int | None]) -> Iterator[tuple[int, int]]:
    """List what `_flat` does, of world 0 alone, each with how it grows from world to world."""
    if isinstance(value, tuple):
        for part in value:
            yield from _of_one_world(part, strides)
        return
    numbers = [(number, 0) for number in _flat(value, {})]
    if isinstance(value, np.ndarray):
        stride = next(strides)
        if stride is not None and stride != NO_WORLDS:
            numbers[:2] = [(numbers[0][0], stride), (1, 0)]
    yield from numbers


def _flat(value: Any, known: dict[int, list[int]]) -> list[int]:
    """List the numbers of an argument, in the order in which `_load` reads them.

    `known` has those of arrays and tuples by their `id`.
    """
    if isinstance(value, np.ndarray):
        if id(value) not in known:
            known[id(value)] = [value.ctypes.data, *value.shape, *value.strides]
        return known[id(value)]
    if isinstance(value, tuple):
        if id(value) not in known:
            known[id(value)] = [word for part in value for word in _flat(part, known)]
        return known[id(value)]
    if isinstance(value, float):
        return [np.float64(value).view(np.int64).item()]
    if isinstance(value, bool | int | np.integer):
        return [int(value)]
    # A function of C
    return [ctypes.cast(value, ctypes.c_void_p).value or 0]


def is_nested(value: Any) -> bool:
    """Check whether an argument is a record of records, whose address functions are given.

    As values they are hundreds of words, which take long to compile, and to copy in each call.
    """
    return hasattr(value, "_fields") and any(isinstance(part, tuple) for part in value)


def _record(value: Any) -> np.ndarray:
    """Write a named tuple into memory, as compiled functions read it by `InMemory`."""
    kind, numbers = _in_memory(value)
    return np.array(numbers, dtype=kind)


def _in_memory(value: Any) -> tuple[Any, Any]:
    """Return NumPy's type of what a part of a record is in memory, and its numbers."""
    if isinstance(value, np.ndarray):
        # Owner and parent are not known: nobody counts references
        place = (0, 0, value.size, value.itemsize, *_flat(value, {}))
        return np.dtype((np.int64, (len(place),))), place
    if isinstance(value, tuple):
        kinds, numbers = zip(*map(_in_memory, value), strict=True)
        return np.dtype([("", kind) for kind in kinds], align=True), numbers
    if isinstance(value, np.generic):
        return value.dtype, value
    kind = next((kind for kind in (bool, float) if isinstance(value, kind)), np.int64)
    return np.dtype(kind), value if isinstance(value, float) else _flat(value, {})[0]


@cache
def _addresses(kernel: Any, forms: tuple[Any, ...]) -> tuple[int, int]:
    """Look up a compiled function, and the one that calls it with what a program keeps.

    Raises:
        TypeError: The function returns something else than a bool.
    """
    arguments = tuple(map(_argument_type, forms))
    result = kernel.compiled(arguments).signature.return_type
    if result not in (types.none, types.boolean):
        raise TypeError(f"{kernel.__name__} returns {result}: a bool, or nothing, is needed")
    kind = types.TypeRef(types.Tuple((result, types.Tuple(arguments))))
    caller = cast(Dispatcher, _call)
    return kernel.address(arguments), caller.address((_WORD, kind))


def _argument_type(form: Any) -> types.Type:
    """Return numba's type of an argument, of which `is_nested` tells whether it is an address."""
    kind = type_of(form)
    is_record = isinstance(kind, types.NamedTuple)
    nested = is_record and any(isinstance(part, TupleForm) for part in form.parts)
    return InMemory(kind) if nested else kind


def _load(context: Any, builder: Any, kind: types.Type, words: Any, k: int) -> tuple[Any, int]:
    """Write the code that makes an argument of the words from k on; tells where they end."""

    def word(place: int) -> Any:
        return builder.load(builder.gep(words, [context.get_constant(types.intp, place)]))

    if isinstance(kind, types.Array):
        array = cgutils.create_struct_proxy(kind)(context, builder)
        end = k + 1 + 2 * kind.ndim
        sizes = [word(place) for place in range(k + 1, end)]
        intp = context.get_value_type(types.intp)
        width = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        populate_array(
            array,
            data=builder.inttoptr(word(k), array.data.type),
            shape=cgutils.pack_array(builder, sizes[: kind.ndim], ty=intp),
            strides=cgutils.pack_array(builder, sizes[kind.ndim :], ty=intp),
            itemsize=context.get_constant(types.intp, width),
            meminfo=None,
        )
        return array._getvalue(), end
    if isinstance(kind, InMemory):
        return builder.inttoptr(word(k), cgutils.voidptr_t), k + 1
    if isinstance(kind, types.BaseTuple):
        parts = []
        for part in kind:
            value, k = _load(context, builder, part, words, k)
            parts.append(value)
        return context.make_tuple(builder, kind, parts), k
    if isinstance(kind, types.Float):
        return builder.bitcast(word(k), context.get_value_type(kind)), k + 1
    if isinstance(kind, types.ExternalFunctionPointer):
        return builder.inttoptr(word(k), context.get_value_type(kind)), k + 1
    return context.cast(builder, word(k), _WORD, kind), k + 1


@intrinsic  # type: ignore[untyped-decorator]
def _called(_: Any, words: Any, kind: Any) -> Any:
    """Call the function whose address is the first of the words with what the others tell."""
    result, arguments = kind.instance_type

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        word = context.get_value_type(_WORD)
        place = builder.inttoptr(given[0], word.as_pointer())
        values = _load(context, builder, arguments, place, 1)[0]
        values = cgutils.unpack_tuple(builder, values, len(arguments))
        done = invoke(context, builder, builder.load(place), result, tuple(arguments), values)
        if result == types.none:
            return context.get_constant(_WORD, 0)
        return context.cast(builder, done, result, _WORD)

    return _WORD(words, kind), generate


@intrinsic  # type: ignore[untyped-decorator]
def _at(_: Any, caller: Any, words: Any) -> Any:
    """Call what stands at an address, of the form of `_call`."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        nothing = cgutils.get_null_value(context.get_value_type(_KIND))
        values = [given[1], nothing]
        return invoke(context, builder, given[0], _WORD, (_WORD, _KIND), values)

    return _WORD(caller, words), generate


@kernel
def _call(words: int, kind: Any) -> int:
    """Make one call of a program."""
    result: int = _called(words, kind)
    return result


@kernel
def run_calls(table: np.ndarray, start: int) -> int:
    """Make calls (address of the caller, of its words) until one returns True, and tell which.

    Returns -1 at the end. An address of 0 is Python's turn.
    """
    for k in range(start, table.shape[0]):
        if table[k, 0] == 0 or _at(table[k, 0], table[k, 1]) != 0:
            return k
    return -1


@kernel
def _run_by_world(
    table: np.ndarray, words: np.ndarray, first: np.ndarray, steps: np.ndarray, worlds: np.ndarray
) -> None:
    """Run a program for each world of a mask; see `ByWorld`."""
    for w in range(worlds.shape[0]):
        if worlds[w]:
            for k in range(words.shape[0]):
                words[k] = first[k] + w * steps[k]
            k = run_calls(table, 0)
            while k >= 0:  # a call returned True, and nobody has a turn
                k = run_calls(table, k + 1)
