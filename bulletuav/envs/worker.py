"""Worker processes of a batch: each simulates some of the worlds, through shared arrays."""

import contextlib
import ctypes
import math
import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from bulletuav.envs.shared_infos import SharedInfos
from bulletuav.envs.snapshot import Snapshot
from bulletuav.envs.vector import BatchAviary
from bulletuav.tasks import TaskSource

PARENT_CHECK_PERIOD = 2.0
"""Period at which an idle process checks that its parent is alive, s"""
JOIN_TIMEOUT = 5.0
"""Time in which all workers have to end, s"""
POLL_TIME = 2e-4
"""Time for which a process polls shared memory before it sleeps, s.

Waking up takes as long as several polls, and many decisions are shorter.
"""
YIELD_CORE = getattr(os, "sched_yield", lambda: None)
"""Let other processes run that wait for the core of this one"""
SharedLayout = dict[str, tuple[tuple[int, ...], Any]]
"""Shape and NumPy type of each shared array, by name; the first axis is that of worlds"""


class SharedArrays:
    """Arrays in shared memory, by name."""

    def __init__(self, context: Any, layout: SharedLayout) -> None:
        """Allocate the memory.

        Args:
            context: Result of `multiprocessing.get_context`.
            layout: Shape and type of each array.
        """
        self._layout = layout
        self._memory: dict[str, Any] = {}
        for name, (shape, dtype) in layout.items():
            size = math.prod(shape) * np.dtype(dtype).itemsize
            self._memory[name] = context.RawArray(ctypes.c_byte, max(1, size))

    def views(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Return views of the arrays.

        Args:
            first: First world of the views.
            last: World after the last one of the views.

        Returns:
            The views by name; they keep the memory alive.
        """
        arrays: dict[str, np.ndarray] = {}
        for name, (shape, dtype) in self._layout.items():
            count = math.prod(shape)
            flat = np.frombuffer(self._memory[name], dtype=dtype, count=count)
            arrays[name] = flat.reshape(shape)[first:last]
        return arrays


def run_worker(
    pipe: Connection,
    poll_time: float,
    shared: SharedArrays,
    first: int,
    last: int,
    task: TaskSource,
    autoreset_mode: AutoresetMode,
    options: dict[str, Any],
) -> None:
    """Simulate some of the worlds until the parent ends; main function of a worker process.

    Requests are (method of `BatchAviary`, keyword arguments), or None to end. Answers are the
    method's result, or an exception. Actions, and results of steps, are in the shared arrays; None
    stands for infos of a step that are there, too.

    Args:
        pipe: Receives requests and sends answers; the first answer says that the worlds are ready.
        poll_time: Time for which the process polls for a request before it sleeps, s.
        shared: Arrays of all worlds.
        first: First world of this process.
        last: World after the last one of this process.
        task: See `BatchAviary`.
        autoreset_mode: See `BatchAviary`.
        options: See `BatchAviary`.
    """
    # The parent handles interrupts
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        part = BatchShard(shared, first, last, task, autoreset_mode, options)
    except Exception as error:
        pipe.send(picklable(error))
        return
    views = shared.views(first, last)
    requests, answers = views["requests"], views["answers"]
    pipe.send(None)
    answers[0] += 1  # after sending, so that the parent need not wait for the pipe
    while (request := _next_request(pipe, requests, int(answers[0]), poll_time)) is not None:
        pipe.send(part.answer(*request))
        answers[0] += 1
    part.close()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    # A normal exit with compiled kernels would take more than a second
    os._exit(0)


class BatchShard:
    """Some of the worlds of a batch, simulated by one process with results in shared arrays."""

    def __init__(
        self,
        shared: SharedArrays,
        first: int,
        last: int,
        task: TaskSource,
        autoreset_mode: AutoresetMode,
        options: dict[str, Any],
    ) -> None:
        """Create the worlds; see `run_worker`."""
        self._arrays = shared.views(first, last)
        self._infos = SharedInfos(self._arrays["info"])
        # Observations are copied to the shared arrays only
        self._batch = BatchAviary(
            task, last - first, autoreset_mode, first_world=first, copy=False, **options
        )

    def answer(self, method: str, keywords: dict[str, Any]) -> Any:
        """Call a method of `BatchAviary`, and return its result or exception; see `run_worker`."""
        try:
            answer = self._call(method, keywords)
            if method == "reset":
                self._infos.set_types(answer)
            elif method == "step" and self._infos.write(answer):
                return None
        except Exception as error:
            return picklable(error)
        return answer

    def _call(self, method: str, keywords: dict[str, Any]) -> Any:
        """Call a method; results of `reset` and `step` except infos are written to the arrays."""
        arrays, batch = self._arrays, self._batch
        if method == "step":
            actions = arrays["action"]
            keywords = {"actions": actions[..., 0] if keywords["choices"] else actions}
        answer = getattr(batch, method)(**keywords)
        if method not in ("step", "reset", "load_state"):
            return answer
        # `reset` returns observations and infos, `load_state` only observations
        observations, *results, infos = (answer, None) if method == "load_state" else answer
        arrays["alive"][:] = batch.aviary.alive
        arrays["ended"][:] = batch.ended
        for name, array in by_shared_name(observations).items():
            arrays[name][:] = array
        for name, array in zip(("reward", "terminated", "truncated"), results, strict=False):
            arrays[name][:] = array
        return infos

    def require_loadable(self, snapshot: Snapshot) -> None:
        """Check a snapshot of any worlds of the batch; see `Aviary.require_loadable`."""
        self._batch.aviary.require_loadable(snapshot)

    def close(self) -> None:
        """Free the worlds."""
        self._batch.close()


def raise_first(answers: list[Any]) -> list[Any]:
    """Raise the first exception among the answers, or return them."""
    for answer in answers:
        if isinstance(answer, Exception):
            raise answer
    return answers


def picklable(error: Exception) -> Exception:
    """Return an exception that can be pickled, with the same message.

    Within this process the new exception has the original as its cause, which is not pickled.
    """
    if type(error) in (ValueError, RuntimeError, ImportError):
        return error
    copy = RuntimeError(f"{type(error).__name__}: {error}")
    copy.__cause__ = error
    return copy


def end_processes(owner: int, pipes: list[Connection], processes: list[Any]) -> None:
    """Ask the processes to end, and kill those that do not."""
    # A forked copy of the owner must not end its processes
    if os.getpid() != owner:
        return
    for pipe in pipes:
        # The process may have ended already
        with contextlib.suppress(OSError):
            pipe.send(None)
    end = time.monotonic() + JOIN_TIMEOUT
    for process in processes:
        process.join(max(0.0, end - time.monotonic()))
        process.kill()  # also ends stopped processes, which stay zombies until joined
        process.join(JOIN_TIMEOUT)


def poll_number(numbers: np.ndarray, number: int, poll_time: float) -> bool:
    """Poll a number until it has a value, or for a time.

    Args:
        numbers: Shared array, whose first number is polled.
        number: Value to wait for.
        poll_time: Maximum time, s.

    Returns:
        Whether the number has the value.
    """
    end = time.perf_counter() + poll_time
    while numbers[0] != number:
        if time.perf_counter() > end:
            return False
        # To processes that share the core, such as the one that is waited for
        YIELD_CORE()
    return True


def _next_request(pipe: Connection, requests: np.ndarray, answered: int, poll_time: float) -> Any:
    """Wait for the next request; return None when the parent process has ended.

    If the parent was forked, its end of the pipe may still be open then. So the process checks the
    parent from time to time: waiting for both would take three times as long in each step.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    try:
        there = poll_number(requests, answered, poll_time)
        while not there and not pipe.poll(PARENT_CHECK_PERIOD):
            if not parent.is_alive():
                return None
        return pipe.recv()
    except (EOFError, OSError):
        return None


def by_shared_name(observations: Any) -> dict[str, Any]:
    """Return the parts of observations, or of their spaces, by the names of shared arrays."""
    parts = observations if isinstance(observations, dict) else {"": observations}
    return {f"observation/{name}": one for name, one in parts.items()}
