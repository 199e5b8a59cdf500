"""Flight of loads with the drones of a task: bodies of the dynamics that are no drones."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.control.setpoint import Setpoints
from bulletuav.dynamics.base import Dynamics
from bulletuav.dynamics.cables import FREE, group_bodies, with_entries
from bulletuav.engine.queries import LoadPoses
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.state import State
from bulletuav.tasks.parts.loads import (
    ATTACHED,
    GRAVITY,
    POSITION,
    QUATERNION,
    RATES,
    TAUT,
    TENSION,
    VELOCITY,
    Loads,
)
from bulletuav.vehicle.swarm import Swarm, get_state, set_state
from bulletuav.vehicle.wind import Wind

LIFT_MARGIN = 1.2
"""Minimum ratio of the maximum thrust of drones to the weight of drones and load"""
DroneRows = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Parameters, supply and gravity (W, N) of drones; see `Dynamics`"""


def drone_rows(dynamics: Dynamics, num_drones: int) -> DroneRows:
    """Return copies of arrays of the dynamics without loads, in C order."""
    every = (dynamics.flight.parameters, dynamics.supply, dynamics.local_gravity)
    parameters, supply, gravity = (one[:, :num_drones].copy() for one in every)
    return parameters, supply, gravity


def require_lift(loads: Loads, options: EnvOptions) -> None:
    """Raise ValueError if drones cannot lift their load with a margin for motion."""
    for m, load in enumerate(loads.loads):
        drones = [options.airframe[one.drone] for one in loads.cables if one.load == m]
        weight = options.gravity * (load.mass + sum(one.mass for one in drones))
        thrust = sum(one.max_thrust for one in drones)
        if drones and thrust < LIFT_MARGIN * weight:
            raise ValueError(
                f"load {m} has {load.mass:.3g} kg, and with its drones a weight of {weight:.3g} N: "
                f"their thrust of {thrust:.3g} N has to be {LIFT_MARGIN:g} times as much; lower "
                f"the mass of the load (load_mass), or use a stronger airframe or more drones"
            )


class LoadFlight:
    """Bodies of W worlds with N drones and L loads, as the dynamics moves them, drones first.

    The state of the drones is that of the simulation, and the state of the loads is in the memory
    of the task. Both are copied to `bodies` before a flight, and back after it.

    Attributes:
        bodies: State of drones and loads, (W, N + L, ...).
        alive: (W, N + L) bool, bodies that move: loads do while any drone of their world flies.
        fresh: (W, N + L) bool, bodies of worlds that start.
    """

    def __init__(self, loads: Loads, dynamics: Dynamics, state: State, rows: DroneRows) -> None:
        """Allocate the arrays, and add the cables to the dynamics.

        Args:
            loads: Loads and cables of the task.
            dynamics: Dynamics, in which loads follow the drones.
            state: State of the simulation.
            rows: Copies for drones only, from `drone_rows`, which are updated before each flight.
        """
        self._rows = rows
        self._loads, self._dynamics, self._state = loads, dynamics, state
        drones = state.alive.shape[1]
        shape = dynamics.flight.parameters.shape
        self.bodies = Swarm.zeros(shape[0], shape[1], state.swarm.rotor_speed.shape[2])
        self.alive, self.fresh = np.zeros((2, *shape), dtype=bool)
        self._setpoint = np.zeros((*shape, state.setpoint.shape[2]))
        self._levels = np.full(shape, int(dynamics.consumes))
        self._levels[:, :drones] = state.levels
        self._wind = np.zeros((*shape, 3))
        memory = state.scene.memory
        self._parts = tuple(memory[name] for name in (POSITION, QUATERNION, VELOCITY, RATES))
        self._before = tuple(part.copy() for part in self._parts[:2])
        dynamics.flight.engine.loads = LoadPoses(*self._parts[:2], *self._before)
        dynamics.cables = with_entries(dynamics.cables, len(loads.cables))
        self._owner = np.array([cable.drone for cable in loads.cables], dtype=int)
        self._ends = np.array([(one.drone, drones + one.load) for one in loads.cables])
        for c, cable in enumerate(loads.cables):
            dynamics.cables.point[:, c, 1] = cable.point
            dynamics.cables.length[:, c] = cable.length

    def start(self, fresh: np.ndarray) -> None:
        """Attach the cables of worlds (W,) bool that start, in which loads have not moved."""
        for before, part in zip(self._before, self._parts, strict=False):
            before[fresh] = part[fresh]
        cables = self._dynamics.cables
        cables.is_taut[fresh], cables.tension[fresh], cables.body[fresh] = False, 0.0, FREE
        self._attach(fresh)

    def _attach(self, worlds: np.ndarray | None = None) -> None:
        """Attach and detach cables as the memory of the task and the presence of drones demand.

        Args:
            worlds: (W,) bool, worlds to do this in; None for all.
        """
        cables, state = self._dynamics.cables, self._state
        wanted = (state.scene.memory[ATTACHED] > 0.0) & state.alive[:, self._owner]
        changed = wanted != (cables.body[..., 0] != FREE)
        if worlds is not None:
            changed &= worlds[:, None]
        if changed.any():
            cables.body[changed] = np.where(wanted[..., None], self._ends, FREE)[changed]
            detached = changed & ~wanted
            cables.is_taut[detached], cables.tension[detached] = False, 0.0
            group_bodies(cables, np.flatnonzero(changed.any(axis=1)).tolist())

    def join(self) -> None:
        """Copy the states of drones and loads to `bodies`."""
        drones = self._state.alive.shape[1]
        for body, drone in zip(self.bodies, self._state.swarm, strict=True):
            body[:, :drones] = drone
        for body, part in zip(self.bodies, self._parts, strict=False):
            body[:, drones:] = part

    def restore(self, mask: np.ndarray) -> None:
        """Resume drones of `mask` (W, N), and the loads of their worlds, after a snapshot."""
        self.join()
        loads = np.repeat(mask.any(axis=1, keepdims=True), len(self._loads.loads), axis=1)
        self._dynamics.restore(self.bodies, np.concatenate([mask, loads], axis=1))

    def add_to(self, program: Program, wind: Wind) -> None:
        """Add the flight of drones and loads to a program.

        Args:
            program: Program that is extended.
            wind: Computes the wind at the bodies.
        """
        state, dynamics, memory = self._state, self._dynamics, self._state.scene.memory
        drones = (state.swarm, state.setpoint, state.flown)
        program.callback(self._attach)
        program.callback(self._update_rows)
        loads = (self._parts, self._before)
        program.call(join_bodies, *drones, *loads, self.bodies, self._setpoint, self.alive)
        wind.add_to(program, self.bodies.position, state.time, self._wind)
        setpoints = Setpoints(self._levels, self._setpoint)
        dynamics.add_to(program, self.bodies, self.alive, setpoints, self._wind)
        tensions = (dynamics.cables.is_taut, dynamics.cables.tension)
        results = (memory[TAUT], memory[TENSION])
        program.call(part_bodies, self.bodies, state.swarm, self._parts, tensions, results)

    def _update_rows(self) -> None:
        """Copy parameters and gravity from the dynamics, and the supply of drones to it."""
        (parameters, supply, gravity), dynamics = self._rows, self._dynamics
        drones = supply.shape[1]
        parameters[:] = dynamics.flight.parameters[:, :drones]
        gravity[:] = dynamics.local_gravity[:, :drones]
        dynamics.supply[:, :drones] = supply
        self._state.scene.memory[GRAVITY][:] = dynamics.local_gravity[:, drones:]

    def fill_pull(self, pull: np.ndarray) -> None:
        """Write the force (W, N) of the cables on the drones, downwards, N.

        It is that of the last substep, in the direction of the cables after it.
        """
        memory = self._state.scene.memory
        along = self._loads.find_ends(memory) - self._state.swarm.position[:, self._owner]
        length = np.sqrt((along * along).sum(axis=-1))
        down = memory[TENSION] * -along[..., 2] / np.maximum(length, 1e-9)
        pull[:] = 0.0
        np.add.at(pull.T, self._owner, down.T)

    def show(self, swarm: Swarm, mask: np.ndarray) -> tuple[Swarm, np.ndarray]:
        """Return the state of drones with that of the loads, and which bodies are shown.

        Args:
            swarm: State of the drones.
            mask: (W, N) bool, drones that are shown.

        Returns:
            The state, and (W, N + L) bool, where loads are shown in worlds with such drones.
        """
        loads = len(self._loads.loads)
        resting = np.zeros((len(mask), loads, swarm.rotor_speed.shape[2]))
        pairs = zip(swarm, (*self._parts, resting, resting[..., :0]), strict=True)
        bodies = Swarm(*(np.concatenate(pair, axis=1) for pair in pairs))
        shown = np.repeat(mask.any(axis=1, keepdims=True), loads, axis=1)
        return bodies, np.concatenate([mask, shown], axis=1)


Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Position, quaternion, velocity and rates of loads, (W, L, ...)"""


@kernel
def join_bodies(
    swarm: Swarm,
    setpoint: np.ndarray,
    flown: np.ndarray,
    parts: Parts,
    before: tuple[np.ndarray, np.ndarray],
    bodies: Swarm,
    setpoints: np.ndarray,
    alive: np.ndarray,
) -> None:
    """Copy N drones and L loads of each world to the rows of its N + L bodies.

    Args:
        swarm: State of the drones.
        setpoint: (W, N, S) setpoints.
        flown: (W, N) bool.
        parts: State of the loads.
        before: Positions and quaternions of the loads before the flight, written.
        bodies: State of the bodies, written.
        setpoints: (W, N + L, S) written for drones.
        alive: (W, N + L) bool, written.
    """
    drones = flown.shape[1]
    position, quaternion, velocity, rates = parts
    for w in range(flown.shape[0]):
        any_flown = False
        for i in range(drones):
            any_flown = any_flown or flown[w, i]
            alive[w, i] = flown[w, i]
            set_state(bodies, w, i, get_state(swarm, w, i))
            for k in range(swarm.rotor_speed.shape[2]):
                bodies.rotor_speed[w, i, k] = swarm.rotor_speed[w, i, k]
            for k in range(setpoint.shape[2]):
                setpoints[w, i, k] = setpoint[w, i, k]
        for m in range(position.shape[1]):
            i = drones + m
            alive[w, i] = any_flown
            for k in range(3):
                bodies.position[w, i, k] = before[0][w, m, k] = position[w, m, k]
                bodies.velocity[w, i, k] = velocity[w, m, k]
                bodies.rates[w, i, k] = rates[w, m, k]
            for k in range(4):
                bodies.quaternion[w, i, k] = before[1][w, m, k] = quaternion[w, m, k]


@kernel
def part_bodies(
    bodies: Swarm,
    swarm: Swarm,
    parts: Parts,
    tensions: tuple[np.ndarray, np.ndarray],
    results: tuple[np.ndarray, np.ndarray],
) -> None:
    """Copy the rows of bodies back to drones and loads, and what cables pull.

    Args:
        bodies: State of the bodies.
        swarm: State of the drones, written.
        parts: State of the loads, written.
        tensions: (W, C) bool, taut cables, and (W, C) tensions, N.
        results: (W, C) the same as numbers, written.
    """
    drones = swarm.position.shape[1]
    position, quaternion, velocity, rates = parts
    for w in range(position.shape[0]):
        for i in range(drones):
            set_state(swarm, w, i, get_state(bodies, w, i))
            for k in range(swarm.rotor_speed.shape[2]):
                swarm.rotor_speed[w, i, k] = bodies.rotor_speed[w, i, k]
        for m in range(position.shape[1]):
            i = drones + m
            for k in range(3):
                position[w, m, k] = bodies.position[w, i, k]
                velocity[w, m, k] = bodies.velocity[w, i, k]
                rates[w, m, k] = bodies.rates[w, i, k]
            for k in range(4):
                quaternion[w, m, k] = bodies.quaternion[w, i, k]
        for c in range(results[0].shape[1]):
            results[0][w, c] = 1.0 if tensions[0][w, c] else 0.0
            results[1][w, c] = tensions[1][w, c]
