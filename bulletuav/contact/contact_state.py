"""State of the contacts of all worlds, and waking of sleeping drones.

A drone is put to sleep after `TIME_TO_SLEEP` at rest, and then costs next to nothing. A sleeping
drone wakes when its forces change by more than its support can take, when something touches it,
when a drone next to it wakes, or when an obstacle comes near.
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
"""Distance between bounding spheres within which sleeping drones wake each other, m"""
MAX_LOAD_CHANGE = 0.02
"""Change of acceleration that wakes a sleeping drone, m/s^2"""
TIME_TO_SLEEP = 0.25
"""Time at rest after which a drone sleeps, unless it rests safely on a face, s"""


class ObstacleTurns(NamedTuple):
    """Rotation of the task's obstacles in the present decision.

    Attributes:
        before: (W, K, 4) attitudes at the beginning of the decision, body to world.
        rotation: (W, K, 3) rotations in the decision, axis times angle, world axes, rad.
    """

    before: np.ndarray
    rotation: np.ndarray


class ContactState(NamedTuple):
    """State of the contacts of W worlds of N drones, for compiled code.

    Attributes:
        scenery: All shapes.
        space: Arrays to work on.
        start: State at the beginning of the present substep.
        budget: (W, N) distance that each drone may move before it is checked, m.
        uses_rotation: (W, N) bool, drones close to the ground, whose rotation uses up budget.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Coefficient of restitution of the ground and of buildings.
        stops: True if drones stop at a contact instead of receiving an impulse.
        sleeps: True if drones at rest are put to sleep.
        asleep: (W, N) bool, sleeping drones.
        quiet: (W, N) how long each drone has been at rest, s.
        pace: (W, N) speed of each drone when it came to rest, m/s.
        load: (W, N, 6) accelerations of sleeping drones without contacts, m/s^2 and rad/s^2; NaN at
            first.
        support: (W, N) rows of `SUPPORT`, what sleeping drones rest on.
        slept: Contacts of each sleeping drone in the decision in which it was put to sleep.
        dozes: (W, N) bool, drones that are about to sleep or to wake.
        flew: (W, N) bool, drones that were active in the last decision.
        stopped: (W, N) bool, drones that stopped in this decision.
        changed: (W, N) bool, drones whose state the last substep changed.
        touches: Contacts of this decision.
        speed: (W,) speed of the fastest point of any obstacle in this decision, m/s.
        before: (W, K, 3) positions of the task's obstacles at the beginning of the decision, m.
        after: (W, K, 3) positions of the task's obstacles at the end of the decision, m.
        turns: Rotation of the task's obstacles in the decision.
        memory: Contact cache: impulses of the last substep.
    """

    scenery: Scenery
    space: ContactWorkspace
    start: Swarm
    budget: np.ndarray
    uses_rotation: np.ndarray
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
    turns: ObstacleTurns
    memory: ContactCache

    def for_thread(self) -> "ContactState":
        """Return the same state with arrays to work on for another thread."""
        return self._replace(space=make_contact_workspace(self.budget.shape[1]))


def make_contact_state(
    scenery: Scenery,
    shape: tuple[int, int, int],
    stops: bool,
    sleeps: bool,
    friction: float,
    restitution: float,
) -> ContactState:
    """Create the state of the contacts of W worlds of N drones.

    Args:
        scenery: All shapes.
        shape: (W, N, K), with K obstacles of the task.
        stops: True if drones stop at a contact instead of receiving an impulse.
        sleeps: True if drones at rest are put to sleep; the dynamics then calls `stays_asleep`.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Coefficient of restitution of the ground and of buildings.
    """
    worlds, drones, obstacles = shape
    each = (worlds, drones)
    return ContactState(
        scenery=scenery,
        space=make_contact_workspace(drones),
        start=Swarm.zeros(*each, 0),
        budget=np.full(each, -1.0),
        uses_rotation=np.zeros(each, dtype=bool),
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
        turns=ObstacleTurns(np.zeros((worlds, obstacles, 4)), np.zeros((worlds, obstacles, 3))),
        memory=make_contact_cache(*each),
    )


@func
def wake_drone(contact: ContactState, w: int, i: int) -> None:
    """Wake a drone, if it sleeps, and all drones that sleep in a pile with it."""
    space = contact.space
    asleep = contact.asleep
    if not asleep[w, i]:
        return
    # Flood fill: each woken drone, listed in `island`, wakes the sleeping drones near it
    num_woken = 1
    done = 0
    space.island[0] = i
    asleep[w, i] = False
    radius = contact.scenery.table.radius
    while done < num_woken:
        k = space.island[done]
        done += 1
        contact.quiet[w, k] = 0.0
        contact.budget[w, k] = -1.0
        for j in range(asleep.shape[1]):
            if asleep[w, j]:
                between = minus(
                    vec3(contact.start.position, w, k), vec3(contact.start.position, w, j)
                )
                within = radius[k] + radius[j] + WAKE_DISTANCE
                if dot(between, between) < within * within:
                    asleep[w, j] = False
                    space.island[num_woken] = j
                    num_woken += 1


@func
def wake_near_obstacles(contact: ContactState, world: ContactWorld) -> None:
    """Wake the sleeping drones that a moving obstacle comes near to."""
    w = world.w
    scenery = contact.scenery
    for i in range(world.alive.shape[1]):
        if not contact.asleep[w, i]:
            continue
        here = vec3(contact.start.position, w, i)
        near = scenery.table.radius[i] + 2.0 * world.obstacle_displacement + WAKE_DISTANCE
        for k in range(scenery.place.shape[1]):
            drift, spin = vec3(scenery.velocity, w, k), vec3(scenery.spin, w, k)
            moves = dot(drift, drift) > 0.0 or dot(spin, spin) > 0.0
            if moves and bound_body_distance(scenery, w, k, here) < near:
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
    """Check whether a sleeping drone stays at rest under its forces, and record the support force.

    Args:
        contact: State of all contacts; the drone's load is set at the first call, and impulses are
            added to.
        w: Index of the world.
        i: Index of the drone.
        quaternion: Attitude of the drone.
        acceleration: Acceleration by forces without contacts, m/s^2.
        spinning: Change of its body rates by torques, rad/s^2.
        row: Row of `PARAMETERS` of the drone.
        dt: Length of the substep, s.
    """
    pressed, is_safe = press_support(contact.support[w, i], quaternion, acceleration, spinning, row)
    return withstands(contact, w, i, acceleration, spinning, pressed, is_safe, dt)


@func
def press_support(
    support: np.record, quaternion: Quat4, acceleration: Vec3, spinning: Vec3, row: np.record
) -> tuple[float, bool]:
    """Compute the force on the support of one sleeping drone, or of lanes; see `stays_asleep`.

    Returns:
        The results of `compute_support_force`.
    """
    inertia = row.inertia
    twist = (inertia[0] * spinning[0], inertia[1] * spinning[1], inertia[2] * spinning[2])
    return compute_support_force(support, row.mass, acceleration, to_world(quaternion, twist))


@func
def withstands(
    contact: ContactState,
    w: int,
    i: int,
    acceleration: Vec3,
    spinning: Vec3,
    pressed: float,
    is_safe: bool,
    dt: float,
) -> bool:
    """Do the same as `stays_asleep`, with the results of `press_support`."""
    load = contact.load[w, i]
    first = bool(np.isnan(load[0]))
    if first:
        for k in range(3):
            load[k] = acceleration[k]
            load[3 + k] = spinning[k]
    contact.touches.impulse[w, i, 0] += pressed * dt
    if is_safe:
        return True
    if first:
        # Without a safe support, the drone must have been at rest for `TIME_TO_SLEEP`
        return bool(contact.quiet[w, i] >= TIME_TO_SLEEP)
    radius = contact.scenery.table.radius[i]
    for k in range(3):
        if abs(load[k] - acceleration[k]) > MAX_LOAD_CHANGE:
            return False
        if radius * abs(load[3 + k] - spinning[k]) > MAX_LOAD_CHANGE:
            return False
    return True
