"""Contacts of all worlds: the functions that dynamics call in each substep, and their results."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import allocating, func, in_memory, kernel
from bulletuav.contact.contact_state import ContactState, wake_near_obstacles
from bulletuav.contact.impact import record_overlap
from bulletuav.contact.manifold import ContactWorld
from bulletuav.contact.motion_bounds import update_budgets
from bulletuav.contact.moving_bodies import STILL, bound_body_motion, place_world_bodies
from bulletuav.contact.obstacle_turns import turn_obstacle
from bulletuav.contact.sleeping import update_sleep
from bulletuav.contact.sorting import sort_drones
from bulletuav.contact.substep import find_pairs, resolve_contacts
from bulletuav.geometry.rotation import dot, minus, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import CITY, GROUND, Contacts, DroneArrays, Swarm, TimeStep


@func
def save_start_state(contact: ContactState, swarm: Swarm, w: int, low: int, high: int) -> None:
    """Copy the state of drones `low` to before `high` at the beginning of a substep."""
    start = contact.start
    # Read the arrays once: the compiler cannot know that writing to them does not change them
    position, quaternion, velocity, rates = (
        (start.position, swarm.position),
        (start.quaternion, swarm.quaternion),
        (start.velocity, swarm.velocity),
        (start.rates, swarm.rates),
    )
    for i in range(low, high):
        for k in range(3):
            position[0][w, i, k] = position[1][w, i, k]
            velocity[0][w, i, k] = velocity[1][w, i, k]
            rates[0][w, i, k] = rates[1][w, i, k]
        for k in range(4):
            quaternion[0][w, i, k] = quaternion[1][w, i, k]


@func
def place_world_obstacles(contact: ContactState, w: int, substep: int, step: TimeStep) -> None:
    """Set the obstacles and bodies of a world to their poses at the beginning of a substep.

    Args:
        contact: State of all contacts; its scenery is written.
        w: Index of the world.
        substep: Index of the substep in the decision.
        step: Division of the decision into substeps.
    """
    fraction, period = substep / step.substeps, step.substeps * step.dt
    for k in range(contact.before.shape[1]):
        for m in range(3):
            change = contact.after[w, k, m] - contact.before[w, k, m]
            contact.scenery.place[w, k, m] = contact.before[w, k, m] + fraction * change
            contact.scenery.velocity[w, k, m] = change / period
        if vec3(contact.turns.rotation, w, k) != STILL:
            turn_obstacle(contact.scenery, contact.turns, w, k, fraction, period)
    later = (substep + 1) / step.substeps
    place_world_bodies(contact.scenery, w, fraction, later, step.dt)


@kernel
def place_obstacles(
    contact: ContactState, first: int, last: int, substep: int, step: TimeStep
) -> None:
    """Set the obstacles of worlds in which any moves; see `place_world_obstacles`.

    Args:
        contact: State of all contacts.
        first: The first world.
        last: The world after the last one.
        substep: Index of the substep in the decision.
        step: Division of the decision into substeps.
    """
    for w in range(first, last):
        if contact.speed[w] > 0.0:
            place_world_obstacles(contact, w, substep, step)


@func
def step_contacts(
    contact: ContactState, drones: DroneArrays, w: int, substep: int, step: TimeStep
) -> bool:
    """Detect and resolve the contacts of one world in a substep.

    Args:
        contact: State of all contacts; `save_start_state` was called at the beginning of the
            substep.
        drones: All drones, with the state at the end of the substep as flown without contacts;
            changed.
        w: Index of the world.
        substep: Index of the substep in the decision.
        step: Division of the decision into substeps.

    Returns:
        True if there was any impact.
    """
    if not update_budgets(
        contact, drones.swarm, drones.alive, w, step.dt, 0, drones.alive.shape[1]
    ):
        return False
    return resolve_world(contact, drones, w, substep, step)


@kernel
def resolve_world(
    contact: ContactState, drones: DroneArrays, w: int, substep: int, step: TimeStep
) -> bool:
    """Resolve the contacts of a world in which drones have to be checked; see `step_contacts`."""
    contact = in_memory(contact)
    place_world_obstacles(contact, w, substep, step)
    world = in_memory(
        ContactWorld(
            w,
            step.dt,
            contact.speed[w] * step.dt,
            contact.friction,
            contact.restitution,
            contact.stops,
            contact.scenery,
            contact.start,
            drones.alive,
            contact.asleep,
            drones.parameters,
            contact.memory,
        )
    )
    swarm = in_memory(drones.swarm)
    if contact.sleeps and world.obstacle_displacement > 0.0:
        wake_near_obstacles(contact, world)
    any_impact = resolve_contacts(
        contact.space,
        world,
        swarm,
        contact.budget,
        contact.uses_rotation,
        contact.stopped,
        contact.changed,
        contact.touches,
    )
    if contact.sleeps:
        update_sleep(contact, world, swarm, substep + 1 == step.substeps)
    return any_impact


@kernel
def step_all_contacts(
    contact: ContactState, drones: DroneArrays, substep: int, step: TimeStep
) -> bool:
    """Detect and resolve the contacts of all worlds; returns whether any state was changed."""
    any_impact = False
    for w in range(drones.alive.shape[0]):
        any_impact |= step_contacts(contact, drones, w, substep, step)
    return any_impact


@kernel
def save_all_start_states(contact: ContactState, swarm: Swarm) -> None:
    """Copy the state of all worlds at the beginning of a substep."""
    for w in range(swarm.position.shape[0]):
        save_start_state(contact, swarm, w, 0, swarm.position.shape[1])


@func
def _restore_sleeper_contacts(contact: ContactState, alive: np.ndarray, w: int) -> None:
    """Restore the contacts of sleeping drones from the decision in which they were put to sleep.

    Sleeping drones wake if a drone was added to their world or removed from it.
    """
    touches, slept = contact.touches, contact.slept
    same = True
    for i in range(alive.shape[1]):
        same = same and contact.flew[w, i] == alive[w, i]
        contact.flew[w, i] = alive[w, i]
    for i in range(alive.shape[1]):
        contact.asleep[w, i] = contact.asleep[w, i] and same
        if contact.asleep[w, i]:
            touches.number[w, i] = slept.number[w, i]
            for k in range(touches.impulse.shape[2]):
                touches.impulse[w, i, k] = slept.impulse[w, i, k]


@kernel
def start_decision(contact: ContactState, alive: np.ndarray, period: float) -> None:
    """Clear the contacts of the last decision, and compute the speed of obstacles in this one.

    Args:
        contact: State of all contacts; `before` and `after` give the positions of obstacles.
        alive: (W, N) bool, active drones.
        period: Length of the decision, s.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            contact.touches.number[w, i] = 0
            contact.stopped[w, i] = False
        if contact.sleeps:
            _restore_sleeper_contacts(contact, alive, w)

        # Obstacles that were moved since the last decision may be close to any drone
        jumped, square, turning = False, 0.0, 0.0
        for k in range(contact.before.shape[1]):
            begin, end = vec3(contact.before, w, k), vec3(contact.after, w, k)
            displacement = minus(end, begin)
            square = max(square, dot(displacement, displacement))
            rotation = vec3(contact.turns.rotation, w, k)
            if rotation != STILL:
                reach = contact.scenery.table.radius[contact.scenery.first_body + k]
                turning = max(turning, math.sqrt(dot(rotation, rotation)) * reach)
            jumped = jumped or vec3(contact.scenery.place, w, k) != begin
        fastest = max(math.sqrt(square) + turning, bound_body_motion(contact.scenery.bodies, w))
        contact.speed[w] = fastest / period
        if jumped:
            for i in range(alive.shape[1]):
                contact.budget[w, i] = -1.0
                contact.asleep[w, i] = False


def get_state_arrays(contact: ContactState) -> dict[str, np.ndarray]:
    """Return all arrays (W, ...) by name on which later contacts depend."""
    parts: dict[str, Any] = contact._asdict()
    for name in ("slept", "touches", "memory"):
        parts |= {f"{name} {key}": one for key, one in getattr(contact, name)._asdict().items()}
    return {name: one for name, one in parts.items() if isinstance(one, np.ndarray)}


def replace_scenery(contact: ContactState, scenery: Scenery) -> ContactState:
    """Return the contact state with another scenery; resets all budgets and wakes all drones."""
    contact.budget[:] = -1.0
    contact.asleep[:] = False
    return contact._replace(scenery=scenery)


@func
def _get_owner(number: int, names: tuple[int, int, int, np.ndarray]) -> int:
    """Return the number in `Contacts.other` for a shape; see `summarize_contacts` for `names`."""
    first_body, first_piece, ground, other = names
    if number < first_body:
        return number
    if number < first_piece:
        return int(other[number - first_body])
    return GROUND if number == ground else CITY


@kernel
def summarize_contacts(
    number: np.ndarray,
    other: np.ndarray,
    impulses: np.ndarray,
    names: tuple[int, int, int, np.ndarray],
    velocity: np.ndarray,
    rates: np.ndarray,
    slowest: float,
    slowest_spin: float,
    collision: np.ndarray,
    resting: np.ndarray,
    impulse: np.ndarray,
) -> None:
    """Summarize the contacts of each drone in a decision.

    Args:
        number: (W, N) number of contacts of each drone, as in `ContactLog`.
        other: (W, N, T) indices of the other shapes, as in `ContactLog`.
        impulses: (W, N, T) N s, as in `ContactLog`.
        names: `first_body`, `first_piece`, `ground` and `other` of the `Scenery`.
        velocity: (W, N, 3) at the end of the decision, m/s.
        rates: (W, N, 3) rad/s.
        slowest: Maximum speed of a drone at rest, m/s.
        slowest_spin: Maximum angular velocity of a drone at rest, rad/s.
        collision: (W, N) bool, written: whether the drone touched anything.
        resting: (W, N) bool, written: whether it did and is at rest.
        impulse: (W, N) written: largest impulse from a single body, N s.
    """
    for w in range(collision.shape[0]):
        for i in range(collision.shape[1]):
            num_contacts = number[w, i]
            collision[w, i] = num_contacts > 0
            resting[w, i] = False
            impulse[w, i] = 0.0
            if num_contacts == 0:
                continue
            fast, spin = vec3(velocity, w, i), vec3(rates, w, i)
            calm = math.sqrt(dot(fast, fast)) <= slowest
            calm = calm and math.sqrt(dot(spin, spin)) <= slowest_spin
            resting[w, i] = calm

            # Several shapes may belong to one city, or to one body
            for k in range(num_contacts):
                one, total = _get_owner(other[w, i, k], names), 0.0
                for m in range(num_contacts):
                    if _get_owner(other[w, i, m], names) == one:
                        total += impulses[w, i, m]
                impulse[w, i] = max(impulse[w, i], total)


def list_contacts(contact: ContactState) -> Contacts:
    """Return the contacts of a decision, sorted by world, drone and other."""
    touches = contact.touches
    if not touches.number.any():
        return Contacts.none()
    scenery = contact.scenery
    used = np.arange(touches.other.shape[-1]) < touches.number[..., None]
    world, drone, _ = np.nonzero(used)
    number = touches.other[used]
    # Convert shape indices to the numbers of their owners in `Contacts`
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
        depth=touches.depth[used],
    )


@allocating
def _record_overlaps(contact: ContactState, drones: DroneArrays, moved: np.ndarray) -> None:
    """Record the contacts of drones that were moved; see `find_overlaps`."""
    contact, alive = in_memory(contact), drones.alive
    swarm = in_memory(drones.swarm)
    space = contact.space
    for w in range(alive.shape[0]):
        world = in_memory(
            ContactWorld(
                w,
                1.0,
                0.0,
                0.0,
                0.0,
                contact.stops,
                contact.scenery,
                swarm,
                alive,
                contact.asleep,
                drones.parameters,
                contact.memory,
            )
        )
        for i in range(alive.shape[1]):
            space.motions[i].is_due = moved[w, i] and alive[w, i]
            space.motions[i].range = 0.0
            space.motions[i].is_started = False
        sort_drones(space.order, swarm.position, w)
        pairs, num_pairs = find_pairs(space, world, swarm, space.order)
        for p in range(num_pairs):
            record_overlap(space, world, pairs[p], contact.touches)


def find_overlaps(contact: ContactState, drones: DroneArrays, moved: np.ndarray) -> Contacts:
    """Find the contacts of drones that were moved to another place.

    Args:
        contact: State of all contacts; its list of contacts is cleared.
        drones: All drones; not changed.
        moved: (W, N) bool, drones that were moved.

    Returns:
        The contacts of `moved` drones with other drones and static shapes, without impulse.
    """
    contact.touches.number[:] = 0
    _record_overlaps(contact, drones, moved)
    contact.budget[moved] = -1.0
    return list_contacts(contact)
