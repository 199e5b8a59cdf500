"""Tensions of the cables of one group of bodies, by the equations of constrained motion.

Of each taut cable the distance d of its ends must not grow. With the Jacobian J of the distances,
the mass matrix M and the accelerations u' without tensions T, that is a linear complementarity
problem, whose matrix is symmetric and positive definite:

    J M^-1 J^T T - (J u' + bend) >= 0,  T >= 0,  and in each row one of both is 0,

where the term `bend` has the products of velocities. The same matrix yields the impulses of cables
that become taut (from the rates of the distances), and corrections of positions (from their excess
over the lengths).

The cables of a group are measured in SIMD lanes, in which also the rows of the matrix are computed.

References:
    D. Baraff, Fast contact force computation for nonpenetrating rigid bodies, SIGGRAPH 1994.
    K. G. Murty, Note on a Bard-type scheme for solving the complementarity problem, Opsearch 1974
        (the pivoting rule of the least index).
"""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.gather import gathered_at
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, is_any, lanes_of, where
from bulletuav.dynamics.cables import WORLD
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    axes,
    cross,
    dot,
    minus,
    normalise_quaternion,
    plus,
    product,
)

REGULARISATION = 1e-10
"""Relative increase of the matrix's diagonal: cables may be parallel, and share their ends"""
MAX_BLOCK_PIVOTS = 3
"""Number of solutions in which all wrong signs are corrected together, not only the first"""
SMALL = 1e-7
"""Error of a length that one correction removes, m"""
MIN_REACH = 1e-9
"""Distance of the ends below which a cable has no direction, m"""

POSITION, VELOCITY, RATES, QUATERNION = 0, 3, 6, 9
"""First numbers of the parts of a state in `CableWork.now`"""


@func
def num_cables(cables: Any, w: int, g: int) -> int:
    """Return the number of cables of a group, slack ones included."""
    return int(cables.first_cable[w, g + 1] - cables.first_cable[w, g])


@func
def _three_at(array: np.ndarray, work: Any, end: int, first: int) -> Vec3:
    """Return three numbers of the bodies at one end of cables as lanes."""
    return (
        gathered_at(array, work.ends, end, first * WIDTH),
        gathered_at(array, work.ends, end, (first + 1) * WIDTH),
        gathered_at(array, work.ends, end, (first + 2) * WIDTH),
    )


@func
def _quaternion_at(work: Any, end: int) -> Quat4:
    """Return the quaternions of the bodies at one end of cables as lanes."""
    x, y, z = _three_at(work.now, work, end, QUATERNION)
    return x, y, z, gathered_at(work.now, work.ends, end, (QUATERNION + 3) * WIDTH)


@func
def _rotate(turned: tuple[Vec3, Vec3, Vec3], v: Vec3) -> Vec3:
    """Rotate a vector from the axes of a body into world axes."""
    still = (0.0, 0.0, 0.0)
    return plus(plus(plus(still, v[0], turned[0]), v[1], turned[1]), v[2], turned[2])


@func
def _move_end(
    work: Any, end: int, at: Vec3, turned: tuple[Vec3, Vec3, Vec3]
) -> tuple[Vec3, Vec3, Vec3]:
    """Return the motion of cables' ends: place, velocity, and acceleration by the rotation alone.

    Args:
        work: `CableWork` with the state in `now`.
        end: Row of `ends`.
        at: The ends in the axes of their bodies, m.
        turned: Axes of the bodies.
    """
    rates = _three_at(work.now, work, end, RATES)
    turning = cross(rates, at)
    place = plus(_three_at(work.now, work, end, POSITION), 1.0, _rotate(turned, at))
    velocity = plus(_three_at(work.now, work, end, VELOCITY), 1.0, _rotate(turned, turning))
    return place, velocity, _rotate(turned, cross(rates, turning))


@func
def _set_push(work: Any, end: int, at: Vec3, along: Vec3, turned: tuple[Vec3, Vec3, Vec3]) -> None:
    """Write the wrenches on the bodies at one end of cables per tension, and their effect."""
    ahead, left, up = turned
    # Torque in body axes
    twist = cross(at, (dot(ahead, along), dot(left, along), dot(up, along)))
    held = lanes_of(work.held, end)
    lightness, x, y, z = held[3], held[4], held[5], held[6]
    push, response = lanes_of(work.push, end), lanes_of(work.response, end)
    for k in range(3):
        push[k] = along[k]
        push[3 + k] = twist[k]
        response[k] = lightness * along[k]
    response[3] = x * twist[0]
    response[4] = y * twist[1]
    response[5] = z * twist[2]


@kernel
def measure_cables(work: Any, size: int) -> None:
    """Measure the distances of the ends of cables, their derivatives and their Jacobian.

    Args:
        work: `CableWork` with the state of the bodies in `now`.
        size: Number of cables.
    """
    for b in range((size + WIDTH - 1) // WIDTH):
        one, two = 2 * b, 2 * b + 1
        held, other = lanes_of(work.held, one), lanes_of(work.held, two)
        here, there = (held[0], held[1], held[2]), (other[0], other[1], other[2])
        # For fixed ends those of the world
        turned, away = axes(_quaternion_at(work, one)), axes(_quaternion_at(work, two))
        begin, moving, bending = _move_end(work, one, here, turned)
        end, carried, turning = _move_end(work, two, there, away)
        apart, drift = minus(begin, end), minus(moving, carried)
        reach = math.sqrt(dot(apart, apart))
        least = max(reach, MIN_REACH)
        is_apart = reach > MIN_REACH
        along = (
            where(is_apart, apart[0] / least, 0.0),
            where(is_apart, apart[1] / least, 0.0),
            where(is_apart, apart[2] / least, 1.0),
        )
        rate = dot(along, drift)
        # Rotation of the cable itself, and of both ends about the centres of mass
        spread = (dot(drift, drift) - rate * rate) / least
        measured = lanes_of(work.measured, b)
        measured[0] = reach
        measured[1] = rate
        measured[2] = spread + dot(along, minus(bending, turning))
        _set_push(work, one, here, (-along[0], -along[1], -along[2]), turned)
        _set_push(work, two, there, along, away)


@kernel
def pack_cables(cables: Any, parameters: np.ndarray, w: int, g: int) -> None:
    """Write what is constant of a group's cables to lanes.

    Args:
        cables: `Cables` with the bodies that do not move in `work.is_fixed`.
        parameters: (W, N) rows of `PARAMETERS`.
        w: Index of the world.
        g: Index of the group.
    """
    work, first, size = cables.work, cables.first_cable[w, g], num_cables(cables, w, g)
    held, number, world = work.held, work.number, work.now.shape[0] - 1
    for s in range((size + WIDTH - 1) // WIDTH * WIDTH):
        # Lanes after the last cable repeat it, without bodies
        c = cables.cable[w, first + min(s, size - 1)]
        for end in range(2):
            row, lane = 2 * (s // WIDTH) + end, s % WIDTH
            body = cables.body[w, c, end] if s < size else WORLD
            i = max(body, 0)
            block, moves = i // WIDTH if body >= 0 else world, body >= 0 and not work.is_fixed[i]
            record = parameters[w, i]
            held[row, 3, lane] = record.mass if moves else np.inf
            for k in range(3):
                held[row, k, lane] = cables.point[w, c, end, k]
                held[row, 4 + k, lane] = record.inertia[k] if moves else np.inf
            number[row, 0, lane] = body
            work.ends[row, lane] = block * work.now.shape[1] * WIDTH + i % WIDTH
    for row in range((size + WIDTH - 1) // WIDTH * 2):
        masses = lanes_of(held, row)
        for k in range(3, 7):
            masses[k] = 1.0 / masses[k]


@func
def get_excess(cables: Any, w: int, g: int, s: int) -> float:
    """Return the measured distance of the ends of a group's cable s beyond its length, m."""
    c = cables.cable[w, cables.first_cable[w, g] + s]
    return float(cables.work.measured[s // WIDTH, 0, s % WIDTH] - cables.length[w, c])


@func
def get_rate(work: Any, s: int) -> float:
    """Return the measured rate of the distance of a group's cable s, m/s."""
    return float(work.measured[s // WIDTH, 1, s % WIDTH])


@func
def _couple(push: Any, response: np.ndarray, end: int, lane: int) -> Any:
    """Return the products of the wrenches of cables at one end with the response of another."""
    total = push[0] * response[end, 0, lane]
    for k in range(1, 6):
        total += push[k] * response[end, k, lane]
    return total


@kernel
def _fill_matrix(work: Any, size: int) -> None:
    """Compute the second derivatives of the distances by the tensions.

    Two cables are coupled if they have a body in common. Only the lower triangle is valid.
    """
    response, matrix, number = work.response, work.matrix, work.number
    for j in range(size):
        column, lane = lanes_of(work.columns, j), j % WIDTH
        for b in range(j // WIDTH, (size + WIDTH - 1) // WIDTH):
            column[b] = 0.0
            for at in range(2):
                other = 2 * (j // WIDTH) + at
                body = number[other, 0, lane]
                for end in range(2):
                    is_same = lanes_of(number, 2 * b + end)[0] == body
                    if body >= 0.0 and is_any(is_same):
                        both = _couple(lanes_of(work.push, 2 * b + end), response, other, lane)
                        column[b] = where(is_same, column[b] + both, column[b])
        matrix[j, j] *= 1.0 + REGULARISATION
        # Neither end of the cable moves
        if matrix[j, j] <= 0.0:
            work.pulls[j] = False
        work.acts[j] = work.listed[j] and work.pulls[j]


@kernel
def _solve(work: Any, size: int, count: int) -> None:
    """Solve the equations of the cables that pull for `count` right-hand sides, by L D L^T.

    The factor L is below the diagonal, the reciprocals of D on it, and L D transposed above it.
    Rows of other cables are those of the identity matrix, and their results are 0.
    """
    matrix, factor, acts = work.matrix, work.factor, work.acts
    found, wanted = work.found, work.wanted
    for i in range(size):
        block, lane, any_pull = i // WIDTH, i % WIDTH, acts[i]
        pivot = matrix[i, i] if any_pull else 1.0
        for j in range(i):
            total = matrix[j, i] if any_pull and acts[j] else 0.0
            for k in range(j):
                total -= factor[k, i] * factor[j, k]
            factor[j, i] = total
            factor[i, j] = total * factor[j, j]
            pivot -= total * factor[i, j]
        # Rounding may make the pivot of parallel cables negative
        least = REGULARISATION * matrix[i, i] if any_pull else 1.0
        factor[i, i] = 1.0 / max(pivot, least)
        for r in range(count):
            total = wanted[r, block, lane] if any_pull else 0.0
            for k in range(i):
                total -= factor[i, k] * found[r, k]
            found[r, i] = total
    for back in range(size):
        i = size - 1 - back
        for r in range(count):
            total = found[r, i] * factor[i, i]
            for k in range(i + 1, size):
                total -= factor[k, i] * found[r, k]
            found[r, i] = total


@func
def _compute_residual(work: Any, size: int, i: int) -> float:
    """Return row i of matrix times solution minus right-hand side."""
    total = -work.wanted[0, i // WIDTH, i % WIDTH]
    for k in range(size):
        total += work.matrix[min(i, k), max(i, k)] * work.found[0, k]
    return float(total)


@func
def _flip_wrong_signs(work: Any, size: int, only_first: bool) -> bool:
    """Exchange the cables whose tension or residual is negative; return True if there is one."""
    any_wrong = False
    for i in range(size):
        if work.acts[i]:
            wrong = work.found[0, i] < 0.0
        else:
            # A fixed cable cannot change its distance
            can_act = work.listed[i] and work.matrix[i, i] > 0.0
            wrong = can_act and _compute_residual(work, size, i) < 0.0
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
            _solve(work, size, 1)
            is_solved = not _flip_wrong_signs(work, size, trial >= MAX_BLOCK_PIVOTS)
    for i in range(size):
        work.found[0, i] = max(work.found[0, i], 0.0)
        if work.listed[i]:
            work.pulls[i] = work.acts[i]


@func
def _accelerate(cables: Any, moved: np.ndarray, w: int, g: int, size: int, r: int) -> None:
    """Add the responses to solution r to the velocities and rates of `moved`."""
    work, first = cables.work, cables.first_cable[w, g]
    for i in range(size):
        if work.acts[i]:
            c, tension = cables.cable[w, first + i], work.found[r, i]
            for end in range(2):
                body, row = cables.body[w, c, end], 2 * (i // WIDTH) + end
                if body >= 0:
                    b, lane = body // WIDTH, body % WIDTH
                    for k in range(6):
                        change = tension * work.response[row, k, i % WIDTH]
                        moved[b, VELOCITY + k, lane] += change


@func
def _list_taut(cables: Any, w: int, g: int, size: int) -> bool:
    """List the taut cables of a group; return True if there is one."""
    work, any_taut = cables.work, False
    for s in range(size):
        work.listed[s] = cables.is_taut[w, cables.cable[w, cables.first_cable[w, g] + s]]
        any_taut = any_taut or work.listed[s]
    return any_taut


@kernel
def add_tensions(cables: Any, w: int, g: int, weight: float) -> None:
    """Add the accelerations by the tensions of a group's taut cables to the slopes of its bodies.

    Args:
        cables: `Cables`, with the state and the slopes of the bodies in `work`.
        w: Index of the world.
        g: Index of the group.
        weight: Time by which the tensions are multiplied in `work.pull`, s.
    """
    work, size = cables.work, num_cables(cables, w, g)
    if not _list_taut(cables, w, g, size):
        return
    measure_cables(work, size)
    right = lanes_of(work.wanted, 0)
    for b in range((size + WIDTH - 1) // WIDTH):
        wanted = lanes_of(work.measured, b)[2]
        for end in range(2 * b, 2 * b + 2):
            push = lanes_of(work.push, end)
            pull = _three_at(work.slope, work, end, VELOCITY)
            spinning = _three_at(work.slope, work, end, RATES)
            for k in range(3):
                wanted -= push[k] * pull[k]
                wanted -= push[3 + k] * spinning[k]
        right[b] = wanted
    _fill_matrix(work, size)
    _solve_complementarity(work, size)
    for s in range(size):
        if work.acts[s]:
            work.pull[s] += weight * work.found[0, s]
    _accelerate(cables, work.slope, w, g, size, 0)


@kernel
def apply_impulses(cables: Any, w: int, g: int) -> None:
    """Stop the growth of the distances of a group's taut cables by impulses, without rebound.

    The kinetic energy does not grow: the impulses are the projection of the velocities onto those
    that the cables allow.

    Args:
        cables: `Cables`; the velocities and rates in `work.now` are changed, and the impulses are
            added to `work.pull`.
        w: Index of the world.
        g: Index of the group.
    """
    work, size = cables.work, num_cables(cables, w, g)
    if not _list_taut(cables, w, g, size):
        return
    measure_cables(work, size)
    _set_rates(work, size, 0)
    _fill_matrix(work, size)
    _solve_complementarity(work, size)
    for s in range(size):
        if work.acts[s]:
            work.pull[s] += work.found[0, s]
    _accelerate(cables, work.now, w, g, size, 0)


@func
def _set_rates(work: Any, size: int, r: int) -> None:
    """Set right-hand side r to the rates of the distances."""
    right = lanes_of(work.wanted, r)
    for b in range((size + WIDTH - 1) // WIDTH):
        right[b] = lanes_of(work.measured, b)[1]


@func
def _shift_bodies(cables: Any, w: int, g: int, size: int) -> None:
    """Move and turn the bodies of a group by the responses to the solution.

    `work.slope` has the sums of the corrections.
    """
    work = cables.work
    for b in range(work.is_used.shape[0]):
        shift = lanes_of(work.slope, b)
        for k in range(VELOCITY, QUATERNION):
            shift[k] = 0.0
    _accelerate(cables, work.slope, w, g, size, 0)
    for b in range(work.is_used.shape[0]):
        if not work.is_used[b]:
            continue
        shift, now = lanes_of(work.slope, b), lanes_of(work.now, b)
        turn = (0.5 * shift[6], 0.5 * shift[7], 0.5 * shift[8], 1.0)
        turned = normalise_quaternion(product((now[9], now[10], now[11], now[12]), turn))
        for k in range(3):
            now[POSITION + k] += shift[VELOCITY + k]
        for k in range(4):
            now[QUATERNION + k] = turned[k]


@kernel
def correct_lengths(cables: Any, w: int, g: int, is_drift: bool, max_iterations: int) -> None:
    """Correct the lengths of a group's taut cables that pull.

    The corrections of positions are Newton's, weighted by the masses: the centre of mass of free
    bodies stays. The correction of rates is a projection of the velocities, which loses energy.

    Args:
        cables: `Cables`; the state in `work.now` is changed.
        w: Index of the world.
        g: Index of the group.
        is_drift: True if the errors are those of integration: the cables were measured, and their
            rates are corrected, too.
        max_iterations: Maximum number of corrections.
    """
    work, size, first = cables.work, num_cables(cables, w, g), cables.first_cable[w, g]
    for k in range(max_iterations):
        if k > 0 or not is_drift:
            measure_cables(work, size)
        worst, any_listed = 0.0, False
        for s in range(size):
            work.listed[s] = cables.is_taut[w, cables.cable[w, first + s]] and work.pulls[s]
            if work.listed[s]:
                excess = get_excess(cables, w, g, s)
                work.wanted[0, s // WIDTH, s % WIDTH] = excess
                worst, any_listed = max(worst, abs(excess)), True
        if not any_listed:
            return
        _set_rates(work, size, 1)
        _fill_matrix(work, size)
        _solve(work, size, 2)
        _shift_bodies(cables, w, g, size)
        # Newton's method converges quadratically, and the directions of the cables hardly change
        if worst <= SMALL:
            if is_drift:
                _accelerate(cables, work.now, w, g, size, 1)
            return
