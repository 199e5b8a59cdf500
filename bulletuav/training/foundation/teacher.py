"""Teacher of a quadrotor: a linear-quadratic regulator that knows the airframe.

The regulator commands rotors from the motion of the drone and its rotors' present thrusts. It is
optimal for small deviations from hover, at the rate of the decisions. Kernels sum in a fixed order,
so that gains have the same bits on any x86-64.

States, in body axes: offset from the goal (m), velocity (m/s), x and y of the thrust's direction
in level axes, body rates (rad/s), and the thrust of each rotor less that in hover, as a fraction of
the maximum. Inputs are the actions `rotor` less those in hover.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, kernel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

NUM_STATES = 15
"""Number of states"""
STATE_COSTS = (4.0,) * 3 + (0.5,) * 3 + (0.0,) * 2 + (0.02,) * 3 + (0.0,) * 4
"""Cost of the square of each state; that of the square of each input is 1

Drones reach a goal at 1 m in about 1.5 s. With these costs, teachers succeed in `hover` hard.
"""
REACH = 1.0
"""Largest offset from the goal on each axis; beyond it, drones approach at a constant speed, m"""
MIN_LAG = 1e-3
"""Smallest time constant of the rotors in the model, s"""
NUM_DOUBLINGS = 20
"""Number of doublings of the horizon, from one decision; the gains change no more after about 12"""
HALVINGS, TERMS = 8, 12
"""Halvings of the time step, and terms of the series, of the matrix exponential"""


def linear_model(airframe: Airframe) -> tuple[np.ndarray, np.ndarray]:
    """Return the linear dynamics dx/dt = A x + B u about hover.

    Args:
        airframe: A quadrotor with rotors in the order of `rotor_axes`.

    Returns:
        A (15, 15) and B (15, 4).
    """
    moving, acting = np.zeros((NUM_STATES, NUM_STATES)), np.zeros((NUM_STATES, 4))
    drag = 4 * airframe.hover_speed() / airframe.mass
    lag = max(0.5 * (airframe.lag_up + airframe.lag_down), MIN_LAG)
    most = airframe.max_thrust / 4
    for k in range(3):
        moving[k, 3 + k] = 1.0
        moving[3 + k, 3 + k] = -drag * (airframe.drag_xy if k < 2 else airframe.drag_z)
        moving[8 + k, 8 + k] = -airframe.damping[k]
    for k in range(2):
        moving[3 + k, 6 + k] = STANDARD_GRAVITY
    moving[6, 9], moving[7, 8] = 1.0, -1.0
    for r, (x, y, turn) in enumerate(airframe.rotors):
        rotor = 11 + r
        moving[5, rotor] = most / airframe.mass
        arms = (y, -x, turn * airframe.torque_ratio)
        for k, (arm, inertia) in enumerate(zip(arms, airframe.inertia, strict=True)):
            moving[8 + k, rotor] = arm * most / inertia
        moving[rotor, rotor] = -1.0 / lag
        # An action from -1 to 1 is a fraction of the thrust from 0 to 1
        acting[rotor, r] = 0.5 / lag
    return moving, acting


def teacher_gains(airframe: Airframe, decision_hz: float) -> np.ndarray:
    """Return the gains of the regulator of an airframe.

    Args:
        airframe: A quadrotor with rotors in the order of `rotor_axes`.
        decision_hz: Decisions per second.

    Returns:
        (4, 15) gains K of u = -K x.
    """
    moving, acting = linear_model(airframe)
    gains = np.empty((4, NUM_STATES))
    _solve(moving, acting, 1.0 / decision_hz, np.array(STATE_COSTS), gains)
    return gains


@kernel
def command_teachers(
    seen: np.ndarray,
    rotor_speed: np.ndarray,
    max_rotor_speed: np.ndarray,
    hover: np.ndarray,
    gains: np.ndarray,
    actions: np.ndarray,
) -> None:
    """Write the actions of the teachers of N drones in W worlds.

    Args:
        seen: (W * N, D) observations; the first are the goal's offset, velocity, direction upwards
            and rates, all in body axes.
        rotor_speed: (W, N, 4) rotor speeds, rad/s.
        max_rotor_speed: (N,) maximum rotor speeds, rad/s.
        hover: (N,) thrust in hover as a fraction of the maximum.
        gains: (N, 4, 15) gains.
        actions: (W * N, 4) actions, written.
    """
    drones = len(hover)
    for row in range(len(seen)):
        w, i = row // drones, row % drones
        for r in range(4):
            action = 2.0 * hover[i] - 1.0
            for k in range(3):
                away = -min(max(np.float64(seen[row, k]), -REACH), REACH)
                action -= gains[i, r, k] * away
                action -= gains[i, r, 3 + k] * seen[row, 3 + k]
                action -= gains[i, r, 8 + k] * seen[row, 9 + k]
            for k in range(2):
                action += gains[i, r, 6 + k] * seen[row, 6 + k]
            for k in range(4):
                speed = rotor_speed[w, i, k] / max_rotor_speed[i]
                action -= gains[i, r, 11 + k] * (speed * speed - hover[i])
            actions[row, r] = min(max(action, -1.0), 1.0)


@allocating
def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the product of two matrices, summed in the order of the columns of `a`."""
    result = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                result[i, j] += a[i, k] * b[k, j]
    return result


@allocating
def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve a x = b by Gaussian elimination with partial pivoting; both are overwritten."""
    size, columns = b.shape
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        if best != k:
            for j in range(size):
                a[k, j], a[best, j] = a[best, j], a[k, j]
            for j in range(columns):
                b[k, j], b[best, j] = b[best, j], b[k, j]
        for i in range(k + 1, size):
            factor = a[i, k] / a[k, k]
            for j in range(k, size):
                a[i, j] -= factor * a[k, j]
            for j in range(columns):
                b[i, j] -= factor * b[k, j]
    for k in range(size - 1, -1, -1):
        for j in range(columns):
            for i in range(k + 1, size):
                b[k, j] -= a[k, i] * b[i, j]
            b[k, j] /= a[k, k]
    return b


@allocating
def _discretise(moving: np.ndarray, acting: np.ndarray, dt: float) -> np.ndarray:
    """Return the matrices A and B over a time step, side by side, with inputs that are held."""
    size, inputs = acting.shape
    rate = np.zeros((size + inputs, size + inputs))
    rate[:size, :size] = moving
    rate[:size, size:] = acting
    rate *= dt / 2.0**HALVINGS
    # Taylor series of the exponential of a small step, which is then doubled
    term, result = np.eye(size + inputs), np.eye(size + inputs)
    for k in range(1, TERMS + 1):
        term = _multiply(term, rate) / k
        result += term
    for _ in range(HALVINGS):
        result = _multiply(result, result)
    return result[:size]


@allocating
def _solve(
    moving: np.ndarray, acting: np.ndarray, dt: float, costs: np.ndarray, gains: np.ndarray
) -> None:
    """Write the gains of the regulator with unit costs of the inputs.

    The Riccati equation is solved by doubling.

    References:
        E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Structure-preserving algorithms for periodic
        discrete-time algebraic Riccati equations (2004).

    Args:
        moving: (n, n) A of the continuous dynamics.
        acting: (n, m) B of the continuous dynamics.
        dt: Time step, s.
        costs: (n,) costs of the squares of the states.
        gains: (m, n) written.
    """
    size, inputs = acting.shape
    both = _discretise(moving, acting, dt)
    a, b = np.ascontiguousarray(both[:, :size]), np.ascontiguousarray(both[:, size:])
    step, spread, cost = a.copy(), _multiply(b, b.T), np.diag(costs)
    for _ in range(NUM_DOUBLINGS):
        sides = np.concatenate((step, spread), axis=1)
        solved = _divide(np.eye(size) + _multiply(spread, cost), sides)
        one, other = np.ascontiguousarray(solved[:, :size]), np.ascontiguousarray(solved[:, size:])
        spread = spread + _multiply(_multiply(step, other), step.T)
        cost = cost + _multiply(step.T, _multiply(cost, one))
        step = _multiply(step, one)
    weighted = _multiply(b.T, cost)
    gains[:] = _divide(np.eye(inputs) + _multiply(weighted, b), _multiply(weighted, a))
