"""Dynamics `rigid_body`: the wrench of the drones, integrated by RK4 in one compiled loop.

Within a substep the setpoint's rotor command, the wind and the downwash of other drones are held.
Rotor lag, drag, ground effect and attitude are evaluated in each stage. The height of the surface
below is sampled once a decision. That is exact over level ground; past an edge the ground effect
lags by up to one decision (at 20 m/s and 10 Hz, 2 m of flight).
"""

from typing import ClassVar

import numpy as np

from bulletuav.compiled.kernel import func, in_memory, kernel
from bulletuav.compiled.lanes import WIDTH
from bulletuav.compiled.program import Program
from bulletuav.contact.contact_state import ContactState, stays_asleep
from bulletuav.contact.contact_state import wake_drone as rouse
from bulletuav.contact.contacts import save_start_state, step_contacts
from bulletuav.control.cascade import command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Decision, Dynamics, surroundings
from bulletuav.dynamics.blocks import (
    CALM,
    FEWEST,
    Blocks,
    fly_block,
    has_enough,
    is_steered,
    pack_blocks,
    steer_block,
)
from bulletuav.dynamics.cables import Cables, group_bodies
from bulletuav.dynamics.integration import lag_stages, rk4, slope_of, turn_rotors
from bulletuav.dynamics.steering import ALONE, pack_steering
from bulletuav.dynamics.tied import fly_tied, hold_tied
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.registry import register
from bulletuav.vehicle.aerodynamics import num_lifted_rotors
from bulletuav.vehicle.swarm import DroneArrays, Swarm, get_state, set_state
from bulletuav.vehicle.wakes import LIST_SKIN, sum_wakes
from bulletuav.vehicle.wrench import MAX_PART_ROTATION, num_spin_steps


@func
def _fly_alone(
    decision: Decision, contact: ContactState, blocks: Blocks, first: int, w: int, i: int
) -> None:
    """Integrate drone i of world w over a substep alone; the group's first world is `first`."""
    swarm, row = decision.drones.swarm, decision.drones.parameters[w, i]
    air, dt = decision.air, decision.step.dt
    alone = blocks.alone
    speeds = (alone[0], alone[1], alone[2])
    command, decay = blocks.command[w - first, i], blocks.decay[w - first, i]
    motors = (air.supply[w, i], air.rotor_ratio[w, i])
    rotors = turn_rotors(swarm.rotor_speed[w, i], command, *motors, decay, row, speeds)
    around = surroundings(air, w, i, blocks.wakes.felt[w - first])
    state = get_state(swarm, w, i)
    if contact.asleep[w, i]:
        # A drone at rest sleeps as long as its contacts balance its forces
        lifted = num_lifted_rotors(state[0][2] - around[1], state[2][2], dt, row)
        slope = slope_of(state, speeds[2], rotors[2], around, lifted, row)
        pull, spinning = slope[2:]
        if stays_asleep(contact, w, i, state[1], pull, spinning, row, dt):
            return
        rouse(contact, w, i)
    # Fast spins need several steps, as their precession is stiff
    parts = num_spin_steps(state[3], dt, MAX_PART_ROTATION)
    for _ in range(parts):
        state = rk4(state, speeds, rotors, dt / parts, around, row)
    set_state(swarm, w, i, state)


@func
def _mark(
    drones: DroneArrays,
    contact: ContactState,
    blocks: Blocks,
    tied: np.ndarray,
    first: int,
    last: int,
    dt: float,
) -> None:
    """Mark the drones to integrate in blocks, of the worlds from `first` to before `last`."""
    # Read the array addresses once: the compiler must assume that writes could change them
    alive, spin = drones.alive, drones.swarm.rates
    stopped, asleep = contact.stopped, contact.asleep
    together, alike, has_rotors = blocks.together, blocks.alike, blocks.has_rotors
    drone = 0
    for w in range(first, last):
        for i in range(alive.shape[1]):
            rates = vec3(spin, w, i)
            still = stopped[w, i] | asleep[w, i] | tied[w, i]
            calm = dot(rates, rates) * dt * dt < CALM * CALM
            # Branches would be slower
            flies = alive[w, i] & calm & (not still)
            together[drone] = flies & alike[drone // WIDTH] & has_rotors[drone]
            drone += 1
    for k in range(drone, blocks.together.shape[0]):
        blocks.together[k] = False
    for b in range(blocks.packed.shape[0]):
        blocks.flown[b] = has_enough(blocks.together, b)


@func
def _steer_blocks(
    decision: Decision, contact: ContactState, blocks: Blocks, first: int, last: int
) -> None:
    """Run the controllers of blocks that are not integrated together, such as of tied drones."""
    alive, stopped, steered = decision.drones.alive, contact.stopped, blocks.steered
    num_drones = alive.shape[1]
    for b in range(blocks.packed.shape[0]):
        is_apart = blocks.flown[b] or not blocks.alike[b] or blocks.steering.level[b] == ALONE
        for k in range(b * WIDTH, (b + 1) * WIDTH):
            w, i = first + k // num_drones, k % num_drones
            flies = not is_apart and w < last and blocks.has_rotors[k]
            steered[k] = flies and alive[w, i] and not stopped[w, i]
        if not is_apart and has_enough(steered, b):
            gravity, dt = decision.air.gravity, decision.step.dt
            steer_block(blocks, first * num_drones, b, gravity, dt)


@func
def start_worlds(decision: Decision, blocks: Blocks, first: int, last: int) -> None:
    """Prepare the work arrays of the worlds from `first` to before `last` for a decision."""
    drones = decision.drones
    # Constant over the substeps
    for w in range(first, last):
        lag_stages(drones.parameters, w, decision.step.dt, blocks.decay[w - first])
    if drones.alive.size >= FEWEST:
        drone = first * drones.alive.shape[1]
        pack_blocks(blocks, decision.air, drone)
        pack_steering(blocks.steering, decision.setpoints, drone)


@func
def fly_worlds(
    decision: Decision,
    contact: ContactState,
    blocks: Blocks,
    cables: Cables,
    first: int,
    last: int,
    substep: int,
) -> None:
    """Fly one substep of the worlds from `first` to before `last`, without contacts.

    Args:
        decision: Inputs of the decision.
        contact: State of the contact solver, which keeps the state at the begin of the substep.
        blocks: Work arrays of these worlds.
        cables: Cables between the bodies.
        first: The first world.
        last: The world after the last one.
        substep: Index of the substep in the decision.
    """
    drones, setpoints, cascade = decision.drones, decision.setpoints, decision.cascade
    air, step = decision.air, decision.step
    swarm, alive, parameters = drones.swarm, drones.alive, drones.parameters
    dt = step.dt
    num_drones = alive.shape[1]
    leeway = LIST_SKIN if step.substeps > 1 else 0.0
    _mark(drones, contact, blocks, cables.is_tied, first, last, dt)
    # Wakes and commands of all drones are computed before any drone moves
    if num_drones > 1:
        sum_wakes(swarm, alive, parameters, first, last, substep > 0, leeway, blocks.wakes)
    _steer_blocks(decision, contact, blocks, first, last)
    for w in range(first, last):
        save_start_state(contact, swarm, w)
        for i in range(num_drones):
            if alive[w, i] and not contact.stopped[w, i]:
                drone = (w - first) * num_drones + i
                command = blocks.command[w - first, i]
                steered = blocks.steered[drone] or is_steered(blocks, drone)
                if not steered and parameters[w, i].num_rotors > 0:
                    command_rotors(cascade, setpoints, swarm, w, i, dt, air.gravity, command)

    # From here on drones do not interact until contacts are resolved
    for b in range(blocks.packed.shape[0]):
        if blocks.flown[b]:
            fly_block(blocks, first * num_drones, b, air.gravity, dt)
    for w in range(first, last):
        for i in range(num_drones):
            moved = blocks.together[(w - first) * num_drones + i] or cables.is_tied[w, i]
            if alive[w, i] and not contact.stopped[w, i] and not moved:
                _fly_alone(decision, contact, blocks, first, w, i)

        if cables.num_groups[w] > 0:
            fly_tied(decision, blocks, cables, contact, w, first)


@kernel
def advance_rigid_body(
    decision: Decision, contact: ContactState, blocks: Blocks, cables: Cables
) -> None:
    """Fly all substeps of one decision in all worlds.

    Args:
        decision: Inputs of the decision.
        contact: State of the contact solver.
        blocks: Work arrays for a group of worlds.
        cables: Cables between the bodies.
    """
    decision, contact, blocks = in_memory(decision), in_memory(contact), in_memory(blocks)
    cables = in_memory(cables)
    drones, step = decision.drones, decision.step
    # Drones of a group of worlds share blocks
    worlds = blocks.command.shape[0]
    for first in range(0, drones.alive.shape[0], worlds):
        last = min(first + worlds, drones.alive.shape[0])
        start_worlds(decision, blocks, first, last)
        for substep in range(step.substeps):
            fly_worlds(decision, contact, blocks, cables, first, last, substep)
            for w in range(first, last):
                hit = step_contacts(contact, drones, w, substep, step)
                if hit and cables.num_groups[w] > 0:
                    hold_tied(decision, cables, contact, w)


@register("dynamics")
class RigidBody(Dynamics):
    """Rigid-body dynamics with six degrees of freedom, integrated by RK4 without the engine."""

    name = "rigid_body"
    consumes = SetpointLevel.ROTOR
    feels_surface = True
    feels_force = True
    feels_torque = True
    feels_rotors = True
    feels_mass = True
    feels_inertia = True
    feels_gravity = True
    feels_cables = True
    contacts: ClassVar[tuple[str, ...]] = ("impulse", "stop")
    sleeps = True

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Find the groups of bodies that the restored cables connect; see the base class."""
        group_bodies(self.cables)

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps as one compiled call; see the base class."""
        blocks = Blocks.of(decision.drones, decision.cascade)
        program.call(advance_rigid_body, decision, self.contact, blocks, self.cables)
