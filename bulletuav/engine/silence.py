"""A context that keeps Bullet's C code from writing to the terminal."""

import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections.abc import Iterator

_ALONE = threading.RLock()
"""Lock of the redirection of the process's output: two at the same time would not restore it"""

# A child process forked during a redirection would have no output, and a lock that stays locked.
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
    """Duplicate a descriptor, to a number other than those of the standard streams."""
    copy = os.dup(descriptor)
    if copy > 2:
        return copy
    try:
        return _copy(descriptor)
    finally:
        os.close(copy)


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Discard what Bullet's C code writes to standard output and error in the `with` block.

    Output of other threads in the meantime is discarded, too. Threads that use this wait for each
    other.
    """
    with _ALONE:
        # Earlier output of Python must not be lost. A stream is None without a console, and may be
        # closed.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(AttributeError, ValueError, OSError):
                stream.flush()
        # Redirect the file descriptors, as C code does not use Python's streams.
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
            # Discard the remaining buffer of the C library, too.
            _c_library().fflush(None)
            for descriptor, copy in saved.items():
                os.dup2(copy, descriptor)
                os.close(copy)
