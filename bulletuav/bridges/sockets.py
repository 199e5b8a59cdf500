"""Sockets of servers that fly in real time, and answer meanwhile."""

import contextlib
import math
import selectors
import socket
import time
from abc import ABC, abstractmethod

from bulletuav.envs.pacer import Pacer
from bulletuav.errors import as_int

Address = tuple[str, int]
LOG_NAME = "bulletuav.bridges"
"""Name of the logger of what servers refuse: calls, and connections"""


LATE_SHARE = 0.25
"""Fraction of a step's time in which a server that is late reads: no flood stops the flight"""


def cannot_listen(host: str, port: int, kind: str, error: OSError) -> OSError:
    """Make the error for a port that cannot be had.

    Args:
        host: Address that was asked for.
        port: Port that was asked for.
        kind: "TCP" or "UDP".
        error: What the system says.

    Returns:
        The error, for the caller to raise.
    """
    return OSError(
        f"cannot listen at {host}, port {port} ({kind}): {error.strerror or error}; is another "
        f"server running? Choose another port"
    )


def listening(host: str, port: int) -> socket.socket:
    """Open a TCP socket that listens.

    Raises:
        OSError: The port is in use, or there is no such address.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise cannot_listen(host, port, "TCP", error) from error


class DatagramServer(ABC):
    """UDP sockets, one a drone, around something that flies step by step in real time.

    Derived classes fly (`_step`), and take datagrams (`_read`).

    Attributes:
        pacer: Keeps the time; tells how many steps were late.
        ports: Of each drone.
    """

    def __init__(self, count: int, host: str, port: int, period: float, speed: float) -> None:
        """Open the ports; clients are answered once it runs.

        Args:
            count: How many drones there are.
            host: Address to listen at. Whoever can reach it can fly the drones.
            port: Of the first drone; 0 for free ones.
            period: Duration of a step, s.
            speed: Simulated seconds in one of the clock.

        Raises:
            ValueError: The port or the speed cannot be.
            OSError: A port is in use, or there is no such address.
        """
        as_int("port", port, 0, 65536 - count if port else 0)
        self.pacer = Pacer(period, speed, _sleep=self._answer_for)
        self._selector = selectors.DefaultSelector()
        self._sockets: list[socket.socket] = []
        # Drone whose packets are read first
        self._next = 0
        try:
            for i in range(count):
                self._open(host, port + i if port else 0)
        except OSError:
            self.close()
            raise
        self.ports: list[int] = [one.getsockname()[1] for one in self._sockets]

    def _open(self, host: str, port: int) -> None:
        """Open the socket of the next drone."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        one = socket.socket(family, socket.SOCK_DGRAM)
        self._sockets.append(one)
        one.setblocking(False)
        try:
            one.bind((host, port))
        except OSError as error:
            raise cannot_listen(host, port, "UDP", error) from error
        self._selector.register(one, selectors.EVENT_READ, len(self._sockets) - 1)

    def run(self, seconds: float | None = None) -> None:
        """Fly and answer.

        Args:
            seconds: How long, simulated; until it is interrupted, if left out.

        Raises:
            RuntimeError: The flight diverged.
        """
        steps = math.inf if seconds is None else math.ceil(seconds / self.pacer.period - 1e-6)
        flown = 0
        self.pacer.restart()
        while flown < steps:
            self._step()
            flown += 1
            # A late loop does not sleep: packets are taken all the same.
            if self.pacer.wait():
                self._answer_for(0.0)

    def _answer_for(self, seconds: float) -> None:
        """Answer packets for a time, s, or for a fraction of a step if there is less.

        Drones take turns: those whose packets were not read in time are the first ones next time.
        """
        start = time.perf_counter()
        end = start + seconds
        limit = max(end, start + LATE_SHARE * self.pacer.period / self.pacer.speed)
        while True:
            received = self._received()
            left = 0.0 if received else max(end - time.perf_counter(), 0.0)
            ready = {key.data for key, _ in self._selector.select(left)}.union(received)
            for i in sorted(ready, key=lambda i: (i - self._next) % len(self._sockets)):
                self._read(i)
                self._next = i + 1
                if time.perf_counter() >= limit:
                    return
            if time.perf_counter() >= end:
                return

    def _received(self) -> list[int]:
        """Return the drones that have packets which are received already, but not taken."""
        return []

    @abstractmethod
    def _step(self) -> None:
        """Fly one step, and send what is due."""

    @abstractmethod
    def _read(self, i: int) -> None:
        """Take the packets that have come for a drone, as many as may be in one go."""

    def _send_to(self, i: int, datagram: bytes, address: Address) -> None:
        """Send a datagram; one that cannot be sent is lost, as on the radio."""
        with contextlib.suppress(OSError):
            self._sockets[i].sendto(datagram, address)

    def close(self) -> None:
        """Close the ports; what flies stays."""
        for one in self._sockets:
            one.close()
        self._selector.close()
