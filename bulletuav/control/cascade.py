"""From a setpoint at any level down to rotor speeds, for one drone, in every physics substep."""

from typing import NamedTuple

import numpy as np

from bulletuav.control.lee import (
    acceleration_setpoint,
    desired_axes,
    force_setpoint,
    mix,
    rates_setpoint,
    torque_setpoint,
    velocity_setpoint,
)
from bulletuav.control.pid import MEMORY, pid_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.rotation import axes, dot, from_euler, quat4
from bulletuav.kernel import func
from bulletuav.vehicle.swarm import get

CONTROLLERS = {"lee": 0, "pid": 1}
PID = CONTROLLERS["pid"]
PID_LEVELS = (SetpointLevel.POSITION, SetpointLevel.VELOCITY, SetpointLevel.ROTOR)


class Cascade(NamedTuple):
    """A controller for all drones.

    controller (a value of `CONTROLLERS`); nominal (W, N) rows of `PARAMETERS` that it believes in; gains (W, N) rows of
    `GAINS`; memory (W, N, 6) integrals of the PID, zero at reset.
    """

    controller: int
    nominal: np.ndarray
    gains: np.ndarray
    memory: np.ndarray

    @classmethod
    def of(cls, controller: str, nominal: np.ndarray, gains: np.ndarray) -> "Cascade":
        """The named controller with empty memory."""
        return cls(CONTROLLERS[controller], nominal, gains, np.zeros((*gains.shape, MEMORY)))


@func
def lee_rotors(level, setpoint, state, total_speed, nominal, gain, gravity, command):
    """The steps of the Lee controller from `level` on."""
    position, quaternion, now, rates = state
    target, thrust, yaw = (setpoint[0], setpoint[1], setpoint[2]), setpoint[3], setpoint[3]
    velocity = now  # at which drag is compensated: the wanted one where there is one
    if level <= SetpointLevel.POSITION:
        target = velocity_setpoint(position, target, gain)
    if level <= SetpointLevel.VELOCITY:
        velocity = target
        target = acceleration_setpoint(now, target, gain)
    if level <= SetpointLevel.ATTITUDE:
        if level <= SetpointLevel.ACCELERATION:
            force = force_setpoint(
                target, quaternion, velocity, total_speed, gravity, nominal, gain
            )
            thrust = dot(force, axes(quaternion)[2])
            desired = desired_axes(force, yaw)
        else:
            desired = axes(from_euler(target[0], target[1], target[2]))
        target = rates_setpoint(quaternion, desired, gain)
    mix(thrust, torque_setpoint(rates, target, nominal, gain), nominal, gain, command)


@func
def pid_errors(level, setpoint, state):
    """Errors of position (m) and velocity (m/s) that the PID sees."""
    position, _, velocity, _ = state
    if level == SetpointLevel.POSITION:
        away = (setpoint[0] - position[0], setpoint[1] - position[1], setpoint[2] - position[2])
        return away, (-velocity[0], -velocity[1], -velocity[2])
    return (0.0, 0.0, 0.0), (
        setpoint[0] - velocity[0],
        setpoint[1] - velocity[1],
        setpoint[2] - velocity[2],
    )


@func
def command_kinematic(level, accelerates, setpoint, position, velocity, gain):
    """Velocity (m/s) for a `setpoint` at `level`, or acceleration (m/s^2) where that is wanted."""
    target = (setpoint[0], setpoint[1], setpoint[2])
    if level <= SetpointLevel.POSITION:
        target = velocity_setpoint(position, target, gain)
    if accelerates and level <= SetpointLevel.VELOCITY:
        target = acceleration_setpoint(velocity, target, gain)
    return target


@func
def command_rotors(level, setpoint, w, i, swarm, cascade, dt, gravity, command):
    """Rotor speeds (rad/s, into `command`) for a drone's setpoint at `level`; dt is the time since the last call, s."""
    controller, all_nominal, all_gains, memory = cascade
    nominal, gain, state = all_nominal[w, i], all_gains[w, i], get(swarm, w, i)
    if level == SetpointLevel.ROTOR:
        for r in range(nominal.num_rotors):
            command[r] = min(max(setpoint[w, i, r], 0.0), nominal.max_rotor_speed)
    elif controller == PID:
        target = quat4(setpoint, w, i)
        away, slow = pid_errors(level, target, state)
        integrals = (
            (memory[w, i, 0], memory[w, i, 1], memory[w, i, 2]),
            (memory[w, i, 3], memory[w, i, 4], memory[w, i, 5]),
        )
        integrals = pid_rotors(
            away,
            slow,
            target[3],
            state[1],
            state[3],
            integrals,
            dt,
            gravity,
            nominal,
            gain,
            command,
        )
        for k in range(3):
            memory[w, i, k], memory[w, i, 3 + k] = integrals[0][k], integrals[1][k]
    else:
        total_speed = 0.0
        for r in range(nominal.num_rotors):
            total_speed += swarm.rotor_speed[w, i, r]
        lee_rotors(
            level, quat4(setpoint, w, i), state, total_speed, nominal, gain, gravity, command
        )
