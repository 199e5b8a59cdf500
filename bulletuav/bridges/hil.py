"""The simulator's side of PX4's protocol for simulators: TCP, MAVLink, lockstep.

    server = HilServer(HilBodies(1))
    server.run()

Autopilots connect to port 4560 and those after it, one for each body. They are sent what sensors
measure, and answer with what motors are to do. Time goes on when all have answered.
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
from bulletuav.bridges.mavlink_wire import Command, Message, Told, Wire, text, whole_frames
from bulletuav.bridges.sockets import LOG_NAME, listening
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
"""Port that the first of PX4's instances connects to"""
MOST_READ = 4096
"""Most bytes that are taken of a connection in one go"""
MOST_WAITING = 65536
"""Most bytes of a frame that is not whole, and of what an autopilot leaves unread"""
SILENT = 10.0
"""How long an autopilot may take to answer, s; then it is let go"""
START = 30.0
"""The same for its first answer, for which it has to start"""
LIMITS = ConnectionLimits(max_clients=1, max_pending=4)
"""Limits of the connections of one body"""
LONGEST_WAIT = 0.1
"""Time after which `run` looks again who has connected, s"""
SIMULATOR = 1
"""System number of the simulator"""
STATE_QUATERNION = 115


class Link:
    """The connection of one autopilot.

    Attributes:
        answers: Whether it has answered newest measurements: from then on it is waited for.
        waits: Whether an answer is awaited.
        asked: When it was sent something that it has not answered yet, by the clock, s.
        begun: When it was sent the first measurement, by the server's clock, s; None before.
        peer: Its address.
        wants_truth: Whether it has asked for HIL_STATE_QUATERNION.
    """

    def __init__(self, one: socket.socket, peer: str) -> None:
        """Take over a connection from an address."""
        self.peer = peer
        self.begun: float | None = None
        self.socket, self.wire, self._rest = one, Wire(SIMULATOR), b""
        self.answers = self.waits = self.wants_truth = False
        self.asked = time.perf_counter()
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        one.setblocking(False)

    def send(self, told: list[Told]) -> None:
        """Send messages.

        Raises:
            OSError: The autopilot has gone, or reads nothing.
        """
        data = b"".join(self.wire.pack(one) for one in told)
        if self.socket.send(data) < len(data):
            raise ConnectionError("an autopilot reads nothing")

    def read(self) -> list[Message]:
        """Read messages.

        Raises:
            OSError: The autopilot has gone, or sends what is no MAVLink.
        """
        data = self.socket.recv(MOST_READ)
        if not data:
            raise ConnectionError("an autopilot has gone")
        frames, self._rest = whole_frames(self._rest + data)
        found = self.wire.read(frames)
        if self.wire.malformed or len(self._rest) > MOST_WAITING:
            raise ConnectionError("an autopilot sends what is no MAVLink")
        return found


class HilServer:
    """Bodies, and the autopilots that fly them in lockstep.

    Attributes:
        bodies: What flies.
        ports: Of each body.
        pacer: Keeps time from going faster than asked for.
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
        """Open the ports; autopilots are answered once it runs.

        Args:
            bodies: What flies.
            host: Address to listen at. Whoever can reach it can fly.
            port: Of the first body; 0 for free ones.
            speed: Simulated seconds in one of the clock, at most.
            patience: How long an autopilot that starts may take to answer a measurement, until it
                is sent the next one, s. Flights repeat to the last bit if it always answers in it.
            limits: Limits of the connections of each body.
            clock: Function that returns the time by which connections are idle, s.

        Raises:
            ValueError: The port or the speed cannot be.
            OSError: A port is in use, or there is no such address.
            ImportError: pymavlink is not installed.
        """
        # Bad options, and a missing pymavlink, are told before a port is open
        as_int("port", port, 0, 65536 - len(bodies) if port else 0)
        Wire(SIMULATOR)
        self.bodies, self._patience = bodies, finite("patience", patience, 0.0)
        self.pacer = Pacer(bodies.airspace.period, speed, _sleep=self._listen_for)
        self._selector = selectors.DefaultSelector()
        self._links: list[Link | None] = [None] * len(bodies)
        self._clock, self._log = clock, Refusals(logging.getLogger(LOG_NAME), clock)
        self._connections: list[Connections[Link]] = [
            Connections(limits, clock) for _ in range(len(bodies))
        ]
        self._listening: list[socket.socket] = []
        # Bodies whose port accepts no connections, and until when, by the clock, s
        self._deaf: dict[int, float] = {}
        self._flies = False
        # A port for each body; if one is taken, those before are closed again
        try:
            for i in range(len(bodies)):
                self._listening.append(listening(host, port + i if port else 0))
                self._listening[i].setblocking(False)
                self._selector.register(self._listening[i], selectors.EVENT_READ, (i, None))
        except OSError:
            self.close()
            raise
        self.ports: list[int] = [one.getsockname()[1] for one in self._listening]

    def run(self, seconds: float | None = None) -> None:
        """Fly, and answer.

        Args:
            seconds: How long to fly, simulated, from when all autopilots have answered; until it
                is interrupted, if left out.

        Raises:
            RuntimeError: The flight diverged.
        """
        end = math.inf if seconds is None else self.bodies.airspace.time + seconds - 1e-9
        self.pacer.restart()
        while self.bodies.airspace.time < end:
            self._turn()

    def _turn(self) -> None:
        """Measure, wait for the answers, and fly a step once all autopilots have answered."""
        self._drop_overdue()
        self._accept_again()
        # Before the first step all autopilots have to be there
        if not self._flies and None in self._links:
            self._listen(LONGEST_WAIT)
            return
        # Readings go out first: autopilots then work at the same time
        measured = self.bodies.measure()
        for i, link in enumerate(self._links):
            if link is not None:
                told = measured[i] + ([self.bodies.truth(i)] if link.wants_truth else [])
                link.waits, link.asked = True, time.perf_counter()
                link.begun = self._clock() if link.begun is None else link.begun
                self._guarded(i, link, link.send, told)
        # Time stands still until all have answered, or waited too long
        while (left := self._left()) > 0:
            self._listen(left)
        # Who is too slow is dropped, and the others fly on
        for i, link in enumerate(self._links):
            if link is not None and link.answers and link.waits:
                self._drop(i, link, f"dropped: it did not answer for {SILENT:g} s")
        # The first step waits for answers of all; later ones do without those dropped
        self._flies = self._flies or all(link and link.answers for link in self._links)
        if self._flies:
            self.bodies.step()
        # A turn that is late has not listened while it waited
        if self.pacer.wait():
            self._listen(0.0)

    def _left(self) -> float:
        """Tell how long answers may be waited for, s; those of autopilots that start, less."""
        ends = [
            link.asked + (SILENT if link.answers else self._patience)
            for link in self._links
            if link is not None and link.waits
        ]
        return max(ends, default=-math.inf) - time.perf_counter()

    def _listen_for(self, seconds: float) -> None:
        """Take what comes for a time, s."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._listen(left)

    def _listen(self, seconds: float) -> None:
        """Take what comes, and wait for it at most a time, s."""
        for key, _ in self._selector.select(seconds):
            i, link = key.data
            if link is None:
                self._meet(i)
            elif link in self._connections[i]:
                self._guarded(i, link, self._hear, i, link)

    def _meet(self, i: int) -> None:
        """Accept a connection; it is an autopilot's once it has sent a message."""
        try:
            one, address = self._listening[i].accept()
        except OSError as error:
            if error.errno in EXHAUSTED_ERRORS:
                self._log.log_server(cannot_accept(error))
                self._selector.unregister(self._listening[i])
                self._deaf[i] = self._clock() + ACCEPT_RETRY
                for k, connections in enumerate(self._connections):
                    for link in connections.spare():
                        self._drop(k, link, EVICTED_FOR_RESOURCES)
            return
        try:
            link = Link(one, join_address(*address[:2]))
            self._selector.register(one, selectors.EVENT_READ, (i, link))
        # Some systems allow no options of a connection that has ended already
        except OSError:
            one.close()
            return
        evicted = self._connections[i].add(link)
        if evicted is not None:
            self._drop(i, evicted, "evicted: it sent nothing, and others needed room")

    def _accept_again(self) -> None:
        """Listen again at ports for which the system had no room, once their time has come."""
        for i in [i for i, end in self._deaf.items() if self._clock() >= end]:
            del self._deaf[i]
            self._selector.register(self._listening[i], selectors.EVENT_READ, (i, None))

    def _hear(self, i: int, link: Link) -> None:
        """Read the messages of a connection, and take them if it is an autopilot's."""
        messages = link.read()
        if messages and self._admit(i, link):
            self._take(i, link, messages)

    def _admit(self, i: int, link: Link) -> bool:
        """Record messages of a connection; return False if another autopilot has the body."""
        try:
            evicted = self._connections[i].request(link)
        except FullError:
            with contextlib.suppress(OSError):
                link.send([text(f"body {i} is flown by another autopilot")])
            self._drop(i, link, f"refused: body {i} is flown by another autopilot")
            return False
        if evicted is not None:
            self._drop(i, evicted, "evicted: it was idle, and another one has come")
        self._links[i] = link
        return True

    def _drop_overdue(self) -> None:
        """Drop connections that send nothing, and autopilots that never answer."""
        for i, connections in enumerate(self._connections):
            for link in connections.overdue():
                self._drop(i, link, "dropped: it sent no message in time")
        for i, one in enumerate(self._links):
            if one is None or one.answers or one.begun is None:
                continue
            if self._clock() - one.begun > START:
                self._drop(i, one, f"dropped: it has not answered any measurement in {START:g} s")

    def _take(self, i: int, link: Link, messages: list[Message]) -> None:
        """Take the messages of an autopilot."""
        for message in messages:
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                # An autopilot that starts may answer late; lockstep begins with what is new.
                if link.answers or message.time_usec >= self.bodies.stamp:
                    link.answers, link.waits = True, False
                    self.bodies.command(i, message)
            elif kind == "COMMAND_LONG" and message.command == Command.SET_INTERVAL:
                link.wants_truth |= message.param1 == STATE_QUATERNION

    def _guarded(
        self,
        i: int,
        link: Link,
        does: Callable[..., None],
        *arguments: Any,
    ) -> None:
        """Do something with a connection; one that fails is dropped."""
        try:
            does(*arguments)
        except OSError as error:
            self._drop(i, link, f"dropped: {error}")

    def _drop(self, i: int, link: Link, event: str) -> None:
        """Close a connection; if it is the autopilot's, its motors stop, and others fly on."""
        self._log.log_connection(link.peer, event)
        self._forget(i, link)

    def _forget(self, i: int, link: Link) -> None:
        """Close a connection without a word."""
        self._connections[i].remove(link)
        self._log.forget(link.peer)
        self._selector.unregister(link.socket)
        link.socket.close()
        if self._links[i] is link:
            self._links[i] = None
            self.bodies.stop(i)

    def close(self) -> None:
        """Close the ports and connections; the bodies stay."""
        for i, connections in enumerate(self._connections):
            for link in connections.all():
                self._forget(i, link)
        for one in self._listening:
            one.close()
        self._selector.close()
