"""Contacts of one world within a substep, in order of time.

A substep is flown without contacts first. Drones that would touch something are then advanced to
the time of impact; all drones that are connected by contacts at that time (an island) are solved
together; and they move on for the remaining substep. Shapes closer than `CONTACT_DISTANCE` are in
contact, so that they do not overlap.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.contact.broad_phase import (
    PAIR_MARGIN,
    are_swept_bounds_apart,
    collect_pairs,
    fill_pair_grid,
)
from bulletuav.contact.clamping import stop_at_contact
from bulletuav.contact.contact_log import ContactLog
from bulletuav.contact.impact import apply_forces, resolve_impact
from bulletuav.contact.islands import add_to_island
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld
from bulletuav.contact.motion import (
    compute_path_displacement,
    compute_path_rates,
    get_segment_end,
    is_at_impact_limit,
    read_vec3,
    start_motion,
    start_segment,
    write_end_state,
    write_vec3,
)
from bulletuav.contact.motion_bounds import (
    are_bounds_clear,
    compute_budget,
    share_budgets,
    share_budgets_in_grid,
    uses_grid,
)
from bulletuav.contact.sorting import sort_drones, write_ranks
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE, NO_IMPACT, find_time_of_impact
from bulletuav.geometry.grid import clear_grid
from bulletuav.geometry.rotation import dot, minus, plus, vec3
from bulletuav.vehicle.swarm import Swarm


@deferred(types.none)
@kernel
def _start_drone_motion(space: ContactWorkspace, world: ContactWorld, end: Swarm, i: int) -> None:
    """Start the motion of a drone that may touch something, unless it is started already."""
    if i < world.scenery.first_body and not space.motions[i].is_started:
        row = world.parameters[world.w, i]
        start_motion(space.motions[i], world.start, end, world.w, i, row, world.dt)
        space.motions[i].is_static = world.asleep[world.w, i]
        for k in range(3):
            space.motions[i].load[0, k] = space.motions[i].load[1, k] = 0.0


@func
def _is_pair_finished(space: ContactWorkspace, world: ContactWorld, pair: np.record) -> bool:
    """Check whether a pair needs no further time of impact in this substep.

    Drones at the impact limit are clamped, or move with an obstacle, and carry other such drones
    that they touch. Pairs of such bodies are finished unless one moves relative to the
    other. A drone that moves with an obstacle is not tested against other obstacles.
    """
    motions = space.motions
    if not is_at_impact_limit(motions[pair.a]):
        return False
    if pair.b < motions.shape[0] and not is_at_impact_limit(motions[pair.b]):
        return False
    if world.stops:
        return True
    move_a, _ = compute_path_rates(world.scenery, motions, world.w, pair.a, world.dt)
    move_b = compute_path_displacement(world.scenery, motions, world.w, pair.b, pair.a, world.dt)
    relative = minus(move_a, move_b)
    is_carried = pair.b >= motions.shape[0] and move_a != (0.0, 0.0, 0.0)
    return is_carried or dot(relative, relative) < CONTACT_DISTANCE * CONTACT_DISTANCE


@kernel
def _update_time_of_impact(
    space: ContactWorkspace, world: ContactWorld, pair: np.record, start: float
) -> None:
    """Find the next time of impact of a pair."""
    motions = space.motions
    pair.impact_time = NO_IMPACT
    pair.is_segment_end = False
    pair.in_contact = False
    if _is_pair_finished(space, world, pair):
        return
    if not are_swept_bounds_apart(world.scenery, motions, world.w, pair.a, pair.b, world.dt):
        pair.impact_time, normal, pair.in_contact = find_time_of_impact(
            world.scenery,
            motions,
            world.w,
            pair.a,
            pair.b,
            start,
            pair.target_distance,
            pair.has_touched,
            world.dt,
            read_vec3(pair.normal),
            space.scratch,
            world.stops,
        )
        write_vec3(pair.normal, normal)
    if pair.impact_time == NO_IMPACT:
        end = get_segment_end(world.scenery, motions, pair.a)
        end = min(end, get_segment_end(world.scenery, motions, pair.b))
        if end < 1.0:
            pair.impact_time = end
            pair.is_segment_end = True


@func
def _update_pairs(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    num_pairs: int,
    time: float,
    only_island: bool,
) -> int:
    """Update the times of impact of all pairs, or of those with drones of the present island.

    Returns:
        The pair with the earliest event (the first of several), or -1 if there is none.
    """
    motions = space.motions
    first = -1
    earliest = NO_IMPACT
    for p in range(num_pairs):
        pair = pairs[p]
        if (
            not only_island
            or motions[pair.a].in_island
            or (pair.b < motions.shape[0] and motions[pair.b].in_island)
        ):
            _update_time_of_impact(space, world, pair, time)
        if pair.impact_time < earliest:
            first = p
            earliest = pair.impact_time
    return first


@func
def _compute_distance(one: np.ndarray, two: np.ndarray, w: int, i: int) -> float:
    """Return the distance of drone i in one array (W, N, 3) from its position in another, m."""
    displacement = minus(vec3(one, w, i), vec3(two, w, i))
    return math.sqrt(dot(displacement, displacement))


@func
def _set_ranges(
    space: ContactWorkspace, world: ContactWorld, end: Swarm, budget: np.ndarray
) -> None:
    """Set how far drones move in the substep, and which of them have to be checked (`is_due`).

    A drone has to be checked if its budget is used up, or would be after one more such substep: one
    check then serves both.
    """
    w = world.w
    for i in range(budget.shape[1]):
        motion = space.motions[i]
        motion.is_started = False
        motion.is_due = False
        motion.range = PAIR_MARGIN
        if world.alive[w, i] and not world.asleep[w, i]:
            motion.range += _compute_distance(end.position, world.start.position, w, i)
            motion.is_due = budget[w, i] < motion.range


@allocating
def _collect_drone_pairs(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    order: np.ndarray,
    rank: int,
    again: bool,
    pairs: np.ndarray,
    num_pairs: int,
) -> tuple[np.ndarray, int]:
    """Collect the pairs of one drone and start the motions of their drones; see `collect_pairs`."""
    old = num_pairs
    pairs, num_pairs = collect_pairs(
        world.scenery,
        space.motions,
        world.alive,
        world.w,
        order,
        rank,
        again,
        world.obstacle_displacement,
        (space.grid, space.rank, space.near),
        pairs,
        num_pairs,
    )
    for p in range(old, num_pairs):
        _start_drone_motion(space, world, end, pairs[p].a)
        _start_drone_motion(space, world, end, pairs[p].b)
    return pairs, num_pairs


@allocating
def find_pairs(
    space: ContactWorkspace, world: ContactWorld, end: Swarm, order: np.ndarray
) -> tuple[np.ndarray, int]:
    """Collect the pairs of all drones to be checked, and of the sleeping drones in these pairs."""
    motions = space.motions
    for i in range(order.shape[0]):
        motions[i].in_island = False
        write_vec3(motions[i].start_position, vec3(world.start.position, world.w, i))
    clear_grid(space.grid)
    if uses_grid(space):
        write_ranks(space.order, space.rank)
        fill_pair_grid(world.scenery, motions, world.alive, world.w, space.grid)
    pairs = space.pairs
    num_pairs = 0
    for rank in range(order.shape[0]):
        if motions[order[rank]].is_due:
            pairs, num_pairs = _collect_drone_pairs(
                space, world, end, order, rank, False, pairs, num_pairs
            )
    # A touched sleeping drone is held by its support, which may be another sleeping drone
    grown = True
    while grown:
        grown = False
        for rank in range(order.shape[0]):
            motion = motions[order[rank]]
            if motion.is_started and not motion.is_due and world.asleep[world.w, order[rank]]:
                motion.is_due = True
                pairs, num_pairs = _collect_drone_pairs(
                    space, world, end, order, rank, True, pairs, num_pairs
                )
                grown = True
    return pairs, num_pairs


@func
def _measure_path(motion: np.record) -> float:
    """Return how far a drone gets from its position at the beginning of the substep, m."""
    here = minus(read_vec3(motion.position), read_vec3(motion.start_position))
    there = plus(here, 1.0, read_vec3(motion.displacement))
    return math.sqrt(max(dot(here, here), dot(there, there)))


@func
def _leaves_search(space: ContactWorkspace, num_members: int) -> bool:
    """Check whether the new path of any drone of the island leaves the distance searched."""
    leaves = False
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        leaves = leaves or not motion.is_due or _measure_path(motion) > motion.range
    return leaves


@allocating
def _extend_pairs(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    order: np.ndarray,
    pairs: np.ndarray,
    num_pairs: int,
) -> tuple[np.ndarray, int]:
    """Collect pairs again for drones whose new path leaves the distance that was searched."""
    for rank in range(order.shape[0]):
        motion = space.motions[order[rank]]
        if not motion.in_island:
            continue
        distance = _measure_path(motion)
        if distance > motion.range or not motion.is_due:
            motion.range = max(motion.range, 1.5 * distance + PAIR_MARGIN)
            reach = world.scenery.table.radius[order[rank]] + motion.range
            space.grid.sizes[2] = max(space.grid.sizes[2], reach)
            motion.is_due = True
            pairs, num_pairs = _collect_drone_pairs(
                space, world, end, order, rank, True, pairs, num_pairs
            )
    return pairs, num_pairs


@func
def _start_next_segment(space: ContactWorkspace, world: ContactWorld, pair: np.record) -> int:
    """Start the next path segment of the drones of a pair whose segment ends.

    Returns the number of these drones; their indices are in `space.island`.
    """
    num_members = 0
    for shape in (pair.a, pair.b):
        if get_segment_end(world.scenery, space.motions, shape) <= pair.impact_time:
            num_members = add_to_island(space, world, num_members, shape, pair.impact_time)
    apply_forces(space, num_members, pair.impact_time, 1.0)
    for m in range(num_members):
        i = space.island[m]
        start_segment(space.motions[i], world.dt, world.parameters[world.w, i])
    apply_forces(space, num_members, pair.impact_time, -1.0)
    return num_members


@allocating
def _resolve_due_drones(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: ContactLog,
) -> bool:
    """Find the pairs of the drones to be checked and resolve their impacts in order of time."""
    order = space.order
    pairs, num_pairs = find_pairs(space, world, end, order)
    if num_pairs == 0:
        return False
    return _resolve_pairs(space, world, end, pairs, num_pairs, stopped, changed, touches)


@deferred(types.boolean)
@allocating
def _resolve_pairs(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    pairs: np.ndarray,
    num_pairs: int,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: ContactLog,
) -> bool:
    """Resolve the impacts of pairs in order of time; returns whether there was any."""
    w = world.w
    motions = space.motions
    any_impact = False
    first = _update_pairs(space, world, pairs, num_pairs, 0.0, False)
    while first >= 0:
        time = pairs[first].impact_time
        knot = pairs[first].is_segment_end
        if knot:
            num_members = _start_next_segment(space, world, pairs[first])
        elif world.stops:
            num_members = stop_at_contact(space, world, pairs[first], time, touches, stopped)
        else:
            num_members = resolve_impact(space, world, pairs, num_pairs, first, time, touches)
        if _leaves_search(space, num_members):
            pairs, num_pairs = _extend_pairs(space, world, end, space.order, pairs, num_pairs)
        first = _update_pairs(space, world, pairs, num_pairs, time, True)
        for m in range(num_members):
            i = space.island[m]
            motions[i].in_island = False
            changed[w, i] = changed[w, i] or not knot
        any_impact = any_impact or not knot
    return any_impact


@kernel
def resolve_contacts(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    budget: np.ndarray,
    uses_rotation: np.ndarray,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: ContactLog,
) -> bool:
    """Detect and resolve the contacts of one world in a substep.

    Args:
        space: Arrays to work on.
        world: The world, with the state at the beginning of the substep.
        end: State at the end of the substep as flown without contacts; changed.
        budget: (W, N) distance that each drone may move before it is checked, m; changed.
        uses_rotation: (W, N) bool, drones whose rotation uses up their budget; changed.
        stopped: (W, N) bool, drones that stopped; changed.
        changed: (W, N) bool, drones whose state was changed; changed.
        touches: Contacts of the decision; added to.

    Returns:
        True if there was any impact.
    """
    w = world.w
    order = space.order
    _set_ranges(space, world, end, budget)
    sort_drones(order, world.start.position, w)
    any_impact = False
    if not are_bounds_clear(space, world, end, budget, uses_rotation):
        any_impact = _resolve_due_drones(space, world, end, stopped, changed, touches)
        for i in range(changed.shape[1]):
            if changed[w, i]:
                write_end_state(space.motions[i], end, w, i, world.parameters[w, i])
            if space.motions[i].is_due and world.alive[w, i]:
                budget[w, i] = compute_budget(world.scenery, end, uses_rotation, w, i)
    if uses_grid(space):
        write_ranks(space.order, space.rank)
        if share_budgets_in_grid(space, world, end, budget):
            return any_impact
    for rank in range(order.shape[0]):
        i = order[rank]
        if space.motions[i].is_due and world.alive[w, i]:
            share_budgets(world.scenery, end, world.alive, budget, order, w, i)
            budget[w, i] -= world.obstacle_displacement
    return any_impact
