"""Contacts of all worlds: what compiled dynamics call in every substep, and what is told after."""

from typing import NamedTuple

import numpy as np

from bulletuav.contact.impact import Workspace, World, make_workspace, tell_pair
from bulletuav.contact.pairs import make_pairs
from bulletuav.contact.resolve import find_pairs, in_order, resolve
from bulletuav.contact.touches import Touches, make_touches
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import CITY, GROUND, Contacts, Motion, Swarm


class Contact(NamedTuple):
    """What contacts of W worlds of N drones need, for compiled code.

    Attributes:
        scenery: What stands, and all shapes.
        space: Arrays to work on.
        start: State at the beginning of the present substep.
        budget: (W, N) how far each drone may move before it must be looked at, m.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
        stops: Whether drones stop where they touch, instead of being pushed.
        stopped: (W, N) bool, drones that stopped in this decision.
        changed: (W, N) bool, drones whose state the last substep changed.
        touches: What was touched in this decision.
        before: (W, K, 3) positions of the task's obstacles at the beginning of the decision, m.
        after: (W, K, 3) the same at its end.
    """

    scenery: Scenery
    space: Workspace
    start: Swarm
    budget: np.ndarray
    friction: float
    restitution: float
    stops: bool
    stopped: np.ndarray
    changed: np.ndarray
    touches: Touches
    before: np.ndarray
    after: np.ndarray


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
def _move_obstacles(contact: Contact, w: int, begin: float, period: float) -> float:
    """Put the obstacles of a world where they are after a share of the decision.

    Args:
        contact: Its scenery is written.
        w: The world.
        begin: The share.
        period: Length of the decision, s.

    Returns:
        Speed of the fastest, m/s.
    """
    fastest = 0.0
    for k in range(contact.before.shape[1]):
        square = 0.0
        for m in range(3):
            change = contact.after[w, k, m] - contact.before[w, k, m]
            contact.scenery.place[w, k, m] = contact.before[w, k, m] + begin * change
            contact.scenery.velocity[w, k, m] = change / period
            square += (change / period) ** 2
        fastest = max(fastest, square)
    return np.sqrt(fastest)


@kernel
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
    for i in range(alive.shape[1]):
        contact.changed[w, i] = False
    speed = dt * _move_obstacles(contact, w, piece / pieces, pieces * dt)
    world = World(
        w,
        dt,
        speed,
        contact.friction,
        contact.restitution,
        contact.scenery,
        contact.start,
        alive,
        parameters,
    )
    return resolve(
        contact.space,
        world,
        swarm,
        contact.budget,
        contact.stops,
        contact.stopped,
        contact.changed,
        contact.touches,
    )


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


def make_contact(
    scenery: Scenery,
    shape: tuple[int, int],
    stops: bool,
    friction: float,
    restitution: float,
) -> Contact:
    """Make what contacts of W worlds of N drones need.

    Args:
        scenery: What stands, and all shapes.
        shape: (W, N).
        stops: Whether drones stop where they touch, instead of being pushed.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
    """
    nowhere = np.zeros((shape[0], 0, 3))
    return Contact(
        scenery=scenery,
        space=make_workspace(shape[1]),
        start=Swarm.zeros(*shape, 0),
        budget=np.full(shape, -1.0),
        friction=friction,
        restitution=restitution,
        stops=stops,
        stopped=np.zeros(shape, dtype=bool),
        changed=np.zeros(shape, dtype=bool),
        touches=make_touches(*shape),
        before=nowhere,
        after=nowhere,
    )


def begin_decision(contact: Contact, scenery: Scenery, motion: Motion) -> Contact:
    """Forget what the last decision touched, and take over where obstacles go in this one.

    Args:
        contact: Of the last decision.
        scenery: What stands now.
        motion: Of the task's obstacles.

    Returns:
        The same arrays, for this decision.
    """
    contact.touches.count[:] = 0
    contact.stopped[:] = False
    # Obstacles that were moved since, or are new, may be near at once
    count = motion.before.shape[1]
    if scenery is not contact.scenery:
        contact.budget[:] = -1.0
    elif count:
        jumped = np.any(scenery.place[:, :count] != motion.before, axis=(1, 2))
        contact.budget[jumped] = -1.0
    return contact._replace(scenery=scenery, before=motion.before, after=motion.after)


def told(contact: Contact) -> Contacts:
    """Tell what was touched in a decision, sorted by world, drone and other."""
    touches = contact.touches
    if not touches.count.any():
        return Contacts.none()
    scenery = contact.scenery
    used = np.arange(touches.other.shape[-1]) < touches.count[..., None]
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


@kernel
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
        world = World(w, 1.0, 0.0, 0.0, 0.0, contact.scenery, swarm, alive, parameters)
        for i in range(alive.shape[1]):
            space.due[i] = moved[w, i] and alive[w, i]
            space.begun[i] = False
            space.reach[i] = 0.0
        order = in_order(swarm.position, w)
        pairs, count = find_pairs(space, world, swarm, order, make_pairs(16))
        for p in range(count):
            tell_pair(space, world, pairs, p, contact.touches)


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
    contact.touches.count[:] = 0
    _note_overlaps(contact, swarm, moved, alive, parameters)
    contact.budget[moved] = -1.0
    return told(contact)
