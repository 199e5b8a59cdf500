"""Checks of what a task gives: results of steps, infos, rewards, arenas."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_int, as_sequence, finite, numbers_of, shown, unknown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import StepResult

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


def check_step_result(task: Task[Any], result: Any, shape: tuple[int, int]) -> None:
    """Refuse a step result that rewards cannot be made of: types, names of terms and shapes (W, N).

    Raises:
        ValueError: With the task, the term and the remedy.
    """
    gave = f"evaluate_step of task {task.name!r} gave"
    if not isinstance(result, StepResult):
        raise ValueError(f"{gave} {shown(result)}: a StepResult is needed")
    if not isinstance(result.terms, Mapping):
        raise ValueError(
            f"{gave} the terms {shown(result.terms)}: a dict of arrays by name is needed"
        )
    # Terms and weights must go together: neither may be left over
    for name in result.terms:
        if name not in task.weights:
            raise unknown(f"reward term in what {gave},", name, task.weights)
    for name, weight in task.weights.items():
        if weight != 0 and name not in result.terms and name in task.reward:
            raise ValueError(
                f"{gave} no reward term {name!r}: its weight is {weight:g}; give it, or the "
                f"weight 0"
            )
    # Then the arrays: numbers for terms, truth for ends and successes
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
                f"{gave} {form} as {name}: an array {shape} (worlds, drones) of {kind} is needed"
            )


def check_info(task: Task[Any], info: Any, shape: tuple[int, int]) -> None:
    """Refuse infos of a task that nobody can tell apart by drones: types, names and shapes (W, N).

    Raises:
        ValueError: With the task, the name and the remedy.
    """
    gave = f"info of task {task.name!r} gave"
    if not isinstance(info, Mapping):
        raise ValueError(f"{gave} {shown(info)}: a dict of arrays by name is needed")
    for name, value in info.items():
        if not isinstance(name, str):
            raise ValueError(f"{gave} the name {shown(name)}: a text is needed")
        if name in STANDARD_INFOS or name.startswith(STANDARD_PREFIXES):
            raise ValueError(f"{gave} {name!r}, which infos tell already: choose another name")
        if not isinstance(value, np.ndarray) or value.shape != shape:
            form = f"an array {value.shape}" if isinstance(value, np.ndarray) else shown(value)
            raise ValueError(
                f"{gave} {form} as {name!r}: an array {shape} (worlds, drones) is needed; "
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
    # The arena itself
    arena = numbers_of(
        f"arena_low and arena_high of task {task.name!r} are", [task.arena_low, task.arena_high]
    )
    if arena.shape != (2, 3) or not np.isfinite(arena).all() or not (arena[0] < arena[1]).all():
        raise ValueError(
            f"arena_low and arena_high of task {task.name!r} are {shown(arena)}: lower and upper "
            f"corner are needed"
        )
    # What else the task tells of places
    finite(f"zone of task {task.name!r}", task.zone)
    if task.rebound is not None:
        finite(f"rebound of task {task.name!r}", task.rebound, 0, 1)
    # Worlds stand side by side on tiles, with parked bodies above them
    reach = float(np.abs(arena[:, :2]).max())
    if 2 * (reach + radius) >= TILE_PITCH or arena[1, 2] >= PARKING_HEIGHT:
        # The message names the lengths of the config that may be too large
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
    # Bodies must be ones that engine and compiled code know
    kinds: dict[str, type] = {"obstacles": Obstacle, "layouts": Solids}
    for name, kind in kinds.items():
        things = getattr(task, name)()
        if not isinstance(things, list | tuple) or not all(isinstance(one, kind) for one in things):
            raise ValueError(
                f"{name} of task {task.name!r} gave {shown(things)}: a list of {kind.__name__} is "
                f"needed"
            )
    # Memory is arrays of a fixed shape in each world
    memory: Any = task.memory()
    if not isinstance(memory, Mapping):
        raise ValueError(
            f"memory of task {task.name!r} gave {shown(memory)}: a dict of shapes by name is needed"
        )
    for name, shape in memory.items():
        label = f"shape of memory {name!r} of task {task.name!r}"
        for side in as_sequence(label, shape):
            as_int(label, side, 0)
