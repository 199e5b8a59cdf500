"""Dynamics `rigid_body`: the wrench of the drones, integrated by RK4 in one compiled loop.

Within a substep the setpoint's rotor command, the wind and the downwash of other drones are held.
Rotor lag, drag, ground effect and attitude are evaluated in each stage. The height of the surface
below is sampled once a decision. That is exact over level ground; past an edge the ground effect
lags by up to one decision (at 20 m/s and 10 Hz, 2 m of flight).
"""

from typing import Any, ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, in_memory, kernel
from bulletuav.compiled.lanes import WIDTH
from bulletuav.compiled.program import Program
from bulletuav.compiled.threads import CACHE_LINE
from bulletuav.contact.contact_state import ContactState, stays_asleep
from bulletuav.contact.contact_state import wake_drone as rouse
from bulletuav.contact.contacts import resolve_world, save_start_state, step_contacts
from bulletuav.contact.motion_bounds import update_budgets
from bulletuav.control.cascade import command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Decision, Dynamics, surroundings
from bulletuav.dynamics.blocks import (
    CALM,
    DRONES,
    FEWEST,
    Blocks,
    count_panels,
    fly_block,
    has_enough,
    is_steered,
    load_block,
    pack_blocks,
    stays_in_block,
    steer_block,
)
from bulletuav.dynamics.cables import Cables, group_bodies
from bulletuav.dynamics.integration import (
    Speeds,
    Stages,
    State,
    lag_stages,
    rk4,
    slope_of,
    turn_rotors,
)
from bulletuav.dynamics.steering import ALONE, pack_steering
from bulletuav.dynamics.tied import fly_tied, hold_tied
from bulletuav.geometry.grid import MIN_POINTS
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.registry import register
from bulletuav.vehicle.aerodynamics import num_lifted_rotors
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.swarm import DroneArrays, Swarm, get_state, set_state
from bulletuav.vehicle.wakes import (
    LIST_SKIN,
    WakeSearch,
    list_pairs_of_drones,
    start_pairs,
    sum_listed_wakes,
    sum_wakes,
)
from bulletuav.vehicle.wings import add_winding, deflection_after
from bulletuav.vehicle.wrench import MAX_PART_ROTATION, Surroundings, num_spin_steps


@func
def _move_surfaces(
    wings: Any, deflection: np.ndarray, command: np.ndarray, w: int, i: int, first: int, dt: float
) -> None:
    """Move the control surfaces of drone i of world w for a substep.

    Args:
        wings: `WingTable`, or None.
        deflection: (S,) deflections, rad; updated.
        command: (R + S,) commands of the drone.
        w: Index of the world.
        i: Index of the drone.
        first: Index of the first commanded deflection: the number of the drone's rotors.
        dt: Duration of the substep, s.
    """
    if wings is not None:
        wing = wings.rows[wings.kind[w, i]]
        for k in range(wing.num_surfaces):
            deflection[k] = deflection_after(deflection[k], command[first + k], k, dt, wing)


@func
def _wind_rotors(
    around: Surroundings, speeds: Speeds, dt: float, row: np.record, wings: Any, w: int, i: int
) -> Surroundings:
    """Add the torque of accelerating rotors of an aircraft with wings, see `add_winding`."""
    if wings is None:
        return around
    return add_winding(around, speeds[0], speeds[2], dt, row, wings.rows[wings.kind[w, i]])


@func
def _slope_alone(
    state: State,
    speed: np.ndarray,
    rotors: Rotors,
    around: Surroundings,
    lifted: int,
    row: np.record,
    wings: Any,
    deflection: np.ndarray,
    w: int,
    i: int,
) -> State:
    """Return the slope of drone i of world w, see `slope_of`; `wings` may be None."""
    if wings is None:
        return slope_of(state, speed, rotors, around, lifted, row, None, None)
    return slope_of(
        state, speed, rotors, around, lifted, row, wings.rows[wings.kind[w, i]], deflection
    )


@func
def _step_alone(
    state: State,
    speeds: Speeds,
    rotors: Stages,
    dt: float,
    around: Surroundings,
    row: np.record,
    wings: Any,
    deflection: np.ndarray,
    w: int,
    i: int,
) -> State:
    """Integrate drone i of world w over a step, see `rk4`; `wings` may be None."""
    if wings is None:
        return rk4(state, speeds, rotors, dt, around, row, None, None)
    return rk4(state, speeds, rotors, dt, around, row, wings.rows[wings.kind[w, i]], deflection)


@func
def _fly_alone(
    decision: Decision, contact: ContactState, blocks: Blocks, first: int, w: int, i: int
) -> None:
    """Integrate drone i of world w over a substep alone; the group's first world is `first`."""
    swarm, row = decision.drones.swarm, decision.drones.parameters[w, i]
    air, dt = decision.air, decision.step.dt
    drone = (w - first) * contact.asleep.shape[1] + i
    if contact.asleep[w, i] and blocks.resting[drone]:
        if stays_in_block(blocks, contact, w, i, drone, dt):
            return
        rouse(contact, w, i)
    alone = blocks.alone
    speeds = (alone[0], alone[1], alone[2])
    command, decay = blocks.command[w - first, i], blocks.decay[w - first, i]
    motors = (air.supply[w, i], air.rotor_ratio[w, i])
    num_panels = count_panels(decision.wings, w, i)
    speed = swarm.rotor_speed[w, i]
    rotors = turn_rotors(speed, command, *motors, decay, row, speeds, num_panels)
    deflection, wings = swarm.deflection[w, i], decision.wings
    _move_surfaces(wings, deflection, command, w, i, row.num_rotors, dt)
    around = surroundings(air, w, i, blocks.wakes.felt[w - first])
    around = _wind_rotors(around, speeds, dt, row, decision.wings, w, i)
    state = get_state(swarm, w, i)
    if contact.asleep[w, i]:
        # A drone at rest sleeps as long as its contacts balance its forces
        lifted = num_lifted_rotors(state[0][2] - around[1], state[2][2], dt, row)
        slope = _slope_alone(
            state, speeds[2], rotors[2], around, lifted, row, wings, deflection, w, i
        )
        pull, spinning = slope[2:]
        if stays_asleep(contact, w, i, state[1], pull, spinning, row, dt):
            return
        rouse(contact, w, i)
    # Fast spins need several steps, as their precession is stiff
    parts = num_spin_steps(state[3], dt, MAX_PART_ROTATION)
    for _ in range(parts):
        state = _step_alone(state, speeds, rotors, dt / parts, around, row, wings, deflection, w, i)
    set_state(swarm, w, i, state)


class GroupPart(NamedTuple):
    """Drones of a group of worlds that one thread flies.

    Attributes:
        first: Index of the group's first world.
        last: Index after the group's last world.
        low: Index of the first drone, in all of these worlds.
        high: Index after the last drone.
        begin: Index of the first block.
        end: Index after the last block.
    """

    first: int
    last: int
    low: int
    high: int
    begin: int
    end: int


@func
def _mark(
    drones: DroneArrays,
    contact: ContactState,
    blocks: Blocks,
    tied: np.ndarray,
    part: GroupPart,
    dt: float,
) -> None:
    """Mark the drones to integrate in blocks, and those that sleep."""
    # Read the array addresses once: the compiler must assume that writes could change them
    alive, spin = drones.alive, drones.swarm.rates
    stopped, asleep = contact.stopped, contact.asleep
    together, alike, has_rotors = blocks.together, blocks.alike, blocks.has_rotors
    sleeping, resting = blocks.sleeping, blocks.resting
    drone = part.begin * WIDTH
    for w in range(part.first, part.last):
        for i in range(part.low, part.high):
            rates = vec3(spin, w, i)
            still = stopped[w, i] | asleep[w, i] | tied[w, i]
            calm = dot(rates, rates) * dt * dt < CALM * CALM
            # Branches would be slower
            flies = alive[w, i] & calm & (not still)
            rests = alive[w, i] & asleep[w, i] & (not (stopped[w, i] | tied[w, i]))
            fits = alike[drone // WIDTH] & has_rotors[drone]
            together[drone] = flies & fits
            resting[drone] = rests & fits & (count_panels(blocks.wings, w, i) == 0)
            sleeping[drone] = asleep[w, i]
            drone += 1
    for k in range(drone, part.end * WIDTH):
        blocks.together[k] = False
        blocks.resting[k] = False
    for b in range(part.begin, part.end):
        blocks.flown[b] = has_enough(blocks.together, b)
        has_enough(blocks.resting, b)


@func
def _steer_blocks(
    decision: Decision, contact: ContactState, blocks: Blocks, part: GroupPart
) -> None:
    """Run the controllers of blocks that are not integrated together, such as of tied drones."""
    alive, stopped, steered = decision.drones.alive, contact.stopped, blocks.steered
    num_drones, first, last = alive.shape[1], part.first, part.last
    for b in range(part.begin, part.end):
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
        drone, count = first * drones.alive.shape[1], blocks.packed.shape[0]
        pack_blocks(blocks, decision.air, drone, 0, count)
        pack_steering(blocks.steering, decision.setpoints, drone, 0, count)


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
    part = GroupPart(first, last, 0, decision.drones.alive.shape[1], 0, blocks.packed.shape[0])
    _sum_wakes(decision, blocks, first, last, substep)
    _fly_part(decision, contact, blocks, cables, part)
    _fly_rest(decision, contact, blocks, cables, part, True)
    for w in range(first, last):
        if cables.num_groups[w] > 0:
            fly_tied(decision, blocks, cables, contact, w, first)


@func
def _sum_wakes(decision: Decision, blocks: Blocks, first: int, last: int, substep: int) -> None:
    """Compute the wakes on the drones of some worlds, before any drone moves."""
    drones, substeps = decision.drones, decision.step.substeps
    if drones.alive.shape[1] > 1:
        leeway = LIST_SKIN if substeps > 1 else 0.0
        swarm, alive, parameters = drones.swarm, drones.alive, drones.parameters
        sum_wakes(swarm, alive, parameters, first, last, substep > 0, leeway, blocks.wakes)


@func
def _fly_part(
    decision: Decision, contact: ContactState, blocks: Blocks, cables: Cables, part: GroupPart
) -> None:
    """Fly one substep of drones that neither sleep nor are tied; they do not affect each other."""
    drones, setpoints, cascade = decision.drones, decision.setpoints, decision.cascade
    air, dt = decision.air, decision.step.dt
    swarm, alive, parameters = drones.swarm, drones.alive, drones.parameters
    num_drones, first = alive.shape[1], part.first
    _mark(drones, contact, blocks, cables.is_tied, part, dt)
    # Commands of the part are computed before any of its drones moves
    _steer_blocks(decision, contact, blocks, part)
    for w in range(first, part.last):
        save_start_state(contact, swarm, w, part.low, part.high)
        for i in range(part.low, part.high):
            if alive[w, i] and not contact.stopped[w, i]:
                drone = (w - first) * num_drones + i
                command = blocks.command[w - first, i]
                steered = blocks.steered[drone] or is_steered(blocks, drone)
                if not steered and parameters[w, i].num_rotors > 0:
                    command_rotors(cascade, setpoints, swarm, w, i, dt, air.gravity, command)
    for b in range(part.begin, part.end):
        if blocks.flown[b]:
            fly_block(blocks, first * num_drones, b, air.gravity, dt)
    _fly_rest(decision, contact, blocks, cables, part, False)


@kernel
def _fly_rest(
    decision: Decision,
    contact: ContactState,
    blocks: Blocks,
    cables: Cables,
    part: GroupPart,
    is_asleep: bool,
) -> None:
    """Fly drones one by one that are not in blocks: those that sleep, or all others.

    Drones that sleep come last, in their order, as a drone that wakes also wakes others.
    """
    alive, num_drones = decision.drones.alive, decision.drones.alive.shape[1]
    loaded = -1
    for w in range(part.first, part.last):
        for i in range(part.low, part.high):
            drone = (w - part.first) * num_drones + i
            if is_asleep and blocks.resting[drone] and drone // WIDTH != loaded:
                loaded = drone // WIDTH
                first = part.first * num_drones
                load_block(blocks, contact.support, first, loaded, decision.step.dt)
            moved = blocks.together[drone] or cables.is_tied[w, i]
            flies = alive[w, i] and not contact.stopped[w, i] and not moved
            if flies and blocks.sleeping[drone] == is_asleep:
                _fly_alone(decision, contact, blocks, part.first, w, i)


@kernel
def advance_rigid_body(
    begin: int,
    end: int,
    decision: Decision,
    contact: ContactState,
    blocks: Blocks,
    cables: Cables,
) -> None:
    """Fly all substeps of one decision in some groups of worlds.

    Args:
        begin: Index of the first group.
        end: Index after the last group.
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
    for group in range(begin, end):
        first = group * worlds
        last = min(first + worlds, drones.alive.shape[0])
        start_worlds(decision, blocks, first, last)
        for substep in range(step.substeps):
            fly_worlds(decision, contact, blocks, cables, first, last, substep)
            for w in range(first, last):
                hit = step_contacts(contact, drones, w, substep, step)
                if hit and cables.num_groups[w] > 0:
                    hold_tied(decision, cables, contact, w)


@kernel
def start_lags(decision: Decision, blocks: Blocks) -> None:
    """Write the decay factors of the rotor lag of a world, once a decision."""
    decision, blocks = in_memory(decision), in_memory(blocks)
    lag_stages(decision.drones.parameters, 0, decision.step.dt, blocks.decay[0])


@kernel
def start_blocks(begin: int, end: int, decision: Decision, blocks: Blocks) -> None:
    """Pack the blocks from `begin` to before `end` of a world, once a decision."""
    decision, blocks = in_memory(decision), in_memory(blocks)
    pack_blocks(blocks, decision.air, 0, begin, end)
    pack_steering(blocks.steering, decision.setpoints, 0, begin, end)


@kernel
def sum_first_wakes(decision: Decision, blocks: Blocks, skin: float, search: WakeSearch) -> None:
    """Compute the wakes of a world in the first substep, from the lists of all threads."""
    decision, blocks = in_memory(decision), in_memory(blocks)
    drones, wakes = decision.drones, blocks.wakes
    sum_listed_wakes(drones.swarm, drones.alive, drones.parameters, skin, wakes, search)


@kernel
def sum_world_wakes(decision: Decision, blocks: Blocks, substep: int) -> None:
    """Compute the wakes of a world in a substep."""
    decision, blocks = in_memory(decision), in_memory(blocks)
    _sum_wakes(decision, blocks, 0, 1, substep)


@kernel
def fly_blocks(
    begin: int,
    end: int,
    decision: Decision,
    contact: ContactState,
    cables: Cables,
    blocks: Blocks,
    found: np.ndarray,
) -> None:
    """Fly a substep of the drones in some blocks of a world, without contacts.

    Args:
        begin: Index of the first block.
        end: Index after the last block.
        decision: Inputs of the decision.
        contact: State of the contact solver.
        cables: Cables between the bodies.
        blocks: Blocks of the world, with scratch arrays of the thread.
        found: (2,) set to 1 if a drone's motion budget is used up, and if a drone sleeps.
    """
    decision, contact, cables = in_memory(decision), in_memory(contact), in_memory(cables)
    blocks = in_memory(blocks)
    drones, high = decision.drones, min(end * WIDTH, decision.drones.alive.shape[1])
    part = GroupPart(0, 1, begin * WIDTH, high, begin, end)
    _fly_part(decision, contact, blocks, cables, part)
    num_sleeping = 0
    for i in range(part.low, part.high):
        num_sleeping += blocks.sleeping[i]
    if num_sleeping > 0:
        found[1] = 1
    # Tied drones move later
    if cables.num_groups[0] == 0:
        dt = decision.step.dt
        if update_budgets(contact, drones.swarm, drones.alive, 0, dt, part.low, part.high):
            found[0] = 1


@kernel
def finish_substep(
    decision: Decision,
    contact: ContactState,
    cables: Cables,
    blocks: Blocks,
    found: np.ndarray,
    substep: int,
) -> None:
    """Fly the drones of a world that sleep or are tied, and resolve the contacts of a substep.

    Args:
        decision: Inputs of the decision.
        contact: State of the contact solver.
        cables: Cables between the bodies.
        blocks: Blocks of the world.
        found: (T, 8) what `fly_blocks` found on each thread; cleared.
        substep: Index of the substep in the decision.
    """
    decision, contact, cables = in_memory(decision), in_memory(contact), in_memory(cables)
    blocks = in_memory(blocks)
    drones, step = decision.drones, decision.step
    swarm, alive, asleep = drones.swarm, drones.alive, contact.asleep
    num_drones, is_found, is_any_asleep = alive.shape[1], False, False
    for thread in range(found.shape[0]):
        is_found |= found[thread, 0] > 0
        is_any_asleep |= found[thread, 1] > 0
        found[thread, 0] = found[thread, 1] = 0
    is_tied = cables.num_groups[0] > 0
    if is_any_asleep:
        part = GroupPart(0, 1, 0, num_drones, 0, blocks.packed.shape[0])
        _fly_rest(decision, contact, blocks, cables, part, True)
        for i in range(num_drones):
            # Drones that have just been woken were skipped as sleeping ones
            if not is_tied and blocks.sleeping[i] and not asleep[0, i]:
                is_found |= update_budgets(contact, swarm, alive, 0, step.dt, i, i + 1)
    if is_tied:
        fly_tied(decision, blocks, cables, contact, 0, 0)
        is_found |= update_budgets(contact, swarm, alive, 0, step.dt, 0, num_drones)
    if is_found and resolve_world(contact, drones, 0, substep, step) and is_tied:
        hold_tied(decision, cables, contact, 0)


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
    has_threads = True

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Find the groups of bodies that the restored cables connect; see the base class."""
        group_bodies(self.cables)

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps as one compiled call; see the base class.

        Several threads fly groups of worlds, or the blocks of a single world substep by substep.
        """
        if program.threads > 1 and decision.drones.alive.shape[0] == 1:
            self._add_blocks(program, decision)
            return
        contact, cables, own = self.contact, self.cables, []
        size = min(max(decision.drones.alive.size // program.threads, 1), DRONES)
        for _ in range(program.threads):
            own.append(
                (
                    contact,
                    Blocks.of(decision.drones, decision.cascade, decision.wings, size),
                    cables,
                )
            )
            contact, cables = contact.for_thread(), cables.for_thread()
        groups = -(-len(decision.drones.alive) // len(own[0][1].command))
        program.call(*program.shared(advance_rigid_body, groups, decision, own=own))

    def _add_blocks(self, program: Program, decision: Decision) -> None:
        """Add the substeps of a single world, whose blocks several threads fly."""
        blocks = [Blocks.of(decision.drones, decision.cascade, decision.wings)]
        blocks += [blocks[0].for_thread() for _ in range(1, program.threads)]
        found = np.zeros((program.threads, CACHE_LINE), dtype=np.int64)
        world = (decision, self.contact, self.cables)
        own, count = list(zip(blocks, found, strict=True)), len(blocks[0].packed)
        flight = program.shared(fly_blocks, count, *world, own=own)
        program.call(start_lags, decision, blocks[0])
        program.call(*program.shared(start_blocks, count, decision, blocks[0]))
        for substep in range(decision.step.substeps):
            if substep == 0 and decision.drones.alive.shape[1] >= MIN_POINTS:
                self._add_first_wakes(program, decision, blocks[0])
            else:
                program.call(sum_world_wakes, decision, blocks[0], substep)
            program.call(*flight)
            program.call(finish_substep, *world, blocks[0], found, substep)

    @staticmethod
    def _add_first_wakes(program: Program, decision: Decision, blocks: Blocks) -> None:
        """Add the wakes of the first substep of a single world; several threads list the pairs."""
        drones, num_drones = decision.drones, decision.drones.alive.shape[1]
        leeway = LIST_SKIN if decision.step.substeps > 1 else 0.0
        search = WakeSearch.of(num_drones)
        listed = (drones.swarm.position, *drones[1:], leeway, blocks.wakes, search)
        near = [(np.zeros(num_drones, dtype=np.int64),) for _ in range(program.threads)]
        program.call(start_pairs, *listed)
        program.call(*program.shared(list_pairs_of_drones, num_drones, *listed, own=near))
        program.call(sum_first_wakes, decision, blocks, leeway, search)
