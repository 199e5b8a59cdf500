"""Server of AirSim's API: msgpack-rpc over TCP, for clients of AirSim and Cosys-AirSim.

    server = AirsimServer(AirsimWorld(3))
    server.run()

A request is [0, number, name, arguments]; its response is [1, number, error or nil, result].

AirSim's client (airsim 1.8.1) and Cosys-AirSim's (cosysairsim 3.5.0) send nothing but requests. The
server therefore closes a connection at the first message that is not a request. HTTP, WebSocket and
TLS begin with bytes that msgpack reads as integers, so that no web page can send a request.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

from bulletuav.bridges.airsim_calls import (
    CONTINUE_CALLS,
    IMAGE_CALLS,
    AirsimCalls,
    NotReadyError,
)
from bulletuav.bridges.airsim_images import ImageCall
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_pictures import DrawingError, PictureQueue
from bulletuav.bridges.airsim_recording import AirsimRecorder
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.sockets import LOG_NAME, open_listener
from bulletuav.envs.pacer import Pacer
from bulletuav.errors import as_int, missing_extra, shown
from bulletuav.serving.connections import Clock, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals
from bulletuav.serving.streams import StreamConnection, StreamServer

PORT = 41451
"""Default port of AirSim's clients"""
LIMITS = ConnectionLimits()
MAX_REQUEST_BYTES = 2**20
"""Maximum size of a request, bytes"""
SCAN_BUFFER = 2**16
"""Size of the buffer of each connection for finding the ends of messages, bytes. By default msgpack
reserves the maximum size of a request, and memory would grow with each connection."""
MAX_ITEMS = 2**13
"""Maximum number of items in all lists and maps of a request; a path of 1000 points has 4,000"""
RESPONSE_HEAD, NO_ERROR = b"\x94\x01", b"\xc0"
"""Packed first two of the four values of a response, and the third one for success"""
MAX_TURN_TIME = 0.005
"""Time after which the requests of a client, or the steps of a call, yield to other clients, s"""


class TurnScheduler:
    """Scheduler of the work of all clients: one client at a time, first come, first served.

    A turn is limited by time rather than by a number of requests, because the cost of requests
    differs by a factor of a hundred. The simulation may step between any two turns.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Create a scheduler without waiting clients.

        Args:
            clock: Function that returns the time, s.
        """
        self._lock, self._clock = asyncio.Lock(), clock

    async def run(self, steps: Iterator[Awaitable[None] | None]) -> None:
        """Run the steps of an iterator, in as many turns as needed.

        Args:
            steps: Iterator that does one piece of work in each step. It yields an awaitable that is
                awaited outside of the turn, or None.
        """
        while True:
            async with self._lock:
                end = self._clock() + MAX_TURN_TIME
                for pending in steps:
                    if pending is not None or self._clock() >= end:
                        break
                else:
                    return
            await (asyncio.sleep(0) if pending is None else pending)


class AirsimServer:
    """Server that steps a world in real time and answers the clients that fly its vehicles.

    Attributes:
        world: The vehicles.
        host: Address that the server listens at.
        port: Port that the server listens at.
        pacer: Real-time pacer; it counts the steps that were late.
    """

    def __init__(
        self,
        world: AirsimWorld,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
        recordings: Path | None = None,
    ) -> None:
        """Open the port; clients are answered while `run` runs.

        Args:
            world: The vehicles.
            host: Address to listen at. Anyone who can reach this address can fly the vehicles.
            port: Port; 0 for a free one.
            speed: Real-time factor: simulated seconds per second of wall-clock time.
            limits: Limits of connections.
            clock: Function that returns the time in s, for timeouts of connections.
            recordings: Folder for what clients record; None if they may not.

        Raises:
            ValueError: If the port or the speed is out of range, or the settings of the world
                start a recording without a folder.
            OSError: If the port is in use or the address does not exist.
            ImportError: If the package msgpack is not installed.
        """
        try:
            import msgpack
        except ImportError:
            raise missing_extra("serving clients of AirSim", "airsim") from None
        # An optional package, kept here because it cannot be imported at the top of the file
        self._msgpack = msgpack
        as_int("port", port, 0, 65535)
        self.world, self.host = world, host
        self._recorder = AirsimRecorder(world, recordings)
        self._calls = AirsimCalls(world, self._recorder)
        self._recording: asyncio.Task[None] | None = None
        self._scheduler, self._pictures = TurnScheduler(), PictureQueue(world)
        self._slack = 0.0
        self.pacer = Pacer(world.airspace.period, speed, _sleep=self._record_slack)
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self._streams = StreamServer(self._serve_client, limits, self._refusals, clock)
        self._stopped = False
        # Last, so that no client connects before the server is complete
        self._socket = open_listener(host, port)
        self.port: int = self._socket.getsockname()[1]

    @property
    def connections(self) -> Connections[StreamConnection]:
        """Open connections."""
        return self._streams.connections

    def _record_slack(self, seconds: float) -> None:
        """Record the time that the pacer would sleep, in which clients are served instead, s."""
        self._slack = seconds

    def stop(self) -> None:
        """Stop `run` after its present step; may be called from any thread."""
        self._stopped = True

    def run(self, seconds: float | None = None) -> None:
        """Step the simulation in real time and answer clients.

        Args:
            seconds: Wall-clock duration, s. None runs until interrupted.

        Raises:
            RuntimeError: If the simulation diverged, or the server has run before or is closed.
        """
        if self._socket.fileno() < 0:
            raise RuntimeError("this server is closed: create a new one")
        asyncio.run(self.serve(seconds))

    def close(self) -> None:
        """Close the port, as `run` does at its end; the world stays open."""
        self._socket.close()

    async def serve(self, seconds: float | None = None) -> None:
        """Do the same as `run` as a coroutine, in an existing event loop."""
        self._pictures.warm_up()
        await self._streams.start(self._socket)
        try:
            async with asyncio.timeout(seconds):
                await self._fly()
        except TimeoutError:
            pass
        finally:
            self._stopped = True
            if self._recording is not None:
                self._recording.cancel()
            self._recorder.stop()
            self._pictures.close()
            await self._streams.stop()

    async def _fly(self) -> None:
        """Step the simulation in real time, unless the world is paused."""
        self.pacer.restart()
        while not self._stopped:
            if not self.world.paused:
                self.world.step()
                self._record()
            self._slack = 0.0
            self.pacer.wait()
            await asyncio.sleep(self._slack)

    def _record(self) -> None:
        """Start to record a row if one is due, and the last one is written."""
        if self._recorder.is_due and (self._recording is None or self._recording.done()):
            self._recording = asyncio.create_task(self._write_rows())

    async def _write_rows(self) -> None:
        """Record a row of each vehicle; end the recording if this is impossible."""
        try:
            await self._recorder.record(self._pictures)
        except (DrawingError, OSError, ValueError) as error:
            # First the reason: who sees that the recording has ended can then read why
            logging.getLogger(LOG_NAME).warning("the recording ended: %s", error)
            self._recorder.stop()

    async def _serve_client(self, stream: StreamConnection) -> None:
        await _Client(self, stream).serve()

    async def advance(self, steps: int, is_wanted: Callable[[], bool] = lambda: True) -> None:
        """Step the simulation as fast as possible, in turns with other clients.

        The server's stop ends the steps.

        Args:
            steps: Number of steps.
            is_wanted: Function that returns whether the client is still connected. The remaining
                steps are skipped when it returns False.
        """

        def fly() -> Iterator[None]:
            for _ in range(steps):
                if self._stopped or not is_wanted():
                    return
                self.world.step()
                self._record()
                yield None

        await self._scheduler.run(fly())
        self.pacer.restart()


class _Client:
    """Connection of one client."""

    def __init__(self, server: AirsimServer, stream: StreamConnection) -> None:
        self._server, self._stream = server, stream
        self._calls, self._msgpack = server._calls, server._msgpack
        # Responses of motions that end while another response is sent in parts
        self._deferred: list[bytes] | None = None

    async def serve(self) -> None:
        """Answer requests until the client disconnects or sends another message."""
        reader = _MessageReader(self._msgpack)
        while data := await self._stream.reader.read(65536):
            await self._server._scheduler.run(self._handle_messages(reader.read(data)))
            if not self._stream.is_open:
                return
            if reader.is_broken:
                self._stream.drop("dropped: it sent bytes that are not msgpack, or too many")
                return

    def _handle_messages(self, messages: Iterator[Any]) -> Iterator[Awaitable[None] | None]:
        """Answer messages in order, and yield work that takes longer than a turn."""
        for message in messages:
            if not self._stream.is_open:
                return
            if not _is_request(message):
                self._stream.drop("dropped: it sent a message that is not a request")
                return
            if not self._admit(message[1]):
                return
            yield self._handle_request(message)

    def _admit(self, number: int) -> bool:
        """Register a request, and close the connection if the server has reached its client limit.

        Returns:
            Whether the client was admitted.
        """
        try:
            self._stream.request()
        except FullError as error:
            self._respond(number, f"this server is full: {error}; try again later", None)
            self._stream.close()
            return False
        return True

    def _handle_request(self, message: Any) -> Awaitable[None] | None:
        """Answer a request.

        Returns:
            Awaitable that answers the request before the client's next message is handled. None if
            it is answered already, or will be at the end of a motion.
        """
        _, number, name, arguments = message
        try:
            if isinstance(name, str) and name in MOTIONS:
                self._calls.start_motion(
                    name, arguments, lambda done: self._end_motion(number, done)
                )
                self._server.connections.wait(self._stream)
                return None
            if name in CONTINUE_CALLS:
                return self._continue_time(number, self._calls.parse_steps(name, arguments))
            if name in IMAGE_CALLS:
                return self._draw_images(number, self._calls.parse_images(name, arguments))
            result = self._calls.call(name, arguments)
        # Invalid calls are errors for their client; a diverged simulation ends the server
        except ValueError as error:
            call = name if isinstance(name, str) else shown(name)
            self._server._refusals.log(self._stream.peer, call, str(error))
            if isinstance(error, NotReadyError):
                self._respond(number, None, False)
            else:
                self._respond(number, str(error), None)
            return None
        self._respond(number, None, result)
        return None

    async def _continue_time(self, number: int, num_steps: int) -> None:
        """Step the simulation, then answer the call."""
        with self._record_waiting():
            await self._server.advance(num_steps, lambda: self._stream.is_open)
            self._respond(number, None, None)

    async def _draw_images(self, number: int, call: ImageCall) -> None:
        """Render the images of a call, then answer it."""
        with self._record_waiting():
            try:
                parts = await self._server._pictures.draw(call, lambda: self._stream.is_open)
            except DrawingError as error:
                self._respond(number, str(error), None)
                return
            head = RESPONSE_HEAD + self._msgpack.packb(number) + NO_ERROR
            await self._send_parts([head, *parts])

    async def _send_parts(self, parts: list[bytes]) -> None:
        """Send a response in parts, as fast as the client reads; responses of motions follow it.

        Images of a call are up to 11 MB. Copying them in one piece would delay other clients, and
        queueing them in one piece would exceed the limit of a client that reads slowly.
        """
        self._deferred = []
        try:
            for part in parts:
                self._stream.send(part)
                await asyncio.sleep(0)
                await self._stream.drain()
        finally:
            deferred, self._deferred = self._deferred, None
        for data in deferred:
            self._stream.send(data)

    @contextlib.contextmanager
    def _record_waiting(self) -> Iterator[None]:
        """Count the client as waiting within a `with` block."""
        connections = self._server.connections
        connections.wait(self._stream)
        try:
            yield
        finally:
            connections.wait(self._stream, -1)

    def _end_motion(self, number: int, done: bool) -> None:
        """Answer the call of a motion that has ended."""
        self._server.connections.wait(self._stream, -1)
        self._respond(number, None, done)

    def _respond(self, number: int, error: str | None, result: Any) -> None:
        """Send a response, after any response that is being sent in parts."""
        data = self._msgpack.packb([1, number, error, result])
        if self._deferred is None:
            self._stream.send(data)
        else:
            self._deferred.append(data)


class _MessageReader:
    """Parser of a stream of messages that buffers an incomplete message as bytes only.

    Lists and maps take up to 72 times the memory of their bytes, so that a message is not unpacked
    before its turn.
    """

    def __init__(self, msgpack: Any) -> None:
        """Start at the beginning of a stream.

        Args:
            msgpack: The module msgpack.
        """
        self._msgpack = msgpack
        # Finds the ends of messages without creating objects
        self._scanner = msgpack.Unpacker(max_buffer_size=MAX_REQUEST_BYTES, read_size=SCAN_BUFFER)
        self._errors = (ValueError, TypeError, msgpack.UnpackException)
        # Bytes of the incomplete message, and the number of bytes of all messages before it
        self._buffer, self._num_parsed = bytearray(), 0
        self.is_broken = False

    def read(self, data: bytes) -> Iterator[Any]:
        """Unpack the messages that are complete, one by one.

        Afterwards `is_broken` is True if the next message cannot be parsed, or is too long.

        Args:
            data: Next bytes of the stream.
        """
        self._buffer += data
        try:
            self._scanner.feed(data)
            while True:
                self._scanner.skip()
                size = self._scanner.tell() - self._num_parsed
                message, self._num_parsed = bytes(self._buffer[:size]), self._num_parsed + size
                del self._buffer[:size]
                yield self._unpack(message)
        except self._msgpack.OutOfData:
            self.is_broken = len(self._buffer) > MAX_REQUEST_BYTES
        # TypeError: maps whose keys are lists
        except self._errors:
            self.is_broken = True

    def _unpack(self, message: bytes) -> Any:
        """Unpack a complete message.

        Raises:
            ValueError, TypeError, UnpackException: If the message has types that no call needs, or
                too many items.
        """
        num_items = 0

        def count_items(items: Any) -> Any:
            nonlocal num_items
            num_items += len(items)
            if num_items > MAX_ITEMS:
                raise ValueError(f"more than {MAX_ITEMS} items in lists and maps")
            return items

        return self._msgpack.unpackb(
            message,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            strict_map_key=False,
            unicode_errors="replace",
            ext_hook=_reject_ext_type,
            list_hook=count_items,
            object_hook=count_items,
        )


def _is_request(message: Any) -> bool:
    """Return True if a message is a msgpack-rpc request."""
    return (
        isinstance(message, list)
        and len(message) == 4
        and type(message[0]) is int
        and message[0] == 0
        and type(message[1]) is int
        and isinstance(message[3], list)
    )


def _reject_ext_type(code: int, data: bytes) -> None:
    """Raise ValueError for a msgpack extension type."""
    raise ValueError(f"a value of extension type {code}, which no call needs")
