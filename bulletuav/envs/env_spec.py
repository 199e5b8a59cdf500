"""What an environment is before there is an engine: options, task, action, observation, and what is asked of them."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.control.actions import Action, ActionContext, make_action
from bulletuav.engine.engine import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve import resolve
from bulletuav.errors import as_int, as_sequence, choose, finite, numbers_of, require_memory, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.lidar import make_beams
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.base import Task, TaskContext
from bulletuav.tasks.observations.observer import IMAGES, NAMES, STATE, ObservationBuilder

MOST_WORLDS = 1_000_000
BODY_BYTES, OBSTACLE_BYTES, LAYOUT_BYTES = 100_000, 5_000, 100_000
"""Of a drone, an obstacle and a city in one world of the engine, measured"""
NUMBER_BYTES = 8
LARGE = 100.0  # m, of an option that may be to blame for an arena that is too large


class EnvSpec:
    """Checked options and what follows from them: task, action, observer and state_observer."""

    def __init__(self, task: TaskSource, num_worlds: int, options: dict[str, Any]):
        """See `Aviary`. Raises ValueError for options that cannot be."""
        kind = find_task(task)
        self.num_worlds = as_int("num_worlds", num_worlds, 1, MOST_WORLDS)
        self.options, config = resolve(kind, options)
        self._require_memory(BODY_BYTES * self.options.num_drones)
        self.task = _make_task(kind, config, self.options)
        self.action = _make_action(self.options, self.task)
        names, camera = self.options.observation or kind.observation, self.options.camera_size
        self.observer = ObservationBuilder(
            names, self.task, self.action, camera, self.options.normalise
        )
        self.state_observer = ObservationBuilder(STATE, self.task, self.action)
        for name in kind.senses:
            choose(
                f"reading among the senses of task {self.task.name!r}:", name, dict.fromkeys(NAMES)
            )
        self.wanted = {*names, *kind.senses}
        self._require_memory(self._world_bytes())

    def _require_memory(self, each: float) -> None:
        """Raise ValueError where the worlds do not fit into the machine, at `each` bytes."""
        drones = self.options.num_drones
        what = f"{self.num_worlds} worlds of {drones} drones (num_worlds, num_drones) with what they observe"
        require_memory(
            what, self.num_worlds * each, "lower num_worlds, num_drones, or what is observed"
        )

    def _world_bytes(self) -> float:
        """About what a world takes: bodies of drones, obstacles and cities, and what is kept of each drone at once.

        That is what it observes, its pictures, the others, targets, and the task's memory.
        """
        pictures = math.prod(self.options.camera_size) if self.wanted.intersection(IMAGES) else 0
        memory = (
            sum(math.prod(shape) for shape in self.task.memory().values())
            // self.options.num_drones
        )
        others = self.options.num_drones if {"neighbours", "all_neighbours"} & self.wanted else 0
        numbers = (
            2 * self.observer.low.size
            + 2 * pictures
            + 3 * others
            + 2 * self.task.num_targets
            + memory
        )
        things = OBSTACLE_BYTES * len(self.task.obstacles()) + LAYOUT_BYTES * len(
            self.task.layouts()
        )
        return (BODY_BYTES + NUMBER_BYTES * numbers) * self.options.num_drones + things

    def mask(self, mask: np.ndarray | None) -> np.ndarray:
        """(W,) worlds to reset, all for None. Raises ValueError for another shape or type."""
        if mask is None:
            return np.ones(self.num_worlds, dtype=bool)
        try:
            mask = np.asarray(mask)
        except ValueError:
            raise ValueError(
                f"mask is {shown(mask)}: ({self.num_worlds},) bool is needed"
            ) from None
        if mask.shape != (self.num_worlds,) or mask.dtype != bool:
            raise ValueError(
                f"mask has shape {mask.shape} and type {mask.dtype}: ({self.num_worlds},) bool is needed"
            )
        return mask

    def require_world(self, world: Any) -> None:
        """Raise ValueError unless there is a world of that number."""
        if (
            not isinstance(world, int | np.integer)
            or isinstance(world, bool)
            or not 0 <= world < self.num_worlds
        ):
            raise self._no_world(world)

    def worlds(self, world: Any) -> np.ndarray:
        """`world`, one or several, as an array. Raises ValueError unless all are whole numbers of worlds that there are."""
        try:
            worlds = np.asarray(world)
        except ValueError:
            raise self._no_world(world) from None
        if worlds.dtype.kind not in "iu" or ((worlds < 0) | (worlds >= self.num_worlds)).any():
            raise self._no_world(world)
        return worlds

    def _no_world(self, world: Any) -> ValueError:
        return ValueError(
            f"world is {shown(world)}: a whole number from 0 to {self.num_worlds - 1} is needed"
        )

    def seeds(self, seeds: Any) -> list[int] | None:
        """One seed for each world: from s on for an int s, None for None. Raises ValueError for what cannot be a seed."""
        if seeds is None:
            return None
        if isinstance(seeds, int | np.integer) and not isinstance(seeds, bool):
            return [as_int("seed", seeds, 0) + k for k in range(self.num_worlds)]
        listed = isinstance(seeds, list | tuple) or (
            isinstance(seeds, np.ndarray) and seeds.ndim == 1
        )
        if not listed or len(seeds) != self.num_worlds:
            raise ValueError(
                f"seed is {shown(seeds)}: a whole number, or a list of {self.num_worlds}, one for each world, is needed"
            )
        return [as_int("seed", seed, 0) for seed in seeds]

    def actions(self, actions: Any, alive: np.ndarray) -> np.ndarray:
        """(W, N, A) actions within their bounds, zeros for drones that are not `alive` (W, N).

        Raises ValueError for a wrong shape, or a number of a living drone that is not finite or no choice.
        """
        actions = numbers_of("actions are", actions)
        shape = (*alive.shape, self.action.low.shape[-1])
        if actions.shape != shape:
            raise ValueError(
                f"actions have shape {actions.shape}: (worlds, drones, {self.action.name}) = {shape} is needed"
            )
        finite = np.isfinite(actions)
        if not finite.all() and (bad := ~finite.all(axis=-1) & alive).any():
            w, i = np.argwhere(bad)[0]
            raise ValueError(
                f"action of drone {i} in world {w} is {actions[w, i]}: finite numbers are needed"
            )
        if not alive.all():
            actions = np.where(alive[..., None], actions, 0.0)
        clipped = np.minimum(np.maximum(actions, self.action.low), self.action.high)
        if (
            self.action.choices is not None
            and (clipped != actions).any() | (clipped % 1 != 0).any()
        ):
            w, i, _ = np.argwhere((clipped != actions) | (clipped % 1 != 0))[0]
            raise ValueError(
                f"action of drone {i} in world {w} is {actions[w, i, 0]:g}: a whole number from 0 to "
                f"{self.action.choices - 1} is needed"
            )
        return clipped


def _make_task(kind: type[Task], config: Any, options: EnvOptions) -> Task:
    radius = max(airframe.collision_radius for airframe in options.airframe)
    period = 1 / options.decision_hz
    task = kind(
        config,
        TaskContext(
            options.num_drones,
            radius,
            options.max_speed,
            period,
            options.num_neighbours,
            options.horizon * period,
            make_beams(options.num_beams, options.lidar_elevations),
            options.max_range,
        ),
    )
    _check_arena(task, config, radius)
    _check_things(task)
    if config.d_safe <= 2 * radius:
        raise ValueError(
            f"d_safe {config.d_safe:g} m must exceed the {2 * radius:.3g} m across of the largest drone"
        )
    return task


def _check_arena(task: Task, config: Any, radius: float) -> None:
    """Raise ValueError where an arena is none, or reaches into that of other worlds."""
    arena = numbers_of(
        f"arena_low and arena_high of task {task.name!r} are", [task.arena_low, task.arena_high]
    )
    if arena.shape != (2, 3) or not np.isfinite(arena).all() or not (arena[0] < arena[1]).all():
        raise ValueError(
            f"arena_low and arena_high of task {task.name!r} are {shown(arena)}: lower and upper corner are needed"
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
            f"the arena reaches {reach:g} m aside and {arena[1, 2]:g} m up: less than {TILE_PITCH / 2:g} and "
            f"{PARKING_HEIGHT:g} m are needed, where other worlds begin; lower {' or '.join(large) or 'num_drones'}"
        )


def _check_things(task: Task) -> None:
    """Raise ValueError where a task's bodies, cities or memory are none."""
    kinds: dict[str, type] = {"obstacles": Obstacle, "layouts": Solids}
    for name, kind in kinds.items():
        things = getattr(task, name)()
        if not isinstance(things, list | tuple) or not all(isinstance(one, kind) for one in things):
            raise ValueError(
                f"{name} of task {task.name!r} gave {shown(things)}: a list of {kind.__name__} is needed"
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


def _make_action(options: EnvOptions, task: Task) -> Action:
    period = 1 / options.decision_hz
    return make_action(
        options.action,
        ActionContext(
            options.airframe,
            options.max_speed,
            task.arena_low,
            task.arena_high,
            period,
            options.gravity,
        ),
    )
