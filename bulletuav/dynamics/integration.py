"""RK4 step of a rigid body under its rotors and wings, for one drone or SIMD lanes of several."""

from typing import Any

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import where
from bulletuav.geometry.rotation import Quat4, Vec3, normalise_quaternion
from bulletuav.vehicle.aerodynamics import num_lifted_rotors
from bulletuav.vehicle.rotors import (
    Rotors,
    lag_decay,
    lag_rates,
    rotor_acceleration,
    rotor_speed_after,
    rotor_wrench,
)
from bulletuav.vehicle.wings import winged_wrench
from bulletuav.vehicle.wrench import Surroundings, body_acceleration, compute_wrench

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position, quaternion, velocity and rates of one drone, or their time derivatives"""
Stages = tuple[Rotors, Rotors, Rotors]
"""Wrench of the rotors at the begin, middle and end of a substep"""
Speeds = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rotor speeds (R,) at the same times, rad/s"""


@func
def _total_wrench(
    state: State,
    speed: np.ndarray,
    rotors: Rotors,
    around: Surroundings,
    lifted: int,
    row: np.record,
    wing: Any,
    deflection: Any,
) -> tuple[Vec3, Vec3, float, float]:
    """Return force, torque, total rotor speed and angular momentum for `body_acceleration`.

    The torque of wings and their propellers contains damping and the gyroscopic torque. Without
    wings in the swarm, `wing` is None, and the compiler removes the code of wings.
    """
    position, quaternion, velocity, rates = state
    if wing is not None:  # noqa: SIM102 - numba removes the block by this test alone
        if wing.num_panels > 0:
            force, torque = winged_wrench(
                quaternion, velocity, rates, speed, deflection, around, row, wing
            )
            return force, torque, rotors[2], rotors[3]
    force, torque = compute_wrench(
        quaternion, velocity, position[2], speed, rotors, around, lifted, row
    )
    return force, torque, rotors[2], rotors[3]


@func
def slope_of(
    state: State,
    speed: np.ndarray,
    rotors: Rotors,
    around: Surroundings,
    lifted: int,
    row: np.record,
    wing: Any,
    deflection: Any,
) -> State:
    """Return the time derivative of a state at rotor speeds (R,), rad/s.

    `wing` is a row of `WINGS`, and `deflection` the deflections of the control surfaces (S,), rad;
    without wings in the swarm, both are None.
    """
    _, quaternion, velocity, rates = state
    force, torque, total_speed, momentum = _total_wrench(
        state, speed, rotors, around, lifted, row, wing, deflection
    )

    # Kinematics of the quaternion (x, y, z, w) under body rates (p, q, r)
    x, y, z, w = quaternion
    p, q, r = rates
    turning = (
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
        -0.5 * (x * p + y * q + z * r),
    )

    lightness = 1.0 / row.mass
    acceleration = (
        lightness * force[0],
        lightness * force[1],
        lightness * force[2],
    )
    spinning = body_acceleration(rates, torque, total_speed, momentum, row)
    return velocity, turning, acceleration, spinning


@func
def advance_state(state: State, time: float, slope: State) -> State:
    """Return state + time * slope."""
    x, q, v, w = state
    dx, dq, dv, dw = slope
    return (
        (
            x[0] + time * dx[0],
            x[1] + time * dx[1],
            x[2] + time * dx[2],
        ),
        (
            q[0] + time * dq[0],
            q[1] + time * dq[1],
            q[2] + time * dq[2],
            q[3] + time * dq[3],
        ),
        (
            v[0] + time * dv[0],
            v[1] + time * dv[1],
            v[2] + time * dv[2],
        ),
        (
            w[0] + time * dw[0],
            w[1] + time * dw[1],
            w[2] + time * dw[2],
        ),
    )


@func
def rk4(
    state: State,
    speeds: Speeds,
    rotors: Stages,
    dt: float,
    around: Surroundings,
    row: np.record,
    wing: Any,
    deflection: Any,
) -> State:
    """Return a state after one classical Runge-Kutta step."""
    lifted = num_lifted_rotors(state[0][2] - around[1], state[2][2], dt, row)
    # Constants let the compiler remove the ground effect, or unroll the loop over four rotors
    if lifted == 0:
        return stepped(state, speeds, rotors, dt, around, 0, row, wing, deflection)
    if lifted == 4:
        return stepped(state, speeds, rotors, dt, around, 4, row, wing, deflection)
    return stepped(state, speeds, rotors, dt, around, lifted, row, wing, deflection)


@func
def stepped(
    state: State,
    speeds: Speeds,
    rotors: Stages,
    dt: float,
    around: Surroundings,
    lifted: int,
    row: np.record,
    wing: Any,
    deflection: Any,
) -> State:
    """Do the step of `rk4` with `lifted` rotors in ground effect."""
    k1 = slope_of(state, speeds[0], rotors[0], around, lifted, row, wing, deflection)
    k2 = slope_of(
        advance_state(state, 0.5 * dt, k1),
        speeds[1],
        rotors[1],
        around,
        lifted,
        row,
        wing,
        deflection,
    )
    k3 = slope_of(
        advance_state(state, 0.5 * dt, k2),
        speeds[1],
        rotors[1],
        around,
        lifted,
        row,
        wing,
        deflection,
    )
    k4 = slope_of(
        advance_state(state, dt, k3), speeds[2], rotors[2], around, lifted, row, wing, deflection
    )
    # k1 + 2 k2 + 2 k3 + k4
    total = advance_state(k1, 2.0, k2)
    total = advance_state(total, 2.0, k3)
    total = advance_state(total, 1.0, k4)
    # One normalisation is enough, as the stages hardly leave the unit sphere
    position, quaternion, velocity, rates = advance_state(state, dt / 6.0, total)
    return position, normalise_quaternion(quaternion), velocity, rates


@func
def lag_stages(parameters: np.ndarray, w: int, dt: float, decay: np.ndarray) -> None:
    """Write the decay factors of the rotor lag of each drone of a world into `decay` (N, 6).

    They are pairs (for rotors that speed up, and that slow down) after 0, dt / 2 and dt.
    """
    for i in range(decay.shape[0]):
        row = parameters[w, i]
        # Most drones of a world have the same motors as the previous drone
        last = parameters[w, max(i - 1, 0)]
        if i > 0 and row.lag_up == last.lag_up and row.lag_down == last.lag_down:
            for k in range(6):
                decay[i, k] = decay[i - 1, k]
        else:
            for stage in range(3):
                elapsed = 0.5 * stage * dt
                up, down = lag_decay(elapsed, row)
                decay[i, 2 * stage] = up
                decay[i, 2 * stage + 1] = down


@func
def turn_rotors(
    speed: np.ndarray,
    command: np.ndarray,
    supply: float,
    ratio: np.ndarray,
    decay: np.ndarray,
    row: np.record,
    speeds: Speeds,
    num_panels: int = 0,
) -> Stages:
    """Advance the rotor speeds of a drone towards their commands by one substep.

    Args:
        speed: (R,) rotor speeds, rad/s; updated.
        command: (R,) commanded speeds, rad/s.
        supply: Fraction of the commanded speeds that the rotors reach.
        ratio: (R,) further such factor of each rotor.
        decay: (6,) decay factors of the drone, from `lag_stages`.
        row: Row of `PARAMETERS`.
        speeds: Rotor speeds at the begin, middle and end of the substep, rad/s; written.
        num_panels: Number of panels of its wings.

    Returns:
        Wrench of the rotors at the begin, middle and end of the substep; zeros for an aircraft with
        wings, see `winged_wrench`.
    """
    begin, middle, end = speeds
    at_begin = (decay[0], decay[1])
    at_middle = (decay[2], decay[3])
    at_end = (decay[4], decay[5])
    rate = lag_rates(row)
    winding0 = winding1 = winding2 = 0.0
    for rotor in range(row.num_rotors):
        now = speed[rotor]
        wanted = supply * (ratio[rotor] * command[rotor])
        begin[rotor] = rotor_speed_after(now, wanted, at_begin)
        middle[rotor] = rotor_speed_after(now, wanted, at_middle)
        end[rotor] = rotor_speed_after(now, wanted, at_end)
        speed[rotor] = end[rotor]
        # The speed error, and with it the acceleration, decays exponentially with the lag
        turn = row.rotor_turn[rotor] * rotor_acceleration(begin[rotor], wanted, rate)
        faster = wanted > now
        winding0 += turn
        winding1 += turn * where(faster, at_middle[0], at_middle[1])
        winding2 += turn * where(faster, at_end[0], at_end[1])
    if num_panels > 0:
        zero = 0.0 * supply
        nothing = (zero, (zero, zero, zero), zero, zero)
        return nothing, nothing, nothing
    return (
        rotor_wrench(begin, winding0, row),
        rotor_wrench(middle, winding1, row),
        rotor_wrench(end, winding2, row),
    )
