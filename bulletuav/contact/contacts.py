"""Contacts of all worlds: what compiled dynamics call in every substep, and what is told after."""

import math

import numpy as np

from bulletuav.contact.impact import tell_pair
from bulletuav.contact.points import World
from bulletuav.contact.resolve import find_pairs, in_order, resolve
from bulletuav.contact.rest import Contact, settle, wake_for_obstacles
from bulletuav.geometry.rotation import dot, minus, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import allocating, borrowed, func, kernel
from bulletuav.vehicle.swarm import CITY, GROUND, Contacts, Motion, Swarm


@func
def remember(contact: Contact, swarm: Swarm, w: int) -> None:
    """Keep the state of a world at the beginning of a substep."""
    start = contact.start
    for i in range(start.position.shape[1]):
        for k in range(3):
            start.position[w, i, k] = swarm.position[w, i, k]
            start.velocity[w, i, k] = swarm.velocity[w, i, k]
            start.rates[w, i, k] = swarm.rates[w, i, k]
        for k in range(4):
            start.quaternion[w, i, k] = swarm.quaternion[w, i, k]


@func
def move_obstacles(contact: Contact, w: int, share: float, period: float) -> None:
    """Put the obstacles of a world where they are after a share of the decision.

    Args:
        contact: Its scenery is written.
        w: The world.
        share: Of the decision, 0 to 1.
        period: Length of the decision, s.
    """
    for k in range(contact.before.shape[1]):
        for m in range(3):
            change = contact.after[w, k, m] - contact.before[w, k, m]
            contact.scenery.place[w, k, m] = contact.before[w, k, m] + share * change
            contact.scenery.velocity[w, k, m] = change / period


@kernel
def place_obstacles(contact: Contact, share: float, period: float) -> None:
    """Do what `move_obstacles` does in all worlds in which any moves."""
    for w in range(contact.speed.shape[0]):
        if contact.speed[w] > 0.0:
            move_obstacles(contact, w, share, period)


@func
def _is_due(contact: Contact, swarm: Swarm, alive: np.ndarray, w: int, dt: float) -> bool:
    """Take what drones moved off their budgets; tells whether the world needs a closer look."""
    found = False
    before = contact.start.position
    way = contact.speed[w] * dt
    for i in range(alive.shape[1]):
        contact.changed[w, i] = False
        contact.due[w, i] = False
        if not alive[w, i]:
            continue
        if contact.asleep[w, i]:
            # Obstacles that move may come near to who sleeps
            found = found or way > 0.0
            continue
        moved = minus(vec3(swarm.position, w, i), vec3(before, w, i))
        contact.budget[w, i] -= math.sqrt(dot(moved, moved)) + way
        if contact.budget[w, i] < 0.0:
            contact.due[w, i] = True
            found = True
    return found


@func
def meet(
    contact: Contact,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    piece: int,
    pieces: int,
    dt: float,
) -> bool:
    """Let the drones of a world touch what they would have flown into in a substep.

    Args:
        contact: Of all worlds; `remember` was called at the beginning of the substep.
        swarm: State at its end, as flown freely; changed.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.
        w: The world.
        piece: Which substep of the decision it is.
        pieces: How many there are.
        dt: Length of a substep, s.

    Returns:
        Whether anything was touched.
    """
    if not _is_due(contact, swarm, alive, w, dt):
        return False
    return _look(contact, swarm, alive, parameters, w, piece, pieces, dt)


@kernel
def _look(
    contact: Contact,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    piece: int,
    pieces: int,
    dt: float,
) -> bool:
    """Do what `meet` does in a world where drones are due."""
    contact = borrowed(contact)
    move_obstacles(contact, w, piece / pieces, pieces * dt)
    world = World(
        w,
        dt,
        contact.speed[w] * dt,
        contact.friction,
        contact.restitution,
        contact.scenery,
        contact.start,
        borrowed(alive),
        contact.asleep,
        borrowed(parameters),
        contact.memory,
    )
    if contact.sleeps and world.speed > 0.0:
        wake_for_obstacles(contact, world)
    eventful = resolve(
        contact.space,
        world,
        swarm,
        contact.due,
        contact.budget,
        contact.stops,
        contact.stopped,
        contact.changed,
        contact.touches,
    )
    if contact.sleeps:
        settle(contact, world, swarm, piece + 1 == pieces)
    return eventful


@kernel
def meet_all(
    contact: Contact,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
    piece: int,
    pieces: int,
    dt: float,
) -> bool:
    """Do what `meet` does in all worlds; returns whether any state was changed."""
    eventful = False
    for w in range(alive.shape[0]):
        eventful |= meet(contact, swarm, alive, parameters, w, piece, pieces, dt)
    return eventful


@kernel
def remember_all(contact: Contact, swarm: Swarm) -> None:
    """Keep the state of all worlds at the beginning of a substep."""
    for w in range(swarm.position.shape[0]):
        remember(contact, swarm, w)


def start(contact: Contact, mask: np.ndarray) -> None:
    """Forget what was before of drones that are put somewhere else.

    Args:
        contact: Changed; all who sleep in these worlds wake.
        mask: (W, N) bool, drones that are put somewhere else.
    """
    contact.budget[mask] = -1.0
    contact.asleep[np.any(mask, axis=1)] = False
    contact.quiet[mask] = 0.0
    contact.memory.number[mask] = 0


def begin_decision(
    contact: Contact,
    scenery: Scenery,
    motion: Motion,
    alive: np.ndarray,
    period: float,
) -> Contact:
    """Forget what the last decision touched, and take over where obstacles go in this one.

    Args:
        contact: Of the last decision.
        scenery: What stands now.
        motion: Of the task's obstacles.
        alive: (W, N) bool, drones that fly.
        period: Length of the decision, s.

    Returns:
        The same arrays, for this decision.
    """
    touches = contact.touches
    if touches.number.any():
        touches.number[:] = 0
    if contact.stops:
        contact.stopped[:] = False
    if contact.sleeps:
        _take_over_sleepers(contact, alive)
    # Obstacles that were moved since, or are new, may be near at once
    count = motion.before.shape[1]
    if scenery is not contact.scenery:
        contact.budget[:] = -1.0
        contact.asleep[:] = False
    elif count:
        jumped = np.any(scenery.place[:, :count] != motion.before, axis=(1, 2))
        contact.budget[jumped] = -1.0
        contact.asleep[jumped] = False
    if motion.moving:
        moved = motion.after - motion.before
        contact.speed[:] = np.sqrt((moved * moved).sum(axis=-1)).max(axis=1) / period
    elif count:
        contact.speed[:] = 0.0
    return contact._replace(scenery=scenery, before=motion.before, after=motion.after)


def _take_over_sleepers(contact: Contact, alive: np.ndarray) -> None:
    """Tell what sleepers touched before, and wake those in whose world a drone came or went."""
    if not contact.asleep.any():
        contact.flew[:] = alive
        return
    contact.asleep[np.any(contact.flew != alive, axis=1)] = False
    contact.flew[:] = alive
    kept = contact.asleep
    contact.touches.number[kept] = contact.slept.number[kept]
    contact.touches.impulse[kept] = contact.slept.impulse[kept]


def told(contact: Contact) -> Contacts:
    """Tell what was touched in a decision, sorted by world, drone and other."""
    touches = contact.touches
    if not touches.number.any():
        return Contacts.none()
    scenery = contact.scenery
    used = np.arange(touches.other.shape[-1]) < touches.number[..., None]
    world, drone, _ = np.nonzero(used)
    number = touches.other[used]
    # Numbers of shapes as `Contacts` calls who they belong to
    other = np.where(number < scenery.first_body, number, CITY)
    other[number == scenery.ground] = GROUND
    bodies = (number >= scenery.first_body) & (number < scenery.first_piece)
    other[bodies] = scenery.other[number[bodies] - scenery.first_body]
    return Contacts.merged(
        world=world,
        drone=drone,
        other=other,
        impulse=touches.impulse[used],
        point=touches.place[used],
        normal=touches.normal[used],
        velocity=touches.velocity[used],
    )


@allocating
def _note_overlaps(
    contact: Contact,
    swarm: Swarm,
    moved: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> None:
    """Tell what drones are in touch with that were put somewhere else; see `overlaps`."""
    space = contact.space
    for w in range(alive.shape[0]):
        world = World(
            w,
            1.0,
            0.0,
            0.0,
            0.0,
            contact.scenery,
            swarm,
            alive,
            contact.asleep,
            parameters,
            contact.memory,
        )
        for i in range(alive.shape[1]):
            space.motions[i].due = moved[w, i] and alive[w, i]
            space.motions[i].reach = 0.0
        order = in_order(swarm.position, w)
        pairs, count = find_pairs(space, world, swarm, order)
        for p in range(count):
            tell_pair(space, world, pairs[p], contact.touches)


def overlaps(
    contact: Contact,
    swarm: Swarm,
    moved: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> Contacts:
    """Find what drones touch that were put somewhere else.

    Args:
        contact: What contacts need; its touches are forgotten.
        swarm: State of all drones; nothing is written.
        moved: (W, N) bool, drones that were moved.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.

    Returns:
        The contacts of `moved` drones with others and what stands, without impulse.
    """
    contact.touches.number[:] = 0
    _note_overlaps(contact, swarm, moved, alive, parameters)
    contact.budget[moved] = -1.0
    return told(contact)
