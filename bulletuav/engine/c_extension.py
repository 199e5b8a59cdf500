"""The calls of `Calls` for all bodies at once, through the optional C extension `_batch` (see there)."""

import ctypes
import importlib.util
import os
import weakref
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.engine.calls import VISIBLE
from bulletuav.engine.tiles import columns, land, localise
from bulletuav.geometry.city_grid import CityGrid
from bulletuav.geometry.raycast import walk
from bulletuav.kernel import kernel

SWITCH = "BULLETUAV_BATCH"
"""Environment variable; 0 turns the extension off"""
POSTFIX = "_bulletuav"
_POINTER, _WHOLE, _COUNT = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64
_SIGNATURES = {
    "batch_find": (ctypes.c_char_p, [ctypes.c_char_p]),
    "batch_open": (_POINTER, [_COUNT, _POINTER]),
    "batch_close": (None, [_POINTER]),
    "batch_read": (None, [_POINTER] * 6),
    "batch_apply": (None, [_POINTER] * 5),
    "batch_step": (None, [_POINTER]),
    "batch_contacts": (_COUNT, [_POINTER, _COUNT, _POINTER, _POINTER]),
    "batch_substep": (_COUNT, [_POINTER] * 8),
    "batch_rays": (None, [_POINTER, _COUNT, _POINTER, _POINTER, _WHOLE, _POINTER]),
    "batch_pose": (None, [_POINTER, _COUNT] + [_POINTER] * 3),
    "batch_velocity": (None, [_POINTER, _COUNT] + [_POINTER] * 3),
    "batch_filter": (None, [_POINTER, _COUNT, _POINTER, _WHOLE, _WHOLE]),
}


class Extension(NamedTuple):
    """The extension, or why there is none: `library` is None then."""

    library: Any
    path: str
    missing: str


def load(engine: str) -> Extension:
    """The extension for the pybullet module in the file `engine`."""
    if os.environ.get(SWITCH) == "0":
        return Extension(None, "", f"turned off by {SWITCH}=0")
    spec = importlib.util.find_spec("bulletuav.engine._batch")
    if spec is None or spec.origin is None:
        return Extension(
            None,
            "",
            "not built: a C compiler and Python's headers are needed when bulletuav is installed",
        )
    try:
        library = ctypes.PyDLL(
            spec.origin
        )  # which keeps the interpreter lock: the engine is not made for threads
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        return Extension(
            None, spec.origin, f"built for something else, install bulletuav again: {error}"
        )
    lacking = library.batch_find(os.fsencode(engine))
    if lacking:
        return Extension(
            None, spec.origin, f"{Path(engine).name} does not offer {lacking.decode()}"
        )
    return Extension(library, spec.origin, "")


class Port(NamedTuple):
    """What compiled code needs to run substeps: session and functions of the extension, arrays of the world.

    place, omega  (W, N, 3) positions and angular velocities as the engine gave them
    offset (W, 1, 3) of the tiles; obstacle, obstacle_radius (W, K, 3), (K,) of bounding spheres, m; atlas of the cities
    """

    session: int
    substep: Any
    rays: Any
    place: np.ndarray
    omega: np.ndarray
    offset: np.ndarray
    obstacle: np.ndarray
    obstacle_radius: np.ndarray
    city_grid: CityGrid


@kernel
def surface_below(port, position, mask, surface):
    """`Engine.surface_below`, into `surface`."""
    who, start, end = columns(
        position, mask, port.obstacle, port.obstacle_radius, port.city_grid, surface
    )
    if who.shape[0] == 0:
        return
    fraction, left = walk(port.city_grid, start, end, who[:, 0], port.obstacle_radius.size > 0)
    count = left.shape[0]
    if count > 0:
        first, last, share = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        for k in range(count):
            m = left[k]
            first[k], last[k] = (
                start[m] + port.offset[who[m, 0], 0],
                end[m] + port.offset[who[m, 0], 0],
            )
        port.rays(port.session, count, first.ctypes, last.ctypes, VISIBLE, share.ctypes)
        fraction[left] = share
    land(surface, who, start, fraction)


@kernel
def substep(port, force, torque, mask, swarm):
    """`Engine.apply_wrenches`, `step` and `read_states`; returns how many points touch."""
    touching = port.substep(
        port.session,
        mask.ctypes,
        force.ctypes,
        torque.ctypes,
        port.place.ctypes,
        swarm.quaternion.ctypes,
        swarm.velocity.ctypes,
        port.omega.ctypes,
    )
    localise(port.place, port.offset, port.omega, mask, swarm)
    return touching


def _at(array: np.ndarray, kind: type = np.float64) -> int:
    assert array.dtype == kind, array.dtype
    assert array.flags.c_contiguous
    return array.ctypes.data


class CExtension:
    """One client and the bodies (n,) of its drones."""

    def __init__(self, library: Any, body: np.ndarray):
        """For the client that loaded the plugin last. Raises RuntimeError where the engine does not answer as expected."""
        self._library, self._body = library, np.ascontiguousarray(body, dtype=np.int32)
        self._session = library.batch_open(len(body), _at(self._body, np.int32))
        if not self._session:
            raise RuntimeError("the engine answers the plugin otherwise than its own calls")
        weakref.finalize(self, library.batch_close, self._session)
        self.functions = self._session, library.batch_substep, library.batch_rays

    def read(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """As in `Calls`, here and below; one crossing for all bodies."""
        self._library.batch_read(
            self._session, _at(mask, bool), *map(_at, (position, quaternion, velocity, omega))
        )

    def apply(
        self, mask: np.ndarray, position: np.ndarray, force: np.ndarray, torque: np.ndarray
    ) -> None:
        """As in `Calls`, here and below; one crossing for all bodies."""
        self._library.batch_apply(
            self._session, _at(mask, bool), *map(_at, (position, force, torque))
        )

    def step(self) -> None:
        """The same command."""
        self._library.batch_step(self._session)

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Asked again with more room where there are many."""
        room = 64
        while True:
            bodies, force = np.empty((room, 2), dtype=np.int32), np.empty(room)
            count = self._library.batch_contacts(
                self._session, room, _at(bodies, np.int32), _at(force)
            )
            if count <= room:
                return bodies[:count], force[:count]
            room = count

    def rays(self, start: np.ndarray, end: np.ndarray, groups: int) -> np.ndarray:
        """Straight into an array."""
        fraction = np.empty(len(start))
        self._library.batch_rays(
            self._session, len(start), _at(start), _at(end), groups, _at(fraction)
        )
        return fraction

    def pose(self, body: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """A command each."""
        self._library.batch_pose(
            self._session, len(body), _at(body, np.int32), _at(position), _at(quaternion)
        )

    def velocity(self, body: np.ndarray, velocity: np.ndarray, omega: np.ndarray) -> None:
        """A command each."""
        self._library.batch_velocity(
            self._session, len(body), _at(body, np.int32), _at(velocity), _at(omega)
        )

    def filter(self, body: np.ndarray, group: int, meets: int) -> None:
        """A command each."""
        self._library.batch_filter(self._session, len(body), _at(body, np.int32), group, meets)
