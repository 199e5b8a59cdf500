"""Server of virtual Crazyflies: each drone is a UDP port that cflib connects to.

    server = CrazyflieServer(Fleet(10))
    server.run()

Clients open `udp://127.0.0.1:19850` and the ports after it, one for each drone.
"""

import logging
import time
from dataclasses import dataclass

from bulletuav.bridges.crazyflie_fleet import Fleet
from bulletuav.bridges.crtp import MOST_DATA, NULL, MalformedError, Packet, Port
from bulletuav.bridges.sockets import LOG_NAME, Address, DatagramServer
from bulletuav.envs.viewer import join_address
from bulletuav.serving.connections import Clock, ConnectionLimits
from bulletuav.serving.refusals import Refusals

PORT = 19850
"""Port of the first drone; cflib looks for drones at this one and the nine after it"""
LIMITS = ConnectionLimits(max_clients=1, grace=0.5, max_idle=10.0)
"""Limits of a drone's client. Another one may have the drone after `grace` seconds of silence, as
cflib pings at 10 Hz. After `max_idle` seconds it is sent no more logs."""
SERVICES = frozenset(Port) - {Port.CONSOLE}
"""Ports that clients send to"""
MOST_READ = 16
"""Most packets that are taken from a drone's socket in one go: others wait, or are dropped"""


@dataclass
class Peer:
    """The client of a drone.

    Attributes:
        address: Where it is.
        heard: When it was heard last, by the clock, s.
        left: Whether its last packet was a command of zero, with which clients close a link.
    """

    address: Address
    heard: float
    left: bool = False


class CrazyflieServer(DatagramServer):
    """Sockets, one a drone, around a fleet that flies in real time.

    Attributes:
        fleet: The drones.
        uris: Addresses that clients open.
        pacer: Keeps the time; tells how many steps were late.
        refused: How many packets came from clients whose drone another one has.
    """

    def __init__(
        self,
        fleet: Fleet,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
    ) -> None:
        """Open the ports; clients are answered once it runs.

        Args:
            fleet: The drones.
            host: Address to listen at. Whoever can reach it can fly the drones.
            port: Of the first drone; 0 for free ones.
            speed: Simulated seconds in one of the clock.
            limits: Limits of each drone's client.
            clock: Function that returns the time by which clients are silent, s.

        Raises:
            ValueError: The port or the speed cannot be.
            OSError: A port is in use, or there is no such address.
        """
        super().__init__(len(fleet), host, port, fleet.airspace.period, speed)
        self.fleet = fleet
        self.refused = 0
        self._limits, self._clock = limits, clock
        self._refusals = Refusals(logging.getLogger(LOG_NAME), clock)
        self._peers: list[Peer | None] = [None] * len(fleet)
        self._waiting: dict[int, tuple[Address, Packet]] = {}
        self.uris = [f"udp://{join_address(host, one)}" for one in self.ports]

    def _step(self) -> None:
        """Fly for 10 ms, and send logs."""
        for i, packet in self.fleet.step():
            self._send(i, packet)
        self._serve_waiting()

    def _read(self, i: int) -> None:
        """Take the packets that have come for a drone, as many as may be in one go."""
        for _ in range(MOST_READ):
            try:
                datagram, address = self._sockets[i].recvfrom(MOST_DATA + 2)
            # Nothing is left; or, on Windows, a client that was sent something has gone.
            except OSError:
                return
            self._take(i, datagram, address[:2])

    def _take(
        self,
        i: int,
        datagram: bytes,
        address: Address,
    ) -> None:
        """Take one packet."""
        if datagram[:1] == NULL[:1]:
            # A client looks for drones: this is no connection.
            if len(datagram) == 1:
                self._send_to(i, NULL, address)
            return
        try:
            packet = Packet.parse(datagram)
        except MalformedError:
            self.fleet.vehicles[i].malformed += 1
            return
        # Such as those of WebRTC, which a page in a browser can send here
        if packet.port not in SERVICES:
            self.fleet.vehicles[i].malformed += 1
            return
        peer = self._peers[i]
        if peer is not None and peer.address != address and not self._gone(peer):
            self._refuse(i, packet, address, peer)
            return
        self._connect(i, address, packet)

    def _gone(self, peer: Peer) -> bool:
        """Return True if a client has gone, as far as can be known."""
        return peer.left or self._clock() - peer.heard > self._limits.grace

    def _refuse(
        self,
        i: int,
        packet: Packet,
        address: Address,
        peer: Peer,
    ) -> None:
        """Let a second client of a drone wait; its request to connect is kept."""
        self.refused += 1
        text = f"drone {i} is flown by port {peer.address[1]}"
        event = f"refused: {text}; close that link first"
        self._refusals.log_connection(join_address(*address), event)
        if packet.port == Port.LINK and packet.channel == 1:
            self._waiting[i] = (address, packet)
            line = f"{text}\n".encode()[:MOST_DATA]
            self._send_to(i, Packet(Port.CONSOLE, 0, line).frame(), address)

    def _connect(
        self,
        i: int,
        address: Address,
        packet: Packet,
    ) -> None:
        """Take a packet of a drone's own client, or of a new one."""
        peer = self._peers[i]
        if peer is None or peer.address != address:
            self.fleet.vehicles[i].leave()
        is_end = packet.port == Port.ATTITUDE_SETPOINT and not any(packet.data)
        self._peers[i] = Peer(address, self._clock(), is_end)
        for answer in self.fleet.take(i, packet):
            self._send(i, answer)
        if reason := self.fleet.vehicles[i].refusal:
            port = Port(packet.port).name if packet.port in tuple(Port) else packet.port
            call = f"packet to {port}, channel {packet.channel}, of drone {i}"
            self._refusals.log(join_address(*address), call, reason)

    def _serve_waiting(self) -> None:
        """Connect clients that waited, where the one before has gone."""
        for i, (address, packet) in list(self._waiting.items()):
            peer = self._peers[i]
            if peer is None or self._gone(peer):
                del self._waiting[i]
                self._connect(i, address, packet)

    def _send(self, i: int, packet: Packet) -> None:
        """Send a packet to a drone's client, if it is there."""
        peer = self._peers[i]
        if peer is None:
            return
        if self._clock() - peer.heard > self._limits.max_idle:
            self._peers[i] = None
            self.fleet.vehicles[i].leave()
            return
        self._send_to(i, packet.frame(), peer.address)
