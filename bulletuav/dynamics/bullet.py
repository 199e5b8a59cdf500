"""Dynamics `bullet`: Bullet integrates the shared wrench.

Scheme of one substep: rotor lag; wrench at the state before the substep with the rotor speeds after
it; velocity v+ = v + dt F / m, position p+ = p + dt v+; body rates by Euler's equation (RK4,
constant torque), attitude R+ = R exp(dt w+). Bullet alone would take an explicit Euler step of the
rates, which gains energy; the torque that it is given makes its step land on the accurate rates.
The height above the surface is taken anew in every substep.

Bullet turns bodies by pi/4 a substep at most (188 rad/s at 240 Hz); faster spins lag in attitude,
not in rates. Contacts are those of all dynamics, see `bulletuav.contact`. With contacts="bullet"
they are Bullet's own, for comparison: fast drones pass through thin things there.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.contact.contacts import meet_all, place_obstacles, remember_all
from bulletuav.contact.rest import Contact, bears, wake
from bulletuav.control.cascade import Cascade, command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, Flight, surroundings
from bulletuav.engine.c_extension import Port, substep, surface_below, write_states
from bulletuav.geometry.rotation import Vec3, cross, plus, quat4, vec3
from bulletuav.kernel import allocating, borrowed, func, kernel
from bulletuav.program import Program
from bulletuav.registry import register
from bulletuav.vehicle.aerodynamics import wakes
from bulletuav.vehicle.airframe import MAX_ROTORS
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.swarm import Contacts, Swarm
from bulletuav.vehicle.wrench import SMALL_TURN, body_acceleration, spin_parts, wrench


@func
def _slopes(rates: Vec3, torque: Vec3, dt: float, row: np.record) -> Vec3:
    """Return six times the weighted mean of the four slopes of the rates (RK4), rad/s^2."""
    k1 = body_acceleration(rates, torque, row)
    k2 = body_acceleration(plus(rates, 0.5 * dt, k1), torque, row)
    k3 = body_acceleration(plus(rates, 0.5 * dt, k2), torque, row)
    k4 = body_acceleration(plus(rates, dt, k3), torque, row)
    return (
        k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0],
        k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1],
        k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2],
    )


@func
def engine_torque(
    rates: Vec3,
    torque: Vec3,
    dt: float,
    row: np.record,
) -> Vec3:
    """Return the torque M' with which Bullet's step of the rates lands on the RK4 solution for M.

    Bullet's step is explicit: w + dt J^-1 (M' - w x J w).

    Args:
        rates: Body rates w before the substep, rad/s.
        torque: M in body axes, N m.
        dt: Duration of the substep, s.
        row: Row of `PARAMETERS` of the drone.

    Returns:
        M' in body axes, N m.
    """
    parts = spin_parts(rates, dt, SMALL_TURN)
    step = dt / parts
    slope = _slopes(rates, torque, step, row)
    total = slope
    now = rates
    for _ in range(parts - 1):
        now = plus(now, step / 6.0, slope)
        slope = _slopes(now, torque, step, row)
        total = plus(total, 1.0, slope)
    total = (total[0] / parts, total[1] / parts, total[2] / parts)

    # What Bullet takes off again: w x J w
    inertia = row.inertia
    momentum = (
        inertia[0] * rates[0],
        inertia[1] * rates[1],
        inertia[2] * rates[2],
    )
    gyroscopic = cross(rates, momentum)
    return (
        gyroscopic[0] + inertia[0] * total[0] / 6.0,
        gyroscopic[1] + inertia[1] * total[1] / 6.0,
        gyroscopic[2] + inertia[2] * total[2] / 6.0,
    )


@kernel
def drive(
    swarm: Swarm,
    alive: np.ndarray,
    levels: np.ndarray,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    dt: float,
    force: np.ndarray,
    torque: np.ndarray,
    room: np.ndarray,
) -> None:
    """Run controllers and rotors of one substep, and fill in the wrenches for the engine.

    Args:
        swarm: State before the substep; its rotor speeds are advanced.
        alive: (W, N) bool, drones that fly.
        levels: (W, N) `SetpointLevel` of each drone's setpoint.
        setpoint: (W, N, S) setpoints.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones.
        dt: Duration of the substep, s.
        force: (W, N, 3) forces to be written, world axes, N.
        torque: (W, N, 3) torques to be written, body axes, N m.
        room: (3, most of N and `MAX_ROTORS`) room for commands, rotor speeds and wakes.
    """
    swarm, cascade, air, room = borrowed((swarm, cascade, air, room))
    command, speed, wake = room[0], room[1], room[2, : alive.shape[1]]
    for w in range(alive.shape[0]):
        # Downwash of all on all
        wakes(w, swarm.position, alive, parameters, air.gravity, wake)
        for i in range(alive.shape[1]):
            if alive[w, i]:
                # Controllers, then the lag of the rotors
                row = parameters[w, i]
                decay = lag_decay(dt, row)
                command_rotors(levels, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                for rotor in range(row.num_rotors):
                    now = swarm.rotor_speed[w, i, rotor]
                    after = lagged(now, command[rotor], decay)
                    swarm.rotor_speed[w, i, rotor] = after
                    speed[rotor] = after

                # Wrench at the state before the substep with the rotor speeds after it
                around = surroundings(air, w, i)
                quaternion = quat4(swarm.quaternion, w, i)
                velocity = vec3(swarm.velocity, w, i)
                altitude = swarm.position[w, i, 2]
                rotors = rotor_wrench(speed, row)
                push, turn = wrench(quaternion, velocity, altitude, rotors, around, wake[i], row)
                turn = engine_torque(vec3(swarm.rates, w, i), turn, dt, row)
                for k in range(3):
                    force[w, i, k] = push[k]
                    torque[w, i, k] = turn[k]


@kernel
def choose_flying(
    alive: np.ndarray,
    parameters: np.ndarray,
    force: np.ndarray,
    torque: np.ndarray,
    swarm: Swarm,
    dt: float,
    contact: Contact,
    flying: np.ndarray,
) -> None:
    """Choose the drones that the engine moves: who rests is left alone while it bears its forces.

    Args:
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.
        force: (W, N, 3) their forces, N.
        torque: (W, N, 3) their torques, N m.
        swarm: State of all drones.
        dt: Length of the substep, s.
        contact: What contacts need; sleepers whose forces changed wake.
        flying: (W, N) bool, written.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            flying[w, i] = alive[w, i] and not contact.stopped[w, i]
            if flying[w, i] and contact.asleep[w, i]:
                row = parameters[w, i]
                turn = vec3(torque, w, i)
                inertia = row.inertia
                accelerates = plus((0.0, 0.0, 0.0), 1.0 / row.mass, vec3(force, w, i))
                spins = (turn[0] / inertia[0], turn[1] / inertia[1], turn[2] / inertia[2])
                turned = quat4(swarm.quaternion, w, i)
                if not bears(contact, w, i, turned, accelerates, spins, row, dt):
                    wake(contact, w, i)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            flying[w, i] = flying[w, i] and not contact.asleep[w, i]


@allocating
def advance(
    port: Port,
    substeps: int,
    near_ground: bool,
    swarm: Swarm,
    alive: np.ndarray,
    levels: np.ndarray,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    dt: float,
    force: np.ndarray,
    torque: np.ndarray,
    room: np.ndarray,
    contact: Contact,
    driven: np.ndarray,
    flying: np.ndarray,
) -> None:
    """Fly all substeps of one decision in one call, through the C extension.

    Args:
        port: Session of the extension, and the arrays of the worlds.
        substeps: Number of substeps.
        near_ground: Whether the ground effect wants the surface below.
        swarm: State of all drones, moved in place.
        alive: (W, N) bool, drones that fly.
        levels: (W, N) `SetpointLevel` of each drone's setpoint.
        setpoint: (W, N, S) setpoints.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones; its surface is written.
        dt: Duration of a substep, s.
        force: (W, N, 3) room for forces, N.
        torque: (W, N, 3) room for torques, N m.
        room: Room for `drive`.
        contact: What contacts need.
        driven: (W, N) bool, room for those whose rotors turn.
        flying: (W, N) bool, room for those whom the engine moves.
    """
    port, swarm, cascade, air, contact = borrowed((port, swarm, cascade, air, contact))
    driven[:] = alive
    for piece in range(substeps):
        remember_all(contact, swarm)
        # Wrenches from the state before the substep, then the engine's step
        if near_ground:
            place_obstacles(contact, piece / substeps, substeps * dt)
            surface_below(port, swarm.position, driven, air.surface)
        drive(swarm, driven, levels, setpoint, cascade, parameters, air, dt, force, torque, room)
        choose_flying(alive, parameters, force, torque, swarm, dt, contact, flying)
        substep(port, force, torque, flying, swarm)
        # What they would have flown into; the engine goes on from there
        if meet_all(contact, swarm, alive, parameters, piece, substeps, dt):
            write_states(port, swarm, contact.changed)
            driven[:] = alive & ~contact.stopped


@register("dynamics")
class BulletDynamics(Dynamics):
    """The full engine: every substep goes through Bullet."""

    name = "bullet"
    consumes = SetpointLevel.ROTOR
    feels_surface = True
    feels_force = True
    feels_torque = True
    contacts = ("impulse", "stop", "bullet")
    sleeps = True

    def __init__(self, flight: Flight) -> None:
        """Make room for the wrenches."""
        super().__init__(flight)
        self._force, self._torque = np.zeros((2, *flight.parameters.shape, 3))
        self._driven, self._flying = np.zeros((2, *flight.parameters.shape), dtype=bool)
        self._room = np.zeros((3, max(MAX_ROTORS, flight.parameters.shape[1])))
        self._in_engine = Contacts.none()

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Start drones from their state, in the engine too; see the base class."""
        self.flight.engine.set_states(swarm, mask)
        super().place(swarm, mask)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Leave the engine's bodies, which are where the swarm is."""

    def add_flight(
        self,
        program: Program,
        swarm: Swarm,
        alive: np.ndarray,
        levels: np.ndarray,
        setpoint: np.ndarray,
        air: Air,
    ) -> None:
        """Add all substeps, as one compiled call where the C extension is; see the base class."""
        flight, port = self.flight, self.flight.engine.port
        # C reads arrays as they lie
        assert all(array.flags.c_contiguous for array in (*swarm, alive))
        inputs = self._inputs(swarm, alive, levels, setpoint, air)
        if flight.contacts == "bullet":
            program.turn(lambda: self._fly_in_engine(inputs))
        elif port is None:
            program.turn(lambda: self._fly_by_calls(inputs))
        else:
            room = (self._driven, self._flying)
            more = (port, flight.substeps, self._near_ground)
            program.call(advance, *more, *inputs, self.contact, *room)

    def touched(self) -> Contacts:
        """Tell what was touched in the last decision; see the base class."""
        return self._in_engine if self.flight.contacts == "bullet" else super().touched()

    def _add_surface(
        self, program: Program, swarm: Swarm, alive: np.ndarray, surface: np.ndarray
    ) -> None:
        """Leave the surface, which is looked for anew in every substep."""

    def _fly_by_calls(self, inputs: "_Inputs") -> None:
        """Fly all substeps through the engine's own calls."""
        flight, contact, swarm, alive = self.flight, self.contact, inputs.swarm, inputs.alive
        driven = alive
        for piece in range(flight.substeps):
            remember_all(contact, swarm)
            place_obstacles(contact, piece / flight.substeps, flight.substeps * flight.dt)
            self._advance_once(inputs._replace(alive=driven))
            parameters = flight.parameters
            if meet_all(contact, swarm, alive, parameters, piece, flight.substeps, flight.dt):
                flight.engine.write_states(swarm, contact.changed)
                driven = alive & ~contact.stopped

    def _inputs(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        levels: np.ndarray,
        setpoint: np.ndarray,
        air: Air,
    ) -> "_Inputs":
        """Collect what `drive` takes."""
        flight = self.flight
        return _Inputs(
            swarm=swarm,
            alive=alive,
            levels=levels,
            setpoint=setpoint,
            cascade=flight.cascade,
            parameters=flight.parameters,
            air=air,
            dt=flight.dt,
            force=self._force,
            torque=self._torque,
            room=self._room,
        )

    def _advance_once(self, inputs: "_Inputs") -> None:
        """Fly one substep through the engine's own calls."""
        engine = self.flight.engine
        if self._near_ground:
            inputs.air.surface[:] = engine.surface_below(inputs.swarm.position, inputs.alive)
        drive(*inputs)
        force, torque, flying = inputs.force, inputs.torque, self._flying
        choose_flying(
            inputs.alive,
            inputs.parameters,
            force,
            torque,
            inputs.swarm,
            inputs.dt,
            self.contact,
            flying,
        )
        engine.apply_wrenches(force, torque, flying)
        engine.step()
        engine.read_states(inputs.swarm, flying)

    def _fly_in_engine(self, inputs: "_Inputs") -> None:
        """Fly with Bullet's own contacts, substep by substep."""
        flight, engine = self.flight, self.flight.engine
        before, after = self.contact.before, self.contact.after
        turns = engine.scenery.quaternion[:, : before.shape[1]]
        moving, flying = bool((before != after).any()), np.any(inputs.alive, axis=1)
        touched = []
        for piece in range(flight.substeps):
            if moving:
                share = (piece + 1) / flight.substeps
                engine.set_obstacles(before + share * (after - before), turns, flying)
            self._advance_once(inputs)
            touched.append(engine.contacts(inputs.swarm, flight.dt))
        columns = [np.concatenate(column) for column in zip(*touched, strict=True)]
        self._in_engine = Contacts.merged(**dict(zip(Contacts._fields, columns, strict=True)))


class _Inputs(NamedTuple):
    """Arguments of `drive`, in their order."""

    swarm: Swarm
    alive: np.ndarray
    levels: np.ndarray
    setpoint: np.ndarray
    cascade: Cascade
    parameters: np.ndarray
    air: Air
    dt: float
    force: np.ndarray
    torque: np.ndarray
    room: np.ndarray
