"""Short rollouts from measured states under logged commands, with the `rigid_body` dynamics."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, in_memory, kernel
from bulletuav.dynamics.base import Air, surroundings
from bulletuav.dynamics.integration import Speeds, Stages, lag_stages, rk4, turn_rotors
from bulletuav.geometry.rotation import Quat4, Quat4Like, Vec3, point, product
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import lag_decay, rotor_speed_after, rotor_wrench
from bulletuav.vehicle.swarm import Swarm, get_state, set_state
from bulletuav.vehicle.wakes import Wakes, sum_wakes

STATE_SIZE = 13
"""Size of a state: position, quaternion, velocity, rates"""
NO_TILT = (0.0, 0.0, 0.0, 1.0)
"""Quaternion of a body that is measured without tilt"""


class Track(NamedTuple):
    """Measurements of a log, equally spaced in time, on the clock of the attitude.

    Attributes:
        position: (n, 3) world, m.
        quaternion: (n, 4) body to world.
        velocity: (n, 3) world, m/s.
        rates: (n, 3) body axes, rad/s.
        other: (n, 3) position of a drone above, m; (0, 3) for none.
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    other: np.ndarray


class Legs(NamedTuple):
    """Sections of a log to simulate.

    Attributes:
        start: Index of the first sample of each leg, (K,).
        num_states: Number of states of each leg that are kept.
        stride: Number of steps between these states.
        guided: Whether attitude and rates are reset to the measured ones after every step.
        measured: Whether rotor speeds are measured: they are interpolated between samples, and
            commands have no effect. A leg then needs the speed after its last step.
    """

    start: np.ndarray
    num_states: int
    stride: int
    guided: bool
    measured: bool = False


@kernel
def simulate_rotors(command: np.ndarray, row: np.record, dt: float, speed: np.ndarray) -> None:
    """Simulate the rotor speeds over a whole log by first-order lags.

    Args:
        command: Commanded rotor speeds from each sample on, (n, R), rad/s.
        row: Row of `PARAMETERS`.
        dt: Sample interval, s.
        speed: Output: rotor speeds at each sample, (n, R); the first equal the first commands.
    """
    decay = lag_decay(dt, row)
    for r in range(command.shape[1]):
        now = command[0, r]
        for k in range(command.shape[0]):
            speed[k, r] = now
            now = rotor_speed_after(now, command[k, r], decay)


@func
def _measured_attitude(quaternion: np.ndarray, k: int, tilt: Quat4Like) -> Quat4:
    """Return the measured attitude k, corrected by the tilt of the measured body."""
    measured = quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3]
    return product(measured, tilt)


@func
def _measured_rotors(
    speed: np.ndarray, k: int, dt: float, row: ParameterRow, speeds: Speeds
) -> Stages:
    """Return the wrenches of rotors whose speeds were measured at samples k and k + 1.

    Speeds are linear in between; see `turn_rotors` for `speeds`.
    """
    begin, middle, end = speeds
    winding = 0.0
    for r in range(row.num_rotors):
        begin[r] = speed[k, r]
        end[r] = speed[k + 1, r]
        middle[r] = 0.5 * (begin[r] + end[r])
        winding += row.rotor_turn[r] * ((end[r] - begin[r]) / dt)
    return (
        rotor_wrench(begin, winding, row),
        rotor_wrench(middle, winding, row),
        rotor_wrench(end, winding, row),
    )


@allocating
def roll_out(
    legs: Legs,
    track: Track,
    command: np.ndarray,
    speed: np.ndarray,
    tilt: Quat4Like,
    torque_bias: Vec3,
    parameters: np.ndarray,
    thrust_speed: float,
    gravity: float,
    dt: float,
    wakes: Wakes,
    states: np.ndarray,
) -> None:
    """Simulate legs of a log from measured states, with the commands or speeds of the log.

    Args:
        legs: The legs.
        track: The measurements.
        command: Commanded rotor speeds from each sample on, (n, R), rad/s.
        speed: Rotor speeds at each sample, (n, R), see `simulate_rotors`.
        tilt: Quaternion from the drone's body to the body whose attitude was measured.
        torque_bias: Constant torque, body axes, N m.
        parameters: Rows of `PARAMETERS` of the drone, and of the other drone if any, (1, N).
        thrust_speed: Rotor speed of the other drone, rad/s.
        gravity: Gravitational acceleration, m/s^2, downwards.
        dt: Time step, s.
        wakes: Work arrays for the wakes of N drones.
        states: Output: predicted positions, quaternions, velocities and rates, (K, num_states, 13).
    """
    num_drones = parameters.shape[1]
    num_rotors = command.shape[1]
    swarm = Swarm(
        np.zeros((1, num_drones, 3)),
        np.zeros((1, num_drones, 4)),
        np.zeros((1, num_drones, 3)),
        np.zeros((1, num_drones, 3)),
        np.full((1, num_drones, num_rotors), thrust_speed),
        np.zeros((1, num_drones, 0)),
    )
    air = Air(
        np.zeros((1, num_drones, 3)),
        np.zeros((1, num_drones)),
        gravity,
        np.zeros((1, num_drones, 3)),
        np.zeros((1, num_drones, 3)),
        np.ones((1, num_drones)),
        np.ones((1, num_drones, num_rotors)),
        np.full((1, num_drones), gravity),
    )
    for k in range(3):
        air.torque[0, 0, k] = torque_bias[k]
    for i in range(num_drones):
        swarm.quaternion[0, i, 3] = 1.0
    alive = np.ones((1, num_drones), dtype=np.bool_)
    wanted = np.zeros((num_drones, num_rotors))
    decay = np.empty((num_drones, 6))
    speeds = (np.empty(num_rotors), np.empty(num_rotors), np.empty(num_rotors))
    lag_stages(parameters, 0, dt, decay)
    row = parameters[0, 0]
    for leg in range(legs.start.size):
        first = legs.start[leg]
        begin = (
            point(track.position, first),
            _measured_attitude(track.quaternion, first, tilt),
            point(track.velocity, first),
            point(track.rates, first),
        )
        set_state(swarm, 0, 0, begin)
        for r in range(num_rotors):
            swarm.rotor_speed[0, 0, r] = speed[first, r]
        for step in range(legs.num_states * legs.stride):
            now = first + step
            if num_drones > 1:
                for k in range(3):
                    swarm.position[0, 1, k] = track.other[now, k]
                sum_wakes(in_memory(swarm), alive, parameters, 0, 1, False, 0.0, in_memory(wakes))
            for r in range(num_rotors):
                wanted[0, r] = command[now, r]
            if legs.measured:
                rotors = _measured_rotors(speed, now, dt, row, speeds)
            else:
                motors = (1.0, air.rotor_ratio[0, 0])
                rotors = turn_rotors(
                    swarm.rotor_speed[0, 0], wanted[0], *motors, decay[0], row, speeds
                )
            before = get_state(swarm, 0, 0)
            around = surroundings(air, 0, 0, wakes.felt[0])
            state = rk4(before, speeds, rotors, dt, around, row, None, None)
            if legs.guided:
                measured = _measured_attitude(track.quaternion, now + 1, tilt)
                state = (state[0], measured, state[2], point(track.rates, now + 1))
            set_state(swarm, 0, 0, state)
            if (step + 1) % legs.stride == 0:
                pick = step // legs.stride
                for k in range(3):
                    states[leg, pick, k] = state[0][k]
                    states[leg, pick, 7 + k] = state[2][k]
                    states[leg, pick, 10 + k] = state[3][k]
                for k in range(4):
                    states[leg, pick, 3 + k] = state[1][k]


def make_track(states: np.ndarray) -> Track:
    """Return the measurements of a drone alone.

    Args:
        states: Measured states, (n, 13).
    """
    series = (*np.split(states, [3, 7, 10], axis=1), np.zeros((0, 3)))
    return Track(*map(np.ascontiguousarray, series))


def predict_legs(
    legs: Legs,
    track: Track,
    command: np.ndarray,
    speed: np.ndarray,
    parameters: np.ndarray,
    dt: float,
    tilt: Quat4Like = NO_TILT,
    torque_bias: Vec3 = (0.0, 0.0, 0.0),
    thrust_speed: float = 0.0,
) -> np.ndarray:
    """Return the states (K, num_states, 13) of legs in standard gravity; see `roll_out`."""
    states = np.empty((len(legs.start), legs.num_states, STATE_SIZE))
    roll_out(
        legs,
        track,
        command,
        speed,
        tilt,
        torque_bias,
        parameters,
        thrust_speed,
        STANDARD_GRAVITY,
        dt,
        Wakes.of(*parameters.shape),
        states,
    )
    return states
