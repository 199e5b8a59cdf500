"""Aerodynamic forces on one drone as compiled functions: drag, and the thrust that surfaces add."""

import math

import numpy as np

from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, dot, to_body, to_world
from bulletuav.kernel import func
from bulletuav.vehicle.parameters import ParameterRow


@func
def drag(
    quaternion: Quat4Like, air_velocity: Vec3Like, total_speed: float, row: ParameterRow
) -> tuple[Vec3, Vec3]:
    """Return the drag of the spinning rotors and of the body.

    Rotors: -R diag(k_xy, k_xy, k_z) R^T v sum(w), linear in the air velocity v (J. Foerster, System
    identification of the Crazyflie 2.0, 2015). Body: -|v| R diag(c_xy, c_xy, c_z) R^T v with
    c = density / 2 times the drag area, which acts on stopped rotors too: a drone that falls
    reaches a terminal speed. The rotors' drag acts above the centre of mass, and turns the drone
    away from where it flies (fit to flights of Crazyflies, see docs/truth.md).

    Args:
        quaternion: Attitude of the drone, body to world.
        air_velocity: Its velocity v relative to the air, world axes, m/s.
        total_speed: Sum of the rotor speeds w, rad/s.
        row: Constants of the drone.

    Returns:
        The force, world axes, N, and the torque, body axes, N m.
    """
    speed = math.sqrt(dot(air_velocity, air_velocity))
    force, torque = drag_along(to_body(quaternion, air_velocity), speed, total_speed, row)
    return to_world(quaternion, force), torque


@func
def drag_along(
    v: Vec3Like, speed: float, total_speed: float, row: ParameterRow
) -> tuple[Vec3, Vec3]:
    """Return what `drag` does, all in body axes.

    Args:
        v: Velocity relative to the air, body axes, m/s.
        speed: Its length, m/s, which the force on the body alone depends on.
        total_speed: Sum of the rotor speeds, rad/s.
        row: Constants of the drone.

    Returns:
        The force, N, and the torque, N m.
    """
    rotors = -row.drag_xy * total_speed
    xy = rotors - row.body_drag_xy * speed
    z = -(row.drag_z * total_speed + row.body_drag_z * speed)
    tip = row.drag_height * rotors
    return (xy * v[0], xy * v[1], z * v[2]), (-tip * v[1], tip * v[0], 0.0)


@func
def ground_effect(height: float, row: ParameterRow) -> float:
    """Return the share by which the thrust of one rotor grows near a surface: k (1 - h / H)^3.

    Fit to take-offs of Crazyflies (data of G. Shi et al., Neural-Swarm2, T-RO 2021; see
    docs/truth.md). k is the share at the surface. The reach H grows with the propeller's radius;
    from there on the share is 0, and so are its slope and curvature.

    Args:
        height: Height h of the rotor above the surface, m; below it the share stays k.
        row: Constants of the drone.

    Returns:
        The share of the rotor's thrust that is added.
    """
    return row.ground_effect_gain * _nearness(1.0 - height / row.ground_effect_reach)


@func
def _nearness(left: float) -> float:
    """Return the cube of what is left of the reach, (1 - h / H)^3 within 0 and 1."""
    within = min(max(left, 0.0), 1.0)
    return within * within * within


@func
def ground_wrench(
    height: float,
    lean: Vec3Like,
    speed: np.ndarray,
    row: ParameterRow,
) -> Vec3:
    """Return what a surface below adds to the rotors: each gains by its own height.

    So the lower side of a tilted drone is lifted. The gain fades out as the drone tilts, and is
    none upside down (our choice).

    Args:
        height: Height of the centre of mass above the surface, m.
        lean: Vertical components of the body's axes x, y, z.
        speed: (R,) rotor speeds, rad/s.
        row: Constants of the drone.

    Returns:
        Thrust (N), and torques about the body's x and y axes (N m).
    """
    # No rotor is lower than this, whatever the tilt
    near = height < row.ground_effect_reach + row.arm
    if not near or row.ground_effect_gain <= 0.0 or lean[2] <= 0.0:
        return 0.0, 0.0, 0.0
    # In reaches, and what all rotors share left out of the loop: it runs in each stage of RK4
    scale = 1.0 / row.ground_effect_reach
    left = 1.0 - scale * height
    by_x = scale * lean[0]
    by_y = scale * lean[1]
    lift = lift_x = lift_y = 0.0
    for r in range(row.num_rotors):
        x = row.rotor_x[r]
        y = row.rotor_y[r]
        force = _nearness(left - x * by_x - y * by_y) * (speed[r] * speed[r])
        lift += force
        lift_x += x * force
        lift_y += y * force
    common = row.ground_effect_gain * lean[2] * row.thrust_coefficient
    return common * lift, common * lift_y, -common * lift_x
