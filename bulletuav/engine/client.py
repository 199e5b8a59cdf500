"""Functions that open, configure and close Bullet clients."""

import contextlib

from bulletuav.engine.calls import bullet
from bulletuav.engine.screen import require_screen
from bulletuav.engine.silence import silenced


def open_client(live: bool) -> int:
    """Open a Bullet client.

    Args:
        live: Whether to open a window.

    Returns:
        Id of the client in Bullet.

    Raises:
        RuntimeError: If there is no screen for a window.
    """
    if live:
        require_screen()
    with silenced():
        client: int = bullet.connect(bullet.GUI if live else bullet.DIRECT)
    return client


def configure(client: int, dt: float, live: bool) -> None:
    """Configure a client so that worlds do not influence each other.

    Islands of touching bodies are solved one by one with the full number of iterations, and pairs
    in a fixed order.

    Args:
        client: Id of the client in Bullet.
        dt: Duration of a substep, s.
        live: Whether the client has a window.
    """
    bullet.setPhysicsEngineParameter(
        fixedTimeStep=dt,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
        minimumSolverIslandSize=1,
        solverResidualThreshold=0,
        physicsClientId=client,
    )
    # Each drone's wrench includes its weight.
    bullet.setGravity(0, 0, 0, physicsClientId=client)
    if live:
        bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=client)


def disconnect(clients: list[int]) -> None:
    """Close clients and clear the list; users may already have closed a live window."""
    while clients:
        with contextlib.suppress(bullet.error):
            bullet.disconnect(clients.pop())
