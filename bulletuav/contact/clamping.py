"""Clamping: drones that stay in place after too many impacts, or because they stop at a contact."""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func
from bulletuav.contact.constraint import CONTACT_POINT
from bulletuav.contact.contact_log import ContactLog, record_contact
from bulletuav.contact.islands import add_to_island, may_touch
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld, add_contact_points
from bulletuav.contact.motion import (
    MAX_IMPACTS,
    clamp_motion,
    compute_path_displacement,
    compute_path_rates,
    is_at_impact_limit,
    read_vec3,
    write_vec3,
)
from bulletuav.geometry.contact_points import MAX_POINTS
from bulletuav.geometry.rotation import Vec3, dot, minus, plus

MIN_APPROACH_SPEED = 1e-9
"""Speed below which touching shapes do not approach, m/s"""


@func
def remove_forces(motion: np.record, time: float) -> None:
    """Remove the forces on a drone for the remaining substep, except what slows it down.

    The impulses that held the drone gave it the speed that gravity takes in the remaining substep.
    Without this correction the drone would keep that speed, and piles would never come to rest.
    Forces never speed the drone up, as it does not move on.
    """
    push = read_vec3(motion.velocity_change)
    square = dot(push, push)
    against = -dot(read_vec3(motion.velocity), push)
    if against > 0.0:
        fraction = min(1.0 - time, against / square)
        write_vec3(motion.velocity, plus(read_vec3(motion.velocity), fraction, push))
    write_vec3(motion.velocity_change, (0.0, 0.0, 0.0))
    write_vec3(motion.momentum_change, (0.0, 0.0, 0.0))


@func
def compute_carried_displacement(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    num_pairs: int,
    num_members: int,
    time: float,
) -> Vec3:
    """Return the displacement by which an obstacle carries an island in a whole substep, m.

    Clamped drones move with the obstacle even if they have just parted from it, as it follows them.
    Drones that are carried already carry the others of the island.

    Args:
        space: Arrays to work on; `island` has the drones of the island.
        world: The world.
        pairs: Rows of `PAIR`.
        num_pairs: Number of pairs in use.
        num_members: Number of drones of the island.
        time: Time of the impact, as a fraction of the substep.
    """
    still = (0.0, 0.0, 0.0)
    for m in range(num_members):
        i = space.island[m]
        # Drones that were clamped at an earlier impact
        if space.motions[i].impacts > MAX_IMPACTS:
            displacement, _ = compute_path_rates(world.scenery, space.motions, world.w, i, world.dt)
            if displacement != still:
                return displacement
    for p in range(num_pairs):
        if space.motions[pairs[p].a].in_island and may_touch(pairs[p], time):
            displacement = compute_path_displacement(
                world.scenery, space.motions, world.w, pairs[p].b, pairs[p].a, world.dt
            )
            if pairs[p].b >= world.scenery.first_body and displacement != still:
                return displacement
    return still


@func
def clamp_drones_at_limit(
    space: ContactWorkspace, num_members: int, time: float, displacement: Vec3
) -> None:
    """Clamp the drones of an island that are at the impact limit, or move them with an obstacle.

    Args:
        space: Arrays to work on; `island` has the drones of the island.
        num_members: Number of drones of the island.
        time: Time of the impact, as a fraction of the substep.
        displacement: Displacement of the obstacle in a whole substep, m; zeros to clamp the drones.
    """
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        if is_at_impact_limit(motion):
            clamp_motion(motion)
            write_vec3(motion.displacement, plus((0.0, 0.0, 0.0), 1.0 - time, displacement))


@func
def _compute_path_velocity(space: ContactWorkspace, world: ContactWorld, i: int, arm: Vec3) -> Vec3:
    """Return the velocity of a drone's surface along its path, whatever its state says, m/s."""
    move, turn = compute_path_rates(world.scenery, space.motions, world.w, i, world.dt)
    x, y, z = arm
    return (
        (move[0] + turn[1] * z - turn[2] * y) / world.dt,
        (move[1] + turn[2] * x - turn[0] * z) / world.dt,
        (move[2] + turn[0] * y - turn[1] * x) / world.dt,
    )


@deferred(types.int64)
@allocating
def stop_at_contact(
    space: ContactWorkspace,
    world: ContactWorld,
    pair: np.record,
    time: float,
    touches: ContactLog,
    stopped: np.ndarray,
) -> int:
    """Stop the drones of a pair at their contact, if they approach.

    Args:
        space: Arrays to work on; `island` is written.
        world: The world.
        pair: Row of `PAIR`.
        time: Time of the contact, as a fraction of the substep.
        touches: Contact log, added to.
        stopped: (W, N) bool, drones that stopped in this decision; written.

    Returns:
        Number of drones of the pair; their indices are in `space.island`.
    """
    motions = space.motions
    w = world.w
    num_members = add_to_island(space, world, 0, pair.a, time)
    num_members = add_to_island(space, world, num_members, pair.b, time)
    points = np.empty(MAX_POINTS, dtype=CONTACT_POINT)
    if add_contact_points(space, world, pair, time, points, 0) == 0:
        return num_members
    point = points[0]
    normal = read_vec3(point.normal)
    arm = read_vec3(point.arm_a)
    velocity = minus(
        _compute_path_velocity(space, world, pair.a, arm), read_vec3(point.obstacle_velocity)
    )
    if point.b >= 0:
        velocity = minus(
            velocity, _compute_path_velocity(space, world, pair.b, read_vec3(point.arm_b))
        )
    tried = 0
    for m in range(num_members):
        motions[space.island[m]].impacts += 1
        tried = max(tried, motions[space.island[m]].impacts)
    # A rotating pair may approach at another point; limit the number of such impacts
    if dot(velocity, normal) > -MIN_APPROACH_SPEED and tried < MAX_IMPACTS:
        return num_members
    place = plus(read_vec3(motions[pair.a].position), 1.0, arm)
    for m in range(num_members):
        i = space.island[m]
        moving = _compute_path_velocity(space, world, i, (0.0, 0.0, 0.0))
        impulse = world.parameters[w, i].mass * math.sqrt(dot(moving, moving))
        other = pair.b if i == pair.a else pair.a
        sign = 1.0 if i == pair.a else -1.0
        record_contact(touches, w, i, other, impulse, place, normal, velocity, 0.0, sign)
    for m in range(num_members):
        i = space.island[m]
        stopped[w, i] = True
        motion = motions[i]
        motion.impacts = MAX_IMPACTS
        clamp_motion(motion)
        for k in range(3):
            motion.velocity[k] = 0.0
            motion.spin[k] = 0.0
            motion.velocity_change[k] = 0.0
            motion.momentum_change[k] = 0.0
    return num_members
