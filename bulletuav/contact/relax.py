"""Sequential impulses on all points of an island together, until nothing changes.

E. Catto, Iterative dynamics with temporal coherence, 2005. Friction stays within Coulomb's disc.
Between sweeps impulses go on the way they went, as in the method of conjugate gradients: M.
Silcowitz, S. Niebe and K. Erleben, A nonsmooth nonlinear conjugate gradient method for interactive
contact force problems, 2010.
"""

import math

import numpy as np

from bulletuav.contact.impulses import eased, push, slip, speed_along
from bulletuav.contact.motion import put_vector, vector
from bulletuav.geometry.rotation import Vec3, dot, minus
from bulletuav.kernel import func, kernel

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
def _rub(
    row: np.record,
    motions: np.ndarray,
) -> float:
    """Let friction act at a point; returns the change of velocity, m/s."""
    one = row.tangent[0]
    two = row.tangent[1]
    along = speed_along(row, motions, 1, one)
    across = speed_along(row, motions, 2, two)
    # What would stop the slip
    first = row.impulse[1] - (row.grip[0] * along + row.grip[1] * across)
    second = row.impulse[2] - (row.grip[1] * along + row.grip[2] * across)
    most = row.friction * max(0.0, row.impulse[0])
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
    push(row, motions, 1, one, first_change)
    push(row, motions, 2, two, second_change)
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
        most = row.resist[side] * max(0.0, row.impulse[0])
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
    missing = row.least - speed_along(row, motions, 0, row.normal)
    pressed = row.impulse[0] + row.mass * missing
    if pressed < 0.0:
        pressed = 0.0
    change = pressed - row.impulse[0]
    row.impulse[0] = pressed
    push(row, motions, 0, row.normal, change)
    moved: float = abs(change) / row.mass
    return moved


@func
def _go_on(points: np.ndarray, count: int, motions: np.ndarray, share: float) -> None:
    """Let impulses go on the way of the sweeps before, by a share of it; not if that is above 1."""
    for k in range(count):
        row = points[k]
        if share > 1.0:
            row.way[:] = 0.0
            continue
        for m in range(3):
            further = share * row.way[m]
            row.impulse[m] += further
            row.way[m] = further + row.step[m]
            push(
                row,
                motions,
                m,
                vector(row.normal) if m == 0 else vector(row.tangent[m - 1]),
                further,
            )


@kernel
def relax(
    points: np.ndarray,
    count: int,
    motions: np.ndarray,
    warm: bool = False,
) -> int:
    """Sweep over points until none closes faster than it may.

    Args:
        points: Rows of `POINT`; impulses are written.
        count: How many of them count.
        motions: (N,) rows of `MOTION`; velocities and spins are changed.
        warm: Whether impulses start from those that are there, instead of zero.

    Returns:
        The number of sweeps.
    """
    fastest = 1.0
    for k in range(count):
        row = points[k]
        for m in range(3):
            row.impulse[m] = row.impulse[m] if warm else 0.0
            row.roll[m] = 0.0
            row.way[m] = 0.0
        if warm:
            push(row, motions, 0, vector(row.normal), row.impulse[0])
            push(row, motions, 1, vector(row.tangent[0]), row.impulse[1])
            push(row, motions, 2, vector(row.tangent[1]), row.impulse[2])
    for k in range(count):
        moving = slip(points[k], motions)
        fastest = max(fastest, math.sqrt(dot(moving, moving)))
    most = max(FEWEST, min(SWEEPS, WORK // max(1, count)))
    before = 0.0
    for sweep in range(most):
        change = 0.0
        square = 0.0
        for k in range(count):
            row = points[k]
            old = vector(row.impulse)
            rubs = row.impulse[0] != 0.0 or row.impulse[1] != 0.0 or row.impulse[2] != 0.0
            if row.friction > 0.0 and rubs:
                _resist_turning(row, motions)
                change = max(change, _rub(row, motions))
            change = max(change, _press(row, motions))
            step = minus(vector(row.impulse), old)
            put_vector(row.step, step)
            square += dot(step, step)
        if change <= FIRM * fastest:
            return sweep + 1
        if sweep > 0 and sweep + 1 < most:
            _go_on(points, count, motions, square / before)
        before = square
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
