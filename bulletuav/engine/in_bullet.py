"""The Bullet side of an engine: a client, its bodies, and the calls that move them."""

import warnings
from typing import NamedTuple

import numpy as np

from bulletuav.engine.body_table import BodyTable, Contents
from bulletuav.engine.c_extension import POSTFIX, CExtension, Extension
from bulletuav.engine.calls import EngineCalls, bullet
from bulletuav.engine.client import configure, open_client
from bulletuav.engine.rendering import SceneRenderer
from bulletuav.engine.silence import silenced


class InBullet(NamedTuple):
    """A Bullet client with its bodies, calls and renderer.

    Attributes:
        client: Id of the client in Bullet.
        bodies: All bodies.
        calls: Functions that read and move the bodies.
        renderer: Renderer of the bodies.
    """

    client: int
    bodies: BodyTable
    calls: EngineCalls | CExtension
    renderer: SceneRenderer

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Change the masses of the drones of one world; see `Engine.set_masses`."""
        # Loads, which follow drones, keep theirs
        bodies = self.bodies.drone[world, : len(mass)].tolist()
        for body, kilograms, moments in zip(bodies, mass.tolist(), inertia.tolist(), strict=True):
            bullet.changeDynamics(
                body,
                -1,
                mass=kilograms,
                localInertiaDiagonal=moments,
                physicsClientId=self.client,
            )

    def without_extension(self) -> "InBullet":
        """Return a copy that calls Bullet only by pybullet, which checks for closed clients."""
        return self._replace(calls=EngineCalls(self.client, self.bodies.drone.ravel()))


def make_in_bullet(
    contents: Contents,
    dt: float,
    live: bool,
    at_once: bool,
    clients: list[int],
    extension: Extension,
) -> InBullet:
    """Open a Bullet client and create the bodies of an engine; drones do not collide yet.

    Args:
        contents: Drones, obstacles and city layouts of the worlds.
        dt: Duration of a substep, s.
        live: Whether to open a window.
        at_once: Whether to create obstacles and cities now, see `BodyTable`.
        clients: Ids of open clients; the new id is appended.
        extension: The C extension, if it is available.

    Raises:
        RuntimeError: If there is no screen for a window.
        ValueError: If Bullet cannot load the URDF of an airframe.
    """
    client = open_client(live)
    clients.append(client)
    configure(client, dt, live)
    bodies = BodyTable(client, contents, at_once)
    drone = bodies.drone.ravel()
    # With a live window, Bullet runs in its own thread, where the extension cannot reach it.
    calls = EngineCalls(client, drone) if live else _make_calls(client, drone, extension)
    calls.filter(drone, 0, 0)
    return InBullet(client, bodies, calls, SceneRenderer(client, bodies, contents.offset))


def _make_calls(client: int, drone: np.ndarray, extension: Extension) -> EngineCalls | CExtension:
    """Return the calls of the C extension if it works, else those of pybullet."""
    if extension.library is None:
        return EngineCalls(client, drone)
    with silenced():
        plugin = bullet.loadPlugin(extension.path, POSTFIX, physicsClientId=client)
    try:
        if plugin < 0:
            raise RuntimeError("the engine could not load the plugin")
        return CExtension(extension.library, drone)
    except RuntimeError as error:
        warnings.warn(
            f"{error}: bulletuav flies without its extension, slower; see `bulletuav doctor`",
            stacklevel=3,
        )
        return EngineCalls(client, drone)
