"""A context that keeps Bullet's C code from writing to the terminal."""

import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections.abc import Iterator

_ALONE = threading.RLock()
"""Held by the thread that redirects the process's output: two at once would lose it for good"""

# A child process made meanwhile would stay without output, and with a lock that nobody opens.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_ALONE.acquire,
        after_in_parent=_ALONE.release,
        after_in_child=_ALONE.release,
    )


@functools.cache
def _c_library() -> ctypes.CDLL:
    """Load the C library that this process uses."""
    return ctypes.CDLL(None)


def _copy(descriptor: int) -> int:
    """Duplicate a descriptor, to a number that is none of a standard stream, open or closed."""
    copy = os.dup(descriptor)
    if copy > 2:
        return copy
    try:
        return _copy(descriptor)
    finally:
        os.close(copy)


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Swallow what Bullet's C code writes to standard output and error: a library does not print.

    Output of other threads at that moment is swallowed too. Threads that silence wait for each
    other.
    """
    with _ALONE:
        # Python's own output up to here must not be lost. A stream is None without a console, and
        # may be closed or gone.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(AttributeError, ValueError, OSError):
                stream.flush()
        # Redirect the descriptors below Python, as C code does not know its streams.
        saved = {}
        for descriptor in (1, 2):
            with contextlib.suppress(OSError):  # a daemon may have closed it
                saved[descriptor] = _copy(descriptor)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for descriptor in saved:
            os.dup2(nowhere, descriptor)
        os.close(nowhere)
        try:
            yield
        finally:
            # What C code still buffers goes nowhere, too.
            _c_library().fflush(None)
            for descriptor, copy in saved.items():
                os.dup2(copy, descriptor)
                os.close(copy)
