"""Deferred functions: compiled at their first call instead of together with their callers.

A flight without contacts need not wait until the contact solver is compiled. A compiled caller
resolves the address of a deferred function at its first call and stores it; later calls cost one
load from memory.
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
"""Value in place of an address if compilation failed"""
_SOON = 0.01
"""Delay after compilation before a signal that arrived meanwhile is raised again, s"""


@contextlib.contextmanager
def delay_signals() -> Iterator[None]:
    """Delay Python's signal handlers, such as that of an interrupt, until shortly after the block.

    An exception raised within compilation would free LLVM's objects twice.
    """
    # Python runs signal handlers only in the main thread
    is_main = threading.current_thread() is threading.main_thread()
    signals = signal.valid_signals() if is_main else ()
    handlers = {one: what for one in signals if callable(what := signal.getsignal(one))}
    noted: list[int] = []

    def note(number: int, _: Any) -> None:
        _LOG.warning("%s is delayed until compilation ends", signal.Signals(number).name)
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


class DeferredEntry(NamedTuple):
    """Entry point of a deferred function, through which machine code resolves its address.

    Attributes:
        module: Name of the function's module.
        name: Name of the function in its module.
        result: Numba type of the return value.
        arguments: Numba types of the arguments.
    """

    module: str
    name: str
    result: Any
    arguments: tuple[Any, ...]

    @property
    def symbol(self) -> str:
        """Name of the entry point in machine code."""
        kinds = hashlib.sha256(repr(self.arguments).encode()).hexdigest()[:24]
        return f"{self.module}.{self.name}.{kinds}.deferred"

    def is_met(self) -> bool:
        """Register the entry point with LLVM, without compiling the function; return True."""
        if self not in _RESOLVERS:
            _RESOLVERS[self] = ctypes.CFUNCTYPE(None, ctypes.c_int64)(self._resolve)
        llvm.add_symbol(self.symbol, ctypes.cast(_RESOLVERS[self], ctypes.c_void_p).value)
        return True

    def _resolve(self, place: int) -> None:
        """Write the address of the function, or `_FAILED`, to the address `place`.

        The calling machine code waits for it, and calls again if nothing was written.
        """
        try:
            with delay_signals():
                address = self.address()
        except Exception:
            _LOG.exception("%s.%s", self.module, self.name)
            address = _FAILED
        ctypes.c_int64.from_address(place).value = address

    def address(self) -> int:
        """Compile or load the function, and return its address.

        Raises:
            TypeError: If the function does not return the type that was declared.
        """
        found = dispatcher_of(self.module, self.name)
        assert found is not None, f"{self.module} has no compiled {self.name} any more"
        result = found.compiled(self.arguments).signature.return_type
        if result != self.result:
            raise TypeError(f"{self.name} returns {result}, but is deferred as {self.result}")
        return found.address(self.arguments)


_RESOLVERS: dict[DeferredEntry, Any] = {}
"""C callbacks that resolve the entry points; they live as long as the process"""


def compile_deferred() -> None:
    """Compile or load all deferred functions, for flights in real time, which cannot wait later.

    Raises:
        TypeError: If a function does not return the type that was declared.
    """
    resolved: set[DeferredEntry] = set()
    # A deferred function may call other deferred functions
    while waiting := [entry for entry in list(_RESOLVERS) if entry not in resolved]:
        for entry in waiting:
            entry.address()
        resolved.update(waiting)


def deferred(result: Any) -> Callable[[Function], Function]:
    """Return a decorator that defers the compilation of a function to its first call.

    The decorator is applied on top of `kernel` or `allocating`, to functions of a module. Compiled
    callers pass arguments by position only.

    Args:
        result: Numba type of the return value; callers are compiled before the function is.

    Raises:
        RuntimeError: At the call, if the function cannot be compiled; the reason is logged.
    """

    def decorate(function: Function) -> Function:
        compiled = cast(Dispatcher, function)
        parts = inspect.signature(compiled.py_func).parameters.values()

        def define(_: Any, *arguments: Any) -> Any:
            entry = DeferredEntry(function.__module__, function.__name__, result, arguments)
            return result(*arguments), functools.partial(_write_deferred_call, entry)

        # Numba reads the argument names from the signature
        first = inspect.Parameter("context", inspect.Parameter.POSITIONAL_ONLY)
        define.__signature__ = inspect.Signature([first, *parts])  # type: ignore[attr-defined]
        compiled.deferred_type = types.Function(
            make_intrinsic_template(compiled, define, function.__name__)
        )
        return function

    return decorate


def _write_deferred_call(
    entry: DeferredEntry, context: Any, builder: Any, _: Any, values: Any
) -> Any:
    """Generate a call of a deferred function through its entry point."""
    entry.is_met()
    library = context.active_code_library
    library.deferred_entries = (*getattr(library, "deferred_entries", ()), entry)
    # The resolved address is stored in a global variable of the caller's module
    word, name = context.get_value_type(types.intp), f"{entry.symbol}.address"
    place = builder.module.globals.get(name)
    if place is None:
        place = cgutils.add_global_variable(builder.module, word, name)
        place.linkage, place.initializer = "internal", word(0)
    look, ask, known = (
        builder.append_basic_block(f"deferred.{part}") for part in ("look", "ask", "known")
    )
    builder.branch(look)
    builder.position_at_end(look)
    address = builder.load(place)
    builder.cbranch(builder.icmp_unsigned("==", address, word(0)), ask, known)
    # Loop until an address is written: a signal may have interrupted the callback
    builder.position_at_end(ask)
    function_type = ir.FunctionType(ir.VoidType(), [word])
    resolver = cgutils.get_or_insert_function(builder.module, function_type, entry.symbol)
    builder.call(resolver, [builder.ptrtoint(place, word)])
    builder.branch(look)
    builder.position_at_end(known)
    with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", address, word(_FAILED))):
        builder.store(word(0), place)
        text = f"{entry.module}.{entry.name} could not be compiled; see the error that was logged"
        context.call_conv.return_user_exc(builder, RuntimeError, (text,))
    return invoke(context, builder, address, entry.result, entry.arguments, values)
