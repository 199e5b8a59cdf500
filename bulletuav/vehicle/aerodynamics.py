"""Aerodynamic forces on one drone as compiled functions."""

import math

import numpy as np

from bulletuav.functions import exp
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, to_body, to_world
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.parameters import ParameterRow

WAKE_EDGE = 80.0
"""Edge of a wake in squared widths from its axis: beyond, it is below 1e-17 of itself."""


@func
def rotor_drag(
    quaternion: Quat4Like, air_velocity: Vec3Like, total_speed: float, row: ParameterRow
) -> Vec3:
    """Return the drag of the spinning rotors: -R diag(k_xy, k_xy, k_z) R^T v_air sum(w).

    Source: J. Foerster, System identification of the Crazyflie 2.0 (2015).

    Args:
        quaternion: Attitude of the drone, body to world.
        air_velocity: Its velocity relative to the air, world axes, m/s.
        total_speed: Sum of the rotor speeds, rad/s.
        row: Constants of the drone.

    Returns:
        The force, world axes, N.
    """
    v = to_body(quaternion, air_velocity)
    xy = -row.drag_xy * total_speed
    z = -row.drag_z * total_speed
    return to_world(quaternion, (xy * v[0], xy * v[1], z * v[2]))


@func
def ground_effect(height: float, up: float, row: ParameterRow) -> float:
    """Return the share by which thrust grows near a surface: k (R / 4h)^2, at most 4/15.

    k = 1 is I. Cheeseman and W. Bennett, ARC R&M 3021 (1955); the bound keeps their formula within
    its validity. The gain fades out as the drone tilts, and is none upside down (our choice).

    Args:
        height: Height above the surface, m.
        up: Vertical component of the thrust axis.
        row: Constants of the drone.

    Returns:
        The share of the thrust that is added.
    """
    if row.ground_effect_gain <= 0.0 or up <= 0.0:
        return 0.0
    # Height at which the share reaches its bound.
    lowest = 0.25 * row.propeller_radius * math.sqrt(3.75 * row.ground_effect_gain)
    ratio = row.propeller_radius / (4.0 * max(height, lowest))
    return up * row.ground_effect_gain * ratio * ratio


@func
def wake_width(drop: float) -> float:
    """Return the width b of the fit in `downwash`, m, `drop` metres below the rotors."""
    return 0.16 * drop - 0.11


@func
def downwash(horizontal_squared: float, drop: float, gravity: float, row: ParameterRow) -> float:
    """Return the downward force of a drone's wake on another drone.

    a exp(-(d / b)^2 / 2) with a = 2267.18 (R / 4 drop)^2 and b = 0.16 drop - 0.11, the fit of
    gym-pybullet-drones (J. Panerati et al. 2021). It is bounded, as it is not there: a by the
    weight of the upper drone, which is all the thrust that its wake carries; b from below by its
    rotor disc. Drones level with the upper one or above it feel none.

    Args:
        horizontal_squared: Square of the horizontal distance d of the two, m^2.
        drop: How far the other is below, m.
        gravity: Gravity, m/s^2.
        row: Constants of the upper drone.

    Returns:
        The force, N.
    """
    if drop <= 0.0 or row.downwash_gain <= 0.0:
        return 0.0
    width = max(wake_width(drop), row.downwash_radius)
    if horizontal_squared > WAKE_EDGE * width * width:
        return 0.0
    ratio = row.propeller_radius / (4.0 * drop)
    strength = min(row.downwash_gain * ratio * ratio, row.mass * gravity)
    return strength * exp(-0.5 * horizontal_squared / (width * width))


@kernel
def wakes(
    w: int,
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    gravity: float,
    total: np.ndarray,
) -> None:
    """Sum the downwash of all living drones of a world on each of them.

    Args:
        w: Index of the world.
        position: (W, N, 3) positions, m.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        gravity: Gravity, m/s^2.
        total: (N,) the downward force on each drone, N; filled.
    """
    # How far the widest wake of this world reaches: pairs farther apart are passed over.
    lowest = np.inf
    highest = -np.inf
    widest = 0.0
    for i in range(total.shape[0]):
        total[i] = 0.0
        if alive[w, i]:
            lowest = min(lowest, position[w, i, 2])
            highest = max(highest, position[w, i, 2])
            widest = max(widest, parameters[w, i].downwash_radius)
    widest = max(widest, wake_width(highest - lowest))
    edge = WAKE_EDGE * widest * widest
    # Of each pair the upper drone blows on the lower one.
    for i in range(total.shape[0]):
        for j in range(i + 1, total.shape[0]):
            dx = position[w, j, 0] - position[w, i, 0]
            dy = position[w, j, 1] - position[w, i, 1]
            square = dx * dx + dy * dy
            if square <= edge and alive[w, i] and alive[w, j]:
                drop = position[w, j, 2] - position[w, i, 2]
                if drop > 0.0:
                    total[i] += downwash(square, drop, gravity, parameters[w, j])
                else:
                    total[j] += downwash(square, -drop, gravity, parameters[w, i])
