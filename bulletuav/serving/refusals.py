"""The log of what servers refuse, which clients often do not show: calls, and connections."""

import logging
import math
import re
import time
from collections import Counter
from collections.abc import Callable

MAX_CLIENTS = 1024
"""Clients whose refusals are remembered; beyond them those heard longest ago are forgotten"""
MAX_KINDS = 32
"""Kinds of refusals that are logged for each client"""
MAX_TEXT = 300
"""Characters of a name, or of a reason, that a line shows"""
MAX_LINES = 100
"""Lines in `PERIOD` of calls, and as many of connections: floods do not fill the disk"""
PERIOD = 60.0
NUMBER = re.compile(r"(?<!\w)\d+(?:\.\d+)?(?:e[+-]?\d+)?")


class Refusals:
    """Logs each kind of refusal once for each client, and not many in a short time.

    Refused calls of one kind differ in numbers alone, but for those within names such as Drone1.
    Connections have lines of their own: addresses can be made up, and a flood from many of them
    hides no refused call of a client that is connected.
    """

    def __init__(self, logger: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with no clients.

        Args:
            logger: Where refusals are logged, at level WARNING.
            clock: Function that returns the time, s.
        """
        self._logger, self._clock = logger, clock
        # Hashes, as texts of clients could be long
        self._kinds: dict[str, set[int]] = {}
        self._start, self._lines = -math.inf, Counter[str]()

    def log(self, client: str, call: str, reason: str) -> bool:
        """Log that a call was refused, unless one of its kind was logged for this client before.

        Args:
            client: Its address.
            call: Name of the call or message; it may hold any characters.
            reason: Why it was refused, with the remedy; it may hold any characters.

        Returns:
            Whether it was logged.
        """
        line = f"{printable(call)} refused: {printable(reason)}"
        return self._log(client, "calls", NUMBER.sub("#", line), line)

    def log_connection(self, client: str, event: str) -> bool:
        """Log that a client's connection was refused or ended, unless the same was logged before.

        Args:
            client: Its address.
            event: What happened, and why, such as "dropped: it sent no request in time".

        Returns:
            Whether it was logged.
        """
        line = f"connection {printable(event)}"
        return self._log(client, "connections", line, line)

    def log_server(self, event: str) -> None:
        """Log what keeps the server from accepting clients, at most once in a period.

        Args:
            event: What happened, with the remedy.
        """
        if self._has_room("server", 1):
            self._lines["server"] += 1
            self._logger.warning("server: %s", printable(event))

    def forget(self, client: str) -> None:
        """Forget a client that has gone."""
        self._kinds.pop(client, None)

    def _log(self, client: str, topic: str, kind: str, line: str) -> bool:
        """Log a line of a kind, unless it was logged before; return whether it was logged."""
        kinds, number = self._kinds.pop(client, set()), hash(kind)
        # The client that was heard last is the last one
        if kinds:
            self._kinds[client] = kinds
        if number in kinds or len(kinds) > MAX_KINDS or not self._has_room(topic):
            return False
        kinds.add(number)
        if len(kinds) > MAX_KINDS:
            line = f"more than {MAX_KINDS} kinds of refusals: further ones are not logged"
        self._kinds[client] = kinds
        if len(self._kinds) > MAX_CLIENTS:
            del self._kinds[next(iter(self._kinds))]
        self._lines[topic] += 1
        if self._lines[topic] == MAX_LINES:
            line += f"; more refused {topic} are not logged for {PERIOD:.0f} s"
        self._logger.warning("client %s: %s", client, line)
        return True

    def _has_room(self, topic: str, most: int = MAX_LINES) -> bool:
        """Return True if one more line may be logged in this period."""
        # In a new period lines are counted from zero
        if self._clock() - self._start > PERIOD:
            self._start = self._clock()
            self._lines.clear()
        return self._lines[topic] < most


class LineLimit(logging.Filter):
    """Limits the lines that a library logs about what clients send, as `Refusals` limits ours."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without lines.

        Args:
            clock: Function that returns the time, s.
        """
        super().__init__()
        self._clock, self._start, self._count = clock, -math.inf, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Escape a record's characters; return False for one too many in this period."""
        if self._clock() - self._start > PERIOD:
            self._start, self._count = self._clock(), 0
        self._count += 1
        record.msg, record.args = printable(record.getMessage()), ()
        if self._count == MAX_LINES:
            record.msg += f"; more lines are not logged for {PERIOD:.0f} s"
        return self._count <= MAX_LINES


def printable(text: str) -> str:
    """Escape characters that would break a line of the log, and cut long texts."""
    cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "..."
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in cut
    )
