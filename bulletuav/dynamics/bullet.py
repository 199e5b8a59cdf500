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

import numpy as np

from bulletuav.compiled.kernel import allocating, in_memory, kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.contact_state import ContactState, stays_asleep, wake_drone
from bulletuav.contact.contacts import place_obstacles, save_all_start_states, step_all_contacts
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Decision, Dynamics, Flight
from bulletuav.dynamics.drive import Scratch, drive
from bulletuav.engine.c_extension import Port, substep, surface_below, write_states
from bulletuav.geometry.rotation import plus, quat4, vec3
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Contacts, DroneArrays, Swarm


@kernel
def choose_flying(drones: DroneArrays, contact: ContactState, dt: float, scratch: Scratch) -> None:
    """Choose the drones that the engine moves: drones at rest stay while they bear their forces.

    Args:
        drones: All drones.
        contact: What contacts need; sleepers whose forces changed wake.
        dt: Length of the substep, s.
        scratch: Wrenches of the drones; `flying` is written.
    """
    alive, flying = drones.alive, scratch.flying
    force, torque = scratch.wrenches.force, scratch.wrenches.torque
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            # Whom a contact stopped stays for the rest of the decision
            flying[w, i] = alive[w, i] and not contact.stopped[w, i]
            if flying[w, i] and contact.asleep[w, i]:
                # What would move a sleeper: forces over mass, torques over inertia
                row = drones.parameters[w, i]
                turn = vec3(torque, w, i)
                inertia = row.inertia
                accelerates = plus((0.0, 0.0, 0.0), 1.0 / row.mass, vec3(force, w, i))
                spins = (turn[0] / inertia[0], turn[1] / inertia[1], turn[2] / inertia[2])
                turned = quat4(drones.swarm.quaternion, w, i)
                if not stays_asleep(contact, w, i, turned, accelerates, spins, row, dt):
                    wake_drone(contact, w, i)
    # The rest of the pile may have woken with one of its drones
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            flying[w, i] = flying[w, i] and not contact.asleep[w, i]


@kernel
def _choose_driven(alive: np.ndarray, contact: ContactState, driven: np.ndarray) -> None:
    """Write whose rotors turn (W, N): all in flight but whom a contact stopped in the decision."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            driven[w, i] = alive[w, i] and not contact.stopped[w, i]


@allocating
def advance(
    decision: Decision, contact: ContactState, scratch: Scratch, port: Port, near_ground: bool
) -> None:
    """Fly all substeps of one decision in one call, through the C extension.

    Args:
        decision: What is flown; the surface of its air is written.
        contact: What contacts need.
        scratch: Arrays to work on.
        port: Session of the extension, and the arrays of the worlds.
        near_ground: Whether the ground effect wants the surface below.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    scratch, port = in_memory(scratch), in_memory(port)
    drones, step, driven = decision.drones, decision.step, scratch.driven
    swarm = drones.swarm
    _choose_driven(drones.alive, contact, driven)
    for piece in range(step.substeps):
        save_all_start_states(contact, swarm)
        # Wrenches from the state before the substep, then the engine's step
        if near_ground:
            place_obstacles(contact, piece, step)
            surface_below(port, swarm.position, driven, decision.air.surface)
        drive(decision, scratch)
        choose_flying(drones, contact, step.dt, scratch)
        substep(port, scratch.wrenches, scratch.flying, swarm)
        # What they would have flown into; the engine goes on from there
        if step_all_contacts(contact, drones, piece, step):
            write_states(port, swarm, contact.changed)
            _choose_driven(drones.alive, contact, driven)


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
        self._scratch = Scratch.of(*flight.parameters.shape)
        self._in_engine = Contacts.none()

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
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

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps, as one compiled call where the C extension is; see the base class."""
        port, drones = self.flight.engine.port, decision.drones
        # C reads arrays as they lie
        assert all(array.flags.c_contiguous for array in (*drones.swarm, drones.alive))
        if self.flight.contacts == "bullet":
            program.turn(lambda: self._fly_in_engine(decision))
        elif port is None:
            program.turn(lambda: self._fly_by_calls(decision))
        else:
            engine = (port, self._near_ground)
            program.call(advance, decision, self.contact, self._scratch, *engine)

    def touched(self) -> Contacts:
        """Tell what was touched in the last decision; see the base class."""
        return self._in_engine if self.flight.contacts == "bullet" else super().touched()

    def _add_surface(self, program: Program, drones: DroneArrays, surface: np.ndarray) -> None:
        """Leave the surface, which is looked for anew in every substep."""

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
        # Ground effect needs the height above what lies below now
        if self._near_ground:
            decision.air.surface[:] = engine.surface_below(swarm.position, scratch.driven)
        # Rotors, and what they and the air do
        drive(decision, scratch)
        # Sleepers take no part; contacts woke whom they do not hold
        choose_flying(decision.drones, self.contact, decision.step.dt, scratch)
        # Bullet integrates
        engine.apply_wrenches(*scratch.wrenches, scratch.flying)
        engine.step()
        engine.read_states(swarm, scratch.flying)

    def _fly_in_engine(self, decision: Decision) -> None:
        """Fly with Bullet's own contacts, substep by substep."""
        engine, (swarm, alive, _), step = self.flight.engine, decision.drones, decision.step
        before, after = self.contact.before, self.contact.after
        turns = engine.scenery.quaternion[:, : before.shape[1]]
        moving, flying = bool((before != after).any()), np.any(alive, axis=1)
        self._scratch.driven[:] = alive
        touched = []
        for piece in range(step.substeps):
            # Obstacles move in steps: the engine's own contacts know no time between
            if moving:
                share = (piece + 1) / step.substeps
                engine.set_obstacles(before + share * (after - before), turns, flying)
            self._advance_once(decision)
            touched.append(engine.contacts(swarm, step.dt))
        # One list of contacts for the whole decision
        columns = [np.concatenate(column) for column in zip(*touched, strict=True)]
        self._in_engine = Contacts.merged(**dict(zip(Contacts._fields, columns, strict=True)))
