"""Convex decomposition in a subprocess, started and fed by `decomposer.Decomposer`.

CoACD is native code that a malformed mesh can cause to crash, hang or exhaust the memory. This file
is executed by its path, so that the process imports NumPy and CoACD only.

The process reads meshes from standard input: two int64, V and T; corners (V, 3) float64; triangles
(T, 3) int32. It writes results to standard output: one int64, the number of pieces; an int64 with
the number of corners of each piece; and the corners of all pieces, (sum, 3) float64. It stops at
the end of the input.
"""

import contextlib
import os
import sys
import threading
import time
from typing import Any, BinaryIO

import numpy as np


def decompose_meshes(coacd: Any, meshes: BinaryIO, answers: BinaryIO, concavity: float) -> None:
    """Decompose meshes until the input ends.

    Args:
        coacd: The CoACD module.
        meshes: Input stream of meshes.
        answers: Output stream of pieces.
        concavity: Concavity threshold of CoACD, a fraction of the mesh's size.
    """
    while header := meshes.read(16):
        count, faces = np.frombuffer(header, np.int64)
        points = np.frombuffer(meshes.read(24 * count)).reshape(count, 3)
        triangles = np.frombuffer(meshes.read(12 * faces), np.int32).reshape(faces, 3)
        mesh = coacd.Mesh(points, triangles)
        found = coacd.run_coacd(mesh, threshold=concavity, preprocess_mode="off", seed=0)
        pieces = [np.asarray(corners, dtype=np.float64) for corners, _ in found]
        sizes = [len(pieces), *map(len, pieces)]
        answers.write(np.array(sizes, np.int64).tobytes())
        answers.write(b"".join(piece.tobytes() for piece in pieces))
        answers.flush()


def limit_memory(size: int) -> None:
    """Limit the memory of this process, in bytes, on systems that support limits."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        soft = size if hard == resource.RLIM_INFINITY else min(size, hard)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def end_with_parent(period: float = 1.0) -> None:
    """Terminate this process when its parent has terminated.

    A killed parent cannot terminate the process, and a call of native code may never return.

    Args:
        period: Time between checks, s.
    """
    parent = os.getppid()

    def check() -> None:
        while os.getppid() == parent:
            time.sleep(period)
        os._exit(1)

    threading.Thread(target=check, daemon=True).start()


if __name__ == "__main__":
    end_with_parent()
    # Redirect CoACD's prints to standard error, as standard output carries the pieces
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    limit_memory(int(sys.argv[2]))
    import coacd

    coacd.set_log_level("error")
    decompose_meshes(coacd, sys.stdin.buffer, pipe, float(sys.argv[1]))
