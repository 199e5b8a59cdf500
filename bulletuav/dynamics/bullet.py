"""Dynamics `bullet`: Bullet integrates the wrench that all 6-DoF dynamics share.

Scheme of one substep: rotor lag; wrench at the state before the substep with the rotor speeds after
it; velocity v+ = v + dt F / m, position p+ = p + dt v+; body rates by Euler's equation (RK4,
constant torque), attitude R+ = R exp(dt w+). Bullet alone would take an explicit Euler step of the
rates, which gains energy; the torque is corrected so that Bullet's step ends at the accurate rates.
The height above the surface is sampled in every substep.

Bullet limits the rotation in a substep to pi/4 (188 rad/s at 240 Hz); for faster spins the attitude
lags behind, the rates do not. `bulletuav.contact` resolves contacts, as for all dynamics. With
contacts="bullet" Bullet's own solver does, for comparison: there fast drones pass through thin
bodies.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, in_memory, kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.contact_state import ContactState, stays_asleep, wake_drone
from bulletuav.contact.contacts import place_obstacles, save_all_start_states, step_all_contacts
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Decision, Dynamics, FlightSetup
from bulletuav.dynamics.drive import Scratch, drive
from bulletuav.engine.c_extension import EnginePort, substep, surface_below, write_states
from bulletuav.geometry.rotation import plus, quat4, vec3
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Contacts, DroneArrays, Swarm


@kernel
def choose_flying(drones: DroneArrays, contact: ContactState, dt: float, scratch: Scratch) -> None:
    """Select the drones that the engine moves, and wake sleeping drones whose forces changed.

    Args:
        drones: All drones.
        contact: State of the contact solver; sleeping drones whose forces changed are woken.
        dt: Duration of the substep, s.
        scratch: Wrenches of the drones; `flying` is written.
    """
    alive, flying = drones.alive, scratch.flying
    force, torque = scratch.wrenches.force, scratch.wrenches.torque
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            # A drone that a contact stopped stays in place for the rest of the decision
            flying[w, i] = alive[w, i] and not contact.stopped[w, i]
            if flying[w, i] and contact.asleep[w, i]:
                # Accelerations that would move a sleeping drone: force / mass, torque / inertia
                row = drones.parameters[w, i]
                turn = vec3(torque, w, i)
                inertia = row.inertia
                accelerates = plus((0.0, 0.0, 0.0), 1.0 / row.mass, vec3(force, w, i))
                spins = (turn[0] / inertia[0], turn[1] / inertia[1], turn[2] / inertia[2])
                turned = quat4(drones.swarm.quaternion, w, i)
                if not stays_asleep(contact, w, i, turned, accelerates, spins, row, dt):
                    wake_drone(contact, w, i)
    # The other drones of a pile are woken together with one of them
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            flying[w, i] = flying[w, i] and not contact.asleep[w, i]


@kernel
def _choose_driven(alive: np.ndarray, contact: ContactState, driven: np.ndarray) -> None:
    """Write the mask (W, N) of drones whose rotors turn: alive, and not stopped by a contact."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            driven[w, i] = alive[w, i] and not contact.stopped[w, i]


@allocating
def advance_bullet(
    decision: Decision, contact: ContactState, scratch: Scratch, port: EnginePort, near_ground: bool
) -> None:
    """Fly all substeps of one decision in one call, through the C extension.

    Args:
        decision: Inputs of the decision; the surface of its air is written.
        contact: State of the contact solver.
        scratch: Work arrays.
        port: Session of the extension, and the arrays of the worlds.
        near_ground: Whether the ground effect needs the surface below.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    scratch, port = in_memory(scratch), in_memory(port)
    drones, step, driven = decision.drones, decision.step, scratch.driven
    swarm = drones.swarm
    _choose_driven(drones.alive, contact, driven)
    for piece in range(step.substeps):
        save_all_start_states(contact, swarm)
        # The wrenches act on the state before the substep
        if near_ground:
            place_obstacles(contact, piece, step)
            surface_below(port, swarm.position, driven, decision.air.surface)
        drive(decision, scratch)
        choose_flying(drones, contact, step.dt, scratch)
        substep(port, scratch.wrenches, scratch.flying, swarm)
        # The engine continues from the states that contacts changed
        if step_all_contacts(contact, drones, piece, step):
            write_states(port, swarm, contact.changed)
            _choose_driven(drones.alive, contact, driven)


@register("dynamics")
class BulletDynamics(Dynamics):
    """Rigid-body dynamics that Bullet integrates in every substep."""

    name = "bullet"
    consumes = SetpointLevel.ROTOR
    feels_surface = True
    feels_force = True
    feels_torque = True
    feels_rotors = True
    feels_mass = True
    feels_inertia = True
    feels_gravity = True
    contacts = ("impulse", "stop", "bullet")
    sleeps = True

    def __init__(self, flight: FlightSetup) -> None:
        """Allocate the work arrays, and create the bodies of the drones in Bullet.

        Args:
            flight: Worlds, drone parameters, controllers and time step.
        """
        super().__init__(flight)
        flight.engine.make_bodies()
        self._scratch = Scratch.of(*flight.parameters.shape)
        self._in_engine = Contacts.none()

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add calls that also set the drones' states in the engine; see the base class."""
        self.flight.engine.add_states(program, swarm, mask)
        super()._add_start(program, swarm, mask)

    def kept(self) -> dict[str, np.ndarray]:
        """Return also the angular velocities in the engine; see the base class."""
        return {**super().kept(), "omega": self.flight.engine.omega}

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set the states of the drones in the engine; see the base class."""
        self.flight.engine.restore_states(swarm, mask)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Do nothing: the engine's bodies are already at the poses of the swarm."""

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps, as one compiled call with the C extension; see the base class."""
        port, drones = self.flight.engine.port, decision.drones
        # C reads the arrays without strides
        assert all(array.flags.c_contiguous for array in (*drones.swarm, drones.alive))
        if self.flight.contacts == "bullet":
            program.callback(lambda: self._fly_in_engine(decision))
        elif port is None:
            program.callback(lambda: self._fly_by_calls(decision))
        else:
            engine = (port, self._near_ground)
            program.call(advance_bullet, decision, self.contact, self._scratch, *engine)

    def touched(self) -> Contacts:
        """Return the contacts of the last decision; see the base class."""
        return self._in_engine if self.flight.contacts == "bullet" else super().touched()

    def _add_surface(self, program: Program, drones: DroneArrays, surface: np.ndarray) -> None:
        """Add nothing: the surface is sampled in every substep."""

    def _fly_by_calls(self, decision: Decision) -> None:
        """Fly all substeps through the engine's own calls."""
        engine, contact, driven = self.flight.engine, self.contact, self._scratch.driven
        drones, step = decision.drones, decision.step
        _choose_driven(drones.alive, contact, driven)
        for piece in range(step.substeps):
            # Contacts need the states before the substep, and where obstacles are then
            save_all_start_states(contact, drones.swarm)
            place_obstacles(contact, piece, step)
            self._advance_once(decision)
            # States that contacts changed go back to the engine
            if step_all_contacts(contact, drones, piece, step):
                engine.write_states(drones.swarm, contact.changed)
                _choose_driven(drones.alive, contact, driven)

    def _advance_once(self, decision: Decision) -> None:
        """Fly one substep of the driven drones through the engine's own calls."""
        engine, swarm, scratch = self.flight.engine, decision.drones.swarm, self._scratch
        # The ground effect needs the present height above the surface
        if self._near_ground:
            decision.air.surface[:] = engine.surface_below(swarm.position, scratch.driven)
        drive(decision, scratch)
        # Sleeping drones are not integrated
        choose_flying(decision.drones, self.contact, decision.step.dt, scratch)
        engine.apply_wrenches(*scratch.wrenches, scratch.flying)
        engine.step()
        engine.read_states(swarm, scratch.flying)

    def _fly_in_engine(self, decision: Decision) -> None:
        """Fly with Bullet's own contacts, substep by substep."""
        engine, (swarm, alive, _), step = self.flight.engine, decision.drones, decision.step
        before, after = self.contact.before, self.contact.after
        turns = engine.scenery.quaternion[:, : before.shape[1]]
        has_bodies = len(engine.scenery.bodies.reach) > 0
        moving, flying = bool((before != after).any()), np.any(alive, axis=1)
        turning = bool(self.contact.turns.rotation.any())
        self._scratch.driven[:] = alive
        touched = []
        for piece in range(step.substeps):
            # Bullet's contacts are discrete in time, so obstacles move once a substep
            if moving:
                share = (piece + 1) / step.substeps
                engine.set_obstacles(before + share * (after - before), turns, flying)
            if has_bodies or turning:
                place_obstacles(self.contact, piece + 1, step)
                engine.show_obstacles()
            self._advance_once(decision)
            touched.append(engine.contacts(swarm, step.dt))
        # One list of contacts for the whole decision
        columns = [np.concatenate(column) for column in zip(*touched, strict=True)]
        self._in_engine = Contacts.merged(**dict(zip(Contacts._fields, columns, strict=True)))
