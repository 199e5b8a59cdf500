"""Decorators that compile the hot loops with numba, with a disk cache that cannot go stale.

`kernel` compiles loops over arrays, `allocating` loops that create arrays, `func` inlined functions
of one drone that the loops call, and `elementwise` functions of numbers that broadcast over arrays.
`bulletuav.compiled.dispatcher` documents how they are stored and linked.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast, overload

import numba
import numpy as np
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate

from bulletuav.compiled.dispatcher import Cache, Dispatcher
from bulletuav.compiled.folders import cache_folder
from bulletuav.compiled.plain import SWITCH, in_python, plain_function

Function = TypeVar("Function", bound=Callable[..., Any])
"""Type of a function that is compiled; the decorators keep its signature."""

_OPTIONS = {"nopython": True, "boundscheck": None, "error_model": "numpy"}
_ONE_BY_ONE = 20_000
"""Count of numbers whose evaluation takes a tenth of the time to compile a function of arrays"""

_CACHE = cache_folder()


def kernel(function: Function) -> Function:
    """Compile a loop over arrays, cached on disk until its file, or a file it imports, changes.

    Division by zero gives inf or NaN as in NumPy. Operations are not reordered (no fast-math), so
    that results are reproducible. A kernel neither creates nor returns arrays. References to its
    arguments are therefore not counted, which could take longer than the loop.
    """
    return _compiled(function, forceinline=False, _nrt=False)


def func(function: Function) -> Function:
    """Compile a function of one drone that is inlined into every kernel that calls it.

    The floating-point rules and the restrictions on arrays are those of `kernel`.
    """
    return _compiled(function, forceinline=True, _nrt=False)


def allocating(function: Function) -> Function:
    """Compile a loop as `kernel` does, which may create arrays or call functions that do."""
    return _compiled(function, forceinline=False, _nrt=True)


def uncached(function: Function, forceinline: bool = False) -> Function:
    """Compile a user's function, without a cache on disk, as it may have no source file.

    Args:
        function: The function.
        forceinline: Whether the function is inlined into its callers.
    """
    options = {**_OPTIONS, "forceinline": forceinline}
    return cast(Function, Dispatcher(function, targetoptions=options))


class Elementwise:
    """A compiled function of numbers, which broadcasts over arrays.

    Numba compiles a function of arrays again in each process, which takes a third of a second.
    Therefore the first elements of arrays are computed one by one.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a function of numbers; see `elementwise`."""
        functools.update_wrapper(self, function)
        self._function = function
        self._left = _ONE_BY_ONE

    @overload
    def __call__(self, *numbers: float) -> float: ...  # type: ignore[overload-overlap]  # by intent
    @overload
    def __call__(self, *numbers: float | np.ndarray) -> np.ndarray: ...
    def __call__(self, *numbers: Any) -> Any:
        """Evaluate the function for numbers, or elementwise for arrays."""
        if SWITCH.is_on:
            return np.vectorize(self.plain, otypes=[np.float64])(*numbers)[()]
        # A list, as a generator that is not exhausted would swallow an interrupt
        if all([isinstance(number, float | int) for number in numbers]):  # noqa: C419
            return np.float64(self._of_numbers(*map(float, numbers)))
        if self._left > 0:
            arrays = list(map(np.asarray, numbers))
            self._left -= np.broadcast(*arrays).size
            # Arrays for which a compiled function of arrays has the same result type and layout
            is_plain = all(one.ndim < 2 or one.flags.c_contiguous for one in arrays)
            if is_plain and np.result_type(*arrays) == np.float64:
                return np.vectorize(self._of_numbers, otypes=[np.float64])(*arrays)[()]
        return self._of_arrays(*numbers)

    @functools.cached_property
    def plain(self) -> Callable[..., Any]:
        """Plain Python version of the function of numbers."""
        return plain_function(self._function)

    @functools.cached_property
    def _of_numbers(self) -> Any:
        return _compiled(self._function, forceinline=False, _nrt=False)

    @functools.cached_property
    def _of_arrays(self) -> Any:
        # Set up the compiler: numba generates a loop even around stored machine code
        cpu_target.target_context.refresh()
        made = numba.vectorize(nopython=True)(self._function)
        made._dispatcher.cache = Cache(self._function, _CACHE, "-elementwise")
        return made

    @property
    def _numba_type_(self) -> Any:
        """Numba type of the function for compiled callers."""
        return cpu_target.typing_context.resolve_value_type(self._of_arrays)


def elementwise(function: Callable[..., Any]) -> Elementwise:
    """Compile a function of numbers, which also broadcasts over arrays.

    Kernels call the function with numbers, Python code also with arrays. Arguments are passed by
    position only.
    """
    return Elementwise(function)


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Generate code that removes the owner from an array, or from all arrays in a tuple."""
    if isinstance(kind, numba.types.Array):
        array = cgutils.create_struct_proxy(kind)(context, builder, value=value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    if isinstance(kind, numba.types.BaseTuple):
        for k, part in enumerate(kind):
            stripped = _without_owner(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, stripped, k)
    return value


@in_python(lambda value: value)
@numba.extending.intrinsic  # type: ignore[untyped-decorator]
def borrowed(_: Any, value: Any) -> Any:
    """Return an array, or a tuple of arrays, without reference counting.

    Reading an array from a tuple normally increments its reference count, which can cost more than
    the work on the array. The caller must keep the arrays alive.
    """

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, value, arguments[0])

    return value(value), generate


class InMemory(numba.types.Type):  # type: ignore[misc]  # numba has no types
    """Numba type of a named tuple that compiled functions pass by its address; see `in_memory`.

    Attributes:
        whole: Numba type of the named tuple.
    """

    def __init__(self, whole: Any) -> None:
        """Create the type from the numba type of the named tuple."""
        self.whole = whole
        super().__init__(f"in memory {whole.name}")


@numba.extending.register_model(InMemory)
class _Address(numba.extending.models.PrimitiveModel):  # type: ignore[misc]
    """Data model of `InMemory`: an address."""

    def __init__(self, manager: Any, kind: InMemory) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)


_NAMED = (numba.types.NamedTuple, numba.types.NamedUniTuple)
"""Numba types of named tuples"""


@numba.extending.infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    """Types of the fields of an `InMemory`."""

    key = InMemory

    def generic_resolve(self, kind: InMemory, name: str) -> Any:
        if name not in kind.whole.fields:
            return None
        field = kind.whole.types[kind.whole.fields.index(name)]
        return InMemory(field) if isinstance(field, _NAMED) else field


@numba.extending.lower_getattr_generic(InMemory)  # type: ignore[untyped-decorator]
def _load_field(context: Any, builder: Any, kind: InMemory, address: Any, name: str) -> Any:
    """Generate code that reads one field, or returns the address of a field that is a tuple."""
    k = kind.whole.fields.index(name)
    whole = builder.bitcast(address, context.get_value_type(kind.whole).as_pointer())
    field = cgutils.gep_inbounds(builder, whole, 0, k)
    if isinstance(kind.whole.types[k], _NAMED):
        return builder.bitcast(field, cgutils.voidptr_t)
    return builder.load(field)


def _store_parts(builder: Any, kind: Any, value: Any, place: Any) -> None:
    """Generate code that stores a tuple by parts, as values of hundreds of words compile slowly."""
    if not isinstance(kind, numba.types.BaseTuple):
        builder.store(value, place)
        return
    for k, part in enumerate(kind):
        field = cgutils.gep_inbounds(builder, place, 0, k)
        _store_parts(builder, part, builder.extract_value(value, k), field)


@in_python(lambda value: value)
@numba.extending.intrinsic  # type: ignore[untyped-decorator]
def in_memory(_: Any, value: Any) -> Any:
    """Return a named tuple that is passed to compiled functions by address.

    A tuple of arrays is hundreds of words, which every call would copy. References to its arrays
    are not counted, as with `borrowed`. The tuple must not outlive the function that calls
    `in_memory`, and that function keeps the arrays alive. Fields are read by name.
    """
    if isinstance(value, InMemory):
        return value(value), lambda _, __, ___, arguments: arguments[0]

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        place = cgutils.alloca_once(builder, context.get_value_type(value))
        _store_parts(builder, value, _without_owner(context, builder, value, arguments[0]), place)
        return builder.bitcast(place, cgutils.voidptr_t)

    return InMemory(value)(value), generate


def _compiled(function: Function, **options: bool) -> Function:
    """Compile a function with numba's options and the cache on disk."""
    compiled = Dispatcher(function, targetoptions={**_OPTIONS, **options})
    compiled.keep_in(_CACHE)
    return cast(Function, compiled)
