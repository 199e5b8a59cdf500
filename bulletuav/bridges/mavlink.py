"""Server of MAVLink vehicles: each is a UDP port, and sends to the port where clients listen.

    server = MavlinkServer(MavlinkFleet(10))
    server.run()

Vehicle k is system k + 1. It sends to port 14540 + k, as PX4 does, and to whoever speaks to it at
its own port, 18570 + k.
"""

import time

from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_services import describe, packed, refusal_of
from bulletuav.bridges.mavlink_wire import Sender, Told, Wire
from bulletuav.bridges.refusals import Refusals, address_text
from bulletuav.bridges.sockets import Address, DatagramServer
from bulletuav.errors import as_int

PORT = 18570
"""Port of the first vehicle"""
CLIENT_PORT = 14540
"""Port to which the first vehicle sends without being asked: MAVSDK listens there"""
GONE = 10.0
"""How long a client says nothing until it is sent nothing more, s"""
MOST_CLIENTS = 8
"""Most clients of a vehicle at once"""
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
        refused: How many came from clients for whom there was no room.
        received, sent: How many messages.
    """

    def __init__(
        self,
        fleet: MavlinkFleet,
        host: str = "127.0.0.1",
        port: int = PORT,
        speed: float = 1.0,
        client_port: int | None = CLIENT_PORT,
    ) -> None:
        """Open the ports; clients are answered once it runs.

        Args:
            fleet: The vehicles.
            host: Address to listen at. Whoever can reach it can fly the vehicles.
            port: Of the first vehicle; 0 for free ones.
            speed: Simulated seconds in one of the clock.
            client_port: Port at the same address to which the first vehicle sends without being
                asked, the others to those after it; None for nowhere.

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
        self._refusals = Refusals()
        # When each client was heard last
        self._clients: list[dict[Address, float]] = [{} for _ in self.ports]
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

    def _send_all(self, i: int, told: list[Told]) -> None:
        """Send messages of a vehicle to all its clients; those that have gone are forgotten."""
        now, clients = time.perf_counter(), self._clients[i]
        for address in [one for one, heard in clients.items() if now - heard > GONE]:
            del clients[address]
        wanted = dict.fromkeys((*self._always[i], *clients))
        if not wanted:
            return
        self.sent += len(told)
        frames = [self._wires[i].pack(one) for one in told]
        for datagram in packed(frames, MOST_DATAGRAM):
            for address in wanted:
                self._send_to(i, datagram, address)

    def _read(self, i: int) -> None:
        """Take the messages that have come for a vehicle, as many as may be in one go."""
        left = MOST_READ
        while left > 0:
            try:
                datagram, address = self._sockets[i].recvfrom(MOST_DATAGRAM)
            # Nothing is left; or, on Windows, a client that was sent something has gone.
            except OSError:
                return
            left -= max(self._take(i, datagram, address[:2]), 1)

    def _take(
        self,
        i: int,
        datagram: bytes,
        address: Address,
    ) -> int:
        """Take a datagram; tell how many messages it had."""
        messages = self._wires[i].read(datagram)
        if not messages or not self._knows(i, address):
            return 1
        for message in messages:
            sender = Sender(message.get_srcSystem(), message.get_srcComponent(), address)
            told = self.fleet.take(i, message, sender)
            if reason := refusal_of(told):
                call = f"{describe(message)} to vehicle {i + 1}"
                self._refusals.log(address_text(*address), call, reason)
            frames = [self._wires[i].pack(one) for one in told]
            for answer in packed(frames, MOST_DATAGRAM):
                self._send_to(i, answer, address)
            self.sent += len(told)
        self.received += len(messages)
        return len(messages)

    def _knows(self, i: int, address: Address) -> bool:
        """Take a client in, or note that it is still there; tell whether there is room for it."""
        clients = self._clients[i]
        if address not in clients and len(clients) >= MOST_CLIENTS:
            self.refused += 1
            # Addresses can be made up: those of a vehicle share one entry of the log
            reason = f"there are {MOST_CLIENTS} clients already; close one first"
            self._refusals.log(f"beyond the limit of vehicle {i + 1}", "connection", reason)
            return False
        clients[address] = time.perf_counter()
        return True
