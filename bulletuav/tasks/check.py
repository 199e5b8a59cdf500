"""Checks of what a task gives: starts, results of steps, infos, rewards, arenas."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.engine.engine import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_int, as_sequence, finite, numbers_of, shown, unknown
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.closest_approach import least_separation
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import quat4, vec3
from bulletuav.geometry.shapes import CYLINDER, HULL, SPHERE, Shape
from bulletuav.geometry.solids import Solids
from bulletuav.kernel import kernel
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import NOTHING, UPRIGHT, Spawn, StepResult
from bulletuav.tasks.starts import refuse_overlap
from bulletuav.vehicle.airframe import Airframe

UNIT = 1e-6
"""How far the norm of a start's quaternion may be off 1"""
GRAZE = 1e-6
"""m, how deep a drone that stands on the ground may be in it"""
STANDARD_INFOS = frozenset(
    {
        "success",
        "collision",
        "resting",
        "impulse",
        "conflicts",
        "separation",
        "goal_distance",
        "power",
        "charge",
    }
)
"""Infos of every task; "goal_distance" of those with goals"""
STANDARD_PREFIXES = ("reward/", "random/")
"""Beginnings of the names of reward terms and of randomized parameters"""
LARGE = 100.0
"""m, of an option that may be to blame for an arena that is too large"""


def take_spawns(
    task: Task[Any],
    spawns: Sequence[Any],
    airframes: Sequence[Airframe],
    obstacles: int,
    remembered: Mapping[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Take the starts of S worlds together, and refuse those that no world can have.

    Args:
        task: Whose `spawn` gave them.
        spawns: What it gave.
        airframes: Of the drones.
        obstacles: How many there are.
        remembered: The arrays of `memory`, of all worlds, by name.

    Returns:
        Arrays (S, ...) by name of the field, "memory NAME" for what the task remembers.

    Raises:
        ValueError: With the task, what is wrong and the remedy.
    """
    drones, things = (len(airframes), 3), (obstacles, 3)
    shapes = dict.fromkeys(("position", "goal", "velocity", "rates", "goal_velocity"), drones)
    shapes |= {"quaternion": (len(airframes), 4), "obstacle": things, "obstacle_velocity": things}
    shapes["obstacle_quaternion"] = (obstacles, 4)
    for spawn in spawns:
        if not isinstance(spawn, Spawn):
            raise ValueError(f"spawn of task {task.name!r} gave {shown(spawn)}: a Spawn is needed")
    layouts = len(task.layouts())
    for spawn in spawns:
        if layouts or spawn.layout != NO_LAYOUT or spawn.memory is not NOTHING:
            _check_memory(task, spawn, remembered, layouts)
    count = len(spawns)
    fields = {name: np.empty((count, *shape)) for name, shape in shapes.items()}
    for name, shape in shapes.items():
        given = [getattr(spawn, name) for spawn in spawns]
        if count and all(one is given[0] for one in given):
            fields[name][:] = _numbers(task, name, given[0], shape)
        else:
            for row, one in zip(fields[name], given, strict=True):
                row[:] = _numbers(task, name, one, shape)
    if not _all_finite(tuple(fields.values())):
        for name, values in fields.items():
            for one in values:
                if not np.isfinite(one).all():
                    raise _refused(task, name, f"is {shown(one)}", "finite numbers are needed")
    if obstacles:
        _check_turns(task, fields["obstacle_quaternion"])
    places = (fields["position"], fields["quaternion"])
    if not _all_clear(*places, task.context.collision_radius):
        for position, quaternion in zip(*places, strict=True):
            _check_places(task, position, quaternion, airframes)
            refuse_overlap(position, task.context.collision_radius)
    for name, array in remembered.items():
        fields[f"memory {name}"] = kept = np.zeros((count, *array.shape[1:]), dtype=array.dtype)
        for k, spawn in enumerate(spawns):
            if name in spawn.memory:
                kept[k] = spawn.memory[name]
    return {**fields, "layout": np.array([spawn.layout for spawn in spawns], dtype=int)}


def _all_clear(position: np.ndarray, quaternion: np.ndarray, radius: float) -> bool:
    """Tell whether starts (S, N, ...) are so far from all limits that none needs a closer look."""
    bounds = (UNIT, TILE_PITCH / 2 - radius, radius, PARKING_HEIGHT)
    apart = 2 * radius * (1 + UNIT)
    return _each_clear(position, quaternion, *bounds) and least_separation(position) > apart


@kernel
def _each_clear(
    position: np.ndarray,
    quaternion: np.ndarray,
    unit: float,
    half: float,
    lowest: float,
    highest: float,
) -> bool:
    """Tell whether all starts (S, N, ...) are turned by unit quaternions, and within bounds, m."""
    for s in range(position.shape[0]):
        for i in range(position.shape[1]):
            x, y, z, w = quat4(quaternion, s, i)
            if not abs(x * x + y * y + z * z + w * w - 1.0) <= unit:
                return False
            east, north, up = vec3(position, s, i)
            if not (abs(east) < half and abs(north) < half and lowest <= up < highest):
                return False
    return True


@kernel
def _all_finite(fields: tuple[np.ndarray, ...]) -> bool:
    """Tell whether all numbers of arrays (S, N, M) are finite."""
    for field in fields:
        for s in range(field.shape[0]):
            for i in range(field.shape[1]):
                for k in range(field.shape[2]):
                    if not math.isfinite(field[s, i, k]):
                        return False
    return True


def _refused(task: Task[Any], name: str, what: str, remedy: str) -> ValueError:
    return ValueError(f"{name} of the spawn of task {task.name!r} {what}: {remedy}")


ONE_FOR_ALL = {
    "goal": ((3,), (1, 3)),
    "velocity": ((), (3,), (1, 3)),
    "quaternion": ((4,), (1, 4)),
    "obstacle_quaternion": ((4,), (1, 4)),
    "rates": ((), (3,), (1, 3)),
    "goal_velocity": ((), (3,), (1, 3)),
}
"""Shapes of what may be given once for all drones"""


def _numbers(task: Task[Any], name: str, value: Any, shape: tuple[int, int]) -> Any:
    """Return a field of a spawn. Raises ValueError unless it is numbers that fill this shape."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.shape == shape:
        return value
    if value is UPRIGHT or (type(value) is float and () in ONE_FOR_ALL.get(name, ())):
        return value
    array = numbers_of(f"{name} of the spawn of task {task.name!r} is", value)
    if array.shape != shape and array.shape not in ONE_FOR_ALL.get(name, ()):
        raise _refused(task, name, f"has shape {array.shape}", f"{shape} is needed")
    return array


def _check_memory(
    task: Task[Any], spawn: Spawn, remembered: Mapping[str, np.ndarray], layouts: int
) -> None:
    if spawn.layout != NO_LAYOUT or layouts:
        as_int(f"layout of the spawn of task {task.name!r}", spawn.layout, NO_LAYOUT, layouts - 1)
    if not isinstance(spawn.memory, Mapping):
        raise _refused(
            task, "memory", f"is {shown(spawn.memory)}", "a dict of arrays by name is needed"
        )
    for name, value in spawn.memory.items():
        if name not in remembered:
            raise unknown(f"memory in the spawn of task {task.name!r}:", name, remembered)
        if np.shape(value) not in ((), remembered[name].shape[1:]):
            what = f"has shape {np.shape(value)}"
            raise _refused(
                task, f"memory {name!r}", what, f"{remembered[name].shape[1:]} is needed"
            )


def _check_turns(task: Task[Any], quaternion: np.ndarray) -> None:
    """Refuse obstacles (S, K) that are not turned by unit quaternions."""
    off = np.abs(np.einsum("skj,skj->sk", quaternion, quaternion) - 1)
    if off.max(initial=0.0) > 2 * UNIT:
        world, k = np.unravel_index(int(off.argmax()), off.shape)
        what = f"of obstacle {k} has the norm {np.linalg.norm(quaternion[world, k]):g}"
        raise _refused(
            task, "obstacle_quaternion", what, "a unit quaternion is needed: divide by it"
        )


def _check_places(
    task: Task[Any], position: np.ndarray, quaternion: np.ndarray, airframes: Sequence[Airframe]
) -> None:
    """Refuse starts that are not turned by unit quaternions, too far out, or in the ground."""
    off = np.abs(np.einsum("ij,ij->i", quaternion, quaternion) - 1)
    if off.max() > 2 * UNIT:
        i = int(off.argmax())
        what = f"has the norm {np.linalg.norm(quaternion[i]):g}"
        raise _refused(
            task, f"quaternion of drone {i}", what, "a unit quaternion is needed: divide by it"
        )
    radius, height = task.context.collision_radius, position[:, 2]
    half, aside = TILE_PITCH / 2 - radius, np.abs(position[:, :2])
    if aside.max() >= half or height.max() >= PARKING_HEIGHT:
        i = int(((aside >= half).any(axis=1) | (height >= PARKING_HEIGHT)).argmax())
        remedy = f"start it less than {half:g} m aside and {PARKING_HEIGHT:g} m up"
        raise _refused(task, f"position of drone {i}", f"is {position[i]} m", remedy)
    if height.min() >= radius:  # clear, whatever the attitude
        return
    depth = _depth([one.shape for one in airframes], quaternion)
    if (sunk := height < depth - GRAZE).any():
        i = int(sunk.argmax())
        what = f"is {height[i]:g} m up, and its shape reaches {depth[i]:g} m down"
        raise _refused(
            task, f"position of drone {i}", what, f"start it at z = {depth[i]:.6g} m or more"
        )


def _depth(shapes: Sequence[Shape], quaternion: np.ndarray) -> np.ndarray:
    """(N,) how far collision shapes, turned by (N, 4), reach down from their middle, m."""
    kind = np.array([shape.kind for shape in shapes])
    half = np.array([shape.half for shape in shapes])
    x, y, z, w = quaternion.T
    # How far the tips of the body's axes rise.
    rise = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]).T
    slope = np.abs(rise)
    rim = half[:, 0] * np.hypot(slope[:, 0], slope[:, 1]) + half[:, 2] * slope[:, 2]
    depth: np.ndarray = np.select(
        [kind == SPHERE, kind == CYLINDER], [half[:, 0], rim], (half * slope).sum(axis=1)
    )
    for i in np.flatnonzero(kind == HULL).tolist():
        depth[i] = -(np.array(shapes[i].corners) * rise[i]).sum(axis=1).min()
    return depth


def check_step_result(task: Task[Any], result: Any, shape: tuple[int, int]) -> None:
    """Refuse a step result that rewards cannot be made of: types, names of terms and shapes (W, N).

    Raises:
        ValueError: With the task, the term and the remedy.
    """
    judged = f"evaluate_step of task {task.name!r} gave"
    if not isinstance(result, StepResult):
        raise ValueError(f"{judged} {shown(result)}: a StepResult is needed")
    if not isinstance(result.terms, Mapping):
        raise ValueError(
            f"{judged} the terms {shown(result.terms)}: a dict of arrays by name is needed"
        )
    for name in result.terms:
        if name not in task.weights:
            raise unknown(f"reward term in what {judged},", name, task.weights)
    for name, weight in task.weights.items():
        if weight != 0 and name not in result.terms and name in task.reward:
            raise ValueError(
                f"{judged} no reward term {name!r}: its weight is {weight:g}; give it, or the "
                f"weight 0"
            )
    wanted = {f"reward term {name!r}": (term, "iufb") for name, term in result.terms.items()}
    wanted |= {name: (getattr(result, name), "b") for name in ("terminated", "success")}
    for name, (value, kinds) in wanted.items():
        array = value if isinstance(value, np.ndarray) else np.asarray(None)
        if array.shape != shape or array.dtype.kind not in kinds:
            form = (
                f"an array {array.shape} of {array.dtype}"
                if isinstance(value, np.ndarray)
                else shown(value)
            )
            kind = "bool" if kinds == "b" else "numbers"
            raise ValueError(
                f"{judged} {form} as {name}: an array {shape} (worlds, drones) of {kind} is needed"
            )


def check_info(task: Task[Any], info: Any, shape: tuple[int, int]) -> None:
    """Refuse infos of a task that nobody can tell apart by drones: types, names and shapes (W, N).

    Raises:
        ValueError: With the task, the name and the remedy.
    """
    told = f"info of task {task.name!r} gave"
    if not isinstance(info, Mapping):
        raise ValueError(f"{told} {shown(info)}: a dict of arrays by name is needed")
    for name, value in info.items():
        if not isinstance(name, str):
            raise ValueError(f"{told} the name {shown(name)}: a text is needed")
        if name in STANDARD_INFOS or name.startswith(STANDARD_PREFIXES):
            raise ValueError(f"{told} {name!r}, which infos tell already: choose another name")
        if not isinstance(value, np.ndarray) or value.shape != shape:
            form = f"an array {value.shape}" if isinstance(value, np.ndarray) else shown(value)
            raise ValueError(
                f"{told} {form} as {name!r}: an array {shape} (worlds, drones) is needed; "
                f"np.broadcast_to makes one of a number"
            )


def require_finite(task: Task[Any], terms: Mapping[str, np.ndarray], reward: np.ndarray) -> None:
    """Raise ValueError, naming the term, where a reward (W, N) is no finite number."""
    if np.isfinite(reward).all():
        return
    w, i = np.argwhere(~np.isfinite(reward))[0]
    wrong = {name: float(term[w, i]) for name, term in terms.items() if not np.isfinite(term[w, i])}
    raise ValueError(
        f"the reward of drone {i} in world {w} is {reward[w, i]:g}: evaluate_step of task "
        f"{task.name!r} gave "
        f"{wrong or 'terms too large to be added'}, weighted; finite numbers are needed"
    )


def check_arena(task: Task[Any], config: Any, radius: float) -> None:
    """Raise ValueError where an arena is none, or reaches into that of other worlds."""
    arena = numbers_of(
        f"arena_low and arena_high of task {task.name!r} are", [task.arena_low, task.arena_high]
    )
    if arena.shape != (2, 3) or not np.isfinite(arena).all() or not (arena[0] < arena[1]).all():
        raise ValueError(
            f"arena_low and arena_high of task {task.name!r} are {shown(arena)}: lower and upper "
            f"corner are needed"
        )
    finite(f"zone of task {task.name!r}", task.zone)
    if task.rebound is not None:
        finite(f"rebound of task {task.name!r}", task.rebound, 0, 1)
    reach = float(np.abs(arena[:, :2]).max())
    if 2 * (reach + radius) >= TILE_PITCH or arena[1, 2] >= PARKING_HEIGHT:
        sizes = {
            field.name: getattr(config, field.name)
            for field in dataclasses.fields(config)
            if field.type is float
        }
        large = [f"{name} {size:g}" for name, size in sizes.items() if size >= LARGE]
        raise ValueError(
            f"the arena reaches {reach:g} m aside and {arena[1, 2]:g} m up: less than "
            f"{TILE_PITCH / 2:g} and "
            f"{PARKING_HEIGHT:g} m are needed, where other worlds begin; lower "
            f"{' or '.join(large) or 'num_drones'}"
        )


def check_bodies(task: Task[Any]) -> None:
    """Raise ValueError where a task's bodies, cities or memory are none."""
    kinds: dict[str, type] = {"obstacles": Obstacle, "layouts": Solids}
    for name, kind in kinds.items():
        things = getattr(task, name)()
        if not isinstance(things, list | tuple) or not all(isinstance(one, kind) for one in things):
            raise ValueError(
                f"{name} of task {task.name!r} gave {shown(things)}: a list of {kind.__name__} is "
                f"needed"
            )
    memory: Any = task.memory()
    if not isinstance(memory, Mapping):
        raise ValueError(
            f"memory of task {task.name!r} gave {shown(memory)}: a dict of shapes by name is needed"
        )
    for name, shape in memory.items():
        label = f"shape of memory {name!r} of task {task.name!r}"
        for side in as_sequence(label, shape):
            as_int(label, side, 0)
