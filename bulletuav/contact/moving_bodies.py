"""Motion of the bodies that users add: constant velocity and angular velocity in a decision.

A body moves straight and rotates about one axis through its origin. Each of its pieces moves
straight within a substep, from one point of its circle to the next.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.spin import rotate_by_fraction
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    dot,
    minus,
    normalise_quaternion,
    plus,
    point,
    product,
    quat4,
    to_world,
    vec3,
)
from bulletuav.geometry.scenery import Bodies, Scenery

STILL = (0.0, 0.0, 0.0)


@kernel
def start_bodies(bodies: Bodies, flying: np.ndarray, period: float) -> None:
    """Set the motion of all bodies in a decision of length `period`, s, from their velocities.

    Bodies in worlds that are not in the mask `flying` (W,) stay in place.
    """
    for w in range(flying.shape[0]):
        duration = period if flying[w] else 0.0
        for b in range(bodies.reach.shape[0]):
            for k in range(3):
                bodies.displacement[w, b, k] = duration * bodies.velocity[w, b, k]
                bodies.rotation[w, b, k] = duration * bodies.spin[w, b, k]


@func
def moves(bodies: Bodies, w: int, b: int) -> bool:
    """Check whether body b of world w moves in this decision."""
    moved: bool = vec3(bodies.displacement, w, b) != STILL or vec3(bodies.rotation, w, b) != STILL
    return moved


@func
def bound_body_motion(bodies: Bodies, w: int) -> float:
    """Return the longest path of any point of a body of world w in this decision, m."""
    longest = 0.0
    for b in range(bodies.reach.shape[0]):
        move, turn = vec3(bodies.displacement, w, b), vec3(bodies.rotation, w, b)
        path = math.sqrt(dot(move, move)) + math.sqrt(dot(turn, turn)) * bodies.reach[b]
        longest = max(longest, path)
    return longest


@func
def _piece_pose(bodies: Bodies, w: int, p: int, fraction: float) -> tuple[Vec3, Quat4]:
    """Return the pose of piece p of the bodies of world w after a fraction of the decision."""
    b = bodies.owner[p]
    turn = rotate_by_fraction(vec3(bodies.rotation, w, b), fraction, quat4(bodies.quaternion, w, b))
    turn = normalise_quaternion(turn)
    place = plus(vec3(bodies.position, w, b), fraction, vec3(bodies.displacement, w, b))
    place = plus(place, 1.0, to_world(turn, point(bodies.offset, p)))
    a = bodies.attitude
    return place, product(turn, (a[p, 0], a[p, 1], a[p, 2], a[p, 3]))


@kernel
def _place_piece(scenery: Scenery, w: int, p: int, begin: float, end: float, dt: float) -> None:
    """Set piece p to its pose at `begin`, and its velocities up to `end`, `dt` later."""
    bodies = scenery.bodies
    r = scenery.place.shape[1] - bodies.owner.shape[0] + p
    place, quaternion = _piece_pose(bodies, w, p, begin)
    there, _ = _piece_pose(bodies, w, p, end)
    moved = minus(there, place)
    turned = vec3(bodies.rotation, w, bodies.owner[p])
    for k in range(3):
        scenery.place[w, r, k] = place[k]
        scenery.velocity[w, r, k] = moved[k] / dt if dt > 0.0 else 0.0
        scenery.spin[w, r, k] = (end - begin) * turned[k] / dt if dt > 0.0 else 0.0
    for k in range(4):
        scenery.quaternion[w, r, k] = quaternion[k]


@func
def place_world_bodies(scenery: Scenery, w: int, begin: float, end: float, dt: float) -> None:
    """Set the moving bodies of a world to their poses and velocities in a substep.

    Args:
        scenery: All shapes; written.
        w: Index of the world.
        begin: Fraction of the decision at the beginning of the substep.
        end: Fraction of the decision at the end of the substep.
        dt: Length of the substep, s.
    """
    for p in range(scenery.bodies.owner.shape[0]):
        if moves(scenery.bodies, w, scenery.bodies.owner[p]):
            _place_piece(scenery, w, p, begin, end, dt)


@kernel
def finish_bodies(scenery: Scenery) -> None:
    """Set all moving bodies to their poses at the end of the decision, and end their motion."""
    bodies = scenery.bodies
    for w in range(scenery.place.shape[0]):
        place_world_bodies(scenery, w, 1.0, 1.0, 0.0)
        for b in range(bodies.reach.shape[0]):
            if not moves(bodies, w, b):
                continue
            turn = rotate_by_fraction(
                vec3(bodies.rotation, w, b), 1.0, quat4(bodies.quaternion, w, b)
            )
            turn = normalise_quaternion(turn)
            for k in range(3):
                bodies.position[w, b, k] += bodies.displacement[w, b, k]
                bodies.displacement[w, b, k] = bodies.rotation[w, b, k] = 0.0
            for k in range(4):
                bodies.quaternion[w, b, k] = turn[k]
