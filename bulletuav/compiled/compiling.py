"""How functions are compiled in less time than numba takes: fewer forms, and less of each."""

import contextlib
import gc
from collections.abc import Iterator
from typing import Any

import llvmlite.binding as llvm
from numba.core import cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

OBJECTS = 20_000
"""New objects before Python looks for garbage while it compiles; Python's own number is far less"""


def any_number(kind: Any) -> Any:
    """Give the type of all numbers for that of a single one; other types as they are."""
    is_single = isinstance(kind, (types.IntegerLiteral, types.BooleanLiteral))
    return kind.literal_type if is_single else kind


def invoke(
    context: Any, builder: Any, address: Any, result: Any, arguments: tuple[Any, ...], values: Any
) -> Any:
    """Write a call of what is at an address (a number), after which an error goes on up.

    Args:
        context: Numba's, as it gives both to who writes code.
        builder: As there.
        address: Where the function is.
        result: Numba's type of what it returns.
        arguments: Those of its arguments.
        values: The arguments.
    """
    form = context.call_conv.get_function_type(result, arguments)
    function = builder.inttoptr(address, form.as_pointer())
    status, done = context.call_conv.call_function(builder, function, result, arguments, values)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return done


@contextlib.contextmanager
def seldom_collected() -> Iterator[None]:
    """Let Python look for garbage less often.

    Compilation makes many objects, of which most stay: a tenth of its time goes into searches.
    """
    usual = gc.get_threshold()
    # 0 is never
    if 0 < usual[0] < OBJECTS:
        gc.set_threshold(OBJECTS, 50, 50)
    try:
        yield
    finally:
        gc.set_threshold(*usual)


class _Part(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """Code of a function that callers copy, for LLVM.

    Numba makes machine code of it by itself, too, which nobody would call. That takes a tenth of
    all that compilation takes.
    """

    def _optimize_final_module(self) -> None:
        """Leave it as it is: it is optimised where it is copied to."""

    def _finalize_final_module(self) -> None:
        """Keep the code for callers, and make machine code of its variable alone.

        Numba writes the address of the function's environment there.
        """
        # Before they are gone: code with addresses of this process is not stored
        self._finalize_dynamic_globals()
        self._finalized = True
        variables = map(str, self._get_module_for_linking().global_variables)
        kept = [one for one in variables if "_ZN08NumbaEnv" in one.partition("=")[0]]
        self._final_module = llvm.parse_assembly("\n".join(kept))
        super()._finalize_final_module()


class PartCompiler(Compiler):  # type: ignore[misc]  # numba has no types
    """Compiles a function that callers copy."""

    def _compile_core(self) -> Any:
        """Take a library of ours instead of numba's."""
        state = self.state
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super()._compile_core()
