"""Aerodynamic forces on one drone as pure functions. `row` is one row of `airframe.PARAMETERS`."""

import math

from bulletuav.kernel import kernel
from bulletuav.physics.rotation import to_body, to_world

WAKE_EDGE = 80.0  # squared widths from its axis, beyond which a wake is below 1e-17 of itself


@kernel
def rotor_drag(quaternion, air_velocity, total_speed, row):
    """Drag of the spinning rotors (N, world): -R diag(k_xy, k_xy, k_z) R^T v_air sum(w).

    `air_velocity` is the velocity relative to the air in world axes, m/s; `total_speed` the sum of rotor speeds, rad/s.
    Source: J. Foerster, System identification of the Crazyflie 2.0 (2015).
    """
    v = to_body(quaternion, air_velocity)
    xy, z = -row.drag_xy * total_speed, -row.drag_z * total_speed
    return to_world(quaternion, (xy * v[0], xy * v[1], z * v[2]))


@kernel
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


@kernel
def downwash(horizontal_squared, drop, gravity, row):
    """Downward force (N) of the drone `row` on another `drop` metres below it and sqrt(horizontal_squared) m aside.

    a exp(-(d / b)^2 / 2) with a = 2267.18 (R / 4 drop)^2 and b = 0.16 drop - 0.11, the fit of gym-pybullet-drones
    (J. Panerati et al. 2021), bounded as it is not there: a by the weight of the upper drone, which is all the thrust its
    wake carries, b from below by its rotor disc. None on drones level with it or above.
    """
    if drop <= 0.0 or row.downwash_gain <= 0.0:
        return 0.0
    width = max(0.16 * drop - 0.11, row.downwash_radius)
    if horizontal_squared > WAKE_EDGE * width * width:
        return 0.0
    ratio = row.propeller_radius / (4.0 * drop)
    strength = min(row.downwash_gain * ratio * ratio, row.mass * gravity)
    return strength * math.exp(-0.5 * horizontal_squared / (width * width))


@kernel
def downwash_on(world, drone, position, alive, parameters, gravity):
    """Sum of the downwash of all living drones of the world on one of them, N."""
    total = 0.0
    for other in range(position.shape[1]):
        if other != drone and alive[world, other]:
            dx = position[world, other, 0] - position[world, drone, 0]
            dy = position[world, other, 1] - position[world, drone, 1]
            drop = position[world, other, 2] - position[world, drone, 2]
            total += downwash(dx * dx + dy * dy, drop, gravity, parameters[world, other])
    return total
