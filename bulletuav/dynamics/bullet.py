"""Dynamics `bullet`: Bullet moves the drones by the forces of the flight of `rigid_body`.

In each substep the RK4 of `rigid_body` computes where a drone is after it. Bullet's step is
semi-implicit Euler: velocity v+ = v + dt F / m, then position p+ = p + dt v+, and likewise attitude
R+ = R exp(dt w+). So Bullet gets the mean force and torque under which v+ and w+ are the mean
velocities over the substep, and its step ends at the accurate pose. The velocities of the swarm are
those of the flight; Bullet's are half a substep behind. Unlike in `rigid_body`, the height of the
surface below is sampled in every substep.

Bullet limits the rotation in a substep to pi/4 (188 rad/s at 240 Hz); for faster spins the attitude
lags behind, the rates do not. `bulletuav.contact` resolves contacts, as for all dynamics. With
contacts="bullet" Bullet's own solver does, for comparison: there fast drones pass through thin
bodies. As that solver changes velocities at the end of a substep, Bullet's are then those of the
flight, and positions are of first order.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, in_memory, kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.contact_state import ContactState
from bulletuav.contact.contacts import place_obstacles, step_contacts
from bulletuav.dynamics.base import Decision, FlightSetup
from bulletuav.dynamics.blocks import FEWEST, Blocks, pack_surface
from bulletuav.dynamics.cables import Cables
from bulletuav.dynamics.rigid_body import RigidBody, fly_worlds, start_worlds
from bulletuav.dynamics.tied import hold_tied
from bulletuav.engine.c_extension import EnginePort, substep, surface_below, write_states
from bulletuav.geometry.rotation import (
    cross,
    log_map,
    minus,
    product,
    quat4,
    to_body,
    vec3,
)
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Contacts, DroneArrays, Swarm
from bulletuav.vehicle.wrench import Wrenches


class BulletFlight(NamedTuple):
    """Work arrays of the flight of W worlds of N drones in Bullet.

    Attributes:
        blocks: Work arrays of the flight of `rigid_body`, for the largest group of worlds.
        cables: Cables between the bodies.
        velocity: (W, N, 3) velocities of the drones in Bullet, world axes, m/s.
        omega: (W, N, 3) angular velocities of the drones in Bullet, world axes, rad/s.
        wrenches: Forces and torques that Bullet applies in a substep.
        flying: (W, N) bool, drones that Bullet moves in a substep.
        is_mean: Whether Bullet's velocities are the means over a substep.
        near_ground: Whether the ground effect needs the surface below.
    """

    blocks: Blocks
    cables: Cables
    velocity: np.ndarray
    omega: np.ndarray
    wrenches: Wrenches
    flying: np.ndarray
    is_mean: bool
    near_ground: bool


@func
def _choose_flying(
    drones: DroneArrays, contact: ContactState, flying: np.ndarray, first: int, last: int
) -> None:
    """Mark the drones that move: a drone that a contact stopped rests until the decision ends."""
    for w in range(first, last):
        for i in range(flying.shape[1]):
            flying[w, i] = drones.alive[w, i] and not contact.stopped[w, i]


@kernel
def fly_ahead(
    decision: Decision,
    contact: ContactState,
    flight: BulletFlight,
    first: int,
    last: int,
    piece: int,
) -> None:
    """Fly one substep of worlds without contacts, and write wrenches for Bullet to do the same.

    Args:
        decision: Inputs of the decision; the swarm is at the end of the substep afterwards.
        contact: State of the contact solver, which keeps the state at the begin of the substep.
        flight: Work arrays; the wrenches, and the drones that Bullet moves, are written.
        first: The first world.
        last: The world after the last one.
        piece: Index of the substep in the decision.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    blocks, cables = in_memory(flight.blocks), in_memory(flight.cables)
    drones, dt = decision.drones, decision.step.dt
    num_drones = drones.alive.shape[1]
    if piece == 0:
        start_worlds(decision, blocks, first, last)
    elif flight.near_ground and drones.alive.size >= FEWEST:
        pack_surface(blocks, decision.air, first * num_drones)
    fly_worlds(decision, contact, blocks, cables, first, last, piece)
    _choose_flying(drones, contact, flight.flying, first, last)
    swarm, start, wrenches = drones.swarm, contact.start, flight.wrenches
    for w in range(first, last):
        for i in range(num_drones):
            flight.flying[w, i] = flight.flying[w, i] and not contact.asleep[w, i]
            if flight.flying[w, i]:
                row, inertia = drones.parameters[w, i], drones.parameters[w, i].inertia
                before = quat4(start.quaternion, w, i)
                # Velocities after Bullet's step, in world and body axes
                speed, rates = vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i)
                if flight.is_mean:
                    path = minus(vec3(swarm.position, w, i), vec3(start.position, w, i))
                    speed = (path[0] / dt, path[1] / dt, path[2] / dt)
                    back = (-before[0], -before[1], -before[2], before[3])
                    turn = log_map(product(back, quat4(swarm.quaternion, w, i)))
                    rates = (turn[0] / dt, turn[1] / dt, turn[2] / dt)
                change = minus(speed, vec3(flight.velocity, w, i))
                spin = to_body(before, vec3(flight.omega, w, i))
                carried = (inertia[0] * spin[0], inertia[1] * spin[1], inertia[2] * spin[2])
                # Bullet subtracts the gyroscopic torque
                gyroscopic = cross(spin, carried)
                for k in range(3):
                    wrenches.force[w, i, k] = row.mass * change[k] / dt
                    turned = inertia[k] * (rates[k] - spin[k]) / dt
                    wrenches.torque[w, i, k] = gyroscopic[k] + turned


@allocating
def advance_bullet(
    decision: Decision, contact: ContactState, flight: BulletFlight, port: EnginePort
) -> None:
    """Fly all substeps of one decision of a group of worlds in one call, through the C extension.

    Args:
        decision: Inputs of the decision; the surface of its air is written.
        contact: State of the contact solver.
        flight: Work arrays.
        port: Session of the extension for the group, and the arrays of all worlds.
    """
    decision, contact, flight = in_memory(decision), in_memory(contact), in_memory(flight)
    drones, step = decision.drones, decision.step
    first, last = port.first, port.last
    for piece in range(step.substeps):
        if flight.near_ground:
            place_obstacles(contact, first, last, piece, step)
            _choose_flying(drones, contact, flight.flying, first, last)
            surface_below(port, drones.swarm.position, flight.flying, decision.air.surface)
        fly_ahead(decision, contact, flight, first, last, piece)
        substep(port, flight.wrenches, flight.flying, drones.swarm)
        # Bullet continues from the states that contacts changed
        if step_and_hold(decision, contact, flight.cables, first, last, piece):
            write_states(port, drones.swarm, contact.changed)


@kernel
def step_and_hold(
    decision: Decision, contact: ContactState, cables: Cables, first: int, last: int, piece: int
) -> bool:
    """Resolve the contacts and cables of some worlds; returns whether any state was changed."""
    any_hit = False
    for w in range(first, last):
        hit = step_contacts(contact, decision.drones, w, piece, decision.step)
        any_hit = any_hit or hit
        if hit and cables.num_groups[w] > 0:
            hold_tied(decision, cables, contact, w)
            for i in range(cables.is_tied.shape[1]):
                contact.changed[w, i] = contact.changed[w, i] or cables.is_tied[w, i]
    return any_hit


@register("dynamics")
class BulletDynamics(RigidBody):
    """Rigid-body dynamics whose drones Bullet moves in every substep."""

    name = "bullet"
    contacts = ("impulse", "stop", "bullet")
    has_threads = False

    def __init__(self, flight: FlightSetup) -> None:
        """Create the bodies of the drones in Bullet.

        Args:
            flight: Worlds, drone parameters, controllers and time step.
        """
        super().__init__(flight)
        flight.engine.make_bodies()
        self._in_engine = Contacts.none()

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add calls that also set the drones' states in the engine; see the base class."""
        self.flight.engine.add_states(program, swarm, mask)
        super()._add_start(program, swarm, mask)

    def kept(self) -> dict[str, np.ndarray]:
        """Return also the velocities in the engine; see the base class."""
        engine = self.flight.engine
        return {**super().kept(), "bullet_velocity": engine.velocity, "omega": engine.omega}

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set the states of the drones in the engine, too; see the base class."""
        super().restore(swarm, mask)
        self.flight.engine.restore_states(swarm, mask)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Do nothing: the engine's bodies are already at the poses of the swarm."""

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps, as one compiled call with the C extension; see the base class."""
        drones, engine = decision.drones, self.flight.engine
        # C reads the arrays without strides
        assert all(array.flags.c_contiguous for array in (*drones.swarm, drones.alive))
        contacts = self.flight.contacts
        # Calls by pybullet fly all worlds in turn
        ports = [] if contacts == "bullet" else engine.ports
        largest = max((port.last - port.first for port in ports), default=drones.alive.shape[0])
        flight = BulletFlight(
            blocks=Blocks.of(
                drones, decision.cascade, decision.wings, largest * drones.alive.shape[1]
            ),
            cables=self.cables,
            velocity=engine.velocity,
            omega=engine.omega,
            wrenches=Wrenches(*np.zeros((2, *drones.alive.shape, 3))),
            flying=np.zeros(drones.alive.shape, dtype=bool),
            is_mean=contacts != "bullet",
            near_ground=self._near_ground,
        )
        if contacts == "bullet":
            program.callback(lambda: self._fly_in_engine(decision, flight))
        elif not ports:
            program.callback(lambda: self._fly_by_calls(decision, flight))
        for port in ports:
            program.call(advance_bullet, decision, self.contact, flight, port)

    def touched(self) -> Contacts:
        """Return the contacts of the last decision; see the base class."""
        return self._in_engine if self.flight.contacts == "bullet" else super().touched()

    def _add_surface(self, program: Program, drones: DroneArrays, surface: np.ndarray) -> None:
        """Add nothing: the surface is sampled in every substep."""

    def _fly_by_calls(self, decision: Decision, flight: BulletFlight) -> None:
        """Fly all substeps through the engine's own calls."""
        engine, contact, swarm = self.flight.engine, self.contact, decision.drones.swarm
        num_worlds = len(decision.drones.alive)
        for piece in range(decision.step.substeps):
            place_obstacles(contact, 0, num_worlds, piece, decision.step)
            self._advance_once(decision, flight, piece)
            engine.read_poses(swarm, flight.flying)
            # States that contacts changed go back to the engine
            if step_and_hold(decision, contact, flight.cables, 0, num_worlds, piece):
                engine.write_states(swarm, contact.changed)

    def _advance_once(self, decision: Decision, flight: BulletFlight, piece: int) -> None:
        """Fly one substep, up to the engine's step, through the engine's own calls."""
        engine, drones = self.flight.engine, decision.drones
        # The ground effect needs the present height above the surface
        if flight.near_ground:
            flying = drones.alive & ~self.contact.stopped
            decision.air.surface[:] = engine.surface_below(drones.swarm.position, flying)
        fly_ahead(decision, self.contact, flight, 0, len(drones.alive), piece)
        engine.apply_wrenches(*flight.wrenches, flight.flying)
        engine.step()

    def _fly_in_engine(self, decision: Decision, flight: BulletFlight) -> None:
        """Fly with Bullet's own contacts, substep by substep."""
        engine, (swarm, alive, _), step = self.flight.engine, decision.drones, decision.step
        before, after = self.contact.before, self.contact.after
        turns = engine.scenery.quaternion[:, : before.shape[1]]
        has_bodies = len(engine.scenery.bodies.reach) > 0
        moving, worlds = bool((before != after).any()), np.any(alive, axis=1)
        turning = bool(self.contact.turns.rotation.any())
        touched = []
        for piece in range(step.substeps):
            # Bullet's contacts are discrete in time, so obstacles move once a substep
            if moving:
                share = (piece + 1) / step.substeps
                engine.set_obstacles(before + share * (after - before), turns, worlds)
            if has_bodies or turning:
                place_obstacles(self.contact, 0, len(alive), piece + 1, step)
                engine.show_obstacles()
            self._advance_once(decision, flight, piece)
            engine.read_states(swarm, flight.flying)
            touched.append(engine.contacts(swarm, step.dt))
        # One list of contacts for the whole decision
        columns = [np.concatenate(column) for column in zip(*touched, strict=True)]
        self._in_engine = Contacts.merged(**dict(zip(Contacts._fields, columns, strict=True)))
