"""Hold a Crazyflie at a target in wind with a custom PID controller.

Shows the loop of an airspace: read the state, compute, command, step. The controller reads the
state of the drone, and commands roll, pitch and thrust at 240 Hz. Its integral term compensates the
wind, so that there is no steady-state error. Prints the error each second, and the maximum of the
last second.

Run it (it has no options):

    python examples/own_pid.py

Takes 5 s, most of it for the start.
"""

import numpy as np

import bulletuav
from bulletuav import SetpointLevel

airframe = bulletuav.load_airframe("cf2x")
airspace = bulletuav.Airspace(
    [(0.0, 0.0, 1.0)], airframe, wind=(2.0, 0.0, 0.0), rotor_speed=airframe.hover_speed()
)
target, gravity = np.array((1.0, -1.0, 1.5)), np.array((0.0, 0.0, 9.80665))
integral, errors = np.zeros(3), []
while airspace.time < 8:
    position, velocity = airspace.swarm.position[0], airspace.swarm.velocity[0]
    error = target - position
    # Anti-windup: bound the integral on the way to the target
    integral = np.clip(integral + error * airspace.period, -0.3, 0.3)
    # Desired specific force: its direction is the attitude, its norm the thrust per kilogram
    force = 5.0 * error + 5.0 * integral - 4.0 * velocity + gravity
    size = np.linalg.norm(force)
    roll, pitch = -np.arcsin(force[1] / size), np.arctan2(force[0], force[2])
    airspace.command(0, SetpointLevel.ATTITUDE, (roll, pitch, 0.0, airframe.mass * size))
    airspace.step()
    errors.append(np.linalg.norm(target - airspace.swarm.position[0]))

for second in range(1, 9):
    print(f"after {second} s the error is {100 * errors[240 * second - 1]:.1f} cm")
print(f"in the last second the error is {100 * max(errors[-240:]):.1f} cm at most")
airspace.close()
