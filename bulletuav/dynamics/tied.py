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
from bulletuav.compiled.gather import four, three
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
    measure_cable,
)
from bulletuav.geometry.rotation import (
    Vec3,
    dot,
    minus,
    normalise_quaternion,
    plus,
    quat4,
    vec3,
)
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
STILL: State = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Slope of a body that does not move"""


@func
def _store_rotors(numbers: np.ndarray, rotors: Rotors) -> None:
    """Write the numbers of `Rotors` to an array (6,)."""
    thrust, torque, total, momentum = rotors
    numbers[0], numbers[4], numbers[5] = thrust, total, momentum
    for k in range(3):
        numbers[1 + k] = torque[k]


@func
def _load_rotors(numbers: np.ndarray) -> Rotors:
    """Return the `Rotors` of an array (6,)."""
    return numbers[0], (numbers[1], numbers[2], numbers[3]), numbers[4], numbers[5]


@func
def _slope(flight: Any, w: int, i: int, first: int, stage: int) -> State:
    """Return the slope of body i in `work.now` without cables, at the begin, middle or end."""
    decision, blocks, cables = flight
    work, row = cables.work, decision.drones.parameters[w, i]
    around = surroundings(decision.air, w, i, blocks.wakes.felt[w - first])
    state, rotors = get_state(work.now, 0, i), _load_rotors(work.rotors[i, stage])
    return slope_of(state, work.speed[i, stage], rotors, around, work.lifted[i], row)


@kernel
def _set_block_slopes(flight: Any, w: int, b: int, stage: int) -> None:
    """Write the slopes of the drones of a block without cables, computed in SIMD lanes."""
    _, blocks, cables = flight
    work, first = cables.work, b * WIDTH
    held, numbers = lanes_of(blocks.held, b), lanes_of(work.lane_rotors, 3 * b + stage)
    rotors = (numbers[0], (numbers[1], numbers[2], numbers[3]), numbers[4], numbers[5])
    state = (
        three(work.now.position, first),
        four(work.now.quaternion, first),
        three(work.now.velocity, first),
        three(work.now.rates, first),
    )
    wind, force = (held[0], held[1], held[2]), (held[4], held[5], held[6])
    torque, wake = (held[7], held[8], held[9]), four(blocks.wakes.felt, first)
    around = make_surroundings(wind, held[3], held[11], force, torque, wake)
    row = lanes_row(blocks.rows, blocks.packed, b)
    speed = lanes_of(work.lane_speed, 3 * b + stage)
    moving, turning, pull, spinning = slope_of(state, speed, rotors, around, work.lane_lift[b], row)
    slope = lanes_of(work.lane_slope, 0)
    for k in range(3):
        slope[k], slope[7 + k], slope[10 + k] = moving[k], pull[k], spinning[k]
    for k in range(4):
        slope[3 + k] = turning[k]
    one = work.lane_slope
    for lane in range(min(WIDTH, work.in_block.shape[0] - first)):
        i = first + lane
        if work.in_block[i]:
            for k in range(3):
                work.slope.position[0, i, k] = one[k, lane]
                work.slope.velocity[0, i, k] = one[7 + k, lane]
                work.slope.rates[0, i, k] = one[10 + k, lane]
            for k in range(4):
                work.slope.quaternion[0, i, k] = one[3 + k, lane]


@kernel
def _choose_blocks(flight: Any, w: int, g: int) -> None:
    """Find the blocks of drones of a group whose slopes are computed together.

    The numbers of blocks count the drones of all worlds: with one world, those of the group, too.
    """
    decision, blocks, cables = flight
    work = cables.work
    is_alone = decision.drones.alive.shape[0] > 1
    for b in range(work.is_block.shape[0]):
        count, lifted = 0, 0
        for i in range(b * WIDTH, min((b + 1) * WIDTH, work.in_block.shape[0])):
            work.in_block[i] = False
        for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
            i = cables.member[w, m]
            if i // WIDTH == b and not work.is_fixed[i]:
                count += 1
                lifted = max(lifted, work.lifted[i])
        work.lane_lift[b] = lifted
        work.is_block[b] = count >= FEWEST and blocks.alike[b] and not is_alone
        if work.is_block[b]:
            for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
                i = cables.member[w, m]
                work.in_block[i] = work.in_block[i] or (i // WIDTH == b and not work.is_fixed[i])


@kernel
def _set_slopes(flight: Any, w: int, g: int, first: int, stage: int, weight: float) -> None:
    """Write the slopes of a group's bodies at their state in `work.now`, with all forces."""
    decision, _, cables = flight
    work = cables.work
    for b in range(work.is_block.shape[0]):
        if work.is_block[b]:
            _set_block_slopes(flight, w, b, stage)
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if not work.in_block[i]:
            slope = STILL if work.is_fixed[i] else _slope(flight, w, i, first, stage)
            set_state(work.slope, 0, i, slope)
    add_tensions(cables, decision.drones.parameters, w, g, weight)


@kernel
def _load_group(cables: Any, swarm: Any, w: int, g: int) -> None:
    """Copy the state of a group's bodies to `work.now`."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        set_state(cables.work.now, 0, i, get_state(swarm, w, i))


@kernel
def _store_group(cables: Any, swarm: Any, w: int, g: int) -> None:
    """Copy the state of a group's bodies from `work.now`."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        if not cables.work.is_fixed[i]:
            set_state(swarm, w, i, get_state(cables.work.now, 0, i))


@kernel
def _step_group(flight: Any, w: int, g: int, first: int, dt: float) -> None:
    """Write the state of a group after a step of RK4 into `work.now`; the swarm is unchanged."""
    decision, _, cables = flight
    work, swarm = cables.work, decision.drones.swarm
    begin, end = cables.first_member[w, g], cables.first_member[w, g + 1]
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        work.pull[cables.cable[w, m]] = 0.0
    _load_group(cables, swarm, w, g)
    # Stages at the begin, twice in the middle, and at the end: k1 + 2 k2 + 2 k3 + k4
    for k in range(4):
        share = 1.0 if k in (0, 3) else 2.0
        _set_slopes(flight, w, g, first, (k + 1) // 2, share * dt / 6.0)
        ahead = dt if k == 2 else 0.5 * dt
        for m in range(begin, end):
            i = cables.member[w, m]
            slope = get_state(work.slope, 0, i)
            total = slope if k == 0 else advance_state(get_state(work.total, 0, i), share, slope)
            set_state(work.total, 0, i, total)
            if k < 3:
                set_state(work.now, 0, i, advance_state(get_state(swarm, w, i), ahead, slope))
    for m in range(begin, end):
        i = cables.member[w, m]
        state = advance_state(get_state(swarm, w, i), dt / 6.0, get_state(work.total, 0, i))
        position, quaternion, velocity, rates = state
        set_state(work.now, 0, i, (position, normalise_quaternion(quaternion), velocity, rates))


@func
def _measure_excess(flight: Any, w: int, g: int) -> float:
    """Return the largest distance of the ends of a group's slack cables beyond its length, m."""
    decision, _, cables = flight
    excess = -np.inf
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        if not cables.is_taut[w, c]:
            measure_cable(cables, decision.drones.parameters, w, c)
            excess = max(excess, cables.work.reach[c] - cables.length[w, c])
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
    low, high, before, after = 0.0, dt, 0.0, excess
    _load_group(flight[2], flight[0].drones.swarm, w, g)
    before = min(_measure_excess(flight, w, g), -LENGTH_TOLERANCE * LENGTH_TOLERANCE)
    time = dt
    for k in range(MAX_BISECTIONS):
        # Regula falsi; bisection now and then, where one end would stay
        time = low - before * (high - low) / (after - before)
        if k % 3 == 2:
            time = 0.5 * (low + high)
        _step_group(flight, w, g, first, time)
        found = _measure_excess(flight, w, g)
        if abs(found) <= 0.5 * LENGTH_TOLERANCE:
            break
        if found > 0.0:
            high, after = time, found
        else:
            low, before = time, found
    return time


@func
def _tighten(flight: Any, contact: Any, w: int, g: int) -> None:
    """Make cables of a group taut whose ends part at its length, and stop that by impulses."""
    decision, _, cables = flight
    work, parameters = cables.work, decision.drones.parameters
    any_new = False
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        if cables.is_taut[w, c]:
            continue
        measure_cable(cables, parameters, w, c)
        # Ends at rest relative to each other may be about to part
        parts = work.rate[c] > -MIN_RATE
        if parts and work.reach[c] >= cables.length[w, c] - LENGTH_TOLERANCE:
            cables.is_taut[w, c] = work.pulls[c] = any_new = True
            for end in range(2):
                body = cables.body[w, c, end]
                if body >= 0 and contact.asleep[w, body]:
                    rouse(contact, w, body)
                    work.is_fixed[body] = contact.stopped[w, body]
    if any_new:
        apply_impulses(cables, parameters, w, g)


@kernel
def _finish_step(flight: Any, contact: Any, w: int, g: int) -> None:
    """Correct lengths and rates after a step, and find the cables that become slack or taut."""
    decision, _, cables = flight
    work, parameters = cables.work, decision.drones.parameters
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        if not cables.is_taut[w, c]:
            continue
        measure_cable(cables, parameters, w, c)
        long = work.reach[c] > cables.length[w, c]
        # Without tension, or with ends that approach each other, the cable is slack
        stays = work.pulls[c] and work.rate[c] > -MAX_DRIFT
        cables.is_taut[w, c] = work.pulls[c] = stays or (long and work.rate[c] > 0.0)
    correct_lengths(cables, parameters, w, g, True, MAX_CORRECTIONS)
    _tighten(flight, contact, w, g)


@func
def _record_tension(cables: Any, w: int, g: int, dt: float) -> None:
    """Add the impulses of a step to the mean tensions of a substep of `dt`, s."""
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        cables.tension[w, c] += max(cables.work.pull[c], 0.0) / dt
        cables.work.pull[c] = 0.0


@kernel
def _advance_group(flight: Any, contact: Any, w: int, g: int, first: int, dt: float) -> None:
    """Integrate a group over a step, up to each time at which a cable becomes taut."""
    decision, _, cables = flight
    swarm, substep = decision.drones.swarm, decision.step.dt
    left = dt
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        cables.work.pulls[c] = cables.is_taut[w, c]
        cables.work.pull[c] = 0.0
    _load_group(cables, swarm, w, g)
    _tighten(flight, contact, w, g)
    _record_tension(cables, w, g, substep)
    _store_group(cables, swarm, w, g)
    for event in range(MAX_EVENTS + 1):
        _step_group(flight, w, g, first, left)
        excess = _measure_excess(flight, w, g)
        time = left
        if excess > 0.5 * LENGTH_TOLERANCE and event < MAX_EVENTS:
            time = _find_event(flight, w, g, first, left, excess)
        _finish_step(flight, contact, w, g)
        if excess > 0.5 * LENGTH_TOLERANCE and event == MAX_EVENTS:
            correct_lengths(cables, decision.drones.parameters, w, g, False, MAX_CORRECTIONS)
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
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        for end in range(2):
            if cables.is_taut[w, c] and cables.body[w, c, end] == i:
                push = work.push[c, end]
                force = plus(force, work.pull[c], (push[0], push[1], push[2]))
                torque = plus(torque, work.pull[c], (push[3], push[4], push[5]))
    return force, torque


@kernel
def _wake_group(flight: Any, contact: Any, w: int, g: int, first: int, dt: float) -> None:
    """Wake the sleeping bodies of a group that their cables and forces would move."""
    decision, _, cables = flight
    work, parameters = cables.work, decision.drones.parameters
    _load_group(cables, decision.drones.swarm, w, g)
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        work.pull[cables.cable[w, m]] = 0.0
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
        if not stays_asleep(
            contact, w, i, quat4(work.now.quaternion, 0, i), pull, spinning, row, dt
        ):
            rouse(contact, w, i)
    _fix_bodies(flight, contact, w, g)
    _choose_blocks(flight, w, g)


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
    return any_asleep


@func
def _turn_group_rotors(flight: Any, w: int, g: int, first: int) -> int:
    """Advance the rotors of a group by a substep; return the number of steps of RK4."""
    decision, blocks, cables = flight
    swarm, air, dt, work = decision.drones.swarm, decision.air, decision.step.dt, cables.work
    parts = 1
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        row = decision.drones.parameters[w, i]
        speed = work.speed[i]
        speeds = (speed[0], speed[1], speed[2])
        motors = (air.supply[w, i], air.rotor_ratio[w, i])
        command, decay = blocks.command[w - first, i], blocks.decay[w - first, i]
        rotors = turn_rotors(swarm.rotor_speed[w, i], command, *motors, decay, row, speeds)
        block, lane = i // WIDTH, i % WIDTH
        for k in range(3):
            _store_rotors(work.rotors[i, k], rotors[k])
            for r in range(6):
                work.lane_rotors[3 * block + k, r, lane] = work.rotors[i, k, r]
            for r in range(row.num_rotors):
                work.lane_speed[3 * block + k, r, lane] = speed[k, r]
        height = swarm.position[w, i, 2] - air.surface[w, i]
        work.lifted[i] = num_lifted_rotors(height, swarm.velocity[w, i, 2], dt, row)
        parts = max(parts, num_spin_steps(vec3(swarm.rates, w, i), dt, MAX_PART_ROTATION))
    return parts


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
        parts = _turn_group_rotors(flight, w, g, first)
        any_asleep = _fix_bodies(flight, contact, w, g)
        _choose_blocks(flight, w, g)
        if any_asleep:
            _wake_group(flight, contact, w, g, first, dt)
        for _ in range(parts):
            _advance_group(flight, contact, w, g, first, dt / parts)


@func
def _spend_budgets(cables: Any, contact: Any, swarm: Any, w: int, g: int) -> None:
    """Subtract the motion of bodies by corrections from their budgets of the contact solver."""
    for m in range(cables.first_member[w, g], cables.first_member[w, g + 1]):
        i = cables.member[w, m]
        moved = minus(vec3(cables.work.now.position, 0, i), vec3(swarm.position, w, i))
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
    swarm, parameters = decision.drones.swarm, decision.drones.parameters
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
        is_long = False
        for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
            c = cables.cable[w, m]
            cables.work.pull[c] = 0.0
            measure_cable(cables, parameters, w, c)
            # Shorter cables stay as they are
            long = cables.work.reach[c] >= cables.length[w, c] - LENGTH_TOLERANCE
            cables.is_taut[w, c] = cables.work.pulls[c] = long
            is_long = is_long or long
        if not is_long:
            continue
        correct_lengths(cables, parameters, w, g, False, MAX_CORRECTIONS)
        apply_impulses(cables, parameters, w, g)
        _record_tension(cables, w, g, decision.step.dt)
        _spend_budgets(cables, contact, swarm, w, g)
        _store_group(cables, swarm, w, g)
