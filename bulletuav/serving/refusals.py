"""Log of rejected calls and connections, which clients often do not show."""

import logging
import math
import re
import time
from collections import Counter
from collections.abc import Callable

MAX_CLIENTS = 1024
"""Maximum number of clients whose log entries are remembered, by last activity"""
MAX_KINDS = 32
"""Maximum number of different entries for each client"""
MAX_TEXT = 300
"""Maximum length of a name, or of a reason, in a line"""
MAX_LINES = 100
"""Maximum number of lines per `PERIOD`, for calls and for connections, so that logs stay small"""
PERIOD = 60.0
NUMBER = re.compile(r"(?<!\w)\d+(?:\.\d+)?(?:e[+-]?\d+)?")


class Refusals:
    """Logs each kind of rejection once for each client, with a limited rate.

    Rejected calls of one kind differ in numbers only, except for numbers within names such as
    Drone1. Connections have a separate rate limit: addresses can be forged, and a flood of them
    must not hide rejected calls of a connected client.
    """

    def __init__(self, logger: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without clients.

        Args:
            logger: Logger of the entries, at level WARNING.
            clock: Function that returns the time, s.
        """
        self._logger, self._clock = logger, clock
        # Hashes, as texts of clients may be long
        self._kinds: dict[str, set[int]] = {}
        self._start, self._lines = -math.inf, Counter[str]()

    def log(self, client: str, call: str, reason: str) -> bool:
        """Log a rejected call, unless a call of its kind was logged for this client before.

        Args:
            client: Address of the client.
            call: Name of the call or message; it may contain any characters.
            reason: Reason, with the remedy; it may contain any characters.

        Returns:
            Whether it was logged.
        """
        line = f"{escape_line(call)} refused: {escape_line(reason)}"
        return self._log(client, "calls", NUMBER.sub("#", line), line)

    def log_connection(self, client: str, event: str) -> bool:
        """Log a rejected or ended connection, unless the same was logged for this client before.

        Args:
            client: Address of the client.
            event: Event and reason, such as "dropped: it sent no request in time".

        Returns:
            Whether it was logged.
        """
        line = f"connection {escape_line(event)}"
        return self._log(client, "connections", line, line)

    def log_server(self, event: str) -> None:
        """Log an event that keeps the server from accepting clients, at most once in a period.

        Args:
            event: The event, with the remedy.
        """
        if self._may_log("server", 1):
            self._lines["server"] += 1
            self._logger.warning("server: %s", escape_line(event))

    def forget(self, client: str) -> None:
        """Remove a client that has disconnected."""
        self._kinds.pop(client, None)

    def _log(self, client: str, topic: str, kind: str, line: str) -> bool:
        """Log a line unless its kind was logged before; return whether it was logged."""
        kinds, number = self._kinds.pop(client, set()), hash(kind)
        # The dict is ordered by the last activity of clients
        if kinds:
            self._kinds[client] = kinds
        if number in kinds or len(kinds) > MAX_KINDS or not self._may_log(topic):
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

    def _may_log(self, topic: str, most: int = MAX_LINES) -> bool:
        """Return True if another line may be logged in this period."""
        if self._clock() - self._start > PERIOD:
            self._start = self._clock()
            self._lines.clear()
        return self._lines[topic] < most


class LineLimit(logging.Filter):
    """Limits the lines that a library logs about client data, as `Refusals` does for ours."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without lines.

        Args:
            clock: Function that returns the time, s.
        """
        super().__init__()
        self._clock, self._start, self._count = clock, -math.inf, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Escape the characters of a record; return False if the rate limit is exceeded."""
        if self._clock() - self._start > PERIOD:
            self._start, self._count = self._clock(), 0
        self._count += 1
        record.msg, record.args = escape_line(record.getMessage()), ()
        if self._count == MAX_LINES:
            record.msg += f"; more lines are not logged for {PERIOD:.0f} s"
        return self._count <= MAX_LINES


def escape_line(text: str) -> str:
    """Escape characters that would break a line of the log, and truncate long texts."""
    cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "..."
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in cut
    )
