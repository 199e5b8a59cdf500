"""Sequential impulses on all points of an island together, until nothing changes.

E. Catto, Iterative dynamics with temporal coherence, 2005. Friction stays within Coulomb's disc.
Between sweeps impulses go on the way they went, as in the method of conjugate gradients: M.
Silcowitz, S. Niebe and K. Erleben, A nonsmooth nonlinear conjugate gradient method for interactive
contact force problems, 2010.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.constraint import (
    BodyVelocities,
    apply_axis_impulse,
    apply_inverse_inertia,
    compute_axis_velocity,
    compute_relative_velocity,
    read_velocities,
    write_velocities,
)
from bulletuav.contact.motion import read_vec3, write_vec3
from bulletuav.geometry.rotation import Vec3, dot, minus, plus, point

TIGHT_TOLERANCE = 1e-9
"""Precision of impulses of what rebounds, see `solve_constraints`"""
SINGLE_BODY_TOLERANCE = 1e-6
"""The same of a drone that is held or stopped: slides are exact to 1e-3 by it"""
MULTI_BODY_TOLERANCE = 1e-5
"""The same of drones that hold each other; rest begins at hundreds of it"""
COLD_START, WARM_START, RESUME = 0, 1, 2
"""What impulses start from, see `solve_constraints`"""
MAX_ITERATIONS = 200
"""Most sweeps over the points of any island"""
RESTART_GROWTH = 4.0
"""Square of the changes over the least so far, above which the way begins anew"""
MAX_MOMENTUM = 0.9
"""Share of its way by which it goes on at most"""
MIN_ROW_UPDATES = 10_000
"""Visits of points that a large island gets, unless that is less than `MIN_ITERATIONS` sweeps"""
ROW_UPDATES_PER_SECOND = 3_000_000
"""The same over the length of the substep, if that is more: forces do more in a longer one"""
MIN_TIPPING_SPIN = 0.02
"""Spin below which tipping is not damped, rad/s"""
MIN_ITERATIONS = 20
"""Sweeps that even a large island gets"""


@func
def _compute_friction_against_slip(
    row: np.record, along: float, across: float
) -> tuple[float, float, float]:
    """Return friction along the tangents that grows against a slip (m/s), and its size, N s."""
    first = row.impulse[1] - row.tangent_mass[3] * along
    second = row.impulse[2] - row.tangent_mass[3] * across
    return first, second, math.sqrt(first * first + second * second)


@func
def _update_friction(row: np.record, motions: np.ndarray, moving: BodyVelocities) -> BodyVelocities:
    """Let friction act at a point, and return how its bodies move then; notes if they slide."""
    one = read_vec3(row.tangent[0])
    two = read_vec3(row.tangent[1])
    along = compute_axis_velocity(row, moving, 1, one)
    across = compute_axis_velocity(row, moving, 2, two)
    # What would stop the slip
    first = row.impulse[1] - (row.tangent_mass[0] * along + row.tangent_mass[1] * across)
    second = row.impulse[2] - (row.tangent_mass[1] * along + row.tangent_mass[2] * across)
    most = row.friction * max(0.0, row.impulse[0])
    size = math.sqrt(first * first + second * second)
    row.is_sliding = False
    if size > most:
        # More than the normal impulse allows: as much as it does, against the slip
        first, second, size = _compute_friction_against_slip(row, along, across)
        if size > most:
            row.is_sliding = True
            first *= most / size
            second *= most / size
    moving = apply_axis_impulse(row, motions, moving, 1, one, first - row.impulse[1])
    moving = apply_axis_impulse(row, motions, moving, 2, two, second - row.impulse[2])
    row.impulse[1] = first
    row.impulse[2] = second
    return moving


@func
def _update_rolling_resistance(row: np.record, moving: BodyVelocities) -> BodyVelocities:
    """Let angular impulses about the axes of a point resist that its bodies roll or pivot."""
    velocity_a, spin_a, velocity_b, spin_b = moving
    for side in range(3):
        if row.rolling_limit[side] == 0.0:
            continue
        axis = read_vec3(row.rolling_axis[side])
        spin = minus(spin_a, spin_b)
        most = row.rolling_limit[side] * max(0.0, row.impulse[0])
        wanted = row.rolling_impulse[side] - row.rolling_mass[side] * dot(spin, axis)
        wanted = min(max(wanted, -most), most)
        change = wanted - row.rolling_impulse[side]
        row.rolling_impulse[side] = wanted
        spin_a = plus(spin_a, change, point(row.rolling_response_a, side))
        if row.b >= 0:
            spin_b = plus(spin_b, -change, point(row.rolling_response_b, side))
    return velocity_a, spin_a, velocity_b, spin_b


@func
def _apply_angular_impulse(motion: np.record, twist: Vec3, sign: float) -> None:
    """Give a drone an angular impulse, N m s."""
    turning = apply_inverse_inertia(motion, twist)
    for k in range(3):
        motion.spin[k] += sign * turning[k]


@func
def _update_normal(row: np.record, motions: np.ndarray, moving: BodyVelocities) -> BodyVelocities:
    """Let a point push its surfaces apart, and return how its bodies move then."""
    normal = read_vec3(row.normal)
    missing = row.target_velocity - compute_axis_velocity(row, moving, 0, normal)
    pressed = max(0.0, row.impulse[0] + row.normal_mass * missing)
    change = pressed - row.impulse[0]
    row.impulse[0] = pressed
    return apply_axis_impulse(row, motions, moving, 0, normal, change)


@func
def _update_sticking(
    row: np.record, motions: np.ndarray, moving: BodyVelocities
) -> tuple[bool, BodyVelocities]:
    """Stop a point along all of its axes at once, if friction can hold it; tells whether it can."""
    missing = (
        row.target_velocity - compute_axis_velocity(row, moving, 0, read_vec3(row.normal)),
        -compute_axis_velocity(row, moving, 1, read_vec3(row.tangent[0])),
        -compute_axis_velocity(row, moving, 2, read_vec3(row.tangent[1])),
    )
    change = (
        dot(point(row.block_mass, 0), missing),
        dot(point(row.block_mass, 1), missing),
        dot(point(row.block_mass, 2), missing),
    )
    wanted = plus(read_vec3(row.impulse), 1.0, change)
    square = wanted[1] * wanted[1] + wanted[2] * wanted[2]
    if wanted[0] < 0.0 or square > (row.friction * wanted[0]) ** 2:
        return False, moving
    write_vec3(row.impulse, wanted)
    return True, _apply_impulse(row, motions, moving, change)


@func
def _apply_impulse(
    row: np.record, motions: np.ndarray, moving: BodyVelocities, impulse: Vec3
) -> BodyVelocities:
    """Return how the bodies of a point move after an impulse along its axes, N s."""
    moving = apply_axis_impulse(row, motions, moving, 0, read_vec3(row.normal), impulse[0])
    moving = apply_axis_impulse(row, motions, moving, 1, read_vec3(row.tangent[0]), impulse[1])
    return apply_axis_impulse(row, motions, moving, 2, read_vec3(row.tangent[1]), impulse[2])


@func
def _update_sliding(
    row: np.record, motions: np.ndarray, moving: BodyVelocities
) -> tuple[bool, BodyVelocities]:
    """Stop a sliding point along its normal, with the friction that the normal impulse allows.

    Friction is `friction` times the normal impulse, so that both are solved for at once. Only its
    direction, against the slip, is left to the next sweep. Tells whether the point slides.
    """
    along = compute_axis_velocity(row, moving, 1, read_vec3(row.tangent[0]))
    across = compute_axis_velocity(row, moving, 2, read_vec3(row.tangent[1]))
    first, second, size = _compute_friction_against_slip(row, along, across)
    if size <= row.friction * max(0.0, row.impulse[0]):
        return False, moving
    # Friction for each unit of the normal impulse
    first *= row.friction / size
    second *= row.friction / size
    # Less where friction presses, but such a point would do more than others bear
    yields = 1.0 / row.normal_mass + max(0.0, row.coupling[0] * first + row.coupling[1] * second)
    missing = row.target_velocity - compute_axis_velocity(row, moving, 0, read_vec3(row.normal))
    # What turns friction into that direction lifts, too
    missing -= row.coupling[0] * (row.impulse[0] * first - row.impulse[1])
    missing -= row.coupling[1] * (row.impulse[0] * second - row.impulse[2])
    pressed = max(0.0, row.impulse[0] + missing / yields)
    wanted = (pressed, pressed * first, pressed * second)
    change = minus(wanted, read_vec3(row.impulse))
    write_vec3(row.impulse, wanted)
    row.is_sliding = True
    return True, _apply_impulse(row, motions, moving, change)


@func
def _update_row(row: np.record, motions: np.ndarray, at_once: bool) -> None:
    """Let a point do what it has to, given what all others do; notes the change in `step`.

    Where it slides, normal impulse and friction are found at once, or one after the other.
    """
    old = read_vec3(row.impulse)
    moving = read_velocities(row, motions)
    none = (0.0, 0.0, 0.0)
    acts = old != none or read_vec3(row.rolling_impulse) != none
    # Most points do nothing and have nothing to do
    if (
        not acts
        and compute_axis_velocity(row, moving, 0, read_vec3(row.normal)) >= row.target_velocity
    ):
        write_vec3(row.impulse_change, none)
        return
    done = False
    if row.friction > 0.0:
        if acts:
            moving = _update_rolling_resistance(row, moving)
        # Who slid a moment ago will hardly stick
        if not row.is_sliding:
            done, moving = _update_sticking(row, motions, moving)
        if not done and at_once:
            done, moving = _update_sliding(row, motions, moving)
        if acts and not done:
            moving = _update_friction(row, motions, moving)
    if not done:
        moving = _update_normal(row, motions, moving)
    write_velocities(row, motions, moving)
    write_vec3(row.impulse_change, minus(read_vec3(row.impulse), old))


@func
def _step_along_search_direction(
    points: np.ndarray, count: int, motions: np.ndarray, share: float, anew: bool
) -> None:
    """Let impulses go on the way of the sweeps before, by a share of it, or begin a new way."""
    for k in range(count):
        row = points[k]
        if anew:
            write_vec3(row.search_direction, (0.0, 0.0, 0.0))
            continue
        way = read_vec3(row.search_direction)
        if way == (0.0, 0.0, 0.0):
            write_vec3(row.search_direction, read_vec3(row.impulse_change))
            continue
        further = (share * way[0], share * way[1], share * way[2])
        write_vec3(row.impulse, plus(read_vec3(row.impulse), 1.0, further))
        write_vec3(row.search_direction, plus(further, 1.0, read_vec3(row.impulse_change)))
        write_velocities(
            row, motions, _apply_impulse(row, motions, read_velocities(row, motions), further)
        )


@kernel
def solve_constraints(
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
        start: `COLD_START`, `WARM_START` for the impulses that are there, which do not act yet,
            or `RESUME` for those that act already.

    Returns:
        The number of sweeps.
    """
    fastest = 1.0
    for k in range(count):
        row = points[k]
        write_vec3(row.search_direction, (0.0, 0.0, 0.0))
        row.is_sliding = False
        if start == RESUME:
            continue
        write_vec3(row.rolling_impulse, (0.0, 0.0, 0.0))
        if start == WARM_START:
            moving = read_velocities(row, motions)
            write_velocities(
                row, motions, _apply_impulse(row, motions, moving, read_vec3(row.impulse))
            )
        else:
            write_vec3(row.impulse, (0.0, 0.0, 0.0))
    for k in range(count):
        slips = compute_relative_velocity(points[k], motions)
        fastest = max(fastest, math.sqrt(dot(slips, slips)))
    work = max(MIN_ROW_UPDATES, int(dt * ROW_UPDATES_PER_SECOND))
    most = max(MIN_ITERATIONS, min(MAX_ITERATIONS, work // max(1, count)))
    before = 0.0
    least = math.inf
    at_once = True
    for sweep in range(most):
        change = 0.0
        square = 0.0
        further = 0.0
        for k in range(count):
            row = points[k]
            _update_row(row, motions, at_once)
            step = read_vec3(row.impulse_change)
            change = max(
                change,
                (abs(step[1]) + abs(step[2])) / row.normal_mass,
                abs(step[0]) / row.normal_mass,
            )
            square += dot(step, step)
            further += dot(step, row.search_direction)
        if change <= firm * fastest:
            return sweep + 1
        grows = square > RESTART_GROWTH * least
        # Points that are wedged may drive each other on by their friction
        at_once = at_once and not grows
        if sweep > 0 and sweep + 1 < most:
            # What went too far is taken back against its way
            anew = further < 0.0 or grows
            _step_along_search_direction(
                points, count, motions, min(square / before, MAX_MOMENTUM), anew
            )
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
        spin = read_vec3(motions[row.a].spin)
        if row.b >= 0:
            spin = minus(spin, read_vec3(motions[row.b].spin))
        normal = read_vec3(row.normal)
        about = dot(spin, normal)
        tipping = (
            spin[0] - about * normal[0],
            spin[1] - about * normal[1],
            spin[2] - about * normal[2],
        )
        square = dot(tipping, tipping)
        if square < MIN_TIPPING_SPIN * MIN_TIPPING_SPIN:
            continue
        # Implicit in the spin, so that it is never turned round
        yields = dot(tipping, apply_inverse_inertia(motions[row.a], tipping)) / square
        if row.b >= 0:
            yields += dot(tipping, apply_inverse_inertia(motions[row.b], tipping)) / square
        strength = row.tipping_damping * row.impulse[0]
        strength /= 1.0 + strength * yields
        twist = (-strength * tipping[0], -strength * tipping[1], -strength * tipping[2])
        _apply_angular_impulse(motions[row.a], twist, 1.0)
        if row.b >= 0:
            _apply_angular_impulse(motions[row.b], twist, -1.0)
        acts = True
    return acts
