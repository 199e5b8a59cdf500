"""Checks for authors of tasks, sensors and dynamics: fly them briefly and look for mistakes."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.step import Step
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.check import check_info, check_step_result

DECISIONS = 30
NUM_WORLDS = 3
SEED = 1


def check_task(task: TaskSource, **options: Any) -> None:
    """Look for mistakes of a task's author, in the manner of Gymnasium's `check_env`.

    Flies random actions in three worlds and looks at shapes, types and numbers of what the task
    gives. Builds every difficulty and preset. Sees whether the same seed gives the same flight,
    whether evaluating a decision changes anything, and whether a reset of one world disturbs
    another.

    Args:
        task: Its name, `module:Name`, or its class.
        **options: Of the environment.

    Raises:
        ValueError: A mistake was found; the message tells what and how to mend it.
    """
    kind = find_task(task)
    for option, choices in (("difficulty", kind.difficulties), ("preset", kind.presets)):
        for name in choices:
            EnvSpec(kind, 1, {**options, option: name})
    rows = [list(_flown(kind, options, resets=True)) for _ in range(2)]
    for k, (one, other) in enumerate(zip(*rows, strict=True)):
        if not _equal(one, other):
            raise ValueError(
                f"task {kind.name!r} flew twice from the same seed, and differs at decision {k}: "
                f"draw "
                f"from the generators that it is given, and keep nothing in the task itself"
            )


def check_sensor(sensor: Any, **options: Any) -> None:
    """Look for mistakes of a sensor's author: shapes, numbers, seeds, and worlds that mix.

    Args:
        sensor: An object, a class, a name, or `module:Name`.
        **options: Of the environment `hover` in which it is tried.

    Raises:
        ValueError: A mistake was found; the message tells what and how to mend it.
    """
    found = find_sensor(sensor)
    usual = {"num_drones": 2, "sensors": (found,), "observation": ("velocity", *found.gives)}
    _check_worlds(f"sensor {found.name!r}", {**usual, **options})


def check_dynamics(dynamics: Any, **options: Any) -> None:
    """Look for mistakes of an author of dynamics: numbers, seeds, and worlds that mix.

    Args:
        dynamics: A class derived from `Dynamics`, a name, or `module:Name`.
        **options: Of the environment `hover` in which it is tried.

    Raises:
        ValueError: A mistake was found; the message tells what and how to mend it.
    """
    usual = {"num_drones": 2, "dynamics": dynamics, "action": "velocity"}
    _check_worlds(f"dynamics {dynamics!r}", {**usual, **options})


def _check_worlds(who: str, options: dict[str, Any]) -> None:
    """Fly `hover` twice in several worlds, and its last world alone: all must agree."""
    both = [list(_flown("hover", options)) for _ in range(2)]
    alone = list(_flown("hover", options, num_worlds=1, first_world=NUM_WORLDS - 1))
    for k, (one, other, single) in enumerate(zip(*both, alone, strict=True)):
        if not _equal(one, other):
            raise ValueError(
                f"{who} differs at decision {k} of two flights from the same seed: draw from the "
                f"generators that it is given, and start anew at a reset"
            )
        if not _equal([array[-1:] for array in one], single):
            raise ValueError(
                f"{who} gives a world something else at decision {k} when it flies alone: worlds "
                f"must not feel each other"
            )


def _flown(
    task: TaskSource,
    options: dict[str, Any],
    *,
    num_worlds: int = NUM_WORLDS,
    first_world: int = 0,
    resets: bool = False,
) -> Iterator[list[np.ndarray]]:
    """Yield observations, rewards and ends of some decisions with random actions."""
    given = {"seed": SEED, **options}
    aviary = Aviary(task, num_worlds, first_world=first_world, **given)
    try:
        yield _arrays(aviary, aviary.reset())
        shape = (NUM_WORLDS, *aviary.action.low.shape)
        rng = np.random.default_rng(SEED)
        for k in range(DECISIONS):
            actions = rng.uniform(np.maximum(aviary.action.low, -1e6), aviary.action.high, shape)
            actions = np.floor(actions) if aviary.action.choices is not None else actions
            mine = actions[first_world : first_world + num_worlds]
            step = aviary.step(mine)
            _check_step(aviary, step)
            yield [*_arrays(aviary, step.observations), step.rewards, step.terminated]
            over = ~np.array(aviary.alive.any(axis=1))
            over[k % num_worlds] |= k % 7 == 3  # in the middle of an episode
            if resets and over.any():
                yield _reset(aviary, over)
    finally:
        aviary.close()


def _check_step(aviary: Aviary, step: Step) -> None:
    """Refuse numbers that are none, and a task that changes what it evaluates."""
    for name, array in step.info.items():
        if array.dtype.kind == "f" and np.isnan(array[~step.terminated]).any():
            raise ValueError(
                f"info {name!r} of task {aviary.task.name!r} is NaN: a number is needed"
            )
    before = _scene(aviary)
    frame = aviary._current()
    shape = aviary.alive.shape
    for _ in range(2):
        result = aviary.task.evaluate_step(frame)
        check_step_result(aviary.task, result, shape)
        check_info(aviary.task, aviary.task.info(frame), shape)
    if not _equal(before, _scene(aviary)):
        raise ValueError(
            f"evaluate_step of task {aviary.task.name!r} changes the scene or its memory: it may "
            f"be "
            f"asked twice; do it in update_memory"
        )


def _reset(aviary: Aviary, worlds: np.ndarray) -> list[np.ndarray]:
    """Reset some worlds, and see that the others stay as they were."""
    before = _scene(aviary)
    observations = aviary.reset(worlds)
    after = _scene(aviary)
    if not _equal([one[~worlds] for one in before], [one[~worlds] for one in after]):
        raise ValueError(
            f"a reset of one world changes goals, obstacles or memory of others in task "
            f"{aviary.task.name!r}: keep nothing of a world in the task itself"
        )
    return _arrays(aviary, observations)


def _scene(aviary: Aviary) -> list[np.ndarray]:
    scene = aviary.scene
    arrays = (scene.goal, scene.goal_velocity, scene.obstacle, *scene.memory.values())
    return [array.copy() for array in arrays]


def _arrays(aviary: Aviary, observations: Any) -> list[np.ndarray]:
    """List the arrays of an observation. Raises ValueError for numbers that are none."""
    parts = observations if isinstance(observations, dict) else {"vector": observations}
    for name, part in parts.items():
        if not np.isfinite(part).all():
            where = np.argwhere(~np.isfinite(part))[0]
            label = aviary.observer.labels[where[-1]].name if name == "vector" else name
            raise ValueError(f"observation {label!r} is NaN or infinite: finite numbers are needed")
    return list(parts.values())


def _equal(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    pairs = zip(one, other, strict=True)
    return all(np.array_equal(mine, theirs, equal_nan=True) for mine, theirs in pairs)
