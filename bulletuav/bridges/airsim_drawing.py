"""Child process that renders images for AirSim's clients, next to the server process.

Rendering in a thread would hold the interpreter lock (GIL) and stop the simulation. The server
starts this process at the first image request, and sends it pickled jobs.
"""

import os
import struct
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any, BinaryIO

from bulletuav.bridges.airsim_images import Exposure, make_response
from bulletuav.engine.body_table import Contents
from bulletuav.engine.visual_scene import ScenePoses, VisualScene
from bulletuav.geometry.coacd_child import end_with_parent

LENGTH_PREFIX = struct.Struct(">Q")
"""Prefix of each response: its number of bytes"""
EXIT_TIMEOUT = 5.0
"""Time that the process has to exit after its pipes are closed, s"""
START_TIMEOUT, PICTURE_TIMEOUT = 600.0, 60.0
"""Time that the process has to start, and to render an image, s; after it the process is killed"""
CHILD_PROGRAM = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
if hasattr(os, "nice"):
    os.nice(5)
from bulletuav.bridges.airsim_drawing import main
main()
"""
"""Program of the process. It ignores interrupts, which are for the server, and has a lower priority
than the simulation."""


class DrawingProcess:
    """Process that renders images of a copy of the world. Its methods block.

    Methods raise EOFError or OSError if the process has exited, and TimeoutError if it hung and was
    killed.
    """

    def __init__(self) -> None:
        """Start the process.

        Raises:
            OSError: If the operating system cannot start a process.
        """
        # The child searches the same folders for the package as this process, whatever changed
        # sys.path. "-P" keeps the working folder, which may contain anything, out of its search
        # path.
        search_path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", CHILD_PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": search_path},
        )
        assert self._process.stdin is not None
        self._jobs = Connection(os.dup(self._process.stdin.fileno()), readable=False)
        self._process.stdin.close()

    @property
    def pid(self) -> int:
        """Process ID."""
        return self._process.pid

    def prepare(self, contents: Contents) -> None:
        """Send the contents of the world, and wait until the process is ready to draw them."""
        self._request((contents,), START_TIMEOUT)

    def draw(self, poses: ScenePoses, exposure: Exposure, is_list: bool) -> bytes:
        """Render an image.

        Args:
            poses: Poses of all bodies.
            exposure: Image request and camera view.
            is_list: Whether to return the whole response, or only its bytes.

        Returns:
            The response, packed by msgpack.
        """
        return self._request((poses, exposure, is_list), PICTURE_TIMEOUT)

    def _request(self, job: tuple[Any, ...], timeout: float) -> bytes:
        """Send a job and wait for its response; kill the process if it takes too long.

        Args:
            job: Job to pickle.
            timeout: Maximum time, s.

        Raises:
            EOFError, OSError: If the process has exited.
            TimeoutError: If the job took too long.
        """
        assert self._process.stdout is not None
        # Not all systems have timeouts for pipes, but pipes end with the process
        is_hung = threading.Event()

        def kill_hung() -> None:
            is_hung.set()
            self.kill()

        timer = threading.Timer(timeout, kill_hung)
        timer.daemon = True
        timer.start()
        try:
            self._jobs.send(job)
            (length,) = LENGTH_PREFIX.unpack(_read(self._process.stdout, LENGTH_PREFIX.size))
            return _read(self._process.stdout, length)
        except (EOFError, OSError):
            if is_hung.is_set():
                raise TimeoutError(f"it hung for {timeout:g} s and was killed") from None
            raise
        finally:
            timer.cancel()

    def kill(self) -> None:
        """Kill the process; may be called from any thread, and more than once."""
        self._process.kill()

    def close(self) -> int:
        """Close the pipes, which ends the process, and wait for its exit.

        Returns:
            Exit code; negative if a signal with that number ended the process.
        """
        assert self._process.stdout is not None
        self._jobs.close()
        self._process.stdout.close()
        try:
            return self._process.wait(EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.kill()
            return self._process.wait()


def _read(pipe: Any, length: int) -> bytes:
    """Read exactly `length` bytes; raise EOFError if the pipe ends before."""
    data: bytes = pipe.read(length)
    if len(data) < length:
        raise EOFError("the process that draws pictures has ended")
    return data


def main() -> None:
    """Render the jobs that arrive on standard input, until it is closed."""
    import msgpack

    # Redirect what libraries print, which would corrupt the responses
    answers, null_device = os.fdopen(os.dup(1), "wb"), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 1)
    # Exit with the server, even if a fork of the server keeps the pipes open
    end_with_parent()
    try:
        jobs = Connection(os.dup(0), writable=False)
        scene = VisualScene(*jobs.recv())
        _write_response(answers, b"")
        while True:
            poses, exposure, is_list = jobs.recv()
            drawn = scene.draw(0, poses, exposure.view.shot, with_bodies=exposure.needs_bodies)
            result = make_response(exposure, *drawn)
            _write_response(
                answers, msgpack.packb(result if is_list else result["image_data_uint8"])
            )
    # The server has exited, or closed the pipes
    except (EOFError, BrokenPipeError):
        os._exit(0)


def _write_response(pipe: BinaryIO, data: bytes) -> None:
    pipe.write(LENGTH_PREFIX.pack(len(data)) + data)
    pipe.flush()
