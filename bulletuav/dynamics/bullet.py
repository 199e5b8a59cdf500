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

from bulletuav.compiled.kernel import allocating, borrowed, in_memory, kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.contacts import meet_all, place_obstacles, remember_all
from bulletuav.contact.rest import Contact, bears, wake
from bulletuav.control.cascade import Cascade
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, Flight
from bulletuav.dynamics.drive import drive
from bulletuav.engine.c_extension import Port, substep, surface_below, write_states
from bulletuav.geometry.rotation import plus, quat4, vec3
from bulletuav.registry import register
from bulletuav.vehicle.airframe import MAX_ROTORS
from bulletuav.vehicle.swarm import Contacts, Swarm
from bulletuav.vehicle.wakes import Wakes


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
            # Whom a contact stopped stays for the rest of the decision
            flying[w, i] = alive[w, i] and not contact.stopped[w, i]
            if flying[w, i] and contact.asleep[w, i]:
                # What would move a sleeper: forces over mass, torques over inertia
                row = parameters[w, i]
                turn = vec3(torque, w, i)
                inertia = row.inertia
                accelerates = plus((0.0, 0.0, 0.0), 1.0 / row.mass, vec3(force, w, i))
                spins = (turn[0] / inertia[0], turn[1] / inertia[1], turn[2] / inertia[2])
                turned = quat4(swarm.quaternion, w, i)
                if not bears(contact, w, i, turned, accelerates, spins, row, dt):
                    wake(contact, w, i)
    # The rest of the pile may have woken with one of its drones
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            flying[w, i] = flying[w, i] and not contact.asleep[w, i]


@kernel
def _choose_driven(alive: np.ndarray, contact: Contact, driven: np.ndarray) -> None:
    """Write whose rotors turn (W, N): all in flight but whom a contact stopped in the decision."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            driven[w, i] = alive[w, i] and not contact.stopped[w, i]


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
    wakes: Wakes,
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
        wakes: Room for the wakes of all worlds.
        contact: What contacts need.
        driven: (W, N) bool, room for those whose rotors turn.
        flying: (W, N) bool, room for those whom the engine moves.
    """
    port, swarm, cascade, air = borrowed((port, swarm, cascade, air))
    contact = in_memory(contact)
    _choose_driven(alive, contact, driven)
    for piece in range(substeps):
        remember_all(contact, swarm)
        # Wrenches from the state before the substep, then the engine's step
        if near_ground:
            place_obstacles(contact, piece / substeps, substeps * dt)
            surface_below(port, swarm.position, driven, air.surface)
        drive(
            swarm,
            driven,
            levels,
            setpoint,
            cascade,
            parameters,
            air,
            dt,
            force,
            torque,
            room,
            wakes,
        )
        choose_flying(alive, parameters, force, torque, swarm, dt, contact, flying)
        substep(port, force, torque, flying, swarm)
        # What they would have flown into; the engine goes on from there
        if meet_all(contact, swarm, alive, parameters, piece, substeps, dt):
            write_states(port, swarm, contact.changed)
            _choose_driven(alive, contact, driven)


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
        """Make room for the wrenches, and the bodies that fly."""
        super().__init__(flight)
        flight.engine.make_bodies()
        self._force, self._torque = np.zeros((2, *flight.parameters.shape, 3))
        self._driven, self._flying = np.zeros((2, *flight.parameters.shape), dtype=bool)
        self._room = np.zeros((2, MAX_ROTORS))
        self._wakes = Wakes.of(*flight.parameters.shape)
        self._in_engine = Contacts.none()

    def _add_start(
        self,
        program: Program,
        swarm: Swarm,
        mask: np.ndarray,
    ) -> None:
        """Add that drones start in the engine, too; see the base class."""
        self.flight.engine.add_states(program, swarm, mask)
        super()._add_start(program, swarm, mask)

    def kept(self) -> dict[str, np.ndarray]:
        """Tell also velocities as the engine has them; see the base class."""
        return {**super().kept(), "omega": self.flight.engine.omega}

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Bring the engine to the state; see the base class."""
        self.flight.engine.restore_states(swarm, mask)

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
        self,
        program: Program,
        swarm: Swarm,
        alive: np.ndarray,
        surface: np.ndarray,
    ) -> None:
        """Leave the surface, which is looked for anew in every substep."""

    def _fly_by_calls(self, inputs: "_Inputs") -> None:
        """Fly all substeps through the engine's own calls."""
        flight, contact, swarm, alive = self.flight, self.contact, inputs.swarm, inputs.alive
        _choose_driven(alive, contact, self._driven)
        for piece in range(flight.substeps):
            # Contacts need the states before the substep, and where obstacles are then
            remember_all(contact, swarm)
            place_obstacles(contact, piece / flight.substeps, flight.substeps * flight.dt)
            self._advance_once(inputs._replace(alive=self._driven))
            # States that contacts changed go back to the engine
            parameters = flight.parameters
            if meet_all(contact, swarm, alive, parameters, piece, flight.substeps, flight.dt):
                flight.engine.write_states(swarm, contact.changed)
                _choose_driven(alive, contact, self._driven)

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
            wakes=self._wakes,
        )

    def _advance_once(self, inputs: "_Inputs") -> None:
        """Fly one substep through the engine's own calls."""
        engine = self.flight.engine
        # Ground effect needs the height above what lies below now
        if self._near_ground:
            inputs.air.surface[:] = engine.surface_below(inputs.swarm.position, inputs.alive)
        # Rotors, and what they and the air do
        drive(*inputs)
        force, torque, flying = inputs.force, inputs.torque, self._flying
        # Sleepers take no part; contacts woke whom they do not hold
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
        # Bullet integrates
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
            # Obstacles move in steps: the engine's own contacts know no time between
            if moving:
                share = (piece + 1) / flight.substeps
                engine.set_obstacles(before + share * (after - before), turns, flying)
            self._advance_once(inputs)
            touched.append(engine.contacts(inputs.swarm, flight.dt))
        # One list of contacts for the whole decision
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
    wakes: Wakes
