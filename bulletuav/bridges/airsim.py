"""Server of AirSim's calls: msgpack-rpc over TCP, for clients of AirSim and Cosys-AirSim.

    server = AirsimServer(World(3))
    server.run()

A request is [0, number, name, arguments], its answer [1, number, error or nil, result].

Neither AirSim's client (airsim 1.8.1) nor Cosys-AirSim's (cosysairsim 3.5.0) sends anything but
requests. A connection ends therefore with the first message that is none: HTTP, WebSocket and TLS
begin with bytes that msgpack reads as integers, so that no page in a browser can send a request.
"""

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Any

from bulletuav.bridges.airsim_calls import Calls
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_world import World
from bulletuav.bridges.sockets import LOG_NAME, listening
from bulletuav.envs.connections import Clock, Connections, FullError, Limits, PeerLog
from bulletuav.envs.pacer import Pacer
from bulletuav.envs.streams import Stream, StreamServer
from bulletuav.errors import as_int, missing

if TYPE_CHECKING:
    import msgpack

PORT = 41451
"""Port that clients connect to, unless they are told another"""
LIMITS = Limits()
MOST_REQUEST = 2**20
"""Greatest size of a request, bytes"""
IN_ONE_GO = 50
"""Requests of a client, or steps of a call, after which others have their turn"""
CONTINUES = ("simContinueForTime", "simContinueForFrames")


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
        limits: Limits = LIMITS,
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
        self._calls = Calls(world)
        self._left = 0.0
        self.pacer = Pacer(world.airspace.period, speed, _sleep=self._note)
        self._streams = StreamServer(
            self._talk, limits, PeerLog(logging.getLogger(LOG_NAME), clock), clock
        )
        self._stopped = False
        # Last, so that nobody comes too early
        self._socket = listening(host, port)
        self.port: int = self._socket.getsockname()[1]

    @property
    def connections(self) -> Connections[Stream]:
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
        await self._streams.start(self._socket)
        try:
            async with asyncio.timeout(seconds):
                await self._fly()
        except TimeoutError:
            pass
        finally:
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

    async def _talk(self, stream: Stream) -> None:
        """Answer a client until it goes."""
        await _Client(self, stream).listen()

    async def advance(self, steps: int) -> None:
        """Fly a number of steps at once; others have their turns meanwhile."""
        for k in range(steps):
            self.world.step()
            if k % IN_ONE_GO == IN_ONE_GO - 1:
                await asyncio.sleep(0)
        self.pacer.restart()


class _Client:
    """One client's connection."""

    def __init__(self, server: AirsimServer, stream: Stream) -> None:
        self._server, self._stream = server, stream
        self._calls, self._msgpack = server._calls, server._msgpack

    async def listen(self) -> None:
        """Answer requests until the client goes, or sends what is no request."""
        unpacker: msgpack.Unpacker = self._msgpack.Unpacker(
            max_buffer_size=MOST_REQUEST,
            strict_map_key=False,
            unicode_errors="replace",
            ext_hook=_refuse_type,
        )
        taken, goes_on = 0, True
        while goes_on and (data := await self._stream.reader.read(65536)):
            messages, goes_on = self._messages(unpacker, data)
            for message in messages:
                if not _is_request(message):
                    self._stream.drop("was dropped: it sent a message that is no request")
                    return
                if not self._admit(message[1]):
                    return
                await self._take(message)
                if not self._stream.is_open:
                    return
                taken += 1
                if taken % IN_ONE_GO == 0:
                    await asyncio.sleep(0)
        if not goes_on:
            self._stream.drop("was dropped: it sent bytes that are no msgpack, or too many")

    def _admit(self, number: int) -> bool:
        """Record a request; return False if there is no place for one more client."""
        try:
            self._stream.request()
        except FullError as error:
            self._answer(number, f"this server is full: {error}; try again later", None)
            return False
        return True

    def _messages(self, unpacker: "msgpack.Unpacker", data: bytes) -> tuple[list[Any], bool]:
        """Read all messages that are whole; tell also whether what follows can be read."""
        messages: list[Any] = []
        try:
            unpacker.feed(data)
            messages.extend(unpacker)
        # TypeError is for maps whose keys are lists.
        except (ValueError, TypeError, self._msgpack.UnpackException):
            return messages, False
        return messages, True

    async def _take(self, message: Any) -> None:
        """Answer a request."""
        _, number, name, arguments = message
        try:
            if isinstance(name, str) and name in MOTIONS:
                self._calls.move(name, arguments, lambda done: self._end_motion(number, done))
                self._server.connections.wait(self._stream)
                return
            if name in CONTINUES:
                await self._advance(self._calls.steps(name, arguments))
                self._answer(number, None, None)
                return
            result = self._calls.call(name, arguments)
        # What clients send wrong is told to them; a flight that diverged ends the server.
        except ValueError as error:
            self._answer(number, str(error), None)
            return
        self._answer(number, None, result)

    async def _advance(self, steps: int) -> None:
        """Fly a number of steps at once, for which the client waits."""
        connections = self._server.connections
        connections.wait(self._stream)
        try:
            await self._server.advance(steps)
        finally:
            connections.wait(self._stream, -1)

    def _end_motion(self, number: int, done: bool) -> None:
        """Answer a motion that has ended."""
        self._server.connections.wait(self._stream, -1)
        self._answer(number, None, done)

    def _answer(
        self,
        number: int,
        error: str | None,
        result: Any,
    ) -> None:
        """Send an answer."""
        self._stream.send(self._msgpack.packb([1, number, error, result]))


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
