"""The batched core: W independent worlds of N drones through one decision at a time. Faces are thin wrappers of it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.control.actions import Action, Flyable, make_action
from bulletuav.control.cascade import Cascade
from bulletuav.control.gains import gain_rows
from bulletuav.envs.camera import Camera
from bulletuav.envs.options import Options, resolve
from bulletuav.physics.airframe import parameter_rows
from bulletuav.physics.bullet import BulletDynamics
from bulletuav.physics.dynamics import Dynamics, Flight
from bulletuav.physics.rigid_body import RigidBody
from bulletuav.physics.swarm import Contacts, Swarm
from bulletuav.physics.world import World
from bulletuav.tasks import find_task
from bulletuav.tasks.base import Frame, Scene, Setting, Spawn, Task, refuse_overlap
from bulletuav.tasks.terms.observations import STATE, Observer

DYNAMICS: dict[str, type[Dynamics]] = {"bullet": BulletDynamics, "rigid_body": RigidBody}


class Step(NamedTuple):
    """Outcome of a decision: observations (W, N, D) float32; rewards, terminated, truncated (W, N); info name -> (W, N)."""

    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, np.ndarray]


class Aviary:
    """W worlds of N drones flying one task.

    Never resets by itself: a drone whose episode ended leaves the airspace and is masked by `alive` (W, N) until its world
    is reset. World k's random numbers come from seed + k alone, and nothing that other worlds do changes world k.

    Public state, to read: options, task, action, observer, swarm, scene, alive, steps (W,).
    """

    def __init__(self, task: str, num_worlds: int = 1, **options: Any):
        """Build the worlds; see `Options` and the task's config. Raises ValueError for options that cannot be."""
        kind = find_task(task)
        self.options, config = resolve(kind, options)
        if not isinstance(num_worlds, int) or num_worlds < 1:
            raise ValueError(f"num_worlds is {num_worlds!r}: a whole number, at least 1, is needed")
        self.num_worlds, self.num_drones = num_worlds, self.options.num_drones
        self.task = self._make_task(kind, config, self.options)
        self.action = self._make_action()
        self.observer = Observer(self.options.observation or kind.observation, self.task)
        self.state_observer = Observer(STATE, self.task)
        self._world = World(
            [self.options.airframe] * self.num_drones,
            num_worlds,
            1 / self.options.physics_hz,
            live=self.options.render_mode == "human",
        )
        self._dynamics, self._cascade = self._make_dynamics()
        self._camera = Camera(self._world, self.options.render_size)
        shape = (num_worlds, self.num_drones)
        self.swarm = Swarm.zeros(*shape, len(self.options.airframe.rotors))
        self.scene = Scene(np.zeros((*shape, 3)), np.zeros((*shape, 3)))
        self.alive = np.zeros(shape, dtype=bool)
        self.steps = np.zeros(num_worlds, dtype=np.int64)
        self._wind = np.broadcast_to(np.array(self.options.wind, dtype=float), (*shape, 3)).copy()
        self._rng: list[np.random.Generator | None] = [None] * num_worlds
        self._frame: Frame | None = None

    @staticmethod
    def _make_task(kind: type[Task], config: Any, options: Options) -> Task:
        radius, period = options.airframe.collision_radius, 1 / options.decision_hz
        return kind(config, Setting(options.num_drones, radius, options.max_speed, period))

    def _make_action(self) -> Action:
        airframes = [self.options.airframe] * self.num_drones
        flyable = Flyable(airframes, self.options.max_speed, self.task.arena_low, self.task.arena_high)
        action = make_action(self.options.action, flyable)
        self.options.check_level(action.level)
        return action

    def _make_dynamics(self) -> tuple[Dynamics, Cascade]:
        options = self.options
        airframes = [options.airframe] * self.num_drones
        worlds = (self.num_worlds, 1)
        actual = np.tile(parameter_rows(airframes, options.effects), worlds)
        nominal = np.tile(parameter_rows(airframes), worlds)
        cascade = Cascade.of(options.controller, nominal, np.tile(gain_rows(airframes, options.max_speed), worlds))
        substeps = options.physics_hz // options.decision_hz
        flight = Flight(self._world, actual, cascade, 1 / options.physics_hz, substeps, options.gravity)
        return DYNAMICS[options.dynamics](flight), cascade

    def reset(self, mask: np.ndarray | None = None, seeds: int | Sequence[int] | None = None) -> np.ndarray:
        """Start new episodes in the worlds of `mask` (W,), all by default; returns observations (W, N, D) float32.

        `seeds`: an int s gives world k the seed s + k; a sequence gives each of the W worlds its own; None goes on with each
        world's random numbers (which begin from the option `seed`, or from entropy).
        """
        self._require_open()
        worlds = np.arange(self.num_worlds) if mask is None else np.flatnonzero(self._checked_mask(mask))
        generators = self._generators(worlds, seeds)
        spawns = [self.task.spawn(rng) for rng in generators]
        for spawn in spawns:
            refuse_overlap(spawn.position, self.options.airframe.collision_radius)
        for k, rng, spawn in zip(worlds, generators, spawns, strict=True):
            self._rng[k] = rng
            self._place(int(k), spawn)
        chosen = np.zeros(self.alive.shape, dtype=bool)
        chosen[worlds] = True
        self._dynamics.place(self.swarm, chosen)
        self._frame = self._rest_frame()
        return self.observer.observe(self._frame, self.alive)

    def _checked_mask(self, mask: np.ndarray) -> np.ndarray:
        mask = np.asarray(mask)
        if mask.shape != (self.num_worlds,) or mask.dtype != bool:
            raise ValueError(f"mask has shape {mask.shape} and type {mask.dtype}: ({self.num_worlds},) bool is needed")
        return mask

    def _generators(self, worlds: np.ndarray, seeds: int | Sequence[int] | None) -> list[np.random.Generator]:
        if seeds is None:
            first = self.options.seed
            return [self._rng[k] or np.random.default_rng(None if first is None else first + int(k)) for k in worlds]
        if isinstance(seeds, int | np.integer):
            seeds = [int(seeds) + k for k in range(self.num_worlds)]
        if len(seeds) != self.num_worlds:
            raise ValueError(f"{len(seeds)} seeds for {self.num_worlds} worlds: one each, or a single int, is needed")
        for seed in seeds:
            if not isinstance(seed, int | np.integer) or seed < 0:
                raise ValueError(f"seed is {seed!r}: a whole number, at least 0, is needed")
        return [np.random.default_rng(int(seeds[k])) for k in worlds]

    def _place(self, k: int, spawn: Spawn) -> None:
        for array, value in zip(self.swarm, spawn[:4], strict=False):
            array[k] = value
        self.swarm.rotor_speed[k] = self.options.airframe.hover_speed(self.options.gravity)
        self.scene.start[k], self.scene.goal[k] = spawn.position, spawn.goal
        self._cascade.memory[k] = 0
        self.alive[k] = True
        self.steps[k] = 0

    def _rest_frame(self) -> Frame:
        """A frame in which nothing happened, to observe after a reset."""
        now = self.swarm.copy()
        action = np.zeros((*self.alive.shape, len(self.action.low)))
        return self._make_frame(now, now, action, Contacts.merge({}), self.alive.copy())

    def _make_frame(self, before: Swarm, after: Swarm, action: np.ndarray, contacts: Contacts, alive: np.ndarray) -> Frame:
        time = self.steps / self.options.decision_hz
        return Frame(before, after, action, self.scene, contacts, alive, time, self.task.config.d_safe)

    def step(self, actions: np.ndarray) -> Step:
        """Fly one decision with actions (W, N, A), those beyond the bounds clipped to them.

        Raises ValueError for a wrong shape or a number that is not finite in a living drone's action (the worlds stay as
        they were), RuntimeError before the first reset or after `close`.
        """
        self._require_open()
        if self._frame is None:
            raise RuntimeError("the worlds have not been started: call reset() before step()")
        flown = self.alive.copy()
        action = self._checked_action(actions)
        before = self.swarm.copy()
        contacts = self._dynamics.fly(self.swarm, flown, self.action.level, self.action.decode(action), self._wind)
        self.steps += flown.any(axis=1)
        frame = self._make_frame(before, self.swarm.copy(), action, contacts, flown)
        terms = self.task.reward_terms(frame)
        terminated = self.task.terminated(frame) & flown
        truncated = (self.steps >= self.options.horizon)[:, None] & flown & ~terminated
        self._frame = frame
        self.alive = flown & ~terminated & ~truncated
        observations = self.observer.observe(frame, self.alive)
        weighted = {name: np.where(flown, self.task.weights[name] * term, 0.0) for name, term in terms.items()}
        self._world.park(flown & ~self.alive)
        if self.options.render_mode == "human":
            self._dynamics.show(self.swarm, self.alive)
            self._camera.show(self.swarm, self.alive, 1 / self.options.decision_hz)
        return Step(
            observations, np.sum(list(weighted.values()), axis=0), terminated, truncated, self._info(frame, weighted)
        )

    def _checked_action(self, actions: np.ndarray) -> np.ndarray:
        actions = np.asarray(actions, dtype=np.float64)
        shape = (*self.alive.shape, len(self.action.low))
        if actions.shape != shape:
            raise ValueError(f"actions have shape {actions.shape}: (worlds, drones, {self.action.name}) = {shape} is needed")
        bad = ~np.isfinite(actions).all(axis=-1) & self.alive
        if bad.any():
            w, i = np.argwhere(bad)[0]
            raise ValueError(f"action of drone {i} in world {w} is {actions[w, i]}: finite numbers are needed")
        return np.clip(np.where(self.alive[..., None], actions, 0.0), self.action.low, self.action.high)

    def _info(self, frame: Frame, weighted: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        info = {f"reward/{name}": term for name, term in weighted.items()}
        info["success"] = self.task.succeeded(frame) & frame.alive
        info["collision"] = frame.collision
        info["conflicts"] = frame.conflict.onsets
        info["separation"] = frame.conflict.separation
        info["goal_distance"] = frame.distance
        return info

    def first_info(self) -> dict[str, np.ndarray]:
        """Info right after a reset: the keys of every step's info, terms at zero."""
        frame = self._current()
        zero = np.zeros(self.alive.shape)
        return self._info(frame, dict.fromkeys(self.task.weights, zero))

    def _current(self) -> Frame:
        if self._frame is None:
            raise RuntimeError("the worlds have not been started: call reset() first")
        return self._frame

    def state(self) -> np.ndarray:
        """(W, N * 17) float32: position, attitude, velocity, rates, goal position and alive of every drone."""
        return self.state_observer.observe(self._current(), self.alive).reshape(self.num_worlds, -1)

    def render(self, world: int = 0) -> np.ndarray | None:
        """(height, width, 3) uint8 picture of a world with render_mode "rgb_array"; None otherwise."""
        self._require_open()
        if self.options.render_mode != "rgb_array":
            return None
        self._current()
        self._dynamics.show(self.swarm, self.alive)
        return self._camera.picture(world, self.swarm, self.scene.goal[world], self.alive)

    def _require_open(self) -> None:
        if self._world.closed:
            raise RuntimeError("this environment is closed: make a new one")

    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._world.close()
