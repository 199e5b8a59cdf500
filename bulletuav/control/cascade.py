"""The controller cascade from a setpoint at any level down to rotor speeds, for one drone.

Controllers are part of the compiled loop over drones. A new controller is therefore a function in
this module, a number in `CONTROLLERS` and a branch in `command_rotors`; users cannot pass one.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.autopilot import AUTOPILOT_MEMORY, Autopilot
from bulletuav.control.fixed_wing import fly_winged, has_autopilot, pause_loops
from bulletuav.control.gains import GainRow
from bulletuav.control.lee import (
    acceleration_setpoint,
    axes_along,
    force_setpoint,
    mix,
    nose,
    rates_setpoint,
    torque_setpoint,
    velocity_setpoint,
)
from bulletuav.control.observers import MEMORY, learned
from bulletuav.control.pid import pid_rotors
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.geometry.rotation import (
    Quat4,
    Quat4Like,
    Vec3,
    Vec3Like,
    axes,
    dot,
    from_euler,
    plus,
    quat4,
)
from bulletuav.vehicle.rotors import rotor_wrench
from bulletuav.vehicle.swarm import Swarm, get_state

LEE = 0
PID = 1
CONTROLLERS: Mapping[str, int] = MappingProxyType({"lee": LEE, "pid": PID})
"""Controllers by name, with their numbers in compiled code; read-only"""
PID_LEVELS = (SetpointLevel.POSITION, SetpointLevel.VELOCITY, SetpointLevel.ROTOR)
"""Setpoint levels that the PID accepts"""

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position (m), quaternion, velocity (m/s) and body rates (rad/s) of one drone"""


class Cascade(NamedTuple):
    """The controller of W worlds of N drones, with its gains and its state.

    Attributes:
        controller: A value of `CONTROLLERS`.
        nominal: (W, N) rows of `PARAMETERS`, the nominal parameters in the controller's model.
        gains: (W, N) rows of `GAINS`.
        memory: (W, N, M) integrals of the PID, or state of the observers, then that of the
            autopilot if there is one; zero at reset.
        integral: Whether the Lee controller estimates steady disturbance forces.
        autopilot: Controller of the aircraft with wings; None in a swarm without any.
    """

    controller: int
    nominal: np.ndarray
    gains: np.ndarray
    memory: np.ndarray
    integral: bool
    autopilot: Autopilot | None

    @classmethod
    def of(
        cls,
        controller: str,
        nominal: np.ndarray,
        gains: np.ndarray,
        integral: bool = False,
        autopilot: np.ndarray | None = None,
    ) -> "Cascade":
        """Create a controller with zero integrals and observer states.

        Args:
            controller: A name in `CONTROLLERS`.
            nominal: (W, N) rows of `PARAMETERS`.
            gains: (W, N) rows of `GAINS`.
            integral: Whether the Lee controller estimates steady disturbance forces.
            autopilot: (W, N) rows of `AUTOPILOT`, None in a swarm without wings.

        Returns:
            The controller, in still air.
        """
        size, pilot = MEMORY, None
        if autopilot is not None:
            size, pilot = (
                MEMORY + AUTOPILOT_MEMORY,
                Autopilot(autopilot, np.zeros((*gains.shape, 3))),
            )
        memory = np.zeros((*gains.shape, size))
        return cls(CONTROLLERS[controller], nominal, gains, memory, integral, pilot)

    def in_wind(self, wind: np.ndarray) -> "Cascade":
        """Return the controller with the wind (W, N, 3) that its airspeed sensors measure, m/s."""
        if self.autopilot is None:
            return self
        return self._replace(autopilot=self.autopilot._replace(wind=wind))


@func
def rates_of_motion(
    level: int,
    target: Vec3,
    ahead: Vec3Like,
    state: State,
    total_speed: float,
    push: Vec3,
    nominal: np.record,
    gain: GainRow,
    gravity: float,
) -> tuple[float, Vec3]:
    """Run the steps of the Lee controller from a position, velocity or acceleration to rates.

    Args:
        level: `SetpointLevel` of the setpoint, up to ACCELERATION.
        target: First three numbers of the setpoint.
        ahead: Horizontal direction of the yaw, see `nose`.
        state: State of the drone.
        total_speed: Sum of the drone's rotor speeds, rad/s.
        push: Acceleration by disturbances to compensate, m/s^2, world.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        Collective thrust, N, and body rates, rad/s.
    """
    position, quaternion, current_velocity, _ = state
    # Drag is compensated at the desired velocity if there is one, else at the current velocity.
    velocity = current_velocity
    if level <= SetpointLevel.POSITION:
        target = velocity_setpoint(position, target, gain)
    if level <= SetpointLevel.VELOCITY:
        velocity = target
        target = acceleration_setpoint(current_velocity, target, gain)
    # The rotors provide the desired acceleration less that by disturbances.
    wanted = plus(target, -1.0, push)
    force = force_setpoint(wanted, quaternion, velocity, total_speed, gravity, nominal, gain)
    # The thrust acts along the present z axis, not along the desired one
    thrust = dot(force, axes(quaternion)[2])
    return thrust, rates_setpoint(quaternion, axes_along(force, ahead), gain)


@func
def turn_by(
    thrust: float,
    target: Vec3,
    rates: Vec3,
    total_speed: float,
    twist: Vec3,
    nominal: np.record,
    gain: GainRow,
    command: np.ndarray,
) -> None:
    """Run the steps of the Lee controller from rates down to rotor speeds.

    Args:
        thrust: Collective thrust, N.
        target: Desired body rates, rad/s.
        rates: Body rates of the drone, rad/s.
        total_speed: Sum of the drone's rotor speeds, rad/s.
        twist: Disturbance torque to compensate, N m, body axes.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s; written.
    """
    torque = torque_setpoint(rates, target, total_speed, nominal, gain)
    mix(thrust, plus(torque, -1.0, twist), nominal, gain, command)


@func
def pid_errors(level: int, setpoint: Quat4Like, state: State) -> tuple[Vec3, Vec3]:
    """Compute the position and velocity errors of the PID.

    Args:
        level: POSITION or VELOCITY of `SetpointLevel`.
        setpoint: The setpoint's four numbers.
        state: State of the drone.

    Returns:
        Errors (target minus state) of position (m) and velocity (m/s). The target velocity of a
        position setpoint is zero, and the position error of a velocity setpoint is zero.
    """
    position, _, velocity, _ = state
    if level == SetpointLevel.POSITION:
        away = (setpoint[0] - position[0], setpoint[1] - position[1], setpoint[2] - position[2])
        return away, (-velocity[0], -velocity[1], -velocity[2])
    slow = (setpoint[0] - velocity[0], setpoint[1] - velocity[1], setpoint[2] - velocity[2])
    return (0.0, 0.0, 0.0), slow


@deferred(types.none)
@kernel
def step_pid(
    level: int,
    setpoint: Quat4Like,
    state: State,
    memory: np.ndarray,
    w: int,
    i: int,
    dt: float,
    gravity: float,
    nominal: np.record,
    gain: GainRow,
    command: np.ndarray,
) -> None:
    """Run the PID of one drone for one step, and advance its integrals.

    Args:
        level: POSITION or VELOCITY of `SetpointLevel`.
        setpoint: The setpoint's four numbers.
        state: State of the drone.
        memory: (W, N, M) integrals of all drones, the first six.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last step, s.
        gravity: Gravitational acceleration, m/s^2.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s, which is written.
    """
    position_error, velocity_error = pid_errors(level, setpoint, state)
    integrals = (
        (memory[w, i, 0], memory[w, i, 1], memory[w, i, 2]),
        (memory[w, i, 3], memory[w, i, 4], memory[w, i, 5]),
    )
    _, quaternion, _, rates = state
    integrals = pid_rotors(
        position_error,
        velocity_error,
        setpoint[3],
        quaternion,
        rates,
        integrals,
        dt,
        gravity,
        nominal,
        gain,
        command,
    )
    for k in range(3):
        memory[w, i, k] = integrals[0][k]
        memory[w, i, 3 + k] = integrals[1][k]


@deferred(types.none)
@kernel
def step_lee(
    level: int,
    setpoint: Quat4Like,
    state: State,
    speeds: np.ndarray,
    memory: np.ndarray,
    integral: bool,
    dt: float,
    gravity: float,
    nominal: np.record,
    gain: GainRow,
    command: np.ndarray,
) -> None:
    """Run the Lee controller from a setpoint level down to rotor speeds, with its observers.

    Args:
        level: `SetpointLevel` of the setpoint, above ROTOR.
        setpoint: The setpoint's four numbers.
        state: State of the drone.
        speeds: (R,) rotor speeds of the drone, rad/s.
        memory: (M,) state of the observers; updated.
        integral: Whether steady disturbance forces are estimated.
        dt: Time since the last step, s.
        gravity: Gravitational acceleration, m/s^2.
        nominal: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s, which is written.
    """
    # Estimate disturbances
    rotors = rotor_wrench(speeds, 0.0, nominal)
    total = rotors[2]
    push, twist = learned(state, rotors, memory, integral, dt, gravity, nominal, gain)
    # The first three numbers enter the cascade; the fourth is yaw or thrust, by the level.
    target = (setpoint[0], setpoint[1], setpoint[2])
    thrust = setpoint[3]
    if level <= SetpointLevel.ACCELERATION:
        ahead = nose(setpoint[3])
        thrust, target = rates_of_motion(
            level, target, ahead, state, total, push, nominal, gain, gravity
        )
    elif level == SetpointLevel.ATTITUDE:
        desired = axes(from_euler(target[0], target[1], target[2]))
        target = rates_setpoint(state[1], desired, gain)
    turn_by(thrust, target, state[3], total, twist, nominal, gain, command)


@func
def command_kinematic(
    level: int,
    accelerates: bool,
    setpoint: Quat4Like,
    position: Vec3Like,
    velocity: Vec3Like,
    gain: GainRow,
) -> Vec3:
    """Compute the command of a drone whose dynamics takes velocities or accelerations.

    Args:
        level: `SetpointLevel` of the setpoint, at or above what the drone takes.
        accelerates: Whether the drone takes an acceleration; else a velocity.
        setpoint: The setpoint's four numbers.
        position: Position of the drone, m, world.
        velocity: Velocity of the drone, m/s, world.
        gain: Row of `GAINS`.

    Returns:
        Velocity (m/s) or acceleration (m/s^2), world.
    """
    # The first steps are those of the Lee controller
    target = (setpoint[0], setpoint[1], setpoint[2])
    if level <= SetpointLevel.POSITION:
        target = velocity_setpoint(position, target, gain)
    if accelerates and level <= SetpointLevel.VELOCITY:
        target = acceleration_setpoint(velocity, target, gain)
    return target


@func
def command_rotors(
    cascade: Cascade,
    setpoints: Setpoints,
    swarm: Swarm,
    w: int,
    i: int,
    dt: float,
    gravity: float,
    command: np.ndarray,
) -> None:
    """Compute the rotor commands of one drone, and advance its controller's state.

    Args:
        cascade: The controller.
        setpoints: Setpoints of all drones.
        swarm: State of all drones.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        command: (R + S,) speed of each rotor, rad/s, and deflection of each control surface, rad,
            which are written.
    """
    # The controller's model has the nominal parameters, not the true ones
    nominal, gain, memory = cascade.nominal[w, i], cascade.gains[w, i], cascade.memory
    level, setpoint = setpoints.level[w, i], setpoints.value
    state = get_state(swarm, w, i)
    pilot = cascade.autopilot
    if level == SetpointLevel.ROTOR:
        # The setpoint is the command, clamped to the rotors' limits.
        for r in range(nominal.num_rotors):
            command[r] = min(max(setpoint[w, i, r], 0.0), nominal.max_rotor_speed)
        # Deflections are limited where the surfaces move
        for k in range(nominal.num_rotors, min(command.shape[0], setpoint.shape[2])):
            command[k] = setpoint[w, i, k]
        if has_autopilot(pilot, w, i):
            pause_loops(memory[w, i])
        return
    target, past = quat4(setpoint, w, i), memory[w, i]
    if fly_winged(pilot, level, target, state, past, w, i, dt, gravity, nominal, gain, command):
        return
    if cascade.controller == PID:
        step_pid(level, target, state, memory, w, i, dt, gravity, nominal, gain, command)
    else:
        speeds, learns = swarm.rotor_speed[w, i], cascade.integral
        step_lee(level, target, state, speeds, past, learns, dt, gravity, nominal, gain, command)
