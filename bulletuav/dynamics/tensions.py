"""Tensions of the cables of one group of bodies, by the equations of constrained motion.

Of each taut cable the distance d of its ends must not grow. With the Jacobian J of the distances,
the mass matrix M and the accelerations u' without tensions T, that is a linear complementarity
problem, whose matrix is symmetric and positive definite:

    J M^-1 J^T T - (J u' + bend) >= 0,  T >= 0,  and in each row one of both is 0,

where the term `bend` has the products of velocities. The same matrix yields the impulses of cables
that become taut (from the rates of the distances), and corrections of positions (from their excess
over the lengths).

References:
    D. Baraff, Fast contact force computation for nonpenetrating rigid bodies, SIGGRAPH 1994.
    K. G. Murty, Note on a Bard-type scheme for solving the complementarity problem, Opsearch 1974
        (the pivoting rule of the least index).
"""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import (
    Vec3,
    axes,
    cross,
    dot,
    minus,
    normalise_quaternion,
    plus,
    product,
    quat4,
    vec3,
)

REGULARISATION = 1e-10
"""Relative increase of the matrix's diagonal: cables may be parallel, and share their ends"""
MAX_BLOCK_PIVOTS = 3
"""Number of solutions in which all wrong signs are corrected together, not only the first"""
SMALL = 1e-7
"""Error of a length that one correction removes, m"""
MIN_REACH = 1e-9
"""Distance of the ends below which a cable has no direction, m"""
STILL = (0.0, 0.0, 0.0)
"""Velocity of a fixed end"""


@func
def _move_end(
    now: Any, body: int, at: Vec3, turned: tuple[Vec3, Vec3, Vec3]
) -> tuple[Vec3, Vec3, Vec3]:
    """Return the motion of a cable's end: place, velocity, and acceleration by the rotation alone.

    Args:
        now: `Swarm` with the state.
        body: Index of the body; `WORLD` for a fixed end.
        at: The end in the axes of its body, or in the world, m.
        turned: Axes of the body.
    """
    if body < 0:
        return at, STILL, STILL
    rates = vec3(now.rates, 0, body)
    turning = cross(rates, at)
    place = plus(vec3(now.position, 0, body), 1.0, _rotate(turned, at))
    velocity = plus(vec3(now.velocity, 0, body), 1.0, _rotate(turned, turning))
    return place, velocity, _rotate(turned, cross(rates, turning))


@func
def _rotate(turned: tuple[Vec3, Vec3, Vec3], v: Vec3) -> Vec3:
    """Rotate a vector from the axes of a body into world axes."""
    return plus(plus(plus(STILL, v[0], turned[0]), v[1], turned[1]), v[2], turned[2])


@func
def _axes_of(now: Any, body: int) -> tuple[Vec3, Vec3, Vec3]:
    """Return the axes of a body in the world; those of the first body for a fixed end."""
    return axes(quat4(now.quaternion, 0, max(body, 0)))


@func
def _twist(at: Vec3, along: Vec3, turned: tuple[Vec3, Vec3, Vec3]) -> Vec3:
    """Return the torque in body axes of a unit force along a direction of the world."""
    ahead, left, up = turned
    return cross(at, (dot(ahead, along), dot(left, along), dot(up, along)))


@func
def _set_push(
    work: Any, c: int, end: int, body: int, row: np.record, along: Vec3, twist: Vec3
) -> None:
    """Write the wrench on the body at one end of a cable per tension, and its effect."""
    push, response = work.push, work.response
    moves = body >= 0 and not work.is_fixed[max(body, 0)]
    lightness = 1.0 / row.mass if moves else 0.0
    ease = 1.0 if moves else 0.0
    x, y, z = ease / row.inertia[0], ease / row.inertia[1], ease / row.inertia[2]
    for k in range(3):
        push[c, end, k], push[c, end, 3 + k] = along[k], twist[k]
        response[c, end, k] = lightness * along[k]
    response[c, end, 3] = x * twist[0]
    response[c, end, 4] = y * twist[1]
    response[c, end, 5] = z * twist[2]


@kernel
def measure_cable(cables: Any, parameters: np.ndarray, w: int, c: int) -> None:
    """Measure the distance of the ends of a cable, its derivatives and its Jacobian.

    Args:
        cables: `Cables`, with the state of the bodies in `work.now`.
        parameters: (W, N) rows of `PARAMETERS`.
        w: Index of the world.
        c: Index of the cable.
    """
    work, point = cables.work, cables.point
    now, one, two = work.now, cables.body[w, c, 0], cables.body[w, c, 1]
    # All is read before anything is written: the compiler must assume that writes may alias
    here = (point[w, c, 0, 0], point[w, c, 0, 1], point[w, c, 0, 2])
    there = (point[w, c, 1, 0], point[w, c, 1, 1], point[w, c, 1, 2])
    turned, other = _axes_of(now, one), _axes_of(now, two)
    begin, moving, bending = _move_end(now, one, here, turned)
    end, carried, turning = _move_end(now, two, there, other)
    apart, drift = minus(begin, end), minus(moving, carried)
    reach = math.sqrt(dot(apart, apart))
    along = (0.0, 0.0, 1.0)
    if reach > MIN_REACH:
        along = (apart[0] / reach, apart[1] / reach, apart[2] / reach)
    back = (-along[0], -along[1], -along[2])
    rate = dot(along, drift)
    # Rotation of the cable itself, and of both ends about the centres of mass
    spread = (dot(drift, drift) - rate * rate) / max(reach, MIN_REACH)
    bend = spread + dot(along, minus(bending, turning))
    work.reach[c], work.rate[c], work.bend[c] = reach, rate, bend
    _set_push(work, c, 0, one, parameters[w, max(one, 0)], back, _twist(here, back, turned))
    _set_push(work, c, 1, two, parameters[w, max(two, 0)], along, _twist(there, along, other))


@func
def _couple(push: np.ndarray, response: np.ndarray, one: int, end: int, two: int, at: int) -> float:
    """Return the product of the wrench of a cable at one end with the response of another."""
    total = 0.0
    for k in range(6):
        total += push[one, end, k] * response[two, at, k]
    return total


@kernel
def _fill_matrix(cables: Any, w: int, size: int) -> None:
    """Compute the second derivatives of the distances by the tensions of the listed cables.

    Two cables are coupled if they have a body in common. Only the lower triangle is written.
    """
    work, body = cables.work, cables.body
    push, response, matrix, listed = work.push, work.response, work.matrix, work.listed
    for i in range(size):
        one = listed[i]
        here, there = body[w, one, 0], body[w, one, 1]
        for j in range(i + 1):
            two = listed[j]
            total = 0.0
            for at in range(2):
                other = body[w, two, at]
                if other >= 0 and other == here:
                    total += _couple(push, response, one, 0, two, at)
                if other >= 0 and other == there:
                    total += _couple(push, response, one, 1, two, at)
            matrix[i, j] = total
        matrix[i, i] *= 1.0 + REGULARISATION
        # Neither end of the cable moves
        if matrix[i, i] <= 0.0:
            work.pulls[one] = False
        work.acts[i] = work.pulls[one]


@kernel
def _factorise(work: Any, size: int) -> None:
    """Compute the Cholesky factor of the matrix, restricted to the cables that pull.

    The diagonal has the reciprocals. Rows of other cables are those of the identity matrix.
    """
    matrix, factor, acts = work.matrix, work.factor, work.acts
    for i in range(size):
        if not acts[i]:
            for j in range(i):
                factor[i, j] = 0.0
            factor[i, i] = 1.0
            continue
        for j in range(i):
            total = matrix[i, j] if acts[j] else 0.0
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = total * factor[j, j]
        total = matrix[i, i]
        for k in range(i):
            total -= factor[i, k] * factor[i, k]
        # Rounding may make the pivot of parallel cables negative
        factor[i, i] = 1.0 / math.sqrt(max(total, REGULARISATION * matrix[i, i]))


@kernel
def _substitute(work: Any, size: int) -> None:
    """Solve the factorised system; the results of cables that do not pull are 0."""
    factor, found, wanted, acts = work.factor, work.found, work.wanted, work.acts
    for i in range(size):
        total = wanted[i] if acts[i] else 0.0
        for k in range(i):
            total -= factor[i, k] * found[k]
        found[i] = total * factor[i, i]
    for back in range(size):
        i = size - 1 - back
        total = found[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * found[k]
        found[i] = total * factor[i, i]


@func
def _compute_residual(work: Any, size: int, i: int) -> float:
    """Return row i of matrix times solution minus right-hand side."""
    total = -work.wanted[i]
    for k in range(size):
        total += work.matrix[max(i, k), min(i, k)] * work.found[k]
    return float(total)


@func
def _flip_wrong_signs(work: Any, size: int, only_first: bool) -> bool:
    """Exchange the cables whose tension or residual is negative; return True if there is one."""
    any_wrong = False
    for i in range(size):
        if work.acts[i]:
            wrong = work.found[i] < 0.0
        else:
            # A fixed cable cannot change its distance
            wrong = work.matrix[i, i] > 0.0 and _compute_residual(work, size, i) < 0.0
        if wrong and not (only_first and any_wrong):
            work.acts[i] = not work.acts[i]
            any_wrong = True
    return any_wrong


@kernel
def _solve_complementarity(work: Any, size: int) -> None:
    """Solve the complementarity problem; `work.acts` is the first guess, and the result."""
    # The rule of the least index ends after finitely many steps; few cables are exchanged in flight
    is_solved = False
    for trial in range(MAX_BLOCK_PIVOTS + 8 * (size + 1)):
        if not is_solved:
            _factorise(work, size)
            _substitute(work, size)
            is_solved = not _flip_wrong_signs(work, size, trial >= MAX_BLOCK_PIVOTS)
    for i in range(size):
        work.found[i] = max(work.found[i], 0.0)
        work.pulls[work.listed[i]] = work.acts[i]


@func
def _accelerate(cables: Any, moved: Any, w: int, size: int) -> None:
    """Add the responses to the solution to the velocities and rates of `moved`."""
    work, bodies, velocity, rates = cables.work, cables.body, moved.velocity, moved.rates
    listed, found, response = work.listed, work.found, work.response
    for i in range(size):
        c, tension = listed[i], found[i]
        for end in range(2):
            body = bodies[w, c, end]
            if body >= 0:
                for k in range(3):
                    velocity[0, body, k] += tension * response[c, end, k]
                    rates[0, body, k] += tension * response[c, end, 3 + k]


@kernel
def add_tensions(cables: Any, parameters: np.ndarray, w: int, g: int, weight: float) -> None:
    """Add the accelerations by the tensions of a group's taut cables to the slopes of its bodies.

    Args:
        cables: `Cables`, with the state and the slopes of the bodies in `work`.
        parameters: (W, N) rows of `PARAMETERS`.
        w: Index of the world.
        g: Index of the group.
        weight: Time by which the tensions are multiplied in `work.pull`, s.
    """
    work = cables.work
    size = 0
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        if not cables.is_taut[w, c]:
            continue
        measure_cable(cables, parameters, w, c)
        wanted, push = work.bend[c], work.push
        for end in range(2):
            body = cables.body[w, c, end]
            if body >= 0:
                pull, spinning = vec3(work.slope.velocity, 0, body), vec3(work.slope.rates, 0, body)
                for k in range(3):
                    wanted -= push[c, end, k] * pull[k]
                    wanted -= push[c, end, 3 + k] * spinning[k]
        work.listed[size], work.wanted[size] = c, wanted
        size += 1
    if size == 0:
        return
    _fill_matrix(cables, w, size)
    _solve_complementarity(work, size)
    for i in range(size):
        work.pull[work.listed[i]] += weight * work.found[i]
    _accelerate(cables, work.slope, w, size)


@kernel
def apply_impulses(cables: Any, parameters: np.ndarray, w: int, g: int) -> None:
    """Stop the growth of the distances of a group's taut cables by impulses, without rebound.

    The kinetic energy does not grow: the impulses are the projection of the velocities onto those
    that the cables allow.

    Args:
        cables: `Cables`; the velocities and rates in `work.now` are changed, and the impulses are
            added to `work.pull`.
        parameters: (W, N) rows of `PARAMETERS`.
        w: Index of the world.
        g: Index of the group.
    """
    work = cables.work
    size = 0
    for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
        c = cables.cable[w, m]
        if cables.is_taut[w, c]:
            measure_cable(cables, parameters, w, c)
            work.listed[size], work.wanted[size] = c, work.rate[c]
            size += 1
    if size == 0:
        return
    _fill_matrix(cables, w, size)
    _solve_complementarity(work, size)
    for i in range(size):
        work.pull[work.listed[i]] += work.found[i]
    _accelerate(cables, work.now, w, size)


@func
def _shift_body(now: Any, body: int, size: float, response: np.ndarray) -> None:
    """Move and turn a body by a correction along a response."""
    x, y, z, w = quat4(now.quaternion, 0, body)
    half = 0.5 * size
    turn = (half * response[3], half * response[4], half * response[5], 1.0)
    turned = normalise_quaternion(product((x, y, z, w), turn))
    for k in range(3):
        now.position[0, body, k] += size * response[k]
    for k in range(4):
        now.quaternion[0, body, k] = turned[k]


@kernel
def correct_lengths(
    cables: Any, parameters: np.ndarray, w: int, g: int, is_drift: bool, max_iterations: int
) -> None:
    """Correct the lengths of a group's taut cables that pull.

    The corrections of positions are Newton's, weighted by the masses: the centre of mass of free
    bodies stays. The correction of rates is a projection of the velocities, which loses energy.

    Args:
        cables: `Cables`; the state in `work.now` is changed.
        parameters: (W, N) rows of `PARAMETERS`.
        w: Index of the world.
        g: Index of the group.
        is_drift: True if the errors are those of integration: the cables were measured, and their
            rates are corrected, too.
        max_iterations: Maximum number of corrections.
    """
    work = cables.work
    for k in range(max_iterations):
        size, worst = 0, 0.0
        for m in range(cables.first_cable[w, g], cables.first_cable[w, g + 1]):
            c = cables.cable[w, m]
            if cables.is_taut[w, c] and work.pulls[c]:
                if k > 0 or not is_drift:
                    measure_cable(cables, parameters, w, c)
                excess = work.reach[c] - cables.length[w, c]
                worst = max(worst, abs(excess))
                work.listed[size], work.wanted[size] = c, excess
                size += 1
        if size == 0:
            return
        _fill_matrix(cables, w, size)
        _factorise(work, size)
        _substitute(work, size)
        for i in range(size):
            c = work.listed[i]
            for end in range(2):
                body = cables.body[w, c, end]
                if body >= 0:
                    _shift_body(work.now, body, work.found[i], work.response[c, end])
            work.wanted[i] = work.rate[c]
        # Newton's method converges quadratically, and the directions of the cables hardly change
        if worst <= SMALL:
            if is_drift:
                _substitute(work, size)
                _accelerate(cables, work.now, w, size)
            return
