"""Live viewers in other programs, and their addresses.

The viewers are in a package above this one, and are imported only for their `render_mode`.
"""

import importlib
from typing import Any, Protocol

from bulletuav.errors import as_int, shown

MODULE = "bulletuav.report.live"
"""Module of the viewers"""
VIEWERS = {"web": "PageView", "foxglove": "FoxgloveView"}
"""Class of the viewer of each live `render_mode`"""
DEFAULT_ADDRESS = "127.0.0.1:8765"
"""Default address of the server, which only this machine can reach"""


class Viewer(Protocol):
    """Live view of world 0 of an environment."""

    def begin(self) -> None:
        """Update the view after a reset of the world."""

    def show(self) -> None:
        """Show the last decision, and wait for its deadline."""

    def close(self) -> None:
        """Close the view."""


def make_viewer(aviary: Any) -> Viewer:
    """Create the viewer of an aviary, and start its server.

    Raises:
        ImportError: If an extra is not installed.
        OSError: If the port is in use, or there is no such address.
    """
    kind = VIEWERS[aviary.options.render_mode]
    viewer: Viewer = getattr(importlib.import_module(MODULE), kind)(aviary)
    return viewer


def parse_address(address: Any) -> tuple[str, int]:
    """Split an address into host and port.

    Args:
        address: host:port; port 0 selects a free one. The host may contain colons.

    Raises:
        ValueError: If the address is invalid.
    """
    host, colon, port = address.rpartition(":") if isinstance(address, str) else ("", "", "")
    if not (host and colon and port.isdecimal()):
        raise ValueError(
            f"render_address is {shown(address)}: host:port is needed, such as {DEFAULT_ADDRESS!r}"
        )
    return host.strip("[]"), as_int("port of render_address", int(port), 0, 65535)


def join_address(host: str, port: int) -> str:
    """Return host and port as text that `parse_address` accepts."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def require_single(render_mode: str | None, stages: int) -> None:
    """Raise ValueError for a live view of several stages, each of which has its own worlds."""
    if render_mode in VIEWERS and stages > 1:
        raise ValueError(
            f"render_mode is {render_mode!r}, and there are {stages} stages: "
            f"give one, or another render_mode"
        )
