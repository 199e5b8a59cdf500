"""Components and state of W worlds of N drones that fly a task; stages operate on it."""

import numpy as np

from bulletuav.control.actions import Action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.cables import cable_bounds
from bulletuav.envs.action_masks import ActionMasks, response_of
from bulletuav.envs.conditions import Schedule
from bulletuav.envs.contact_record import ContactRecord
from bulletuav.envs.cruise import directions_to_goals
from bulletuav.envs.energy import Energy
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.loads import LoadFlight, drone_rows
from bulletuav.envs.parts import BODY_BOUNDS, CONDITION_BOUNDS, Parts, num_surfaces
from bulletuav.envs.results import Results
from bulletuav.envs.snapshot import UNSTARTED, Bounds, contact_bounds, state_bounds
from bulletuav.envs.state import LAST, STATE, Sizes, State, with_prefix
from bulletuav.envs.world_bodies import WorldBodies
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.sensors.base import Moment
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.frame_measures import FrameMeasures, make_frame_measures
from bulletuav.tasks.ingredients import PRESENT
from bulletuav.tasks.observations.images import frames_name, push_frames
from bulletuav.tasks.stages import StepEvaluation
from bulletuav.vehicle.swarm import Swarm


class Worlds(Parts):
    """Components and state of W worlds of N drones that fly a task.

    Attributes:
        spec: Validates arguments of callers.
        task: The task.
        action: Definition of actions.
        observer: Computes observations.
        energy: Batteries and power consumption.
        schedule: Events of the episodes.
        state: All arrays.
        frame: View of the state for tasks, sensors and observations.
        account: Separations, distances and collisions of the decision, which are also in the frame.
        contacts: Contacts of the decision.
        readings: Last sensor readings, by name, which are also in the frame.
        results: Reward terms and infos; created at the first reset.
        vector: (W, N, D) observations of the last decision.
        rng: Random generator of each world.
        bodies: Bodies of the option `bodies`.
        loads: Flight of the task's loads; None without loads.
        members: (W, N) bool, drones of the episode; False for absent ones.
        masks: Computes the masks of discrete actions; None without the option.
        any_left: Whether the episode of any drone ended in the last decision.
    """

    account: FrameMeasures
    results: Results

    def __init__(self, spec: EnvSpec, first_world: int) -> None:
        """Create all components.

        Args:
            spec: Validated options and the task.
            first_world: Index of the first of these worlds among those of several processes.
        """
        options, task, obstacles = spec.options, spec.task, spec.task.obstacles()
        sensors = (spec.sensors, spec.setup)
        loads = () if task.loads is None else task.loads.loads
        super().__init__(options, obstacles, task.layouts(), *sensors, first_world, loads)
        options.check_setpoint_levels(spec.action.kind_levels, self.dynamics.consumes)
        self.spec, self.task, self.action = spec, task, spec.action
        self.observer, self.num_worlds = spec.observer, spec.num_worlds
        given = (self.parameters, self.dynamics.supply, self.dynamics.local_gravity)
        if task.loads is not None:
            # Its kernels need arrays of drones only
            given = drone_rows(self.dynamics, options.num_drones)
        has_rotors = self.dynamics.consumes == SetpointLevel.ROTOR
        self.energy = Energy(options, *given, has_rotors)
        self.schedule = Schedule(self, self.energy)
        self.contacts = ContactRecord(self.dynamics, options.num_drones)
        self.rng: list[np.random.Generator] = [UNSTARTED] * self.num_worlds
        self.bodies = WorldBodies(options.bodies, self.engine)
        self.dynamics.look_around()
        self._make_state(len(obstacles))
        self.loads = (
            None if task.loads is None else LoadFlight(task.loads, self.dynamics, self.state, given)
        )
        self.members = np.ones((self.num_worlds, options.num_drones), dtype=bool)
        self.any_left = False
        self.masks = self.make_masks(self.action) if options.action_masks else None

    def _make_state(self, num_obstacles: int) -> None:
        """Allocate all arrays, and create the frame."""
        task, action, shape = self.task, self.action, (self.num_worlds, self.options.num_drones)
        size = action.low.shape[-1]
        setpoint = action.decode(np.zeros((*shape, size)), np.zeros((*shape, 3)))
        rotors = self.hover_speed.shape[1]
        surfaces = num_surfaces(self.options)
        sizes = Sizes(*shape, size, setpoint.shape[-1], num_obstacles, rotors, surfaces)
        self.state = state = State.make(sizes, task.memory())
        state.setpoint[:] = setpoint
        state.levels[:] = action.levels
        self.nothing_seen = np.zeros((*shape, task.num_targets), dtype=bool)
        self.readings = {"sight": self.nothing_seen, **self.energy.readings()}
        self.frame = Frame(
            before=state.before,
            after=state.swarm,
            action=state.action,
            scene=state.scene,
            read_contacts=self.contacts.collect,
            alive=state.flown,
            time=state.time,
            last=state.last,
            d_safe=float(task.config.d_safe),
            zone=float(task.zone),
            goal_before=state.goal_before,
            readings=self.readings,
        )
        self.vector = self.observer.make_vector(shape)

    def make_masks(self, action: Action) -> ActionMasks:
        """Return what computes the masks of a discrete action in these worlds."""
        options = self.options
        radius = np.array([airframe.collision_radius for airframe in options.airframe])
        drive = (self.dynamics.consumes, options.dynamics_name, options.gravity)
        response = response_of(self.cascade.gains[0, : options.num_drones], *drive)
        every = 1 if self.spec.decision_every is None else self.spec.decision_every
        period = np.broadcast_to(every / options.decision_hz, radius.shape)
        return ActionMasks(action, self.task, radius, response, period)

    def action_masks(self) -> np.ndarray:
        """Compute the masks of discrete actions, (W, N, C) int8; needs the option."""
        assert self.masks is not None, "checked by Aviary"
        return self.compute_masks(self.masks)

    def compute_masks(self, masks: ActionMasks) -> np.ndarray:
        """Compute the masks of a discrete action for the present state, (W, N, C) int8."""
        state = self.state
        present = state.alive | state.truncated
        return masks.compute(state.swarm.position, state.swarm.velocity, present)

    def decides(self) -> np.ndarray:
        """Return the active drones whose next action is flown, (W, N) bool."""
        every, alive = self.spec.decision_every, self.state.alive
        return alive.copy() if every is None else alive & (self.state.steps[:, None] % every == 0)

    @property
    def collects_contacts(self) -> bool:
        """Whether Python adds contacts that compiled code does not know."""
        return self.task.rebound is not None or self.options.contacts == "bullet"

    @property
    def judgement(self) -> StepEvaluation:
        """Arrays for the task's evaluation of the decision."""
        return StepEvaluation(self.state.ended, self.state.success, self.results.named_terms)

    def make_frame_measures(self) -> None:
        """Allocate the arrays of the account, which are also in the frame."""
        self.account = make_frame_measures(self.frame)

    def forget_derived(self) -> None:
        """Clear the values that the task derived from the previous frame."""
        self.frame.derived.clear()
        self.frame.derived[PRESENT] = self.state.present

    def place_obstacles(self, worlds: np.ndarray) -> None:
        """Copy the poses of obstacles of `worlds` (W,) bool from the scene to the engine."""
        scene = self.state.scene
        obstacles = (scene.obstacle, scene.obstacle_quaternion, worlds)
        if self.engine.asks_bodies:
            self.engine.set_obstacles(*obstacles)
        else:
            self.engine.note_obstacles(*obstacles)

    def start_cruise(self, due: np.ndarray) -> None:
        """Write the cruise of the drones of `due` (W, N) bool that cannot hover, in the wind."""
        cruise, state, swarm = self.cruise, self.state, self.state.swarm
        if not due[:, cruise.drones].any():
            return
        wind = self.carrying_wind(swarm.position, state.steps / self.options.decision_hz)
        has_goals = self.task.has_goals
        to_goal = directions_to_goals(swarm.position, state.scene.goal, has_goals)
        for w in np.flatnonzero(due.any(axis=1)).tolist():
            motion = (swarm.velocity[w], swarm.quaternion[w], swarm.rates[w])
            cruise.write(motion, cruise.drones[due[w, cruise.drones]], to_goal[w], wind[w])

    def restore_flight(self, mask: np.ndarray) -> None:
        """Resume drones of `mask` (W, N), with their loads, after a snapshot was written."""
        if self.loads is None:
            self.dynamics.restore(self.state.swarm, mask)
        else:
            self.loads.restore(mask)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Update the poses of drones of `mask` (W, N), loads and obstacles in the engine."""
        super().show(*self.shown(swarm, mask))

    def shown(self, swarm: Swarm, mask: np.ndarray) -> tuple[Swarm, np.ndarray]:
        """Return the state and the mask (W, N) of drones with those of the loads, for pictures."""
        return (swarm, mask) if self.loads is None else self.loads.show(swarm, mask)

    def measure(self, before: Swarm, after: Swarm, mask: np.ndarray) -> None:
        """Measure with all sensors from the drones of `mask` (W, N), and store the readings."""
        if not self.sensors.sensors:
            return
        targets = self.task.targets(self.state.scene)
        gravity = self.dynamics.local_gravity[:, : mask.shape[1]]
        given = (self.state.action, gravity, self.measured_wind(after, self.state.steps))
        moment = Moment(before, after, targets, mask, self.state.steps, self.rng, {}, *given)
        for name, value in self.sensors.measure(moment, self.show).items():
            held = self.readings.get(name)
            if held is None or held is self.nothing_seen:
                self.readings[name] = np.array(value)
            else:
                held[...] = value
        if self.observer.num_frames > 1:
            self._push_frames(mask)

    def _push_frames(self, mask: np.ndarray) -> None:
        """Append new pictures of the drones of `mask` (W, N) to their last frames."""
        for name in self.observer.images:
            picture, key = self.readings[name], frames_name(name)
            if key not in self.readings:
                shape = (*mask.shape, self.observer.num_frames, *picture.shape[2:])
                self.readings[key] = np.zeros(shape, picture.dtype)
            push_frames(self.readings[key], picture, mask, self.state.steps)

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the state; see `Parts.state_arrays`."""
        scene = self.state.scene._asdict()
        memory = with_prefix("memory", scene.pop("memory"))
        return {
            **self.state.swarm._asdict(),
            **scene,
            **memory,
            **with_prefix("drawn", self.uncertainty.drawn),
            **self.state.kept(STATE),
            "parameters": self.parameters,
            "controller": self.cascade.memory,
            "charge": self.energy.readings()["charge"],
            # Bodies of `add_body` never move
            **(self.body_arrays() if self.bodies.count else {}),
            **({"members": self.members} if self.options.has_absent else {}),
            **self.schedule.arrays(),
            **self.dynamics.cables.kept(),
        }

    def last_arrays(self) -> dict[str, np.ndarray]:
        """Return the other arrays that the future depends on; see `Parts.last_arrays`."""
        parts = (self.wind, self.energy, self.sensors, self.dynamics)
        return {
            **{name: array for part in parts for name, array in part.kept().items()},
            **with_prefix("before", self.state.before._asdict()),
            **with_prefix("reading", self.readings),
            **self.state.kept(LAST),
            **self.condition_arrays(),
        }

    def bounds(self) -> Bounds:
        """Return the bounds of the arrays that a snapshot may write, by name."""
        return {
            **state_bounds(self.state.swarm),
            **self.state.bounds(),
            "layout": (NO_LAYOUT, len(self.task.layouts()) - 1),
            **{f"memory {name}": one for name, one in self.task.memory_bounds().items()},
            **self.sensors.kept_bounds(),
            **CONDITION_BOUNDS,
            **self.schedule.bounds(),
            **contact_bounds(self.engine.scenery),
            **BODY_BOUNDS,
            **cable_bounds(len(self.dynamics.flight.parameters[0])),
        }
