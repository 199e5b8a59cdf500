"""A process that flies some of the worlds for another one, through arrays that they share."""

import ctypes
import math
import multiprocessing
import os
import signal
import sys
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np

from bulletuav.envs.vector import BatchAviary


class Shared:
    """Arrays in memory that processes share, by name."""

    def __init__(self, context: Any, layout: dict[str, tuple[tuple[int, ...], Any]]):
        """layout: shape and type of each."""
        self._layout = layout
        self._memory = {
            name: context.RawArray(
                ctypes.c_byte, max(1, math.prod(shape) * np.dtype(kind).itemsize)
            )
            for name, (shape, kind) in layout.items()
        }

    def arrays(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Views on the worlds from `first` up to `last`."""
        return {
            name: np.frombuffer(self._memory[name], dtype=kind, count=math.prod(shape)).reshape(
                shape
            )[first:last]
            for name, (shape, kind) in self._layout.items()
        }


def work(
    pipe: Connection,
    shared: Shared,
    first: int,
    last: int,
    arguments: tuple,
    options: dict[str, Any],
) -> None:
    """A worker: the worlds from `first` up to `last`, asked by (method, keyword arguments) until None comes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that asks
    arrays = shared.arrays(first, last)
    try:
        batch = BatchAviary(
            arguments[0], last - first, *arguments[1:], first_world=first, **options
        )
    except Exception as error:
        pipe.send(portable(error))
        return
    pipe.send(None)
    while (question := _next(pipe)) is not None:
        method, keywords = question
        try:
            if method == "step":
                keywords = {
                    "actions": arrays["action"][..., 0] if keywords["choices"] else arrays["action"]
                }
            answer = getattr(batch, method)(**keywords)
            if method in ("step", "reset"):
                observations, *judged, answer = answer
                arrays["alive"][:], arrays["ended"][:] = batch.alive, batch.ended
                for name, array in named(observations).items():
                    arrays[name][:] = array
                for name, array in zip(("reward", "terminated", "truncated"), judged, strict=False):
                    arrays[name][:] = array
        except Exception as error:
            answer = portable(error)
        pipe.send(answer)
    batch.close()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    os._exit(0)  # taking down an interpreter with its compiled kernels takes more than a second


def portable(error: Exception) -> Exception:
    """The error, or one that says the same and surely survives the way to another process."""
    return (
        error
        if type(error) in (ValueError, RuntimeError, ImportError)
        else RuntimeError(f"{type(error).__name__}: {error}")
    )


def _next(pipe: Connection) -> Any:
    """The next question; None when the asking process has ended (whose end of the pipe a fork may have left open)."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    if pipe not in wait([pipe, parent.sentinel]):
        return None
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None


def named(observations: Any) -> dict[str, Any]:
    """Observations, or their spaces, by the names of their shared arrays."""
    parts = observations if isinstance(observations, dict) else {"": observations}
    return {f"observation/{name}": array for name, array in parts.items()}
