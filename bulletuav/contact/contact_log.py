"""Contact log: the contacts of each drone in a decision, as compiled code records them."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3

MAX_LOGGED_CONTACTS = 16
"""Maximum number of other shapes in the log of a drone in a decision; more add to the last"""


class ContactLog(NamedTuple):
    """Contacts of a decision: up to `MAX_LOGGED_CONTACTS` other shapes (T) for each drone.

    Attributes:
        number: (W, N) number of other shapes.
        other: (W, N, T) index of the other shape, see `Scenery`.
        impulse: (W, N, T) sum of the impulses along the normals, N s.
        place: (W, N, T, 3) position of the first contact, m.
        normal: (W, N, T, 3) direction in which the drone was pushed there.
        velocity: (W, N, T, 3) velocity of the drone's surface relative to the other just before,
            m/s.
        depth: (W, N, T) penetration depth there, m.
    """

    number: np.ndarray
    other: np.ndarray
    impulse: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    velocity: np.ndarray
    depth: np.ndarray


def make_contact_log(num_worlds: int, num_drones: int) -> ContactLog:
    """Create an empty contact log."""
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
    """Return the slot of a drone's contacts with another shape, a new one for the first contact."""
    num_contacts = int(touches.number[w, i])
    for k in range(num_contacts):
        if touches.other[w, i, k] == other:
            return k
    if num_contacts == MAX_LOGGED_CONTACTS:
        return MAX_LOGGED_CONTACTS - 1
    touches.number[w, i] = num_contacts + 1
    touches.other[w, i, num_contacts] = other
    touches.impulse[w, i, num_contacts] = 0.0
    return num_contacts


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
    """Add a contact point to the log of drone i of world w.

    Args:
        touches: Contact log, changed; all but the impulse is kept from the first point alone.
        w: Index of the world.
        i: Index of the drone.
        other: Index of the other shape.
        impulse: Impulse along the normal, N s.
        place: Position of the point, m.
        normal: Direction in which the impulse acts on the drone, if `sign` is 1.
        velocity: Velocity of the drone's surface relative to the other before, m/s, if `sign` is 1.
        depth: Penetration depth at the point, m.
        sign: -1 to reverse normal and velocity.
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
