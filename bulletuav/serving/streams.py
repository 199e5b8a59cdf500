"""Connections of servers on asyncio: bounded queues, and the policy of `connections.py`."""

import asyncio
import contextlib
import socket
import time
from collections.abc import Awaitable, Callable
from typing import Any

from bulletuav.envs.viewer import join_address
from bulletuav.serving.connections import (
    EVICTED_FOR_RESOURCES,
    EXHAUSTED_ERRORS,
    Clock,
    ConnectionLimits,
    Connections,
    FullError,
    cannot_accept,
)
from bulletuav.serving.refusals import Refusals

SWEEP_PERIOD = 0.25
"""Period of checks for overdue and stalled connections, s"""


class StreamConnection:
    """One connection, with a bounded send queue.

    Attributes:
        reader: Reader of the peer's data.
        peer: Address of the peer.
    """

    def __init__(
        self, server: "StreamServer", reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Wrap an accepted connection."""
        self.reader, self._writer, self._server = reader, writer, server
        self._transport = writer.transport
        # The peer may have reset the connection already
        name = writer.get_extra_info("peername") or ("unknown", 0)
        self.peer = join_address(*name[:2])
        self._sent = self._delivered = 0
        self._progress_time = server.clock()
        one = writer.get_extra_info("socket")
        with contextlib.suppress(OSError):
            # Detects peers that vanished, such as a machine that was switched off
            one.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            # A small message otherwise waits for the acknowledgement of the one before, which
            # peers delay by 40 ms. asyncio sets this for sockets with protocol TCP alone, and
            # `socket.create_server` makes them with protocol 0.
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @property
    def is_open(self) -> bool:
        """Whether bytes can still be sent."""
        return not self._transport.is_closing()

    @property
    def unread(self) -> int:
        """Number of bytes in the send queue."""
        return self._transport.get_write_buffer_size()

    def send(self, data: bytes) -> None:
        """Queue bytes; drop the connection if the peer leaves too many unread.

        A single message may exceed the limit if the queue is empty.
        """
        if not self.is_open:
            return
        if self.unread and self.unread + len(data) > self._server.limits.max_unread:
            self.drop(f"dropped: it left {self.unread} bytes unread")
            return
        if not self.unread:
            self._progress_time = self._server.clock()
        self._sent += len(data)
        self._writer.write(data)

    async def drain(self) -> None:
        """Wait until the peer has read most of the queue.

        Raises:
            ConnectionError: If the connection was lost.
        """
        await self._writer.drain()

    def request(self) -> None:
        """Record a valid request.

        Raises:
            FullError: If the server has no place for another client.
        """
        try:
            evicted = self._server.connections.request(self)
        except FullError as error:
            self._server.log.log_connection(self.peer, f"refused: {error}")
            raise
        if evicted is not None:
            evicted.drop("evicted: it was idle longest, and another client needed its place")

    def check_progress(self) -> None:
        """Check whether the peer has read data since the last check."""
        delivered = self._sent - self.unread
        if delivered > self._delivered or not self.unread:
            self._progress_time = self._server.clock()
        if delivered > self._delivered:
            self._server.connections.touch(self)
        self._delivered = delivered

    @property
    def stalled(self) -> float:
        """Time for which the peer has read none of its unread bytes, s."""
        return self._server.clock() - self._progress_time if self.unread else 0.0

    def close(self) -> None:
        """Close the connection after the queue was sent."""
        self._writer.close()

    def drop(self, event: str) -> None:
        """Close the connection immediately, and log the reason.

        Args:
            event: Event and reason, such as "dropped: it sent no request in time".
        """
        if self.is_open:
            self._server.log.log_connection(self.peer, event)
        self.abort()

    def abort(self) -> None:
        """Close the connection immediately."""
        self._transport.abort()

    async def end(self) -> None:
        """Close the connection; the rest of the queue is discarded if the peer stops reading."""
        self.close()
        moved, unread = self._server.clock(), self.unread
        try:
            closed = asyncio.ensure_future(self._writer.wait_closed())
            while not (await asyncio.wait([closed], timeout=SWEEP_PERIOD))[0]:
                if self.unread < unread:
                    moved, unread = self._server.clock(), self.unread
                elif self._server.clock() - moved > self._server.limits.linger:
                    return
        finally:
            self.abort()
            with contextlib.suppress(OSError):
                await closed


class StreamServer:
    """Accepts connections, and serves each in its own task.

    Attributes:
        limits: Limits of connections.
        connections: Present connections.
        clock: Function that returns the time, s.
        log: Log of peers that were rejected or dropped.
    """

    def __init__(
        self,
        talk: Callable[[StreamConnection], Awaitable[None]],
        limits: ConnectionLimits,
        log: Refusals,
        clock: Clock = time.monotonic,
    ) -> None:
        """Create a server that does not listen yet.

        Args:
            talk: Coroutine function that serves a connection, which is closed afterwards.
            limits: Limits of connections.
            log: Log of peers that were rejected or dropped.
            clock: Function that returns the time, s.
        """
        self._talk, self.limits, self.log, self.clock = talk, limits, log, clock
        self.connections: Connections[StreamConnection] = Connections(limits, clock)
        self._talks: dict[asyncio.Task[None], StreamConnection] = {}
        self._server: asyncio.Server | None = None
        self._sweeper: asyncio.Task[None] | None = None

    async def start(self, listening: socket.socket, max_line: int = 2**16) -> None:
        """Accept connections of a listening socket.

        Args:
            listening: The socket.
            max_line: Maximum length of a line that a stream's reader reads, bytes.
        """
        self._handle_errors_of(listening)
        self._server = await asyncio.start_server(self._accept, sock=listening, limit=max_line)
        self._sweeper = asyncio.create_task(self._sweep_periodically())

    def _handle_errors_of(self, listening: socket.socket) -> None:
        """Log exhausted resources as one line, without a traceback.

        asyncio itself tries again after a second. Other errors go to the previous handler.
        """
        loop = asyncio.get_running_loop()
        before = loop.get_exception_handler()

        def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            error, of = context.get("exception"), context.get("socket")
            is_ours = of is not None and of.fileno() == listening.fileno()
            if is_ours and isinstance(error, OSError) and error.errno in EXHAUSTED_ERRORS:
                self.log.log_server(cannot_accept(error))
                for stream in self.connections.spare():
                    stream.drop(EVICTED_FOR_RESOURCES)
            elif before is not None:
                before(loop, context)
            else:
                loop.default_exception_handler(context)

        loop.set_exception_handler(handle)

    async def stop(self) -> None:
        """Close the port and all connections, and wait until they have ended."""
        if self._server is not None:
            # asyncio leaks a connection if its server is closed while accepting: stop accepting,
            # and let the event loop start the tasks of connections that were just accepted
            with contextlib.suppress(NotImplementedError):
                for one in self._server.sockets:
                    asyncio.get_running_loop().remove_reader(one.fileno())
            for _ in range(3):
                await asyncio.sleep(0)
            self._server.close()
        if self._sweeper is not None:
            self._sweeper.cancel()
        talks = dict(self._talks)
        for stream in talks.values():
            stream.close()
        if talks:
            await asyncio.wait(talks, timeout=self.limits.linger)
        # Data that peers have not read by now is discarded
        for task, stream in talks.items():
            stream.abort()
            task.cancel()
        await asyncio.gather(*talks, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Start to serve a connection; `stop` closes it, even if its task has not started yet."""
        stream = StreamConnection(self, reader, writer)
        task = asyncio.get_running_loop().create_task(self._serve(stream))
        self._talks[task] = stream
        task.add_done_callback(self._talks.pop)

    async def _serve(self, stream: StreamConnection) -> None:
        """Serve a connection until it ends."""
        try:
            with contextlib.suppress(ConnectionError):
                evicted = self.connections.add(stream)
                if evicted is not None:
                    evicted.drop("evicted: it sent no request, and another peer needed its place")
                await self._talk(stream)
        finally:
            # A connection keeps its place until it has ended, as it still uses memory
            await stream.end()
            self.connections.remove(stream)
            self.log.forget(stream.peer)

    async def _sweep_periodically(self) -> None:
        """Run `sweep` periodically."""
        while True:
            await asyncio.sleep(SWEEP_PERIOD)
            self.sweep()

    def sweep(self) -> None:
        """Drop connections that are overdue, or read none of their unread bytes."""
        for stream in self.connections.all():
            stream.check_progress()
            if stream.stalled > self.limits.max_stall:
                stream.drop(f"dropped: it read nothing for {self.limits.max_stall:g} s")
        for stream in self.connections.overdue():
            stream.drop("dropped: it sent no request in time")
