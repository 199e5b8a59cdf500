"""Impulses at the points where shapes touch: sequential impulses on all of an island together.

Each point is asked for the impulse that keeps its surfaces from closing faster than they may, and
for friction within Coulomb's disc; the points are swept until nothing changes (E. Catto, Iterative
dynamics with temporal coherence, 2005). Impulses act on both bodies at one point, so that momentum
and angular momentum stay.
"""

import math

import numpy as np

from bulletuav.contact.motion import quaternion_of, vector
from bulletuav.geometry.rotation import Vec3, Vec3Like, axes, cross, dot, minus
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
        ("grip", "f8", 4),
        ("least", "f8"),
        ("axis", "f8", (3, 3)),
        ("stiff", "f8", 3),
        ("resist", "f8", 3),
        ("roll", "f8", 3),
        ("damping", "f8"),
        ("impulse", "f8", 3),
        ("total", "f8", 3),
        ("former", "f8", 3),
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
    grip: Inverse of the symmetric 2 x 2 matrix of velocities by impulses across: 11, 12, 22; and
        its least eigenvalue, kg.
    least: Velocity along the normal that must be reached, m/s.
    axis: Unit vectors about which they do not turn freely: z of a, z of b, and the normal.
    stiff: Moments of inertia about them, kg m^2.
    resist: Greatest angular impulses about them, over the normal impulse, m.
    roll: Angular impulses about the axes, in this pass, N m s.
    damping: Angular impulse that damps tipping, over the normal impulse and the spin, m s.
    impulse: Along the normal and the tangents, in this pass, N s.
    total: The same in all passes, N s.
    former: The same in all passes before those that may gain energy, N s.
"""

FIRM = 1e-9
"""Change of velocity below which a sweep changes nothing, as share of the greatest one or 1 m/s"""
SWEEPS = 200
"""Most sweeps over the points of a small island"""
WORK = 20_000
"""Most visits of points of an island, unless that is less than `FEWEST` sweeps"""
CALM = 0.02
"""Spin below which tipping is not damped, rad/s"""
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
def eased(motion: np.record, v: Vec3Like) -> Vec3:
    """Return the change of spin (rad/s) by an angular impulse (N m s), world axes."""
    ease = motion.ease
    return (
        ease[0, 0] * v[0] + ease[0, 1] * v[1] + ease[0, 2] * v[2],
        ease[1, 0] * v[0] + ease[1, 1] * v[1] + ease[1, 2] * v[2],
        ease[2, 0] * v[0] + ease[2, 1] * v[1] + ease[2, 2] * v[2],
    )


@func
def set_ease(motion: np.record, row: np.record) -> None:
    """Set how a drone yields to impulses in its present attitude."""
    motion.lightness = 1.0 / row.mass
    bx, by, bz = axes(quaternion_of(motion))
    inertia = row.inertia
    for k in range(3):
        for m in range(3):
            total = bx[k] * bx[m] / inertia[0]
            total += by[k] * by[m] / inertia[1]
            total += bz[k] * bz[m] / inertia[2]
            motion.ease[k, m] = total


@func
def _yield_of(motion: np.record, arm: Vec3, one: Vec3, two: Vec3) -> float:
    """Return the velocity along `two` that a unit impulse along `one` at `arm` gives a drone."""
    spun = eased(motion, cross(arm, one))
    yields: float = motion.lightness * dot(one, two) + dot(spun, cross(arm, two))
    return yields


@kernel
def prepare(row: np.record, motions: np.ndarray) -> None:
    """Fill in what a point feels of the masses; a, b, normal and arms must be there."""
    normal = vector(row.normal)
    one, two = _tangents(normal)
    for k in range(3):
        row.tangent[0, k] = one[k]
        row.tangent[1, k] = two[k]
        row.total[k] = 0.0
        row.former[k] = 0.0
        row.impulse[k] = 0.0
    arm = vector(row.arm_a)
    motion = motions[row.a]
    yields = _yield_of(motion, arm, normal, normal)
    k11 = _yield_of(motion, arm, one, one)
    k12 = _yield_of(motion, arm, one, two)
    k22 = _yield_of(motion, arm, two, two)
    if row.b >= 0:
        arm = vector(row.arm_b)
        motion = motions[row.b]
        yields += _yield_of(motion, arm, normal, normal)
        k11 += _yield_of(motion, arm, one, one)
        k12 += _yield_of(motion, arm, one, two)
        k22 += _yield_of(motion, arm, two, two)
    row.mass = 1.0 / yields
    scale = 1.0 / (k11 * k22 - k12 * k12)
    row.grip[0] = k22 * scale
    row.grip[1] = -k12 * scale
    row.grip[2] = k11 * scale
    spread = math.sqrt((k11 - k22) ** 2 + 4.0 * k12 * k12)
    row.grip[3] = 2.0 / (k11 + k22 + spread)


@func
def _surface_velocity(motion: np.record, arm: Vec3) -> Vec3:
    """Return the velocity of a drone's surface at a point, m/s."""
    turning = cross(vector(motion.spin), arm)
    return (
        motion.velocity[0] + turning[0],
        motion.velocity[1] + turning[1],
        motion.velocity[2] + turning[2],
    )


@func
def slip(row: np.record, motions: np.ndarray) -> Vec3:
    """Return the velocity of a's surface against that of b at a point, m/s."""
    other = vector(row.drift)
    if row.b >= 0:
        other = _surface_velocity(motions[row.b], vector(row.arm_b))
    return minus(_surface_velocity(motions[row.a], vector(row.arm_a)), other)


@func
def _push(motion: np.record, arm: Vec3, impulse: Vec3, sign: float) -> None:
    """Give a drone an impulse (N s) at a point."""
    turning = eased(motion, cross(arm, impulse))
    for k in range(3):
        motion.velocity[k] += sign * motion.lightness * impulse[k]
        motion.spin[k] += sign * turning[k]


@func
def _apply(row: np.record, impulse: Vec3, motions: np.ndarray) -> None:
    """Give both bodies of a point an impulse, N s."""
    _push(motions[row.a], vector(row.arm_a), impulse, 1.0)
    if row.b >= 0:
        _push(motions[row.b], vector(row.arm_b), impulse, -1.0)


@func
def _rub(
    row: np.record,
    motions: np.ndarray,
) -> float:
    """Let friction act at a point; returns the change of velocity, m/s."""
    moving = slip(row, motions)
    one = vector(row.tangent[0])
    two = vector(row.tangent[1])
    along = dot(moving, one)
    across = dot(moving, two)
    # What would stop the slip
    first = row.impulse[1] - (row.grip[0] * along + row.grip[1] * across)
    second = row.impulse[2] - (row.grip[1] * along + row.grip[2] * across)
    most = row.friction * row.impulse[0]
    size = math.sqrt(first * first + second * second)
    if size > most:
        # More than the normal impulse allows: as much as it does, against the slip
        first = row.impulse[1] - row.grip[3] * along
        second = row.impulse[2] - row.grip[3] * across
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
    _apply(row, impulse, motions)
    moved: float = (abs(first_change) + abs(second_change)) / row.mass
    return moved


@func
def _resist_turning(row: np.record, motions: np.ndarray) -> None:
    """Let angular impulses about the axes of a point resist that its bodies roll or pivot."""
    for side in range(3):
        if row.resist[side] == 0.0:
            continue
        axis = vector(row.axis[side])
        spin = vector(motions[row.a].spin)
        if row.b >= 0:
            spin = minus(spin, vector(motions[row.b].spin))
        most = row.resist[side] * row.impulse[0]
        wanted = row.roll[side] - row.stiff[side] * dot(spin, axis)
        wanted = min(max(wanted, -most), most)
        change = wanted - row.roll[side]
        row.roll[side] = wanted
        twist = (change * axis[0], change * axis[1], change * axis[2])
        _spin_up(motions[row.a], twist, 1.0)
        if row.b >= 0:
            _spin_up(motions[row.b], twist, -1.0)


@func
def _spin_up(motion: np.record, twist: Vec3, sign: float) -> None:
    """Give a drone an angular impulse, N m s."""
    turning = eased(motion, twist)
    for k in range(3):
        motion.spin[k] += sign * turning[k]


@func
def _press(
    row: np.record,
    motions: np.ndarray,
) -> float:
    """Let a point push its surfaces apart; returns the change of velocity, m/s."""
    normal = vector(row.normal)
    missing = row.least - dot(slip(row, motions), normal)
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
    _apply(row, impulse, motions)
    moved: float = abs(change) / row.mass
    return moved


@kernel
def relax(
    points: np.ndarray,
    count: int,
    motions: np.ndarray,
) -> int:
    """Sweep over points until none closes faster than it may.

    Args:
        points: Rows of `POINT`; impulses start from zero and are written.
        count: How many of them count.
        motions: (N,) rows of `MOTION`; velocities and spins are changed.

    Returns:
        The number of sweeps.
    """
    fastest = 1.0
    for k in range(count):
        row = points[k]
        row.impulse[0] = 0.0
        row.impulse[1] = 0.0
        row.impulse[2] = 0.0
        row.roll[:] = 0.0
        moving = slip(row, motions)
        fastest = max(fastest, math.sqrt(dot(moving, moving)))
    most = max(FEWEST, min(SWEEPS, WORK // max(1, count)))
    for sweep in range(most):
        change = 0.0
        for k in range(count):
            row = points[k]
            rubs = row.impulse[0] > 0.0 or row.impulse[1] != 0.0 or row.impulse[2] != 0.0
            if row.friction > 0.0 and rubs:
                _resist_turning(row, motions)
                change = max(change, _rub(row, motions))
            change = max(change, _press(row, motions))
        if change <= FIRM * fastest:
            return sweep + 1
    return most


@kernel
def damp_tipping(points: np.ndarray, count: int, motions: np.ndarray) -> bool:
    """Damp the spin of bodies about axes across the normals of points that press.

    Args:
        points: Rows of `POINT`, with the impulses of a pass.
        count: How many of them count.
        motions: (N,) rows of `MOTION`; spins are changed.

    Returns:
        Whether any spin was changed enough to matter.
    """
    acts = False
    for k in range(count):
        row = points[k]
        if row.impulse[0] <= 0.0:
            continue
        spin = vector(motions[row.a].spin)
        if row.b >= 0:
            spin = minus(spin, vector(motions[row.b].spin))
        normal = vector(row.normal)
        about = dot(spin, normal)
        tipping = (
            spin[0] - about * normal[0],
            spin[1] - about * normal[1],
            spin[2] - about * normal[2],
        )
        square = dot(tipping, tipping)
        if square < CALM * CALM:
            continue
        # Implicit in the spin, so that it is never turned round
        yields = dot(tipping, eased(motions[row.a], tipping)) / square
        if row.b >= 0:
            yields += dot(tipping, eased(motions[row.b], tipping)) / square
        strength = row.damping * row.impulse[0]
        strength /= 1.0 + strength * yields
        twist = (-strength * tipping[0], -strength * tipping[1], -strength * tipping[2])
        _spin_up(motions[row.a], twist, 1.0)
        if row.b >= 0:
            _spin_up(motions[row.b], twist, -1.0)
        acts = True
    return acts


@kernel
def keep(points: np.ndarray, count: int) -> None:
    """Add the impulses of a pass to the totals."""
    for k in range(count):
        for m in range(3):
            points[k].total[m] += points[k].impulse[m]


@func
def energy(
    motion: np.record, velocity: Vec3Like, spin: Vec3Like, frame: Vec3, row: np.record
) -> float:
    """Return a drone's kinetic energy (J) with a velocity and spin, as seen from a frame."""
    bx, by, bz = axes(quaternion_of(motion))
    turning = vector(spin)
    moving = minus(vector(velocity), frame)
    total: float = 0.5 * row.mass * dot(moving, moving)
    total += 0.5 * row.inertia[0] * dot(bx, turning) ** 2
    total += 0.5 * row.inertia[1] * dot(by, turning) ** 2
    total += 0.5 * row.inertia[2] * dot(bz, turning) ** 2
    return total
