"""Policy for the connections of all servers: limits and eviction.

A connection is pending until its first valid request, then it belongs to a client. Pending
connections and clients have separate limits, so that peers which send nothing cannot block clients:

- If the number of pending connections is at its limit, a new connection evicts the pending one that
  has been idle longest. A pending connection without a valid request is closed after `handshake`
  seconds.
- The first valid request needs a client's place. If all are taken, the client that has been idle
  longest is evicted, if it was idle for more than `grace` seconds. Clients that wait for an answer
  are evicted after all others, and only after `max_wait` seconds. If no client may be evicted, the
  new one is rejected.

`Connections` keeps the records and has no sockets; `streams.py` applies it to asyncio.
`refusals.py` logs rejected, dropped and evicted connections.
"""

import errno
import math
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Clock = Callable[[], float]


EXHAUSTED_ERRORS = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
"""Errors of a system without resources for another connection"""
ACCEPT_RETRY = 1.0
"""Time for which a server then accepts no connections, instead of retrying continuously, s"""


EVICTED_FOR_RESOURCES = (
    "evicted: it sent nothing, and the system has no resources for more connections"
)
"""Event of a pending connection that was closed for lack of resources"""


def cannot_accept(error: OSError) -> str:
    """Return a message that no connections are accepted for now, with the remedy."""
    return (
        f"no connection can be accepted ({error.strerror}): retrying in {ACCEPT_RETRY:g} s; "
        f"close other connections, or raise the limit of open files (ulimit -n)"
    )


class FullError(ConnectionError):
    """All places are taken by connections in use."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits of a server's connections.

    Attributes:
        max_clients: Maximum number of clients.
        max_pending: Maximum number of connections without a valid request.
        handshake: Time until the first valid request, s.
        grace: Time after its last request in which a client is not evicted, s.
        max_wait: The same for a client that waits for an answer, s.
        pending_grace: The same for pending connections, s.
        max_idle: Time after its last request after which a client is dropped, s.
        max_unread: Maximum number of bytes that a client may leave unread.
        max_stall: Maximum time for which a client may read none of its unread bytes, s.
        linger: The same for a connection that the server has closed, s.
    """

    max_clients: int = 64
    max_pending: int = 64
    handshake: float = 10.0
    grace: float = 60.0
    max_wait: float = 600.0
    pending_grace: float = 0.0
    max_idle: float = math.inf
    max_unread: int = 2**24
    max_stall: float = 30.0
    linger: float = 2.0


@dataclass
class _Entry:
    """Record of a connection.

    Attributes:
        active: Time of the last valid request, or of the start, s.
        is_client: Whether the connection has sent a valid request.
        busy: Number of requests that wait for an answer.
    """

    active: float
    is_client: bool = False
    busy: int = 0


class Connections(Generic[Key]):
    """Pending connections and clients of a server.

    Attributes:
        limits: Limits of the connections.
    """

    def __init__(self, limits: ConnectionLimits, clock: Clock = time.monotonic) -> None:
        """Start without connections.

        Args:
            limits: Limits of the connections.
            clock: Function that returns the time, s.
        """
        self.limits, self._clock = limits, clock
        self._entries: dict[Key, _Entry] = {}

    def __len__(self) -> int:
        """Return the number of connections, pending ones and clients."""
        return len(self._entries)

    def __contains__(self, key: Key) -> bool:
        return key in self._entries

    def is_client(self, key: Key) -> bool:
        """Return True if a connection has a client's place."""
        return key in self._entries and self._entries[key].is_client

    def all(self) -> list[Key]:
        """Return all connections, oldest first."""
        return list(self._entries)

    def clients(self) -> list[Key]:
        """Return the connections of clients, oldest first."""
        return [key for key, entry in self._entries.items() if entry.is_client]

    def add(self, key: Key) -> Key | None:
        """Add a pending connection.

        Args:
            key: The connection.

        Returns:
            A pending connection that is evicted, which the server has to close; or None.

        Raises:
            FullError: If all pending places are taken, and none of them may be evicted yet.
        """
        limits = self.limits
        evicted = self._evict_idle(False, limits.max_pending, limits.pending_grace)
        self._entries[key] = _Entry(self._clock())
        return evicted

    def request(self, key: Key) -> Key | None:
        """Record a valid request; a pending connection becomes a client's.

        Args:
            key: The connection; a new one needs no pending place.

        Returns:
            A client that is evicted, whose connection the server has to close; or None.

        Raises:
            FullError: If all clients' places are taken, and none of them may be evicted yet.
        """
        evicted = None
        if not self.is_client(key):
            evicted = self._evict_idle(True, self.limits.max_clients, self.limits.grace)
            self._entries[key] = _Entry(0.0, is_client=True)
        self._entries[key].active = self._clock()
        return evicted

    def touch(self, key: Key) -> None:
        """Record that a connection is in use without a request, as it reads data."""
        if key in self._entries:
            self._entries[key].active = self._clock()

    def wait(self, key: Key, count: int = 1) -> None:
        """Record that a client waits for `count` more requests, or for fewer if negative."""
        if key in self._entries:
            self._entries[key].busy += count
            self._entries[key].active = self._clock()

    def idle(self, key: Key) -> float:
        """Return the time since the last request of a connection, s."""
        return self._clock() - self._entries[key].active

    def overdue(self) -> list[Key]:
        """Return connections that have been idle for too long, which the server has to close."""
        now, limits = self._clock(), self.limits
        return [
            key
            for key, entry in self._entries.items()
            if now - entry.active > self._patience(entry, limits.max_idle, limits.handshake)
        ]

    def _patience(self, entry: _Entry, client: float, pending: float) -> float:
        """Return the idle time that a connection may have; more if it waits for an answer, s."""
        patience = client if entry.is_client else pending
        return max(patience, self.limits.max_wait) if entry.busy else patience

    def spare(self) -> list[Key]:
        """Remove and return pending connections to close when the system lacks resources.

        These are the ones that have been idle for `ACCEPT_RETRY`.
        """
        spared = [
            key
            for key, entry in self._entries.items()
            if not entry.is_client and self.idle(key) >= ACCEPT_RETRY
        ]
        for key in spared:
            self.remove(key)
        return spared

    def remove(self, key: Key) -> None:
        """Remove a connection, if it exists."""
        self._entries.pop(key, None)

    def _evict_idle(self, is_client: bool, most: int, grace: float) -> Key | None:
        """Remove and return the longest idle connection of a kind, if the limit is reached.

        Raises:
            FullError: If none has been idle for longer than the grace time.
        """
        kept = [key for key, entry in self._entries.items() if entry.is_client == is_client]
        if len(kept) < most:
            return None
        free = [
            key
            for key in kept
            if self.idle(key) >= self._patience(self._entries[key], grace, grace)
        ]
        if not free:
            raise FullError(f"{len(kept)} others are connected, which is the limit")
        evicted = min(free, key=lambda key: (self._entries[key].busy > 0, -self.idle(key)))
        self.remove(evicted)
        return evicted
