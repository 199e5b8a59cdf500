"""Aerodynamic forces on one drone as pure functions. `row` is one row of `airframe.PARAMETERS`."""

import math

import numpy as np

from bulletuav.geometry.rotation import to_body, to_world
from bulletuav.kernel import func, kernel

WAKE_EDGE = 80.0  # squared widths from its axis, beyond which a wake is below 1e-17 of itself


@func
def rotor_drag(quaternion, air_velocity, total_speed, row):
    """Drag of the spinning rotors (N, world): -R diag(k_xy, k_xy, k_z) R^T v_air sum(w).

    `air_velocity` is the velocity relative to the air in world axes, m/s; `total_speed` the sum of rotor speeds, rad/s.
    Source: J. Foerster, System identification of the Crazyflie 2.0 (2015).
    """
    v = to_body(quaternion, air_velocity)
    xy, z = -row.drag_xy * total_speed, -row.drag_z * total_speed
    return to_world(quaternion, (xy * v[0], xy * v[1], z * v[2]))


@func
def ground_effect(height, up, row):
    """Share by which thrust grows `height` metres above a surface: k (R / 4h)^2, at most 4/15.

    k = 1 is I. Cheeseman and W. Bennett, ARC R&M 3021 (1955); the bound keeps their formula within its validity. `up` is
    the vertical component of the thrust axis: the gain fades out as the drone tilts, and is none upside down (our choice).
    """
    if row.ground_effect_gain <= 0.0 or up <= 0.0:
        return 0.0
    lowest = 0.25 * row.propeller_radius * math.sqrt(3.75 * row.ground_effect_gain)
    ratio = row.propeller_radius / (4.0 * max(height, lowest))
    return up * row.ground_effect_gain * ratio * ratio


@func
def wake_width(drop):
    """Of the fit in `downwash`, m."""
    return 0.16 * drop - 0.11


@func
def downwash(horizontal_squared, drop, gravity, row):
    """Downward force (N) of the drone `row` on another `drop` metres below it and sqrt(horizontal_squared) m aside.

    a exp(-(d / b)^2 / 2) with a = 2267.18 (R / 4 drop)^2 and b = 0.16 drop - 0.11, the fit of gym-pybullet-drones
    (J. Panerati et al. 2021), bounded as it is not there: a by the weight of the upper drone, which is all the thrust its
    wake carries, b from below by its rotor disc. None on drones level with it or above.
    """
    if drop <= 0.0 or row.downwash_gain <= 0.0:
        return 0.0
    width = max(wake_width(drop), row.downwash_radius)
    if horizontal_squared > WAKE_EDGE * width * width:
        return 0.0
    ratio = row.propeller_radius / (4.0 * drop)
    strength = min(row.downwash_gain * ratio * ratio, row.mass * gravity)
    return strength * math.exp(-0.5 * horizontal_squared / (width * width))


@kernel
def wakes(w, position, alive, parameters, gravity, total):
    """The downwash of all living drones of world w on each of them, N, into `total` (N,)."""
    lowest, highest, widest = np.inf, -np.inf, 0.0
    for i in range(total.shape[0]):
        total[i] = 0.0
        if alive[w, i]:
            lowest, highest = min(lowest, position[w, i, 2]), max(highest, position[w, i, 2])
            widest = max(widest, parameters[w, i].downwash_radius)
    widest = max(widest, wake_width(highest - lowest))
    edge = WAKE_EDGE * widest * widest  # no wake of this world reaches farther
    for i in range(total.shape[0]):
        for j in range(i + 1, total.shape[0]):
            dx, dy = position[w, j, 0] - position[w, i, 0], position[w, j, 1] - position[w, i, 1]
            square = dx * dx + dy * dy
            if square <= edge and alive[w, i] and alive[w, j]:
                drop = position[w, j, 2] - position[w, i, 2]
                if drop > 0.0:
                    total[i] += downwash(square, drop, gravity, parameters[w, j])
                else:
                    total[j] += downwash(square, -drop, gravity, parameters[w, i])
