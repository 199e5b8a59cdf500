"""Clients of Bullet: how they are opened, set up and closed."""

import contextlib

from bulletuav.engine.calls import bullet
from bulletuav.engine.screen import require_screen
from bulletuav.engine.silence import silenced


def open_client(live: bool) -> int:
    """Open a client.

    Args:
        live: Whether to open a window.

    Returns:
        Number that Bullet gave the client.

    Raises:
        RuntimeError: There is no screen for a window.
    """
    if live:
        require_screen()
    with silenced():
        client: int = bullet.connect(bullet.GUI if live else bullet.DIRECT)
    return client


def configure(client: int, dt: float, live: bool) -> None:
    """Set a client up so that worlds cannot feel each other.

    Islands of bodies that touch are solved one by one and to the full iteration count, and pairs
    in a fixed order.

    Args:
        client: Number that Bullet gave the client.
        dt: Length of a substep, s.
        live: Whether it has a window.
    """
    bullet.setPhysicsEngineParameter(
        fixedTimeStep=dt,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
        minimumSolverIslandSize=1,
        solverResidualThreshold=0,
        physicsClientId=client,
    )
    # Weight is part of each drone's wrench.
    bullet.setGravity(0, 0, 0, physicsClientId=client)
    if live:
        bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=client)


def disconnect(clients: list[int]) -> None:
    """Close clients and forget them; a live window may already have been closed by its user."""
    while clients:
        with contextlib.suppress(bullet.error):
            bullet.disconnect(clients.pop())
