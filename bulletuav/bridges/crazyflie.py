"""Server of virtual Crazyflies: each drone is a UDP port that cflib connects to.

    server = CrazyflieServer(Fleet(10))
    server.run()

Clients open `udp://127.0.0.1:19850` and the ports after it, one for each drone.
"""

import contextlib
import selectors
import socket
import time
from dataclasses import dataclass

from bulletuav.bridges.crazyflie_fleet import Fleet
from bulletuav.bridges.crtp import MOST_DATA, NULL, MalformedError, Packet, Port
from bulletuav.envs.pacer import Pacer
from bulletuav.errors import as_int

PORT = 19850
"""Port of the first drone; cflib looks for drones at this one and the nine after it"""
SILENT = 0.5
"""How long a client says nothing until another may have its drone, s; cflib pings at 10 Hz"""
GONE = 10.0
"""How long a client says nothing until it is sent no more logs, s"""
MOST_READ = 16
"""Most packets that are taken from a drone's socket in one go: others wait, or are dropped"""

Address = tuple[str, int]


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


class CrazyflieServer:
    """Sockets, one a drone, around a fleet that flies in real time.

    Attributes:
        fleet: The drones.
        uris: Addresses that clients open.
        pacer: Keeps the time; tells how many steps were late.
        refused: How many packets came from clients whose drone another one has.
    """

    def __init__(
        self, fleet: Fleet, host: str = "127.0.0.1", port: int = PORT, speed: float = 1.0
    ) -> None:
        """Open the ports; clients are answered once it runs.

        Args:
            fleet: The drones.
            host: Address to listen at. Whoever can reach it can fly the drones.
            port: Of the first drone; 0 for free ones.
            speed: Simulated seconds in one of the clock.

        Raises:
            ValueError: The port or the speed cannot be.
            OSError: A port is in use, or there is no such address.
        """
        as_int("port", port, 0, 65536 - len(fleet) if port else 0)
        self.fleet = fleet
        self.pacer = Pacer(fleet.airspace.period, speed, _sleep=self._answer_for)
        self.refused = 0
        self._peers: list[Peer | None] = [None] * len(fleet)
        self._waiting: dict[int, tuple[Address, Packet]] = {}
        self._selector = selectors.DefaultSelector()
        self._sockets: list[socket.socket] = []
        try:
            for i in range(len(fleet)):
                self._open(host, port + i if port else 0)
        except OSError:
            self.close()
            raise
        self.uris = [f"udp://{host}:{one.getsockname()[1]}" for one in self._sockets]

    def _open(self, host: str, port: int) -> None:
        """Open the socket of the next drone."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        one = socket.socket(family, socket.SOCK_DGRAM)
        self._sockets.append(one)
        one.setblocking(False)
        try:
            one.bind((host, port))
        except OSError as error:
            reason = error.strerror or error
            raise OSError(
                f"cannot listen at {host}, port {port} (UDP): {reason}; is another server running? "
                f"Choose another port"
            ) from error
        self._selector.register(one, selectors.EVENT_READ, len(self._sockets) - 1)

    def run(self, seconds: float | None = None) -> None:
        """Fly and answer.

        Args:
            seconds: How long, simulated; until it is interrupted, if left out.

        Raises:
            RuntimeError: The flight diverged.
        """
        end = None if seconds is None else self.fleet.time + seconds
        self.pacer.restart()
        while end is None or self.fleet.time < end - 1e-9:
            for i, packet in self.fleet.step():
                self._send(i, packet)
            self._serve_waiting()
            # A late loop does not sleep: packets are taken all the same.
            if self.pacer.wait():
                self._answer_for(0.0)

    def _answer_for(self, seconds: float) -> None:
        """Answer packets for a time, s."""
        end = time.perf_counter() + seconds
        while True:
            for key, _ in self._selector.select(max(end - time.perf_counter(), 0.0)):
                self._read(key.data)
            if time.perf_counter() >= end:
                return

    def _read(self, i: int) -> None:
        """Take the packets that have come for a drone, as many as may be in one go."""
        for _ in range(MOST_READ):
            try:
                datagram, address = self._sockets[i].recvfrom(MOST_DATA + 2)
            # Nothing is left; or, on Windows, a client that was sent something has gone.
            except OSError:
                return
            self._take(i, datagram, address[:2])

    def _take(self, i: int, datagram: bytes, address: Address) -> None:
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
        peer = self._peers[i]
        if peer is not None and peer.address != address and not self._gone(peer):
            self._refuse(i, packet, address, peer)
            return
        self._connect(i, address, packet)

    @staticmethod
    def _gone(peer: Peer) -> bool:
        """Tell whether a client has gone, as far as can be known."""
        return peer.left or time.perf_counter() - peer.heard > SILENT

    def _refuse(self, i: int, packet: Packet, address: Address, peer: Peer) -> None:
        """Let a second client of a drone wait; its request to connect is kept."""
        self.refused += 1
        if packet.port == Port.LINK and packet.channel == 1:
            self._waiting[i] = (address, packet)
            text = f"drone {i} is flown by port {peer.address[1]}\n".encode()
            self._send_to(i, Packet(Port.CONSOLE, 0, text[:MOST_DATA]).frame(), address)

    def _connect(self, i: int, address: Address, packet: Packet) -> None:
        """Take a packet of a drone's own client, or of a new one."""
        peer = self._peers[i]
        if peer is None or peer.address != address:
            self.fleet.vehicles[i].leave()
        is_end = packet.port == Port.ATTITUDE_SETPOINT and not any(packet.data)
        self._peers[i] = Peer(address, time.perf_counter(), is_end)
        for answer in self.fleet.take(i, packet):
            self._send(i, answer)

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
        if time.perf_counter() - peer.heard > GONE:
            self._peers[i] = None
            self.fleet.vehicles[i].leave()
            return
        self._send_to(i, packet.frame(), peer.address)

    def _send_to(self, i: int, datagram: bytes, address: Address) -> None:
        """Send a datagram; one that cannot be sent is lost, as on the radio."""
        with contextlib.suppress(OSError):
            self._sockets[i].sendto(datagram, address)

    def close(self) -> None:
        """Close the ports; the fleet stays."""
        for one in self._sockets:
            one.close()
        self._selector.close()
