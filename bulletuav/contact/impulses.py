"""Impulses at the points where shapes touch: sequential impulses on all of an island together.

Each point is asked for the impulse that keeps its surfaces from closing faster than they may, and
for friction within Coulomb's disc; the points are swept until nothing changes (E. Catto, Iterative
dynamics with temporal coherence, 2005). Impulses act on both bodies at one point, so that momentum
and angular momentum stay.
"""

import math

import numpy as np

from bulletuav.contact.motion import Motions, quaternion_of
from bulletuav.geometry.rotation import Vec3, Vec3Like, axes, cross, dot, point
from bulletuav.kernel import func, kernel

POINT = np.dtype(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("normal", "f8", 3),
        ("tangent", "f8", (2, 3)),
        ("arm_a", "f8", 3),
        ("arm_b", "f8", 3),
        ("drift", "f8", 3),
        ("friction", "f8"),
        ("restitution", "f8"),
        ("distance", "f8"),
        ("approach", "f8"),
        ("mass", "f8"),
        ("grip", "f8", 3),
        ("least", "f8"),
        ("impulse", "f8", 3),
        ("total", "f8", 3),
    ]
)
"""A point of contact.

Attributes:
    a: Index of the drone that `normal` pushes.
    b: Index of the other drone, or -1 for what does not yield.
    normal: Unit vector from b to a.
    tangent: Two unit vectors across it.
    arm_a: From the centre of mass of a to the point, m.
    arm_b: From that of b, m.
    drift: Velocity of what does not yield, m/s.
    friction: Coefficient of friction.
    restitution: Coefficient of restitution.
    distance: Signed distance of the surfaces along the normal, m.
    approach: Velocity along the normal before the impact, m/s.
    mass: That the point feels along the normal, kg.
    grip: Inverse of the symmetric 2 x 2 matrix of velocities by impulses across: 11, 12, 22, kg.
    least: Velocity along the normal that must be reached, m/s.
    impulse: Along the normal and the tangents, in this pass, N s.
    total: The same in all passes, N s.
"""

FIRM = 1e-9
"""Change of velocity below which a sweep changes nothing, as share of the greatest velocity"""
SWEEPS = 100
"""Most sweeps over the points of a small island"""
WORK = 20_000
"""Most visits of points of an island, unless that is less than `FEWEST` sweeps"""
FEWEST = 20
"""Sweeps that even a large island gets"""


@func
def _tangents(normal: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors across a unit vector and each other."""
    x, y, z = normal
    if abs(x) > abs(z):
        scale = 1.0 / math.sqrt(x * x + y * y)
        one = (-y * scale, x * scale, 0.0)
    else:
        scale = 1.0 / math.sqrt(y * y + z * z)
        one = (0.0, -z * scale, y * scale)
    return one, cross(normal, one)


@func
def vector(array: np.ndarray) -> Vec3:
    """Return an array of three numbers as a tuple."""
    return array[0], array[1], array[2]


@func
def _matrix(matrix: np.ndarray, i: int, v: Vec3Like) -> Vec3:
    """Return matrix[i] (3, 3) times v."""
    return (
        matrix[i, 0, 0] * v[0] + matrix[i, 0, 1] * v[1] + matrix[i, 0, 2] * v[2],
        matrix[i, 1, 0] * v[0] + matrix[i, 1, 1] * v[1] + matrix[i, 1, 2] * v[2],
        matrix[i, 2, 0] * v[0] + matrix[i, 2, 1] * v[1] + matrix[i, 2, 2] * v[2],
    )


@kernel
def ease_of(motions: Motions, i: int, row: np.record, ease: np.ndarray) -> None:
    """Write the inverse inertia of drone i in world axes to ease[i] (3, 3), 1 / (kg m^2)."""
    bx, by, bz = axes(quaternion_of(motions, i))
    inertia = row.inertia
    for k in range(3):
        for m in range(3):
            total = bx[k] * bx[m] / inertia[0]
            total += by[k] * by[m] / inertia[1]
            total += bz[k] * bz[m] / inertia[2]
            ease[i, k, m] = total


@func
def _yield_of(
    ease: np.ndarray, lightness: np.ndarray, i: int, arm: Vec3, one: Vec3, two: Vec3
) -> float:
    """Return the velocity along `two` that a unit impulse along `one` at `arm` gives drone i."""
    spun = _matrix(ease, i, cross(arm, one))
    return lightness[i] * dot(one, two) + dot(spun, cross(arm, two))


@kernel
def prepare(row: np.record, ease: np.ndarray, lightness: np.ndarray) -> None:
    """Fill in what a point feels of the masses; a, b, normal and arms must be there."""
    normal = vector(row.normal)
    one, two = _tangents(normal)
    for k in range(3):
        row.tangent[0, k] = one[k]
        row.tangent[1, k] = two[k]
        row.total[k] = 0.0
        row.impulse[k] = 0.0
    arm = vector(row.arm_a)
    yields = _yield_of(ease, lightness, row.a, arm, normal, normal)
    k11 = _yield_of(ease, lightness, row.a, arm, one, one)
    k12 = _yield_of(ease, lightness, row.a, arm, one, two)
    k22 = _yield_of(ease, lightness, row.a, arm, two, two)
    if row.b >= 0:
        arm = vector(row.arm_b)
        yields += _yield_of(ease, lightness, row.b, arm, normal, normal)
        k11 += _yield_of(ease, lightness, row.b, arm, one, one)
        k12 += _yield_of(ease, lightness, row.b, arm, one, two)
        k22 += _yield_of(ease, lightness, row.b, arm, two, two)
    row.mass = 1.0 / yields
    scale = 1.0 / (k11 * k22 - k12 * k12)
    row.grip[0] = k22 * scale
    row.grip[1] = -k12 * scale
    row.grip[2] = k11 * scale


@func
def slip(row: np.record, velocity: np.ndarray, spin: np.ndarray) -> Vec3:
    """Return the velocity of a's surface against that of b at a point, m/s."""
    arm = vector(row.arm_a)
    turning = cross(point(spin, row.a), arm)
    x = velocity[row.a, 0] + turning[0]
    y = velocity[row.a, 1] + turning[1]
    z = velocity[row.a, 2] + turning[2]
    if row.b >= 0:
        arm = vector(row.arm_b)
        turning = cross(point(spin, row.b), arm)
        x -= velocity[row.b, 0] + turning[0]
        y -= velocity[row.b, 1] + turning[1]
        z -= velocity[row.b, 2] + turning[2]
    else:
        x -= row.drift[0]
        y -= row.drift[1]
        z -= row.drift[2]
    return x, y, z


@func
def _push(
    i: int,
    arm: Vec3,
    impulse: Vec3,
    sign: float,
    velocity: np.ndarray,
    spin: np.ndarray,
    ease: np.ndarray,
    lightness: np.ndarray,
) -> None:
    """Give drone i an impulse (N s) at a point."""
    turning = _matrix(ease, i, cross(arm, impulse))
    for k in range(3):
        velocity[i, k] += sign * lightness[i] * impulse[k]
        spin[i, k] += sign * turning[k]


@func
def _apply(
    row: np.record,
    impulse: Vec3,
    velocity: np.ndarray,
    spin: np.ndarray,
    ease: np.ndarray,
    lightness: np.ndarray,
) -> None:
    """Give both bodies of a point an impulse, N s."""
    _push(row.a, vector(row.arm_a), impulse, 1.0, velocity, spin, ease, lightness)
    if row.b >= 0:
        _push(row.b, vector(row.arm_b), impulse, -1.0, velocity, spin, ease, lightness)


@func
def _rub(
    row: np.record,
    velocity: np.ndarray,
    spin: np.ndarray,
    ease: np.ndarray,
    lightness: np.ndarray,
) -> float:
    """Let friction act at a point; returns the change of velocity, m/s."""
    moving = slip(row, velocity, spin)
    one = vector(row.tangent[0])
    two = vector(row.tangent[1])
    along = dot(moving, one)
    across = dot(moving, two)
    # What would stop the slip, shortened as a vector to what the normal impulse allows
    first = row.impulse[1] - (row.grip[0] * along + row.grip[1] * across)
    second = row.impulse[2] - (row.grip[1] * along + row.grip[2] * across)
    most = row.friction * row.impulse[0]
    size = math.sqrt(first * first + second * second)
    if size > most:
        first *= most / size
        second *= most / size
    first_change = first - row.impulse[1]
    second_change = second - row.impulse[2]
    row.impulse[1] = first
    row.impulse[2] = second
    impulse = (
        first_change * one[0] + second_change * two[0],
        first_change * one[1] + second_change * two[1],
        first_change * one[2] + second_change * two[2],
    )
    _apply(row, impulse, velocity, spin, ease, lightness)
    return (abs(first_change) + abs(second_change)) / row.mass


@func
def _press(
    row: np.record,
    velocity: np.ndarray,
    spin: np.ndarray,
    ease: np.ndarray,
    lightness: np.ndarray,
) -> float:
    """Let a point push its surfaces apart; returns the change of velocity, m/s."""
    normal = vector(row.normal)
    missing = row.least - dot(slip(row, velocity, spin), normal)
    pressed = row.impulse[0] + row.mass * missing
    if pressed < 0.0:
        pressed = 0.0
    change = pressed - row.impulse[0]
    row.impulse[0] = pressed
    impulse = (
        change * normal[0],
        change * normal[1],
        change * normal[2],
    )
    _apply(row, impulse, velocity, spin, ease, lightness)
    return abs(change) / row.mass


@kernel
def relax(
    points: np.ndarray,
    count: int,
    velocity: np.ndarray,
    spin: np.ndarray,
    ease: np.ndarray,
    lightness: np.ndarray,
) -> int:
    """Sweep over points until none closes faster than it may.

    Args:
        points: Rows of `POINT`; impulses start from zero and are written.
        count: How many of them count.
        velocity: (N, 3) of the drones, m/s; changed.
        spin: (N, 3) angular velocities, world axes, rad/s; changed.
        ease: (N, 3, 3) inverse inertias in world axes, 1 / (kg m^2).
        lightness: (N,) inverse masses, 1 / kg.

    Returns:
        The number of sweeps.
    """
    fastest = 1e-3
    for k in range(count):
        row = points[k]
        row.impulse[0] = 0.0
        row.impulse[1] = 0.0
        row.impulse[2] = 0.0
        moving = slip(row, velocity, spin)
        fastest = max(fastest, math.sqrt(dot(moving, moving)))
    most = max(FEWEST, min(SWEEPS, WORK // max(1, count)))
    for sweep in range(most):
        change = 0.0
        for k in range(count):
            row = points[k]
            rubs = row.impulse[0] > 0.0 or row.impulse[1] != 0.0 or row.impulse[2] != 0.0
            if row.friction > 0.0 and rubs:
                change = max(change, _rub(row, velocity, spin, ease, lightness))
            change = max(change, _press(row, velocity, spin, ease, lightness))
        if change <= FIRM * fastest:
            return sweep + 1
    return most


@kernel
def keep(points: np.ndarray, count: int) -> None:
    """Add the impulses of a pass to the totals."""
    for k in range(count):
        for m in range(3):
            points[k].total[m] += points[k].impulse[m]


@kernel
def energy(
    drones: np.ndarray,
    count: int,
    velocity: np.ndarray,
    spin: np.ndarray,
    frame: Vec3,
    motions: Motions,
    parameters: np.ndarray,
    w: int,
) -> float:
    """Return the kinetic energy of drones as seen from a frame that moves, J."""
    total = 0.0
    for k in range(count):
        i = drones[k]
        row = parameters[w, i]
        bx, by, bz = axes(quaternion_of(motions, i))
        turning = point(spin, i)
        for m in range(3):
            total += 0.5 * row.mass * (velocity[i, m] - frame[m]) ** 2
        total += 0.5 * row.inertia[0] * dot(bx, turning) ** 2
        total += 0.5 * row.inertia[1] * dot(by, turning) ** 2
        total += 0.5 * row.inertia[2] * dot(bz, turning) ** 2
    return total
