"""Compilation of the hot loops by numba, with a cache on disk that cannot go stale.

`kernel` compiles loops over arrays, `allocating` those that make arrays, `func` the functions of
one drone that they call, and `elementwise` functions of numbers that broadcast over arrays. How
they are stored and linked is documented in `bulletuav.compiled.dispatcher`.
"""

import contextlib
import functools
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast, overload

import numba
import numpy as np
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate

from bulletuav.compiled.dispatcher import Cache, Dispatcher
from bulletuav.compiled.plain import SWITCH, in_python, plain_function

Function = TypeVar("Function", bound=Callable[..., Any])
"""Type of a function that is compiled; the decorators keep its signature."""

_OPTIONS = {"nopython": True, "boundscheck": None, "error_model": "numpy"}
_FOLDERS_KEPT = 8
_ONE_BY_ONE = 20_000
"""Numbers that take a tenth of the time in which numba makes a function of arrays"""


def cache_folder() -> Path:
    """Make the folder for the compiled kernels of this installation of the package.

    It is below `NUMBA_CACHE_DIR`, or else below the user's cache folder. Where neither can be
    written to, it is below the folder for temporary files, if nobody else can write there: what
    numba reads from its cache can run code.

    Raises:
        OSError: No folder can be written to.
    """
    chosen = (
        numba.config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    )
    user = os.getuid() if hasattr(os, "getuid") else ""
    spare = Path(tempfile.gettempdir(), f"bulletuav-{user}")
    candidates = [Path(chosen), spare]
    installation = hashlib.sha256(os.fsencode(Path(__file__).parents[1])).hexdigest()[:16]
    for base in candidates:
        folder = base / "bulletuav-kernels" / installation
        with contextlib.suppress(OSError):
            # Others may write to the folder for temporary files, but must not to ours in it.
            if base == spare and not _is_private(spare):
                continue
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                _forget_old_folders(folder)
                return folder
    raise OSError(
        f"no writable folder for compiled kernels among {candidates}; set NUMBA_CACHE_DIR to one"
    )


def _is_private(folder: Path) -> bool:
    """Make a folder, and tell whether only this user can write to it."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.lstat()
    others_write = stat.S_IMODE(about.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
    is_ours = not hasattr(os, "getuid") or about.st_uid == os.getuid()
    return stat.S_ISDIR(about.st_mode) and not others_write and is_ours


def _forget_old_folders(current: Path) -> None:
    """Remove the folders of other installations, but for the ones used last."""
    # Another process may be tidying too: what it has removed is no error.
    with contextlib.suppress(OSError):
        os.utime(current)
        others = [path for path in current.parent.iterdir() if path != current]
        newest_first = sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)
        for path in newest_first[_FOLDERS_KEPT - 1 :]:
            shutil.rmtree(path, ignore_errors=True)


_CACHE = cache_folder()


def kernel(function: Function) -> Function:
    """Compile a loop over arrays, cached on disk until its file, or one it imports, changes.

    Division by zero gives inf or NaN as in numpy. Nothing is reordered (no fast-math), so results
    are reproducible. It makes and returns no arrays of its own. So references to those that it is
    given need not be counted, which can take longer than the work.
    """
    return _compiled(function, forceinline=False, _nrt=False)


def func(function: Function) -> Function:
    """Compile a function of one drone's numbers, which becomes part of every kernel that calls it.

    Numbers are computed as in `kernel`, and arrays treated as there.
    """
    return _compiled(function, forceinline=True, _nrt=False)


def allocating(function: Function) -> Function:
    """Compile a loop as `kernel` does that makes arrays, or calls one that returns some."""
    return _compiled(function, forceinline=False, _nrt=True)


def uncached(function: Function, forceinline: bool = False) -> Function:
    """Compile a function anew in each process: one of users, whose source may be a text.

    Args:
        function: The function.
        forceinline: Whether it becomes part of its callers.
    """
    options = {**_OPTIONS, "forceinline": forceinline}
    return cast(Function, Dispatcher(function, targetoptions=options))


class Elementwise:
    """A compiled function of numbers, which also takes arrays.

    Numba makes a function of arrays anew in each process, in a third of a second. So the first
    numbers of arrays are computed one by one.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Take a function of numbers; see `elementwise`."""
        functools.update_wrapper(self, function)
        self._function = function
        self._left = _ONE_BY_ONE

    @overload
    def __call__(self, *numbers: float) -> float: ...  # type: ignore[overload-overlap]  # by intent
    @overload
    def __call__(self, *numbers: float | np.ndarray) -> np.ndarray: ...
    def __call__(self, *numbers: Any) -> Any:
        """Compute it, of numbers or of arrays."""
        if SWITCH.is_on:
            return np.vectorize(self.plain, otypes=[np.float64])(*numbers)[()]
        # A list: a generator that is left early would swallow an interrupt
        if all([isinstance(number, float | int) for number in numbers]):  # noqa: C419
            return np.float64(self._of_numbers(*map(float, numbers)))
        if self._left > 0:
            arrays = list(map(np.asarray, numbers))
            self._left -= np.broadcast(*arrays).size
            # Those of which a function of arrays would give the same type and order in memory
            is_plain = all(one.ndim < 2 or one.flags.c_contiguous for one in arrays)
            if is_plain and np.result_type(*arrays) == np.float64:
                return np.vectorize(self._of_numbers, otypes=[np.float64])(*arrays)[()]
        return self._of_arrays(*numbers)

    @functools.cached_property
    def plain(self) -> Callable[..., Any]:
        """The function of numbers as plain Python."""
        return plain_function(self._function)

    @functools.cached_property
    def _of_numbers(self) -> Any:
        return _compiled(self._function, forceinline=False, _nrt=False)

    @functools.cached_property
    def _of_arrays(self) -> Any:
        # Numba gets ready to compile: it writes a loop, also around stored machine code
        cpu_target.target_context.refresh()
        made = numba.vectorize(nopython=True)(self._function)
        made._dispatcher.cache = Cache(self._function, _CACHE, "-elementwise")
        return made

    @property
    def _numba_type_(self) -> Any:
        """What compiled callers find under the function's name."""
        return cpu_target.typing_context.resolve_value_type(self._of_arrays)


def elementwise(function: Callable[..., Any]) -> Elementwise:
    """Compile a function of numbers to a number, which also takes arrays that broadcast.

    Kernels call it with numbers, users with arrays. It takes no keywords: numbers come in order.
    """
    return Elementwise(function)


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return the code that takes the owner out of an array, or of all arrays in a tuple."""
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
    """Return arrays, or tuples of them, for which nobody counts references.

    Whoever takes an array out of a tuple counts a reference to it, which can cost more than what
    is done with it. The caller keeps the arrays alive.
    """

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, value, arguments[0])

    return value(value), generate


class InMemory(numba.types.Type):  # type: ignore[misc]  # numba has no types
    """Type of a named tuple of which compiled functions hand on the address; see `in_memory`.

    Attributes:
        whole: Type of the named tuple.
    """

    def __init__(self, whole: Any) -> None:
        """Tell the type of the named tuple."""
        self.whole = whole
        super().__init__(f"in memory {whole.name}")


@numba.extending.register_model(InMemory)
class _Address(numba.extending.models.PrimitiveModel):  # type: ignore[misc]
    """How `InMemory` is passed: as an address."""

    def __init__(self, manager: Any, kind: InMemory) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)


_NAMED = (numba.types.NamedTuple, numba.types.NamedUniTuple)
"""Numba's types of named tuples"""


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
    """Return the code that reads one field, or tells the address of one that is a tuple."""
    k = kind.whole.fields.index(name)
    whole = builder.bitcast(address, context.get_value_type(kind.whole).as_pointer())
    field = cgutils.gep_inbounds(builder, whole, 0, k)
    if isinstance(kind.whole.types[k], _NAMED):
        return builder.bitcast(field, cgutils.voidptr_t)
    return builder.load(field)


def _store_parts(builder: Any, kind: Any, value: Any, place: Any) -> None:
    """Write a tuple part by part: as one value of hundreds of words it takes long to compile."""
    if not isinstance(kind, numba.types.BaseTuple):
        builder.store(value, place)
        return
    for k, part in enumerate(kind):
        field = cgutils.gep_inbounds(builder, place, 0, k)
        _store_parts(builder, part, builder.extract_value(value, k), field)


@in_python(lambda value: value)
@numba.extending.intrinsic  # type: ignore[untyped-decorator]
def in_memory(_: Any, value: Any) -> Any:
    """Return a named tuple of which others are given the address, and read what they need.

    A tuple of arrays is hundreds of words, which every call would copy. Nobody counts references
    to its arrays, as with `borrowed`. It must not leave the function that calls this, which keeps
    the arrays alive. Its fields are read by name.
    """
    if isinstance(value, InMemory):
        return value(value), lambda _, __, ___, arguments: arguments[0]

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        place = cgutils.alloca_once(builder, context.get_value_type(value))
        _store_parts(builder, value, _without_owner(context, builder, value, arguments[0]), place)
        return builder.bitcast(place, cgutils.voidptr_t)

    return InMemory(value)(value), generate


def _compiled(function: Function, **options: bool) -> Function:
    """Compile a function with numba's options, and keep it on disk."""
    compiled = Dispatcher(function, targetoptions={**_OPTIONS, **options})
    compiled.keep_in(_CACHE)
    return cast(Function, compiled)
