"""Server of MAVLink vehicles: each is a UDP port, and sends to the port where clients listen.

    server = MavlinkServer(MavlinkFleet(10))
    server.run()

Vehicle k is system k + 1. It sends to port 14540 + k, as PX4 does, and to whoever speaks to it at
its own port, 18570 + k.
"""

import logging
import time
from collections import deque

from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_services import describe, packed, refusal_of
from bulletuav.bridges.mavlink_wire import Message, Sender, Told, Wire, text
from bulletuav.bridges.sockets import LOG_NAME, Address, DatagramServer
from bulletuav.envs.viewer import join_address
from bulletuav.errors import as_int
from bulletuav.serving.connections import Clock, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals

PORT = 18570
"""Port of the first vehicle"""
CLIENT_PORT = 14540
"""Port to which the first vehicle sends without being asked: MAVSDK listens there"""
LIMITS = ConnectionLimits(
    max_clients=8, max_pending=8, handshake=10.0, max_idle=10.0, grace=5.0, pending_grace=3.0
)
"""Limits of the peers of a vehicle, which are pending while they send nothing but heartbeats"""
MOST_DATAGRAM = 1400
"""Most bytes of a datagram; longer ones are cut"""
MOST_READ = 32
"""Most messages that are taken of a vehicle's socket in one go: others wait, or are dropped"""


class MavlinkServer(DatagramServer):
    """Sockets, one a vehicle, around a fleet that flies in real time.

    Attributes:
        fleet: The vehicles.
        pacer: Keeps the time; tells how many steps were late.
        ports: Of each vehicle.
        malformed: How many datagrams held what is no frame of MAVLink.
        refused: How many came from peers for which there was no room.
        connections: Peers of each vehicle.
        received, sent: How many messages.
    """

    def __init__(
        self,
        fleet: MavlinkFleet,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        client_port: int | None = CLIENT_PORT,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
    ) -> None:
        """Open the ports; clients are answered once it runs.

        Args:
            fleet: The vehicles.
            host: Address to listen at. Whoever can reach it can fly the vehicles.
            port: Of the first vehicle; 0 for free ones.
            speed: Simulated seconds in one of the clock.
            client_port: Port at the same address to which the first vehicle sends without being
                asked, the others to those after it; None for nowhere.
            limits: Limits of the peers of each vehicle.
            clock: Function that returns the time by which peers are idle, s.

        Raises:
            ValueError: A port or the speed cannot be.
            OSError: A port is in use, or there is no such address.
            ImportError: pymavlink is not installed.
        """
        if client_port is not None:
            as_int("client_port", client_port, 1, 65536 - len(fleet))
        self._wires = [Wire(k + 1) for k in range(len(fleet))]
        super().__init__(len(fleet), host, port, fleet.airspace.period, speed)
        self.fleet = fleet
        self.refused = self.received = self.sent = 0
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self.connections: list[Connections[Address]] = [
            Connections(limits, clock) for _ in self.ports
        ]
        # Messages of a datagram that had more than are taken in one go
        self._waiting: list[deque[tuple[Message, Address]]] = [deque() for _ in self.ports]
        self._always: list[tuple[Address, ...]] = [
            () if client_port is None else ((host, client_port + k),) for k in range(len(fleet))
        ]

    @property
    def malformed(self) -> int:
        """Number of datagrams that held what is no frame of MAVLink."""
        return sum(wire.malformed for wire in self._wires)

    def _step(self) -> None:
        """Fly for 10 ms, and send what vehicles tell."""
        for i, told in enumerate(self.fleet.step()):
            if told:
                self._send_all(i, told)

    def _received(self) -> list[int]:
        """Return the vehicles that have messages which are received already, but not taken."""
        return [i for i, waiting in enumerate(self._waiting) if waiting]

    def _send_all(self, i: int, told: list[Told]) -> None:
        """Send messages of a vehicle to all its peers; those that have gone are forgotten."""
        connections = self.connections[i]
        for address in connections.overdue():
            connections.remove(address)
        wanted = dict.fromkeys((*self._always[i], *connections.all()))
        if not wanted:
            return
        self.sent += len(told)
        frames = [self._wires[i].pack(one) for one in told]
        for datagram in packed(frames, MOST_DATAGRAM):
            for address in wanted:
                self._send_to(i, datagram, address)

    def _read(self, i: int) -> None:
        """Take the messages that have come for a vehicle, as many as may be in one go."""
        waiting = self._waiting[i]
        for _ in range(MOST_READ):
            if not waiting and not self._receive(i):
                return
            if waiting:
                self._take(i, *waiting.popleft())

    def _receive(self, i: int) -> bool:
        """Receive a datagram, whose messages wait; return False if there is none."""
        try:
            datagram, address = self._sockets[i].recvfrom(MOST_DATAGRAM)
        # Nothing is left; or, on Windows, a client that was sent something has gone.
        except OSError:
            return False
        messages = self._wires[i].read(datagram)
        self._waiting[i].extend((message, address[:2]) for message in messages)
        return True

    def _take(self, i: int, message: Message, address: Address) -> None:
        """Take a message, and send the answers."""
        if not self._admit(i, message, address):
            return
        sender = Sender(message.get_srcSystem(), message.get_srcComponent(), address)
        told = self.fleet.take(i, message, sender)
        if reason := refusal_of(told):
            call = f"{describe(message)} to vehicle {i + 1}"
            self._refusals.log(join_address(*address), call, reason)
        self._send_frames(i, told, address)
        self.received += 1

    def _send_frames(self, i: int, told: list[Told], address: Address) -> None:
        """Send messages of a vehicle to one address."""
        frames = [self._wires[i].pack(one) for one in told]
        for datagram in packed(frames, MOST_DATAGRAM):
            self._send_to(i, datagram, address)
        self.sent += len(told)

    def _admit(self, i: int, message: Message, address: Address) -> bool:
        """Record that a peer was heard; return False if there is no room for it.

        Heartbeats alone take no client's place: they come from any number of ports in a flood.
        """
        connections = self.connections[i]
        try:
            if message.get_type() != "HEARTBEAT":
                connections.request(address)
            elif address in connections:
                connections.touch(address)
            else:
                connections.add(address)
        except FullError as error:
            self.refused += 1
            event = f"refused by vehicle {i + 1}: {error}; close one first"
            if self._refusals.log_connection(join_address(*address), event):
                self._send_frames(i, [text("refused: too many clients, try later")], address)
            return False
        return True
