"""Numba dispatchers that compile, cache and link each kernel once.

Plain numba copies the machine code of every function that is called into each of its callers, and
optimises and stores the copy again there. For calls nested ten deep, as in the contact solver, that
takes ten times as long. Here a kernel is compiled once, and its callers are linked to its symbol,
as functions of different object files are. Inlined functions (`func`) are copied as before.

Numba also generates a wrapper that unpacks Python arguments. For tuples of arrays the wrapper is
longer than the function itself. Here only functions that Python calls get a wrapper.

Numba invalidates cached code by the function's own file only; see `bulletuav.compiled.stamps`.
"""

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import re
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from multiprocessing import current_process
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, ClassVar, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numba.core import sigutils, types
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.runtime import _nrt_python
from numba.core.serialize import dumps

from bulletuav.compiled.compiling import PartCompiler, any_number, seldom_collected
from bulletuav.compiled.plain import SWITCH, as_compiled, plain_function
from bulletuav.compiled.shipped import CODE
from bulletuav.compiled.stamps import stamp_of

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None

# A child process forked while another thread compiles would inherit a locked lock
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )

_LOG = logging.getLogger(__name__)
MANY = 20
"""Number of functions that a process compiles before it logs the reason of the delay"""
FIRST = ("MainProcess", "-1")
"""Suffixes of the names of processes that log it: the main process and the first worker"""
PATIENCE = 300.0
"""Time after which a process that holds a compilation lock is assumed to be stopped, s"""


class Compilation:
    """Count and time of the functions that a process has compiled.

    Attributes:
        num_functions: Number of functions that were compiled, not loaded from the cache.
        watch: Callback that is called with this object after each compiled function, instead of
            the message that is logged once.
    """

    def __init__(self) -> None:
        """Start with a count of 0."""
        self.num_functions = 0
        self.watch: Callable[[Compilation], None] | None = None
        self._depth, self._begin, self._seconds = 0, 0.0, 0.0

    @property
    def seconds(self) -> float:
        """Time spent on compilation, including a compilation that is running, s."""
        running = time.monotonic() - self._begin if self._depth else 0.0
        return self._seconds + running

    def forget_watch(self) -> None:
        """Remove the callback."""
        self.watch = None

    @contextlib.contextmanager
    def count(self) -> Iterator[None]:
        """Count a function that is compiled in the `with` block; blocks may be nested."""
        if self._depth == 0:
            self._begin = time.monotonic()
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                self._seconds += time.monotonic() - self._begin
        self.num_functions += 1
        if self.watch is not None:
            self.watch(self)
        elif self.num_functions == MANY and current_process().name.endswith(FIRST):
            _LOG.warning(
                "compiling for this machine, for a minute or two; later runs start immediately "
                "(bulletuav compile compiles everything at once)"
            )


COMPILATION = Compilation()
"""Compilation count of this process"""
if hasattr(os, "register_at_fork"):
    # Workers must not write between the lines of the process that shows progress
    os.register_at_fork(after_in_child=COMPILATION.forget_watch)


class Need(NamedTuple):
    """A compiled function that other machine code is linked to.

    Attributes:
        module: Name of the function's module.
        name: Name of the function in its module.
        arguments: Numba types of the arguments.
        symbol: Symbol of the function in machine code.
    """

    module: str
    name: str
    arguments: tuple[Any, ...]
    symbol: str

    def is_met(self) -> bool:
        """Compile or load the function, and check whether it has the expected symbol."""
        found = dispatcher_of(self.module, self.name)
        if found is None:
            return False
        return bool(found.compiled(self.arguments).fndesc.mangled_name == self.symbol)


class Cache:
    """Machine code of a function on disk, with a stamp of all files that the function depends on.

    Each specialisation is a separate file, and the file name identifies it: by names, contents and
    versions, so that it is the same wherever the package is. Files that come with the package (see
    `bulletuav.compiled.shipped`) are only read, others are in the cache folder. Numba's own cache
    reads an index first, and sets up the compiler before it looks for stored code.
    """

    _locks: ClassVar[dict[Path, int]] = {}
    """Open lock file of each folder in which this process compiles; closing it frees its locks"""

    def __init__(
        self, function: Callable[..., Any], folder: Path, suffix: str = "", apart: bool = False
    ) -> None:
        """Create the cache of a function; files are read only on demand.

        Args:
            function: The function.
            folder: Folder of its machine code.
            suffix: Distinguishes two variants of a function.
            apart: Whether callers are linked to the function instead of copying it.
        """
        self._py_func, self._folder, self._suffix = function, folder, suffix
        self._apart = apart

    @property
    def cache_path(self) -> str:
        """Folder of the machine code; numba reports it with its statistics."""
        return str(self._folder)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Load the machine code for a signature; None if it is not stored."""
        file = self._file(signature, context)
        files = [file] if CODE is None else [CODE / file.name, file]
        found = (self._load(one, context) for one in files)
        return next((one for one in found if one is not None), None)

    def _load(self, file: Path, context: Any) -> Any:
        """Load the machine code in a file; None if the file is absent, damaged or outdated."""
        try:
            # A damaged file, as after a crash of the system, has another checksum
            data = zlib.decompress(file.read_bytes())
        except (OSError, zlib.error):
            return None
        _name_helpers()
        if b"hashsecret" in data:
            # Numba registers these symbols when it imports this module, which is slow
            import_module("numba.cpython.hashing")
        # Unpickling is safe: only this user, or the one who installed the package, wrote the file
        needs, payload = pickle.loads(data)
        if not all(need.is_met() for need in needs):
            return None
        compiled = CompileResult._rebuild(context, *payload)
        compiled.library.needs = needs
        self._link(compiled)
        return compiled

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store the machine code for a signature."""
        library = compiled.library
        linked = (need for other in library._linking_libraries for need in _asked(other))
        library.needs = tuple(dict.fromkeys((*getattr(library, "deferred_entries", ()), *linked)))
        if self._is_apart() or not self._suffix:
            # Callers, if any, copy these stubs, of which numba reads only the names
            names = [compiled.fndesc.mangled_name]
            names += [] if self._suffix else [compiled.fndesc.llvm_cpython_wrapper_name]
            stubs = (f'define void @"{name}"() {{ ret void }}' for name in names)
            library._shared_module = llvm.parse_assembly("\n".join(stubs))
        # Addresses of this process are invalid in another process
        if not library.has_dynamic_globals:
            file = self._file(signature, compiled.target_context)
            try:
                # Without the annotated source, which has paths of this computer
                reduced = compiled._replace(type_annotation="")._reduce()
                _replace(file, zlib.compress(dumps((library.needs, reduced))))
                self._forget_old(file)
            except OSError as error:
                _warn_once(f"{error}: compiled functions are not stored for later runs")
        self._link(compiled)

    @contextlib.contextmanager
    def alone(self, signature: Any, context: Any) -> Iterator[None]:
        """Lock a specialisation, so that other processes do not compile it at the same time.

        They would compile it under another symbol, and the next process would have to compile the
        callers again. Other functions are not locked. Functions are not recursive, so that the
        locks cannot deadlock. Without locks, or without a writable folder, processes compile
        independently.
        """
        name = self._file(signature, context).name.encode()
        place = int(hashlib.sha256(name).hexdigest()[:15], 16)
        lock = None
        with contextlib.suppress(OSError):
            if fcntl is not None and self._folder not in self._locks:
                file = self._folder / ".lock"
                self._locks[self._folder] = os.open(file, os.O_CREAT | os.O_RDWR, 0o600)
            lock = self._locks.get(self._folder)
            if lock is not None:
                _wait_for(lock, place)
        try:
            with seldom_collected():
                yield
        finally:
            if fcntl is not None and lock is not None:
                with contextlib.suppress(OSError):
                    fcntl.lockf(lock, fcntl.LOCK_UN, 1, place)

    def _file(self, signature: Any, context: Any) -> Path:
        """Return the path of the file for a signature."""
        function = self._py_func
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        kinds = repr(sigutils.normalize_signature(signature))
        key = hashlib.sha256(f"{kinds} {_machine(context.codegen())}".encode())
        code = function.__code__
        key.update(code.co_code)
        # Two functions of the same line may differ only in these
        constants = [one for one in code.co_consts if not isinstance(one, CodeType | frozenset)]
        key.update(repr((constants, code.co_names)).encode())
        key.update(dumps(cells) if cells else b"")
        stamp = stamp_of(function.__code__.co_filename)
        return self._folder / f"{self._base}.{stamp}.{key.hexdigest()[:24]}.nbc"

    @functools.cached_property
    def _base(self) -> str:
        """Prefix of the names of all files of the function."""
        function = self._py_func
        code = function.__code__
        place = (
            f"{function.__module__} {function.__qualname__} {code.co_firstlineno} {self._suffix}"
        )
        name = re.sub(r"\W", "", function.__name__)
        return f"{name}-{hashlib.sha256(place.encode()).hexdigest()[:12]}"

    def _forget_old(self, file: Path) -> None:
        """Remove machine code of the function with other stamps."""
        stamp = file.name.split(".")[1]
        for other in self._folder.glob(f"{self._base}.*"):
            if other.name.split(".")[1] != stamp:
                other.unlink(missing_ok=True)

    def _is_apart(self) -> bool:
        """Check whether callers are linked to the function: they must find it in its module."""
        home = sys.modules.get(self._py_func.__module__)
        found = getattr(home, self._py_func.__name__, None)
        return self._apart and getattr(found, "py_func", None) is self._py_func

    def _link(self, compiled: Any) -> None:
        """Set the dependencies of a library's callers, and remove the code that they would copy."""
        library, function = compiled.library, self._py_func
        library.asked = library.needs
        if self._is_apart():
            library._shared_module = llvm.parse_assembly("")
            arguments = tuple(compiled.signature.args)
            symbol = compiled.fndesc.mangled_name
            library.asked = (Need(function.__module__, function.__name__, arguments, symbol),)


@functools.cache
def _name_helpers() -> None:
    """Register with LLVM the runtime functions of numba that stored machine code calls.

    Numba registers them when it sets up the compiler, which takes longer than loading all kernels.
    """
    for name, address in _nrt_python.c_helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@functools.cache
def _warn_once(text: str) -> None:
    """Log a warning once in a process."""
    _LOG.warning(text)


def _wait_for(lock: int, place: int) -> None:
    """Lock a byte of a file; give up after `PATIENCE` seconds.

    The byte need not exist.
    """
    assert fcntl is not None
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        # The lock ends with the process, and forks do not inherit it
        with contextlib.suppress(BlockingIOError):
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            return
        time.sleep(0.02)


def _replace(file: Path, data: bytes) -> None:
    """Write a file atomically: another process may read or write it at the same time."""
    part = file.with_name(f".part-{os.getpid()}-{file.name}")
    try:
        part.write_bytes(data)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def _asked(library: Any) -> tuple[Need, ...]:
    """Return the functions that callers of a library must be linked to; none for numba's own."""
    return getattr(library, "asked", ())


class _Stored(CPUDispatcher):  # type: ignore[misc]  # numba has no types
    """A numba dispatcher that looks for stored machine code before it sets up the compiler."""

    def compile(self, sig: Any) -> Any:
        """Load or compile the machine code for a signature, and return its entry point.

        Numba's own method also measures the time of each call of LLVM, which is slower.
        """
        kinds, result = sigutils.normalize_signature(sig)
        with global_compiler_lock:
            if kinds not in self.overloads and isinstance(self._cache, Cache):
                found = self._cache.load_overload(sig, self.targetctx)
                if found is None:
                    # Another process may have compiled it while this process waited for the lock
                    with self._cache.alone(sig, self.targetctx):
                        found = self._cache.load_overload(sig, self.targetctx)
                        if found is None:
                            return self._make(sig, kinds, result)
                self._cache_hits[sig] += 1
                self.targetctx.insert_user_function(
                    found.entry_point, found.fndesc, [found.library]
                )
                self.add_overload(found)
        return super().compile(sig)

    def _make(self, sig: Any, kinds: Any, result: Any) -> Any:
        """Compile and store the machine code for a signature, and return its entry point."""
        with COMPILATION.count(), self._compiling_counter:
            self._cache_misses[sig] += 1
            made = self._compiler.compile(kinds, result)
            # Store and link it before callers can find it, even if an interrupt follows
            self._cache.save_overload(sig, made)
            self.add_overload(made)
        return made.entry_point

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Find the specialisation for a call, with one for all literals of a type.

        Numba would compile one specialisation for each literal number.
        """
        named = {name: any_number(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(any_number, args)), named)


class Dispatcher(_Stored):
    """A compiled function that Python and compiled code can call.

    Attributes:
        deferred_type: Numba type of the function for compiled callers if it is deferred, else None;
            see `bulletuav.compiled.deferred`.
    """

    deferred_type: Any = None
    _folder: Path | None = None
    _inner: Any = None

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: Mapping[str, Any] | None = None,
        targetoptions: Mapping[str, Any] | None = None,
        pipeline_class: type = Compiler,
    ) -> None:
        """Create the dispatcher; the function is compiled when it is called.

        Args:
            py_func: The Python function.
            locals: Numba types of local variables.
            targetoptions: Options of numba.
            pipeline_class: Numba's compiler class.
        """
        options = {**(targetoptions or {}), "no_cfunc_wrapper": True}
        super().__init__(py_func, dict(locals or {}), options, pipeline_class)

    @property
    def inner(self) -> Any:
        """Dispatcher of the same function for compiled callers, without a wrapper for Python."""
        # All threads must share one dispatcher, as callers are linked to its symbols
        with global_compiler_lock:
            if self._inner is None:
                self._inner = self._make_inner()
            return self._inner

    @functools.cached_property
    def plain(self) -> Callable[..., Any]:
        """Plain Python version of the function; see `bulletuav.compiled.plain`."""
        return plain_function(self.py_func)

    def _make_inner(self) -> _Stored:
        """Create the dispatcher for compiled callers."""
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        apart = not options.get("forceinline")
        pipeline = Compiler if apart else PartCompiler
        made = _Stored(self.py_func, dict(self.locals), options, pipeline)
        if self._folder is not None:
            made._cache = Cache(self.py_func, self._folder, "-inner", apart)
        return made

    @property
    def _numba_type_(self) -> Any:
        """Numba type of the function for compiled callers."""
        return self.deferred_type or types.Dispatcher(self.inner)

    def compiled(self, arguments: tuple[Any, ...]) -> Any:
        """Compile or load the specialisation for compiled callers, and return numba's result.

        Args:
            arguments: Numba types of the arguments.
        """
        self.inner.compile(arguments)
        return self.inner.overloads[arguments]

    def address(self, arguments: tuple[Any, ...]) -> int:
        """Return the address of the specialisation for types of arguments."""
        made = self.compiled(arguments)
        place: int = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
        return place

    def keep_in(self, folder: Path) -> None:
        """Cache the machine code of the function, with and without wrapper, in a folder."""
        self._folder = folder
        self._cache = Cache(self.py_func, folder)


def _switched(dispatcher: Dispatcher, *arguments: Any, **named: Any) -> Any:
    """Call a function from Python, as plain Python if the switch is on."""
    if not SWITCH.is_on:
        return CPUDispatcher.__call__(dispatcher, *arguments, **named)
    named = {name: as_compiled(value) for name, value in named.items()}
    return dispatcher.plain(*as_compiled(arguments), **named)


@contextlib.contextmanager
def plain_kernels() -> Iterator[None]:
    """Run kernels that this thread calls in the `with` block as plain Python.

    With `NUMBA_DISABLE_JIT=1` all kernels always run as plain Python.
    """
    # Set only when needed, as calls from Python take three times as long with it
    if "__call__" not in vars(Dispatcher):
        Dispatcher.__call__ = _switched
    before, SWITCH.is_on = SWITCH.is_on, True
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        SWITCH.is_on = before


if SWITCH.is_on:
    Dispatcher.__call__ = _switched


def dispatcher_of(module: str, name: str) -> Dispatcher | None:
    """Return the compiled function of that name in a module; None if there is none."""
    found = getattr(import_module(module), name, None)
    return found if isinstance(found, Dispatcher) else None


@functools.cache
def _machine(codegen: Any) -> str:
    """Describe the Python version and the processor that machine code is compiled for."""
    return repr((sys.implementation.cache_tag, codegen.magic_tuple()))
