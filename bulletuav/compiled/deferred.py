"""Functions that are compiled when they are first called, not when their callers are.

Who touches nothing need not wait until all of contacts is compiled. A caller asks for the address
of such a function when it gets there, and keeps it: later calls look at memory once more.
"""

import contextlib
import ctypes
import functools
import hashlib
import inspect
import logging
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar, cast

import llvmlite.binding as llvm
import llvmlite.ir as ir
from numba.core import cgutils, types
from numba.core.typing.templates import make_intrinsic_template

from bulletuav.compiled.compiling import invoke
from bulletuav.compiled.dispatcher import Dispatcher, dispatcher_of

Function = TypeVar("Function", bound=Callable[..., Any])
"""Type of a compiled function; the decorator keeps its signature."""
_LOG = logging.getLogger(__name__)
_FAILED = 1
"""In the place of an address: there is none"""
_SOON = 0.01
"""Time after which a signal is told that came while a function was compiled, s"""


@contextlib.contextmanager
def signals_later() -> Iterator[None]:
    """Let what programs do at a signal, such as an interrupt, wait until shortly after this.

    Compilation cannot be left just anywhere: LLVM's objects would be freed twice.
    """
    # Python runs handlers in its main thread alone
    is_main = threading.current_thread() is threading.main_thread()
    signals = signal.valid_signals() if is_main else ()
    handlers = {one: what for one in signals if callable(what := signal.getsignal(one))}
    noted: list[int] = []

    def note(number: int, _: Any) -> None:
        _LOG.warning("%s waits until this is compiled", signal.Signals(number).name)
        noted.append(number)

    for one in handlers:
        signal.signal(one, note)
    try:
        yield
    finally:
        for one, what in handlers.items():
            signal.signal(one, what)
        for number in dict.fromkeys(noted):
            threading.Timer(_SOON, signal.raise_signal, [number]).start()


class Door(NamedTuple):
    """What machine code asks for the address of a function when it gets there.

    Attributes:
        module: Name of the function's module.
        name: Its name there.
        result: Numba's type of what it returns.
        arguments: Those of its arguments.
    """

    module: str
    name: str
    result: Any
    arguments: tuple[Any, ...]

    @property
    def symbol(self) -> str:
        """The name of the door in machine code."""
        kinds = hashlib.sha256(repr(self.arguments).encode()).hexdigest()[:24]
        return f"{self.module}.{self.name}.{kinds}.door"

    def is_met(self) -> bool:
        """Tell LLVM where the door is; what is behind it need not be compiled."""
        if self not in _OPENERS:
            _OPENERS[self] = ctypes.CFUNCTYPE(None, ctypes.c_int64)(self._answer)
        llvm.add_symbol(self.symbol, ctypes.cast(_OPENERS[self], ctypes.c_void_p).value)
        return True

    def _answer(self, place: int) -> None:
        """Write the address of the function, or `_FAILED`, to where machine code reads it.

        That waits in the middle of a flight, and asks again if nothing is written.
        """
        try:
            with signals_later():
                address = self.address()
        except Exception:
            _LOG.exception("%s.%s", self.module, self.name)
            address = _FAILED
        ctypes.c_int64.from_address(place).value = address

    def address(self) -> int:
        """Compile or load the function; tells its address.

        Raises:
            TypeError: It returns something else than was told.
        """
        found = dispatcher_of(self.module, self.name)
        assert found is not None, f"{self.module} has no compiled {self.name} any more"
        result = found.compiled(self.arguments).signature.return_type
        if result != self.result:
            raise TypeError(f"{self.name} returns {result}, but is deferred as {self.result}")
        return found.address(self.arguments)


_OPENERS: dict[Door, Any] = {}
"""What C calls to open each door that machine code has; it lives as long as the process"""


def compile_deferred() -> None:
    """Compile or load all that was deferred, for flights in real time, which cannot wait for it.

    Raises:
        TypeError: A function returns something else than was told.
    """
    opened: set[Door] = set()
    # What is behind a door may have doors of its own
    while waiting := [door for door in list(_OPENERS) if door not in opened]:
        for door in waiting:
            door.address()
        opened.update(waiting)


def deferred(result: Any) -> Callable[[Function], Function]:
    """Compile a function when a compiled caller first gets to it.

    It stands above `kernel` or `allocating`, in a module. Compiled callers give no keywords.

    Args:
        result: Numba's type of what the function returns: its callers are compiled without it.

    Raises:
        RuntimeError: Where it is called, if it cannot be compiled; the reason is logged.
    """

    def decorate(function: Function) -> Function:
        compiled = cast(Dispatcher, function)
        parts = inspect.signature(compiled.py_func).parameters.values()

        def define(_: Any, *arguments: Any) -> Any:
            door = Door(function.__module__, function.__name__, result, arguments)
            return result(*arguments), functools.partial(_through, door)

        # Numba reads the names of its arguments
        first = inspect.Parameter("context", inspect.Parameter.POSITIONAL_ONLY)
        define.__signature__ = inspect.Signature([first, *parts])  # type: ignore[attr-defined]
        compiled.door = types.Function(make_intrinsic_template(compiled, define, function.__name__))
        return function

    return decorate


def _through(door: Door, context: Any, builder: Any, _: Any, values: Any) -> Any:
    """Write a call through a door."""
    door.is_met()
    library = context.active_code_library
    library.doors = (*getattr(library, "doors", ()), door)
    # The address stays in the caller's own code
    word, name = context.get_value_type(types.intp), f"{door.symbol}.address"
    place = builder.module.globals.get(name)
    if place is None:
        place = cgutils.add_global_variable(builder.module, word, name)
        place.linkage, place.initializer = "internal", word(0)
    look, ask, known = (
        builder.append_basic_block(f"door.{part}") for part in ("look", "ask", "known")
    )
    builder.branch(look)
    builder.position_at_end(look)
    address = builder.load(place)
    builder.cbranch(builder.icmp_unsigned("==", address, word(0)), ask, known)
    # Until there is an answer: a signal may have come before it was written
    builder.position_at_end(ask)
    form = ir.FunctionType(ir.VoidType(), [word])
    opener = cgutils.get_or_insert_function(builder.module, form, door.symbol)
    builder.call(opener, [builder.ptrtoint(place, word)])
    builder.branch(look)
    builder.position_at_end(known)
    with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", address, word(_FAILED))):
        builder.store(word(0), place)
        text = f"{door.module}.{door.name} could not be compiled; see the error that was logged"
        context.call_conv.return_user_exc(builder, RuntimeError, (text,))
    return invoke(context, builder, address, door.result, door.arguments, values)
