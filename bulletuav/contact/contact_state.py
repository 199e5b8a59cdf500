"""Rest: drones that lie still sleep, and cost next to nothing, until something changes.

A drone falls asleep after lying still for `TIME_TO_SLEEP`. It wakes when its forces change by more than its
support bears, when something touches it, when a drone that lies by it wakes, or when an obstacle
comes near.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.broad_phase import bound_body_distance
from bulletuav.contact.contact_log import ContactLog, make_contact_log
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld, make_contact_workspace
from bulletuav.contact.resting_support import SUPPORT, compute_support_force
from bulletuav.contact.warm_start import ContactCache, make_contact_cache
from bulletuav.geometry.rotation import Quat4, Vec3, dot, minus, to_world, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

WAKE_DISTANCE = 0.01
"""Distance between bounding spheres within which sleepers wake each other, m"""
MAX_LOAD_CHANGE = 0.02
"""Change of acceleration that wakes a sleeper, m/s^2"""
TIME_TO_SLEEP = 0.25
"""How long it is before it does elsewhere, s"""


class ContactState(NamedTuple):
    """What contacts of W worlds of N drones need, for compiled code.

    Attributes:
        scenery: What stands, and all shapes.
        space: Arrays to work on.
        start: State at the beginning of the present substep.
        budget: (W, N) how far each drone may move before it must be looked at, m.
        turns: (W, N) bool, drones that fly low: their turns count there as ways.
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
        dozes: (W, N) bool, drones that fall asleep now, or wake.
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
    space: ContactWorkspace
    start: Swarm
    budget: np.ndarray
    turns: np.ndarray
    friction: float
    restitution: float
    stops: bool
    sleeps: bool
    asleep: np.ndarray
    quiet: np.ndarray
    pace: np.ndarray
    load: np.ndarray
    support: np.ndarray
    slept: ContactLog
    dozes: np.ndarray
    flew: np.ndarray
    stopped: np.ndarray
    changed: np.ndarray
    touches: ContactLog
    speed: np.ndarray
    before: np.ndarray
    after: np.ndarray
    memory: ContactCache


def make_contact_state(
    scenery: Scenery,
    shape: tuple[int, int, int],
    stops: bool,
    sleeps: bool,
    friction: float,
    restitution: float,
) -> ContactState:
    """Make what contacts of W worlds of N drones need.

    Args:
        scenery: What stands, and all shapes.
        shape: (W, N, K), of which K are the task's obstacles.
        stops: Whether drones stop where they touch, instead of being pushed.
        sleeps: Whether drones that rest are left alone until something changes; the dynamics asks
            `stays_asleep` of them.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
    """
    worlds, drones, obstacles = shape
    each = (worlds, drones)
    return ContactState(
        scenery=scenery,
        space=make_contact_workspace(drones),
        start=Swarm.zeros(*each, 0),
        budget=np.full(each, -1.0),
        turns=np.zeros(each, dtype=bool),
        friction=friction,
        restitution=restitution,
        stops=stops,
        sleeps=sleeps and not stops,
        asleep=np.zeros(each, dtype=bool),
        quiet=np.zeros(each),
        pace=np.zeros(each),
        load=np.full((*each, 6), np.nan),
        support=np.zeros(each, dtype=SUPPORT),
        slept=make_contact_log(*each),
        dozes=np.zeros(each, dtype=bool),
        flew=np.zeros(each, dtype=bool),
        stopped=np.zeros(each, dtype=bool),
        changed=np.zeros(each, dtype=bool),
        touches=make_contact_log(*each),
        speed=np.zeros(worlds),
        before=np.zeros((worlds, obstacles, 3)),
        after=np.zeros((worlds, obstacles, 3)),
        memory=make_contact_cache(*each),
    )


@func
def wake_drone(contact: ContactState, w: int, i: int) -> None:
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
                within = radius[k] + radius[j] + WAKE_DISTANCE
                if dot(gap, gap) < within * within:
                    asleep[w, j] = False
                    space.island[count] = j
                    count += 1


@func
def wake_near_obstacles(contact: ContactState, world: ContactWorld) -> None:
    """Wake the sleepers that an obstacle which moves comes near to."""
    w = world.w
    scenery = contact.scenery
    for i in range(world.alive.shape[1]):
        if not contact.asleep[w, i]:
            continue
        here = vec3(contact.start.position, w, i)
        near = scenery.table.radius[i] + 2.0 * world.speed + WAKE_DISTANCE
        for k in range(contact.before.shape[1]):
            drift = vec3(scenery.velocity, w, k)
            if dot(drift, drift) > 0.0 and bound_body_distance(scenery, w, k, here) < near:
                wake_drone(contact, w, i)


@func
def stays_asleep(
    contact: ContactState,
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
        pressed, borne = compute_support_force(
            support, row.mass, acceleration, to_world(quaternion, twist)
        )
        contact.touches.impulse[w, i, 0] += pressed * dt
        if borne:
            return True
    if first:
        # On a face alone it has been at rest for too short a time to trust that
        return bool(contact.quiet[w, i] >= TIME_TO_SLEEP)
    reach = contact.scenery.table.radius[i]
    for k in range(3):
        if abs(load[k] - acceleration[k]) > MAX_LOAD_CHANGE:
            return False
        if reach * abs(load[3 + k] - spinning[k]) > MAX_LOAD_CHANGE:
            return False
    return True
