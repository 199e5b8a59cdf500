"""Disturbance observers: estimates of forces and torques that the controller's model lacks.

An observer predicts velocity or rates from the rotors' speeds. The prediction error is integrated
into an estimate of the disturbance (K. Ohnishi, M. Shibata, T. Murakami, Motion control for
advanced mechatronics, IEEE/ASME T-Mech 1996). Saturated rotors cause no wind-up, since the
prediction uses the actual rotor speeds. While the model is exact the estimate stays near zero.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import is_any, where
from bulletuav.control.gains import GainRow
from bulletuav.control.lee import torque_of_drag_ahead
from bulletuav.geometry.rotation import Quat4, Vec3, Vec3Like, axes, dot, plus, to_body
from bulletuav.vehicle.aerodynamics import drag_torque, thrust_and_drag
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.wrench import body_acceleration

MEMORY = 13
"""Size of the observers' state: predicted velocity (3) and push (3), predicted rates (2) and torque
(2), and the last velocity (3)"""
PUSHES = 6
"""Number of these about pushes, which come first"""
FASTER = 2.0
"""Frequency of the observer of pushes, relative to that of the position loop"""
LARGEST_TORQUE = 0.25
"""Bound of the estimated torque, relative to the maximum thrust times the arm"""


@func
def _fresh(memory: np.ndarray, first: int, last: int) -> bool:
    """Check whether an observer has just been reset: its state is all zeros."""
    size = abs(memory[first])
    for k in range(first + 1, last):
        size += abs(memory[k])
    fresh: bool = size == 0.0
    return fresh


@func
def felt_acceleration(velocity: Vec3Like, memory: np.ndarray, dt: float) -> Vec3:
    """Compute the mean acceleration of a drone since the last call, by a finite difference.

    Args:
        velocity: Velocity, m/s, world.
        memory: (M,) observer state of the drone; zeros after a reset.
        dt: Time since the last call, s.

    Returns:
        Acceleration, m/s^2, world; zero at the first call after a reset.
    """
    fresh = _fresh(memory, 10, 13)
    # Velocity at the last call, replaced by the present one
    before = (memory[10], memory[11], memory[12])
    for k in range(3):
        memory[10 + k] = velocity[k]
    change = plus((velocity[0], velocity[1], velocity[2]), -1.0, before)
    felt = plus((0.0, 0.0, 0.0), 1.0 / dt, change)
    # After a reset there is no previous velocity to take the difference from
    return where(fresh, 0.0, felt[0]), where(fresh, 0.0, felt[1]), where(fresh, 0.0, felt[2])


@func
def learned_push(
    velocity: Vec3Like,
    known: Vec3Like,
    memory: np.ndarray,
    dt: float,
    gravity: float,
    gain: GainRow,
) -> Vec3:
    """Advance the observer of disturbance forces, such as a wake or a low battery voltage.

    With velocity v, prediction p and estimate d: p' = a + d + 2 z f (v - p), d' = f^2 (v - p).

    Args:
        velocity: Velocity, m/s, world.
        known: Acceleration a by thrust, gravity and drag in still air, m/s^2, world.
        memory: (M,) observer state of the drone; zeros after a reset.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        gain: Row of `GAINS`.

    Returns:
        Acceleration by disturbance forces, m/s^2, world.
    """
    # The prediction begins at the measured velocity
    fresh = _fresh(memory, 0, PUSHES)
    for k in range(3):
        memory[k] = where(fresh, velocity[k], memory[k])
    # Euler steps of the two equations; with damping 1 both poles are at -f
    frequency = FASTER * gain.position_frequency
    for k in range(3):
        missed = velocity[k] - memory[k]
        correction = 2.0 * gain.damping * frequency * missed
        memory[k] += dt * (known[k] + memory[3 + k] + correction)
        memory[3 + k] += dt * frequency * frequency * missed
    # The bound prevents wind-up on the ground or in a hand.
    push = (memory[3], memory[4], memory[5])
    size = math.sqrt(dot(push, push))
    over = size > gain.max_push * gravity
    if is_any(over):
        for k in range(3):
            memory[3 + k] = where(over, push[k] * gain.max_push * gravity / size, push[k])
    return memory[3], memory[4], memory[5]


@func
def learned_torque(
    rates: Vec3,
    rotors: Rotors,
    tipped: Vec3Like,
    memory: np.ndarray,
    dt: float,
    row: np.record,
    gain: GainRow,
) -> Vec3:
    """Advance the observer of disturbance torques about the x and y axes, such as by wind.

    The observer is that of `learned_push` for rates, at the frequency of the attitude loop.

    Args:
        rates: Body rates, rad/s.
        rotors: Wrench of the rotors.
        tipped: Torque of the drag in still air, N m.
        memory: (M,) observer state of the drone; zeros after a reset.
        dt: Time since the last call, s.
        row: Row of the nominal `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Disturbance torque, N m, body axes; zero about z.
    """
    # The prediction begins at the measured rates
    fresh = _fresh(memory, 6, 10)
    for k in range(2):
        memory[6 + k] = where(fresh, rates[k], memory[6 + k])
    # Angular acceleration by rotors and still air in the controller's model
    _, torque, total_speed, momentum = rotors
    learned = (memory[8], memory[9])
    x = torque[0] + tipped[0] + learned[0]
    y = torque[1] + tipped[1] + learned[1]
    spinning = body_acceleration(rates, (x, y, torque[2]), total_speed, momentum, row)
    # Bound by the torque that the rotors can compensate
    most = LARGEST_TORQUE * gain.max_thrust * row.arm
    for k in range(2):
        # As for pushes, with torque over inertia in place of acceleration
        frequency = gain.attitude_frequency[k]
        missed = rates[k] - memory[6 + k]
        correction = 2.0 * gain.damping * frequency * missed
        memory[6 + k] += dt * (spinning[k] + correction)
        more = learned[k] + dt * row.inertia[k] * frequency * frequency * missed
        memory[8 + k] = min(max(more, -most), most)
    return memory[8], memory[9], 0.0


@func
def learned(
    state: tuple[Vec3, Quat4, Vec3, Vec3],
    rotors: Rotors,
    memory: np.ndarray,
    integral: bool,
    dt: float,
    gravity: float,
    nominal: np.record,
    gain: GainRow,
) -> tuple[Vec3, Vec3]:
    """Advance the disturbance observers, and return the estimates to compensate.

    Args:
        state: Position (m), quaternion, velocity (m/s) and body rates (rad/s) of the drone.
        rotors: Present wrench of the rotors in the controller's model.
        memory: (M,) observer state of the drone; updated.
        integral: Whether steady disturbance forces are estimated.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Acceleration by disturbance forces, m/s^2, world, and disturbance torque, N m, body axes.
    """
    _, quaternion, velocity, rates = state
    # Steady disturbance forces, such as by wind
    push = (0.0, 0.0, 0.0)
    if integral:
        up = axes(quaternion)[2]
        lift = thrust_and_drag(velocity, up, rotors[0], rotors[2], nominal)
        known = plus((0.0, 0.0, -gravity), 1.0 / nominal.mass, lift)
        push = learned_push(velocity, known, memory, dt, gravity, gain)
    twist = (0.0, 0.0, 0.0)
    # Wind turns drones whose drag acts far above the centre of mass.
    if is_any(nominal.drag_height > 0.0):
        tipped = drag_torque(to_body(quaternion, velocity), rotors[2], nominal)
        twist = learned_torque(rates, rotors, tipped, memory, dt, nominal, gain)
        felt = felt_acceleration(velocity, memory, dt)
        still = torque_of_drag_ahead(quaternion, velocity, rates, felt, rotors[2], nominal)
        twist = plus(twist, 1.0, still)
    return push, twist
