"""The Bullet side of an engine: clients, their bodies, and the calls that move them.

Bullet processes all bodies of a client several times in each step. Large batches of worlds are
therefore split into groups with a client each, whose bodies stay in the cache of a core while the
group flies a decision.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np

from bulletuav.engine.body_table import AddedPiece, BodyTable, Contents
from bulletuav.engine.c_extension import POSTFIX, CExtension, Extension
from bulletuav.engine.calls import EngineCalls, bullet
from bulletuav.engine.client import configure, open_client
from bulletuav.engine.rendering import SceneRenderer
from bulletuav.engine.silence import silenced

GROUP_DRONES = 160
"""Minimum number of drones in a group, about: fewer fit better into the second cache of a core, of
about 1 MB, but each client takes 28 MB of memory, as much as 250 drones, and 30 ms to open"""
MAX_GROUPS = 16
"""Maximum number of groups, for a bound of this memory"""


class InBullet(NamedTuple):
    """A group of worlds in Bullet: a client with its bodies, calls and renderer.

    Indices of worlds in `bodies` and `renderer` start at the first world of the group.

    Attributes:
        worlds: The worlds of the group.
        client: Id of the client in Bullet.
        bodies: All bodies.
        calls: Functions that read and move the bodies.
        renderer: Renderer of the bodies.
    """

    worlds: slice
    client: int
    bodies: BodyTable
    calls: EngineCalls | CExtension
    renderer: SceneRenderer

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Change the masses of the drones of a world of the group; see `Engine.set_masses`."""
        # Loads, which follow drones, keep theirs
        bodies = self.bodies.drone[world - self.worlds.start, : len(mass)].tolist()
        for body, kilograms, moments in zip(bodies, mass.tolist(), inertia.tolist(), strict=True):
            bullet.changeDynamics(
                body,
                -1,
                mass=kilograms,
                localInertiaDiagonal=moments,
                physicsClientId=self.client,
            )

    def has(self, worlds: Any) -> Any:
        """Check whether worlds (a number or an array) are in the group."""
        return (self.worlds.start <= worlds) & (worlds < self.worlds.stop)

    def add(self, piece: AddedPiece) -> None:
        """Create the copies of a piece of a body that are in the group."""
        inside = self.has(piece.worlds)
        poses = [piece.poses[k] for k in np.flatnonzero(inside).tolist()]
        worlds = piece.worlds[inside] - self.worlds.start
        self.bodies.add(piece._replace(poses=poses, worlds=worlds))

    def without_extension(self) -> "InBullet":
        """Return a copy that calls Bullet only by pybullet, which checks for closed clients."""
        return self._replace(calls=EngineCalls(self.client, self.bodies.drone.ravel()))


def group_worlds(num_worlds: int, num_drones: int) -> list[slice]:
    """Split W worlds of N drones into groups of consecutive worlds.

    Each group but the last has the same number of worlds.
    """
    groups = min(max(num_worlds * num_drones // GROUP_DRONES, 1), MAX_GROUPS)
    size = -(-num_worlds // groups)
    return [slice(k, min(k + size, num_worlds)) for k in range(0, num_worlds, size)]


def make_in_bullet(
    worlds: slice,
    contents: Contents,
    dt: float,
    live: bool,
    at_once: bool,
    clients: list[int],
    extension: Extension,
) -> InBullet:
    """Open a Bullet client and create the bodies of a group; drones do not collide yet.

    Args:
        worlds: The worlds of the group.
        contents: Drones, obstacles and city layouts of all worlds.
        dt: Duration of a substep, s.
        live: Whether to open a window.
        at_once: Whether to create obstacles and cities now, see `BodyTable`.
        clients: Ids of open clients; the new id is appended.
        extension: The C extension, if it is available.

    Raises:
        RuntimeError: If there is no screen for a window.
        ValueError: If Bullet cannot load the URDF of an airframe.
    """
    contents = contents._replace(
        layout=contents.layout[worlds],
        offset=contents.offset[worlds],
        parking=contents.parking[worlds],
    )
    client = open_client(live)
    clients.append(client)
    configure(client, dt, live)
    bodies = BodyTable(client, contents, at_once)
    drone = bodies.drone.ravel()
    # With a live window, Bullet runs in its own thread, where the extension cannot reach it.
    calls = EngineCalls(client, drone) if live else _make_calls(client, drone, extension)
    calls.filter(drone, 0, 0)
    return InBullet(worlds, client, bodies, calls, SceneRenderer(client, bodies, contents.offset))


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
