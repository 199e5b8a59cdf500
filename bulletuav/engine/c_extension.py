"""Calls of `EngineCalls` for all bodies together, through the C extension `_batch.c`.

The extension is optional: it makes flights several times as fast.
"""

import ctypes
import importlib.util
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, kernel
from bulletuav.engine.calls import VISIBLE
from bulletuav.engine.tiles import cover, globalise, localise, vertical_rays, write_surface
from bulletuav.geometry.city_grid import CityGrid
from bulletuav.geometry.raycast import cast_scenery_rays
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wrench import Wrenches

SWITCH = "BULLETUAV_BATCH"
"""Environment variable that disables the extension if it is 0"""
POSTFIX = "_bulletuav"
"""Suffix of the names of the functions that Bullet calls in a plugin"""

_POINTER = ctypes.c_void_p
_INT = ctypes.c_int
_COUNT = ctypes.c_int64
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "batch_find": (ctypes.c_char_p, [ctypes.c_char_p]),
    "batch_open": (_POINTER, [_COUNT, _POINTER]),
    "batch_close": (None, [_POINTER]),
    "batch_read": (None, [_POINTER] * 6),
    "batch_apply": (None, [_POINTER] * 5),
    "batch_step": (None, [_POINTER]),
    "batch_substep": (None, [_POINTER] * 8),
    "batch_write": (None, [_POINTER] * 6),
    "batch_rays": (None, [_POINTER, _COUNT, _POINTER, _POINTER, _INT, _POINTER]),
    "batch_pose": (None, [_POINTER, _COUNT] + [_POINTER] * 3),
    "batch_velocity": (None, [_POINTER, _COUNT] + [_POINTER] * 3),
    "batch_filter": (None, [_POINTER, _COUNT, _POINTER, _INT, _INT]),
}
"""Types of the result and the arguments of each function of the extension"""
_NOT_BUILT = "not built: a C compiler and Python's headers are needed when bulletuav is installed"


class Extension(NamedTuple):
    """The C extension, or the reason why it is not available.

    Attributes:
        library: The loaded library; None if it is not available.
        path: Path of the library; empty if no file was found.
        missing: Reason why the library is not available; empty if it is.
    """

    library: ctypes.PyDLL | None
    path: str
    missing: str


def load_extension(engine: str | None) -> Extension:
    """Load the C extension.

    Args:
        engine: Path of the pybullet module that is already loaded. If None, the extension is never
            called, but compiled code still needs its functions for the types of `EnginePort`.

    Returns:
        The extension, or the reason why it is not available.
    """
    if os.environ.get(SWITCH) == "0":
        return Extension(None, "", f"turned off by {SWITCH}=0")
    spec = importlib.util.find_spec("bulletuav.engine._batch")
    if spec is None or spec.origin is None:
        return Extension(None, "", _NOT_BUILT)
    try:
        # A PyDLL keeps the interpreter lock, as Bullet is not thread-safe.
        library = ctypes.PyDLL(spec.origin)
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype = result
            function.argtypes = arguments
    except (OSError, AttributeError) as error:
        missing = f"built for something else, install bulletuav again: {error}"
        return Extension(None, spec.origin, missing)
    if engine is not None and (lacking := library.batch_find(os.fsencode(engine))):
        missing = f"{Path(engine).name} does not offer {lacking.decode()}"
        return Extension(None, spec.origin, missing)
    return Extension(library, spec.origin, "")


NO_SESSION = 0
"""Session of a port that never calls Bullet"""


class EnginePort(NamedTuple):
    """Arrays and C functions with which compiled code flies a group of worlds without Python.

    Arrays are those of all worlds; functions process those of the group only.

    Attributes:
        session: Address of the extension's session.
        first: First world of the group.
        last: World after the last one of the group.
        substep: The extension's function `batch_substep`.
        write: The extension's function `batch_write`.
        rays: The extension's function `batch_rays`.
        place: (W, N, 3) positions from Bullet, in its frame, m.
        velocity: (W, N, 3) velocities in Bullet, world axes, m/s.
        omega: (W, N, 3) angular velocities in Bullet, world axes, rad/s.
        offset: (W, 1, 3) origins of the tiles, m.
        obstacle_radius: (K,) radii of the obstacles' bounding spheres, m.
        city_grid: Pieces of the city layouts, and the present layout of each world.
        scenery: Collision shapes of bodies and buildings.
        compiled: Whether rays are cast by compiled code instead of Bullet.
    """

    session: int
    first: int
    last: int
    substep: Callable[..., None]
    write: Callable[..., None]
    rays: Callable[..., None]
    place: np.ndarray
    velocity: np.ndarray
    omega: np.ndarray
    offset: np.ndarray
    obstacle_radius: np.ndarray
    city_grid: CityGrid
    scenery: Scenery
    compiled: bool


@allocating
def surface_below(
    port: EnginePort, position: np.ndarray, mask: np.ndarray, surface: np.ndarray
) -> None:
    """Write the height of the surface below drones, as `Engine.surface_below` does.

    Args:
        port: Port of the engine.
        position: (W, N, 3) positions of the drones, m.
        mask: (W, N) bool, drones to find the surface for.
        surface: (W, N) heights z, m; written; -inf outside `mask`.
    """
    covered = cover(position, mask, port.scenery, surface, port.first, port.last)
    if covered == 0:
        return
    _cast_down(port, position, surface, covered)


@deferred(types.none)
@allocating
def _cast_down(port: EnginePort, position: np.ndarray, surface: np.ndarray, covered: int) -> None:
    """Write the height of the surface below the drones for which `cover` wrote NaN."""
    drone, start, end = vertical_rays(position, surface, covered, port.first, port.last)
    if port.compiled:
        fraction = cast_scenery_rays(port.scenery, start, end, drone[:, 0])
    else:
        fraction = np.empty(covered)
        begin = np.empty((covered, 3))
        finish = np.empty((covered, 3))
        for m in range(covered):
            for axis in range(3):
                origin = port.offset[drone[m, 0], 0, axis]
                begin[m, axis] = start[m, axis] + origin
                finish[m, axis] = end[m, axis] + origin
        port.rays(port.session, covered, begin.ctypes, finish.ctypes, VISIBLE, fraction.ctypes)
    write_surface(surface, drone, start, fraction)


@kernel
def substep(port: EnginePort, wrenches: Wrenches, mask: np.ndarray, swarm: Swarm) -> None:
    """Run `Engine.apply_wrenches`, `Engine.step` and `Engine.read_poses` in one call.

    Args:
        port: Port of the engine.
        wrenches: Forces and torques on all drones.
        mask: (W, N) bool, drones that fly.
        swarm: State of all drones; positions and attitudes are written.
    """
    first, last = port.first, port.last
    # C reads and writes the arrays in place
    port.substep(
        port.session,
        mask[first:last].ctypes,
        wrenches.force[first:last].ctypes,
        wrenches.torque[first:last].ctypes,
        port.place[first:last].ctypes,
        swarm.quaternion[first:last].ctypes,
        port.velocity[first:last].ctypes,
        port.omega[first:last].ctypes,
    )
    # Convert to the frame of each world
    localise(port.place, port.offset, mask, swarm, first, last)


@kernel
def write_states(port: EnginePort, swarm: Swarm, mask: np.ndarray) -> None:
    """Set poses and velocities of drones in Bullet, as `Engine.write_states` does.

    Args:
        port: Port of the engine.
        swarm: The states.
        mask: (W, N) bool, drones to set.
    """
    first, last = port.first, port.last
    # Convert to Bullet's frame
    globalise(port.place, port.offset, port.velocity, port.omega, mask, swarm, first, last)
    port.write(
        port.session,
        mask[first:last].ctypes,
        port.place[first:last].ctypes,
        swarm.quaternion[first:last].ctypes,
        port.velocity[first:last].ctypes,
        port.omega[first:last].ctypes,
    )


@kernel
def bring_out(port: EnginePort, swarm: Swarm, mask: np.ndarray, out: np.ndarray) -> None:
    """Set the states of the drones of `mask` (W, N) in Bullet, and mark them as not parked."""
    write_states(port, swarm, mask)
    for w in range(port.first, port.last):
        for i in range(mask.shape[1]):
            out[w, i] = out[w, i] or mask[w, i]


def _at(array: np.ndarray, kind: type = np.float64) -> int:
    """Return the address of a C-contiguous array."""
    assert array.dtype == kind, array.dtype
    assert array.flags.c_contiguous
    return array.ctypes.data


class CExtension:
    """Functions of the C extension for the drones of one client, with the API of `EngineCalls`.

    Attributes:
        session: Address of the extension's session.
        library: The loaded extension.
    """

    def __init__(self, library: ctypes.PyDLL, body: np.ndarray) -> None:
        """Open a session on the client that loaded the plugin last.

        Args:
            library: The loaded extension.
            body: (n,) ids of the drones' bodies in Bullet.

        Raises:
            RuntimeError: If Bullet does not answer as expected.
        """
        self.library = library
        self._body = np.ascontiguousarray(body, dtype=np.int32)
        session: int | None = library.batch_open(len(body), _at(self._body, np.int32))
        if not session:
            raise RuntimeError("the engine answers the plugin differently from its own calls")
        weakref.finalize(self, library.batch_close, session)
        self.session = session

    def read(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """Read poses and velocities of drones into arrays; see `EngineCalls.read`."""
        self.library.batch_read(
            self.session,
            _at(mask, bool),
            *map(_at, (position, quaternion, velocity, omega)),
        )

    def write(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """Set poses and velocities of drones; see `EngineCalls.write`."""
        self.library.batch_write(
            self.session,
            _at(mask, bool),
            *map(_at, (position, quaternion, velocity, omega)),
        )

    def apply(
        self, mask: np.ndarray, position: np.ndarray, force: np.ndarray, torque: np.ndarray
    ) -> None:
        """Apply a force and a torque to each drone; see `EngineCalls.apply`."""
        self.library.batch_apply(
            self.session,
            _at(mask, bool),
            *map(_at, (position, force, torque)),
        )

    def step(self) -> None:
        """Advance the simulation by one substep."""
        self.library.batch_step(self.session)

    def rays(self, start: np.ndarray, end: np.ndarray, groups: int) -> np.ndarray:
        """Cast rays; see `EngineCalls.rays`."""
        fraction = np.empty(len(start))
        self.library.batch_rays(
            self.session,
            len(start),
            _at(start),
            _at(end),
            groups,
            _at(fraction),
        )
        return fraction

    def pose(self, body: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Set poses of bodies, at rest; see `EngineCalls.pose`."""
        self.library.batch_pose(
            self.session,
            len(body),
            _at(body, np.int32),
            _at(position),
            _at(quaternion),
        )

    def velocity(self, body: np.ndarray, velocity: np.ndarray, omega: np.ndarray) -> None:
        """Set velocities of bodies; see `EngineCalls.velocity`."""
        self.library.batch_velocity(
            self.session,
            len(body),
            _at(body, np.int32),
            _at(velocity),
            _at(omega),
        )

    def filter(self, body: np.ndarray, group: int, meets: int) -> None:
        """Set collision filters of bodies; see `EngineCalls.filter`."""
        self.library.batch_filter(self.session, len(body), _at(body, np.int32), group, meets)
