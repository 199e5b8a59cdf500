"""Islands: who hangs together at the time of a touch, and who sleeps under them and bears them.

Who sleeps bears those that lie on it as the ground does, and what it gets goes on to what it lies
on. So a heap falls asleep from below. A sleeper that is hit yields, and all who sleep near it.
"""

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.constraint import compute_surface_velocity, set_inverse_mass
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld, measure_pair
from bulletuav.contact.motion import advance_motion
from bulletuav.contact.time_of_impact import MAX_CONTACT_DISTANCE
from bulletuav.geometry.rotation import Vec3, dot

WAKE_APPROACH_SPEED = 0.05
"""Approach from which on a sleeper yields, m/s"""


@func
def add_to_island(
    space: ContactWorkspace, world: ContactWorld, members: int, i: int, time: float
) -> int:
    """Bring a drone to the time of an impact, as one of its island; returns how many there are."""
    if i >= world.scenery.first_body or space.motions[i].in_island:
        return members
    motion = space.motions[i]
    row = world.parameters[world.w, i]
    motion.in_island = True
    space.island[members] = i
    advance_motion(motion, time, row)
    set_inverse_mass(motion, row)
    return members + 1


@func
def may_touch(pair: np.record, time: float) -> bool:
    """Tell whether a pair may be in touch at a time."""
    found: bool = pair.has_touched or pair.in_contact or pair.impact_time <= time
    return found


@func
def is_pair_in_island(motions: np.ndarray, pair: np.record) -> bool:
    """Tell whether both of a pair belong to the island, or the one that can move.

    Others were measured when it was gathered, and are not in touch.
    """
    if not motions[pair.a].in_island:
        return False
    found: bool = pair.b >= motions.shape[0] or pair.is_on_sleeper or motions[pair.b].in_island
    return found


@func
def _swap_bodies(pair: np.record) -> None:
    """Let a pair be told from its other side."""
    pair.a, pair.b = pair.b, pair.a
    for k in range(3):
        pair.normal[k] = -pair.normal[k]


@func
def _is_one_static(motions: np.ndarray, pair: np.record) -> bool:
    """Tell whether one of two drones sleeps and bears the other."""
    if pair.b >= motions.shape[0]:
        return False
    found: bool = motions[pair.a].is_static != motions[pair.b].is_static
    return found


@func
def _is_hit(motions: np.ndarray, pair: np.record, normal: Vec3, on_a: Vec3) -> bool:
    """Tell whether a drone a of an island closes on a sleeper faster than that bears."""
    velocity = compute_surface_velocity(motions[pair.a], on_a)
    hit: bool = -dot(velocity, normal) > WAKE_APPROACH_SPEED
    return hit


@func
def _add_drone_on_sleeper(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    count: int,
    pair: np.record,
    members: int,
    time: float,
) -> int:
    """Let one of an island lean on a sleeper that it touches; if it hits that, no sleeper bears.

    Returns the number of members.
    """
    motions = space.motions
    if motions[pair.a].is_static:
        _swap_bodies(pair)
    members = add_to_island(space, world, members, pair.a, time)
    distance, normal, on_a, _ = measure_pair(space, world, pair, time)
    pair.is_on_sleeper = True
    if distance <= MAX_CONTACT_DISTANCE and _is_hit(motions, pair, normal, on_a):
        for i in range(motions.shape[0]):
            motions[i].is_static = False
        for p in range(count):
            pairs[p].is_on_sleeper = False
        members = add_to_island(space, world, members, pair.b, time)
    return members


@func
def build_island(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    count: int,
    first: int,
    time: float,
) -> int:
    """Find all drones that hang together with a pair at the time of its touch.

    Returns their number; they are in `space.island`.
    """
    motions = space.motions
    for p in range(count):
        pairs[p].is_on_sleeper = False
    if _is_one_static(motions, pairs[first]):
        members = _add_drone_on_sleeper(space, world, pairs, count, pairs[first], 0, time)
    else:
        members = add_to_island(space, world, 0, pairs[first].a, time)
        members = add_to_island(space, world, members, pairs[first].b, time)
    grown = True
    while grown:
        grown = False
        for p in range(count):
            pair = pairs[p]
            if pair.b >= world.scenery.first_body or not may_touch(pair, time):
                continue
            if pair.is_on_sleeper or motions[pair.a].in_island == motions[pair.b].in_island:
                continue
            if _is_one_static(motions, pair):
                members = _add_drone_on_sleeper(space, world, pairs, count, pair, members, time)
                grown = grown or not pair.is_on_sleeper
                continue
            distance, _, _, _ = measure_pair(space, world, pair, time)
            if distance <= MAX_CONTACT_DISTANCE:
                members = add_to_island(space, world, members, pair.a, time)
                members = add_to_island(space, world, members, pair.b, time)
                grown = True
    return members
