"""Measures that shorten numba's compilation: fewer specialisations, and less code for each."""

import contextlib
import gc
from collections.abc import Iterator
from typing import Any

import llvmlite.binding as llvm
from numba.core import cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

OBJECTS = 20_000
"""Garbage collection threshold during compilation, new objects; far above Python's default"""


def any_number(kind: Any) -> Any:
    """Return the general type of a literal's type; other types unchanged."""
    is_single = isinstance(kind, (types.IntegerLiteral, types.BooleanLiteral))
    return kind.literal_type if is_single else kind


def invoke(
    context: Any, builder: Any, address: Any, result: Any, arguments: tuple[Any, ...], values: Any
) -> Any:
    """Generate a call of the function at an address; its errors are propagated to the caller.

    Args:
        context: Numba's target context.
        builder: LLVM's IR builder.
        address: Address of the function, an integer value.
        result: Numba type of the return value.
        arguments: Numba types of the arguments.
        values: LLVM values of the arguments.

    Returns:
        LLVM value of the result.
    """
    function_type = context.call_conv.get_function_type(result, arguments)
    function = builder.inttoptr(address, function_type.as_pointer())
    status, done = context.call_conv.call_function(builder, function, result, arguments, values)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return done


@contextlib.contextmanager
def seldom_collected() -> Iterator[None]:
    """Run garbage collection less often in the `with` block.

    Compilation creates many objects, most of which survive: garbage collection takes a tenth of
    its time.
    """
    usual = gc.get_threshold()
    # 0 disables garbage collection
    if 0 < usual[0] < OBJECTS:
        gc.set_threshold(OBJECTS, 50, 50)
    try:
        yield
    finally:
        gc.set_threshold(*usual)


class _Part(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """LLVM code library of a function that is inlined into its callers.

    Numba would also generate machine code of the function alone, which is never called. That takes
    a tenth of the compilation time.
    """

    def _optimize_final_module(self) -> None:
        """Do nothing: the code is optimised as part of its callers."""

    def _finalize_final_module(self) -> None:
        """Keep the code for callers, and generate machine code only for its environment variable.

        Numba writes the address of the function's environment there.
        """
        # Checked before the globals are removed: code with addresses of this process is not stored
        self._finalize_dynamic_globals()
        self._finalized = True
        variables = map(str, self._get_module_for_linking().global_variables)
        kept = [one for one in variables if "_ZN08NumbaEnv" in one.partition("=")[0]]
        self._final_module = llvm.parse_assembly("\n".join(kept))
        super()._finalize_final_module()


class PartCompiler(Compiler):  # type: ignore[misc]  # numba has no types
    """Compiler of functions that are inlined into their callers."""

    def _compile_core(self) -> Any:
        """Compile into a `_Part` instead of numba's code library."""
        state = self.state
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super()._compile_core()
