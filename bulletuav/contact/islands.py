"""Islands: drones that are connected by contacts at the time of an impact.

A sleeping drone supports the drones on it like a static body, and passes their load on to its own
support. A pile therefore falls asleep from below. A sleeping drone that is hit becomes dynamic,
and so do all drones that sleep near it.
"""

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.constraint import compute_surface_velocity, set_inverse_mass
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld, measure_pair
from bulletuav.contact.motion import advance_motion
from bulletuav.contact.time_of_impact import MAX_CONTACT_DISTANCE
from bulletuav.geometry.rotation import Vec3, dot

WAKE_APPROACH_SPEED = 0.05
"""Approach speed above which a sleeping drone becomes dynamic, m/s"""


@func
def add_to_island(
    space: ContactWorkspace, world: ContactWorld, num_members: int, i: int, time: float
) -> int:
    """Advance a drone to the time of an impact and add it to the island.

    Shapes that are no drones, and drones of the island, are skipped.

    Args:
        space: Arrays to work on; `island` and the motion of the drone are written.
        world: The world.
        num_members: Number of drones of the island so far.
        i: Index of the shape.
        time: Time of the impact, as a fraction of the substep.

    Returns:
        Number of drones of the island.
    """
    if i >= world.scenery.first_body or space.motions[i].in_island:
        return num_members
    motion = space.motions[i]
    row = world.parameters[world.w, i]
    motion.in_island = True
    space.island[num_members] = i
    advance_motion(motion, time, row)
    set_inverse_mass(motion, row)
    return num_members + 1


@func
def may_touch(pair: np.record, time: float) -> bool:
    """Check whether a pair may be in contact at a time."""
    found: bool = pair.has_touched or pair.in_contact or pair.impact_time <= time
    return found


@func
def is_pair_in_island(motions: np.ndarray, pair: np.record) -> bool:
    """Check whether all dynamic bodies of a pair belong to the island.

    Other pairs were measured when the island was built, and are not in contact.
    """
    if not motions[pair.a].in_island:
        return False
    found: bool = pair.b >= motions.shape[0] or pair.is_on_sleeper or motions[pair.b].in_island
    return found


@func
def _swap_bodies(pair: np.record) -> None:
    """Swap the bodies of a pair."""
    pair.a, pair.b = pair.b, pair.a
    for k in range(3):
        pair.normal[k] = -pair.normal[k]


@func
def _is_one_static(motions: np.ndarray, pair: np.record) -> bool:
    """Check whether exactly one of two drones is a sleeping drone that acts as a static body."""
    if pair.b >= motions.shape[0]:
        return False
    found: bool = motions[pair.a].is_static != motions[pair.b].is_static
    return found


@func
def _is_hit(motions: np.ndarray, pair: np.record, normal: Vec3, on_a: Vec3) -> bool:
    """Check whether drone a approaches a sleeping drone faster than `WAKE_APPROACH_SPEED`."""
    velocity = compute_surface_velocity(motions[pair.a], on_a)
    hit: bool = -dot(velocity, normal) > WAKE_APPROACH_SPEED
    return hit


@func
def _add_drone_on_sleeper(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    num_pairs: int,
    pair: np.record,
    num_members: int,
    time: float,
) -> int:
    """Add a drone that touches a sleeping drone to the island.

    If the sleeping drone is hit, all sleeping drones become dynamic. Returns the number of drones
    of the island.
    """
    motions = space.motions
    if motions[pair.a].is_static:
        _swap_bodies(pair)
    num_members = add_to_island(space, world, num_members, pair.a, time)
    distance, normal, on_a, _ = measure_pair(space, world, pair, time)
    pair.is_on_sleeper = True
    if distance <= MAX_CONTACT_DISTANCE and _is_hit(motions, pair, normal, on_a):
        for i in range(motions.shape[0]):
            motions[i].is_static = False
        for p in range(num_pairs):
            pairs[p].is_on_sleeper = False
        num_members = add_to_island(space, world, num_members, pair.b, time)
    return num_members


@func
def build_island(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    num_pairs: int,
    first: int,
    time: float,
) -> int:
    """Find all drones that are connected to a pair by contacts at the time of its impact.

    Args:
        space: Arrays to work on; `island` and the motions of its drones are written.
        world: The world.
        pairs: Rows of `PAIR`; bodies may be swapped.
        num_pairs: Number of pairs in use.
        first: Index of the pair whose impact it is.
        time: Time of the impact, as a fraction of the substep.

    Returns:
        Number of drones of the island; their indices are in `space.island`.
    """
    motions = space.motions
    for p in range(num_pairs):
        pairs[p].is_on_sleeper = False
    if _is_one_static(motions, pairs[first]):
        num_members = _add_drone_on_sleeper(space, world, pairs, num_pairs, pairs[first], 0, time)
    else:
        num_members = add_to_island(space, world, 0, pairs[first].a, time)
        num_members = add_to_island(space, world, num_members, pairs[first].b, time)
    grown = True
    while grown:
        grown = False
        for p in range(num_pairs):
            pair = pairs[p]
            if pair.b >= world.scenery.first_body or not may_touch(pair, time):
                continue
            if pair.is_on_sleeper or motions[pair.a].in_island == motions[pair.b].in_island:
                continue
            if _is_one_static(motions, pair):
                num_members = _add_drone_on_sleeper(
                    space, world, pairs, num_pairs, pair, num_members, time
                )
                grown = grown or not pair.is_on_sleeper
                continue
            distance, _, _, _ = measure_pair(space, world, pair, time)
            if distance <= MAX_CONTACT_DISTANCE:
                num_members = add_to_island(space, world, num_members, pair.a, time)
                num_members = add_to_island(space, world, num_members, pair.b, time)
                grown = True
    return num_members
