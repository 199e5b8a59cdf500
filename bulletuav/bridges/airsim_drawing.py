"""The process that draws pictures for AirSim's clients, next to the server that flies.

PyBullet holds the interpreter in each of its calls, so that drawing in a thread would stop the
flight. The server starts this process at the first picture, and sends it pickled jobs.
"""

import os
import struct
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any, BinaryIO

from bulletuav.bridges.airsim_images import Exposure, make_response
from bulletuav.city.coacd_child import end_with_parent
from bulletuav.engine.scene_copy import SceneCopy, ScenePoses

LENGTH_PREFIX = struct.Struct(">Q")
"""Number of bytes of the answer that follows"""
EXIT_TIMEOUT = 5.0
"""Seconds that the process has to end by itself"""
START_TIMEOUT, PICTURE_TIMEOUT = 600.0, 60.0
"""Seconds that the process has to start, and to draw a picture; then it counts as hung"""
CHILD_PROGRAM = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
if hasattr(os, "nice"):
    os.nice(5)
from bulletuav.bridges.airsim_drawing import main
main()
"""
"""Program of the process. An interrupt is for the server, and the flight goes before pictures."""


class DrawingProcess:
    """A process that draws pictures of a copy of the world. Its methods block.

    Calls raise EOFError or OSError when the process has ended, and TimeoutError when it was killed
    because it hung.
    """

    def __init__(self) -> None:
        """Start the process.

        Raises:
            OSError: There is no room for a process.
        """
        # As this process finds the package, the other one does, whatever has changed sys.path. "-P"
        # keeps it from looking in the working folder first, where anything may lie.
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
        self._num_added = 0

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def prepare(self, setup: tuple[Any, ...]) -> None:
        """Send what is in the world, and wait until the copy is made.

        Args:
            setup: Arguments of `SceneCopy`.
        """
        self._request(setup, START_TIMEOUT)

    def draw(self, poses: ScenePoses, exposure: Exposure, is_list: bool) -> bytes:
        """Draw a picture.

        Args:
            poses: Where everything is.
            exposure: What is asked for.
            is_list: Whether the whole response is wanted, or its bytes alone.

        Returns:
            The response, packed by msgpack.
        """
        new = poses._replace(added=poses.added[self._num_added :])
        self._num_added = len(poses.added)
        return self._request((new, exposure, is_list), PICTURE_TIMEOUT)

    def _request(self, job: tuple[Any, ...], timeout: float) -> bytes:
        """Send a job, and wait for its answer; a process that takes longer than a limit is killed.

        Raises:
            EOFError, OSError: The process has ended.
            TimeoutError: It took too long.
        """
        assert self._process.stdout is not None
        # Pipes have no time limits on all systems: they end with the process
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
        """End the process; may be called from any thread, and more than once."""
        self._process.kill()

    def close(self) -> int:
        """Close the pipes, which ends the process, and wait for it.

        Returns:
            Its exit code, negative for the number of a signal.
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
    """Read a number of bytes; raises EOFError where there are fewer."""
    data: bytes = pipe.read(length)
    if len(data) < length:
        raise EOFError("the process that draws pictures has ended")
    return data


def main() -> None:
    """Draw what is asked for by standard input, until it ends."""
    import msgpack

    # What libraries print must not get between the answers.
    answers, null_device = os.fdopen(os.dup(1), "wb"), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 1)
    # When the server has ended, though a fork of it may keep the pipes open
    end_with_parent()
    try:
        jobs = Connection(os.dup(0), writable=False)
        copy = SceneCopy(*jobs.recv())
        _write_response(answers, b"")
        while True:
            poses, exposure, is_list = jobs.recv()
            result = make_response(exposure, copy.picture(0, poses, exposure.view.shot))
            _write_response(
                answers, msgpack.packb(result if is_list else result["image_data_uint8"])
            )
    # The server has ended, or closed the pipes.
    except (EOFError, BrokenPipeError):
        os._exit(0)


def _write_response(pipe: BinaryIO, data: bytes) -> None:
    """Send an answer."""
    pipe.write(LENGTH_PREFIX.pack(len(data)) + data)
    pipe.flush()
