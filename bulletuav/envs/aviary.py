"""The batched core: W independent worlds of N drones through one decision at a time. Faces are thin wrappers of it."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from bulletuav.control.cascade import Cascade
from bulletuav.control.gains import gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import find_dynamics
from bulletuav.dynamics.base import Dynamics, Flight
from bulletuav.dynamics.contacts import overlaps
from bulletuav.engine.engine import Engine
from bulletuav.envs.energy import Energy
from bulletuav.envs.env_spec import MOST_WORLDS, EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.randomization import Uncertainty
from bulletuav.envs.renderer import Camera
from bulletuav.envs.senses import SensorSuite
from bulletuav.envs.step import Step
from bulletuav.errors import as_int, points_of
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.sight import line_of_sight
from bulletuav.tasks import TaskSource
from bulletuav.tasks.base import Frame, Scene, Spawn
from bulletuav.tasks.check import check_spawn, check_step_result, require_finite
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm, confine
from bulletuav.vehicle.wind import Wind

NOTHING_STANDS = Solids(np.zeros((0, 2, 3)))


class Aviary(Environment):
    """W worlds of N drones flying one task.

    Never resets by itself: a drone whose episode ended leaves the airspace and is masked by `alive` (W, N) until its world
    is reset. World k's random numbers come from seed + k alone, and nothing that other worlds do changes world k.

    Public state, to read: options, task, action, observer, swarm, scene, alive, steps (W,), commanded (W, N, 3) (velocities
    commanded last, m/s), parameters (W, N) (rows of `PARAMETERS` that the drones fly with) and rng, the worlds' random
    generators, None before their first reset.
    """

    def __init__(
        self, task: TaskSource, num_worlds: int = 1, *, first_world: int = 0, **options: Any
    ):
        """Build the worlds; see `Options` and the task's config. Raises ValueError for options that cannot be.

        `first_world`: number of the first of these worlds among those of several processes; world k is then the one that
        it would be in a single process.
        """
        self._plan = plan = EnvSpec(task, num_worlds, options)
        self.options, self.task, self.action, self.observer = (
            plan.options,
            plan.task,
            plan.action,
            plan.observer,
        )
        self.state_observer = plan.state_observer
        shape = self.num_worlds, self.num_drones = plan.num_worlds, self.options.num_drones
        live = self.options.render_mode == "human"
        dt, self._first_world = (
            1 / self.options.physics_hz,
            as_int("first_world", first_world, 0, MOST_WORLDS),
        )
        obstacles, layouts = self.task.obstacles(), self.task.layouts()
        self._engine = Engine(
            self.options.airframe, self.num_worlds, dt, obstacles, layouts, first_world, live
        )
        self._dynamics, self._cascade = self._make_dynamics()
        self.options.check_setpoint_levels(self.action.level, self._dynamics.consumes)
        self._camera = Camera(self._engine, self.options.render_size)
        self.swarm = Swarm.zeros(
            *shape, max(len(airframe.rotors) for airframe in self.options.airframe)
        )
        self.scene = Scene.empty(*shape, len(obstacles), self.task.memory())
        self.commanded = np.zeros((*shape, 3))
        self.alive = np.zeros(shape, dtype=bool)
        self.steps = np.zeros(self.num_worlds, dtype=np.int64)
        self._wind = Wind(
            self.options.wind, self.options.wind20, shape, 1 / self.options.decision_hz
        )
        self._uncertainty = self._make_uncertainty()
        drawn = {} if self._uncertainty is None else self._uncertainty.drawn
        self._senses = SensorSuite(
            plan.wanted, self.task, self.options, self._engine, self._dynamics, drawn
        )
        self._energy = Energy(self.options, self.parameters)
        self.rng: list[np.random.Generator | None] = [None] * self.num_worlds
        self._frame: Frame | None = None
        self._judged = False

    def _make_dynamics(self) -> tuple[Dynamics, Cascade]:
        options, worlds = self.options, (self.num_worlds, 1)
        actual = np.tile(parameter_rows(options.airframe, options.effects), worlds)
        nominal = actual.copy()
        gains = np.tile(gain_rows(options.airframe, options.max_speed), worlds)
        cascade = Cascade.of(options.controller, nominal, gains)
        substeps = options.physics_hz // options.decision_hz
        self.parameters = actual
        flight = Flight(
            self._engine, actual, cascade, 1 / options.physics_hz, substeps, options.gravity
        )
        return find_dynamics(options.dynamics)(flight), cascade

    def _make_uncertainty(self) -> Uncertainty | None:
        if not self.options.randomization.active:
            return None
        period = 1 / self.options.decision_hz
        return Uncertainty(
            self.options.randomization, self._engine, self.parameters, self._wind, period
        )

    @exclusive
    def reset(
        self, mask: np.ndarray | None = None, seeds: int | Sequence[int] | None = None
    ) -> Observation:
        """Start new episodes in the worlds of `mask` (W,), all by default; returns observations (W, N, D) float32.

        `seeds`: an int s gives world k the seed s + k; a sequence gives each of the W worlds its own; None goes on with each
        world's random numbers (which begin from the option `seed`, or from entropy).
        """
        self._require_open()
        worlds = np.flatnonzero(self._plan.mask(mask))
        generators = self._generators(worlds, self._plan.seeds(seeds))
        spawns = [self.task.spawn(rng) for rng in generators]
        for spawn in spawns:  # all before anything of the worlds is written
            check_spawn(
                self.task,
                spawn,
                self.options.airframe,
                self.scene.obstacle.shape[1],
                self.scene.memory,
            )
        for k, rng, spawn in zip(worlds, generators, spawns, strict=True):
            self.rng[k] = rng
            self._place(int(k), spawn)
            self._wind.reset(int(k), rng)
            if self._uncertainty is not None:
                self._uncertainty.start(int(k), self.swarm, rng)
            self._senses.start(int(k), self.swarm, rng)
            self._energy.start(int(k))
        chosen = np.zeros(self.alive.shape, dtype=bool)
        chosen[worlds] = True
        self._dynamics.place(self.swarm, chosen)
        self._engine.set_layouts(self.scene.layout, np.any(chosen, axis=1))
        self._engine.set_obstacles(
            self.scene.obstacle, self.scene.obstacle_quaternion, np.any(chosen, axis=1)
        )
        now = self.swarm.copy()
        self._senses.take(now, now, self.scene, chosen, self.steps, self.rng)
        action = np.zeros((*self.alive.shape, self.action.low.shape[-1]))
        flown = chosen
        if self._frame is not None:  # of the worlds that fly on
            action = np.where(chosen[..., None], action, self._frame.action)
            flown = chosen | self._frame.alive
        frame = self._make_frame(
            now, now, action, Contacts.merge({}), flown, self.scene.goal.copy()
        )
        if not self._judged:  # once: later verdicts are of the same form
            check_step_result(self.task, self.task.evaluate_step(frame), flown.shape)
            self._judged = True
        self._frame = frame
        return self.observer.observe(self._frame, self.alive)

    def _generators(self, worlds: np.ndarray, seeds: list[int] | None) -> list[np.random.Generator]:
        if seeds is not None:
            return [np.random.default_rng(seeds[k]) for k in worlds]
        first = None if self.options.seed is None else self.options.seed + self._first_world
        return [
            self.rng[k] or np.random.default_rng(None if first is None else first + int(k))
            for k in worlds
        ]

    def _place(self, k: int, spawn: Spawn) -> None:
        for array, value in zip(self.swarm, spawn[:4], strict=False):
            array[k] = value
        for i, airframe in enumerate(self.options.airframe):
            self.swarm.rotor_speed[k, i, : len(airframe.rotors)] = airframe.hover_speed(
                self.options.gravity
            )
        self.scene.start[k], self.scene.goal[k] = spawn.position, spawn.goal
        self.scene.goal_velocity[k] = spawn.goal_velocity
        self.scene.obstacle[k], self.scene.obstacle_velocity[k] = (
            spawn.obstacle,
            spawn.obstacle_velocity,
        )
        self.scene.layout[k] = spawn.layout
        for name, remembered in self.scene.memory.items():
            remembered[k] = spawn.memory.get(name, 0)
        self._cascade.memory[k] = 0
        self.commanded[k] = spawn.velocity
        self.alive[k] = True
        self.steps[k] = 0

    def _make_frame(
        self,
        before: Swarm,
        after: Swarm,
        action: np.ndarray,
        contacts: Contacts,
        flown: np.ndarray,
        goal_before: np.ndarray,
    ) -> Frame:
        readings = {**self._energy.readings(), **self._senses.readings()}
        if self._uncertainty is not None:
            readings |= self._uncertainty.readings()
        time, last = self.steps / self.options.decision_hz, self.steps >= self.options.horizon
        task = self.task
        return Frame(
            before,
            after,
            action,
            self.scene,
            contacts,
            flown,
            time,
            last,
            task.config.d_safe,
            task.zone,
            goal_before,
            readings,
        )

    @exclusive
    def step(self, actions: np.ndarray) -> Step:
        """Fly one decision with actions (W, N, A), those beyond the bounds clipped to them.

        Raises ValueError for a wrong shape or a number that is not finite in a living drone's action (the worlds stay as
        they were), RuntimeError before the first reset or after `close`.
        """
        self.require_started()
        frame = self._fly(self._plan.actions(actions, self.alive), self.alive.copy())
        self.task.update_memory(frame, self.rng)
        flown, result = frame.alive, self.task.evaluate_step(frame)
        terminated = (result.terminated | frame.depleted) & flown
        present = flown & ~terminated  # the horizon takes nobody away
        truncated = frame.last[:, None] & present
        self._frame = frame
        self.alive = present & ~truncated
        observations = self.observer.observe(frame, present)
        weighted = {name: self.task.weights[name] * term for name, term in result.terms.items()}
        if not flown.all():
            weighted = {name: np.where(flown, term, 0.0) for name, term in weighted.items()}
        self._engine.park(flown & ~self.alive)
        if self.options.render_mode == "human":
            self._dynamics.show(self.swarm, self.alive)
            self._camera.show(self.swarm, self.alive, 1 / self.options.decision_hz)
        reward = functools.reduce(np.add, weighted.values(), np.zeros(flown.shape))
        require_finite(self.task, weighted, reward)
        return Step(
            observations, reward, terminated, truncated, self._info(frame, weighted, result.success)
        )

    def _fly(self, action: np.ndarray, flown: np.ndarray) -> Frame:
        """One decision of the drones of `flown` (W, N)."""
        flying, time = np.any(flown, axis=1), self.steps / self.options.decision_hz
        wind = self._wind.sample(self.swarm, time, self.rng, flying)
        before, goal_before = self.swarm.copy(), self.scene.goal.copy()
        motion = self._move_scene(flying)
        setpoint = self.action.decode(action, self.commanded)
        if self.action.level == SetpointLevel.VELOCITY:
            self.commanded = setpoint[..., :3]
        if self._uncertainty is not None:
            self._uncertainty.drain(time)
        contacts = self._dynamics.fly(self.swarm, flown, self.action.level, setpoint, wind, motion)
        if motion.moving:
            self._engine.set_obstacles(self.scene.obstacle, self.scene.obstacle_quaternion, flying)
        if self.task.rebound is not None:
            moved = confine(
                self.swarm,
                self.commanded,
                flown,
                self.task.arena_low,
                self.task.arena_high,
                self.task.rebound,
            )
            if moved.any():
                self._dynamics.place(self.swarm, moved)
                contacts = contacts.joined(
                    overlaps(self._engine, self.swarm, moved, flown, self.parameters)
                )
        self.steps += flying
        if self._uncertainty is not None:
            self._uncertainty.sense(self.swarm, flown, self.rng)
        after = self.swarm.copy()
        self._energy.spend(before, after, wind, self.task.payload_power(self.scene), flown)
        self._senses.take(before, after, self.scene, flown, self.steps, self.rng)
        return self._make_frame(before, after, action, contacts, flown, goal_before)

    def _move_scene(self, flying: np.ndarray) -> Motion:
        """Let the task move goals and obstacles of the worlds that fly; tells where obstacles go meanwhile."""
        before = self.scene.obstacle.copy()
        time = self.steps / self.options.decision_hz
        moved = self.task.advance(self.scene, time, flying, self.rng)
        after = self.scene.obstacle.copy() if moved else before
        return Motion(before, after, self.scene.obstacle_quaternion)

    def _info(
        self, frame: Frame, weighted: dict[str, np.ndarray], success: np.ndarray
    ) -> dict[str, np.ndarray]:
        info = {f"reward/{name}": term for name, term in weighted.items()}
        info["success"] = success & frame.alive
        info["collision"] = frame.collision
        info["conflicts"] = frame.conflict.onsets
        info["separation"] = frame.conflict.separation
        info["goal_distance"] = frame.distance
        info |= {name: frame.readings[name] for name in ("power", "charge")} | self.task.info(frame)
        if self._uncertainty is not None:
            info |= self._uncertainty.info()
        return {
            name: np.array(value) for name, value in info.items()
        }  # whose callers may write into them

    @exclusive
    def first_info(self) -> dict[str, np.ndarray]:
        """Info right after a reset: the keys of every step's info, terms at zero."""
        result = self.task.evaluate_step(self._current())
        return self._info(
            self._current(), dict.fromkeys(result.terms, np.zeros(self.alive.shape)), result.success
        )

    def _current(self) -> Frame:
        if self._frame is None:
            raise RuntimeError("the worlds have not been started: call reset() first")
        return self._frame

    @exclusive
    def state(self) -> np.ndarray:
        """(W, N * 17) float32: the true position, attitude, velocity, rates, goal position and alive of every drone."""
        self._require_open()
        frame = self._current()
        if self._uncertainty is not None:
            frame = dataclasses.replace(frame, readings={})
        state = self.state_observer.observe(frame, self.alive)
        assert isinstance(state, np.ndarray)  # no pictures among its blocks
        return state.reshape(self.num_worlds, -1)

    @exclusive
    def render(self, world: int = 0) -> np.ndarray | None:
        """(height, width, 3) uint8 picture of a world with render_mode "rgb_array"; None otherwise.

        Shows the drones that flew the last decision, so also those that it ended.
        """
        self._require_open()
        if self.options.render_mode != "rgb_array":
            return None
        self._plan.require_world(world)
        flown = self._current().alive
        self._dynamics.show(self.swarm, self.alive)
        self._engine.set_poses(
            self.swarm, flown & ~self.alive
        )  # those that just ended are still to be seen
        picture = self._camera.picture(world, self.swarm, self.scene.goal[world], flown)
        self._engine.park(flown & ~self.alive)
        return picture

    @exclusive
    def line_of_sight(
        self, start: np.ndarray, end: np.ndarray, world: np.ndarray | int = 0
    ) -> np.ndarray:
        """(M,) bool: nothing but drones is between points `start` and `end` (M, 3), m, in worlds `world`, one or (M,).

        Raises ValueError for points that are not finite, or a world that there is not.
        """
        self.require_started()
        start, end = np.broadcast_arrays(points_of("start", start), points_of("end", end))
        return line_of_sight(
            self._engine, start, end, np.broadcast_to(self._plan.worlds(world), len(start))
        )

    @property
    def sight(self) -> np.ndarray:
        """(W, N, U) bool: which of the task's targets the drones saw that flew the last decision."""
        return self._current().seen

    def solids(self, world: int = 0) -> Solids:
        """What stands in a world, beside obstacles."""
        layout = self.scene.layout[self._plan.worlds(world)]
        return NOTHING_STANDS if layout == NO_LAYOUT else self.task.layouts()[layout]

    @property
    def setpoint_level(self) -> SetpointLevel:
        """Setpoint level that the dynamics consumes."""
        return self._dynamics.consumes

    @property
    def communicates(self) -> bool:
        """Whether messages between drones are simulated, with infos that count them."""
        return self._uncertainty is not None and self._uncertainty.communicates

    def require_started(self) -> None:
        """Raise RuntimeError before the first reset and after `close`."""
        self._require_open()
        self._current()

    def _require_open(self) -> None:
        if self._engine.closed:
            raise RuntimeError("this environment is closed: make a new one")

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._engine.close()
