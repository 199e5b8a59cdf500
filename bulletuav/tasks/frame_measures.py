"""Per-drone measures of a decision: separations, distances to goals, and contacts."""

import dataclasses
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.conflict.separation import Conflict, add_conflict, no_conflict
from bulletuav.contact.contact_state import ContactState
from bulletuav.contact.contacts import summarize_contacts
from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.tasks.frame import (
    MAX_RESTING_SPEED,
    MAX_RESTING_SPIN,
    MAX_TOUCHDOWN_SPEED,
    MIN_TOUCHDOWN_COSINE,
    STANDING_TOLERANCE,
    Frame,
)
from bulletuav.vehicle.swarm import GROUND


class FrameMeasures(NamedTuple):
    """Arrays (W, N) behind a frame's properties of the same names, filled by a program.

    Attributes:
        conflict: Separations and conflicts.
        distance: Distance to the goal, m.
        distance_before: Distance to the goal before the decision, m.
        known_distance: Distance to the goal as measured by the drone, m.
        collision: Whether the drone touched anything.
        resting: Whether the drone touched something and is at rest.
        impulse: Maximum impulse of a contact, N s.
        landed: Whether the drone stands or lands on the ground, in tasks that allow it.
    """

    conflict: Conflict
    distance: np.ndarray
    distance_before: np.ndarray
    known_distance: np.ndarray
    collision: np.ndarray
    resting: np.ndarray
    impulse: np.ndarray
    landed: np.ndarray


def make_frame_measures(frame: Frame) -> FrameMeasures:
    """Allocate the measures of a frame and install them as its properties of the same names."""
    shape = frame.alive.shape
    distance, distance_before, known_distance, impulse = np.zeros((4, *shape))
    collision, resting, landed = np.zeros((3, *shape), dtype=bool)
    # The frame refers to these arrays, so they must be filled, never replaced
    measures = FrameMeasures(
        conflict=no_conflict(shape),
        distance=distance,
        distance_before=distance_before,
        known_distance=known_distance,
        collision=collision,
        resting=resting,
        impulse=impulse,
        landed=landed,
    )
    vars(frame).update(measures._asdict())
    return measures


def add_frame_measures(
    program: Program, measures: FrameMeasures, frame: Frame, contact: ContactState
) -> None:
    """Add steps to a program that fill the measures after a decision.

    Args:
        program: Program to extend.
        measures: Measures of the frame.
        frame: The decision, with all arrays in place.
        contact: Contacts of the drones.
    """
    before, after, goal = frame.before.position, frame.after.position, frame.scene.goal
    limits = (frame.d_safe, frame.zone)
    add_conflict(program, before, after, frame.alive, *limits, measures.conflict)
    places = (before, after, frame.known_position)
    distances = (measures.distance_before, measures.distance, measures.known_distance)
    program.call(_fill_all, goal, places, distances)
    scenery, touches = contact.scenery, contact.touches
    names = (scenery.first_body, scenery.first_piece, scenery.ground, scenery.other)
    given = (touches.number, touches.other, touches.impulse, names, *frame.after[2:4])
    marks = (measures.collision, measures.resting, measures.impulse)
    program.call(summarize_contacts, *given, MAX_RESTING_SPEED, MAX_RESTING_SPIN, *marks)


@kernel
def _fill_all(
    goal: np.ndarray,
    places: tuple[np.ndarray, np.ndarray, np.ndarray],
    distances: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Write the distances of goals (W, N, 3) from each of three position arrays, (W, N)."""
    fill_paired_distances(goal, places[0], distances[0])
    fill_paired_distances(goal, places[1], distances[1])
    fill_paired_distances(goal, places[2], distances[2])


def mark_contacts(measures: FrameMeasures, frame: Frame) -> None:
    """Fill the contact measures from the contacts of the frame."""
    fresh = dataclasses.replace(frame)  # a copy without cached properties
    measures.collision[:] = fresh.collision
    measures.resting[:] = fresh.resting
    measures.impulse[:] = fresh.impulse


def mark_landings(
    measures: FrameMeasures,
    frame: Frame,
    standing_height: np.ndarray,
    places: tuple[int, ...] = (GROUND,),
) -> None:
    """Mark drones that stand or land on the ground, see `Frame.landed`; landings are no collisions.

    Args:
        measures: Measures of the frame, modified.
        frame: The decision.
        standing_height: (N,) height of the centre of mass of a standing drone, m.
        places: What drones may land on, as in `Contacts.other`.
    """
    touched, landed = frame.contacts, measures.landed
    landed[:] = measures.collision & frame.alive
    if GROUND in places:
        # Drones as low as a standing drone may stand without contact force
        low = frame.after.position[..., 2] <= standing_height + STANDING_TOLERANCE
        landed |= low & frame.alive
    for swarm in (frame.before, frame.after):
        x, y = swarm.quaternion[..., 0], swarm.quaternion[..., 1]
        landed &= 1 - 2 * (x * x + y * y) >= MIN_TOUCHDOWN_COSINE
    # Other contacts and fast impacts are no landings
    rough = np.linalg.norm(touched.velocity, axis=-1) > MAX_TOUCHDOWN_SPEED
    rough |= ~np.isin(touched.other, places)
    # The sides of what drones may land on
    rough |= touched.normal[:, 2] < MIN_TOUCHDOWN_COSINE
    landed[touched.world[rough], touched.drone[rough]] = False
    measures.collision[landed] = False
