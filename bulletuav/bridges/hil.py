"""Server of PX4's simulator protocol: MAVLink over TCP in lockstep.

    server = HilServer(HilBodies(1))
    server.run()

Autopilots connect to port 4560 and the ports after it, one port for each vehicle. The server sends
sensor measurements, and each autopilot answers with motor commands. The simulation steps when all
autopilots have answered.
"""

import contextlib
import logging
import math
import selectors
import socket
import time
from collections.abc import Callable
from typing import Any

from bulletuav.bridges.hil_bodies import STEP_HZ, HilBodies
from bulletuav.bridges.mavlink_protocol import (
    Command,
    MavlinkCodec,
    Message,
    OutgoingMessage,
    split_frames,
    text,
)
from bulletuav.bridges.sockets import LOG_NAME, open_listener
from bulletuav.envs.pacer import Pacer
from bulletuav.envs.viewer import join_address
from bulletuav.errors import as_int, finite
from bulletuav.serving.connections import (
    ACCEPT_RETRY,
    EVICTED_FOR_RESOURCES,
    EXHAUSTED_ERRORS,
    Clock,
    ConnectionLimits,
    Connections,
    FullError,
    cannot_accept,
)
from bulletuav.serving.refusals import Refusals

PORT = 4560
"""Default port of the first PX4 instance"""
MAX_READ_BYTES = 4096
"""Maximum number of bytes that one call reads from a connection"""
MAX_BUFFER_BYTES = 65536
"""Maximum size of an incomplete MAVLink frame, bytes"""
ANSWER_TIMEOUT = 10.0
"""Time in which an autopilot must answer, s; after it the autopilot is dropped"""
START_TIMEOUT = 30.0
"""Time in which an autopilot must answer for the first time, s; longer, since it has to start"""
LIMITS = ConnectionLimits(max_clients=1, max_pending=4)
"""Limits of the connections of one vehicle"""
MAX_LISTEN_TIME = 0.1
"""Maximum time that `run` waits for connections in one call, s"""
SYSTEM_ID = 1
"""MAVLink system ID of the simulator"""
STATE_QUATERNION = 115
"""MAVLink message ID of HIL_STATE_QUATERNION"""


class AutopilotLink:
    """Connection of one autopilot.

    Attributes:
        has_answered: Whether the autopilot has answered the latest measurements. From then on, the
            simulation waits for it.
        is_awaited: Whether an answer is outstanding.
        sent_time: Wall-clock time when the unanswered measurements were sent, s.
        first_sent_time: Time of the server's clock when the first measurements were sent, s; None
            before.
        peer: Address of the autopilot.
        wants_ground_truth: Whether the autopilot has requested HIL_STATE_QUATERNION.
    """

    def __init__(self, connection: socket.socket, peer: str) -> None:
        """Configure an accepted connection.

        Args:
            connection: Socket of the connection.
            peer: Address of the autopilot.
        """
        self.peer = peer
        self.first_sent_time: float | None = None
        self.socket, self.wire, self._buffer = connection, MavlinkCodec(SYSTEM_ID), b""
        self.has_answered = self.is_awaited = self.wants_ground_truth = False
        self.sent_time = time.perf_counter()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)

    def send(self, messages: list[OutgoingMessage]) -> None:
        """Send messages.

        Raises:
            OSError: If the autopilot has disconnected, or does not read.
        """
        data = b"".join(self.wire.pack(message) for message in messages)
        if self.socket.send(data) < len(data):
            raise ConnectionError("the autopilot does not read its messages")

    def read(self) -> list[Message]:
        """Read the complete messages that have arrived.

        Raises:
            OSError: If the autopilot has disconnected, or sent bytes that are not MAVLink.
        """
        data = self.socket.recv(MAX_READ_BYTES)
        if not data:
            raise ConnectionError("the autopilot has disconnected")
        frames, self._buffer = split_frames(self._buffer + data)
        messages = self.wire.read(frames)
        if self.wire.malformed or len(self._buffer) > MAX_BUFFER_BYTES:
            raise ConnectionError("the autopilot sent bytes that are not MAVLink")
        return messages


class HilServer:
    """Server that steps vehicles in lockstep with their autopilots.

    Attributes:
        bodies: The vehicles.
        ports: TCP port of each vehicle.
        pacer: Pacer that limits the simulation to the requested speed.
    """

    def __init__(
        self,
        bodies: HilBodies,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        patience: float = 1 / STEP_HZ,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
    ) -> None:
        """Open the ports; autopilots are answered while `run` runs.

        Args:
            bodies: The vehicles.
            host: Address to listen at. Anyone who can reach this address can fly the vehicles.
            port: Port of the first vehicle; 0 for free ports.
            speed: Maximum real-time factor: simulated seconds per second of wall-clock time.
            patience: Time that a starting autopilot has to answer a measurement before the next one
                is sent, s. Flights are reproducible to the last bit if it always answers in this
                time.
            limits: Limits of the connections of each vehicle.
            clock: Function that returns the time in s, for timeouts of connections.

        Raises:
            ValueError: If the port, the speed or the patience is out of range.
            OSError: If a port is in use or the address does not exist.
            ImportError: If pymavlink is not installed.
        """
        # Raise errors for bad options and a missing pymavlink before a port is open
        as_int("port", port, 0, 65536 - len(bodies) if port else 0)
        MavlinkCodec(SYSTEM_ID)
        self.bodies, self._patience = bodies, finite("patience", patience, 0.0)
        self.pacer = Pacer(bodies.airspace.period, speed, _sleep=self._listen_for)
        self._selector = selectors.DefaultSelector()
        self._links: list[AutopilotLink | None] = [None] * len(bodies)
        self._clock, self._log = clock, Refusals(logging.getLogger(LOG_NAME), clock)
        self._connections: list[Connections[AutopilotLink]] = [
            Connections(limits, clock) for _ in range(len(bodies))
        ]
        self._listeners: list[socket.socket] = []
        # Vehicles whose port accepts no connections now, and the time when it will again, s
        self._paused_ports: dict[int, float] = {}
        self._is_flying = False
        # One port for each vehicle; if one is taken, the ports opened so far are closed again
        try:
            for i in range(len(bodies)):
                self._listeners.append(open_listener(host, port + i if port else 0))
                self._listeners[i].setblocking(False)
                self._selector.register(self._listeners[i], selectors.EVENT_READ, (i, None))
        except OSError:
            self.close()
            raise
        self.ports: list[int] = [listener.getsockname()[1] for listener in self._listeners]

    def run(self, seconds: float | None = None) -> None:
        """Run the simulation in lockstep with the autopilots.

        Args:
            seconds: Simulated duration after all autopilots have answered, s. None runs until
                interrupted.

        Raises:
            RuntimeError: If the simulation diverged.
        """
        end = math.inf if seconds is None else self.bodies.airspace.time + seconds - 1e-9
        self.pacer.restart()
        while self.bodies.airspace.time < end:
            self._step_lockstep()

    def _step_lockstep(self) -> None:
        """Send measurements, wait for the answers, and step once all autopilots have answered."""
        self._drop_overdue()
        self._accept_again()
        # The first step needs all autopilots
        if not self._is_flying and None in self._links:
            self._listen(MAX_LISTEN_TIME)
            return
        # Send to all autopilots first, so that they compute at the same time
        readings = self.bodies.measure()
        for i, link in enumerate(self._links):
            if link is not None:
                messages = readings[i] + ([self.bodies.truth(i)] if link.wants_ground_truth else [])
                link.is_awaited, link.sent_time = True, time.perf_counter()
                link.first_sent_time = (
                    self._clock() if link.first_sent_time is None else link.first_sent_time
                )
                self._call_guarded(i, link, link.send, messages)
        # Simulated time stands still until all have answered or timed out
        while (left := self._remaining_wait()) > 0:
            self._listen(left)
        # Drop autopilots that timed out; the other vehicles go on flying
        for i, link in enumerate(self._links):
            if link is not None and link.has_answered and link.is_awaited:
                self._drop(i, link, f"dropped: it did not answer for {ANSWER_TIMEOUT:g} s")
        # The first step waits for all answers; later steps do not wait for dropped autopilots
        self._is_flying = self._is_flying or all(link and link.has_answered for link in self._links)
        if self._is_flying:
            self.bodies.step()
        # A late step has not read any messages while it waited
        if self.pacer.wait():
            self._listen(0.0)

    def _remaining_wait(self) -> float:
        """Return the time left to wait for answers, s; starting autopilots are given less."""
        ends = [
            link.sent_time + (ANSWER_TIMEOUT if link.has_answered else self._patience)
            for link in self._links
            if link is not None and link.is_awaited
        ]
        return max(ends, default=-math.inf) - time.perf_counter()

    def _listen_for(self, seconds: float) -> None:
        """Handle connections and messages for a duration, s."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._listen(left)

    def _listen(self, seconds: float) -> None:
        """Handle connections and messages that arrive within a duration, s."""
        for key, _ in self._selector.select(seconds):
            i, link = key.data
            if link is None:
                self._accept_connection(i)
            elif link in self._connections[i]:
                self._call_guarded(i, link, self._receive, i, link)

    def _accept_connection(self, i: int) -> None:
        """Accept a connection; it becomes the autopilot of vehicle `i` with its first message."""
        try:
            connection, address = self._listeners[i].accept()
        except OSError as error:
            if error.errno in EXHAUSTED_ERRORS:
                self._log.log_server(cannot_accept(error))
                self._selector.unregister(self._listeners[i])
                self._paused_ports[i] = self._clock() + ACCEPT_RETRY
                for k, connections in enumerate(self._connections):
                    for link in connections.spare():
                        self._drop(k, link, EVICTED_FOR_RESOURCES)
            return
        try:
            link = AutopilotLink(connection, join_address(*address[:2]))
            self._selector.register(connection, selectors.EVENT_READ, (i, link))
        # Some systems reject socket options if the peer has closed the connection already
        except OSError:
            connection.close()
            return
        evicted = self._connections[i].add(link)
        if evicted is not None:
            self._drop(
                i, evicted, "evicted: it sent nothing, and another connection needed its place"
            )

    def _accept_again(self) -> None:
        """Accept connections again at the ports that ran out of system resources."""
        for i in [i for i, end in self._paused_ports.items() if self._clock() >= end]:
            del self._paused_ports[i]
            self._selector.register(self._listeners[i], selectors.EVENT_READ, (i, None))

    def _receive(self, i: int, link: AutopilotLink) -> None:
        """Read messages from a connection, and handle those of the autopilot of vehicle `i`."""
        messages = link.read()
        if messages and self._admit(i, link):
            self._handle_messages(i, link, messages)

    def _admit(self, i: int, link: AutopilotLink) -> bool:
        """Register a connection that sent messages as the autopilot of vehicle `i`.

        Returns:
            False if another autopilot flies the vehicle; the connection is dropped then.
        """
        try:
            evicted = self._connections[i].request(link)
        except FullError:
            with contextlib.suppress(OSError):
                link.send([text(f"body {i} is flown by another autopilot")])
            self._drop(i, link, f"refused: body {i} is flown by another autopilot")
            return False
        if evicted is not None:
            self._drop(i, evicted, "evicted: it was idle, and another autopilot has connected")
        self._links[i] = link
        return True

    def _drop_overdue(self) -> None:
        """Drop connections that send nothing, and autopilots that never answer."""
        for i, connections in enumerate(self._connections):
            for link in connections.overdue():
                self._drop(i, link, "dropped: it sent no message in time")
        for i, autopilot in enumerate(self._links):
            if autopilot is None or autopilot.has_answered or autopilot.first_sent_time is None:
                continue
            if self._clock() - autopilot.first_sent_time > START_TIMEOUT:
                self._drop(
                    i,
                    autopilot,
                    f"dropped: it has not answered any measurement in {START_TIMEOUT:g} s",
                )

    def _handle_messages(self, i: int, link: AutopilotLink, messages: list[Message]) -> None:
        """Handle the messages of the autopilot of vehicle `i`."""
        for message in messages:
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                # A starting autopilot may answer old measurements; lockstep begins with the newest
                if link.has_answered or message.time_usec >= self.bodies.stamp:
                    link.has_answered, link.is_awaited = True, False
                    self.bodies.command(i, message)
            elif kind == "COMMAND_LONG" and message.command == Command.SET_INTERVAL:
                link.wants_ground_truth |= message.param1 == STATE_QUATERNION

    def _call_guarded(
        self, i: int, link: AutopilotLink, action: Callable[..., None], *arguments: Any
    ) -> None:
        """Call a function on a connection, and drop the connection if it fails."""
        try:
            action(*arguments)
        except OSError as error:
            self._drop(i, link, f"dropped: {error}")

    def _drop(self, i: int, link: AutopilotLink, event: str) -> None:
        """Log an event and close a connection; an autopilot's motors stop."""
        self._log.log_connection(link.peer, event)
        self._close_link(i, link)

    def _close_link(self, i: int, link: AutopilotLink) -> None:
        """Close a connection without logging."""
        self._connections[i].remove(link)
        self._log.forget(link.peer)
        self._selector.unregister(link.socket)
        link.socket.close()
        if self._links[i] is link:
            self._links[i] = None
            self.bodies.stop(i)

    def close(self) -> None:
        """Close the ports and connections; the vehicles stay open."""
        for i, connections in enumerate(self._connections):
            for link in connections.all():
                self._close_link(i, link)
        for listener in self._listeners:
            listener.close()
        self._selector.close()
