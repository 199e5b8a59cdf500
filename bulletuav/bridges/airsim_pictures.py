"""Queue of image requests of AirSim's clients, and the process that renders them."""

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from bulletuav.bridges.airsim_drawing import DrawingProcess
from bulletuav.bridges.airsim_images import Exposure, ImageCall, ImageRequest, make_exposures
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.sockets import LOG_NAME
from bulletuav.engine.visual_scene import ScenePoses

LOG = logging.getLogger(LOG_NAME)
MAX_RESTARTS = 1
"""Maximum number of consecutive restarts of the process without a rendered image"""
RESTART_MESSAGE = "the process that draws pictures ended ({}); the next request starts it again"
GIVE_UP_MESSAGE = (
    "no more pictures: the process that draws them ended {} times in a row ({}); see what it "
    "printed on the server's terminal, and restart the server"
)


class DrawingError(RuntimeError):
    """Error for an image that could not be rendered, for reasons outside the client's request."""


class PictureQueue:
    """Queue that renders the images of all clients, one at a time, in another process.

    The process starts at the first request. Clients take turns image by image, first come, first
    served, so that a call for many images does not block other clients. All images of a call show
    the state of the world when the turn of its first image came.
    """

    def __init__(self, world: AirsimWorld) -> None:
        """Create the queue without starting the process.

        Args:
            world: World to render.
        """
        self._world = world
        # Clients wait in order of arrival; each requests one image at a time
        self._lock = asyncio.Lock()
        # A thread waits for the process, so that the event loop does not block
        self._thread = ThreadPoolExecutor(1, "airsim-pictures")
        self._process: DrawingProcess | None = None
        self._airspace = world.airspace
        self._num_exits = 0
        # Reason why rendering has stopped, and a lock between `close` and the start of the process
        self._stop_reason = ""
        self._closing = threading.Lock()

    def warm_up(self) -> None:
        """Compile the functions for camera poses, which would delay the simulation later."""
        make_exposures(self._world, 0, [ImageRequest({"camera_name": "0", "image_type": 0})])

    async def draw(
        self, call: ImageCall, is_wanted: Callable[[], bool] = lambda: True
    ) -> list[bytes]:
        """Render the images of a call.

        Args:
            call: Result of `AirsimCalls.parse_images`.
            is_wanted: Function that returns whether the client is still connected. Rendering of its
                images stops when it returns False.

        Returns:
            Result of the call, packed by msgpack, in parts, because joining them would take long.
            Empty if the client has disconnected.

        Raises:
            DrawingError: If the process exited, or the server is closing.
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
                if self._process is not None and self._airspace is not self._world.airspace:
                    # A vehicle was added
                    process, self._process, poses = self._process, None, None
                    await run(self._thread, process.close)
                    self._require_open()
                if self._process is None:
                    await run(self._thread, self._start)
                    # The queue may have been closed meanwhile
                    self._require_open()
                if poses is None:
                    poses = self._world.airspace.scene_poses()
                    exposures = make_exposures(self._world, call.drone, call.requests)
                job = (poses, exposures[len(parts)], call.is_list)
                parts.append(await run(self._thread, self._draw, *job))
        head = [msgpack.Packer().pack_array_header(len(parts))] if call.is_list else []
        return head + parts

    def _require_open(self) -> None:
        """Raise DrawingError if rendering has stopped."""
        if self._stop_reason:
            raise DrawingError(self._stop_reason)

    def _start(self) -> None:
        """Start the process, and wait until it can render; runs in the thread."""
        try:
            with self._closing:
                self._require_open()
                self._process = DrawingProcess()
            self._airspace = self._world.airspace
            self._process.prepare(self._airspace.scene_contents)
        except (OSError, EOFError) as error:
            raise self._handle_exit(error) from error

    def _draw(self, poses: ScenePoses, exposure: Exposure, is_list: bool) -> bytes:
        """Render an image; runs in the thread."""
        assert self._process is not None
        try:
            packed = self._process.draw(poses, exposure, is_list)
        except (OSError, EOFError) as error:
            raise self._handle_exit(error) from error
        self._num_exits = 0
        return packed

    def _handle_exit(self, error: Exception) -> DrawingError:
        """Record that the process has exited, and return the error for the request."""
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
        """End the process; outstanding requests raise `DrawingError`."""
        with self._closing:
            self._stop_reason = "no more pictures: the server is closing"
            # The thread may record the exit of the process at the same time
            process = self._process
            if process is not None:
                process.kill()
        self._thread.shutdown()
        if self._process is not None:
            self._process.close()
