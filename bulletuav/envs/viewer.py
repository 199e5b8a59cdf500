"""What shows worlds in other programs while they fly, and where these find it.

Viewers are in a room above this one, which needs them for two kinds of `render_mode` alone.
"""

import importlib
from typing import Any, Protocol

from bulletuav.errors import as_int, shown

MODULE = "bulletuav.report.live"
"""Module of the viewers"""
VIEWERS = {"web": "PageView", "foxglove": "FoxgloveView"}
"""Class of the viewer of each kind of `render_mode`"""
USUAL_ADDRESS = "127.0.0.1:8765"
"""Where it is served: to this machine alone"""


class Viewer(Protocol):
    """What shows world 0 of an environment."""

    def begin(self) -> None:
        """Take in that the world was reset."""

    def show(self) -> None:
        """Show the decision that was flown, and wait until its time has come."""

    def close(self) -> None:
        """End the view."""


def make_viewer(aviary: Any) -> Viewer:
    """Make the viewer of an aviary, and begin to serve it.

    Raises:
        ImportError: It needs an extra that is missing.
        OSError: The port is in use, or there is no such address.
    """
    kind = VIEWERS[aviary.options.render_mode]
    viewer: Viewer = getattr(importlib.import_module(MODULE), kind)(aviary)
    return viewer


def parse_address(address: Any) -> tuple[str, int]:
    """Split an address into host and port.

    Args:
        address: host:port; port 0 takes a free one. Colons of the host are part of it.

    Raises:
        ValueError: It is none.
    """
    host, colon, port = address.rpartition(":") if isinstance(address, str) else ("", "", "")
    if not (host and colon and port.isdecimal()):
        raise ValueError(
            f"render_address is {shown(address)}: host:port is needed, such as {USUAL_ADDRESS!r}"
        )
    return host.strip("[]"), as_int("port of render_address", int(port), 0, 65535)


def join_address(host: str, port: int) -> str:
    """Write host and port as `parse_address` reads them."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def require_single(render_mode: str | None, stages: int) -> None:
    """Raise ValueError for a live view of several stages, each of which has worlds of its own."""
    if render_mode in VIEWERS and stages > 1:
        raise ValueError(
            f"render_mode is {render_mode!r}, and there are {stages} stages: "
            f"give one, or another render_mode"
        )
