"""What the controller's model does not know: pushes and torques, learned while flying.

An observer predicts velocity or rates from the rotors' speeds. What the prediction misses is
integrated into an estimate (K. Ohnishi, M. Shibata, T. Murakami, Motion control for advanced
mechatronics, IEEE/ASME T-Mech 1996). Limits of the rotors do not wind it up, since it looks at what
they did. While the model is right the estimate stays near zero, and flights are as without it.
"""

import math

import numpy as np

from bulletuav.control.gains import GainRow
from bulletuav.geometry.rotation import Vec3, Vec3Like, dot, plus
from bulletuav.kernel import func
from bulletuav.vehicle.rotors import Rotors
from bulletuav.vehicle.wrench import body_acceleration

MEMORY = 13
"""Numbers that observers remember: predicted velocity (3) and push (3), predicted rates (2) and
torque (2), and the last velocity (3)"""
FASTER = 2.0
"""Frequency of the observer of pushes over that of the position loop"""
LARGEST_PUSH = 0.5
"""Largest push that is learned, in gravities"""
LARGEST_TORQUE = 0.25
"""Largest torque that is learned, over the greatest thrust times the arm"""


@func
def _fresh(
    memory: np.ndarray,
    w: int,
    i: int,
    first: int,
    last: int,
) -> bool:
    """Tell whether an observer has just started: its memory is all zeros."""
    for k in range(first, last):
        if memory[w, i, k] != 0.0:
            return False
    return True


@func
def felt_acceleration(
    velocity: Vec3Like,
    memory: np.ndarray,
    w: int,
    i: int,
    dt: float,
) -> Vec3:
    """Return how a drone was accelerated since the last call, as an accelerometer would tell.

    Args:
        velocity: Velocity, m/s, world.
        memory: (W, N, M) memory of all drones; zeros for a drone that starts.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last call, s.

    Returns:
        Acceleration, m/s^2, world; none at a start.
    """
    fresh = _fresh(memory, w, i, 10, 13)
    # Velocity of the last call, which the present one replaces
    before = (memory[w, i, 10], memory[w, i, 11], memory[w, i, 12])
    for k in range(3):
        memory[w, i, 10 + k] = velocity[k]
    # There is no velocity before: a difference from 0 would be a jolt
    if fresh:
        return 0.0, 0.0, 0.0
    return plus(
        (0.0, 0.0, 0.0), 1.0 / dt, plus((velocity[0], velocity[1], velocity[2]), -1.0, before)
    )


@func
def learned_push(
    velocity: Vec3Like,
    known: Vec3Like,
    memory: np.ndarray,
    w: int,
    i: int,
    dt: float,
    gravity: float,
    gain: GainRow,
) -> Vec3:
    """Advance the observer of what pushes a drone, such as a wake or a weak battery.

    With velocity v, prediction p and estimate d: p' = a + d + 2 z f (v - p), d' = f^2 (v - p).

    Args:
        velocity: Velocity, m/s, world.
        known: Acceleration a by thrust, gravity and drag in still air, m/s^2, world.
        memory: (W, N, M) memory of all drones; zeros for a drone that starts.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        gain: Row of `GAINS`.

    Returns:
        Acceleration by what pushes beside the known forces, m/s^2, world.
    """
    # The prediction begins at the measured velocity
    if _fresh(memory, w, i, 0, 6):
        for k in range(3):
            memory[w, i, k] = velocity[k]
    # Euler steps of the two equations; both poles lie at f for a damping of 1
    frequency = FASTER * gain.position_frequency
    for k in range(3):
        missed = velocity[k] - memory[w, i, k]
        correction = 2.0 * gain.damping * frequency * missed
        memory[w, i, k] += dt * (known[k] + memory[w, i, 3 + k] + correction)
        memory[w, i, 3 + k] += dt * frequency * frequency * missed
    # Bounded: on the ground, or held by a hand, it would grow for ever.
    push = (memory[w, i, 3], memory[w, i, 4], memory[w, i, 5])
    size = math.sqrt(dot(push, push))
    if size > LARGEST_PUSH * gravity:
        for k in range(3):
            memory[w, i, 3 + k] = push[k] * LARGEST_PUSH * gravity / size
    return memory[w, i, 3], memory[w, i, 4], memory[w, i, 5]


@func
def learned_torque(
    rates: Vec3,
    rotors: Rotors,
    tipped: Vec3Like,
    memory: np.ndarray,
    w: int,
    i: int,
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
        memory: (W, N, M) memory of all drones; zeros for a drone that starts.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last call, s.
        row: Row of the nominal `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Torque beside the known ones, N m, body axes; none about z.
    """
    # The prediction begins at the measured rates
    if _fresh(memory, w, i, 6, 10):
        for k in range(2):
            memory[w, i, 6 + k] = rates[k]
    # Angular acceleration by rotors and still air, as the controller knows them
    _, torque, total_speed, momentum = rotors
    learned = (memory[w, i, 8], memory[w, i, 9])
    x = torque[0] + tipped[0] + learned[0]
    y = torque[1] + tipped[1] + learned[1]
    spinning = body_acceleration(rates, (x, y, torque[2]), total_speed, momentum, row)
    # A bound by what the rotors could make up for
    most = LARGEST_TORQUE * gain.max_thrust * row.arm
    for k in range(2):
        # As for pushes, with a torque over the inertia for the acceleration
        frequency = gain.attitude_frequency[k]
        missed = rates[k] - memory[w, i, 6 + k]
        correction = 2.0 * gain.damping * frequency * missed
        memory[w, i, 6 + k] += dt * (spinning[k] + correction)
        more = learned[k] + dt * row.inertia[k] * frequency * frequency * missed
        memory[w, i, 8 + k] = min(max(more, -most), most)
    return memory[w, i, 8], memory[w, i, 9], 0.0
