"""Subprocess that decomposes meshes with CoACD, with limits on time and memory."""

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, Self

import numpy as np

from bulletuav.errors import GIB, missing_extra, total_memory
from bulletuav.geometry.mesh import Mesh, find_crossing

CHILD = Path(__file__).with_name("coacd_child.py")
"""Program of the subprocess"""
CONCAVITY = 0.05
"""Concavity threshold of CoACD, its default: a fraction of the mesh's size"""
MAX_SECONDS = 600.0
"""Time limit per mesh, s"""
MAX_SECONDS_CROSSING = 60.0
"""Time limit for self-intersecting meshes, s, for which CoACD may never finish"""
MIN_MEMORY = 2 * GIB
"""Minimum memory limit of the subprocess, bytes; half of the memory on larger machines"""
REMEDY = (
    "repair the mesh in a modelling program, so that it is closed and no faces intersect; or split "
    "it into convex objects by hand, NAME_piece_1, NAME_piece_2, ...; or remove it"
)


class Decomposer:
    """Context manager that decomposes meshes into convex pieces with CoACD.

    CoACD is native code that crashes on some meshes and hangs on others. It runs in a subprocess,
    which starts with the first mesh, decomposes all meshes, and is replaced after a failure. It is
    started by `subprocess`, not forked, so that it is independent of the threads of this process.

    The results of CoACD do not depend on the number of threads.
    """

    def __init__(self) -> None:
        """Initialise without a subprocess."""
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None

    def __enter__(self) -> Self:
        """Return self; the subprocess starts with the first mesh."""
        return self

    def __exit__(self, *_: object) -> None:
        """Terminate the subprocess, even during a decomposition."""
        self._end()

    def __call__(self, mesh: Mesh, where: str) -> list[np.ndarray]:
        """Decompose a mesh into convex pieces.

        Args:
            mesh: A closed mesh with outward triangles.
            where: File and object, for the message.

        Returns:
            Points (V, 3) of each piece, m.

        Raises:
            ImportError: If CoACD is not installed.
            ValueError: If CoACD fails on this mesh, crashes, or exceeds the time or memory limit.
        """
        # CoACD needs a mesh that is centred at the origin
        middle = mesh.points.mean(axis=0)
        process = self._started()
        is_done = threading.Event()
        limits: list[float] = []  # the exceeded limit
        arguments = (process, mesh, is_done, limits)
        watch = threading.Thread(target=_kill_on_timeout, args=arguments, daemon=True)
        watch.start()
        code = 0
        found: list[np.ndarray] = []
        try:
            _send(process, mesh._replace(points=mesh.points - middle))
            found = _receive(process)
        except (OSError, EOFError):  # the subprocess closed its pipe
            code = process.wait()
        finally:
            is_done.set()
        if not found:
            watch.join()
            reason = f"took longer than {limits[0]:g} s" if limits else self._exit_reason(code)
            self._end()
            raise ValueError(
                f"{where}: CoACD, which splits meshes that are not convex, {reason}"
                f"{_crossing(mesh)}: {REMEDY}"
            )
        return [points + middle for points in found]

    def _started(self) -> "subprocess.Popen[bytes]":
        """Return the subprocess; start it if necessary."""
        if self._process is None:
            if importlib.util.find_spec("coacd") is None:
                raise missing_extra("splitting a mesh that is not convex", "city")
            self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by _end
            limit = max(MIN_MEMORY, total_memory() // 2)
            # The subprocess has the same import path; -P excludes the folder of its own file
            path = os.pathsep.join(filter(None, sys.path))
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(CHILD), repr(CONCAVITY), str(limit)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                env={**os.environ, "PYTHONPATH": path},
            )
        return self._process

    def _exit_reason(self, code: int) -> str:
        """Describe how the subprocess ended: by a signal, an error, or without pieces."""
        assert self._log is not None
        self._log.seek(0)
        text = self._log.read().decode(errors="replace").strip()
        last = f" ({text.splitlines()[-1][:200]})" if text else ""
        if "bad_alloc" in text or "MemoryError" in text:
            return f"needs more memory than {max(MIN_MEMORY, total_memory() // 2) / GIB:.3g} GiB"
        if code >= 0:
            return "failed" + last if code else "returned no pieces"
        with contextlib.suppress(ValueError):
            return f"crashed with {signal.Signals(-code).name}{last}"
        return f"crashed with signal {-code}{last}"

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            # Wait, and close the pipes
            with contextlib.suppress(OSError, ValueError):
                self._process.communicate()
        if self._log is not None:
            self._log.close()
        self._process = self._log = None


def _kill_on_timeout(
    process: "subprocess.Popen[bytes]", mesh: Mesh, is_done: threading.Event, limits: list[float]
) -> None:
    """Kill the subprocess if a mesh exceeds its time limit.

    The limit is shorter for self-intersecting meshes.

    Args:
        process: The subprocess.
        mesh: The mesh.
        is_done: Set when the subprocess has ended or answered.
        limits: The exceeded limit, s, is appended if the subprocess is killed.
    """
    # Most meshes finish within the shorter limit, so the search for intersections is delayed
    limit = min(MAX_SECONDS_CROSSING, MAX_SECONDS)
    if is_done.wait(limit):
        return
    if find_crossing(mesh) is None:
        if is_done.wait(MAX_SECONDS - limit):
            return
        limit = MAX_SECONDS
    if not is_done.is_set():
        limits.append(limit)
        process.kill()


def _send(process: "subprocess.Popen[bytes]", mesh: Mesh) -> None:
    assert process.stdin is not None
    sizes = np.array([len(mesh.points), len(mesh.triangles)], np.int64)
    process.stdin.write(sizes.tobytes())
    process.stdin.write(np.ascontiguousarray(mesh.points, np.float64).tobytes())
    process.stdin.write(np.ascontiguousarray(mesh.triangles, np.int32).tobytes())
    process.stdin.flush()


def _receive(process: "subprocess.Popen[bytes]") -> list[np.ndarray]:
    (count,) = np.frombuffer(_read(process, 8), np.int64)
    sizes = np.frombuffer(_read(process, 8 * int(count)), np.int64)
    points = np.frombuffer(_read(process, 24 * int(sizes.sum()))).reshape(-1, 3)
    return np.split(points, np.cumsum(sizes)[:-1]) if count else []


def _read(process: "subprocess.Popen[bytes]", size: int) -> bytes:
    """Read bytes from the subprocess; raise EOFError if it has ended."""
    assert process.stdout is not None
    content = process.stdout.read(size)
    if len(content) < size:
        raise EOFError
    return content


def _crossing(mesh: Mesh) -> str:
    """Describe a self-intersection of the mesh, the usual cause; empty if none is found."""
    place = find_crossing(mesh)
    if place is None:
        return ""
    x, y, z = place.tolist()
    return f"; its faces intersect each other, for example at ({x:.6g}, {y:.6g}, {z:.6g}) m"
