"""What the controller's model does not know: pushes and torques, learned while flying.

An observer predicts velocity or rates from the rotors' speeds. What the prediction misses is
integrated into an estimate (K. Ohnishi, M. Shibata, T. Murakami, Motion control for advanced
mechatronics, IEEE/ASME T-Mech 1996). Limits of the rotors do not wind it up, since it looks at what
they did. While the model is right the estimate stays near zero, and flights are as without it.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import is_any, where
from bulletuav.control.gains import GainRow
from bulletuav.control.lee import torque_of_drag_ahead
from bulletuav.geometry.rotation import Quat4, Vec3, Vec3Like, axes, dot, plus, to_body
from bulletuav.vehicle.aerodynamics import force_of_air, torque_of_drag
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.wrench import body_acceleration

MEMORY = 13
"""Numbers that observers remember: predicted velocity (3) and push (3), predicted rates (2) and
torque (2), and the last velocity (3)"""
PUSHES = 6
"""Of these about pushes, which come first"""
FASTER = 2.0
"""Frequency of the observer of pushes over that of the position loop"""
LARGEST_PUSH = 0.5
"""Largest push that is learned, in gravities"""
LARGEST_TORQUE = 0.25
"""Largest torque that is learned, over the greatest thrust times the arm"""


@func
def _fresh(memory: np.ndarray, first: int, last: int) -> bool:
    """Tell whether an observer has just started: its memory is all zeros."""
    size = abs(memory[first])
    for k in range(first + 1, last):
        size += abs(memory[k])
    fresh: bool = size == 0.0
    return fresh


@func
def felt_acceleration(velocity: Vec3Like, memory: np.ndarray, dt: float) -> Vec3:
    """Return how a drone was accelerated since the last call, as an accelerometer would tell.

    Args:
        velocity: Velocity, m/s, world.
        memory: (M,) memory of the drone; zeros for one that starts.
        dt: Time since the last call, s.

    Returns:
        Acceleration, m/s^2, world; none at a start.
    """
    fresh = _fresh(memory, 10, 13)
    # Velocity of the last call, which the present one replaces
    before = (memory[10], memory[11], memory[12])
    for k in range(3):
        memory[10 + k] = velocity[k]
    change = plus((velocity[0], velocity[1], velocity[2]), -1.0, before)
    felt = plus((0.0, 0.0, 0.0), 1.0 / dt, change)
    # There is no velocity before: a difference from 0 would be a jolt
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
    """Advance the observer of what pushes a drone, such as a wake or a weak battery.

    With velocity v, prediction p and estimate d: p' = a + d + 2 z f (v - p), d' = f^2 (v - p).

    Args:
        velocity: Velocity, m/s, world.
        known: Acceleration a by thrust, gravity and drag in still air, m/s^2, world.
        memory: (M,) memory of the drone; zeros for one that starts.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        gain: Row of `GAINS`.

    Returns:
        Acceleration by what pushes beside the known forces, m/s^2, world.
    """
    # The prediction begins at the measured velocity
    fresh = _fresh(memory, 0, PUSHES)
    for k in range(3):
        memory[k] = where(fresh, velocity[k], memory[k])
    # Euler steps of the two equations; both poles lie at f for a damping of 1
    frequency = FASTER * gain.position_frequency
    for k in range(3):
        missed = velocity[k] - memory[k]
        correction = 2.0 * gain.damping * frequency * missed
        memory[k] += dt * (known[k] + memory[3 + k] + correction)
        memory[3 + k] += dt * frequency * frequency * missed
    # Bounded: on the ground, or held by a hand, it would grow for ever.
    push = (memory[3], memory[4], memory[5])
    size = math.sqrt(dot(push, push))
    over = size > LARGEST_PUSH * gravity
    if is_any(over):
        for k in range(3):
            memory[3 + k] = where(over, push[k] * LARGEST_PUSH * gravity / size, push[k])
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
    """Advance the observer of what turns a drone about its x and y axes, such as wind.

    It is that of `learned_push` for rates, at the frequency of the attitude loop.

    Args:
        rates: Body rates, rad/s.
        rotors: What the rotors do.
        tipped: Torque of the drag in still air, N m.
        memory: (M,) memory of the drone; zeros for one that starts.
        dt: Time since the last call, s.
        row: Row of the nominal `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Torque beside the known ones, N m, body axes; none about z.
    """
    # The prediction begins at the measured rates
    fresh = _fresh(memory, 6, 10)
    for k in range(2):
        memory[6 + k] = where(fresh, rates[k], memory[6 + k])
    # Angular acceleration by rotors and still air, as the controller knows them
    _, torque, total_speed, momentum = rotors
    learned = (memory[8], memory[9])
    x = torque[0] + tipped[0] + learned[0]
    y = torque[1] + tipped[1] + learned[1]
    spinning = body_acceleration(rates, (x, y, torque[2]), total_speed, momentum, row)
    # A bound by what the rotors could make up for
    most = LARGEST_TORQUE * gain.max_thrust * row.arm
    for k in range(2):
        # As for pushes, with a torque over the inertia for the acceleration
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
    """Advance what the controller learns, and return what it makes up for.

    Args:
        state: Position (m), quaternion, velocity (m/s) and body rates (rad/s) of the drone.
        rotors: What its rotors do now, as far as the controller knows.
        memory: (M,) its memory, which is changed.
        integral: Whether steady pushes are learned.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Acceleration, m/s^2, world, and torque, N m, body axes.
    """
    _, quaternion, velocity, rates = state
    # Steady pushes, such as wind: learned from how the velocity departs from what is known
    push = (0.0, 0.0, 0.0)
    if integral:
        up = axes(quaternion)[2]
        lift = force_of_air(velocity, up, rotors[0], rotors[2], nominal)
        known = plus((0.0, 0.0, -gravity), 1.0 / nominal.mass, lift)
        push = learned_push(velocity, known, memory, dt, gravity, gain)
    twist = (0.0, 0.0, 0.0)
    # Wind turns drones whose drag acts far above the centre of mass.
    if is_any(nominal.drag_height > 0.0):
        tipped = torque_of_drag(to_body(quaternion, velocity), rotors[2], nominal)
        twist = learned_torque(rates, rotors, tipped, memory, dt, nominal, gain)
        felt = felt_acceleration(velocity, memory, dt)
        still = torque_of_drag_ahead(quaternion, velocity, rates, felt, rotors[2], nominal)
        twist = plus(twist, 1.0, still)
    return push, twist
