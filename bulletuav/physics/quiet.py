"""Keeping the engine's C code from writing to the terminal."""

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Swallow what the engine's C code writes to standard output and error: a library does not print."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = {stream: os.dup(stream) for stream in (1, 2)}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in saved:
        os.dup2(nowhere, stream)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)
        os.close(nowhere)
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)
