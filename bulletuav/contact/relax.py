"""Sequential impulses on all points of an island together, until nothing changes.

E. Catto, Iterative dynamics with temporal coherence, 2005. Friction stays within Coulomb's disc.
Between sweeps impulses go on the way they went, as in the method of conjugate gradients: M.
Silcowitz, S. Niebe and K. Erleben, A nonsmooth nonlinear conjugate gradient method for interactive
contact force problems, 2010.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.impulses import (
    Moving,
    eased,
    moving_at,
    pushed,
    put_moving,
    slip,
    speed_along,
)
from bulletuav.contact.motion import put_vector, vector
from bulletuav.geometry.rotation import Vec3, dot, minus, plus, point

FIRM = 1e-9
"""Precision of impulses of what rebounds, see `relax`"""
FIRM_ENOUGH = 1e-6
"""The same of a drone that is held or stopped: slides are exact to 1e-3 by it"""
FIRM_IN_HEAPS = 1e-5
"""The same of drones that hold each other; rest begins at hundreds of it"""
FROM_NOTHING, FROM_MEMORY, FROM_BEFORE = 0, 1, 2
"""What impulses start from, see `relax`"""
SWEEPS = 200
"""Most sweeps over the points of any island"""
GROWTH = 4.0
"""Square of the changes over the least so far, above which the way begins anew"""
MOMENTUM = 0.9
"""Share of its way by which it goes on at most"""
WORK = 10_000
"""Visits of points that a large island gets, unless that is less than `FEWEST` sweeps"""
WORK_A_SECOND = 3_000_000
"""The same over the length of the substep, if that is more: forces do more in a longer one"""
CALM = 0.02
"""Spin below which tipping is not damped, rad/s"""
FEWEST = 20
"""Sweeps that even a large island gets"""


@func
def _against(row: np.record, along: float, across: float) -> tuple[float, float, float]:
    """Return friction along the tangents that grows against a slip (m/s), and its size, N s."""
    first = row.impulse[1] - row.grip[3] * along
    second = row.impulse[2] - row.grip[3] * across
    return first, second, math.sqrt(first * first + second * second)


@func
def _rub(row: np.record, motions: np.ndarray, moving: Moving) -> Moving:
    """Let friction act at a point, and return how its bodies move then; notes if they slide."""
    one = vector(row.tangent[0])
    two = vector(row.tangent[1])
    along = speed_along(row, moving, 1, one)
    across = speed_along(row, moving, 2, two)
    # What would stop the slip
    first = row.impulse[1] - (row.grip[0] * along + row.grip[1] * across)
    second = row.impulse[2] - (row.grip[1] * along + row.grip[2] * across)
    most = row.friction * max(0.0, row.impulse[0])
    size = math.sqrt(first * first + second * second)
    row.slides = False
    if size > most:
        # More than the normal impulse allows: as much as it does, against the slip
        first, second, size = _against(row, along, across)
        if size > most:
            row.slides = True
            first *= most / size
            second *= most / size
    moving = pushed(row, motions, moving, 1, one, first - row.impulse[1])
    moving = pushed(row, motions, moving, 2, two, second - row.impulse[2])
    row.impulse[1] = first
    row.impulse[2] = second
    return moving


@func
def _resist_turning(row: np.record, moving: Moving) -> Moving:
    """Let angular impulses about the axes of a point resist that its bodies roll or pivot."""
    velocity_a, spin_a, velocity_b, spin_b = moving
    for side in range(3):
        if row.resist[side] == 0.0:
            continue
        axis = vector(row.axis[side])
        spin = minus(spin_a, spin_b)
        most = row.resist[side] * max(0.0, row.impulse[0])
        wanted = row.roll[side] - row.stiff[side] * dot(spin, axis)
        wanted = min(max(wanted, -most), most)
        change = wanted - row.roll[side]
        row.roll[side] = wanted
        spin_a = plus(spin_a, change, point(row.turning_a, side))
        if row.b >= 0:
            spin_b = plus(spin_b, -change, point(row.turning_b, side))
    return velocity_a, spin_a, velocity_b, spin_b


@func
def _spin_up(motion: np.record, twist: Vec3, sign: float) -> None:
    """Give a drone an angular impulse, N m s."""
    turning = eased(motion, twist)
    for k in range(3):
        motion.spin[k] += sign * turning[k]


@func
def _press(row: np.record, motions: np.ndarray, moving: Moving) -> Moving:
    """Let a point push its surfaces apart, and return how its bodies move then."""
    normal = vector(row.normal)
    missing = row.least - speed_along(row, moving, 0, normal)
    pressed = max(0.0, row.impulse[0] + row.mass * missing)
    change = pressed - row.impulse[0]
    row.impulse[0] = pressed
    return pushed(row, motions, moving, 0, normal, change)


@func
def _stick(row: np.record, motions: np.ndarray, moving: Moving) -> tuple[bool, Moving]:
    """Stop a point along all of its axes at once, if friction can hold it; tells whether it can."""
    missing = (
        row.least - speed_along(row, moving, 0, vector(row.normal)),
        -speed_along(row, moving, 1, vector(row.tangent[0])),
        -speed_along(row, moving, 2, vector(row.tangent[1])),
    )
    change = (
        dot(point(row.hold, 0), missing),
        dot(point(row.hold, 1), missing),
        dot(point(row.hold, 2), missing),
    )
    wanted = plus(vector(row.impulse), 1.0, change)
    square = wanted[1] * wanted[1] + wanted[2] * wanted[2]
    if wanted[0] < 0.0 or square > (row.friction * wanted[0]) ** 2:
        return False, moving
    put_vector(row.impulse, wanted)
    return True, _given(row, motions, moving, change)


@func
def _given(row: np.record, motions: np.ndarray, moving: Moving, impulse: Vec3) -> Moving:
    """Return how the bodies of a point move after an impulse along its axes, N s."""
    moving = pushed(row, motions, moving, 0, vector(row.normal), impulse[0])
    moving = pushed(row, motions, moving, 1, vector(row.tangent[0]), impulse[1])
    return pushed(row, motions, moving, 2, vector(row.tangent[1]), impulse[2])


@func
def _slide(row: np.record, motions: np.ndarray, moving: Moving) -> tuple[bool, Moving]:
    """Stop a sliding point along its normal, with the friction that the normal impulse allows.

    Friction is `friction` times the normal impulse, so that both are solved for at once. Only its
    direction, against the slip, is left to the next sweep. Tells whether the point slides.
    """
    along = speed_along(row, moving, 1, vector(row.tangent[0]))
    across = speed_along(row, moving, 2, vector(row.tangent[1]))
    first, second, size = _against(row, along, across)
    if size <= row.friction * max(0.0, row.impulse[0]):
        return False, moving
    # Friction for each unit of the normal impulse
    first *= row.friction / size
    second *= row.friction / size
    # Less where friction presses, but such a point would do more than others bear
    yields = 1.0 / row.mass + max(0.0, row.lift[0] * first + row.lift[1] * second)
    missing = row.least - speed_along(row, moving, 0, vector(row.normal))
    # What turns friction into that direction lifts, too
    missing -= row.lift[0] * (row.impulse[0] * first - row.impulse[1])
    missing -= row.lift[1] * (row.impulse[0] * second - row.impulse[2])
    pressed = max(0.0, row.impulse[0] + missing / yields)
    wanted = (pressed, pressed * first, pressed * second)
    change = minus(wanted, vector(row.impulse))
    put_vector(row.impulse, wanted)
    row.slides = True
    return True, _given(row, motions, moving, change)


@func
def _visit(row: np.record, motions: np.ndarray, at_once: bool) -> None:
    """Let a point do what it has to, given what all others do; notes the change in `step`.

    Where it slides, normal impulse and friction are found at once, or one after the other.
    """
    old = vector(row.impulse)
    moving = moving_at(row, motions)
    none = (0.0, 0.0, 0.0)
    acts = old != none or vector(row.roll) != none
    # Most points do nothing and have nothing to do
    if not acts and speed_along(row, moving, 0, vector(row.normal)) >= row.least:
        put_vector(row.step, none)
        return
    done = False
    if row.friction > 0.0:
        if acts:
            moving = _resist_turning(row, moving)
        # Who slid a moment ago will hardly stick
        if not row.slides:
            done, moving = _stick(row, motions, moving)
        if not done and at_once:
            done, moving = _slide(row, motions, moving)
        if acts and not done:
            moving = _rub(row, motions, moving)
    if not done:
        moving = _press(row, motions, moving)
    put_moving(row, motions, moving)
    put_vector(row.step, minus(vector(row.impulse), old))


@func
def _go_on(points: np.ndarray, count: int, motions: np.ndarray, share: float, anew: bool) -> None:
    """Let impulses go on the way of the sweeps before, by a share of it, or begin a new way."""
    for k in range(count):
        row = points[k]
        if anew:
            put_vector(row.way, (0.0, 0.0, 0.0))
            continue
        way = vector(row.way)
        if way == (0.0, 0.0, 0.0):
            put_vector(row.way, vector(row.step))
            continue
        further = (share * way[0], share * way[1], share * way[2])
        put_vector(row.impulse, plus(vector(row.impulse), 1.0, further))
        put_vector(row.way, plus(further, 1.0, vector(row.step)))
        put_moving(row, motions, _given(row, motions, moving_at(row, motions), further))


@kernel
def relax(
    points: np.ndarray, count: int, motions: np.ndarray, dt: float, firm: float, start: int
) -> int:
    """Sweep over points until none closes faster than it may.

    Args:
        points: Rows of `POINT`; impulses are written.
        count: How many of them count.
        motions: (N,) rows of `MOTION`; velocities and spins are changed.
        dt: Length of the substep, s.
        firm: Change of velocity below which a sweep changes nothing, as share of the greatest one
            or 1 m/s.
        start: `FROM_NOTHING`, `FROM_MEMORY` for the impulses that are there, which do not act yet,
            or `FROM_BEFORE` for those that act already.

    Returns:
        The number of sweeps.
    """
    fastest = 1.0
    for k in range(count):
        row = points[k]
        put_vector(row.way, (0.0, 0.0, 0.0))
        row.slides = False
        if start == FROM_BEFORE:
            continue
        put_vector(row.roll, (0.0, 0.0, 0.0))
        if start == FROM_MEMORY:
            moving = moving_at(row, motions)
            put_moving(row, motions, _given(row, motions, moving, vector(row.impulse)))
        else:
            put_vector(row.impulse, (0.0, 0.0, 0.0))
    for k in range(count):
        slips = slip(points[k], motions)
        fastest = max(fastest, math.sqrt(dot(slips, slips)))
    work = max(WORK, int(dt * WORK_A_SECOND))
    most = max(FEWEST, min(SWEEPS, work // max(1, count)))
    before = 0.0
    least = math.inf
    at_once = True
    for sweep in range(most):
        change = 0.0
        square = 0.0
        further = 0.0
        for k in range(count):
            row = points[k]
            _visit(row, motions, at_once)
            step = vector(row.step)
            change = max(change, (abs(step[1]) + abs(step[2])) / row.mass, abs(step[0]) / row.mass)
            square += dot(step, step)
            further += dot(step, row.way)
        if change <= firm * fastest:
            return sweep + 1
        grows = square > GROWTH * least
        # Points that are wedged may drive each other on by their friction
        at_once = at_once and not grows
        if sweep > 0 and sweep + 1 < most:
            # What went too far is taken back against its way
            anew = further < 0.0 or grows
            _go_on(points, count, motions, min(square / before, MOMENTUM), anew)
        before = square
        least = min(least, square)
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
