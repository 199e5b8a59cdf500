"""Rest: drones that lie still sleep, and cost next to nothing, until something changes.

A drone falls asleep after lying still for `LONG`. It wakes when its forces change by more than its
support bears, when something touches it, when a drone that lies by it wakes, or when an obstacle
comes near.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.contact.memory import Memory, make_memory
from bulletuav.contact.motion import vector
from bulletuav.contact.pairs import body_distance
from bulletuav.contact.points import Workspace, World, make_workspace
from bulletuav.contact.support import SUPPORT, find_support, pressing
from bulletuav.contact.touches import Touches, make_touches
from bulletuav.geometry.rotation import Quat4, Vec3, dot, minus, plus, to_world, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import func
from bulletuav.vehicle.swarm import Swarm

NEARBY = 0.01
"""Distance between bounding spheres within which sleepers wake each other, m"""
SAME_LOAD = 0.02
"""Change of acceleration that wakes a sleeper, m/s^2"""
SLOWEST = 5e-3
"""Speed below which a drone is at rest, m/s"""
SLOWEST_SPIN = 0.05
"""Spin below which a drone is at rest, rad/s"""
SHORT = 0.05
"""How long a drone is at rest before it falls asleep on a face that bears it safely, s"""
LONG = 0.25
"""How long it is before it does elsewhere, s"""
FASTER = 1.5e-4
"""How much faster a drone at rest may have become in that time, m/s"""


class Contact(NamedTuple):
    """What contacts of W worlds of N drones need, for compiled code.

    Attributes:
        scenery: What stands, and all shapes.
        space: Arrays to work on.
        start: State at the beginning of the present substep.
        due: (W, N) bool, drones whose budget the present substep used up.
        budget: (W, N) how far each drone may move before it must be looked at, m.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
        stops: Whether drones stop where they touch, instead of being pushed.
        sleeps: Whether drones that rest are left alone until something changes.
        asleep: (W, N) bool, drones that are.
        quiet: (W, N) how long each drone has been at rest, s.
        pace: (W, N) speed of each drone when it came to rest, m/s.
        load: (W, N, 6) accelerations of sleepers without contacts, m/s^2 and rad/s^2; NaN at first.
        support: (W, N) rows of `SUPPORT`, what sleepers rest on.
        slept: What each sleeper touched in the decision in which it fell asleep.
        dozes: (W, N) bool, drones that fall asleep now.
        flew: (W, N) bool, drones that flew the last decision.
        stopped: (W, N) bool, drones that stopped in this decision.
        changed: (W, N) bool, drones whose state the last substep changed.
        touches: What was touched in this decision.
        speed: (W,) speed of the fastest obstacle in this decision, m/s.
        before: (W, K, 3) positions of the task's obstacles at the beginning of the decision, m.
        after: (W, K, 3) the same at its end.
        memory: Impulses of the last substep.
    """

    scenery: Scenery
    space: Workspace
    start: Swarm
    due: np.ndarray
    budget: np.ndarray
    friction: float
    restitution: float
    stops: bool
    sleeps: bool
    asleep: np.ndarray
    quiet: np.ndarray
    pace: np.ndarray
    load: np.ndarray
    support: np.ndarray
    slept: Touches
    dozes: np.ndarray
    flew: np.ndarray
    stopped: np.ndarray
    changed: np.ndarray
    touches: Touches
    speed: np.ndarray
    before: np.ndarray
    after: np.ndarray
    memory: Memory


def make_contact(
    scenery: Scenery,
    shape: tuple[int, int, int],
    stops: bool,
    sleeps: bool,
    friction: float,
    restitution: float,
) -> Contact:
    """Make what contacts of W worlds of N drones need.

    Args:
        scenery: What stands, and all shapes.
        shape: (W, N, K), of which K are the task's obstacles.
        stops: Whether drones stop where they touch, instead of being pushed.
        sleeps: Whether drones that rest are left alone until something changes; the dynamics asks
            `bears` of them.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
    """
    worlds, drones, obstacles = shape
    each = (worlds, drones)
    return Contact(
        scenery=scenery,
        space=make_workspace(drones),
        start=Swarm.zeros(*each, 0),
        due=np.zeros(each, dtype=bool),
        budget=np.full(each, -1.0),
        friction=friction,
        restitution=restitution,
        stops=stops,
        sleeps=sleeps and not stops,
        asleep=np.zeros(each, dtype=bool),
        quiet=np.zeros(each),
        pace=np.zeros(each),
        load=np.full((*each, 6), np.nan),
        support=np.zeros(each, dtype=SUPPORT),
        slept=make_touches(*each),
        dozes=np.zeros(each, dtype=bool),
        flew=np.zeros(each, dtype=bool),
        stopped=np.zeros(each, dtype=bool),
        changed=np.zeros(each, dtype=bool),
        touches=make_touches(*each),
        speed=np.zeros(worlds),
        before=np.zeros((worlds, obstacles, 3)),
        after=np.zeros((worlds, obstacles, 3)),
        memory=make_memory(*each),
    )


@func
def wake(
    contact: Contact,
    w: int,
    i: int,
) -> None:
    """Wake a drone, if it sleeps, and all who sleep in a heap with it."""
    space = contact.space
    asleep = contact.asleep
    if not asleep[w, i]:
        return
    # All that were woken, in `island`, wake those who are near them
    count = 1
    done = 0
    space.island[0] = i
    asleep[w, i] = False
    radius = contact.scenery.table.radius
    while done < count:
        k = space.island[done]
        done += 1
        contact.quiet[w, k] = 0.0
        contact.budget[w, k] = -1.0
        for j in range(asleep.shape[1]):
            if asleep[w, j]:
                gap = minus(vec3(contact.start.position, w, k), vec3(contact.start.position, w, j))
                within = radius[k] + radius[j] + NEARBY
                if dot(gap, gap) < within * within:
                    asleep[w, j] = False
                    space.island[count] = j
                    count += 1


@func
def wake_for_obstacles(contact: Contact, world: World) -> None:
    """Wake the sleepers that an obstacle which moves comes near to."""
    w = world.w
    scenery = contact.scenery
    for i in range(world.alive.shape[1]):
        if not contact.asleep[w, i]:
            continue
        here = vec3(contact.start.position, w, i)
        near = scenery.table.radius[i] + 2.0 * world.speed + NEARBY
        for k in range(contact.before.shape[1]):
            drift = vec3(scenery.velocity, w, k)
            if dot(drift, drift) > 0.0 and body_distance(scenery, w, k, here) < near:
                wake(contact, w, i)


@func
def bears(
    contact: Contact,
    w: int,
    i: int,
    quaternion: Quat4,
    acceleration: Vec3,
    spinning: Vec3,
    row: np.record,
    dt: float,
) -> bool:
    """Tell whether a sleeper stays at rest under its forces, and note how they press it down.

    They may be what its support bears, or those with which it fell asleep.

    Args:
        contact: Its load is set at the first call; touches are added to.
        w: The world.
        i: The drone.
        quaternion: Its attitude.
        acceleration: By forces without contacts, m/s^2.
        spinning: Change of its rates by torques, rad/s^2.
        row: Row of `PARAMETERS` of the drone.
        dt: Length of the substep, s.
    """
    load = contact.load[w, i]
    first = bool(np.isnan(load[0]))
    if first:
        for k in range(3):
            load[k] = acceleration[k]
            load[3 + k] = spinning[k]
    support = contact.support[w, i]
    if support.span > 0.0:
        inertia = row.inertia
        twist = (inertia[0] * spinning[0], inertia[1] * spinning[1], inertia[2] * spinning[2])
        pressed, borne = pressing(support, row.mass, acceleration, to_world(quaternion, twist))
        contact.touches.impulse[w, i, 0] += pressed * dt
        if borne:
            return True
    if first:
        # On a face alone it has been at rest for too short a time to trust that
        return bool(contact.quiet[w, i] >= LONG)
    reach = contact.scenery.table.radius[i]
    for k in range(3):
        if abs(load[k] - acceleration[k]) > SAME_LOAD:
            return False
        if reach * abs(load[3 + k] - spinning[k]) > SAME_LOAD:
            return False
    return True


@func
def _is_slow(velocity: Vec3, rates: Vec3) -> bool:
    """Tell whether a drone is as good as at rest."""
    slow: bool = dot(velocity, velocity) < SLOWEST**2 and dot(rates, rates) < SLOWEST_SPIN**2
    return slow


@func
def _speed(
    swarm: Swarm,
    w: int,
    i: int,
) -> float:
    """Return the speed of a drone, m/s."""
    velocity = vec3(swarm.velocity, w, i)
    return math.sqrt(dot(velocity, velocity))


@func
def settle(
    contact: Contact,
    world: World,
    swarm: Swarm,
    last: bool,
) -> None:
    """Let drones that have been at rest for long fall asleep, and sleepers that were hit wake.

    Args:
        contact: Of all worlds.
        world: The world.
        swarm: State at the end of the substep; sleepers stay where they are.
        last: Whether it is the decision's last substep: only then a drone falls asleep, so that
            what it touched is told of a whole decision.
    """
    w = world.w
    for i in range(world.alive.shape[1]):
        changed = contact.changed[w, i]
        slow = _is_slow(vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i))
        if contact.asleep[w, i]:
            if changed and slow:
                _put_back(contact, swarm, w, i)
            elif changed:
                wake(contact, w, i)
            continue
        if not (changed and slow):
            contact.quiet[w, i] = 0.0
            continue
        speed = _speed(swarm, w, i)
        if contact.quiet[w, i] == 0.0:
            contact.pace[w, i] = speed
        contact.quiet[w, i] += world.dt
        if contact.quiet[w, i] >= SHORT and last and _is_borne(contact, w, i):
            _note_support(contact, world, swarm, i)
            contact.dozes[w, i] = _is_safe(contact, world, i)
        if contact.quiet[w, i] >= LONG:
            # Who slides ever faster down a slope that is hardly steep enough does not rest
            if speed > contact.pace[w, i] + FASTER:
                contact.quiet[w, i] = 0.0
                contact.dozes[w, i] = False
            else:
                contact.dozes[w, i] = last and _is_borne(contact, w, i)
    # All at once, so that their order does not matter
    for i in range(world.alive.shape[1]):
        if contact.dozes[w, i]:
            contact.dozes[w, i] = False
            contact.asleep[w, i] = True
            contact.load[w, i, 0] = np.nan
            _note_support(contact, world, swarm, i)
            support = contact.support[w, i]
            if support.span > 0.0:
                # What its support takes from it
                lost = world.parameters[w, i].mass * dot(vec3(swarm.velocity, w, i), support.normal)
                contact.touches.impulse[w, i, 0] -= lost
            for k in range(3):
                swarm.velocity[w, i, k] = 0.0
                swarm.rates[w, i, k] = 0.0


@func
def _is_safe(
    contact: Contact,
    world: World,
    i: int,
) -> bool:
    """Tell whether the support of a drone bears the forces of this substep."""
    support = contact.support[world.w, i]
    if support.span <= 0.0:
        return False
    motion = contact.space.motions[i]
    scale = 1.0 / world.dt
    acceleration = plus((0.0, 0.0, 0.0), scale, vector(motion.push))
    torque = plus((0.0, 0.0, 0.0), scale, vector(motion.twist))
    _, borne = pressing(support, world.parameters[world.w, i].mass, acceleration, torque)
    return borne


@func
def _is_borne(
    contact: Contact,
    w: int,
    i: int,
) -> bool:
    """Tell whether a drone touches something that does not yield, or somebody who sleeps on it."""
    touches = contact.touches
    for k in range(touches.number[w, i]):
        other = touches.other[w, i, k]
        if other >= contact.scenery.first_body or contact.asleep[w, other]:
            return True
    return False


@func
def _note_support(
    contact: Contact,
    world: World,
    swarm: Swarm,
    i: int,
) -> None:
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
        find_support(support, contact.space, world, swarm, i, touches.other[w, i, 0])
    if support.span > 0.0:
        # How it is pressed down is told of each substep
        slept.impulse[w, i, 0] = 0.0


@func
def _put_back(
    contact: Contact,
    swarm: Swarm,
    w: int,
    i: int,
) -> None:
    """Put a drone back to where it was at the beginning of the substep, at rest."""
    for k in range(3):
        swarm.position[w, i, k] = contact.start.position[w, i, k]
        swarm.velocity[w, i, k] = 0.0
        swarm.rates[w, i, k] = 0.0
    for k in range(4):
        swarm.quaternion[w, i, k] = contact.start.quaternion[w, i, k]
