"""The wake that drones blow on those below them: a push, and a tip towards its axis."""

import math

import numpy as np

from bulletuav.functions import exp
from bulletuav.geometry.rotation import quat4, to_body
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import rotor_wrench
from bulletuav.vehicle.swarm import Swarm

WAKE_EDGE = 80.0
"""Edge of a wake in squared widths from its axis: beyond, it is below 1e-17 of itself."""


@func
def wake_width_squared(drop: float, row: ParameterRow) -> float:
    """Return the square of a wake's width, s^2 = r^2 + (b drop)^2, m^2.

    Args:
        drop: How far below the rotors, m.
        row: Constants of the upper drone: r is `wake_radius`, b is `wake_spread`.
    """
    spread = row.wake_spread * drop
    return row.wake_radius * row.wake_radius + spread * spread


@func
def is_in_wake(
    horizontal_squared: float,
    drop: float,
    row: ParameterRow,
) -> bool:
    """Tell whether a place is in a drone's wake; see `downwash` for the arguments."""
    if drop <= 0.0 or row.wake_share <= 0.0:
        return False
    return horizontal_squared <= WAKE_EDGE * wake_width_squared(drop, row)


@func
def downwash(
    horizontal_squared: float,
    drop: float,
    thrust: float,
    row: ParameterRow,
) -> tuple[float, float]:
    """Return what a drone's wake does to a drone below: it pushes it, and tips it to the axis.

    The push is F = A T r / s exp(-d^2 / 2 s^2) with s^2 = r^2 + (b drop)^2: a jet of the size of
    the drone that spreads slowly. The torque is a^2 F d / s^2, with the arm a of the lower drone:
    its rotors on the side of the axis are pushed more than the others. Both are fits to pairs of
    Crazyflies (data of G. Shi et al., Neural-Swarm2, T-RO 2021; see docs/truth.md). Other
    airframes have the same A and b, and r grows with their size (our choice).

    Args:
        horizontal_squared: Square of the horizontal distance d from the upper drone, m^2.
        drop: How far the lower drone is below, m; nothing at or above the upper one.
        thrust: Thrust T of the upper drone, N.
        row: Constants of the upper drone: A is `wake_share`.

    Returns:
        The downward force F, N, and F / s^2, N/m^2.
    """
    if not is_in_wake(horizontal_squared, drop, row):
        return 0.0, 0.0
    # 1 / s^2
    narrow = 1.0 / wake_width_squared(drop, row)
    strength = row.wake_share * thrust * row.wake_radius * math.sqrt(narrow)
    push = strength * exp(-0.5 * horizontal_squared * narrow)
    return push, push * narrow


@func
def _blow(
    swarm: Swarm,
    w: int,
    above: int,
    below: int,
    parameters: np.ndarray,
    wake: np.ndarray,
) -> None:
    """Add the wake of drone `above` on drone `below` of world w to `wake` (N, 4)."""
    row = parameters[w, above]
    # From the lower drone to the axis of the wake.
    x = swarm.position[w, above, 0] - swarm.position[w, below, 0]
    y = swarm.position[w, above, 1] - swarm.position[w, below, 1]
    drop = swarm.position[w, above, 2] - swarm.position[w, below, 2]
    if not is_in_wake(x * x + y * y, drop, row):
        return
    thrust = rotor_wrench(swarm.rotor_speed[w, above], 0.0, row)[0]
    push, tip = downwash(x * x + y * y, drop, thrust, row)
    tip *= parameters[w, below].arm * parameters[w, below].arm
    torque = to_body(quat4(swarm.quaternion, w, below), (-tip * y, tip * x, 0.0))
    wake[below, 0] += push
    for k in range(3):
        wake[below, 1 + k] += torque[k]


@func
def _has_company(
    position: np.ndarray,
    w: int,
    i: int,
    edge: float,
) -> bool:
    """Tell whether a drone of higher index is within a squared horizontal distance of drone i."""
    # A sum without branches, which compiles to several pairs at once
    near = 0
    for j in range(i + 1, position.shape[1]):
        dx = position[w, j, 0] - position[w, i, 0]
        dy = position[w, j, 1] - position[w, i, 1]
        near += dx * dx + dy * dy <= edge
    return near > 0


@kernel
def wakes(
    w: int,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
    wake: np.ndarray,
) -> None:
    """Sum the wakes of all living drones of a world on each of them.

    Args:
        w: Index of the world.
        swarm: State of all drones.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        wake: (N, 4) downward force (N) and torque about the body's axes (N m); filled.
    """
    # How far the widest wake of this world reaches: pairs farther apart are passed over.
    lowest = np.inf
    highest = -np.inf
    for i in range(wake.shape[0]):
        for k in range(4):
            wake[i, k] = 0.0
        if alive[w, i]:
            lowest = min(lowest, swarm.position[w, i, 2])
            highest = max(highest, swarm.position[w, i, 2])
    widest = 0.0
    for i in range(wake.shape[0]):
        if alive[w, i] and parameters[w, i].wake_share > 0.0:
            widest = max(widest, wake_width_squared(highest - lowest, parameters[w, i]))
    edge = WAKE_EDGE * widest
    # Of each pair the upper drone blows on the lower one.
    for i in range(wake.shape[0]):
        if not alive[w, i] or not _has_company(swarm.position, w, i, edge):
            continue
        for j in range(i + 1, wake.shape[0]):
            dx = swarm.position[w, j, 0] - swarm.position[w, i, 0]
            dy = swarm.position[w, j, 1] - swarm.position[w, i, 1]
            if dx * dx + dy * dy <= edge and alive[w, j]:
                if swarm.position[w, j, 2] > swarm.position[w, i, 2]:
                    _blow(swarm, w, j, i, parameters, wake)
                else:
                    _blow(swarm, w, i, j, parameters, wake)
