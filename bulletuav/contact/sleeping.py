"""Sleeping: put drones at rest to sleep, and wake those that are hit or overloaded."""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.contact_state import TIME_TO_SLEEP, ContactState, wake_drone
from bulletuav.contact.manifold import ContactWorld
from bulletuav.contact.motion import read_vec3
from bulletuav.contact.resting_support import can_carry_load, compute_support_force, measure_support
from bulletuav.geometry.rotation import Vec3, dot, plus, point, quat4, to_world, vec3
from bulletuav.vehicle.swarm import Swarm

MAX_REST_SPEED = 5e-3
"""Speed below which a drone is at rest, m/s"""
MAX_REST_SPIN = 0.05
"""Angular velocity below which a drone is at rest, rad/s"""
TOUCHING_FACTOR = 2.0
"""Factor of both limits for a drone that touches other drones"""
TIME_TO_SLEEP_ON_FACE = 0.05
"""Time at rest after which a drone sleeps if a face supports it safely, s"""
MAX_SPEED_GAIN = 1.5e-4
"""Maximum gain of speed of a drone at rest in that time, m/s"""


@func
def _is_slow(contact: ContactState, w: int, i: int, velocity: Vec3, rates: Vec3) -> bool:
    """Check whether a drone is slow enough to be at rest."""
    scale = 1.0
    for k in range(contact.touches.number[w, i]):
        if contact.touches.other[w, i, k] < contact.scenery.first_body:
            scale = TOUCHING_FACTOR * TOUCHING_FACTOR
    slow: bool = dot(velocity, velocity) < scale * MAX_REST_SPEED**2
    return slow and dot(rates, rates) < scale * MAX_REST_SPIN**2


@func
def _compute_speed(swarm: Swarm, w: int, i: int) -> float:
    velocity = vec3(swarm.velocity, w, i)
    return math.sqrt(dot(velocity, velocity))


@func
def _is_any_asleep(contact: ContactState, w: int) -> bool:
    """Check whether any drone of a world sleeps.

    NumPy's `any` would make stored code import Numba's `arraymath`, and with it SciPy, when it is
    loaded.
    """
    found = False
    for i in range(contact.asleep.shape[1]):
        found |= contact.asleep[w, i]
    return found


@func
def update_sleep(contact: ContactState, world: ContactWorld, swarm: Swarm, last: bool) -> None:
    """Put drones that have been at rest long enough to sleep, and wake disturbed ones.

    Args:
        contact: State of all contacts.
        world: The world.
        swarm: State at the end of the substep; sleeping drones keep their pose.
        last: True in the last substep of a decision. Drones are put to sleep only then, so that
            their contacts are those of a whole decision.
    """
    w = world.w
    if _is_any_asleep(contact, w):
        _wake_disturbed(contact, world, swarm)
    for i in range(world.alive.shape[1]):
        velocity, rates = vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i)
        slow = _is_slow(contact, w, i, velocity, rates)
        if contact.asleep[w, i] or (contact.changed[w, i] and slow):
            _update_rest_time(contact, world, swarm, i, slow, last)
        else:
            contact.quiet[w, i] = 0.0
    # Put all to sleep together, so that their order does not matter
    for i in range(world.alive.shape[1]):
        if contact.dozes[w, i]:
            _put_to_sleep(contact, world, swarm, i)


@deferred(types.none)
@kernel
def _wake_disturbed(contact: ContactState, world: ContactWorld, swarm: Swarm) -> None:
    """Wake sleeping drones that were hit or are overloaded, and all that sleep in a pile with them.

    The disturbed drones are found before any is woken, so that their order does not matter.
    """
    w = world.w
    for i in range(world.alive.shape[1]):
        if not contact.asleep[w, i]:
            continue
        if contact.changed[w, i]:
            velocity, rates = vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i)
            contact.dozes[w, i] = not _is_slow(contact, w, i, velocity, rates)
        else:
            contact.dozes[w, i] = _is_overloaded(contact, world, i)
    for i in range(world.alive.shape[1]):
        if contact.dozes[w, i]:
            contact.dozes[w, i] = False
            wake_drone(contact, w, i)


@deferred(types.none)
@kernel
def _update_rest_time(
    contact: ContactState, world: ContactWorld, swarm: Swarm, i: int, slow: bool, last: bool
) -> None:
    """Update the rest time of a slow drone; restore the pose of a touched sleeping drone."""
    w = world.w
    if contact.asleep[w, i]:
        if contact.changed[w, i]:
            _restore_pose(contact, swarm, w, i)
        return
    speed = _compute_speed(swarm, w, i)
    if contact.quiet[w, i] == 0.0:
        contact.pace[w, i] = speed
    contact.quiet[w, i] += world.dt
    if contact.quiet[w, i] >= TIME_TO_SLEEP_ON_FACE and last and _is_supported(contact, w, i):
        _store_support(contact, world, swarm, i)
        contact.dozes[w, i] = _is_support_safe(contact, world, i)
    if contact.quiet[w, i] >= TIME_TO_SLEEP:
        # A drone that slides ever faster down a barely steep slope is not at rest
        if speed > contact.pace[w, i] + MAX_SPEED_GAIN:
            contact.quiet[w, i] = 0.0
            contact.dozes[w, i] = False
        else:
            contact.dozes[w, i] = last and _is_supported(contact, w, i)


@deferred(types.none)
@kernel
def _put_to_sleep(contact: ContactState, world: ContactWorld, swarm: Swarm, i: int) -> None:
    """Put a drone to sleep, which stops it."""
    w = world.w
    contact.dozes[w, i] = False
    contact.asleep[w, i] = True
    contact.load[w, i, 0] = np.nan
    _store_support(contact, world, swarm, i)
    support = contact.support[w, i]
    if support.span > 0.0:
        # The momentum that its support absorbs
        lost = world.parameters[w, i].mass * dot(vec3(swarm.velocity, w, i), support.normal)
        contact.touches.impulse[w, i, 0] -= lost
    for k in range(3):
        swarm.velocity[w, i, k] = 0.0
        swarm.rates[w, i, k] = 0.0


@func
def _is_overloaded(contact: ContactState, world: ContactWorld, i: int) -> bool:
    """Check whether the drones on a sleeping drone push it more than its support can take."""
    motion = contact.space.motions[i]
    load = contact.load[world.w, i]
    given = motion.load
    if not motion.is_started or not motion.is_static or np.isnan(load[0]):
        return False
    if dot(point(given, 0), point(given, 0)) == 0.0:
        return False
    row = world.parameters[world.w, i]
    inertia = row.inertia
    twist = (inertia[0] * load[3], inertia[1] * load[4], inertia[2] * load[5])
    acceleration = (load[0], load[1], load[2])
    torque = to_world(quat4(contact.start.quaternion, world.w, i), twist)
    support = contact.support[world.w, i]
    return not can_carry_load(support, row, acceleration, torque, given, world.dt)


@func
def _is_support_safe(contact: ContactState, world: ContactWorld, i: int) -> bool:
    """Check whether the support of a drone can take the forces of this substep."""
    support = contact.support[world.w, i]
    if support.span <= 0.0:
        return False
    motion = contact.space.motions[i]
    scale = 1.0 / world.dt
    acceleration = plus((0.0, 0.0, 0.0), scale, read_vec3(motion.velocity_change))
    torque = plus((0.0, 0.0, 0.0), scale, read_vec3(motion.momentum_change))
    _, is_safe = compute_support_force(
        support, world.parameters[world.w, i].mass, acceleration, torque
    )
    return is_safe


@func
def _is_supported(contact: ContactState, w: int, i: int) -> bool:
    """Check whether a drone touches a static shape or a sleeping drone."""
    touches = contact.touches
    for k in range(touches.number[w, i]):
        other = touches.other[w, i, k]
        if other >= contact.scenery.first_body or contact.asleep[w, other]:
            return True
    return False


@func
def _store_support(contact: ContactState, world: ContactWorld, swarm: Swarm, i: int) -> None:
    """Store the contacts of a drone that is put to sleep, and its support.

    There is a support only if the drone rests on one surface.
    """
    w = world.w
    touches = contact.touches
    slept = contact.slept
    slept.number[w, i] = touches.number[w, i]
    for k in range(touches.number[w, i]):
        slept.impulse[w, i, k] = touches.impulse[w, i, k]
    support = contact.support[w, i]
    support.span = 0.0
    if touches.number[w, i] == 1:
        measure_support(support, contact.space, world, swarm, i, touches.other[w, i, 0])
    if support.span > 0.0:
        # The support force is recorded in each substep, see `stays_asleep`
        slept.impulse[w, i, 0] = 0.0


@func
def _restore_pose(contact: ContactState, swarm: Swarm, w: int, i: int) -> None:
    """Reset a drone to its pose at the beginning of the substep, at rest."""
    for k in range(3):
        swarm.position[w, i, k] = contact.start.position[w, i, k]
        swarm.velocity[w, i, k] = 0.0
        swarm.rates[w, i, k] = 0.0
    for k in range(4):
        swarm.quaternion[w, i, k] = contact.start.quaternion[w, i, k]
