"""What drones touched during a decision, as compiled code notes it."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3

MAX_LOGGED_CONTACTS = 16
"""Others that are told of a drone in a decision; more add to the last"""


class ContactLog(NamedTuple):
    """What drones touched during a decision: up to `MAX_LOGGED_CONTACTS` others (T) each.

    Attributes:
        number: (W, N) how many.
        other: (W, N, T) number of the other shape, see `Scenery`.
        impulse: (W, N, T) along the normals, N s, summed up.
        place: (W, N, T, 3) where they touched first, m.
        normal: (W, N, T, 3) direction in which the drone was pushed there.
        velocity: (W, N, T, 3) of the drone's surface against the other's just before, m/s.
        depth: (W, N, T) how deep shapes overlapped there, m.
    """

    number: np.ndarray
    other: np.ndarray
    impulse: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    velocity: np.ndarray
    depth: np.ndarray


def make_contact_log(num_worlds: int, num_drones: int) -> ContactLog:
    """Make room for what drones touch."""
    shape = (num_worlds, num_drones)
    return ContactLog(
        number=np.zeros(shape, dtype=np.int64),
        other=np.zeros((*shape, MAX_LOGGED_CONTACTS), dtype=np.int64),
        impulse=np.zeros((*shape, MAX_LOGGED_CONTACTS)),
        place=np.zeros((*shape, MAX_LOGGED_CONTACTS, 3)),
        normal=np.zeros((*shape, MAX_LOGGED_CONTACTS, 3)),
        velocity=np.zeros((*shape, MAX_LOGGED_CONTACTS, 3)),
        depth=np.zeros((*shape, MAX_LOGGED_CONTACTS)),
    )


@func
def _find_slot(touches: ContactLog, w: int, i: int, other: int) -> int:
    """Return where to tell a touch, a new place if it is the first."""
    count = int(touches.number[w, i])
    for k in range(count):
        if touches.other[w, i, k] == other:
            return k
    if count == MAX_LOGGED_CONTACTS:
        return MAX_LOGGED_CONTACTS - 1
    touches.number[w, i] = count + 1
    touches.other[w, i, count] = other
    touches.impulse[w, i, count] = 0.0
    return count


@kernel
def record_contact(
    touches: ContactLog,
    w: int,
    i: int,
    other: int,
    impulse: float,
    place: Vec3,
    normal: Vec3,
    velocity: Vec3,
    depth: float,
    sign: float,
) -> None:
    """Add a point of contact to what drone i of world w touched.

    Args:
        touches: Changed; all but the impulse are kept of the first point alone.
        w: The world.
        i: The drone.
        other: Number of the other shape.
        impulse: Along the normal, N s.
        place: Of the point, m.
        normal: Direction in which the impulse acts on the drone, if `sign` is 1.
        velocity: Of the drone's surface against the other's before, m/s, if `sign` is 1.
        depth: How deep shapes overlap there, m.
        sign: -1 to turn normal and velocity round.
    """
    before = touches.number[w, i]
    k = _find_slot(touches, w, i, other)
    touches.impulse[w, i, k] += impulse
    if touches.number[w, i] > before:
        touches.depth[w, i, k] = depth
        for m in range(3):
            touches.place[w, i, k, m] = place[m]
            touches.normal[w, i, k, m] = sign * normal[m]
            touches.velocity[w, i, k, m] = sign * velocity[m]
