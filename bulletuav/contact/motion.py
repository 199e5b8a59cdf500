"""Where the drones of one world are within a substep, and how their way changes at an impact.

Times are shares of the substep, from 0 to 1. Between impacts a drone moves straight and turns about
one axis; its forces act evenly. Angular momentum, not angular velocity, is what stays without
torque.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    Vec3Like,
    exponential,
    normalised,
    point,
    product,
    quat4,
    to_body,
    to_world,
    vec3,
)
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Swarm


class Motions(NamedTuple):
    """Motion of the N drones of one world from a time within the substep to its end.

    Attributes:
        time: (N,) share of the substep from which on the rest holds; below 0 before `begin`.
        position: (N, 3) centres of mass at that time, m.
        quaternion: (N, 4) attitudes at that time.
        velocity: (N, 3) at that time, m/s.
        spin: (N, 3) angular velocities at that time, world axes, rad/s.
        move: (N, 3) displacement from that time to the end of the substep, m.
        turn: (N, 3) rotation from that time to the end, as axis times angle, world axes, rad.
        push: (N, 3) change of velocity by forces over the whole substep, m/s.
        twist: (N, 3) change of angular momentum by torques over the substep, world axes, N m s.
        impacts: (N,) how often the drone took part in an impact in this substep.
    """

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    move: np.ndarray
    turn: np.ndarray
    push: np.ndarray
    twist: np.ndarray
    impacts: np.ndarray


def make_motions(num_drones: int) -> Motions:
    """Make room for the motion of N drones."""
    vectors = [np.zeros((num_drones, size)) for size in (3, 4, 3, 3, 3, 3, 3, 3)]
    return Motions(np.zeros(num_drones), *vectors, np.zeros(num_drones, dtype=np.int64))


@func
def _set(array: np.ndarray, i: int, values: Vec3) -> None:
    """Write array[i] (3,)."""
    array[i, 0] = values[0]
    array[i, 1] = values[1]
    array[i, 2] = values[2]


@func
def _set_quaternion(array: np.ndarray, i: int, values: Quat4) -> None:
    """Write array[i] (4,)."""
    array[i, 0] = values[0]
    array[i, 1] = values[1]
    array[i, 2] = values[2]
    array[i, 3] = values[3]


@func
def quaternion_of(motions: Motions, i: int) -> Quat4:
    """Return the attitude of drone i at its time."""
    q = motions.quaternion
    return q[i, 0], q[i, 1], q[i, 2], q[i, 3]


@func
def along(start: Vec3Like, share: float, change: Vec3Like) -> Vec3:
    """Return start + share * change."""
    return (
        start[0] + share * change[0],
        start[1] + share * change[1],
        start[2] + share * change[2],
    )


@func
def _rotation_between(before: Quat4, after: Quat4) -> Vec3:
    """Return the rotation from one attitude to another as axis times angle, the shorter way."""
    x, y, z, w = product(after, (-before[0], -before[1], -before[2], before[3]))
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0.0, 0.0, 0.0
    scale = 2.0 * math.atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z


@func
def turned(rotation: Vec3, share: float, quaternion: Quat4) -> Quat4:
    """Return an attitude after a share of a rotation (axis times angle, world axes)."""
    part = (
        share * rotation[0],
        share * rotation[1],
        share * rotation[2],
    )
    return normalised(product(exponential(part), quaternion))


@func
def momentum(quaternion: Quat4, spin: Vec3, row: np.record) -> Vec3:
    """Return the angular momentum (N m s) of an angular velocity (rad/s), both in world axes."""
    p, q, r = to_body(quaternion, spin)
    inertia = row.inertia
    return to_world(quaternion, (inertia[0] * p, inertia[1] * q, inertia[2] * r))


@func
def spin_of(quaternion: Quat4, angular: Vec3, row: np.record) -> Vec3:
    """Return the angular velocity (rad/s) of an angular momentum (N m s), both in world axes."""
    p, q, r = to_body(quaternion, angular)
    inertia = row.inertia
    return to_world(quaternion, (p / inertia[0], q / inertia[1], r / inertia[2]))


@kernel
def begin(
    motions: Motions,
    before: Swarm,
    after: Swarm,
    w: int,
    i: int,
    row: np.record,
) -> None:
    """Start drone i of world w on its way through a substep in which it touches nothing.

    Args:
        motions: Row i is written.
        before: State at the beginning of the substep.
        after: State at its end.
        w: The world.
        i: The drone.
        row: Row of `PARAMETERS` of the drone.
    """
    position = vec3(before.position, w, i)
    quaternion = quat4(before.quaternion, w, i)
    later = quat4(after.quaternion, w, i)
    velocity = vec3(before.velocity, w, i)
    spin = to_world(quaternion, vec3(before.rates, w, i))
    spin_after = to_world(later, vec3(after.rates, w, i))
    angular = momentum(quaternion, spin, row)
    angular_after = momentum(later, spin_after, row)
    motions.time[i] = 0.0
    motions.impacts[i] = 0
    _set(motions.position, i, position)
    _set_quaternion(motions.quaternion, i, quaternion)
    _set(motions.velocity, i, velocity)
    _set(motions.spin, i, spin)
    _set(motions.move, i, along(vec3(after.position, w, i), -1.0, position))
    _set(motions.turn, i, _rotation_between(quaternion, later))
    _set(motions.push, i, along(vec3(after.velocity, w, i), -1.0, velocity))
    _set(motions.twist, i, along(angular_after, -1.0, angular))


@func
def _share(motions: Motions, i: int, time: float) -> float:
    """Return the share of the rest of its way that drone i has gone at a time."""
    rest = 1.0 - motions.time[i]
    return (time - motions.time[i]) / rest if rest > 0.0 else 0.0


@kernel
def advance_to(motions: Motions, i: int, time: float, row: np.record) -> None:
    """Move drone i on to a time within the substep."""
    share = _share(motions, i, time)
    elapsed = time - motions.time[i]
    here = quaternion_of(motions, i)
    there = turned(point(motions.turn, i), share, here)
    angular = momentum(here, point(motions.spin, i), row)
    angular = along(angular, elapsed, point(motions.twist, i))
    _set(motions.position, i, along(point(motions.position, i), share, point(motions.move, i)))
    _set_quaternion(motions.quaternion, i, there)
    _set(motions.velocity, i, along(point(motions.velocity, i), elapsed, point(motions.push, i)))
    _set(motions.spin, i, spin_of(there, angular, row))
    for k in range(3):
        motions.move[i, k] *= 1.0 - share
        motions.turn[i, k] *= 1.0 - share
    motions.time[i] = time


@kernel
def aim(motions: Motions, i: int, dt: float, row: np.record) -> None:
    """Let drone i fly on from its time with the velocities that `motions` has of it.

    The rotation takes the angular velocity halfway (midpoint rule), with the angular momentum held.
    """
    rest = 1.0 - motions.time[i]
    velocity = point(motions.velocity, i)
    here = quaternion_of(motions, i)
    angular = momentum(here, point(motions.spin, i), row)
    halfway = turned(point(motions.spin, i), 0.5 * rest * dt, here)
    spin = spin_of(halfway, angular, row)
    for k in range(3):
        motions.move[i, k] = rest * dt * velocity[k]
        motions.turn[i, k] = rest * dt * spin[k]


@kernel
def stay(motions: Motions, i: int) -> None:
    """Keep drone i where it is until the end of the substep; its velocities stay."""
    for k in range(3):
        motions.move[i, k] = 0.0
        motions.turn[i, k] = 0.0


@kernel
def finish(motions: Motions, after: Swarm, w: int, i: int, row: np.record) -> None:
    """Write the state of drone i at the end of the substep."""
    advance_to(motions, i, 1.0, row)
    quaternion = quaternion_of(motions, i)
    rates = to_body(quaternion, point(motions.spin, i))
    for k in range(3):
        after.position[w, i, k] = motions.position[i, k]
        after.velocity[w, i, k] = motions.velocity[i, k]
        after.rates[w, i, k] = rates[k]
    for k in range(4):
        after.quaternion[w, i, k] = quaternion[k]


@func
def pose_at(
    scenery: Scenery, motions: Motions, w: int, who: int, time: float, dt: float
) -> tuple[Vec3, Quat4]:
    """Return position and attitude of someone (number of a shape) at a time in the substep."""
    level = (0.0, 0.0, 0.0, 1.0)
    if who < scenery.first_body:
        share = _share(motions, who, time)
        position = along(point(motions.position, who), share, point(motions.move, who))
        return position, turned(point(motions.turn, who), share, quaternion_of(motions, who))
    if who < scenery.first_piece:
        k = who - scenery.first_body
        turn = quat4(scenery.quaternion, w, k)
        velocity = vec3(scenery.velocity, w, k)
        return along(vec3(scenery.place, w, k), time * dt, velocity), turn
    if who < scenery.ground:
        return point(scenery.piece_place, who - scenery.first_piece), level
    return (0.0, 0.0, 0.0), level


@func
def change_rates(
    scenery: Scenery, motions: Motions, w: int, who: int, dt: float
) -> tuple[Vec3, Vec3]:
    """Return displacement and rotation of someone in the rest of the substep, per whole substep."""
    still = (0.0, 0.0, 0.0)
    if who < scenery.first_body:
        rest = 1.0 - motions.time[who]
        scale = 1.0 / rest if rest > 0.0 else 0.0
        move = point(motions.move, who)
        turn = point(motions.turn, who)
        return along(still, scale, move), along(still, scale, turn)
    if who < scenery.first_piece:
        velocity = vec3(scenery.velocity, w, who - scenery.first_body)
        return along(still, dt, velocity), still
    return still, still
