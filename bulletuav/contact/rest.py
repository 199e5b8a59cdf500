"""Rest: drones that lie still sleep, and cost next to nothing, until something changes.

A drone falls asleep after lying still for `LONG`. It wakes when its forces change by more than its
support bears, when something touches it, when a drone that lies by it wakes, or when an obstacle
comes near.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.memory import Memory, make_memory
from bulletuav.contact.pairs import body_distance
from bulletuav.contact.points import Workspace, World, make_workspace
from bulletuav.contact.support import SUPPORT, pressing
from bulletuav.contact.touches import Touches, make_touches
from bulletuav.geometry.rotation import Quat4, Vec3, dot, minus, to_world, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

NEARBY = 0.01
"""Distance between bounding spheres within which sleepers wake each other, m"""
SAME_LOAD = 0.02
"""Change of acceleration that wakes a sleeper, m/s^2"""
LONG = 0.25
"""How long it is before it does elsewhere, s"""


class Contact(NamedTuple):
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
    space: Workspace
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
def wake(contact: Contact, w: int, i: int) -> None:
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
