"""Programs: compiled calls one after the other, which run as one call.

Calling compiled code from Python looks at the type of every array each time, which takes longer
than a substep of a drone. A program looks once: it keeps where arrays are, and runs its calls
without Python in between. Where a call needs Python, its turn comes right there.
"""

import ctypes
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import from_dtype

from bulletuav.kernel import kernel

Turn = Callable[[], None]
"""What Python does when its turn comes"""
_WORD = types.int64
_KIND = types.TypeRef(_WORD)
"""A type as an argument; it takes no room, so that any stands for all"""
_SCALARS = {float: types.float64, bool: types.boolean}
_C_ORDER, _F_ORDER, _WRITEABLE = 1, 2, 0x400
"""Bits of an array's `flags.num`"""


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
        """Add a call of a function compiled by `bulletuav.kernel`.

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
    def names(self) -> list[str]:
        """Names of the calls; "" for turns of Python."""
        return [getattr(call.kernel, "__name__", "") for call in self._calls]

    def run(self) -> None:
        """Run all calls and turns; an exception of a turn ends it."""
        if len(self.table) != len(self._calls):
            self.compile()
        k = run_calls(self.table, 0)
        while k >= 0:
            for turn in self._calls[k].turns:
                turn()
            k = run_calls(self.table, k + 1)

    def interpret(self) -> None:
        """Do what `run` does, call by call through Python; for programs that run once."""
        for function, arguments, turns in self._calls:
            if function is None or function(*arguments):
                for turn in turns:
                    turn()

    def compile(self) -> None:
        """Look up the addresses of all functions and arguments; the first run does it otherwise."""
        table = np.zeros((len(self._calls), 2), dtype=np.int64)
        kept: list[np.ndarray] = []
        for row, (made, arguments, _) in zip(table, self._calls, strict=True):
            if made is not None:
                function, caller = _addresses(made, tuple(map(_form, arguments)))
                words = np.array([function, *_flat(arguments)], dtype=np.int64)
                row[:] = caller, words.ctypes.data
                kept.append(words)
        # At once: an interrupt before it leaves no table without some of the calls
        self._words, self.table = kept, table


def _flat(value: Any) -> Iterator[int]:
    """List the numbers of an argument, in the order in which `_load` reads them."""
    if isinstance(value, np.ndarray):
        yield from (value.ctypes.data, *value.shape, *value.strides)
    elif isinstance(value, tuple):
        for part in value:
            yield from _flat(part)
    elif isinstance(value, float):
        yield np.float64(value).view(np.int64).item()
    elif isinstance(value, bool | int | np.integer):
        yield int(value)
    else:  # a function of C
        yield ctypes.cast(value, ctypes.c_void_p).value or 0


class _ArrayForm(NamedTuple):
    """What the type of an array follows from; `flags` are numpy's, in bits."""

    dtype: np.dtype[Any]
    ndim: int
    flags: int


class _TupleForm(NamedTuple):
    """What the type of a tuple follows from."""

    kind: type
    parts: tuple[Any, ...]


def _form(value: Any) -> Any:
    """Tell what the type of an argument follows from: quicker to make and to look up than a type.

    Numba takes ten times as long to make types, and an environment has hundreds of arguments.
    """
    if isinstance(value, np.ndarray):
        return _ArrayForm(value.dtype, value.ndim, value.flags.num)
    if isinstance(value, tuple):
        return _TupleForm(type(value), tuple(map(_form, value)))
    return _SCALARS.get(type(value)) or numba.typeof(value)


def _type_of(form: Any) -> types.Type:
    """Make numba's type of an argument of that form: what `numba.typeof` tells of it."""
    if isinstance(form, _ArrayForm):
        layout = "C" if form.flags & _C_ORDER else "F" if form.flags & _F_ORDER else "A"
        readonly = not form.flags & _WRITEABLE
        return types.Array(from_dtype(form.dtype), form.ndim, layout, readonly=readonly)
    if isinstance(form, _TupleForm):
        return types.BaseTuple.from_types(tuple(map(_type_of, form.parts)), form.kind)
    return form


@cache
def _addresses(kernel: Any, forms: tuple[Any, ...]) -> tuple[int, int]:
    """Look up a compiled function, and the one that calls it with what a program keeps.

    Raises:
        TypeError: The function returns something else than a bool.
    """
    arguments = tuple(map(_type_of, forms))
    function, result = _compiled(kernel, arguments)
    if result not in (types.none, types.boolean):
        raise TypeError(f"{kernel.__name__} returns {result}: a bool, or nothing, is needed")
    kind = types.TypeRef(types.Tuple((result, types.Tuple(arguments))))
    return function, _compiled(_call, (_WORD, kind))[0]


def _compiled(dispatcher: Any, arguments: tuple[types.Type, ...]) -> tuple[int, types.Type]:
    """Compile a function for some types; tells its address, and the type of its result."""
    dispatcher.inner.compile(arguments)
    made = dispatcher.inner.overloads[arguments]
    address: int = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
    return address, made.signature.return_type


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
        form = context.call_conv.get_function_type(result, tuple(arguments))
        function = builder.inttoptr(builder.load(place), form.as_pointer())
        done = _invoked(context, builder, function, result, tuple(arguments), values)
        if result == types.none:
            return context.get_constant(_WORD, 0)
        return context.cast(builder, done, result, _WORD)

    return _WORD(words, kind), generate


@intrinsic  # type: ignore[untyped-decorator]
def _at(_: Any, caller: Any, words: Any) -> Any:
    """Call what stands at an address, of the form of `_call`."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        form = context.call_conv.get_function_type(_WORD, (_WORD, _KIND))
        function = builder.inttoptr(given[0], form.as_pointer())
        nothing = cgutils.get_null_value(context.get_value_type(_KIND))
        values = [given[1], nothing]
        return _invoked(context, builder, function, _WORD, (_WORD, _KIND), values)

    return _WORD(caller, words), generate


def _invoked(
    context: Any, builder: Any, function: Any, result: Any, kinds: tuple[Any, ...], values: Any
) -> Any:
    """Write a call, after which an error goes on up."""
    status, done = context.call_conv.call_function(builder, function, result, kinds, values)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return done


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
