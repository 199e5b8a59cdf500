"""The batched core: W independent worlds of N drones through one decision at a time."""

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.environment import exclusive
from bulletuav.envs.step import Step
from bulletuav.envs.worlds import UNSTARTED, Worlds
from bulletuav.sensors.base import Moment
from bulletuav.tasks.base import Task
from bulletuav.tasks.check import check_info, check_step_result, require_finite, take_spawns
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm, confine


class Aviary(Worlds):
    """W worlds of N drones flying one task.

    Never resets by itself: a drone whose episode ended leaves the airspace and is masked by `alive`
    until its world is reset. World k's random numbers come from seed + k alone, and nothing that
    other worlds do changes world k.

    Attributes:
        options: Common options.
        task: The task.
        action: What actions mean.
        observer: Makes observations; tells labels, and splits by name.
        swarm: State of the drones, (W, N, ...).
        scene: Goals, obstacles and the task's memory.
        alive: (W, N) bool, drones whose episode goes on.
        steps: (W,) decisions since the reset.
        commanded: (W, N, 3) velocities commanded last, m/s.
        parameters: (W, N) rows of `PARAMETERS` with which the drones fly.
        rng: Random generator of each world.
    """

    @exclusive
    def reset(
        self, mask: np.ndarray | None = None, seeds: int | Sequence[int] | None = None
    ) -> Observation:
        """Start new episodes.

        Args:
            mask: (W,) bool, worlds to reset; all when left out.
            seeds: An int s gives world k the seed s + k; a sequence gives each of the W worlds its
                own; None goes on with each world's random numbers, which begin from the option
                `seed`, or from entropy.

        Returns:
            Observations of all worlds, (W, N, D) float32 or a dict.

        Raises:
            ValueError: The task's start cannot be; the worlds stay as they were.
            RuntimeError: The environment is closed.
        """
        self._require_open()
        worlds = np.flatnonzero(self._spec.mask(mask))
        generators = self._generators(worlds, self._spec.seeds(seeds))
        spawns = list(self.task.spawn_many(generators))
        if len(spawns) != len(generators):
            raise ValueError(
                f"spawn_many of task {self.task.name!r} gave {len(spawns)} starts: "
                f"{len(generators)} "
                f"are needed, one for each generator"
            )
        # All before anything of the worlds is written
        things = self.scene.obstacle.shape[1]
        starts = take_spawns(self.task, spawns, self.options.airframe, things, self.scene.memory)
        self._place(worlds, starts)
        for k, rng in zip(worlds.tolist(), generators, strict=True):
            self.rng[k] = rng
            self._wind.reset(k, rng)
            self._uncertainty.reset(k, rng)
            self._sensors.reset(k, self.swarm, rng)
        chosen = np.zeros(self.alive.shape, dtype=bool)
        chosen[worlds] = True
        self._dynamics.place(self.swarm, chosen)
        reset = np.any(chosen, axis=1)
        self._engine.set_layouts(self.scene.layout, reset)
        self._engine.set_obstacles(self.scene.obstacle, self.scene.obstacle_quaternion, reset)
        frame = self._first_frame(chosen)
        self._start_memory(frame, chosen)
        if not self._checked:  # once: later results are of the same form
            check_step_result(self.task, self.task.evaluate_step(frame), chosen.shape)
            check_info(self.task, self.task.info(frame), chosen.shape)
            self._checked = True
        self._frame = frame
        return self.observer.observe(self._frame, self.alive)

    def _generators(self, worlds: np.ndarray, seeds: list[int] | None) -> list[np.random.Generator]:
        if seeds is not None:
            return [np.random.default_rng(seeds[k]) for k in worlds]
        first = None if self.options.seed is None else self.options.seed + self._first_world
        return [
            np.random.default_rng(None if first is None else first + int(k))
            if self.rng[k] is UNSTARTED
            else self.rng[k]
            for k in worlds
        ]

    def _place(self, worlds: np.ndarray, start: Mapping[str, np.ndarray]) -> None:
        """Write the starts (S, ...) of some worlds (S,)."""
        swarm, scene = self.swarm, self.scene
        swarm.position[worlds], swarm.quaternion[worlds] = start["position"], start["quaternion"]
        swarm.velocity[worlds], swarm.rates[worlds] = start["velocity"], start["rates"]
        swarm.rotor_speed[worlds] = self._hover_speed
        scene.start[worlds], scene.goal[worlds] = start["position"], start["goal"]
        scene.goal_velocity[worlds] = start["goal_velocity"]
        scene.obstacle[worlds] = start["obstacle"]
        scene.obstacle_velocity[worlds] = start["obstacle_velocity"]
        scene.layout[worlds] = start["layout"]
        for name, remembered in scene.memory.items():
            remembered[worlds] = start[f"memory {name}"]
        self._cascade.memory[worlds] = 0
        self.commanded[worlds] = start["velocity"]
        self.alive[worlds] = True
        self.steps[worlds] = 0
        self._energy.start(worlds)

    def _first_frame(self, chosen: np.ndarray) -> Frame:
        """Make the frame right after a reset of the drones of `chosen` (W, N)."""
        now = self.swarm.copy()
        readings = self._measure(now, now, chosen)
        action = np.zeros((*self.alive.shape, self.action.low.shape[-1]))
        flown, contacts, goal = chosen, Contacts.none(), self.scene.goal.copy()
        if self._frame is not None:  # of the worlds that fly on
            action = np.where(chosen[..., None], action, self._frame.action)
            flown = chosen | self._frame.alive
            contacts = self._frame.contacts.of_worlds(~np.any(chosen, axis=1))
        return self._make_frame(now, now, action, contacts, flown, goal, readings)

    def _start_memory(self, frame: Frame, chosen: np.ndarray) -> None:
        """Let the task fill the memory of the worlds that were reset; others keep theirs."""
        if type(self.task).start_memory is Task.start_memory:
            return
        memory = self.scene.memory
        kept = {name: array.copy() for name, array in memory.items()}
        self.task.start_memory(frame)
        others = ~np.any(chosen, axis=1)
        for name, array in kept.items():
            memory[name][others] = array[others]

    def _measure(self, before: Swarm, after: Swarm, mask: np.ndarray) -> dict[str, np.ndarray]:
        """Measure with all sensors, from the drones of `mask` (W, N)."""
        readings = {"sight": self._nothing_seen, **self._energy.readings()}
        if not self._sensors.sensors:
            return readings
        targets = self.task.targets(self.scene)
        moment = Moment(before, after, targets, mask, self.steps, self.rng, {})
        return {**readings, **self._sensors.measure(moment, self._dynamics.show)}

    def _make_frame(
        self,
        before: Swarm,
        after: Swarm,
        action: np.ndarray,
        contacts: Contacts,
        flown: np.ndarray,
        goal_before: np.ndarray,
        readings: dict[str, np.ndarray],
    ) -> Frame:
        return Frame(
            before=before,
            after=after,
            action=action,
            scene=self.scene,
            contacts=contacts,
            alive=flown,
            time=self.steps / self.options.decision_hz,
            last=self.steps >= self.options.horizon,
            d_safe=self.task.config.d_safe,
            zone=self.task.zone,
            goal_before=goal_before,
            readings=readings,
        )

    @exclusive
    def step(self, actions: np.ndarray) -> Step:
        """Fly one decision.

        Args:
            actions: (W, N, A); those beyond the bounds are clipped to them.

        Raises:
            ValueError: A wrong shape, or a number that is not finite in a living drone's action.
                The worlds stay as they were.
            RuntimeError: Before the first reset or after `close`.
        """
        self.require_started()
        frame = self._fly(self._spec.actions(actions, self.alive), self.alive.copy())
        self.task.update_memory(frame, self.rng)
        flown, result = frame.alive, self.task.evaluate_step(frame)
        terminated = (result.terminated | frame.depleted) & flown
        present = flown & ~terminated  # the horizon takes nobody away
        truncated = frame.last[:, None] & present
        self._frame = frame
        self.alive = present & ~truncated
        observations = self.observer.observe(frame, present)
        terms = {**result.terms, **self.task.extra_terms(frame)}
        weighted = {name: self.task.weights[name] * term for name, term in terms.items()}
        if not flown.all():
            weighted = {name: np.where(flown, term, 0.0) for name, term in weighted.items()}
        self._engine.park(flown & ~self.alive)
        if self.options.render_mode == "human":
            self._dynamics.show(self.swarm, self.alive)
            self._renderer.show(self.swarm, self.alive, 1 / self.options.decision_hz)
        reward = functools.reduce(np.add, weighted.values(), np.zeros(flown.shape))
        require_finite(self.task, weighted, reward)
        info = self._info(frame, weighted, result.success)
        return Step(observations, reward, terminated, truncated, info)

    def _fly(self, action: np.ndarray, flown: np.ndarray) -> Frame:
        """Fly one decision of the drones of `flown` (W, N)."""
        flying, time = np.any(flown, axis=1), self.steps / self.options.decision_hz
        wind = self._wind.sample(self.swarm, time, self.rng, flying)
        before, goal_before = self.swarm.copy(), self.scene.goal.copy()
        motion = self._move_scene(flying)
        setpoint = self.action.decode(action, self.commanded)
        if self.action.level == SetpointLevel.VELOCITY:
            self.commanded = setpoint[..., :3]
        self._uncertainty.drain(time)
        level = self.action.level
        contacts = self._dynamics.fly(self.swarm, flown, level, setpoint, wind, motion)
        if motion.moving:
            turns = self.scene.obstacle_quaternion
            self._engine.set_obstacles(self.scene.obstacle, turns, flying)
        if self.task.rebound is not None:
            contacts = self._confine(contacts, flown, self.task.rebound)
        self.steps += flying
        after = self.swarm.copy()
        payload = self.task.payload_power(self.scene)
        self._energy.spend(before, after, wind, payload, flown)
        readings = self._measure(before, after, flown)
        return self._make_frame(before, after, action, contacts, flown, goal_before, readings)

    def _confine(self, contacts: Contacts, flown: np.ndarray, rebound: float) -> Contacts:
        """Put drones back that left the arena; tells contacts with what they meet there, too."""
        low, high = self.task.arena_low, self.task.arena_high
        moved = confine(self.swarm, self.commanded, flown, low, high, rebound)
        if not moved.any():
            return contacts
        self._dynamics.place(self.swarm, moved)
        return contacts.joined(self._dynamics.overlaps(self.swarm, moved, flown))

    def _move_scene(self, flying: np.ndarray) -> Motion:
        """Let the task move goals and obstacles; tells where obstacles go meanwhile."""
        before = self.scene.obstacle.copy()
        time = self.steps / self.options.decision_hz
        moved = self.task.move_scene(self.scene, time, flying, self.rng)
        after = self.scene.obstacle.copy() if moved else before
        return Motion(before, after, self.scene.obstacle_quaternion)

    def _info(
        self, frame: Frame, weighted: dict[str, np.ndarray], success: np.ndarray
    ) -> dict[str, np.ndarray]:
        info = {f"reward/{name}": term for name, term in weighted.items()}
        info["success"] = success & frame.alive
        info |= {name: getattr(frame, name) for name in ("collision", "resting", "impulse")}
        info["conflicts"] = frame.conflict.onsets
        info["separation"] = frame.conflict.separation
        info["goal_distance"] = frame.distance
        info |= {name: frame.readings[name] for name in ("power", "charge")}
        info |= {**self.task.info(frame), **self._uncertainty.info(), **self._sensors.info()}
        return {name: np.array(value) for name, value in info.items()}  # for callers to write into

    @exclusive
    def first_info(self) -> dict[str, np.ndarray]:
        """Tell the infos right after a reset: the keys of every step's info, terms at zero."""
        frame = self._current()
        result = self.task.evaluate_step(frame)
        names = [*result.terms, *self.task.extra_terms(frame)]
        nothing = dict.fromkeys(names, np.zeros(self.alive.shape))
        return self._info(frame, nothing, result.success)
