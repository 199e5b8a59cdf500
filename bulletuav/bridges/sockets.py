"""Sockets of servers that step a simulation in real time and answer clients between steps."""

import contextlib
import math
import selectors
import socket
import time
from abc import ABC, abstractmethod

from bulletuav.bridges.links import Address as Address
from bulletuav.bridges.links import Datagram, LinkQuality, LossyLink
from bulletuav.envs.pacer import Pacer
from bulletuav.errors import as_int

LOG_NAME = "bulletuav.bridges"
"""Name of the logger for rejected calls and connections"""


LATE_READ_FRACTION = 0.25
"""Fraction of the duration of a step for which a late server still reads packets, so that a flood
of packets cannot stop the flight"""
MAX_UNDELIVERED = 64
"""Maximum number of datagrams that are received in a row without one that a link delivers"""


def make_listen_error(host: str, port: int, kind: str, error: OSError) -> OSError:
    """Return the error for a port at which a server cannot listen.

    Args:
        host: Requested address.
        port: Requested port.
        kind: "TCP" or "UDP".
        error: Error that the operating system raised.

    Returns:
        The error, for the caller to raise.
    """
    return OSError(
        f"cannot listen at {host}, port {port} ({kind}): {error.strerror or error}; is another "
        f"server running? Choose another port"
    )


def open_listener(host: str, port: int) -> socket.socket:
    """Open a TCP socket that listens for connections.

    Args:
        host: IPv4 or IPv6 address, or host name.
        port: Port; 0 for a free one.

    Returns:
        The socket.

    Raises:
        OSError: If the port is in use or the address does not exist.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise make_listen_error(host, port, "TCP", error) from error


class DatagramServer(ABC):
    """UDP server with one socket for each drone, around a simulation that is stepped in real time.

    Subclasses implement `_step`, which steps the simulation, and `_read`, which handles datagrams.

    Attributes:
        pacer: Real-time pacer; it counts the steps that were late.
        ports: UDP port of each drone.
    """

    def __init__(
        self,
        num_drones: int,
        host: str,
        port: int,
        period: float,
        speed: float,
        quality: LinkQuality,
    ) -> None:
        """Open one port for each drone; clients are answered while `run` runs.

        Args:
            num_drones: Number of drones.
            host: Address to listen at. Anyone who can reach this address can fly the drones.
            port: Port of the first drone; 0 for free ports.
            period: Duration of a step, s.
            speed: Real-time factor: simulated seconds per second of wall-clock time.
            quality: Losses and delay of the datagrams.

        Raises:
            ValueError: If the port, the speed, the losses or the delay are out of range.
            OSError: If a port is in use or the address does not exist.
        """
        as_int("port", port, 0, 65536 - num_drones if port else 0)
        quality.check()
        # Links from and to clients; none if all datagrams arrive
        self._uplinks, self._downlinks = (
            []
            if quality.is_ideal
            else [LossyLink(quality, period, (i, way)) for i in range(num_drones)]
            for way in range(2)
        )
        self._num_steps = 0
        self.pacer = Pacer(period, speed, _sleep=self._serve_packets)
        self._selector = selectors.DefaultSelector()
        self._sockets: list[socket.socket] = []
        # Index of the drone whose packets are read first
        self._first_drone = 0
        try:
            for i in range(num_drones):
                self._open(host, port + i if port else 0)
        except OSError:
            self.close()
            raise
        self.ports: list[int] = [sock.getsockname()[1] for sock in self._sockets]

    def _open(self, host: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_DGRAM)
        self._sockets.append(sock)
        sock.setblocking(False)
        try:
            sock.bind((host, port))
        except OSError as error:
            raise make_listen_error(host, port, "UDP", error) from error
        self._selector.register(sock, selectors.EVENT_READ, len(self._sockets) - 1)

    def run(self, seconds: float | None = None) -> None:
        """Step the simulation in real time and answer clients.

        Args:
            seconds: Simulated duration, s. None runs until interrupted.

        Raises:
            RuntimeError: If the simulation diverged.
        """
        steps = math.inf if seconds is None else math.ceil(seconds / self.pacer.period - 1e-6)
        num_steps = 0
        self.pacer.restart()
        while num_steps < steps:
            self._num_steps += 1
            self._deliver()
            self._step()
            num_steps += 1
            # A late loop does not sleep, but still has to read packets.
            if self.pacer.wait():
                self._serve_packets(0.0)

    def _serve_packets(self, seconds: float) -> None:
        """Answer packets for a duration, but at least for `LATE_READ_FRACTION` of a step.

        Drones are served in rotation: the next call starts with the first drone that was not
        served.

        Args:
            seconds: Time until the next step, s of wall-clock time.
        """
        start = time.perf_counter()
        end = start + seconds
        limit = max(end, start + LATE_READ_FRACTION * self.pacer.period / self.pacer.speed)
        while True:
            received = self._received()
            timeout = 0.0 if received else max(end - time.perf_counter(), 0.0)
            ready = {key.data for key, _ in self._selector.select(timeout)}.union(received)
            for i in sorted(ready, key=lambda i: (i - self._first_drone) % len(self._sockets)):
                self._read(i)
                self._first_drone = i + 1
                if time.perf_counter() >= limit:
                    return
            if time.perf_counter() >= end:
                return

    def _received(self) -> list[int]:
        """Return the indices of drones with packets that are received but not handled yet."""
        return [i for i, link in enumerate(self._uplinks) if link.has_due(self._num_steps)]

    def _receive_datagram(self, i: int, max_size: int) -> Datagram | None:
        """Return the next datagram for a drone, or None.

        Lost and delayed datagrams are received until the link delivers one, the socket is empty, or
        `MAX_UNDELIVERED` is reached.

        Args:
            i: Index of the drone.
            max_size: Number of bytes after which a datagram is cut.
        """
        for _ in range(MAX_UNDELIVERED):
            try:
                datagram, address = self._sockets[i].recvfrom(max_size)
            # The socket is empty; or, on Windows, the receiver of an earlier datagram has gone
            except OSError:
                break
            received = (datagram, address[:2])
            if not self._uplinks:
                return received
            self._uplinks[i].put(received, self._num_steps)
            if self._uplinks[i].has_due(self._num_steps):
                break
        return self._uplinks[i].get(self._num_steps) if self._uplinks else None

    @abstractmethod
    def _step(self) -> None:
        """Step the simulation, and send the messages that are due."""

    @abstractmethod
    def _read(self, i: int) -> None:
        """Handle packets that arrived for drone `i`, up to the limit for one call."""

    def _send_to(self, i: int, datagram: bytes, address: Address) -> None:
        """Send a datagram; a datagram that cannot be sent is lost, as on the radio."""
        if self._downlinks:
            self._downlinks[i].put((datagram, address), self._num_steps)
            self._deliver()
        else:
            self._transmit(i, datagram, address)

    def _deliver(self) -> None:
        """Send the delayed datagrams that are due."""
        for i, link in enumerate(self._downlinks):
            while (due := link.get(self._num_steps)) is not None:
                self._transmit(i, *due)

    def _transmit(self, i: int, datagram: bytes, address: Address) -> None:
        with contextlib.suppress(OSError):
            self._sockets[i].sendto(datagram, address)

    def close(self) -> None:
        """Close the ports; the simulation stays open."""
        for sock in self._sockets:
            sock.close()
        self._selector.close()
