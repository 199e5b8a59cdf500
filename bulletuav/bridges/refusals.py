"""The log of what servers refuse, which clients often do not show."""

import logging
import re

LOG = logging.getLogger("bulletuav.bridges")
MAX_CLIENTS = 64
"""Clients whose refusals are remembered; beyond them the oldest client's are forgotten"""
MAX_KINDS = 32
"""Kinds of refusals that are logged for each client"""
MAX_TEXT = 300
"""Characters of a name, or of a reason, that a line shows"""
NUMBER = re.compile(r"(?<!\w)\d+(?:\.\d+)?(?:e[+-]?\d+)?")


class Refusals:
    """Logs each kind of refusal once for each client.

    Refusals of one kind differ in numbers alone, but for those within names such as Drone1.
    """

    def __init__(self) -> None:
        """Begin with no clients."""
        self._kinds: dict[str, set[str]] = {}

    def log(self, client: str, call: str, reason: str) -> None:
        """Log a refusal, unless one of its kind was logged for this client before.

        Args:
            client: Its address.
            call: Name of the call or message; it may hold any characters.
            reason: Why it was refused, with the remedy; it may hold any characters.
        """
        line = f"{printable(call)} refused: {printable(reason)}"
        kind = NUMBER.sub("#", line)
        kinds = self._kinds.setdefault(client, set())
        if len(self._kinds) > MAX_CLIENTS:
            del self._kinds[next(iter(self._kinds))]
        if kind in kinds or len(kinds) > MAX_KINDS:
            return
        kinds.add(kind)
        if len(kinds) > MAX_KINDS:
            line = f"more than {MAX_KINDS} kinds of refusals: further ones are not logged"
        LOG.warning("client %s: %s", client, line)

    def forget(self, client: str) -> None:
        """Forget a client that has gone."""
        self._kinds.pop(client, None)


def address_text(host: str, port: int) -> str:
    """Write an address as host:port, with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def printable(text: str) -> str:
    """Escape characters that would break a line of the log, and cut long texts."""
    cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "..."
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in cut
    )
