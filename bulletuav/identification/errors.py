"""How far predicted flights are from those that were measured."""

from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.rotation import exponential
from bulletuav.identification.constants import Constant
from bulletuav.identification.flight import LoggedFlight
from bulletuav.identification.rollout import STATE_SIZE, Legs, roll_out, simulate_rotors
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wakes import Wakes

STATES_PER_LEG = 5
"""States of a leg that are compared with the log"""
FREE_LEGS_PER_WINDOW = 2
"""Legs without guidance in a window: attitudes diverge sooner than positions"""
TORQUE_BIAS_UNIT = 0.01
"""Unit of the torque bias, in weights times arm"""
TILT_UNIT = 0.01
"""Unit of the tilt, rad"""
DELAY_UNIT = 0.01
"""Unit of delays, s"""
GAIN_UNIT = 0.01
"""Unit of the thrust's gain"""
LOG_PARAMETERS = ("delay", "tilt_x", "tilt_y", "twist_x", "twist_y", "twist_z", "gain")
"""What is fitted for each log by itself: its clock, how the body whose attitude was measured is
tilted, torques of an uneven drone, and how strong its motors are on that day"""
LOG_PARAMETER_STD = 5.0
"""How large they usually are, in their units"""
NUM_LOG_PARAMETERS = len(LOG_PARAMETERS)


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of predictions in windows of one log.

    Attributes:
        translation: (K, PICKS, 6) of position (m) and velocity (m/s), attitude as measured.
        rotation: (K, TURNS * PICKS, 6) of attitude (rad, body axes) and rates (rad/s).
    """

    translation: np.ndarray
    rotation: np.ndarray


def with_constants(airframe: Airframe, constants: list[Constant], theta: np.ndarray) -> Airframe:
    """Return an airframe with other constants, given by the numbers that are fitted."""
    for constant, number in zip(constants, theta, strict=True):
        airframe = constant.replace(airframe, constant.decode(float(number)))
    return airframe


def make_legs(flight: LoggedFlight, windows: np.ndarray) -> tuple[Legs, Legs]:
    """Return the legs with guidance and those without of some windows.

    Args:
        flight: The flight.
        windows: (K,) indices of windows, of `flight.windows`.
    """
    start = flight.windows[windows]
    stride = max(flight.steps // STATES_PER_LEG, 1)
    half = max(flight.steps // (FREE_LEGS_PER_WINDOW * STATES_PER_LEG), 1)
    turns = start[:, None] + flight.steps // FREE_LEGS_PER_WINDOW * np.arange(FREE_LEGS_PER_WINDOW)
    return Legs(start, STATES_PER_LEG, stride, True), Legs(
        turns.ravel(), STATES_PER_LEG, half, False
    )


@dataclass(frozen=True)
class _RotorInputs:
    """What flies the legs of a log.

    Attributes:
        command: (n, R) rotor speeds that are commanded, rad/s.
        speed: (n, R) rotor speeds, rad/s.
        parameters: (1, N) rows of `PARAMETERS`.
        hover_speed: Rotor speed of another drone, rad/s.
        offsets: (7,) the log's own numbers.
        twist: Torque of an uneven drone, N m.
    """

    command: np.ndarray
    speed: np.ndarray
    parameters: np.ndarray
    hover_speed: float
    log_parameters: np.ndarray
    torque_bias: tuple[float, float, float]


def _make_inputs(
    flight: LoggedFlight, airframe: Airframe, log_parameters: np.ndarray
) -> _RotorInputs:
    """Let the rotors of an airframe follow the commands of a log."""
    command = flight.commands(airframe, DELAY_UNIT * log_parameters[0])
    other = len(flight.track.other) > 0
    parameters = parameter_rows([airframe] * (1 + other))[None]
    gain = 1.0 + GAIN_UNIT * log_parameters[6]
    parameters["thrust_coefficient"][0, 0] *= gain
    parameters["torque_coefficient"][0, 0] *= gain
    speed = np.empty_like(command)
    simulate_rotors(command, parameters[0, 0], flight.dt, speed)
    unit = TORQUE_BIAS_UNIT * airframe.mass * STANDARD_GRAVITY * airframe.arm
    torque_bias = (unit * log_parameters[3], unit * log_parameters[4], unit * log_parameters[5])
    return _RotorInputs(
        command, speed, parameters, airframe.hover_speed(), log_parameters, torque_bias
    )


def _predict(flight: LoggedFlight, legs: Legs, inputs: _RotorInputs) -> np.ndarray:
    """Return the states (L, picks, 13) that legs lead to."""
    states = np.empty((len(legs.start), legs.num_states, STATE_SIZE))
    roll_out(
        legs,
        flight.track,
        inputs.command,
        inputs.speed,
        tilt_quaternion(inputs.log_parameters),
        inputs.torque_bias,
        inputs.parameters,
        inputs.hover_speed,
        STANDARD_GRAVITY,
        flight.dt,
        Wakes.of(*inputs.parameters.shape),
        states,
    )
    return states


def tilt_quaternion(log_parameters: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion from the drone's body to the one whose attitude was measured."""
    return exponential((TILT_UNIT * log_parameters[1], TILT_UNIT * log_parameters[2], 0.0))


def compute_differences(
    flight: LoggedFlight, legs: Legs, states: np.ndarray, log_parameters: np.ndarray
) -> np.ndarray:
    """Return by how much predicted states differ from the measured ones.

    Returns:
        (L, picks, 12) differences of position, velocity, attitude (rotation vector in body axes),
        and rates.
    """
    at = legs.start[:, None] + legs.stride * np.arange(1, legs.num_states + 1)
    track = flight.track
    measured = multiply_quaternions(track.quaternion[at], np.array(tilt_quaternion(log_parameters)))
    off = multiply_quaternions(conjugate(measured), states[..., 3:7])
    # Twice the vector part: the rotation vector of small turns, of the shorter way
    turn = 2 * off[..., :3] * np.where(off[..., 3:] < 0, -1.0, 1.0)
    return np.concatenate(
        [
            states[..., :3] - track.position[at],
            states[..., 7:10] - track.velocity[at],
            turn,
            states[..., 10:] - track.rates[at],
        ],
        axis=-1,
    )


def multiply_quaternions(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the products p q of quaternions (..., 4)."""
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    scalar = p[..., 3:] * q[..., 3:] - np.sum(p[..., :3] * q[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse of unit quaternions (..., 4)."""
    inverse: np.ndarray = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return inverse


def compute_errors(
    flight: LoggedFlight, windows: np.ndarray, airframe: Airframe, log_parameters: np.ndarray
) -> PredictionErrors:
    """Predict windows of a flight, and compare with what was measured.

    Args:
        flight: The flight.
        windows: (K,) indices of its windows.
        airframe: The airframe.
        offsets: (7,) the log's own numbers.
    """
    guided, free = make_legs(flight, windows)
    inputs = _make_inputs(flight, airframe, log_parameters)
    translation = compute_differences(
        flight, guided, _predict(flight, guided, inputs), log_parameters
    )
    rotation = compute_differences(flight, free, _predict(flight, free, inputs), log_parameters)
    return PredictionErrors(translation[..., :6], rotation[..., 6:].reshape(len(windows), -1, 6))


def compute_naive_errors(flight: LoggedFlight, windows: np.ndarray) -> PredictionErrors:
    """Return the errors of predicting that velocity and rates stay what they are."""
    guided, free = make_legs(flight, windows)
    found = []
    for legs in (guided, free):
        track = flight.track
        lapse = flight.dt * legs.stride * np.arange(1, legs.num_states + 1)
        velocity = track.velocity[legs.start][:, None]
        rates = track.rates[legs.start][:, None]
        angle = rates * lapse[:, None]
        size = np.linalg.norm(angle, axis=-1, keepdims=True)
        turn = np.concatenate([0.5 * np.sinc(size / (2 * np.pi)) * angle, np.cos(size / 2)], -1)
        same = np.ones((1, legs.num_states, 1))
        states = np.concatenate(
            [
                track.position[legs.start][:, None] + velocity * lapse[:, None],
                multiply_quaternions(track.quaternion[legs.start][:, None], turn),
                velocity * same,
                rates * same,
            ],
            axis=-1,
        )
        found.append(compute_differences(flight, legs, states, np.zeros(NUM_LOG_PARAMETERS)))
    return PredictionErrors(found[0][..., :6], found[1][..., 6:].reshape(len(windows), -1, 6))
