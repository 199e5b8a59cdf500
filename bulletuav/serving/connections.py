"""One policy for the connections of all servers: limits and eviction.

A connection is pending until its first valid request, then it belongs to a client. Both have
places of their own, so that peers which send nothing cannot take a client's place:

- A new connection evicts the pending one that has been idle longest if all pending places are
  taken. A pending connection without a valid request is closed after `handshake` seconds.
- A first valid request needs a client's place. If all are taken, the client that has been idle
  longest is evicted, if that is longer than `grace` seconds. Clients that wait for an answer are
  evicted after all others, and have `max_wait` seconds instead. If no client may be evicted, the
  new one is refused.

`Connections` keeps the books and has no sockets; `streams.py` applies it to asyncio's. What is
refused, dropped or evicted is logged by `refusals.py`.
"""

import errno
import math
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Clock = Callable[[], float]


EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
"""Errors of a system that has no room for one more connection"""
ACCEPT_RETRY = 1.0
"""Time for which a server then accepts none, s: or it would try again and again"""


SPARED = "evicted: it sent nothing, and there was no room for one more connection"
"""Event of a pending connection that was closed for that"""


def cannot_accept(error: OSError) -> str:
    """Describe why no more connections are accepted for now, with the remedy."""
    return (
        f"no connection can be accepted ({error.strerror}): it tries again in {ACCEPT_RETRY:g} s; "
        f"close other connections, or raise the limit of open files (ulimit -n)"
    )


class FullError(ConnectionError):
    """All places are taken by connections that are in use."""


@dataclass(frozen=True)
class Limits:
    """Limits of a server's connections.

    Attributes:
        max_clients: Clients at the same time.
        max_pending: Connections without a valid request at the same time.
        handshake: Time until the first valid request, s.
        grace: Time after its last request in which a client is not evicted for another, s.
        max_wait: The same for a client that waits for an answer, s.
        pending_grace: The same for pending connections, s.
        max_idle: Time after its last request after which a client is dropped, s.
        max_unread: Bytes that a client may leave unread.
        max_stall: Time in which a client with unread bytes has to read some, s.
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
    """What is known of a connection.

    Attributes:
        active: Time of its last valid request, or of its start, s.
        is_client: Whether it has sent a valid request.
        busy: Requests that it waits for.
    """

    active: float
    is_client: bool = False
    busy: int = 0


class Connections(Generic[Key]):
    """Pending connections and clients of a server.

    Attributes:
        limits: Their limits.
    """

    def __init__(self, limits: Limits, clock: Clock = time.monotonic) -> None:
        """Start without connections.

        Args:
            limits: Their limits.
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
            A pending connection that is evicted for it: the server closes it.

        Raises:
            FullError: All pending places are taken, and none of them may be evicted yet.
        """
        limits = self.limits
        evicted = self._make_room(False, limits.max_pending, limits.pending_grace)
        self._entries[key] = _Entry(self._clock())
        return evicted

    def request(self, key: Key) -> Key | None:
        """Record a valid request; a pending connection becomes a client's.

        Args:
            key: The connection; one that is new needs no pending place.

        Returns:
            A client that is evicted for it: the server closes its connection.

        Raises:
            FullError: All clients' places are taken, and none of them may be evicted yet.
        """
        evicted = None
        if not self.is_client(key):
            evicted = self._make_room(True, self.limits.max_clients, self.limits.grace)
            self._entries[key] = _Entry(0.0, is_client=True)
        self._entries[key].active = self._clock()
        return evicted

    def touch(self, key: Key) -> None:
        """Record that a connection is in use, without a request: it reads what it is sent."""
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
        """Return connections that have been idle for too long: the server closes them."""
        now, limits = self._clock(), self.limits
        return [
            key
            for key, entry in self._entries.items()
            if now - entry.active > self._patience(entry, limits.max_idle, limits.handshake)
        ]

    def _patience(self, entry: _Entry, client: float, pending: float) -> float:
        """Return the time that a client or a pending connection has; one that waits has more, s."""
        patience = client if entry.is_client else pending
        return max(patience, self.limits.max_wait) if entry.busy else patience

    def spare(self) -> list[Key]:
        """Remove and return pending connections to close where the system has no room for more.

        Those are the ones that have been idle for `ACCEPT_RETRY`.
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
        """Remove a connection, if it is there."""
        self._entries.pop(key, None)

    def _make_room(self, is_client: bool, most: int, grace: float) -> Key | None:
        """Remove and return the connection of a kind that has been idle longest, if needed.

        Raises:
            FullError: None has been idle for longer than the grace time.
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
