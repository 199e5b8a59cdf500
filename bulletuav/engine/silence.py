"""Keeping the engine's C code from writing to the terminal."""

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator

_ALONE = threading.RLock()
"""Held by the thread that has turned the process's output away: two at once would lose it for good"""

if hasattr(
    os, "register_at_fork"
):  # a child made meanwhile would stay without output, and with a lock that nobody opens
    os.register_at_fork(
        before=_ALONE.acquire, after_in_parent=_ALONE.release, after_in_child=_ALONE.release
    )


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Swallow what the engine's C code writes to standard output and error: a library does not print.

    Other threads' output of that moment is swallowed too; threads that silence wait for each other.
    """
    with _ALONE:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(
                AttributeError, ValueError, OSError
            ):  # None without a console; closed; gone
                stream.flush()
        saved = {}
        for stream in (1, 2):
            with contextlib.suppress(OSError):  # a daemon may have closed it
                saved[stream] = os.dup(stream)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in saved:
            os.dup2(nowhere, stream)
        os.close(nowhere)
        try:
            yield
        finally:
            ctypes.CDLL(None).fflush(None)
            for stream, copy in saved.items():
                os.dup2(copy, stream)
                os.close(copy)
