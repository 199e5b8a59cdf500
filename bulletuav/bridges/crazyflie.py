"""UDP server of virtual Crazyflies: cflib connects to one port for each drone.

    server = CrazyflieServer(CrazyflieFleet(10))
    server.run()

Clients open `udp://127.0.0.1:19850` and the following ports, one for each drone.
"""

import logging
import time
from dataclasses import dataclass

from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.crtp import MAX_DATA_SIZE, NULL_PACKET, CrtpPort, MalformedError, Packet
from bulletuav.bridges.links import IDEAL, LinkQuality
from bulletuav.bridges.sockets import LOG_NAME, Address, DatagramServer
from bulletuav.envs.viewer import join_address
from bulletuav.serving.connections import Clock, ConnectionLimits
from bulletuav.serving.refusals import Refusals

PORT = 19850
"""Port of the first drone; cflib scans this port and the nine after it"""
LIMITS = ConnectionLimits(max_clients=1, grace=0.5, max_idle=10.0)
"""Limits of a drone's client. Another client may take the drone after `grace` seconds of silence
(cflib pings at 10 Hz). After `max_idle` seconds the client receives no more logs."""
SERVICES = frozenset(CrtpPort) - {CrtpPort.CONSOLE}
"""Ports to which clients send"""
MAX_PACKETS_PER_READ = 16
"""Maximum number of packets that are read from a drone's socket in a row; others wait"""


@dataclass
class CrazyflieClient:
    """Client of a drone.

    Attributes:
        address: Address of the client.
        last_heard: Time of the client's last packet by the server's clock, s.
        has_closed_link: Whether the last packet was a thrust command of zero, with which cflib
            closes a link.
    """

    address: Address
    last_heard: float
    has_closed_link: bool = False


class CrazyflieServer(DatagramServer):
    """Server with one UDP socket for each drone of a fleet, which flies in real time.

    Attributes:
        fleet: The drones.
        uris: URIs that clients open.
        pacer: Pacer of the real-time loop, which counts late steps.
        refused: Number of packets from clients whose drone is in use by another client.
    """

    def __init__(
        self,
        fleet: CrazyflieFleet,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
        quality: LinkQuality = IDEAL,
    ) -> None:
        """Open the ports; clients are answered once `run` is called.

        Args:
            fleet: The drones.
            host: Address to listen at. Anybody who can reach it can fly the drones.
            port: Port of the first drone; 0 for free ports.
            speed: Simulated seconds per second of real time.
            limits: Limits of each drone's client.
            clock: Function that returns the time by which clients are silent, s.
            quality: Losses and delay of the packets.

        Raises:
            ValueError: If the port, the speed, the losses or the delay are invalid.
            OSError: If a port is in use, or the address does not exist.
        """
        super().__init__(len(fleet), host, port, fleet.airspace.period, speed, quality)
        self.fleet = fleet
        self.refused = 0
        self._limits, self._clock = limits, clock
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self._peers: list[CrazyflieClient | None] = [None] * len(fleet)
        self._waiting: dict[int, tuple[Address, Packet]] = {}
        self.uris = [f"udp://{join_address(host, port)}" for port in self.ports]

    def _step(self) -> None:
        """Fly for one step of 10 ms, and send log packets."""
        for i, packet in self.fleet.step():
            self._send(i, packet)
        self._serve_waiting()

    def _read(self, i: int) -> None:
        """Read packets for a drone, up to `MAX_PACKETS_PER_READ`."""
        for _ in range(MAX_PACKETS_PER_READ):
            received = self._receive_datagram(i, MAX_DATA_SIZE + 2)
            if received is None:
                return
            self._handle_datagram(i, *received)

    def _handle_datagram(self, i: int, datagram: bytes, address: Address) -> None:
        """Handle one datagram: a scan, or a packet from the drone's client or from another one."""
        if datagram[:1] == NULL_PACKET[:1]:
            # A scan for drones does not connect
            if len(datagram) == 1:
                self._send_to(i, NULL_PACKET, address)
            return
        try:
            packet = Packet.parse(datagram)
        except MalformedError:
            self.fleet.vehicles[i].malformed += 1
            return
        # For example WebRTC requests, which a page in a browser can send to this port
        if packet.port not in SERVICES:
            self.fleet.vehicles[i].malformed += 1
            return
        peer = self._peers[i]
        if peer is not None and peer.address != address and not self._is_gone(peer):
            self._refuse_client(i, packet, address, peer)
            return
        self._serve_client(i, address, packet)

    def _is_gone(self, peer: CrazyflieClient) -> bool:
        """Return True if a client has closed its link or has been silent longer than `grace`."""
        return peer.has_closed_link or self._clock() - peer.last_heard > self._limits.grace

    def _refuse_client(
        self, i: int, packet: Packet, address: Address, peer: CrazyflieClient
    ) -> None:
        """Refuse a second client of a drone; a request to connect waits until the drone is free."""
        self.refused += 1
        text = f"drone {i} is in use by port {peer.address[1]}"
        event = f"refused: {text}; close that link first"
        self._refusals.log_connection(join_address(*address), event)
        if packet.port == CrtpPort.LINK and packet.channel == 1:
            self._waiting[i] = (address, packet)
            line = f"{text}\n".encode()[:MAX_DATA_SIZE]
            self._send_to(i, Packet(CrtpPort.CONSOLE, 0, line).frame(), address)

    def _serve_client(self, i: int, address: Address, packet: Packet) -> None:
        """Handle a packet of a drone's present or new client, and send the answers."""
        peer = self._peers[i]
        if peer is None or peer.address != address:
            self.fleet.vehicles[i].reset_client()
        is_end = packet.port == CrtpPort.SETPOINT and not any(packet.data)
        self._peers[i] = CrazyflieClient(address, self._clock(), is_end)
        for answer in self.fleet.take(i, packet):
            self._send(i, answer)
        if reason := self.fleet.vehicles[i].refusal:
            port = CrtpPort(packet.port).name if packet.port in tuple(CrtpPort) else packet.port
            call = f"packet to {port}, channel {packet.channel}, of drone {i}"
            self._refusals.log(join_address(*address), call, reason)

    def _serve_waiting(self) -> None:
        """Connect waiting clients to drones whose client has gone."""
        for i, (address, packet) in list(self._waiting.items()):
            peer = self._peers[i]
            if peer is None or self._is_gone(peer):
                del self._waiting[i]
                self._serve_client(i, address, packet)

    def _send(self, i: int, packet: Packet) -> None:
        """Send a packet to a drone's client; disconnect the client if it is idle for too long."""
        peer = self._peers[i]
        if peer is None:
            return
        if self._clock() - peer.last_heard > self._limits.max_idle:
            self._peers[i] = None
            self.fleet.vehicles[i].reset_client()
            return
        self._send_to(i, packet.frame(), peer.address)
