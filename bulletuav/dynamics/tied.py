"""Flight of bodies that are tied by cables: RK4 of each group, with the tensions of its cables.

The wrenches of the drones are those of all other flights. In each stage of RK4 the tensions follow
from the equations of constrained motion (`tensions`). A step ends at the time at which a slack
cable becomes taut; an impulse then stops the growth of its length, so that energy is lost.
Rounding errors of lengths are corrected after each step.

Contacts are resolved after the substep, without the cables. Bodies that a contact moved are then
pulled back to where their cables allow.
"""

import math
from typing import Any

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.gather import four, gathered
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, lanes_of, lanes_row
from bulletuav.contact.contact_state import stays_asleep
from bulletuav.contact.contact_state import wake_drone as rouse
from bulletuav.dynamics.base import surroundings
from bulletuav.dynamics.blocks import FEWEST
from bulletuav.dynamics.integration import advance_state, slope_of, turn_rotors
from bulletuav.dynamics.tensions import (
    add_tensions,
    apply_impulses,
    correct_lengths,
    get_excess,
    get_rate,
    measure_cables,
    num_cables,
    pack_cables,
)
from bulletuav.geometry.rotation import Vec3, dot, minus, normalise_quaternion, plus, vec3
from bulletuav.vehicle.aerodynamics import num_lifted_rotors
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.swarm import State, get_state, set_state
from bulletuav.vehicle.wrench import make_surroundings, num_spin_steps

MAX_PART_ROTATION = 0.04
"""Maximum rotation of a tied body in one step of RK4, rad: errors of energy are then below 1e-7"""
LENGTH_TOLERANCE = 1e-9
"""Error of the length at which a slack cable counts as taut, m"""
MIN_RATE = 1e-9
"""Rate at which the ends of a slack cable may approach each other and count as at rest, m/s"""
MAX_EVENTS = 8
"""Number of times in a step at which cables become taut exactly; later ones are corrected after
it"""
MAX_BISECTIONS = 60
"""Maximum number of iterations in the search of such a time"""
MAX_CORRECTIONS = 20
"""Maximum number of corrections of lengths after a contact"""
MAX_DRIFT = 1e-3
"""Rate of the distance up to which a taut cable's rate is a rounding error, m/s"""


@func
def _read_state(array: np.ndarray, i: int) -> State:
    """Return the state of body i in an array such as `CableWork.now`."""
    b, lane = i // WIDTH, i % WIDTH
    return (
        (array[b, 0, lane], array[b, 1, lane], array[b, 2, lane]),
        (array[b, 9, lane], array[b, 10, lane], array[b, 11, lane], array[b, 12, lane]),
        (array[b, 3, lane], array[b, 4, lane], array[b, 5, lane]),
        (array[b, 6, lane], array[b, 7, lane], array[b, 8, lane]),
    )


@func
def _write_state(array: np.ndarray, i: int, state: State) -> None:
    """Set the state of body i, in the form of `_read_state`."""
    b, lane = i // WIDTH, i % WIDTH
    position, quaternion, velocity, rates = state
    for k in range(3):
        array[b, k, lane] = position[k]
        array[b, 3 + k, lane] = velocity[k]
        array[b, 6 + k, lane] = rates[k]
    for k in range(4):
        array[b, 9 + k, lane] = quaternion[k]


@func
def _read_block(array: np.ndarray, b: int) -> Any:
    """Return the states of block b in an array such as `CableWork.now`, as lanes."""
    one = lanes_of(array, b)
    position, velocity = (one[0], one[1], one[2]), (one[3], one[4], one[5])
    return position, (one[9], one[10], one[11], one[12]), velocity, (one[6], one[7], one[8])


@func
def _write_block(array: np.ndarray, b: int, state: Any) -> None:
    """Set the states of block b, in the form of `_read_block`."""
    one = lanes_of(array, b)
    position, quaternion, velocity, rates = state
    for k in range(3):
        one[k] = position[k]
        one[3 + k] = velocity[k]
        one[6 + k] = rates[k]
    for k in range(4):
        one[9 + k] = quaternion[k]


@func
def _read_rotors(numbers: np.ndarray, row: int, lane: int) -> Rotors:
    """Return the `Rotors` of one drone in an array such as `CableWork.rotors`."""
    torque = (numbers[row, 1, lane], numbers[row, 2, lane], numbers[row, 3, lane])
    return numbers[row, 0, lane], torque, numbers[row, 4, lane], numbers[row, 5, lane]


@func
def _slope(flight: Any, w: int, i: int, first: int, stage: int) -> State:
    """Return the slope of body i in `work.now` without cables, at the begin, middle or end."""
    decision, blocks, cables = flight
    work, row = cables.work, decision.drones.parameters[w, i]
    around = surroundings(decision.air, w, i, blocks.wakes.felt[w - first])
    index, lane = 3 * (i // WIDTH) + stage, i % WIDTH
    rotors = _read_rotors(work.rotors, index, lane)
    speed = work.speed[index, :, lane]
    return slope_of(
        _read_state(work.now, i), speed, rotors, around, work.lifted[i], row, None, None
    )


@kernel
def _set_block_slopes(flight: Any, b: int, stage: int) -> None:
    """Write the slopes of the drones of a block without cables, computed in SIMD lanes."""
    _, blocks, cables = flight
    work, first = cables.work, b * WIDTH
    held, numbers = lanes_of(blocks.held, b), lanes_of(work.rotors, 3 * b + stage)
    rotors = (numbers[0], (numbers[1], numbers[2], numbers[3]), numbers[4], numbers[5])
    wind, force = (held[0], held[1], held[2]), (held[4], held[5], held[6])
    torque, wake = (held[7], held[8], held[9]), four(blocks.wakes.felt, first)
    around = make_surroundings(wind, held[3], held[11], force, torque, wake)
    row = lanes_row(blocks.rows, blocks.packed, b)
    speed = lanes_of(work.speed, 3 * b + stage)
    now = _read_block(work.now, b)
    slope = slope_of(now, speed, rotors, around, work.lift[b], row, None, None)
    _write_block(work.slope, b, slope)


@kernel
def _choose_blocks(flight: Any, w: int, g: int) -> None:
    """Find the blocks of drones of a group whose slopes are computed together.

    The numbers of blocks count the drones of all worlds: with one world, those of the group, too.
    """
    decision, blocks, cables = flight
    work, parameters = cables.work, decision.drones.parameters
    is_alone = decision.drones.alive.shape[0] > 1
    for b in range(work.is_block.shape[0]):
        count, lifted, is_used = 0, 0, False
        for i in range(b * WIDTH, min((b + 1) * WIDTH, work.in_block.shape[0])):
            work.in_block[i] = False
        for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
            i = cables.member[w, m]
            is_used = is_used or i // WIDTH == b
            flies = parameters[w, i].num_rotors > 0 and not work.is_fixed[i]
            if i // WIDTH == b and flies:
                count += 1
                lifted = max(lifted, work.lifted[i])
                work.in_block[i] = True
        work.lift[b], work.is_used[b] = lifted, is_used
        work.is_block[b] = count >= FEWEST and blocks.alike[b] and not is_alone
        if not work.is_block[b]:
            for i in range(b * WIDTH, min((b + 1) * WIDTH, work.in_block.shape[0])):
                work.in_block[i] = False


@kernel
def _set_slopes(flight: Any, w: int, g: int, first: int, stage: int, weight: float) -> None:
    """Write the slopes of a group's bodies at their state in `work.now`, with all forces."""
    work, cables = flight[2].work, flight[2]
    for b in range(work.is_block.shape[0]):
        if work.is_block[b]:
            _set_block_slopes(flight, b, stage)
    still = (0.0, 0.0, 0.0)
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if work.is_fixed[i]:
            _write_state(work.slope, i, (still, (0.0, 0.0, 0.0, 0.0), still, still))
        elif not work.in_block[i]:
            _write_state(work.slope, i, _slope(flight, w, i, first, stage))
    add_tensions(cables, w, g, weight)


@kernel
def _load_group(cables: Any, swarm: Any, w: int, g: int) -> None:
    """Copy the state of a group's bodies to `work.now`."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        _write_state(cables.work.now, i, get_state(swarm, w, i))


@kernel
def _store_group(cables: Any, swarm: Any, w: int, g: int) -> None:
    """Copy the state of a group's bodies from `work.now`."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if not cables.work.is_fixed[i]:
            set_state(swarm, w, i, _read_state(cables.work.now, i))


@kernel
def _step_group(flight: Any, w: int, g: int, first: int, dt: float) -> None:
    """Advance the state of a group in `work.now` by a step of RK4; the swarm is unchanged."""
    cables = flight[2]
    work = cables.work
    for s in range(num_cables(cables, w, g)):
        work.pull[s] = 0.0
    for b in range(work.is_used.shape[0]):
        if work.is_used[b]:
            _write_block(work.begun, b, _read_block(work.now, b))
    # Stages at the begin, twice in the middle, and at the end: k1 + 2 k2 + 2 k3 + k4
    for k in range(4):
        share = 1.0 if k in (0, 3) else 2.0
        _set_slopes(flight, w, g, first, (k + 1) // 2, share * dt / 6.0)
        ahead = dt if k == 2 else 0.5 * dt
        for b in range(work.is_used.shape[0]):
            if work.is_used[b]:
                begun, slope = _read_block(work.begun, b), _read_block(work.slope, b)
                total = slope
                if k > 0:
                    total = advance_state(_read_block(work.total, b), share, slope)
                if k < 3:
                    _write_block(work.total, b, total)
                    _write_block(work.now, b, advance_state(begun, ahead, slope))
                else:
                    position, quaternion, velocity, rates = advance_state(begun, dt / 6.0, total)
                    state = (position, normalise_quaternion(quaternion), velocity, rates)
                    _write_block(work.now, b, state)


@func
def _measure_excess(cables: Any, w: int, g: int) -> float:
    """Return the largest distance of the ends of a group's slack cables beyond its length, m."""
    excess, size, first = -np.inf, num_cables(cables, w, g), cables.first_cable[w, g]
    is_measured = False
    for s in range(size):
        if not cables.is_taut[w, cables.cable[w, first + s]]:
            if not is_measured:
                measure_cables(cables.work, size)
                is_measured = True
            excess = max(excess, get_excess(cables, w, g, s))
    return excess


@kernel
def _find_event(flight: Any, w: int, g: int, first: int, dt: float, excess: float) -> float:
    """Find when the first slack cable becomes taut within a step, and integrate up to there.

    Args:
        flight: Decision, blocks and cables.
        w: Index of the world.
        g: Index of the group.
        first: First world of the blocks.
        dt: Duration of the step, s.
        excess: Excess of a length at the end of the step, above 0, m.

    Returns:
        Time after the beginning of the step, s; `work.now` has the state at that time.
    """
    decision, _, cables = flight
    low, high, after = 0.0, dt, excess
    _load_group(cables, decision.drones.swarm, w, g)
    before = min(_measure_excess(cables, w, g), -LENGTH_TOLERANCE * LENGTH_TOLERANCE)
    time = dt
    for k in range(MAX_BISECTIONS):
        # Regula falsi; bisection now and then, where one end would stay
        time = low - before * (high - low) / (after - before)
        if k % 3 == 2:
            time = 0.5 * (low + high)
        _load_group(cables, decision.drones.swarm, w, g)
        _step_group(flight, w, g, first, time)
        found = _measure_excess(cables, w, g)
        if abs(found) <= 0.5 * LENGTH_TOLERANCE:
            break
        if found > 0.0:
            high, after = time, found
        else:
            low, before = time, found
    return time


@func
def _tighten(flight: Any, contact: Any, w: int, g: int) -> bool:
    """Make cables of a group taut whose ends part at its length, and stop that by impulses.

    Returns:
        True if a cable became taut.
    """
    decision, _, cables = flight
    work, size, first = cables.work, num_cables(cables, w, g), cables.first_cable[w, g]
    any_slack = any_new = any_woken = False
    for s in range(size):
        any_slack = any_slack or not cables.is_taut[w, cables.cable[w, first + s]]
    if not any_slack:
        return False
    measure_cables(work, size)
    for s in range(size):
        c = cables.cable[w, first + s]
        # Ends at rest relative to each other may be about to part
        parts = get_rate(work, s) > -MIN_RATE
        is_long = get_excess(cables, w, g, s) >= -LENGTH_TOLERANCE
        if parts and is_long and not cables.is_taut[w, c]:
            cables.is_taut[w, c] = work.pulls[s] = any_new = True
            for end in range(2):
                body = cables.body[w, c, end]
                if body >= 0 and contact.asleep[w, body]:
                    rouse(contact, w, body)
                    work.is_fixed[body] = contact.stopped[w, body]
                    any_woken = True
    if any_woken:
        pack_cables(cables, decision.drones.parameters, w, g)
        _choose_blocks(flight, w, g)
    if any_new:
        apply_impulses(cables, w, g)
    return any_new


@kernel
def _finish_step(flight: Any, contact: Any, w: int, g: int) -> None:
    """Correct lengths and rates after a step, and find the cables that become slack or taut."""
    cables = flight[2]
    work, size, first = cables.work, num_cables(cables, w, g), cables.first_cable[w, g]
    any_taut = False
    for s in range(size):
        c = cables.cable[w, first + s]
        if cables.is_taut[w, c]:
            if not any_taut:
                measure_cables(work, size)
                any_taut = True
            rate, is_long = get_rate(work, s), get_excess(cables, w, g, s) > 0.0
            # Without tension, or with ends that approach each other, the cable is slack
            stays = work.pulls[s] and rate > -MAX_DRIFT
            cables.is_taut[w, c] = work.pulls[s] = stays or (is_long and rate > 0.0)
    if any_taut:
        correct_lengths(cables, w, g, True, MAX_CORRECTIONS)
    _tighten(flight, contact, w, g)


@func
def _record_tension(cables: Any, w: int, g: int, dt: float) -> None:
    """Add the impulses of a step to the mean tensions of a substep of `dt`, s."""
    for s in range(num_cables(cables, w, g)):
        c = cables.cable[w, cables.first_cable[w, g] + s]
        cables.tension[w, c] += max(cables.work.pull[s], 0.0) / dt
        cables.work.pull[s] = 0.0


@kernel
def _advance_group(flight: Any, contact: Any, w: int, g: int, first: int, dt: float) -> None:
    """Integrate a group over a step, up to each time at which a cable becomes taut."""
    decision, _, cables = flight
    swarm, substep = decision.drones.swarm, decision.step.dt
    left = dt
    for s in range(num_cables(cables, w, g)):
        c = cables.cable[w, cables.first_cable[w, g] + s]
        cables.work.pulls[s] = cables.is_taut[w, c]
        cables.work.pull[s] = 0.0
    _load_group(cables, swarm, w, g)
    if _tighten(flight, contact, w, g):
        _record_tension(cables, w, g, substep)
        _store_group(cables, swarm, w, g)
    for event in range(MAX_EVENTS + 1):
        if event > 0:
            _load_group(cables, swarm, w, g)
        _step_group(flight, w, g, first, left)
        excess = _measure_excess(cables, w, g)
        time = left
        if excess > 0.5 * LENGTH_TOLERANCE and event < MAX_EVENTS:
            time = _find_event(flight, w, g, first, left, excess)
        _finish_step(flight, contact, w, g)
        if excess > 0.5 * LENGTH_TOLERANCE and event == MAX_EVENTS:
            correct_lengths(cables, w, g, False, MAX_CORRECTIONS)
        _record_tension(cables, w, g, substep)
        _store_group(cables, swarm, w, g)
        left -= time
        if left <= 0.0:
            return


@func
def _sum_pulls(cables: Any, w: int, g: int, i: int) -> tuple[Vec3, Vec3]:
    """Return the force (world axes) and torque (body axes) of the tensions in `work.pull`."""
    work = cables.work
    force = torque = (0.0, 0.0, 0.0)
    for s in range(num_cables(cables, w, g)):
        c = cables.cable[w, cables.first_cable[w, g] + s]
        for end in range(2):
            if cables.is_taut[w, c] and cables.body[w, c, end] == i:
                push = work.push[2 * (s // WIDTH) + end, :, s % WIDTH]
                force = plus(force, work.pull[s], (push[0], push[1], push[2]))
                torque = plus(torque, work.pull[s], (push[3], push[4], push[5]))
    return force, torque


@kernel
def _wake_group(flight: Any, contact: Any, w: int, g: int, first: int, dt: float) -> None:
    """Wake the sleeping bodies of a group that their cables and forces would move."""
    decision, _, cables = flight
    work, parameters = cables.work, decision.drones.parameters
    _load_group(cables, decision.drones.swarm, w, g)
    for s in range(num_cables(cables, w, g)):
        work.pull[s] = 0.0
    # The tensions on bodies that stay at rest
    _set_slopes(flight, w, g, first, 0, 1.0)
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if not contact.asleep[w, i]:
            continue
        row = parameters[w, i]
        force, torque = _sum_pulls(cables, w, g, i)
        _, _, pull, spinning = _slope(flight, w, i, first, 0)
        pull = plus(pull, 1.0 / row.mass, force)
        spinning = (
            spinning[0] + torque[0] / row.inertia[0],
            spinning[1] + torque[1] / row.inertia[1],
            spinning[2] + torque[2] / row.inertia[2],
        )
        if not stays_asleep(contact, w, i, _read_state(work.now, i)[1], pull, spinning, row, dt):
            rouse(contact, w, i)
    _prepare_group(flight, contact, w, g)


@func
def _fix_bodies(flight: Any, contact: Any, w: int, g: int) -> bool:
    """Find the bodies of a group that do not move in the substep; return True if any sleeps."""
    decision, _, cables = flight
    any_asleep = False
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        stands = contact.stopped[w, i] or not decision.drones.alive[w, i]
        cables.work.is_fixed[i] = stands or contact.asleep[w, i]
        any_asleep = any_asleep or contact.asleep[w, i]
    pack_cables(cables, decision.drones.parameters, w, g)
    return any_asleep


@func
def _prepare_group(flight: Any, contact: Any, w: int, g: int) -> bool:
    """Find the bodies that do not move and the blocks; return True if any body sleeps."""
    any_asleep = _fix_bodies(flight, contact, w, g)
    _choose_blocks(flight, w, g)
    return any_asleep


@func
def _count_steps(flight: Any, w: int, g: int) -> int:
    """Find the ground effect of a group in a substep; return the number of steps of RK4."""
    decision, _, cables = flight
    swarm, air, dt = decision.drones.swarm, decision.air, decision.step.dt
    parts = 1
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        height = swarm.position[w, i, 2] - air.surface[w, i]
        row = decision.drones.parameters[w, i]
        cables.work.lifted[i] = num_lifted_rotors(height, swarm.velocity[w, i, 2], dt, row)
        parts = max(parts, num_spin_steps(vec3(swarm.rates, w, i), dt, MAX_PART_ROTATION))
    return parts


@kernel
def _turn_block_rotors(flight: Any, w: int, g: int, b: int) -> None:
    """Advance the rotors of a group's drones in a block by a substep, in SIMD lanes."""
    decision, blocks, cables = flight
    work, swarm = cables.work, decision.drones.swarm
    speed, command = lanes_of(blocks.rotors, 0), lanes_of(blocks.rotors, 1)
    row = lanes_row(blocks.rows, blocks.packed, b)
    for r in range(row.num_rotors):
        speed[r] = gathered(swarm.rotor_speed, b * WIDTH, r)
        command[r] = gathered(blocks.command, b * WIDTH, r)
    speeds = (
        lanes_of(work.speed, 3 * b),
        lanes_of(work.speed, 3 * b + 1),
        lanes_of(work.speed, 3 * b + 2),
    )
    motors = (lanes_of(blocks.held, b)[10], lanes_of(blocks.ratio, b))
    rotors = turn_rotors(speed, command, *motors, lanes_of(blocks.lag, b), row, speeds)
    for k in range(3):
        thrust, torque, total, momentum = rotors[k]
        numbers = lanes_of(work.rotors, 3 * b + k)
        numbers[0], numbers[4], numbers[5] = thrust, total, momentum
        numbers[1], numbers[2], numbers[3] = torque[0], torque[1], torque[2]
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if i // WIDTH == b and work.in_block[i]:
            for r in range(row.num_rotors):
                swarm.rotor_speed[w, i, r] = blocks.rotors[0, r, i % WIDTH]


@kernel
def _turn_group_rotors(flight: Any, w: int, g: int, first: int) -> None:
    """Advance the rotors of a group by a substep."""
    decision, blocks, cables = flight
    swarm, air, work = decision.drones.swarm, decision.air, cables.work
    for b in range(work.is_block.shape[0]):
        if work.is_block[b]:
            _turn_block_rotors(flight, w, g, b)
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if work.in_block[i]:
            continue
        index, lane = 3 * (i // WIDTH), i % WIDTH
        speeds = (
            work.speed[index, :, lane],
            work.speed[index + 1, :, lane],
            work.speed[index + 2, :, lane],
        )
        motors = (air.supply[w, i], air.rotor_ratio[w, i])
        command, decay = blocks.command[w - first, i], blocks.decay[w - first, i]
        row = decision.drones.parameters[w, i]
        rotors = turn_rotors(swarm.rotor_speed[w, i], command, *motors, decay, row, speeds)
        for k in range(3):
            thrust, torque, total, momentum = rotors[k]
            numbers = (thrust, torque[0], torque[1], torque[2], total, momentum)
            for r in range(6):
                work.rotors[index + k, r, lane] = numbers[r]


@deferred(types.none)
@kernel
def fly_tied(decision: Any, blocks: Any, cables: Any, contact: Any, w: int, first: int) -> None:
    """Integrate all bodies of a world that are tied by cables over a substep.

    Args:
        decision: `Decision`; the swarm is updated.
        blocks: `Blocks` with commands, decay factors and wakes of the substep.
        cables: `Cables`; tensions are written.
        contact: `ContactState`; sleeping bodies that cables move are woken.
        w: Index of the world.
        first: First world of the group of worlds in `blocks`.
    """
    flight = (decision, blocks, cables)
    dt = decision.step.dt
    for c in range(cables.length.shape[1]):
        cables.tension[w, c] = 0.0
    for g in range(cables.num_groups[w]):
        parts = _count_steps(flight, w, g)
        any_asleep = _prepare_group(flight, contact, w, g)
        _turn_group_rotors(flight, w, g, first)
        if any_asleep:
            _wake_group(flight, contact, w, g, first, dt)
        for _ in range(parts):
            _advance_group(flight, contact, w, g, first, dt / parts)


@func
def _spend_budgets(cables: Any, contact: Any, swarm: Any, w: int, g: int) -> None:
    """Subtract the motion of bodies by corrections from their budgets of the contact solver."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        moved = minus(_read_state(cables.work.now, i)[0], vec3(swarm.position, w, i))
        contact.budget[w, i] -= math.sqrt(dot(moved, moved))


@deferred(types.none)
@kernel
def hold_tied(decision: Any, cables: Any, contact: Any, w: int) -> None:
    """Restore the lengths of cables in a world whose bodies were moved by contacts.

    Args:
        decision: `Decision`; the swarm is updated.
        cables: `Cables`; impulses are added to the tensions.
        contact: `ContactState`, whose budgets are reduced.
        w: Index of the world.
    """
    swarm, work = decision.drones.swarm, cables.work
    flight = (decision, decision, cables)
    for g in range(cables.num_groups[w]):
        is_moved = False
        for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
            i = cables.member[w, m]
            is_moved = is_moved or contact.changed[w, i]
        if not is_moved:
            continue
        _load_group(cables, swarm, w, g)
        _fix_bodies(flight, contact, w, g)
        size, is_long = num_cables(cables, w, g), False
        measure_cables(work, size)
        for s in range(size):
            work.pull[s] = 0.0
            # Shorter cables stay as they are
            long = get_excess(cables, w, g, s) >= -LENGTH_TOLERANCE
            c = cables.cable[w, cables.first_cable[w, g] + s]
            cables.is_taut[w, c] = work.pulls[s] = long
            is_long = is_long or long
        if not is_long:
            continue
        correct_lengths(cables, w, g, False, MAX_CORRECTIONS)
        apply_impulses(cables, w, g)
        _record_tension(cables, w, g, decision.step.dt)
        _spend_budgets(cables, contact, swarm, w, g)
        _store_group(cables, swarm, w, g)
