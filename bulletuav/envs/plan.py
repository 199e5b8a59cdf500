"""What an environment is before there is an engine: options, task, action, observation, and what is asked of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bulletuav.control.actions import Action, Flyable, make_action
from bulletuav.envs.options import Options, resolve
from bulletuav.errors import numbers_of, whole
from bulletuav.physics.tiles import TILE_PITCH
from bulletuav.physics.world import PARKING_HEIGHT
from bulletuav.sensors.lidar import make_beams
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.base import Setting, Task
from bulletuav.tasks.terms.observations import STATE, Observer


class Plan:
    """Checked options and what follows from them: task, action, observer and state_observer."""

    def __init__(self, task: TaskSource, num_worlds: int, options: dict[str, Any]):
        """See `Aviary`. Raises ValueError for options that cannot be."""
        kind = find_task(task)
        self.options, config = resolve(kind, options)
        self.num_worlds = whole("num_worlds", num_worlds, 1)
        self.task = _make_task(kind, config, self.options)
        self.action = _make_action(self.options, self.task)
        names, camera = self.options.observation or kind.observation, self.options.camera_size
        self.observer = Observer(names, self.task, self.action, camera, self.options.normalise)
        self.state_observer = Observer(STATE, self.task, self.action)
        self.wanted = {*names, *kind.senses}

    def mask(self, mask: np.ndarray | None) -> np.ndarray:
        """(W,) worlds to reset, all for None. Raises ValueError for another shape or type."""
        if mask is None:
            return np.ones(self.num_worlds, dtype=bool)
        mask = np.asarray(mask)
        if mask.shape != (self.num_worlds,) or mask.dtype != bool:
            raise ValueError(f"mask has shape {mask.shape} and type {mask.dtype}: ({self.num_worlds},) bool is needed")
        return mask

    def require_world(self, world: Any) -> None:
        """Raise ValueError unless there is a world of that number."""
        if world not in range(self.num_worlds):
            raise self._no_world(world)

    def worlds(self, world: Any) -> np.ndarray:
        """`world`, one or several, as an array. Raises ValueError unless all are whole numbers of worlds that there are."""
        worlds = np.asarray(world)
        if worlds.dtype.kind not in "iu" or ((worlds < 0) | (worlds >= self.num_worlds)).any():
            raise self._no_world(world)
        return worlds

    def _no_world(self, world: Any) -> ValueError:
        return ValueError(f"world is {world!r}: a whole number from 0 to {self.num_worlds - 1} is needed")

    def seeds(self, seeds: int | Sequence[int] | None) -> list[int] | None:
        """One seed for each world: from s on for an int s, None for None. Raises ValueError for what cannot be a seed."""
        if seeds is None:
            return None
        if isinstance(seeds, int | np.integer):
            return [whole("seed", seeds, 0) + k for k in range(self.num_worlds)]
        if not isinstance(seeds, list | tuple | np.ndarray) or np.shape(seeds) != (self.num_worlds,):
            raise ValueError(
                f"seed is {seeds!r}: a whole number, or a list of {self.num_worlds}, one for each world, is needed"
            )
        return [whole("seed", seed, 0) for seed in seeds]

    def actions(self, actions: Any, alive: np.ndarray) -> np.ndarray:
        """(W, N, A) actions within their bounds, zeros for drones that are not `alive` (W, N).

        Raises ValueError for a wrong shape, or a number of a living drone that is not finite or no choice.
        """
        actions = numbers_of("actions are", actions)
        shape = (*alive.shape, self.action.low.shape[-1])
        if actions.shape != shape:
            raise ValueError(f"actions have shape {actions.shape}: (worlds, drones, {self.action.name}) = {shape} is needed")
        finite = np.isfinite(actions)
        if not finite.all() and (bad := ~finite.all(axis=-1) & alive).any():
            w, i = np.argwhere(bad)[0]
            raise ValueError(f"action of drone {i} in world {w} is {actions[w, i]}: finite numbers are needed")
        if not alive.all():
            actions = np.where(alive[..., None], actions, 0.0)
        clipped = np.minimum(np.maximum(actions, self.action.low), self.action.high)
        if self.action.choices is not None and (clipped != actions).any() | (clipped % 1 != 0).any():
            w, i, _ = np.argwhere((clipped != actions) | (clipped % 1 != 0))[0]
            raise ValueError(
                f"action of drone {i} in world {w} is {actions[w, i, 0]:g}: a whole number from 0 to "
                f"{self.action.choices - 1} is needed"
            )
        return clipped


def _make_task(kind: type[Task], config: Any, options: Options) -> Task:
    radius = max(airframe.collision_radius for airframe in options.airframe)
    period = 1 / options.decision_hz
    task = kind(
        config,
        Setting(
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
    reach = float(np.abs([task.arena_low[:2], task.arena_high[:2]]).max())
    if 2 * (reach + radius) >= TILE_PITCH or task.arena_high[2] >= PARKING_HEIGHT:
        raise ValueError(
            f"the arena reaches {reach:g} m aside and {task.arena_high[2]:g} m up: less than {TILE_PITCH / 2:g} and "
            f"{PARKING_HEIGHT:g} m are needed, where other worlds begin"
        )
    if config.d_safe <= 2 * radius:
        raise ValueError(f"d_safe {config.d_safe:g} m must exceed the {2 * radius:.3g} m across of the largest drone")
    return task


def _make_action(options: Options, task: Task) -> Action:
    period = 1 / options.decision_hz
    return make_action(
        options.action,
        Flyable(options.airframe, options.max_speed, task.arena_low, task.arena_high, period, options.gravity),
    )
