"""Aerodynamic forces on one drone as compiled functions: drag, and the thrust that surfaces add."""

import math

import numpy as np

from bulletuav.functions import exp
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, dot, to_body, to_world
from bulletuav.kernel import func
from bulletuav.vehicle.parameters import ParameterRow

GROUND_EFFECT_EDGE = 25.0
"""Height in decay lengths above which there is no ground effect: it is below 1e-11 of the thrust"""


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
    v = to_body(quaternion, air_velocity)
    speed = math.sqrt(dot(v, v))
    rotors = -row.drag_xy * total_speed
    xy = rotors - row.body_drag_xy * speed
    z = -(row.drag_z * total_speed + row.body_drag_z * speed)
    tip = row.drag_height * rotors
    force = to_world(quaternion, (xy * v[0], xy * v[1], z * v[2]))
    return force, (-tip * v[1], tip * v[0], 0.0)


@func
def ground_effect(height: float, row: ParameterRow) -> float:
    """Return the share by which the thrust of one rotor grows near a surface: k exp(-h / d).

    Fit to take-offs of Crazyflies (data of G. Shi et al., Neural-Swarm2, T-RO 2021; see
    docs/truth.md). k is the share at the surface. d grows with the propeller's radius.

    Args:
        height: Height h of the rotor above the surface, m; below it the share stays k.
        row: Constants of the drone.

    Returns:
        The share of the rotor's thrust that is added.
    """
    return row.ground_effect_gain * exp(-max(height, 0.0) / row.ground_effect_decay)


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
    near = height < GROUND_EFFECT_EDGE * row.ground_effect_decay
    if not near or row.ground_effect_gain <= 0.0 or lean[2] <= 0.0:
        return 0.0, 0.0, 0.0
    thrust = torque_x = torque_y = 0.0
    for r in range(row.num_rotors):
        x = row.rotor_x[r]
        y = row.rotor_y[r]
        share = lean[2] * ground_effect(height + x * lean[0] + y * lean[1], row)
        force = share * row.thrust_coefficient * speed[r] * speed[r]
        thrust += force
        torque_x += y * force
        torque_y -= x * force
    return thrust, torque_x, torque_y
