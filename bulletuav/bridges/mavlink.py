"""UDP server of MAVLink vehicles: one port for each vehicle.

    server = MavlinkServer(MavlinkFleet(10))
    server.run()

Vehicle k is system k + 1. It sends to port 14540 + k, as PX4 does, and to all clients that send
messages to its own port, 18570 + k.
"""

import logging
import time
from collections import deque

from bulletuav.bridges.links import IDEAL, LinkQuality
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_protocol import MavlinkCodec, Message, OutgoingMessage, Sender, text
from bulletuav.bridges.mavlink_services import describe_message, find_refusal_reason, join_frames
from bulletuav.bridges.sockets import LOG_NAME, Address, DatagramServer
from bulletuav.envs.viewer import join_address
from bulletuav.errors import as_int
from bulletuav.serving.connections import Clock, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals

PORT = 18570
"""Port of the first vehicle"""
CLIENT_PORT = 14540
"""Port to which the first vehicle sends unasked, at which MAVSDK listens"""
LIMITS = ConnectionLimits(
    max_clients=8, max_pending=8, handshake=10.0, max_idle=10.0, grace=5.0, pending_grace=3.0
)
"""Limits of a vehicle's clients; a client is pending while it has sent nothing but heartbeats"""
MAX_DATAGRAM_SIZE = 1400
"""Maximum size of a datagram, bytes; longer datagrams are truncated"""
MAX_MESSAGES_PER_READ = 32
"""Maximum number of messages of a vehicle that are handled in a row; others wait"""


class MavlinkServer(DatagramServer):
    """Server with one UDP socket for each vehicle of a fleet, which flies in real time.

    Attributes:
        fleet: The vehicles.
        pacer: Pacer of the real-time loop, which counts late steps.
        ports: Port of each vehicle.
        malformed: Number of datagrams with bytes that are not a MAVLink frame.
        refused: Number of messages from clients beyond the limit.
        connections: Clients of each vehicle.
        received, sent: Numbers of messages.
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
        quality: LinkQuality = IDEAL,
    ) -> None:
        """Open the ports; clients are answered once `run` is called.

        Args:
            fleet: The vehicles.
            host: Address to listen at. Anybody who can reach it can fly the vehicles.
            port: Port of the first vehicle; 0 for free ports.
            speed: Simulated seconds per second of real time.
            client_port: Port at the same address to which the first vehicle sends unasked. Further
                vehicles send to the following ports. None for no such ports.
            limits: Limits of the clients of each vehicle.
            clock: Function that returns the time by which clients are idle, s.
            quality: Losses and delay of the datagrams.

        Raises:
            ValueError: If a port, the speed, the losses or the delay are invalid.
            OSError: If a port is in use, or the address does not exist.
            ImportError: If pymavlink is not installed.
        """
        if client_port is not None:
            as_int("client_port", client_port, 1, 65536 - len(fleet))
        self._codecs = [MavlinkCodec(k + 1) for k in range(len(fleet))]
        super().__init__(len(fleet), host, port, fleet.airspace.period, speed, quality)
        self.fleet = fleet
        self.refused = self.received = self.sent = 0
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self.connections: list[Connections[Address]] = [
            Connections(limits, clock) for _ in self.ports
        ]
        # Received messages beyond the limit per read
        self._waiting: list[deque[tuple[Message, Address]]] = [deque() for _ in self.ports]
        self._client_addresses: list[tuple[Address, ...]] = [
            () if client_port is None else ((host, client_port + k),) for k in range(len(fleet))
        ]

    @property
    def malformed(self) -> int:
        """Number of datagrams with bytes that are not a MAVLink frame."""
        return sum(wire.malformed for wire in self._codecs)

    def _step(self) -> None:
        """Fly for one step of 10 ms, and send telemetry."""
        for i, messages in enumerate(self.fleet.step()):
            if messages:
                self._broadcast(i, messages)

    def _received(self) -> list[int]:
        """Return the vehicles with received messages that have not been handled."""
        waiting = [i for i, messages in enumerate(self._waiting) if messages]
        return [*waiting, *super()._received()]

    def _broadcast(self, i: int, messages: list[OutgoingMessage]) -> None:
        """Send messages of a vehicle to all its clients, and remove idle clients."""
        connections = self.connections[i]
        for address in connections.overdue():
            connections.remove(address)
        addresses = dict.fromkeys((*self._client_addresses[i], *connections.all()))
        if not addresses:
            return
        self.sent += len(messages)
        frames = [self._codecs[i].pack(message) for message in messages]
        for datagram in join_frames(frames, MAX_DATAGRAM_SIZE):
            for address in addresses:
                self._send_to(i, datagram, address)

    def _read(self, i: int) -> None:
        """Handle messages for a vehicle, up to `MAX_MESSAGES_PER_READ`."""
        waiting = self._waiting[i]
        for _ in range(MAX_MESSAGES_PER_READ):
            if not waiting and not self._receive(i):
                return
            if waiting:
                self._handle_message(i, *waiting.popleft())

    def _receive(self, i: int) -> bool:
        """Receive a datagram and queue its messages; return False if there is none."""
        received = self._receive_datagram(i, MAX_DATAGRAM_SIZE)
        if received is None:
            return False
        datagram, address = received
        messages = self._codecs[i].read(datagram)
        self._waiting[i].extend((message, address) for message in messages)
        return True

    def _handle_message(self, i: int, message: Message, address: Address) -> None:
        """Handle a message, and send the answers to its sender."""
        if not self._admit(i, message, address):
            return
        sender = Sender(message.get_srcSystem(), message.get_srcComponent(), address)
        messages = self.fleet.take(i, message, sender)
        if reason := find_refusal_reason(messages):
            call = f"{describe_message(message)} to vehicle {i + 1}"
            self._refusals.log(join_address(*address), call, reason)
        self._send_messages(i, messages, address)
        self.received += 1

    def _send_messages(self, i: int, messages: list[OutgoingMessage], address: Address) -> None:
        """Send messages of a vehicle to one address."""
        frames = [self._codecs[i].pack(message) for message in messages]
        for datagram in join_frames(frames, MAX_DATAGRAM_SIZE):
            self._send_to(i, datagram, address)
        self.sent += len(messages)

    def _admit(self, i: int, message: Message, address: Address) -> bool:
        """Register activity of a client; return False if the vehicle has too many clients.

        Clients that send heartbeats alone have a limit of their own, so that a flood of heartbeats
        from many ports cannot displace a client that commands the vehicle.
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
                self._send_messages(i, [text("refused: too many clients, try later")], address)
            return False
        return True
