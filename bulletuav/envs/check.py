"""Checks for authors of tasks, sensors and dynamics: fly them briefly and find mistakes."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bulletuav.dynamics import find_dynamics
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.step import Step
from bulletuav.sensors.base import SensorSetup
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.check import check_info, check_step_result

DECISIONS = 30
NUM_WORLDS = 3
SEED = 1


def check_task(task: TaskSource, **options: Any) -> None:
    """Check a task for mistakes, in the manner of Gymnasium's `check_env`.

    Flies random actions in three worlds and checks shapes, types and values of the task's results.
    Builds every difficulty and preset. Checks that the same seed gives the same flight, that
    evaluating a decision changes nothing, that a reset of one world does not affect others, and
    that a world flies alone as it does among others.

    Args:
        task: Name of the task, `module:Name`, or a task class.
        **options: Options of the environment.

    Raises:
        ValueError: If a mistake was found; the message names it and the remedy.
    """
    kind = find_task(task)
    for option, choices in (("difficulty", kind.difficulties), ("preset", kind.presets)):
        for name in choices:
            EnvSpec(kind, 1, {**options, option: name})
    _check_worlds(f"task {kind.name!r}", kind, options)


def check_sensor(sensor: Any, **options: Any) -> None:
    """Check a sensor for mistakes: shapes, values, seeds, and independence of worlds.

    Args:
        sensor: A sensor object, a class, a name, or `module:Name`.
        **options: Options of the environment `hover` in which the sensor is tested.

    Raises:
        ValueError: If a mistake was found; the message names it and the remedy.
    """
    found = find_sensor(sensor)
    # Some readings have no labels, such as those that other blocks show
    shown = [name for name in found.gives if name in found.labels(SensorSetup())]
    usual = {"num_drones": 2, "sensors": (found,), "observation": ("velocity", *shown)}
    _check_worlds(f"sensor {found.name!r}", "hover", {**usual, **options})


def check_dynamics(dynamics: Any, **options: Any) -> None:
    """Check a dynamics for mistakes: values, seeds, and independence of worlds.

    Args:
        dynamics: A class derived from `Dynamics`, a name, or `module:Name`.
        **options: Options of the environment `hover` in which the dynamics is tested.

    Raises:
        ValueError: If a mistake was found; the message names it and the remedy.
    """
    name = find_dynamics(dynamics).name
    usual = {"num_drones": 2, "dynamics": dynamics, "action": "velocity"}
    _check_worlds(f"dynamics {name!r}", "hover", {**usual, **options})


def _check_worlds(subject: str, task: TaskSource, options: dict[str, Any]) -> None:
    """Fly a task twice in several worlds, and its last world alone: all results must agree."""
    both = [list(_fly(task, options)) for _ in range(2)]
    alone = list(_fly(task, options, num_worlds=1, first_world=NUM_WORLDS - 1))
    for k, (one, other, single) in enumerate(zip(*both, alone, strict=True)):
        decision = (k + 1) // 2
        if not _equal(one, other):
            raise ValueError(
                f"{subject} differs at decision {decision} of two flights from the same seed: draw "
                f"from the given generators only, and clear all state at a reset"
            )
        if not _equal([array[-1:] for array in one], single):
            raise ValueError(
                f"{subject} gives a world other results when it flies alone, at decision "
                f"{decision}: worlds must be independent of each other"
            )


def _fly(
    task: TaskSource, options: dict[str, Any], *, num_worlds: int = NUM_WORLDS, first_world: int = 0
) -> Iterator[list[np.ndarray]]:
    """Yield the results of some decisions with random actions, and observations after resets.

    Args:
        task: The task.
        options: Options of the environment.
        num_worlds: Number of worlds that are flown.
        first_world: Index of the first of these.
    """
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
            observed = _arrays(aviary, step.observations)
            yield [*observed, step.rewards, step.terminated]
            # Finished worlds are reset, and in turn one in the middle of an episode
            over = ~np.array(aviary.alive.any(axis=1))
            turn = k % NUM_WORLDS - first_world
            if k % 7 == 3 and 0 <= turn < num_worlds:
                over[turn] = True
            yield _reset(aviary, over) if over.any() else observed
    finally:
        aviary.close()


def _check_step(aviary: Aviary, step: Step) -> None:
    """Raise ValueError for NaN infos, and for a task that modifies the state it evaluates."""
    # Infos of drones whose episode ended may be undefined
    for name, array in step.info.items():
        if array.dtype.kind == "f" and np.isnan(array[~step.terminated]).any():
            raise ValueError(
                f"info {name!r} of task {aviary.task.name!r} is NaN: a number is needed"
            )
    # Arrays that tasks may only read
    frame = aviary.current_frame()
    shown = (*frame.before, *frame.after, frame.action)
    before = [*_scene(aviary), *(array.copy() for array in shown)]
    shape = aviary.alive.shape
    # Twice, as repeated calls must change nothing
    for _ in range(2):
        result = aviary.task.evaluate_step(frame)
        check_step_result(aviary.task, result, shape)
        check_info(aviary.task, aviary.task.info(frame), shape)
    if not _equal(before, [*_scene(aviary), *shown]):
        raise ValueError(
            f"evaluate_step or info of task {aviary.task.name!r} changes the swarm, the scene or "
            f"its memory: they may be called twice; do it in update_memory"
        )


def _reset(aviary: Aviary, worlds: np.ndarray) -> list[np.ndarray]:
    """Reset some worlds, and check that the others did not change."""
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
    """List the arrays of an observation. Raises ValueError for NaN and infinity."""
    parts = observations if isinstance(observations, dict) else {"vector": observations}
    for name, part in parts.items():
        if not np.isfinite(part).all():
            where = np.argwhere(~np.isfinite(part))[0]
            labels = aviary.observer.of(int(where[1])).labels
            label = labels[where[-1]].name if name == "vector" else name
            raise ValueError(f"observation {label!r} is NaN or infinite: finite numbers are needed")
    return list(parts.values())


def _equal(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    pairs = zip(one, other, strict=True)
    return all(np.array_equal(mine, theirs, equal_nan=True) for mine, theirs in pairs)
