"""Programs: sequences of compiled calls that run as one call.

A call of compiled code from Python checks the type of every array, which takes longer than a
substep of a drone. A program checks types once: it stores the addresses of arrays, and runs its
calls without Python in between. Python callbacks may be inserted between compiled calls. Calls
whose items are independent can be computed by several threads; see `bulletuav.compiled.threads`.
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
from bulletuav.compiled.kernel import InMemory, kernel
from bulletuav.compiled.plain import SWITCH
from bulletuav.compiled.specialisation import TupleKey, specialisation_key, type_from_key
from bulletuav.compiled.threads import CHUNKS, MAX_CHUNKS, TEAM, run_shared

Callback = Callable[[], None]
"""A Python callback, a step of a program that needs Python"""
_WORD = types.int64
_KIND = types.TypeRef(_WORD)
"""A type as an argument; it has no size, so that this type represents all types"""


class _Call(NamedTuple):
    """A compiled call, or Python callbacks.

    Attributes:
        kernel: The compiled function; None if the callbacks always run.
        arguments: Arguments of the function.
        callbacks: Callbacks that run if the function returns True, or if there is no function.
    """

    kernel: Callable[..., Any] | None
    arguments: tuple[Any, ...]
    callbacks: list[Callback]


class Program:
    """Compiled calls, with Python callbacks between them, in the order in which they were added.

    Arrays are read and written in place: they must not be replaced.

    Attributes:
        threads: Number of threads that compute the calls made by `shared`.
        table: (K, 2) addresses of each call, for `run_calls`; written by the first run.
    """

    def __init__(self, threads: int = 1) -> None:
        """Create an empty program for a number of threads, including the one that runs it."""
        self.threads = 1 if SWITCH.is_on else threads
        self._jobs: list[Any] = []
        self._calls: list[_Call] = []
        self._words: list[np.ndarray] = []
        self.table = np.zeros((0, 2), dtype=np.int64)

    def call(
        self, kernel: Callable[..., Any], *arguments: Any, otherwise: Callback | None = None
    ) -> None:
        """Add a call of a function compiled by `bulletuav.compiled.kernel`.

        Args:
            kernel: The function; it returns nothing, or a bool.
            *arguments: Arrays, numbers, and tuples of them.
            otherwise: Python callback that runs right after the function if it returns True.
        """
        self._calls.append(_Call(kernel, arguments, [] if otherwise is None else [otherwise]))

    def shared(
        self, kernel: Callable[..., Any], size: int, *arguments: Any, own: Sequence[Any] = ()
    ) -> tuple[Any, ...]:
        """Return the function and arguments, for `call`, of a call that all threads share.

        Args:
            kernel: Function of (first, last, *arguments, *own) that returns nothing. It computes
                the items from `first` to before `last`, in any order, and writes nothing else. If
                the program is also used by `by_world`, it must end at the size of its arrays.
            size: Number of items; few items, each of which takes a microsecond or more, are best.
            *arguments: Arguments of all threads.
            own: Arguments of each thread, a tuple for each; the kernel may write scratch arrays in
                them. Can be left out if there are none.
        """
        chunks = min(size, CHUNKS * self.threads, MAX_CHUNKS)
        if self.threads == 1 or chunks < 2:
            return (kernel, 0, size, *arguments, *(own[0] if own else ()))
        every = [(0, 0, *arguments, *one) for one in own or [()] * self.threads]
        job = np.zeros((self.threads, 2), dtype=np.int64)
        known = _Known({}, {}, {})
        words = [_words_of(kernel, one, known) for one in every]
        for row, (caller, numbers) in zip(job, words, strict=True):
            row[:] = caller, numbers.ctypes.data
        # Machine code has the addresses of all of these
        self._jobs.append((job, words, known, every))
        return (run_shared, TEAM.address, job.ctypes.data, size, chunks, self.threads)

    def callback(self, callback: Callback) -> None:
        """Add a Python callback; consecutive callbacks are one step of the program."""
        if self._calls and self._calls[-1].kernel is None:
            self._calls[-1].callbacks.append(callback)
        else:
            self._calls.append(_Call(None, (), [callback]))

    @property
    def calls(self) -> Sequence[tuple[Callable[..., Any] | None, tuple[Any, ...], list[Callback]]]:
        """The steps: function (None if the callbacks always run), arguments and callbacks."""
        return self._calls

    @property
    def names(self) -> list[str]:
        """Names of the compiled functions; "" for Python callbacks."""
        return [getattr(call.kernel, "__name__", "") for call in self._calls]

    def run(self) -> None:
        """Run all calls and callbacks; an exception in a callback ends the program."""
        if SWITCH.is_on:
            self.interpret()
            return
        if len(self.table) != len(self._calls):
            self.compile()
        if self.threads > 1:
            TEAM.require(self.threads)
        last = len(self._calls) - 1
        k = run_calls(self.table, 0)
        while k >= 0:
            for callback in self._calls[k].callbacks:
                callback()
            k = run_calls(self.table, k + 1) if k < last else -1

    def interpret(self) -> None:
        """Run all calls one by one from Python, for debugging or for a single run."""
        for function, arguments, callbacks in self._calls:
            if function is None or function(*arguments):
                for callback in callbacks:
                    callback()

    def compile(self) -> None:
        """Look up the addresses of all functions and arguments; otherwise the first run does."""
        if SWITCH.is_on:
            return
        table = np.zeros((len(self._calls), 2), dtype=np.int64)
        kept: list[np.ndarray] = []
        known = _Known({}, {}, {})
        for row, (made, arguments, _) in zip(table, self._calls, strict=True):
            if made is not None:
                row[0], words = _words_of(made, arguments, known)
                row[1] = words.ctypes.data
                kept.append(words)
        # Assigned together, so that an interrupt cannot leave an incomplete table
        self._words, self.table = [*kept, *known.records.values()], table


class _Known(NamedTuple):
    """What is known of arguments by their ids, which are unique while the arguments live.

    Most calls share tuples and arrays.

    Attributes:
        keys: Keys of specialisations.
        words: Words of arrays and tuples, see `_flat`.
        records: Nested records in memory, see `_record`.
    """

    keys: dict[int, Any]
    words: dict[int, list[int]]
    records: dict[int, np.ndarray]


def _words_of(function: Any, arguments: tuple[Any, ...], known: _Known) -> tuple[int, np.ndarray]:
    """Return the address of a function's caller, and the words of a call of the function."""
    for one in arguments:
        if id(one) not in known.keys:
            known.keys[id(one)] = specialisation_key(one)
    address, caller = _addresses(function, tuple(known.keys[id(one)] for one in arguments))
    numbers = [address]
    for one in arguments:
        if is_nested(one):
            if id(one) not in known.records:
                known.records[id(one)] = _record(one)
            numbers.append(known.records[id(one)].ctypes.data)
        else:
            numbers += _flat(one, known.words)
    return caller, np.array(numbers, dtype=np.int64)


class ByWorld:
    """A program that can run for selected worlds, with arguments of one world at a time."""

    def __init__(self, table: np.ndarray, words: np.ndarray, steps: np.ndarray) -> None:
        """Store the calls.

        Args:
            table: (K, 2) addresses of each call, for `run_calls`.
            words: (B,) arguments of the calls for world 0, to which the table points.
            steps: (B,) increment of each word from one world to the next.
        """
        self._table, self._words, self._steps = table, words, steps
        self._first = words.copy()

    def run(self, worlds: np.ndarray) -> None:
        """Run all calls for each world of a mask (W,)."""
        _run_by_world(self._table, self._words, self._first, self._steps, worlds)


def by_world(program: Program, arrays: Iterable[np.ndarray]) -> ByWorld | None:
    """Convert a program into one that can run for selected worlds.

    Args:
        program: Compiled calls that treat each world in the same way, one after the other.
        arrays: Arrays with a first axis of W worlds.

    Returns:
        The program; None if it has Python callbacks, if an argument is a nested record or an array
        that may also have an axis of worlds, or if kernels run as plain Python.
    """
    if SWITCH.is_on:
        return None
    known = [_span(array) for array in arrays if array.size]
    steps: list[int] = []
    words: list[int] = []
    begins: list[int] = []
    for function, arguments, callbacks in program.calls:
        parts = list(_arrays_in(arguments))
        strides = [_world_stride(array, known) for array in parts]
        if function is None or callbacks or None in strides or any(map(is_nested, arguments)):
            return None
        begins.append(len(words))
        address, _ = _addresses(function, tuple(map(specialisation_key, arguments)))
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
    """Memory of an array of worlds: first byte, byte after the last, bytes of one world, and W."""

    low: int
    high: int
    stride: int
    worlds: int


def _span(array: np.ndarray) -> _Span:
    """Return the span of an array of worlds in memory."""
    low = array.ctypes.data
    reach = sum((n - 1) * stride for n, stride in zip(array.shape, array.strides, strict=True))
    return _Span(low, low + reach + array.itemsize, array.strides[0], len(array))


NO_WORLDS = -1
"""Stride of an array whose first axis is not that of worlds"""


def _world_stride(array: np.ndarray, known: list[_Span]) -> int | None:
    """Return the stride of the axis of worlds, bytes, or `NO_WORLDS`; None if it is ambiguous."""
    worlds = known[0].worlds
    if not array.size:
        return array.strides[0] if len(array) == worlds else NO_WORLDS
    for span in known:
        if array.ndim and span.low <= array.ctypes.data < span.high:
            is_same = len(array) == worlds and array.strides[0] == span.stride
            return span.stride if is_same and array.ctypes.data < span.low + span.stride else None
    return None if array.ndim and len(array) == worlds else NO_WORLDS


def _of_one_world(value: Any, strides: Iterator[int | None]) -> Iterator[tuple[int, int]]:
    """List the words of `_flat` for world 0, each with its increment from world to world."""
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
    """List the words of an argument, in the order in which `_load` reads them.

    `known` caches the words of arrays and tuples by their `id`.
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
    # A C function
    return [ctypes.cast(value, ctypes.c_void_p).value or 0]


def is_nested(value: Any) -> bool:
    """Check whether an argument is a nested record, which is passed by address.

    Passed by value, it would be hundreds of words, which are slow to compile and to copy.
    """
    return hasattr(value, "_fields") and any(isinstance(part, tuple) for part in value)


def _record(value: Any) -> np.ndarray:
    """Copy a named tuple into memory, in the layout of `InMemory`."""
    kind, numbers = _in_memory(value)
    return np.array(numbers, dtype=kind)


def _in_memory(value: Any) -> tuple[Any, Any]:
    """Return the NumPy type of a part of a record in memory, and its numbers."""
    if isinstance(value, np.ndarray):
        # Owner and parent are null, as references are not counted
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
def _addresses(kernel: Any, keys: tuple[Any, ...]) -> tuple[int, int]:
    """Return the addresses of a compiled function, and of the caller that unpacks its arguments.

    Raises:
        TypeError: If the function returns neither a bool nor nothing.
    """
    arguments = tuple(map(_argument_type, keys))
    result = kernel.compiled(arguments).signature.return_type
    if result not in (types.none, types.boolean):
        raise TypeError(f"{kernel.__name__} returns {result}: a bool, or nothing, is needed")
    kind = types.TypeRef(types.Tuple((result, types.Tuple(arguments))))
    caller = cast(Dispatcher, _call)
    return kernel.address(arguments), caller.address((_WORD, kind))


def _argument_type(key: Any) -> types.Type:
    """Return the numba type of an argument; nested records (see `is_nested`) are addresses."""
    kind = type_from_key(key)
    is_record = isinstance(kind, types.NamedTuple)
    nested = is_record and any(isinstance(part, TupleKey) for part in key.parts)
    return InMemory(kind) if nested else kind


def _load(context: Any, builder: Any, kind: types.Type, words: Any, k: int) -> tuple[Any, int]:
    """Generate code that builds an argument from the words from k on; return it and their end."""

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
    """Call the function at the address in the first word, with arguments from the other words."""
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
    """Call the function at an address, which has the signature of `_call`."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        nothing = cgutils.get_null_value(context.get_value_type(_KIND))
        values = [given[1], nothing]
        return invoke(context, builder, given[0], _WORD, (_WORD, _KIND), values)

    return _WORD(caller, words), generate


@kernel
def _call(words: int, kind: Any) -> int:
    """Run one call of a program."""
    result: int = _called(words, kind)
    return result


@kernel
def run_calls(table: np.ndarray, start: int) -> int:
    """Run calls until one returns True or Python callbacks are next.

    Args:
        table: (K, 2) addresses of each call's caller (0 for Python callbacks) and of its words.
        start: Index of the first call.

    Returns:
        Index of the call that returned True, or of the callbacks; -1 at the end.
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
            while k >= 0:  # a call returned True, and has no callbacks
                k = run_calls(table, k + 1)
