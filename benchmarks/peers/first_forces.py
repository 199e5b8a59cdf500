"""The forces of bulletuav's first model, in the form in which its flights call them today.

`install` puts them in the place of today's, so that both are measured in the same flights: thrust
and torque of the rotors, linear drag, Cheeseman's and Bennett's ground effect on the whole drone,
and the wake of gym-pybullet-drones as a force. Their constants are those of a Crazyflie.
"""

import math

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import where
from bulletuav.dynamics import base, blocks, drive, integration, rigid_body
from bulletuav.geometry.rotation import Vec3, axes, minus, plus, to_body, to_world
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.wrench import Surroundings

EFFECTS = ("lag", "drag", "ground_effect", "downwash")
"""Effects that it had"""
GROUND_GAIN, WAKE_GAIN, WAKE_RADIUS, WAKE_EDGE = 11.37, 2267.18, 0.07, 80.0


@func
def rotor_wrench(speed: np.ndarray, winding: float, row: ParameterRow) -> Rotors:
    """Return thrust, torque, and the sum of speeds; rotors without inertia."""
    thrust = torque_x = torque_y = torque_z = total = 0.0
    for r in range(row.num_rotors):
        now = speed[r]
        force = row.thrust_coefficient * now * now
        thrust += force
        torque_x += row.rotor_y[r] * force
        torque_y -= row.rotor_x[r] * force
        torque_z += row.rotor_turn[r] * row.torque_coefficient * now * now
        total += now
    return thrust, (torque_x, torque_y, torque_z), total, 0.0


@func
def ground_effect(height: float, up: float, row: ParameterRow) -> float:
    """Return the share by which thrust grows near a surface."""
    lowest = 0.25 * row.propeller_radius * math.sqrt(3.75 * GROUND_GAIN)
    ratio = row.propeller_radius / (4.0 * max(height, lowest))
    share = up * GROUND_GAIN * ratio * ratio
    return where(row.ground_effect_gain > 0.0, where(up > 0.0, share, 0.0), 0.0)


@func
def wrench(quaternion, velocity, altitude, speed, rotors, around: Surroundings, lifted, row):
    """Return force and torque on one drone."""
    wind, surface, gravity, push, twist = around
    thrust, torque, total_speed, _ = rotors
    up = axes(quaternion)[2]
    thrust *= 1.0 + ground_effect(altitude - surface, up[2], row)
    along = to_body(quaternion, minus(velocity, wind))
    xy = -row.drag_xy * total_speed
    z = -row.drag_z * total_speed
    slowed = to_world(quaternion, (xy * along[0], xy * along[1], z * along[2]))
    force = (
        thrust * up[0] + slowed[0],
        thrust * up[1] + slowed[1],
        thrust * up[2] + slowed[2] - row.mass * gravity,
    )
    return plus(force, 1.0, push), plus(torque, 1.0, twist)


@func
def body_acceleration(rates, torque, total_speed: float, momentum: float, row: ParameterRow):
    """Return the angular acceleration of a body whose rates nothing damps."""
    jx = row.inertia[0]
    jy = row.inertia[1]
    jz = row.inertia[2]
    return (
        (torque[0] - (jz - jy) * rates[1] * rates[2]) * (1.0 / jx),
        (torque[1] - (jx - jz) * rates[2] * rates[0]) * (1.0 / jy),
        (torque[2] - (jy - jx) * rates[0] * rates[1]) * (1.0 / jz),
    )


@func
def with_wake(
    wind: Vec3, surface: float, gravity: float, force: Vec3, torque: Vec3, wake
) -> Surroundings:
    """Return what surrounds a drone; wakes push it, and do not turn it."""
    return wind, surface, gravity, (force[0], force[1], force[2] - wake[0]), torque


@func
def downwash(horizontal_squared: float, drop: float, row: ParameterRow) -> float:
    """Return the downward force of a drone's wake on another drone, N."""
    if drop <= 0.0 or row.wake_share <= 0.0:
        return 0.0
    width = max(0.16 * drop - 0.11, WAKE_RADIUS)
    if horizontal_squared > WAKE_EDGE * width * width:
        return 0.0
    ratio = row.propeller_radius / (4.0 * drop)
    strength = min(WAKE_GAIN * ratio * ratio, row.mass * 9.8)
    return strength * exp(-0.5 * horizontal_squared / (width * width))


@kernel
def sum_wakes(swarm, alive, parameters, first: int, last: int, listed: bool, leeway: float, wakes):
    """Sum the downwash of all living drones of some worlds on each of them."""
    position, felt = swarm.position, wakes.felt
    for w in range(first, last):
        _sum_wakes(w, position, alive, parameters, felt[w - first])


@func
def _sum_wakes(w: int, position, alive: np.ndarray, parameters: np.ndarray, wake: np.ndarray):
    """Sum the downwash of a world."""
    lowest = np.inf
    highest = -np.inf
    widest = WAKE_RADIUS
    for i in range(wake.shape[0]):
        wake[i, 0] = 0.0
        if alive[w, i]:
            lowest = min(lowest, position[w, i, 2])
            highest = max(highest, position[w, i, 2])
    widest = max(widest, 0.16 * (highest - lowest) - 0.11)
    edge = WAKE_EDGE * widest * widest
    for i in range(wake.shape[0]):
        for j in range(i + 1, wake.shape[0]):
            dx = position[w, j, 0] - position[w, i, 0]
            dy = position[w, j, 1] - position[w, i, 1]
            square = dx * dx + dy * dy
            if square <= edge and alive[w, i] and alive[w, j]:
                drop = position[w, j, 2] - position[w, i, 2]
                if drop > 0.0:
                    wake[i, 0] += downwash(square, drop, parameters[w, j])
                else:
                    wake[j, 0] += downwash(square, -drop, parameters[w, i])


def install() -> None:
    """Let flights that are compiled from now on feel these forces."""
    for flight in (base, integration, blocks, rigid_body, drive):
        for law in (rotor_wrench, wrench, body_acceleration, with_wake, sum_wakes):
            setattr(flight, law.__name__, law)
