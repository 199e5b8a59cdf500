"""Helper threads that take part in the compiled calls of a program.

A program (`bulletuav.compiled.program`) runs on the thread that calls it. With `threads=T`, up to
T - 1 helpers compute parts of those of its calls that are made by `Program.shared`:

- Such a call is a kernel with arguments (first, last, ...), which computes the items from `first`
  to before `last`, independently of all other items. The items are cut into chunks, and every
  thread takes the next chunk until none is left. Each thread has arguments of its own, as kernels
  work in scratch arrays. The results do not depend on which thread computes a chunk.
- Chunks are handed out by one word, the ticket: the number of the call, and a bit for each chunk
  that is left. Compare-and-swap of the ticket takes a chunk. Threads start at different chunks, the
  same ones in every call, whose data are in the caches of their cores. A helper that is late finds
  a new ticket, and no thread waits for it: the calling thread takes all chunks that are left.
- The calling thread then waits for the chunks that helpers have taken. Threads that wait poll for
  some 50 us, and then sleep on a lock of Python's C API, which the other side releases. With fewer
  cores than threads they sleep immediately.

The helpers are Python threads that stay in one compiled function, without the GIL. The calling
thread holds the GIL, but not while it sleeps: a helper may need the GIL to compile a function that
is called for the first time. All environments of a process share the helpers, which start with
the first program that needs them, and end with the process. A child process after `fork` has
none, and starts its own.
"""

import atexit
import ctypes
import os
import platform
import threading
from typing import Any, cast

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from bulletuav.compiled.dispatcher import Dispatcher
from bulletuav.compiled.kernel import kernel
from bulletuav.cores import count_cores
from bulletuav.interrupts import block_interrupts

MAX_THREADS = 32
CHUNKS = 8
"""Number of chunks of a call for each of its threads: a thread that loses its core leaves few"""
MAX_CHUNKS = 32
POLLS = 2000
"""Number of times that a thread polls before it sleeps, some 50 us"""
_CHUNKS_LEFT = 0xFFFF_FFFF
"""Bits of a ticket for the chunks"""

_WORD = types.int64
_KIND = types.TypeRef(_WORD)
CACHE_LINE = 8
"""Words of a cache line: words that different threads write are in lines of their own"""
_TICKET, _DONE, _WAITS, _BUSY, _ENDS, _FAILED = range(0, 64 * 6, 64)
_JOB, _SIZE, _CHUNKS, _THREADS, _POLLS, _LOCK = range(384, 384 + 64 * 6, 64)
_ACQUIRE, _RELEASE, _LEAVE_GIL, _TAKE_GIL, _HELPERS = range(768, 768 + 64 * 5, 64)
"""Bytes from the address of the team's words to each word, in cache lines of their own; helpers
follow"""
_OWN_LOCK = 8
"""Bytes from a helper's word, which is 1 while it sleeps, to its lock"""


@intrinsic  # type: ignore[untyped-decorator]
def _load(_: Any, address: Any) -> Any:
    """Read a word that other threads write."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        return builder.load_atomic(_place(context, builder, given[0]), "seq_cst", 8)

    return _WORD(address), generate


@intrinsic  # type: ignore[untyped-decorator]
def _store(_: Any, address: Any, value: Any) -> Any:
    """Write a word that other threads read."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        builder.store_atomic(given[1], _place(context, builder, given[0]), "seq_cst", 8)
        return context.get_dummy_value()

    return types.none(address, _WORD), generate


@intrinsic  # type: ignore[untyped-decorator]
def _add(_: Any, address: Any, value: Any) -> Any:
    """Add to a word, and return its value before."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        place = _place(context, builder, given[0])
        return builder.atomic_rmw("add", place, given[1], "seq_cst")

    return _WORD(address, _WORD), generate


@intrinsic  # type: ignore[untyped-decorator]
def _swap(_: Any, address: Any, before: Any, after: Any) -> Any:
    """Replace a word by `after` if it is `before`; return whether it was."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        place = _place(context, builder, given[0])
        found = builder.cmpxchg(place, given[1], given[2], "seq_cst", "seq_cst")
        return builder.extract_value(found, 1)

    return types.boolean(address, _WORD, _WORD), generate


@intrinsic  # type: ignore[untyped-decorator]
def _pause(_: Any) -> Any:
    """Give way to the other hyperthread of the core for some 40 ns, while polling."""

    def generate(context: Any, builder: Any, _: Any, __: Any) -> Any:
        machine, number, module = platform.machine().lower(), ir.IntType(32), builder.module
        if machine in ("x86_64", "amd64"):
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(cgutils.get_or_insert_function(module, kind, "llvm.x86.sse2.pause"), [])
        elif machine in ("aarch64", "arm64"):
            kind = ir.FunctionType(ir.VoidType(), [number])
            hint = cgutils.get_or_insert_function(module, kind, "llvm.aarch64.hint")
            builder.call(hint, [number(1)])
        return context.get_dummy_value()

    return types.none(), generate


@intrinsic  # type: ignore[untyped-decorator]
def _call_c(_: Any, function: Any, one: Any, other: Any) -> Any:
    """Call the C function at an address with up to two words; it returns at most one."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        word = context.get_value_type(_WORD)
        kind = ir.FunctionType(word, [word, word])
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), given[1:])

    return _WORD(function, _WORD, _WORD), generate


@intrinsic  # type: ignore[untyped-decorator]
def _attempt(_: Any, caller: Any, words: Any) -> Any:
    """Run a call as `run_calls` does; return whether it raised an exception."""

    def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
        convention, kinds = context.call_conv, (_WORD, _KIND)
        function_type = convention.get_function_type(_WORD, kinds)
        function = builder.inttoptr(given[0], function_type.as_pointer())
        values = [given[1], cgutils.get_null_value(context.get_value_type(_KIND))]
        status, _ = convention.call_function(builder, function, _WORD, kinds, values)
        return status.is_error

    return types.boolean(caller, words), generate


def _place(context: Any, builder: Any, address: Any) -> Any:
    """Return the pointer to the word at an address."""
    return builder.inttoptr(address, context.get_value_type(_WORD).as_pointer())


@kernel
def _find_chunk(team: int, thread: int, ticket: int) -> int:
    """Return a chunk that a ticket has left for a thread; -1 if there is none."""
    chunks: int = _load(team + _CHUNKS)
    threads: int = _load(team + _THREADS)
    if (ticket & _CHUNKS_LEFT) == 0 or thread >= threads:
        return -1
    first = chunks * thread // threads
    for k in range(chunks):
        chunk = first + k if first + k < chunks else first + k - chunks
        if ticket & (1 << chunk):
            return chunk
    return -1


@kernel
def _compute_chunk(team: int, thread: int, chunk: int) -> None:
    """Compute a chunk, which the thread has taken from the ticket."""
    job, size = _load(team + _JOB) + 16 * thread, _load(team + _SIZE)
    words, count = _load(job + 8), _load(team + _CHUNKS)
    # The arguments (first, last) follow the function's address
    _store(words + 8, size * chunk // count)
    _store(words + 16, size * (chunk + 1) // count)
    if _attempt(_load(job), words):
        _store(team + _FAILED, 1)


@kernel
def _help(team: int, thread: int) -> int:
    """Compute chunks in a helper thread until the team ends."""
    own = team + _HELPERS + 8 * CACHE_LINE * thread
    polls = 0
    while _load(team + _ENDS) == 0:
        ticket = _load(team + _TICKET)
        chunk = _find_chunk(team, thread, ticket)
        if chunk >= 0:
            # If the call has ended meanwhile, there is another ticket
            if _swap(team + _TICKET, ticket, ticket - (1 << chunk)):
                # Read before the call can end, and another start
                chunks = _load(team + _CHUNKS)
                _compute_chunk(team, thread, chunk)
                is_last = _add(team + _DONE, 1) + 1 == chunks
                if is_last and _swap(team + _WAITS, 1, 0):
                    _call_c(_load(team + _RELEASE), _load(team + _LOCK), 0)
            polls = 0
            continue
        polls += 1
        if polls < _load(team + _POLLS):
            _pause()
            continue
        polls = 0
        _store(own, 1)
        # Work that came before the calling thread could see the word is not missed
        is_needed = _find_chunk(team, thread, _load(team + _TICKET)) >= 0
        is_needed = is_needed or _load(team + _ENDS) != 0
        if not (is_needed and _swap(own, 1, 0)):
            _call_c(_load(team + _ACQUIRE), _load(own + _OWN_LOCK), 1)
    return 0


@kernel
def run_shared(team: int, job: int, size: int, chunks: int, threads: int) -> None:
    """Compute the items of a call on several threads.

    Args:
        team: Address of the team's words.
        job: Address of the call's (caller, words) for each thread, as in `Program.table`.
        size: Number of items.
        chunks: Number of chunks, at most `MAX_CHUNKS`.
        threads: Number of threads, including the calling one.

    Raises:
        RuntimeError: If a function raised an exception.
    """
    if not _swap(team + _BUSY, 0, 1):
        # Another thread of Python's uses the helpers, and released the GIL while it waits
        words = _load(job + 8)
        _store(words + 8, 0)
        _store(words + 16, size)
        if _attempt(_load(job), words):
            raise RuntimeError("a compiled function failed")
        return
    _store(team + _JOB, job)
    _store(team + _SIZE, size)
    _store(team + _CHUNKS, chunks)
    _store(team + _THREADS, threads)
    _store(team + _DONE, 0)
    _store(team + _FAILED, 0)
    number = (_load(team + _TICKET) >> 32) + 1
    _store(team + _TICKET, ((number & 0x7FFF_FFFF) << 32) | ((1 << chunks) - 1))
    for thread in range(1, threads):
        helper = team + _HELPERS + 8 * CACHE_LINE * thread
        if _load(helper) != 0 and _swap(helper, 1, 0):
            _call_c(_load(team + _RELEASE), _load(helper + _OWN_LOCK), 0)
    while True:
        ticket = _load(team + _TICKET)
        chunk = _find_chunk(team, 0, ticket)
        if chunk < 0:
            break
        if _swap(team + _TICKET, ticket, ticket - (1 << chunk)):
            _compute_chunk(team, 0, chunk)
            _add(team + _DONE, 1)
    polls = 0
    while _load(team + _DONE) < chunks:
        polls += 1
        if polls < _load(team + _POLLS):
            _pause()
            continue
        polls = 0
        _store(team + _WAITS, 1)
        if not (_load(team + _DONE) >= chunks and _swap(team + _WAITS, 1, 0)):
            state = _call_c(_load(team + _LEAVE_GIL), 0, 0)
            _call_c(_load(team + _ACQUIRE), _load(team + _LOCK), 1)
            _call_c(_load(team + _TAKE_GIL), state, 0)
    has_failed = _load(team + _FAILED) != 0
    _store(team + _BUSY, 0)
    if has_failed:
        raise RuntimeError("a compiled function failed on one of several threads")


class Team:
    """The helper threads of this process.

    Attributes:
        address: Address of the words by which threads exchange work.
    """

    def __init__(self) -> None:
        """Create a team without helpers."""
        self._words = np.zeros((_HELPERS // 8 + CACHE_LINE * (MAX_THREADS + 1)), dtype=np.int64)
        self.address: int = self._words.ctypes.data
        self._helpers: list[threading.Thread] = []
        self._start_lock = threading.Lock()

    def require(self, threads: int) -> None:
        """Start helpers until there are `threads` threads, including the calling one."""
        if len(self._helpers) >= threads - 1:
            return
        with self._start_lock:
            if not self._helpers:
                self._write(_LOCK, _make_lock())
                for place, name in (
                    (_ACQUIRE, "PyThread_acquire_lock"),
                    (_RELEASE, "PyThread_release_lock"),
                    (_LEAVE_GIL, "PyEval_SaveThread"),
                    (_TAKE_GIL, "PyEval_RestoreThread"),
                ):
                    function = getattr(ctypes.pythonapi, name)
                    self._write(place, ctypes.cast(function, ctypes.c_void_p).value or 0)
            # Polling occupies a core, and uses up quotas
            self._write(_POLLS, POLLS if count_cores() >= threads else 0)
            while len(self._helpers) < threads - 1:
                thread = len(self._helpers) + 1
                self._write(_HELPERS + 8 * CACHE_LINE * thread + _OWN_LOCK, _make_lock())
                name = f"bulletuav helper {thread}"
                helper = threading.Thread(target=self._run, args=(thread,), name=name, daemon=True)
                # Listed first: after an error no second helper may have the same scratch arrays
                self._helpers.append(helper)
                with block_interrupts():
                    helper.start()

    def _run(self, thread: int) -> None:
        """Stay in compiled code until the team ends."""
        words = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
        # Calls of this type of function are without the GIL
        kind = ctypes.CFUNCTYPE(ctypes.c_int32, *words)
        address = cast(Dispatcher, _help).address((_WORD, _WORD))
        result, error = ctypes.c_int64(), ctypes.c_void_p()
        kind(address)(ctypes.addressof(result), ctypes.addressof(error), self.address, thread)

    def _write(self, place: int, value: int) -> None:
        """Write a word."""
        self._words[place // 8] = value

    def end(self) -> None:
        """End all helpers."""
        self._write(_ENDS, 1)
        for thread, helper in enumerate(self._helpers, start=1):
            word = (_HELPERS + 8 * CACHE_LINE * thread) // 8
            # Released even if the helper polls, as it may be about to sleep
            lock = ctypes.c_void_p(int(self._words[word + _OWN_LOCK // 8]))
            ctypes.pythonapi.PyThread_release_lock(lock)
            if helper.ident is not None:
                helper.join(1.0)

    def forget(self) -> None:
        """Forget the helpers, which a forked process does not have."""
        self._words[:] = 0
        self._helpers = []
        self._start_lock = threading.Lock()


def _make_lock() -> int:
    """Create a lock that is taken: the first thread that acquires it sleeps until its release."""
    python = ctypes.pythonapi
    python.PyThread_allocate_lock.restype = ctypes.c_void_p
    lock: int = python.PyThread_allocate_lock()
    python.PyThread_acquire_lock(ctypes.c_void_p(lock), 1)
    return lock


TEAM = Team()
"""The helper threads of this process"""
atexit.register(TEAM.end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=TEAM.forget)
