"""Aerodynamic forces on one drone, as compiled functions: drag and ground effect."""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import where
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, axes, dot
from bulletuav.vehicle.parameters import ParameterRow


@func
def drag(
    quaternion: Quat4Like, air_velocity: Vec3Like, total_speed: float, row: ParameterRow
) -> tuple[Vec3, Vec3]:
    """Compute the drag of the rotors and of the body.

    Rotors: -R diag(k_xy, k_xy, k_z) R^T v sum(w), linear in the air velocity v. Body:
    -|v| R diag(c_xy, c_xy, c_z) R^T v with c = density / 2 times the drag area. The drag of the
    body also acts with stopped rotors, so that a falling drone reaches a terminal velocity. The
    rotors' drag acts above the centre of mass and pitches the drone against its direction of flight
    (fitted to flights of Crazyflies, see docs/explanation/truth.md).

    Args:
        quaternion: Attitude of the drone, body to world.
        air_velocity: Velocity v relative to the air, world axes, m/s.
        total_speed: Sum of the rotor speeds w, rad/s.
        row: Constants of the drone.

    Returns:
        The force, world axes, N, and the torque, body axes, N m.

    References:
        J. Foerster, System identification of the Crazyflie 2.0 (2015).
    """
    ahead, left, up = axes(quaternion)
    along = (dot(ahead, air_velocity), dot(left, air_velocity), 0.0)
    force = thrust_and_drag(air_velocity, up, 0.0, total_speed, row)
    return force, drag_torque(along, total_speed, row)


@func
def thrust_and_drag(
    v: Vec3Like, up: Vec3Like, thrust: float, total_speed: float, row: ParameterRow
) -> Vec3:
    """Compute the sum of thrust and drag, world axes, N.

    The drag constants along the body's x and y axes are equal. Therefore diag(k_xy, k_xy, k_z) in
    body axes is k_xy v + (k_z - k_xy) (v . up) up in world axes, and no vector needs to be rotated.

    Args:
        v: Velocity relative to the air, world axes, m/s.
        up: The body's z axis in the world.
        thrust: Thrust along the body's z axis, N.
        total_speed: Sum of the rotor speeds, rad/s.
        row: Constants of the drone.

    Returns:
        The force, world axes, N.
    """
    climb = dot(up, v)
    across = row.drag_xy * total_speed
    lift = thrust + (across - row.drag_z * total_speed) * climb
    body = row.body_drag_xy
    rise = (body - row.body_drag_z) * climb
    # Last, since the square root has the longest latency
    speed = math.sqrt(dot(v, v))
    return (
        lift * up[0] - across * v[0] + speed * (rise * up[0] - body * v[0]),
        lift * up[1] - across * v[1] + speed * (rise * up[1] - body * v[1]),
        lift * up[2] - across * v[2] + speed * (rise * up[2] - body * v[2]),
    )


@func
def drag_torque(along: Vec3Like, total_speed: float, row: ParameterRow) -> Vec3:
    """Compute the torque of the rotors' drag, which acts above the centre of mass, body axes, N m.

    Args:
        along: Velocity relative to the air along the body's axes x and y, m/s.
        total_speed: Sum of the rotor speeds, rad/s.
        row: Constants of the drone.

    Returns:
        The torque, body axes, N m.
    """
    tip = row.drag_height * (row.drag_xy * total_speed)
    return tip * along[1], -tip * along[0], 0.0


@func
def ground_effect(height: float, row: ParameterRow) -> float:
    """Return the relative increase of a rotor's thrust near a surface: k (1 - h / H)^3.

    k is the relative increase at the surface. The reach H is proportional to the propeller's
    radius; from there on the increase, its slope and its curvature are 0. The law is a fit to
    take-offs of Crazyflies (see docs/explanation/truth.md).

    Args:
        height: Height h of the rotor above the surface, m; below the surface the increase stays k.
        row: Constants of the drone.

    Returns:
        The added thrust as a fraction of the rotor's thrust.

    References:
        G. Shi et al., Neural-Swarm2 (T-RO 2021), for the data.
    """
    return row.ground_effect_gain * _ground_proximity(1.0 - row.ground_effect_fade * height)


@func
def _ground_proximity(left: float) -> float:
    """Return the cube of the remaining fraction of the reach, (1 - h / H)^3, clamped to 0 and 1."""
    within = min(max(left, 0.0), 1.0)
    return within * within * within


@func
def is_near_surface(height: float, climb: float, dt: float, row: ParameterRow) -> bool:
    """Check whether the ground effect of a surface below may act on any rotor within a step.

    Args:
        height: Height of the centre of mass above the surface, m.
        climb: Vertical velocity, m/s.
        dt: Duration of the step, s.
        row: Constants of the drone.

    Returns:
        True if it may act.
    """
    # No rotor is lower than the arm, at any tilt; twice the distance is a margin for a fall
    lowest = height - row.arm - 2.0 * dt * abs(climb)
    near: bool = where(row.ground_effect_gain > 0.0, lowest, np.inf) < row.ground_effect_reach
    return near


@func
def num_lifted_rotors(height: float, climb: float, dt: float, row: ParameterRow) -> int:
    """Return the number of rotors with a ground effect: all or none; see `is_near_surface`."""
    return row.num_rotors if is_near_surface(height, climb, dt, row) else 0


@func
def ground_wrench(
    height: float, lean: Vec3Like, speed: np.ndarray, lifted: int, row: ParameterRow
) -> Vec3:
    """Compute the thrust and torques that the ground effect adds to a drone.

    Each rotor gains by its own height, so that the lower side of a tilted drone is lifted. The gain
    fades out as the drone tilts, and is 0 upside down (our choice).

    Args:
        height: Height of the centre of mass above the surface, m.
        lean: Vertical components of the body's axes x, y, z.
        speed: (R,) rotor speeds, rad/s.
        lifted: Result of `num_lifted_rotors`.
        row: Constants of the drone.

    Returns:
        Thrust (N), and torques about the body's x and y axes (N m).
    """
    # Heights in units of the reach; common factors are outside of the loop, a hot path of RK4
    left = 1.0 - row.ground_effect_fade * height
    slope_x = row.ground_effect_fade * lean[0]
    slope_y = row.ground_effect_fade * lean[1]
    lift = lift_x = lift_y = 0.0
    for r in range(lifted):
        x = row.rotor_x[r]
        y = row.rotor_y[r]
        lower = x * slope_x + y * slope_y
        force = _ground_proximity(left - lower) * (speed[r] * speed[r])
        lift += force
        lift_x += x * force
        lift_y += y * force
    common = row.ground_effect_gain * max(lean[2], 0.0) * row.thrust_coefficient
    return common * lift, common * lift_y, -common * lift_x
