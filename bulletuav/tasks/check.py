"""Validation of the values that a task returns: step results, infos, rewards, arenas, bodies."""

import dataclasses
from collections.abc import Collection, Mapping
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
        "decides",
    }
)
"""Infos of every task ("goal_distance" if the task has goals, "decides" with `decision_every`)"""
STANDARD_PREFIXES = ("reward/", "random/")
"""Prefixes of infos that hold reward terms and randomized parameters"""
LARGE = 100.0
"""Length from which an option is named in the error for an arena that is too large, m"""


def check_step_result(task: Task[Any], result: Any, shape: tuple[int, int]) -> None:
    """Check types, term names and shapes (W, N) of a step result.

    Raises:
        ValueError: If the step result is invalid; the message names task, term and remedy.
    """
    gave = f"evaluate_step of task {task.name!r} gave"
    if not isinstance(result, StepResult):
        raise ValueError(f"{gave} {shown(result)}: a StepResult is needed")
    if not isinstance(result.terms, Mapping):
        raise ValueError(
            f"{gave} the terms {shown(result.terms)}: a dict of arrays by name is needed"
        )
    # Every term needs a weight, and every nonzero weight a term
    for name in result.terms:
        if name not in task.weights:
            raise unknown(f"reward term in what {gave},", name, task.weights)
    for name, weight in task.weights.items():
        if weight != 0 and name not in result.terms and name in task.reward:
            raise ValueError(
                f"{gave} no reward term {name!r}: its weight is {weight:g}; give it, or the "
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
                f"{gave} {form} as {name}: an array {shape} (worlds, drones) of {kind} is needed"
            )


def check_info(task: Task[Any], info: Any, shape: tuple[int, int]) -> None:
    """Check types, names and shapes (W, N) of a task's infos.

    Raises:
        ValueError: If an info is invalid; the message names task, info and remedy.
    """
    gave = f"info of task {task.name!r} gave"
    if not isinstance(info, Mapping):
        raise ValueError(f"{gave} {shown(info)}: a dict of arrays by name is needed")
    for name, value in info.items():
        if not isinstance(name, str):
            raise ValueError(f"{gave} the name {shown(name)}: a text is needed")
        if name in STANDARD_INFOS or name.startswith(STANDARD_PREFIXES):
            raise ValueError(f"{gave} {name!r}, which is a standard info: choose another name")
        if not isinstance(value, np.ndarray) or value.shape != shape:
            form = f"an array {value.shape}" if isinstance(value, np.ndarray) else shown(value)
            raise ValueError(
                f"{gave} {form} as {name!r}: an array {shape} (worlds, drones) is needed; "
                f"np.broadcast_to makes one of a number"
            )


def require_new_infos(
    task: Task[Any], info: Mapping[str, np.ndarray], compiled: Collection[str]
) -> None:
    """Check that no info of a task has the name of one that compiled calls of its parts write.

    Raises:
        ValueError: If there is one.
    """
    both = info.keys() & compiled
    if both:
        raise ValueError(
            f"info of task {task.name!r} gave {min(both)!r}, as a part of it does: "
            f"choose another name"
        )


def require_finite(task: Task[Any], terms: Mapping[str, np.ndarray], reward: np.ndarray) -> None:
    """Check that rewards (W, N) are finite.

    Raises:
        ValueError: If a reward is not finite; the message names the term.
    """
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
    """Check that a task's arena is valid and fits on the tile of its world.

    Raises:
        ValueError: If the arena is invalid or reaches into other worlds.
    """
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
    # Worlds are side by side on tiles, with parked bodies above them
    half_side = float(np.abs(arena[:, :2]).max())
    if 2 * (half_side + radius) >= TILE_PITCH or arena[1, 2] >= PARKING_HEIGHT:
        sizes = {
            field.name: getattr(config, field.name)
            for field in dataclasses.fields(config)
            if field.type is float
        }
        large = [f"{name} {size:g}" for name, size in sizes.items() if size >= LARGE]
        raise ValueError(
            f"the arena reaches {half_side:g} m aside and {arena[1, 2]:g} m up: less than "
            f"{TILE_PITCH / 2:g} and "
            f"{PARKING_HEIGHT:g} m are needed, where other worlds begin; lower "
            f"{' or '.join(large) or 'num_drones'}"
        )


def check_bodies(task: Task[Any]) -> None:
    """Check the types of a task's obstacles, layouts and memory shapes.

    Raises:
        ValueError: If one of them is invalid.
    """
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
