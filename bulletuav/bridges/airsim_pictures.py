"""Pictures of AirSim's clients: turns, and the process that draws them."""

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from bulletuav.bridges.airsim_calls import ImageCall
from bulletuav.bridges.airsim_drawing import DrawingProcess
from bulletuav.bridges.airsim_images import Exposure, ImageRequest, make_exposures
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.sockets import LOG_NAME
from bulletuav.engine.scene_copy import ScenePoses

LOG = logging.getLogger(LOG_NAME)
MAX_RESTARTS = 1
"""How often in a row the process that draws is started again without having drawn anything"""
RESTART_MESSAGE = "the process that draws pictures ended ({}); the next request starts it again"
GIVE_UP_MESSAGE = (
    "no more pictures: the process that draws them ended {} times in a row ({}); see what it "
    "printed on the server's terminal, and restart the server"
)


class DrawingError(RuntimeError):
    """Error for a picture that could not be drawn, for no fault of the client's."""


class PictureQueue:
    """Pictures of all clients, drawn one at a time by another process, which the first one starts.

    Clients take turns picture by picture, first come, first served: a call for many pictures lets
    other clients have theirs in between. All pictures of a call show the state of the world when
    the turn of its first one came.
    """

    def __init__(self, world: AirsimWorld) -> None:
        """Prepare to draw a world; nothing is started yet."""
        self._world = world
        # Waiting clients in order; each asks for one picture at a time
        self._lock = asyncio.Lock()
        # One thread waits for the process, so that the loop does not
        self._thread = ThreadPoolExecutor(1, "airsim-pictures")
        self._process: DrawingProcess | None = None
        self._num_exits = 0
        # Why nothing more is drawn, and a lock for those that read it before they start
        self._stop_reason = ""
        self._closing = threading.Lock()

    def warm_up(self) -> None:
        """Load the compiled code that finds cameras, for which the flight would wait later."""
        make_exposures(self._world, 0, [ImageRequest({"camera_name": "0", "image_type": 0})])

    async def draw(
        self, call: ImageCall, is_wanted: Callable[[], bool] = lambda: True
    ) -> list[bytes]:
        """Take the pictures of a call.

        Args:
            album: What `AirsimCalls.album` returned.
            is_wanted: Function that returns whether the client is still there. Once it is not, no
                more of its pictures are drawn.

        Returns:
            The result of the call, packed by msgpack, in parts: joining them would take long. It
            is empty if the client has gone.

        Raises:
            DrawingError: The process that draws ended, or the server is closing.
        """
        import msgpack

        run = asyncio.get_running_loop().run_in_executor
        parts: list[bytes] = []
        poses: ScenePoses | None = None
        exposures: list[Exposure] = []
        while len(parts) < len(call.requests):
            async with self._lock:
                if not is_wanted():
                    return []
                self._require_open()
                if self._process is None:
                    await run(self._thread, self._start)
                    # It may have been closed meanwhile
                    self._require_open()
                if poses is None:
                    poses = self._world.airspace.scene_poses()
                    exposures = make_exposures(self._world, call.drone, call.requests)
                job = (poses, exposures[len(parts)], call.is_list)
                parts.append(await run(self._thread, self._draw, *job))
        head = [msgpack.Packer().pack_array_header(len(parts))] if call.is_list else []
        return head + parts

    def _require_open(self) -> None:
        """Raise DrawingError if nothing more is drawn."""
        if self._stop_reason:
            raise DrawingError(self._stop_reason)

    def _start(self) -> None:
        """Start the process, and wait until it can draw; runs in the thread."""
        try:
            with self._closing:
                self._require_open()
                self._process = DrawingProcess()
            self._process.prepare(self._world.airspace.scene_setup)
        except (OSError, EOFError) as error:
            raise self._handle_exit(error) from error

    def _draw(self, poses: ScenePoses, exposure: Exposure, is_list: bool) -> bytes:
        """Draw a picture; runs in the thread."""
        assert self._process is not None
        try:
            packed = self._process.draw(poses, exposure, is_list)
        except (OSError, EOFError) as error:
            raise self._handle_exit(error) from error
        self._num_exits = 0
        return packed

    def _handle_exit(self, error: Exception) -> DrawingError:
        """Note that the process has ended, and return the error for the request."""
        process, self._process = self._process, None
        code = None if process is None else process.close()
        is_named = code is None or isinstance(error, TimeoutError)
        reason = str(error) if is_named else f"exit code {code}"
        self._require_open()
        self._num_exits += 1
        message = RESTART_MESSAGE.format(reason)
        if self._num_exits > MAX_RESTARTS:
            message = self._stop_reason = GIVE_UP_MESSAGE.format(self._num_exits, reason)
        LOG.warning(message)
        return DrawingError(message)

    def close(self) -> None:
        """End the process; pictures that were asked for raise `DrawingError`."""
        with self._closing:
            self._stop_reason = "no more pictures: the server is closing"
            # The thread may note at the same time that it has ended
            process = self._process
            if process is not None:
                process.kill()
        self._thread.shutdown()
        if self._process is not None:
            self._process.close()
