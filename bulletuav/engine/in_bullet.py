"""What Bullet has of the worlds of an engine: a client, its bodies, and what moves them."""

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
    """A client of Bullet with all that is in it.

    Attributes:
        client: Number that Bullet gave the client.
        bodies: All bodies.
        calls: What reads and moves them.
        renderer: What takes pictures of them.
    """

    client: int
    bodies: BodyTable
    calls: EngineCalls | CExtension
    renderer: SceneRenderer

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Change the masses of the drones of one world; see `Engine.set_masses`."""
        bodies = self.bodies.drone[world].tolist()
        for body, kilograms, moments in zip(bodies, mass.tolist(), inertia.tolist(), strict=True):
            bullet.changeDynamics(
                body,
                -1,
                mass=kilograms,
                localInertiaDiagonal=moments,
                physicsClientId=self.client,
            )

    def without_extension(self) -> "InBullet":
        """Call Bullet through pybullet alone, which answers of closed clients by an error."""
        return self._replace(calls=EngineCalls(self.client, self.bodies.drone.ravel()))


def make_in_bullet(
    contents: Contents,
    dt: float,
    live: bool,
    at_once: bool,
    clients: list[int],
    extension: Extension,
) -> InBullet:
    """Connect to Bullet and make the bodies of an engine. Nothing meets the drones yet.

    Args:
        contents: What is in the worlds.
        dt: Length of a substep, s.
        live: Whether to open a window.
        at_once: Whether obstacles and cities are made now, see `BodyTable`.
        clients: Open clients; the new one is added.
        extension: The C extension, if there is one.

    Raises:
        RuntimeError: There is no screen for a window.
        ValueError: Bullet cannot load the URDF of an airframe.
    """
    client = open_client(live)
    clients.append(client)
    configure(client, dt, live)
    bodies = BodyTable(client, contents, at_once)
    drone = bodies.drone.ravel()
    # Bullet runs in a thread of its own behind a live window.
    calls = EngineCalls(client, drone) if live else _make_calls(client, drone, extension)
    calls.filter(drone, 0, 0)
    return InBullet(client, bodies, calls, SceneRenderer(client, bodies, contents.offset))


def _make_calls(client: int, drone: np.ndarray, extension: Extension) -> EngineCalls | CExtension:
    """Choose the C extension where it works, else the calls through pybullet."""
    if extension.library is None:
        return EngineCalls(client, drone)
    with silenced():
        plugin = bullet.loadPlugin(extension.path, POSTFIX, physicsClientId=client)
    try:
        if plugin < 0:
            raise RuntimeError("the engine refused the plugin")
        return CExtension(extension.library, drone)
    except RuntimeError as error:
        warnings.warn(
            f"{error}: bulletuav flies without its extension, slower; see `bulletuav doctor`",
            stacklevel=3,
        )
        return EngineCalls(client, drone)
