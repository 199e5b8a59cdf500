"""Buffer of starts that a task draws: validated, then kept until they are written to worlds."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_int, numbers_of, shown, unknown
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.rotation import dot, quat4, vec3
from bulletuav.geometry.shapes import CYLINDER, HULL, SPHERE, Shape
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import NO_MEMORY, UPRIGHT, Spawn
from bulletuav.tasks.starts import check_overlap
from bulletuav.vehicle.airframe import Airframe

NORM_TOLERANCE = 1e-6
"""Maximum deviation of the norm of a start's quaternion from 1"""
MAX_GROUND_DEPTH = 1e-6
"""Maximum ground penetration of a standing drone, m"""
FLOAT = np.dtype(float)
MEMORY = "memory "
"""Prefix of the task's memory arrays in the names of `SpawnBuffer.rows`"""


class SpawnBuffer:
    """Buffer for the starts of some of W worlds; starts are validated when they are stored.

    Attributes:
        rows: Arrays (W, ...) by field of `Spawn`, and "memory NAME" for the task's memory. Their
            first rows hold the starts stored last.
    """

    def __init__(
        self,
        task: Task[Any],
        airframes: Sequence[Airframe],
        worlds: int,
        obstacles: int,
        memory: Mapping[str, np.ndarray],
    ) -> None:
        """Allocate the buffer.

        Args:
            task: Task whose `spawn` draws the starts.
            airframes: Airframes of the N drones.
            worlds: W.
            obstacles: Number of obstacles per world.
            memory: The task's arrays (W, ...) by name.
        """
        self._task, self._airframes, self._memory = task, airframes, memory
        self._layouts = len(task.layouts())
        drones, things = (len(airframes), 3), (obstacles, 3)
        shapes = dict.fromkeys(("position", "goal", "velocity"), drones)
        shapes |= {"quaternion": (len(airframes), 4), "rates": drones, "goal_velocity": drones}
        shapes |= {"obstacle": things, "obstacle_velocity": things}
        shapes["obstacle_quaternion"] = (obstacles, 4)
        self._fields = {name: np.zeros((worlds, *shape)) for name, shape in shapes.items()}
        assert list(shapes) == list(Spawn._fields[: len(shapes)])
        self._columns = [_FieldColumn(task, *field) for field in self._fields.items()]
        self._layout = np.zeros(worlds, dtype=int)
        self._kept = {name: np.zeros_like(array) for name, array in memory.items()}
        kept = {f"{MEMORY}{name}": array for name, array in self._kept.items()}
        self.rows = {**self._fields, "layout": self._layout, **kept}
        # Flattened to 2-d, so that one compiled specialisation serves all fields
        flat = tuple(array.reshape(worlds, -1) for array in self._fields.values())
        places = (self._fields["position"], self._fields["quaternion"])
        radius = float(task.context.collision_radius)
        self._count, self._is_in_doubt = np.zeros(1, dtype=np.int64), False
        self._check = Program()
        given = (self._count, flat, *places, radius)
        self._check.call(_needs_full_check, *given, otherwise=self._mark_doubtful)

    def store(self, spawns: Sequence[Any]) -> None:
        """Store and validate the starts of S worlds.

        Args:
            spawns: Results of the task's `spawn`.

        Raises:
            ValueError: If a start is invalid; the message names the task and the remedy.
        """
        if not spawns:
            return
        for spawn in spawns:
            if not isinstance(spawn, Spawn):
                raise ValueError(
                    f"spawn of task {self._task.name!r} gave {shown(spawn)}: a Spawn is needed"
                )
        # Copy field by field into arrays, which compiled code then checks together
        if len(spawns) == 1:
            *fields, layout, memory = spawns[0]
            for column, value in zip(self._columns, fields, strict=True):
                column.store_one(value)
            layouts, memories = (layout,), (memory,)
        else:
            *columns, layouts, memories = zip(*spawns, strict=True)
            for column, values in zip(self._columns, columns, strict=True):
                column.store(values)
        self._count[0], self._is_in_doubt = len(spawns), False
        self._check.run()
        # Python checks again only if needed, and raises the error
        if self._is_in_doubt:
            self._check_fully(len(spawns))
        if self._fields["obstacle"].size:
            _check_obstacle_quaternions(
                self._task, self._fields["obstacle_quaternion"][: len(spawns)]
            )
        self._store_memory(spawns, layouts, memories)

    def _mark_doubtful(self) -> None:
        self._is_in_doubt = True

    def _check_fully(self, count: int) -> None:
        """Raise ValueError for a number that is not finite, or an impossible pose."""
        for name, values in self._fields.items():
            for one in values[:count]:
                if not np.isfinite(one).all():
                    what = f"is {shown(one)}"
                    raise _make_error(self._task, name, what, "finite numbers are needed")
        places = (self._fields["position"][:count], self._fields["quaternion"][:count])
        for position, quaternion in zip(*places, strict=True):
            _check_poses(self._task, position, quaternion, self._airframes)
            check_overlap(position, self._task.context.collision_radius)

    def _store_memory(
        self,
        spawns: Sequence[Spawn],
        layouts: tuple[int, ...],
        memories: tuple[Mapping[str, np.ndarray], ...],
    ) -> None:
        """Store the task's initial memory, zero by default, and the layouts."""
        is_default = layouts.count(NO_LAYOUT) == len(layouts) and not self._layouts
        if not is_default or any([memory is not NO_MEMORY for memory in memories]):  # noqa: C419
            for spawn in spawns:
                _check_memory(self._task, spawn, self._memory, self._layouts)
        self._layout[: len(layouts)] = layouts
        for name, array in self._kept.items():
            for k, memory in enumerate(memories):
                array[k] = memory.get(name, 0)


class _FieldColumn:
    """One field of starts, written to the first rows of an array."""

    def __init__(self, task: Task[Any], name: str, array: np.ndarray) -> None:
        self._task, self._name, self._array = task, name, array
        self._first, self._shape = array[0], array.shape[1:]
        # Default of the field, and whether all rows hold it
        self._default, self._holds_default = Spawn._field_defaults.get(name), False

    def store_one(self, value: Any) -> None:
        """Write the value of a single start; see `store`."""
        if value is self._default and self._holds_default:
            return
        self._holds_default = False
        if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == self._shape:
            self._first[:] = value
        else:
            self._first[:] = _numbers(self._task, self._name, value, self._shape)

    def store(self, given: tuple[Any, ...]) -> None:
        """Write values (S,) of starts. Raises ValueError if a value does not fit the shape."""
        count, one = len(given), given[0]
        is_default, was_default, self._holds_default = (
            one is self._default,
            self._holds_default,
            False,
        )
        # A list, as a generator that is not exhausted may swallow interrupts
        if all([value is one for value in given]):  # noqa: C419
            if not (is_default and was_default):  # otherwise the rows already hold it
                rows = self._array if is_default else self._array[:count]
                rows[:] = _numbers(self._task, self._name, one, self._shape)
            self._holds_default = is_default
        elif not self._store_together(given):
            for row, value in zip(self._array, given, strict=False):
                row[:] = _numbers(self._task, self._name, value, self._shape)

    def _store_together(self, given: tuple[Any, ...]) -> bool:
        """Write all values by one call if all are arrays of the shape. Returns True on success."""
        if set(map(type, given)) != {np.ndarray} or {a.shape for a in given} != {self._shape}:
            return False
        rows = self._array[: len(given)].reshape(-1, self._shape[1])
        try:  # raises for other dtypes
            np.concatenate(given, out=rows, casting="no")
        except (TypeError, ValueError):
            return False
        return True


@kernel
def _needs_full_check(
    count: np.ndarray,
    fields: tuple[np.ndarray, ...],
    position: np.ndarray,
    quaternion: np.ndarray,
    radius: float,
) -> bool:
    """Return True if any of the first starts needs the full check in Python.

    Args:
        count: (1,) number of starts.
        fields: Fields of the starts, arrays (W, M).
        position: (W, N, 3) m.
        quaternion: (W, N, 4).
        radius: Collision radius, m.
    """
    for field in fields:
        for s in range(count[0]):
            for k in range(field.shape[1]):
                if not math.isfinite(field[s, k]):
                    return True
    # Comparisons are negated so that they also hold for NaN
    half = TILE_PITCH / 2 - radius
    apart = 2 * radius * (1 + NORM_TOLERANCE)
    for s in range(count[0]):
        for i in range(position.shape[1]):
            x, y, z, w = quat4(quaternion, s, i)
            if not abs(x * x + y * y + z * z + w * w - 1.0) <= NORM_TOLERANCE:
                return True
            # On the world's tile, above the ground, below parked bodies
            east, north, up = vec3(position, s, i)
            if not (abs(east) < half and abs(north) < half and radius <= up < PARKING_HEIGHT):
                return True
            for j in range(i):
                # Bounding spheres must not overlap
                gap = offset(position, s, i, j)
                if not dot(gap, gap) > apart * apart:
                    return True
    return False


def _make_error(task: Task[Any], name: str, what: str, remedy: str) -> ValueError:
    return ValueError(f"{name} of the spawn of task {task.name!r} {what}: {remedy}")


ONE_FOR_ALL = {
    "goal": ((3,), (1, 3)),
    "velocity": ((), (3,), (1, 3)),
    "quaternion": ((4,), (1, 4)),
    "obstacle_quaternion": ((4,), (1, 4)),
    "rates": ((), (3,), (1, 3)),
    "goal_velocity": ((), (3,), (1, 3)),
}
"""Shapes that may be given once for all drones, by field"""


def _numbers(task: Task[Any], name: str, value: Any, shape: tuple[int, int]) -> Any:
    """Return a field of a spawn as an array. Raises ValueError if it does not fit the shape."""
    if type(value) is np.ndarray and value.shape == shape and value.dtype.kind == "f":
        return value
    if value is UPRIGHT or (type(value) is float and () in ONE_FOR_ALL.get(name, ())):
        return value
    array = numbers_of(f"{name} of the spawn of task {task.name!r} is", value)
    if array.shape != shape and array.shape not in ONE_FOR_ALL.get(name, ()):
        raise _make_error(task, name, f"has shape {array.shape}", f"{shape} is needed")
    return array


def _check_memory(
    task: Task[Any], spawn: Spawn, remembered: Mapping[str, np.ndarray], layouts: int
) -> None:
    if spawn.layout != NO_LAYOUT or layouts:
        as_int(f"layout of the spawn of task {task.name!r}", spawn.layout, NO_LAYOUT, layouts - 1)
    if not isinstance(spawn.memory, Mapping):
        raise _make_error(
            task, "memory", f"is {shown(spawn.memory)}", "a dict of arrays by name is needed"
        )
    for name, value in spawn.memory.items():
        if name not in remembered:
            raise unknown(f"memory in the spawn of task {task.name!r}:", name, remembered)
        if np.shape(value) not in ((), remembered[name].shape[1:]):
            what = f"has shape {np.shape(value)}"
            raise _make_error(
                task, f"memory {name!r}", what, f"{remembered[name].shape[1:]} is needed"
            )


def _check_obstacle_quaternions(task: Task[Any], quaternion: np.ndarray) -> None:
    """Check that quaternions (S, K, 4) of obstacles have norm 1."""
    off = np.abs(np.einsum("skj,skj->sk", quaternion, quaternion) - 1)
    if off.max(initial=0.0) > 2 * NORM_TOLERANCE:
        world, k = np.unravel_index(int(off.argmax()), off.shape)
        what = f"of obstacle {k} has the norm {np.linalg.norm(quaternion[world, k]):g}"
        raise _make_error(
            task, "obstacle_quaternion", what, "a unit quaternion is needed: divide by it"
        )


def _check_poses(
    task: Task[Any], position: np.ndarray, quaternion: np.ndarray, airframes: Sequence[Airframe]
) -> None:
    """Check that starts have unit quaternions, and are inside the tile and above the ground."""
    # Squared norms deviate from 1 by twice as much as norms
    off = np.abs(np.einsum("ij,ij->i", quaternion, quaternion) - 1)
    if off.max() > 2 * NORM_TOLERANCE:
        i = int(off.argmax())
        what = f"has the norm {np.linalg.norm(quaternion[i]):g}"
        raise _make_error(
            task, f"quaternion of drone {i}", what, "a unit quaternion is needed: divide by it"
        )
    # Other worlds and parked bodies are beyond the tile
    radius, height = task.context.collision_radius, position[:, 2]
    half, aside = TILE_PITCH / 2 - radius, np.abs(position[:, :2])
    if aside.max() >= half or height.max() >= PARKING_HEIGHT:
        i = int(((aside >= half).any(axis=1) | (height >= PARKING_HEIGHT)).argmax())
        remedy = f"start it less than {half:g} m aside and {PARKING_HEIGHT:g} m up"
        raise _make_error(task, f"position of drone {i}", f"is {position[i]} m", remedy)
    if height.min() >= radius:  # clear in any attitude
        return
    # Near the ground the lowest point of the shape depends on the attitude
    depth = _depth([one.shape for one in airframes], quaternion)
    if (sunk := height < depth - MAX_GROUND_DEPTH).any():
        i = int(sunk.argmax())
        what = f"is {height[i]:g} m up, and its shape reaches {depth[i]:g} m down"
        raise _make_error(
            task, f"position of drone {i}", what, f"start it at z = {depth[i]:.6g} m or more"
        )


def _depth(shapes: Sequence[Shape], quaternion: np.ndarray) -> np.ndarray:
    """Return how far collision shapes, rotated by (N, 4), extend below their centres, (N,) m."""
    kind = np.array([shape.kind for shape in shapes])
    half = np.array([shape.half for shape in shapes])
    x, y, z, w = quaternion.T
    # World z components of the body axes
    rise = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]).T
    slope = np.abs(rise)
    rim = half[:, 0] * np.hypot(slope[:, 0], slope[:, 1]) + half[:, 2] * slope[:, 2]
    depth: np.ndarray = np.select(
        [kind == SPHERE, kind == CYLINDER], [half[:, 0], rim], (half * slope).sum(axis=1)
    )
    for i in np.flatnonzero(kind == HULL).tolist():
        depth[i] = -(np.array(shapes[i].corners) * rise[i]).sum(axis=1).min()
    return depth
