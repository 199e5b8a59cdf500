"""What numba does with a function of ours: compile it once, store it, and link it.

Plain numba copies the machine code of every function that is called into each of its callers, and
optimizes and stores the copy again there. Where calls are nested ten deep, as in contacts, that
takes ten times as long. Here a kernel is compiled once. Its callers call it where it is, as
functions of different object files call each other. Functions that become part of their callers
(`func`) are copied as before.

Numba also writes a wrapper that takes apart what Python gives, which for tuples of arrays is longer
than the function itself. Here only what Python calls gets one.

And numba stamps what it stores with the function's own file alone; see `bulletuav.compiled.stamps`.
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
from bulletuav.compiled.stamps import stamp_of

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None

# A child process forked while another thread compiles would wait for the lock forever
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )

_LOG = logging.getLogger(__name__)
MANY = 20
"""Functions that a process compiles before it logs why nothing else happens"""
FIRST = ("MainProcess", "-1")
"""Ends of the names of the processes that log it: of several workers the first"""
PATIENCE = 300.0
"""Time after which a process that compiles is taken for one that was stopped, s"""


class Compilation:
    """What a process has compiled so far.

    Attributes:
        num_functions: Functions that were compiled, and not loaded.
        watch: Called with this after each of them, in place of the line that is logged once.
    """

    def __init__(self) -> None:
        """Start with nothing."""
        self.num_functions = 0
        self.watch: Callable[[Compilation], None] | None = None
        self._depth, self._begin, self._seconds = 0, 0.0, 0.0

    @property
    def seconds(self) -> float:
        """Time that compilation has taken, with what goes on now, s."""
        running = time.monotonic() - self._begin if self._depth else 0.0
        return self._seconds + running

    def forget_watch(self) -> None:
        """Call nothing from now on."""
        self.watch = None

    @contextlib.contextmanager
    def count(self) -> Iterator[None]:
        """Count a function that is compiled meanwhile, within its callers or not."""
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
                "compiling for this machine, for a minute or two; later runs start at once"
            )


COMPILATION = Compilation()
"""That of this process"""
if hasattr(os, "register_at_fork"):
    # Workers must not write between the lines of the process that shows progress
    os.register_at_fork(after_in_child=COMPILATION.forget_watch)


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
        found = dispatcher_of(self.module, self.name)
        if found is None:
            return False
        return bool(found.compiled(self.arguments).fndesc.mangled_name == self.symbol)


class Cache:
    """Machine code of a function on disk, with a stamp of all files that the function depends on.

    Each form of its arguments is a file of its own, whose name tells what it is. Numba's own cache
    reads an index first, and makes all that compilation needs before it looks.
    """

    _locks: ClassVar[dict[Path, int]] = {}
    """An open file of each folder in which this process compiles; to close it frees its locks"""

    def __init__(
        self, function: Callable[..., Any], folder: Path, suffix: str = "", apart: bool = False
    ) -> None:
        """Open the cache of a function; nothing is read before it is asked.

        Args:
            function: The function.
            folder: Where its machine code is.
            suffix: Tells two forms of a function from each other.
            apart: Whether callers call it where it is.
        """
        self._py_func, self._folder, self._suffix = function, folder, suffix
        self._apart = apart

    @property
    def cache_path(self) -> str:
        """Where machine code is; numba tells it with its statistics."""
        return str(self._folder)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Load machine code for some types of arguments; None where there is none."""
        try:
            data = self._file(signature, context).read_bytes()
        except FileNotFoundError:
            return None
        if not data.endswith(pickle.STOP):
            return None  # the system stopped before all of it was on disk
        _name_helpers()
        if b"hashsecret" in data:
            # Numba names these where it is imported, which takes longer than most
            import_module("numba.cpython.hashing")
        # Made by this user: nobody else can write there
        needs, payload = pickle.loads(data)
        if not all(need.is_met() for need in needs):
            return None
        compiled = CompileResult._rebuild(context, *payload)
        compiled.library.needs = needs
        self._link(compiled)
        return compiled

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store machine code."""
        library = compiled.library
        linked = (need for other in library._linking_libraries for need in _asked(other))
        library.needs = tuple(dict.fromkeys((*getattr(library, "doors", ()), *linked)))
        if self._is_apart():
            # What is stored for callers to copy: the name alone, which numba reads
            name = compiled.fndesc.mangled_name
            library._shared_module = llvm.parse_assembly(f'define void @"{name}"() {{ ret void }}')
        # Addresses of this process would be wrong in another
        if not library.has_dynamic_globals:
            file = self._file(signature, compiled.target_context)
            try:
                _replace(file, dumps((library.needs, compiled._reduce())))
                self._forget_old(file)
            except OSError as error:
                _tell_once(f"{error}: what is compiled is not kept for later runs")
        self._link(compiled)

    @contextlib.contextmanager
    def alone(self, signature: Any, context: Any) -> Iterator[None]:
        """Keep other processes from compiling the function for some types meanwhile.

        They would compile it under another symbol, and callers of either would be compiled once
        more by the next process. They compile other functions at the same time. No function calls
        itself, by others or not: so nobody waits for whoever waits for them. Without locks, or a
        folder that can be written, each goes on by itself.
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
        """Name the file for some types of arguments."""
        function = self._py_func
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        kinds = repr(sigutils.normalize_signature(signature))
        key = hashlib.sha256(f"{kinds} {_machine(context.codegen())}".encode())
        code = function.__code__
        key.update(code.co_code)
        # Functions of one line may differ in these alone
        constants = [one for one in code.co_consts if not isinstance(one, CodeType | frozenset)]
        key.update(repr((constants, code.co_names)).encode())
        key.update(dumps(cells) if cells else b"")
        stamp = stamp_of(function.__code__.co_filename)
        return self._folder / f"{self._base}.{stamp}.{key.hexdigest()[:24]}.nbc"

    @functools.cached_property
    def _base(self) -> str:
        """What names of all files of the function begin with."""
        function = self._py_func
        code = function.__code__
        place = f"{code.co_filename} {function.__qualname__} {code.co_firstlineno} {self._suffix}"
        name = re.sub(r"\W", "", function.__name__)
        return f"{name}-{hashlib.sha256(place.encode()).hexdigest()[:12]}"

    def _forget_old(self, file: Path) -> None:
        """Remove what other versions of the function's files have left."""
        stamp = file.name.split(".")[1]
        for other in self._folder.glob(f"{self._base}.*"):
            if other.name.split(".")[1] != stamp:
                other.unlink(missing_ok=True)

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


@functools.cache
def _name_helpers() -> None:
    """Tell LLVM where functions of numba's are that stored machine code calls.

    Numba does it while it gets ready to compile, which takes longer than all that is loaded.
    """
    for name, address in _nrt_python.c_helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@functools.cache
def _tell_once(text: str) -> None:
    """Log a warning, once in a process."""
    _LOG.warning(text)


def _wait_for(lock: int, place: int) -> None:
    """Lock a byte of a file, unless another process holds it for longer than compilation takes.

    The byte need not be there.
    """
    assert fcntl is not None
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        # It ends with the process, and is not handed on to forks
        with contextlib.suppress(BlockingIOError):
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            return
        time.sleep(0.02)


def _replace(file: Path, data: bytes) -> None:
    """Write a file at a stroke: another process may write or read it now."""
    part = file.with_name(f".part-{os.getpid()}-{file.name}")
    try:
        part.write_bytes(data)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def _asked(library: Any) -> tuple[Need, ...]:
    """Tell what is needed by whoever links a library; numba's own need nothing."""
    return getattr(library, "asked", ())


class _Stored(CPUDispatcher):  # type: ignore[misc]  # numba has no types
    """A compiled function that looks for stored machine code before all else."""

    def compile(self, sig: Any) -> Any:
        """Load machine code for some types of arguments, or compile it; tells where it is.

        Numba does the same, and takes the time of each call of LLVM meanwhile.
        """
        kinds, result = sigutils.normalize_signature(sig)
        with global_compiler_lock:
            if kinds not in self.overloads and isinstance(self._cache, Cache):
                found = self._cache.load_overload(sig, self.targetctx)
                if found is None:
                    # Another process may have compiled it while this one waited
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
        """Compile and store what no process has; tells where it is."""
        with COMPILATION.count(), self._compiling_counter:
            self._cache_misses[sig] += 1
            made = self._compiler.compile(kinds, result)
            # Linked before callers may find it, whatever happens meanwhile
            self._cache.save_overload(sig, made)
            self.add_overload(made)
        return made.entry_point

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Find the form for a call: one for all numbers in its place; numba makes one for each."""
        named = {name: any_number(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(any_number, args)), named)


class Dispatcher(_Stored):
    """A compiled function as Python calls it.

    Attributes:
        door: What compiled callers find under its name if it is compiled later than they are; see
            `bulletuav.compiled.deferred`.
    """

    door: Any = None
    _folder: Path | None = None
    _inner: Any = None

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: Mapping[str, Any] | None = None,
        targetoptions: Mapping[str, Any] | None = None,
        pipeline_class: type = Compiler,
    ) -> None:
        """Prepare it; it is not compiled before it is called."""
        options = {**(targetoptions or {}), "no_cfunc_wrapper": True}
        super().__init__(py_func, dict(locals or {}), options, pipeline_class)

    @property
    def inner(self) -> Any:
        """The same function for callers that are compiled, without a wrapper for Python."""
        # One for all threads: code that calls another one would not find this one's
        with global_compiler_lock:
            if self._inner is None:
                self._inner = self._make_inner()
            return self._inner

    @functools.cached_property
    def plain(self) -> Callable[..., Any]:
        """The function as plain Python; see `bulletuav.compiled.plain`."""
        return plain_function(self.py_func)

    def _make_inner(self) -> _Stored:
        """Make the function for callers that are compiled."""
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        apart = not options.get("forceinline")
        pipeline = Compiler if apart else PartCompiler
        made = _Stored(self.py_func, dict(self.locals), options, pipeline)
        if self._folder is not None:
            made._cache = Cache(self.py_func, self._folder, "-inner", apart)
        return made

    @property
    def _numba_type_(self) -> Any:
        """What compiled callers find under the function's name."""
        return self.door or types.Dispatcher(self.inner)

    def compiled(self, arguments: tuple[Any, ...]) -> Any:
        """Compile it for other machine code, or load it; tells all about it.

        Args:
            arguments: Numba's types of its arguments.
        """
        self.inner.compile(arguments)
        return self.inner.overloads[arguments]

    def address(self, arguments: tuple[Any, ...]) -> int:
        """Tell where its machine code for some types of arguments is."""
        made = self.compiled(arguments)
        place: int = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
        return place

    def keep_in(self, folder: Path) -> None:
        """Keep both on disk."""
        self._folder = folder
        self._cache = Cache(self.py_func, folder)


def _switched(dispatcher: Dispatcher, *arguments: Any, **named: Any) -> Any:
    """Call a function as Python does where kernels may run as plain Python."""
    if not SWITCH.is_on:
        return CPUDispatcher.__call__(dispatcher, *arguments, **named)
    named = {name: as_compiled(value) for name, value in named.items()}
    return dispatcher.plain(*as_compiled(arguments), **named)


@contextlib.contextmanager
def plain_kernels() -> Iterator[None]:
    """Run kernels that this thread calls in the `with` block as plain Python.

    Where `NUMBA_DISABLE_JIT=1` is set they always do.
    """
    # Only now, as a call from Python takes three times as long then
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
    """Find a compiled function by its place; None if something else is there."""
    found = getattr(import_module(module), name, None)
    return found if isinstance(found, Dispatcher) else None


@functools.cache
def _machine(codegen: Any) -> str:
    """Tell for what Python and processor machine code is made."""
    return repr((sys.implementation.cache_tag, codegen.magic_tuple()))
