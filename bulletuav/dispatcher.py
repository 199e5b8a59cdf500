"""What numba does with a function of ours: compile it once, store it, and link it.

Plain numba copies the machine code of every function that is called into each of its callers, and
optimizes and stores the copy again there. Where calls are nested ten deep, as in contacts, that
takes ten times as long. Here a kernel is compiled once. Its callers call it where it is, as
functions of different object files call each other. Functions that become part of their callers
(`func`) are copied as before.

Numba also writes a wrapper that takes apart what Python gives, which for tuples of arrays is longer
than the function itself. Here only what Python calls gets one.

And numba stamps what it stores with the function's own file alone, so that it survives an edit of
a helper in another file. Here the stamp covers all files that the function's file imports.
"""

import functools
import hashlib
import inspect
import itertools
import logging
import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

MANY = 20
"""Functions that a process compiles before it tells why nothing else happens"""
_IMPORT = re.compile(
    rb"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+([\w.]+))", re.MULTILINE
)


class Need(NamedTuple):
    """A function that machine code calls where it is.

    Attributes:
        module: Name of its module.
        name: Its name there.
        arguments: Numba's types of its arguments.
        symbol: Its name in the machine code.
    """

    module: str
    name: str
    arguments: tuple[Any, ...]
    symbol: str

    def is_met(self) -> bool:
        """Compile or load the function, and tell whether that gives it under the same symbol."""
        found = getattr(import_module(self.module), self.name, None)
        if not isinstance(found, Dispatcher):
            return False
        compiled = found.inner
        compiled.compile(self.arguments)
        return bool(compiled.overloads[self.arguments].fndesc.mangled_name == self.symbol)


class _Stored(CompileResultCacheImpl):  # type: ignore[misc]  # numba has no types
    """Machine code on disk, with what it needs: that is loaded first."""

    def reduce(self, compiled: Any) -> Any:
        """Return what is stored."""
        return compiled.library.needs, super().reduce(compiled)

    def rebuild(self, context: Any, stored: Any) -> Any:
        """Load machine code; None where what it needs is not there, so that it is made anew."""
        needs, payload = stored
        if not all(need.is_met() for need in needs):
            return None
        compiled = super().rebuild(context, payload)
        compiled.library.needs = needs
        return compiled


class Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """Numba's cache of a function, with a stamp of all files that the function depends on."""

    _impl_class = _Stored
    _made = itertools.count(1)

    def __init__(self, function: Callable[..., Any], suffix: str = "", apart: bool = False) -> None:
        """Open the cache of a function.

        Args:
            function: The function.
            suffix: Tells two forms of a function from each other.
            apart: Whether callers call it where it is.
        """
        super().__init__(function)
        name = self._impl.filename_base + suffix
        stamp = stamp_of(Path(inspect.getfile(function)))
        self._cache_file = IndexDataCacheFile(self.cache_path, name, stamp)
        self._apart = apart

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Load machine code for some types of arguments; None where there is none."""
        compiled = super().load_overload(signature, context)
        if compiled is not None:
            self._link(compiled)
        return compiled

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store machine code."""
        library = compiled.library
        linked = (need for other in library._linking_libraries for need in _asked(other))
        library.needs = tuple(dict.fromkeys(linked))
        if self._is_apart():
            # What is stored for callers to copy: the name alone, which numba reads
            name = compiled.fndesc.mangled_name
            library._shared_module = llvm.parse_assembly(f'define void @"{name}"() {{ ret void }}')
        super().save_overload(signature, compiled)
        self._link(compiled)
        if next(self._made) == MANY:
            logging.getLogger(__name__).warning(
                "compiling for this machine, for a minute or two; later runs start at once"
            )

    def _is_apart(self) -> bool:
        """Tell whether callers call it where it is: if they can find it again."""
        home = sys.modules.get(self._py_func.__module__)
        found = getattr(home, self._py_func.__name__, None)
        return self._apart and getattr(found, "py_func", None) is self._py_func

    def _link(self, compiled: Any) -> None:
        """Tell a library what its callers need, and take away what they would copy."""
        library, function = compiled.library, self._py_func
        library.asked = library.needs
        if self._is_apart():
            library._shared_module = llvm.parse_assembly("")
            arguments = tuple(compiled.signature.args)
            symbol = compiled.fndesc.mangled_name
            library.asked = (Need(function.__module__, function.__name__, arguments, symbol),)


def _asked(library: Any) -> tuple[Need, ...]:
    """Tell what is needed by whoever links a library; numba's own need nothing."""
    return getattr(library, "asked", ())


class Dispatcher(CPUDispatcher):  # type: ignore[misc]  # numba has no types
    """A compiled function as Python calls it.

    Attributes:
        inner: The same function for callers that are compiled, without a wrapper for Python.
    """

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: Mapping[str, Any] | None = None,
        targetoptions: Mapping[str, Any] | None = None,
        pipeline_class: type = Compiler,
    ) -> None:
        """Prepare both; neither is compiled before it is called."""
        options = {**(targetoptions or {}), "no_cfunc_wrapper": True}
        bare = {**options, "no_cpython_wrapper": True}
        chosen = dict(locals or {})
        super().__init__(py_func, chosen, options, pipeline_class)
        self.inner = CPUDispatcher(py_func, chosen, bare, pipeline_class)

    @property
    def _numba_type_(self) -> Any:
        """What compiled callers find under the function's name."""
        return types.Dispatcher(self.inner)

    def enable_caching(self) -> None:
        """Keep both on disk."""
        apart = not self.targetoptions.get("forceinline")
        self._cache = Cache(self.py_func)
        self.inner._cache = Cache(self.py_func, "-inner", apart)


@functools.cache
def stamp_of(path: Path) -> str:
    """Hash a file, all files that it imports of its package, and those that they import.

    Args:
        path: The file.

    Returns:
        16 hexadecimal digits, with the version of numba in them.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    seen = {path}
    waiting = [*seen]
    while waiting:
        for imported in _imported(waiting.pop()) - seen:
            seen.add(imported)
            waiting.append(imported)
    for file in sorted(seen):
        digest.update(_hash(file))
    return digest.hexdigest()[:16]


@functools.cache
def _hash(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


@functools.cache
def _imported(file: Path) -> frozenset[Path]:
    """List the files of our package that a file imports, in whatever place of it."""
    package = Path(__file__).parent
    found: set[Path] = set()
    for source, names, module in _IMPORT.findall(file.read_bytes()):
        first, *rest = (source or module).decode().split(".")
        if first == package.name:
            place = package.joinpath(*rest)
            found |= {place.with_suffix(".py"), place / "__init__.py"}
            found |= {place / f"{name}.py" for name in re.findall(r"\w+", names.decode())}
    return frozenset(path for path in found if path.is_file() and path != package / "__init__.py")
