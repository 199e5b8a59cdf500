"""Server of AirSim's calls: msgpack-rpc over TCP, for clients of AirSim and Cosys-AirSim.

    server = AirsimServer(World(3))
    server.run()

A request is [0, number, name, arguments], its answer [1, number, error or nil, result].

Neither AirSim's client (airsim 1.8.1) nor Cosys-AirSim's (cosysairsim 3.5.0) sends anything but
requests. A connection ends therefore with the first message that is none: HTTP, WebSocket and TLS
begin with bytes that msgpack reads as integers, so that no page in a browser can send a request.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

from bulletuav.bridges.airsim_calls import CONTINUES, PICTURES, Album, Calls
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_pictures import DrawingError, Pictures
from bulletuav.bridges.airsim_world import World
from bulletuav.bridges.sockets import LOG_NAME, listening
from bulletuav.envs.pacer import Pacer
from bulletuav.errors import as_int, missing, shown
from bulletuav.serving.connections import Clock, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals
from bulletuav.serving.streams import StreamConnection, StreamServer

PORT = 41451
"""Port that clients connect to, unless they are told another"""
LIMITS = ConnectionLimits()
MOST_REQUEST = 2**20
"""Greatest size of a request, bytes"""
SCAN_BUFFER = 2**16
"""Bytes that are reserved for each connection to find where messages end; msgpack would reserve as
many as a request may have, and the heap would grow with each new connection"""
MAX_ITEMS = 2**13
"""Most items that all lists and maps of a request have together: a path of 1000 points has 4,000"""
ANSWER_HEAD, NO_ERROR = b"\x94\x01", b"\xc0"
"""Packed, the first two of an answer's four values, and the third where there is no error"""
LONGEST_TURN = 0.005
"""Time of a client's requests, or of a call's steps, after which others have their turn, s"""


class Turns:
    """Turns on the server's loop: one client at a time, first come, first served.

    A turn ends by time, not after a number of requests: some take a hundred times as long as
    others. The flight goes on between any two turns.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Begin while no client has its turn.

        Args:
            clock: Returns the time, s.
        """
        self._lock, self._clock = asyncio.Lock(), clock

    async def take(self, work: Iterator[Awaitable[None] | None]) -> None:
        """Do work piece by piece, in as many turns as it takes.

        Args:
            work: Does the next piece each time, and yields what remains to be awaited of the piece
                outside of the turn, or None.
        """
        while True:
            async with self._lock:
                end = self._clock() + LONGEST_TURN
                for rest in work:
                    if rest is not None or self._clock() >= end:
                        break
                else:
                    return
            await (asyncio.sleep(0) if rest is None else rest)


class AirsimServer:
    """A world that flies in real time, and the clients that fly it.

    Attributes:
        world: The vehicles.
        host: Address that it listens at.
        port: Port that it listens at.
        pacer: Keeps the time; tells how many steps were late.
    """

    def __init__(
        self,
        world: World,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
    ) -> None:
        """Open the port; clients are answered once it runs.

        Args:
            world: The vehicles.
            host: Address to listen at. Whoever can reach it can fly the vehicles.
            port: Port; 0 for a free one.
            speed: Simulated seconds in one of the clock.
            limits: Limits of connections.
            clock: Function that returns the time by which connections are idle, s.

        Raises:
            ValueError: The port or the speed cannot be.
            OSError: The port is in use, or there is no such address.
            ImportError: The package msgpack is not installed.
        """
        try:
            import msgpack
        except ImportError:
            raise missing("serving clients of AirSim", "airsim") from None
        # The package is optional, so that it is kept rather than imported above
        self._msgpack = msgpack
        as_int("port", port, 0, 65535)
        self.world, self.host = world, host
        self._calls, self._turns, self._pictures = Calls(world), Turns(), Pictures(world)
        self._left = 0.0
        self.pacer = Pacer(world.airspace.period, speed, _sleep=self._note)
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self._streams = StreamServer(self._talk, limits, self._refusals, clock)
        self._stopped = False
        # Last, so that nobody comes too early
        self._socket = listening(host, port)
        self.port: int = self._socket.getsockname()[1]

    @property
    def connections(self) -> Connections[StreamConnection]:
        """The connections that there are."""
        return self._streams.connections

    def _note(self, seconds: float) -> None:
        """Note how long the pacer would sleep: others work meanwhile."""
        self._left = seconds

    def stop(self) -> None:
        """Let `run` return after its present turn; may be called from any thread."""
        self._stopped = True

    def run(self, seconds: float | None = None) -> None:
        """Fly and answer.

        Args:
            seconds: How long, by the clock; until it is interrupted, if left out.

        Raises:
            RuntimeError: The flight diverged, or it has run before.
        """
        if self._socket.fileno() < 0:
            raise RuntimeError("this server is closed: make a new one")
        asyncio.run(self.serve(seconds))

    def close(self) -> None:
        """Close the port, as the end of `run` does; the world stays."""
        self._socket.close()

    async def serve(self, seconds: float | None = None) -> None:
        """Do what `run` does, in an event loop of one's own."""
        self._pictures.warm_up()
        await self._streams.start(self._socket)
        try:
            async with asyncio.timeout(seconds):
                await self._fly()
        except TimeoutError:
            pass
        finally:
            self._stopped = True
            self._pictures.close()
            await self._streams.stop()

    async def _fly(self) -> None:
        """Fly in real time, unless time stands still."""
        self.pacer.restart()
        while not self._stopped:
            if not self.world.paused:
                self.world.step()
            self._left = 0.0
            self.pacer.wait()
            await asyncio.sleep(self._left)

    async def _talk(self, stream: StreamConnection) -> None:
        """Answer a client until it goes."""
        await _Client(self, stream).listen()

    async def advance(self, steps: int, is_wanted: Callable[[], bool] = lambda: True) -> None:
        """Fly a number of steps at once, or until the server stops; others have their turns.

        Args:
            steps: How many.
            is_wanted: Function that returns whether the client is still there; the rest of its
                steps is not flown if it is not.
        """

        def fly() -> Iterator[None]:
            for _ in range(steps):
                if self._stopped or not is_wanted():
                    return
                self.world.step()
                yield None

        await self._turns.take(fly())
        self.pacer.restart()


class _Client:
    """One client's connection."""

    def __init__(self, server: AirsimServer, stream: StreamConnection) -> None:
        self._server, self._stream = server, stream
        self._calls, self._msgpack = server._calls, server._msgpack
        # Answers of motions that end while another answer is sent in parts
        self._held: list[bytes] | None = None

    async def listen(self) -> None:
        """Answer requests until the client goes, or sends what is no request."""
        reader = _MessageReader(self._msgpack)
        while data := await self._stream.reader.read(65536):
            await self._server._turns.take(self._answers(reader.read(data)))
            if not self._stream.is_open:
                return
            if reader.is_broken:
                self._stream.drop("dropped: it sent bytes that are no msgpack, or too many")
                return

    def _answers(self, messages: Iterator[Any]) -> Iterator[Awaitable[None] | None]:
        """Answer messages in order, until the client goes; yields what takes longer than a turn."""
        for message in messages:
            if not self._stream.is_open:
                return
            if not _is_request(message):
                self._stream.drop("dropped: it sent a message that is no request")
                return
            if not self._admit(message[1]):
                return
            yield self._take(message)

    def _admit(self, number: int) -> bool:
        """Record a request; if there is no place for one more client, end the connection.

        Returns:
            Whether there is a place.
        """
        try:
            self._stream.request()
        except FullError as error:
            self._answer(number, f"this server is full: {error}; try again later", None)
            self._stream.close()
            return False
        return True

    def _take(self, message: Any) -> Awaitable[None] | None:
        """Answer a request.

        Returns:
            What will answer it later, before the client's next message is taken; None if it is
            answered, or will be by the end of a motion.
        """
        _, number, name, arguments = message
        try:
            if isinstance(name, str) and name in MOTIONS:
                self._calls.move(name, arguments, lambda done: self._end_motion(number, done))
                self._server.connections.wait(self._stream)
                return None
            if name in CONTINUES:
                return self._continue(number, self._calls.steps(name, arguments))
            if name in PICTURES:
                return self._draw(number, self._calls.album(name, arguments))
            result = self._calls.call(name, arguments)
        # Wrong calls are errors for their client; a flight that diverged ends the server.
        except ValueError as error:
            call = name if isinstance(name, str) else shown(name)
            self._server._refusals.log(self._stream.peer, call, str(error))
            self._answer(number, str(error), None)
            return None
        self._answer(number, None, result)
        return None

    async def _continue(self, number: int, steps: int) -> None:
        """Answer a call when its steps are flown."""
        with self._busy():
            await self._server.advance(steps, lambda: self._stream.is_open)
            self._answer(number, None, None)

    async def _draw(self, number: int, album: Album) -> None:
        """Answer a call when its pictures are drawn."""
        with self._busy():
            try:
                parts = await self._server._pictures.take(album, lambda: self._stream.is_open)
            except DrawingError as error:
                self._answer(number, str(error), None)
                return
            head = ANSWER_HEAD + self._msgpack.packb(number) + NO_ERROR
            await self._send_parts([head, *parts])

    async def _send_parts(self, parts: list[bytes]) -> None:
        """Send an answer in parts, as fast as the client reads; answers of motions come after it.

        Pictures of a call are up to 11 MB: copying them at once would keep others waiting, and
        queuing them at once would be too much for a client that reads slowly.
        """
        self._held = []
        try:
            for part in parts:
                self._stream.send(part)
                await asyncio.sleep(0)
                await self._stream.drain()
        finally:
            held, self._held = self._held, None
        for data in held:
            self._stream.send(data)

    @contextlib.contextmanager
    def _busy(self) -> Iterator[None]:
        """Record that the client waits, until the end of the block."""
        connections = self._server.connections
        connections.wait(self._stream)
        try:
            yield
        finally:
            connections.wait(self._stream, -1)

    def _end_motion(self, number: int, done: bool) -> None:
        """Answer a motion that has ended."""
        self._server.connections.wait(self._stream, -1)
        self._answer(number, None, done)

    def _answer(self, number: int, error: str | None, result: Any) -> None:
        """Send an answer, after one that is being sent in parts."""
        data = self._msgpack.packb([1, number, error, result])
        if self._held is None:
            self._stream.send(data)
        else:
            self._held.append(data)


class _MessageReader:
    """Reads messages from a stream; one that is not whole takes the memory of its bytes alone.

    Lists and maps take up to 72 times the memory of their bytes, so that no objects are made of a
    message until its turn has come.
    """

    def __init__(self, msgpack: Any) -> None:
        """Start at the beginning of a stream.

        Args:
            msgpack: The package.
        """
        self._msgpack = msgpack
        # Finds where messages end, and makes no objects
        self._scanner = msgpack.Unpacker(max_buffer_size=MOST_REQUEST, read_size=SCAN_BUFFER)
        self._errors = (ValueError, TypeError, msgpack.UnpackException)
        # Bytes of the message that is not whole, and of all messages before it
        self._rest, self._read = bytearray(), 0
        self.is_broken = False

    def read(self, data: bytes) -> Iterator[Any]:
        """Unpack the messages that are whole by now, one by one.

        If what follows cannot be read, or is too long, `is_broken` is True afterwards.

        Args:
            data: The next bytes of the stream.
        """
        self._rest += data
        try:
            self._scanner.feed(data)
            while True:
                self._scanner.skip()
                size = self._scanner.tell() - self._read
                message, self._read = bytes(self._rest[:size]), self._read + size
                del self._rest[:size]
                yield self._unpack(message)
        except self._msgpack.OutOfData:
            self.is_broken = len(self._rest) > MOST_REQUEST
        # TypeError is for maps whose keys are lists
        except self._errors:
            self.is_broken = True

    def _unpack(self, message: bytes) -> Any:
        """Unpack a whole message.

        Raises:
            ValueError, TypeError, UnpackException: It holds what no call needs, or too much.
        """
        count = 0

        def count_items(items: Any) -> Any:
            nonlocal count
            count += len(items)
            if count > MAX_ITEMS:
                raise ValueError(f"more than {MAX_ITEMS} items in lists and maps")
            return items

        return self._msgpack.unpackb(
            message,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            strict_map_key=False,
            unicode_errors="replace",
            ext_hook=_refuse_type,
            list_hook=count_items,
            object_hook=count_items,
        )


def _is_request(message: Any) -> bool:
    """Return True if a message is a request of msgpack-rpc."""
    return (
        isinstance(message, list)
        and len(message) == 4
        and type(message[0]) is int
        and message[0] == 0
        and type(message[1]) is int
        and isinstance(message[3], list)
    )


def _refuse_type(code: int, data: bytes) -> None:
    """Refuse a value of a type that msgpack does not define.

    Raises:
        ValueError: Always.
    """
    raise ValueError(f"a value of type {code}, which no call needs")
