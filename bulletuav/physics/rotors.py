"""Rotors of one drone: first-order speed lag, thrust k_f w^2 and reaction torque k_m w^2.

Source: R. Mahony, V. Kumar, P. Corke, Multirotor Aerial Vehicles, IEEE RAM 2012.
`row` is one row of `airframe.PARAMETERS`.
"""

import math

from bulletuav.kernel import kernel

RPM = 2.0 * math.pi / 60.0  # rad/s


@kernel
def lagged(speed, command, elapsed, row):
    """Rotor speed `elapsed` seconds after `command` (rad/s) was given, exact for a constant command."""
    lag = row.lag_up if command > speed else row.lag_down
    if lag <= 0.0:
        return command
    return command + (speed - command) * math.exp(-elapsed / lag)


@kernel
def rotor_wrench(speed, command, elapsed, row):
    """Thrust (N), body torques (N m) and sum of rotor speeds (rad/s), `elapsed` after the command."""
    thrust = torque_x = torque_y = torque_z = total = 0.0
    for r in range(row.num_rotors):
        now = lagged(speed[r], command[r], elapsed, row)
        force = row.thrust_coefficient * now * now
        thrust += force
        torque_x += row.rotor_y[r] * force
        torque_y -= row.rotor_x[r] * force
        torque_z += row.rotor_turn[r] * row.torque_coefficient * now * now
        total += now
    return thrust, (torque_x, torque_y, torque_z), total
