"""What follows from a decision for every drone: separations, distances, and what it touched."""

import dataclasses
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.conflict.separation import Conflict, fill_conflict, no_conflict
from bulletuav.contact.contacts import mark
from bulletuav.contact.rest import Contact
from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.tasks.frame import (
    RESTING_SPEED,
    RESTING_SPIN,
    STANDING_GAP,
    TOUCHDOWN_SPEED,
    TOUCHDOWN_UPRIGHT,
    Frame,
)
from bulletuav.vehicle.swarm import GROUND


class Account(NamedTuple):
    """Arrays (W, N) of a frame's properties of the same names, which a program fills.

    Attributes:
        conflict: Separations.
        distance: To the goal, m.
        distance_before: Before the decision, m.
        known_distance: As drones know it, m.
        collision: Whether the drone touched anything.
        resting: Whether it did, and hardly moves.
        impulse: Greatest impulse of a contact, N s.
        landed: Whether it stands or lands on the ground, in tasks that allow it.
    """

    conflict: Conflict
    distance: np.ndarray
    distance_before: np.ndarray
    known_distance: np.ndarray
    collision: np.ndarray
    resting: np.ndarray
    impulse: np.ndarray
    landed: np.ndarray


def make_account(frame: Frame) -> Account:
    """Make arrays that the frame shows from now on as its properties of the same names."""
    shape = frame.alive.shape
    distance, distance_before, known_distance, impulse = np.zeros((4, *shape))
    collision, resting, landed = np.zeros((3, *shape), dtype=bool)
    # The frame shows these arrays, so they are filled and never replaced
    account = Account(
        conflict=no_conflict(shape),
        distance=distance,
        distance_before=distance_before,
        known_distance=known_distance,
        collision=collision,
        resting=resting,
        impulse=impulse,
        landed=landed,
    )
    vars(frame).update(account._asdict())
    return account


def add_account(program: Program, account: Account, frame: Frame, contact: Contact) -> None:
    """Add to a program that the account is filled after a decision.

    Args:
        program: To be added to.
        account: Of the frame.
        frame: The decision, with all arrays in place.
        contact: What drones touched.
    """
    before, after, goal = frame.before.position, frame.after.position, frame.scene.goal
    limits = (frame.d_safe, frame.zone)
    program.call(fill_conflict, before, after, frame.alive, *limits, *account.conflict)
    places = (before, after, frame.known_position)
    distances = (account.distance_before, account.distance, account.known_distance)
    program.call(_fill_all, goal, places, distances)
    scenery, touches = contact.scenery, contact.touches
    names = (scenery.first_body, scenery.first_piece, scenery.ground, scenery.other)
    given = (touches.number, touches.other, touches.impulse, names, *frame.after[2:4])
    marks = (account.collision, account.resting, account.impulse)
    program.call(mark, *given, RESTING_SPEED, RESTING_SPIN, *marks)


@kernel
def _fill_all(
    goal: np.ndarray,
    places: tuple[np.ndarray, np.ndarray, np.ndarray],
    distances: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Write how far goals (W, N, 3) are from each of three places, (W, N)."""
    fill_paired_distances(goal, places[0], distances[0])
    fill_paired_distances(goal, places[1], distances[1])
    fill_paired_distances(goal, places[2], distances[2])


def mark_contacts(account: Account, frame: Frame) -> None:
    """Fill what the account tells of contacts from those that the frame tells."""
    fresh = dataclasses.replace(frame)  # works everything out by itself
    account.collision[:] = fresh.collision
    account.resting[:] = fresh.resting
    account.impulse[:] = fresh.impulse


def mark_landings(account: Account, frame: Frame, standing_height: np.ndarray) -> None:
    """Tell who stands or lands on the ground, see `Frame.landed`; landings are no collisions.

    Args:
        account: Of the frame, changed.
        frame: The decision.
        standing_height: (N,) of the centre of mass of a drone that stands, m.
    """
    touched, landed = frame.contacts, account.landed
    # Who touches anything, or stands so near that nothing is felt.
    low = frame.after.position[..., 2] <= standing_height + STANDING_GAP
    landed[:] = (account.collision | low) & frame.alive
    for swarm in (frame.before, frame.after):
        x, y = swarm.quaternion[..., 0], swarm.quaternion[..., 1]
        landed &= 1 - 2 * (x * x + y * y) >= TOUCHDOWN_UPRIGHT
    # What it touches, and how fast.
    rough = np.linalg.norm(touched.velocity, axis=-1) > TOUCHDOWN_SPEED
    rough |= touched.other != GROUND
    landed[touched.world[rough], touched.drone[rough]] = False
    account.collision[landed] = False
