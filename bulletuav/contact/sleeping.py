"""Settling: who has been at rest for long falls asleep, and who is hit or pushed hard wakes."""

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
"""Spin below which a drone is at rest, rad/s"""
TOUCHING_FACTOR = 2.0
"""How much more of both a drone may have that touches others"""
TIME_TO_SLEEP_ON_FACE = 0.05
"""How long a drone is at rest before it falls asleep on a face that bears it safely, s"""
MAX_SPEED_GAIN = 1.5e-4
"""How much faster a drone at rest may have become in that time, m/s"""


@func
def _is_slow(contact: ContactState, w: int, i: int, velocity: Vec3, rates: Vec3) -> bool:
    """Tell whether a drone is as good as at rest."""
    scale = 1.0
    for k in range(contact.touches.number[w, i]):
        if contact.touches.other[w, i, k] < contact.scenery.first_body:
            scale = TOUCHING_FACTOR * TOUCHING_FACTOR
    slow: bool = dot(velocity, velocity) < scale * MAX_REST_SPEED**2
    return slow and dot(rates, rates) < scale * MAX_REST_SPIN**2


@func
def _compute_speed(swarm: Swarm, w: int, i: int) -> float:
    """Return the speed of a drone, m/s."""
    velocity = vec3(swarm.velocity, w, i)
    return math.sqrt(dot(velocity, velocity))


@func
def update_sleep(contact: ContactState, world: ContactWorld, swarm: Swarm, last: bool) -> None:
    """Let drones that have been at rest for long fall asleep, and sleepers that were hit wake.

    Args:
        contact: Of all worlds.
        world: The world.
        swarm: State at the end of the substep; sleepers stay where they are.
        last: Whether it is the decision's last substep: only then a drone falls asleep, so that
            what it touched is told of a whole decision.
    """
    w = world.w
    if contact.asleep[w].any():
        _wake_disturbed(contact, world, swarm)
    for i in range(world.alive.shape[1]):
        velocity, rates = vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i)
        slow = _is_slow(contact, w, i, velocity, rates)
        if contact.asleep[w, i] or (contact.changed[w, i] and slow):
            _update_rest_time(contact, world, swarm, i, slow, last)
        else:
            contact.quiet[w, i] = 0.0
    # All at once, so that their order does not matter
    for i in range(world.alive.shape[1]):
        if contact.dozes[w, i]:
            _put_to_sleep(contact, world, swarm, i)


@deferred(types.none)
@kernel
def _wake_disturbed(contact: ContactState, world: ContactWorld, swarm: Swarm) -> None:
    """Wake sleepers that were hit or bear too much, and all who sleep in a heap with them.

    Who that is must be known before anybody wakes, or their order would matter.
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
    """Put a sleeper that was touched back, or look whether a drone at rest is to fall asleep."""
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
        # Who slides ever faster down a slope that is hardly steep enough does not rest
        if speed > contact.pace[w, i] + MAX_SPEED_GAIN:
            contact.quiet[w, i] = 0.0
            contact.dozes[w, i] = False
        else:
            contact.dozes[w, i] = last and _is_supported(contact, w, i)


@deferred(types.none)
@kernel
def _put_to_sleep(contact: ContactState, world: ContactWorld, swarm: Swarm, i: int) -> None:
    """Let a drone fall asleep, which stops it."""
    w = world.w
    contact.dozes[w, i] = False
    contact.asleep[w, i] = True
    contact.load[w, i, 0] = np.nan
    _store_support(contact, world, swarm, i)
    support = contact.support[w, i]
    if support.span > 0.0:
        # What its support takes from it
        lost = world.parameters[w, i].mass * dot(vec3(swarm.velocity, w, i), support.normal)
        contact.touches.impulse[w, i, 0] -= lost
    for k in range(3):
        swarm.velocity[w, i, k] = 0.0
        swarm.rates[w, i, k] = 0.0


@func
def _is_overloaded(contact: ContactState, world: ContactWorld, i: int) -> bool:
    """Tell whether those who lie on a sleeper push it more than what it lies on bears."""
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
    """Tell whether the support of a drone bears the forces of this substep."""
    support = contact.support[world.w, i]
    if support.span <= 0.0:
        return False
    motion = contact.space.motions[i]
    scale = 1.0 / world.dt
    acceleration = plus((0.0, 0.0, 0.0), scale, read_vec3(motion.velocity_change))
    torque = plus((0.0, 0.0, 0.0), scale, read_vec3(motion.momentum_change))
    _, borne = compute_support_force(
        support, world.parameters[world.w, i].mass, acceleration, torque
    )
    return borne


@func
def _is_supported(contact: ContactState, w: int, i: int) -> bool:
    """Tell whether a drone touches something that does not yield, or somebody who sleeps on it."""
    touches = contact.touches
    for k in range(touches.number[w, i]):
        other = touches.other[w, i, k]
        if other >= contact.scenery.first_body or contact.asleep[w, other]:
            return True
    return False


@func
def _store_support(contact: ContactState, world: ContactWorld, swarm: Swarm, i: int) -> None:
    """Keep what a drone that falls asleep touches, and what it rests on if that is one surface."""
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
        # How it is pressed down is told of each substep
        slept.impulse[w, i, 0] = 0.0


@func
def _restore_pose(contact: ContactState, swarm: Swarm, w: int, i: int) -> None:
    """Put a drone back to where it was at the beginning of the substep, at rest."""
    for k in range(3):
        swarm.position[w, i, k] = contact.start.position[w, i, k]
        swarm.velocity[w, i, k] = 0.0
        swarm.rates[w, i, k] = 0.0
    for k in range(4):
        swarm.quaternion[w, i, k] = contact.start.quaternion[w, i, k]
