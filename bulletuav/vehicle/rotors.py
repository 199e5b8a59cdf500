"""Rotors of one drone: first-order speed lag, thrust k_f w^2 and reaction torque k_m w^2.

Source: R. Mahony, V. Kumar, P. Corke, Multirotor Aerial Vehicles, IEEE RAM 2012.
`row` is one row of `airframe.PARAMETERS`.
"""

import math

from bulletuav.kernel import func

RPM = 2.0 * math.pi / 60.0  # rad/s


@func
def lag_decay(elapsed, row):
    """Share of the way to a command that is left after `elapsed` seconds, for rotors that speed up and that slow down."""
    up = math.exp(-elapsed / row.lag_up) if row.lag_up > 0.0 else 0.0
    if row.lag_down == row.lag_up:
        return up, up
    return up, math.exp(-elapsed / row.lag_down) if row.lag_down > 0.0 else 0.0


@func
def lagged(speed, command, decay):
    """Rotor speed on the way from `speed` to `command` (rad/s), exact for a constant command; `decay` from `lag_decay`."""
    return command + (speed - command) * (decay[0] if command > speed else decay[1])


@func
def rotor_wrench(speed, row):
    """Thrust (N), body torques (N m) and sum of the rotor speeds (R,), rad/s."""
    thrust = torque_x = torque_y = torque_z = total = 0.0
    for r in range(row.num_rotors):
        now = speed[r]
        force = row.thrust_coefficient * now * now
        thrust += force
        torque_x += row.rotor_y[r] * force
        torque_y -= row.rotor_x[r] * force
        torque_z += row.rotor_turn[r] * row.torque_coefficient * now * now
        total += now
    return thrust, (torque_x, torque_y, torque_z), total
