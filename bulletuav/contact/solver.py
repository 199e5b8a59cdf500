"""Contact solver: projected Gauss-Seidel (sequential impulses) over the constraints of an island.

Friction is limited by Coulomb's disc.

References:
    E. Catto, Iterative dynamics with temporal coherence, 2005.
    M. Silcowitz, S. Niebe and K. Erleben, A nonsmooth nonlinear conjugate gradient method for
    interactive contact force problems, 2010: the acceleration between iterations.
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
"""Tolerance of the solver for impacts with restitution, see `solve_constraints`"""
SINGLE_BODY_TOLERANCE = 1e-6
"""Tolerance for a single drone that rests or is stopped; sliding distances are exact to 1e-3"""
MULTI_BODY_TOLERANCE = 1e-5
"""Tolerance for islands of several drones; speeds at rest are hundreds of times this"""
COLD_START, WARM_START, RESUME = 0, 1, 2
"""Starting impulses of the solver, see `solve_constraints`"""
MAX_ITERATIONS = 200
"""Maximum number of iterations for any island"""
RESTART_GROWTH = 4.0
"""Growth of the squared change over its minimum at which the search direction is reset"""
MAX_MOMENTUM = 0.9
"""Maximum fraction of the search direction that is added between iterations"""
MIN_ROW_UPDATES = 10_000
"""Number of row updates that a large island gets, unless that is less than `MIN_ITERATIONS`"""
ROW_UPDATES_PER_SECOND = 3_000_000
"""Row updates per second of the substep, if that is more: forces do more in a long substep"""
MIN_TIPPING_SPIN = 0.02
"""Angular velocity below which tipping is not damped, rad/s"""
MIN_ITERATIONS = 20
"""Number of iterations that even a large island gets"""


@func
def _compute_friction_against_slip(
    row: np.record, along: float, across: float
) -> tuple[float, float, float]:
    """Return the friction impulses along the tangents against a slip (m/s), and their norm, N s."""
    first = row.impulse[1] - row.tangent_mass[3] * along
    second = row.impulse[2] - row.tangent_mass[3] * across
    return first, second, math.sqrt(first * first + second * second)


@func
def _update_friction(
    row: np.record, motions: np.ndarray, velocities: BodyVelocities
) -> BodyVelocities:
    """Update the friction impulses of a point; returns the new velocities of its bodies."""
    one = read_vec3(row.tangent[0])
    two = read_vec3(row.tangent[1])
    along = compute_axis_velocity(row, velocities, 1, one)
    across = compute_axis_velocity(row, velocities, 2, two)
    # Impulses that stop the slip
    first = row.impulse[1] - (row.tangent_mass[0] * along + row.tangent_mass[1] * across)
    second = row.impulse[2] - (row.tangent_mass[1] * along + row.tangent_mass[2] * across)
    limit = row.friction * max(0.0, row.impulse[0])
    size = math.sqrt(first * first + second * second)
    row.is_sliding = False
    if size > limit:
        # Beyond the friction limit: clamp the impulse, directed against the slip
        first, second, size = _compute_friction_against_slip(row, along, across)
        if size > limit:
            row.is_sliding = True
            first *= limit / size
            second *= limit / size
    velocities = apply_axis_impulse(row, motions, velocities, 1, one, first - row.impulse[1])
    velocities = apply_axis_impulse(row, motions, velocities, 2, two, second - row.impulse[2])
    row.impulse[1] = first
    row.impulse[2] = second
    return velocities


@func
def _update_rolling_resistance(row: np.record, velocities: BodyVelocities) -> BodyVelocities:
    """Update the angular impulses that resist rolling and pivoting; returns the new velocities."""
    velocity_a, spin_a, velocity_b, spin_b = velocities
    for side in range(3):
        if row.rolling_limit[side] == 0.0:
            continue
        axis = read_vec3(row.rolling_axis[side])
        spin = minus(spin_a, spin_b)
        limit = row.rolling_limit[side] * max(0.0, row.impulse[0])
        wanted = row.rolling_impulse[side] - row.rolling_mass[side] * dot(spin, axis)
        wanted = min(max(wanted, -limit), limit)
        change = wanted - row.rolling_impulse[side]
        row.rolling_impulse[side] = wanted
        spin_a = plus(spin_a, change, point(row.rolling_response_a, side))
        if row.b >= 0:
            spin_b = plus(spin_b, -change, point(row.rolling_response_b, side))
    return velocity_a, spin_a, velocity_b, spin_b


@func
def _apply_angular_impulse(motion: np.record, twist: Vec3, sign: float) -> None:
    """Apply an angular impulse to a drone, N m s."""
    turning = apply_inverse_inertia(motion, twist)
    for k in range(3):
        motion.spin[k] += sign * turning[k]


@func
def _update_normal(
    row: np.record, motions: np.ndarray, velocities: BodyVelocities
) -> BodyVelocities:
    """Update the normal impulse of a point; returns the new velocities of its bodies."""
    normal = read_vec3(row.normal)
    velocity_error = row.target_velocity - compute_axis_velocity(row, velocities, 0, normal)
    normal_impulse = max(0.0, row.impulse[0] + row.normal_mass * velocity_error)
    change = normal_impulse - row.impulse[0]
    row.impulse[0] = normal_impulse
    return apply_axis_impulse(row, motions, velocities, 0, normal, change)


@func
def _update_sticking(
    row: np.record, motions: np.ndarray, velocities: BodyVelocities
) -> tuple[bool, BodyVelocities]:
    """Stop a point along all three axes by a block solve, if friction can hold it.

    Returns whether the impulse is within the friction cone, and the velocities of the bodies.
    """
    velocity_error = (
        row.target_velocity - compute_axis_velocity(row, velocities, 0, read_vec3(row.normal)),
        -compute_axis_velocity(row, velocities, 1, read_vec3(row.tangent[0])),
        -compute_axis_velocity(row, velocities, 2, read_vec3(row.tangent[1])),
    )
    change = (
        dot(point(row.block_mass, 0), velocity_error),
        dot(point(row.block_mass, 1), velocity_error),
        dot(point(row.block_mass, 2), velocity_error),
    )
    wanted = plus(read_vec3(row.impulse), 1.0, change)
    square = wanted[1] * wanted[1] + wanted[2] * wanted[2]
    if wanted[0] < 0.0 or square > (row.friction * wanted[0]) ** 2:
        return False, velocities
    write_vec3(row.impulse, wanted)
    return True, _apply_impulse(row, motions, velocities, change)


@func
def _apply_impulse(
    row: np.record, motions: np.ndarray, velocities: BodyVelocities, impulse: Vec3
) -> BodyVelocities:
    """Return the velocities of the bodies of a point after an impulse along its axes, N s."""
    velocities = apply_axis_impulse(row, motions, velocities, 0, read_vec3(row.normal), impulse[0])
    velocities = apply_axis_impulse(
        row, motions, velocities, 1, read_vec3(row.tangent[0]), impulse[1]
    )
    return apply_axis_impulse(row, motions, velocities, 2, read_vec3(row.tangent[1]), impulse[2])


@func
def _update_sliding(
    row: np.record, motions: np.ndarray, velocities: BodyVelocities
) -> tuple[bool, BodyVelocities]:
    """Solve the normal impulse of a sliding point together with its friction.

    The friction is `friction` times the normal impulse, so that both are solved at once. The
    direction of the friction, against the slip, is updated in each iteration. Returns whether the
    point slides, and the velocities of the bodies.
    """
    along = compute_axis_velocity(row, velocities, 1, read_vec3(row.tangent[0]))
    across = compute_axis_velocity(row, velocities, 2, read_vec3(row.tangent[1]))
    first, second, size = _compute_friction_against_slip(row, along, across)
    if size <= row.friction * max(0.0, row.impulse[0]):
        return False, velocities
    # Friction per unit of the normal impulse
    first *= row.friction / size
    second *= row.friction / size
    # Ignore friction that presses: it would make this point stronger than others can balance
    inverse_mass = 1.0 / row.normal_mass + max(
        0.0, row.coupling[0] * first + row.coupling[1] * second
    )
    velocity_error = row.target_velocity - compute_axis_velocity(
        row, velocities, 0, read_vec3(row.normal)
    )
    # The change of the friction's direction changes the normal velocity, too
    velocity_error -= row.coupling[0] * (row.impulse[0] * first - row.impulse[1])
    velocity_error -= row.coupling[1] * (row.impulse[0] * second - row.impulse[2])
    normal_impulse = max(0.0, row.impulse[0] + velocity_error / inverse_mass)
    wanted = (normal_impulse, normal_impulse * first, normal_impulse * second)
    change = minus(wanted, read_vec3(row.impulse))
    write_vec3(row.impulse, wanted)
    row.is_sliding = True
    return True, _apply_impulse(row, motions, velocities, change)


@func
def _update_row(row: np.record, motions: np.ndarray, coupled: bool) -> None:
    """Update the impulses of one contact point with all others fixed; sets `impulse_change`.

    Args:
        row: Row of `CONTACT_POINT`.
        motions: (N,) rows of `MOTION`; velocities are changed.
        coupled: True to solve the normal impulse of a sliding point together with its friction.
    """
    old = read_vec3(row.impulse)
    velocities = read_velocities(row, motions)
    none = (0.0, 0.0, 0.0)
    acts = old != none or read_vec3(row.rolling_impulse) != none
    # Most points carry no impulse and need none
    if (
        not acts
        and compute_axis_velocity(row, velocities, 0, read_vec3(row.normal)) >= row.target_velocity
    ):
        write_vec3(row.impulse_change, none)
        return
    done = False
    if row.friction > 0.0:
        if acts:
            velocities = _update_rolling_resistance(row, velocities)
        # A point that slid in the last iteration rarely sticks
        if not row.is_sliding:
            done, velocities = _update_sticking(row, motions, velocities)
        if not done and coupled:
            done, velocities = _update_sliding(row, motions, velocities)
        if acts and not done:
            velocities = _update_friction(row, motions, velocities)
    if not done:
        velocities = _update_normal(row, motions, velocities)
    write_velocities(row, motions, velocities)
    write_vec3(row.impulse_change, minus(read_vec3(row.impulse), old))


@func
def _step_along_search_direction(
    points: np.ndarray, num_points: int, motions: np.ndarray, fraction: float, restart: bool
) -> None:
    """Add a fraction of the search direction to all impulses, or reset it if `restart`."""
    for k in range(num_points):
        row = points[k]
        if restart:
            write_vec3(row.search_direction, (0.0, 0.0, 0.0))
            continue
        direction = read_vec3(row.search_direction)
        if direction == (0.0, 0.0, 0.0):
            write_vec3(row.search_direction, read_vec3(row.impulse_change))
            continue
        further = (fraction * direction[0], fraction * direction[1], fraction * direction[2])
        write_vec3(row.impulse, plus(read_vec3(row.impulse), 1.0, further))
        write_vec3(row.search_direction, plus(further, 1.0, read_vec3(row.impulse_change)))
        write_velocities(
            row, motions, _apply_impulse(row, motions, read_velocities(row, motions), further)
        )


@kernel
def solve_constraints(
    points: np.ndarray,
    num_points: int,
    motions: np.ndarray,
    dt: float,
    tolerance: float,
    start: int,
) -> int:
    """Solve the contact constraints of an island by projected Gauss-Seidel.

    Args:
        points: Rows of `CONTACT_POINT`; impulses are written.
        num_points: Number of points in use.
        motions: (N,) rows of `MOTION`; velocities and angular velocities are changed.
        dt: Length of the substep, s.
        tolerance: The solver stops when no velocity changes by more than this fraction of the
            largest relative velocity (or of 1 m/s).
        start: `COLD_START` to start from zero impulses, `WARM_START` to apply the impulses in
            `points`, or `RESUME` if the impulses in `points` have been applied already.

    Returns:
        Number of iterations.
    """
    fastest = 1.0
    for k in range(num_points):
        row = points[k]
        write_vec3(row.search_direction, (0.0, 0.0, 0.0))
        row.is_sliding = False
        if start == RESUME:
            continue
        write_vec3(row.rolling_impulse, (0.0, 0.0, 0.0))
        if start == WARM_START:
            velocities = read_velocities(row, motions)
            write_velocities(
                row, motions, _apply_impulse(row, motions, velocities, read_vec3(row.impulse))
            )
        else:
            write_vec3(row.impulse, (0.0, 0.0, 0.0))
    for k in range(num_points):
        slips = compute_relative_velocity(points[k], motions)
        fastest = max(fastest, math.sqrt(dot(slips, slips)))
    work = max(MIN_ROW_UPDATES, int(dt * ROW_UPDATES_PER_SECOND))
    max_iterations = max(MIN_ITERATIONS, min(MAX_ITERATIONS, work // max(1, num_points)))
    before = 0.0
    least = math.inf
    coupled = True
    for iteration in range(max_iterations):
        change = 0.0
        square = 0.0
        further = 0.0
        for k in range(num_points):
            row = points[k]
            _update_row(row, motions, coupled)
            step = read_vec3(row.impulse_change)
            change = max(
                change,
                (abs(step[1]) + abs(step[2])) / row.normal_mass,
                abs(step[0]) / row.normal_mass,
            )
            square += dot(step, step)
            further += dot(step, row.search_direction)
        if change <= tolerance * fastest:
            return iteration + 1
        grows = square > RESTART_GROWTH * least
        # With a coupled solve, the friction of wedged points may diverge
        coupled = coupled and not grows
        if iteration > 0 and iteration + 1 < max_iterations:
            # Reset the search direction after an overshoot
            restart = further < 0.0 or grows
            _step_along_search_direction(
                points, num_points, motions, min(square / before, MAX_MOMENTUM), restart
            )
        before = square
        least = min(least, square)
    return max_iterations


@kernel
def damp_tipping(points: np.ndarray, num_points: int, motions: np.ndarray) -> bool:
    """Damp the angular velocity of bodies about tangential axes at points that carry an impulse.

    Args:
        points: Rows of `CONTACT_POINT`, with the impulses of a pass.
        num_points: Number of points in use.
        motions: (N,) rows of `MOTION`; angular velocities are changed.

    Returns:
        True if any angular velocity was changed.
    """
    acts = False
    for k in range(num_points):
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
        # Implicit in the spin, so that its sign never changes
        inverse_inertia = dot(tipping, apply_inverse_inertia(motions[row.a], tipping)) / square
        if row.b >= 0:
            inverse_inertia += dot(tipping, apply_inverse_inertia(motions[row.b], tipping)) / square
        strength = row.tipping_damping * row.impulse[0]
        strength /= 1.0 + strength * inverse_inertia
        twist = (-strength * tipping[0], -strength * tipping[1], -strength * tipping[2])
        _apply_angular_impulse(motions[row.a], twist, 1.0)
        if row.b >= 0:
            _apply_angular_impulse(motions[row.b], twist, -1.0)
        acts = True
    return acts
