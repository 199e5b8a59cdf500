"""The process that splits meshes by CoACD, with limits on its time and memory."""

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

from bulletuav.city.mesh import Mesh, find_crossing
from bulletuav.errors import GIB, memory, missing

CHILD = Path(__file__).with_name("coacd_child.py")
"""Program of the process"""
CONCAVITY = 0.05
"""Threshold of CoACD, its default: a fraction of the mesh's size"""
MAX_SECONDS = 600.0
"""Time that one mesh may take"""
MAX_SECONDS_CROSSING = 60.0
"""The same of a mesh that crosses itself, of which CoACD may never make pieces"""
MIN_MEMORY = 2 * GIB
"""Bytes that the process may always take; on larger machines half of the memory"""
REMEDY = (
    "repair the mesh in a modelling program, so that it is closed and no faces cross; or split it "
    "into convex objects by hand, NAME_piece_1, NAME_piece_2, ...; or leave it out"
)


class Decomposer:
    """Splits meshes into convex pieces by CoACD: a context manager.

    CoACD is native code: it crashes on some meshes, and takes forever on others. It runs in another
    process, which starts with the first mesh and splits all of them. The process is started by
    `subprocess`, not forked, so that threads of this process do no harm.

    CoACD returns the same pieces on any number of threads.
    """

    def __init__(self) -> None:
        """Start nothing yet."""
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None

    def __enter__(self) -> Self:
        """Start nothing yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, also in the middle of a mesh."""
        self._end()

    def __call__(self, mesh: Mesh, where: str) -> list[np.ndarray]:
        """Split a mesh.

        Args:
            mesh: A closed mesh, whose triangles face outwards.
            where: File and object, for the message.

        Returns:
            Points (V, 3) of each piece, m.

        Raises:
            ImportError: CoACD is not installed.
            ValueError: CoACD does not split this mesh, crashes, or needs too much time or memory.
        """
        # CoACD works on a mesh that is about the origin
        middle = mesh.points.mean(axis=0)
        process = self._started()
        is_done = threading.Event()
        limits: list[float] = []  # the one that it has passed
        arguments = (process, mesh, is_done, limits)
        watch = threading.Thread(target=_end_late, args=arguments, daemon=True)
        watch.start()
        code = 0
        found: list[np.ndarray] = []
        try:
            _send(process, mesh._replace(points=mesh.points - middle))
            found = _receive(process)
        except (OSError, EOFError):  # it has closed its end
            code = process.wait()
        finally:
            is_done.set()
        if not found:
            watch.join()
            reason = f"took longer than {limits[0]:g} s" if limits else self._why(code)
            self._end()
            raise ValueError(
                f"{where}: CoACD, which splits meshes that are not convex, {reason}"
                f"{_crossing(mesh)}: {REMEDY}"
            )
        return [points + middle for points in found]

    def _started(self) -> "subprocess.Popen[bytes]":
        """Return the process, which is started if there is none."""
        if self._process is None:
            if importlib.util.find_spec("coacd") is None:
                raise missing("splitting a mesh that is not convex", "city")
            self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by _end
            most = max(MIN_MEMORY, memory() // 2)
            # The process finds the same packages as this one; -P: nothing beside its own file
            path = os.pathsep.join(filter(None, sys.path))
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(CHILD), repr(CONCAVITY), str(most)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                env={**os.environ, "PYTHONPATH": path},
            )
        return self._process

    def _why(self, code: int) -> str:
        """Describe how the process has ended: by a signal, an error, or with no pieces."""
        assert self._log is not None
        self._log.seek(0)
        text = self._log.read().decode(errors="replace").strip()
        last = f" ({text.splitlines()[-1][:200]})" if text else ""
        if "bad_alloc" in text or "MemoryError" in text:
            return f"needs more memory than {max(MIN_MEMORY, memory() // 2) / GIB:.3g} GiB"
        if code >= 0:
            return "failed" + last if code else "returned no pieces"
        with contextlib.suppress(ValueError):
            return f"crashed with {signal.Signals(-code).name}{last}"
        return f"crashed with signal {-code}{last}"

    def _end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            # Waits, and closes the pipes
            with contextlib.suppress(OSError, ValueError):
                self._process.communicate()
        if self._log is not None:
            self._log.close()
        self._process = self._log = None


def _end_late(
    process: "subprocess.Popen[bytes]", mesh: Mesh, is_done: threading.Event, limits: list[float]
) -> None:
    """Kill the process when a mesh takes too long, sooner if it crosses itself.

    Args:
        process: The process.
        mesh: What it splits.
        is_done: Set when it has ended, or has answered.
        limits: The time that it has taken, s, is added if it is killed.
    """
    # Most meshes take less than the shorter limit: nothing is searched in them
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
    """Write a mesh to the process."""
    assert process.stdin is not None
    sizes = np.array([len(mesh.points), len(mesh.triangles)], np.int64)
    process.stdin.write(sizes.tobytes())
    process.stdin.write(np.ascontiguousarray(mesh.points, np.float64).tobytes())
    process.stdin.write(np.ascontiguousarray(mesh.triangles, np.int32).tobytes())
    process.stdin.flush()


def _receive(process: "subprocess.Popen[bytes]") -> list[np.ndarray]:
    """Read the pieces from the process."""
    (count,) = np.frombuffer(_read(process, 8), np.int64)
    sizes = np.frombuffer(_read(process, 8 * int(count)), np.int64)
    points = np.frombuffer(_read(process, 24 * int(sizes.sum()))).reshape(-1, 3)
    return np.split(points, np.cumsum(sizes)[:-1]) if count else []


def _read(process: "subprocess.Popen[bytes]", size: int) -> bytes:
    """Read bytes from the process. Raises EOFError where it has ended."""
    assert process.stdout is not None
    content = process.stdout.read(size)
    if len(content) < size:
        raise EOFError
    return content


def _crossing(mesh: Mesh) -> str:
    """Name a place where the mesh crosses itself, the usual reason; empty where none is found."""
    place = find_crossing(mesh)
    if place is None:
        return ""
    x, y, z = place.tolist()
    return f"; its faces cross each other, such as at ({x:.6g}, {y:.6g}, {z:.6g}) m"
