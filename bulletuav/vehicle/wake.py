"""The wake of a drone on drones below it (downwash): a force and a torque towards its axis."""

import math

from bulletuav.compiled.functions import moderate_exp
from bulletuav.compiled.kernel import func
from bulletuav.vehicle.parameters import ParameterRow

WAKE_EDGE = 80.0
"""Squared distance from the axis, in squared widths, beyond which the wake is neglected: it is
below 1e-17 of its maximum there.
"""


@func
def wake_width_squared(drop: float, row: ParameterRow) -> float:
    """Return the squared width of a wake, s^2 = r^2 + (b drop)^2, m^2.

    Args:
        drop: Distance below the rotors, m.
        row: Constants of the upper drone: r is `wake_radius`, b is `wake_spread`.
    """
    spread = row.wake_spread * drop
    return row.wake_radius * row.wake_radius + spread * spread


@func
def is_in_wake(horizontal_squared: float, drop: float, row: ParameterRow) -> bool:
    """Return True if a position is in a drone's wake; see `downwash` for the arguments."""
    if drop <= 0.0 or row.wake_share <= 0.0:
        return False
    return horizontal_squared <= WAKE_EDGE * wake_width_squared(drop, row)


@func
def downwash(
    horizontal_squared: float, drop: float, thrust: float, row: ParameterRow
) -> tuple[float, float]:
    """Compute the downward force of a drone's wake on a drone below, and the factor of its torque.

    The force is F = A T r / s exp(-d^2 / 2 s^2) with s^2 = r^2 + (b drop)^2: a jet of the size of
    the drone that spreads slowly. The torque towards the axis is a^2 F d / s^2, with the arm a of
    the lower
    drone: rotors on the side of the axis are pushed more than the others. Both are fits to pairs of
    Crazyflies (see docs/explanation/truth.md). Other airframes have the same A and b; r scales with
    their size (our choice).

    Args:
        horizontal_squared: Squared horizontal distance d from the upper drone, m^2.
        drop: Distance of the lower drone below the upper one, m; the wake is 0 if it is 0 or less.
        thrust: Thrust T of the upper drone, N.
        row: Constants of the upper drone: A is `wake_share`.

    Returns:
        The downward force F, N, and F / s^2, N/m^2.

    References:
        G. Shi et al., Neural-Swarm2 (T-RO 2021), for the data.
    """
    if not is_in_wake(horizontal_squared, drop, row):
        return 0.0, 0.0
    strength = row.wake_share * thrust * row.wake_radius
    return jet(horizontal_squared, wake_width_squared(drop, row), strength)


@func
def jet(horizontal_squared: float, width_squared: float, strength: float) -> tuple[float, float]:
    """Compute `downwash` inside the edge of a wake, of one drone or in lanes of several.

    Args:
        horizontal_squared: See `downwash`.
        width_squared: Result of `wake_width_squared`.
        strength: A T r, N m.

    Returns:
        The same as `downwash`.
    """
    # 1 / s^2
    narrow = 1.0 / width_squared
    push = strength * math.sqrt(narrow) * moderate_exp(-0.5 * horizontal_squared * narrow)
    return push, push * narrow
