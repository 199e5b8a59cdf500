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
from bulletuav.control.levels import Level
from bulletuav.control.pid import MEMORY, pid_rotors
from bulletuav.kernel import kernel
from bulletuav.physics.rotation import axes, dot, from_euler

CONTROLLERS = {"lee": 0, "pid": 1}
PID = CONTROLLERS["pid"]
PID_LEVELS = (Level.POSITION, Level.VELOCITY, Level.ROTOR)


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


@kernel
def lee_rotors(level, setpoint, world, drone, swarm, nominal, gain, gravity, command):
    """The steps of the Lee controller from `level` on."""
    quaternion, rates = swarm.quaternion[world, drone], swarm.rates[world, drone]
    v = swarm.velocity[world, drone]
    velocity = (v[0], v[1], v[2])  # at which drag is compensated: the wanted one where there is one
    target = (setpoint[0], setpoint[1], setpoint[2])
    thrust = setpoint[3]
    if level <= Level.POSITION:
        target = velocity_setpoint(swarm.position[world, drone], target, gain)
    if level <= Level.VELOCITY:
        velocity = target
        target = acceleration_setpoint(v, target, gain)
    if level <= Level.ATTITUDE:
        if level <= Level.ACCELERATION:
            total_speed = swarm.rotor_speed[world, drone].sum()
            force = force_setpoint(target, quaternion, velocity, total_speed, gravity, nominal, gain)
            thrust = dot(force, axes(quaternion)[2])
            desired = desired_axes(force, setpoint[3])
        else:
            desired = axes(from_euler(setpoint[0], setpoint[1], setpoint[2]))
        target = rates_setpoint(quaternion, desired, gain)
    mix(thrust, torque_setpoint(rates, target, nominal, gain), nominal, gain, command)


@kernel
def command_kinematic(level, accelerates, setpoint, world, drone, swarm, cascade):
    """Velocity (m/s) for a `setpoint` row at `level`, or acceleration (m/s^2) where that is wanted."""
    gain, velocity = cascade.gains[world, drone], swarm.velocity[world, drone]
    target = (setpoint[0], setpoint[1], setpoint[2])
    if level <= Level.POSITION:
        target = velocity_setpoint(swarm.position[world, drone], target, gain)
    if accelerates and level <= Level.VELOCITY:
        target = acceleration_setpoint(velocity, target, gain)
    return target


@kernel
def command_rotors(level, setpoint, world, drone, swarm, cascade, dt, gravity, command):
    """Rotor speeds (rad/s, into `command`) for a `setpoint` row at `level`; dt is the time since the last call, s."""
    nominal, gain = cascade.nominal[world, drone], cascade.gains[world, drone]
    if level == Level.ROTOR:
        for r in range(nominal.num_rotors):
            command[r] = min(max(setpoint[r], 0.0), nominal.max_rotor_speed)
    elif cascade.controller == PID:
        target = (setpoint[0], setpoint[1], setpoint[2])
        velocity, position = swarm.velocity[world, drone], swarm.position[world, drone]
        away = (0.0, 0.0, 0.0)
        slow = (-velocity[0], -velocity[1], -velocity[2])
        if level == Level.POSITION:
            away = (target[0] - position[0], target[1] - position[1], target[2] - position[2])
        else:
            slow = (target[0] - velocity[0], target[1] - velocity[1], target[2] - velocity[2])
        quaternion, rates = swarm.quaternion[world, drone], swarm.rates[world, drone]
        memory = cascade.memory[world, drone]
        pid_rotors(away, slow, setpoint[3], quaternion, rates, memory, dt, gravity, nominal, gain, command)
    else:
        lee_rotors(level, setpoint, world, drone, swarm, nominal, gain, gravity, command)
