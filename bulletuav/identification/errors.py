"""Errors of predicted flights against the measured ones."""

from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.quaternions import multiply_quaternions
from bulletuav.geometry.rotation import exp_map
from bulletuav.identification.constants import Constant
from bulletuav.identification.flight import LoggedFlight
from bulletuav.identification.motor_gains import motor_speed_ratios
from bulletuav.identification.rollout import Legs, Track, predict_legs, simulate_rotors
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import parameter_rows

STATES_PER_LEG = 5
"""Number of predicted states of a leg that are compared with the log"""
FREE_LEGS_PER_WINDOW = 2
"""Number of legs without guidance in a window: attitudes diverge sooner than positions"""
TORQUE_BIAS_UNIT = 0.01
"""Unit of the torque bias, in weight times arm length"""
TILT_UNIT = 0.01
"""Unit of the tilt, rad"""
DELAY_UNIT = 0.01
"""Unit of delays, s"""
GAIN_UNIT = 0.01
"""Unit of the thrust gain"""
LOG_PARAMETERS = (
    "delay",
    "tilt_x",
    "tilt_y",
    "twist_x",
    "twist_y",
    "twist_z",
    "gain",
    "position_delay",
    "velocity_delay",
)
"""Nuisance parameters that are fitted for each log: the delay of commands, the tilt of the measured
body against the drone's body, the torque bias of an asymmetric drone, the thrust gain, and on
request the delays of positions and velocities behind the attitude
"""
CLOCKS = ("position_delay", "velocity_delay")
"""Parameters that are fitted on request only"""
LOG_PARAMETER_STD = 5.0
"""Prior standard deviation of the per-log parameters, in their units"""
NUM_LOG_PARAMETERS = len(LOG_PARAMETERS)


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of predictions in K windows of one log.

    Attributes:
        translation: Errors of position (m) and velocity (m/s), (K, STATES_PER_LEG, 6), predicted
            with the measured attitude.
        rotation: Errors of attitude (rad, body axes) and body rates (rad/s),
            (K, FREE_LEGS_PER_WINDOW * STATES_PER_LEG, 6).
    """

    translation: np.ndarray
    rotation: np.ndarray


def with_constants(airframe: Airframe, constants: list[Constant], theta: np.ndarray) -> Airframe:
    """Return a copy of the airframe with the constants that a parameter vector encodes."""
    for constant, number in zip(constants, theta, strict=True):
        airframe = constant.replace(airframe, constant.decode(float(number)))
    return airframe


def make_legs(flight: LoggedFlight, windows: np.ndarray) -> tuple[Legs, Legs]:
    """Return the guided legs and the free legs of some windows.

    Args:
        flight: The flight.
        windows: Indices into `flight.windows`, (K,).

    Returns:
        One guided leg and `FREE_LEGS_PER_WINDOW` free legs per window.
    """
    start = flight.windows[windows]
    stride = max(flight.steps // STATES_PER_LEG, 1)
    half = max(flight.steps // (FREE_LEGS_PER_WINDOW * STATES_PER_LEG), 1)
    turns = start[:, None] + flight.steps // FREE_LEGS_PER_WINDOW * np.arange(FREE_LEGS_PER_WINDOW)
    return Legs(start, STATES_PER_LEG, stride, True, flight.measured), Legs(
        turns.ravel(), STATES_PER_LEG, half, False, flight.measured
    )


@dataclass(frozen=True)
class _RotorInputs:
    """Inputs of the rollouts of one log.

    Attributes:
        command: Commanded rotor speeds, (n, R), rad/s; measured ones if there are any.
        speed: Rotor speeds, (n, R), rad/s.
        parameters: Rows of `PARAMETERS`, (1, N).
        hover_speed: Rotor speed of the other drone, rad/s.
        log_parameters: Per-log parameters, (9,), see `LOG_PARAMETERS`.
        torque_bias: Torque of an asymmetric drone, body axes, N m.
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
    """Simulate the rotors of an airframe under the commands of a log, or read their speeds."""
    delay = DELAY_UNIT * log_parameters[0]
    read = flight.measured_speeds if flight.measured else flight.commands
    command = read(airframe, delay) * motor_speed_ratios(airframe)
    other = len(flight.track.other) > 0
    parameters = parameter_rows([airframe] * (1 + other))[None]
    gain = 1.0 + GAIN_UNIT * log_parameters[6]
    parameters["thrust_coefficient"][0, 0] *= gain
    parameters["torque_coefficient"][0, 0] *= gain
    speed = command
    if not flight.measured:
        speed = np.empty_like(command)
        simulate_rotors(command, parameters[0, 0], flight.dt, speed)
    unit = TORQUE_BIAS_UNIT * airframe.mass * STANDARD_GRAVITY * airframe.arm
    torque_bias = (unit * log_parameters[3], unit * log_parameters[4], unit * log_parameters[5])
    return _RotorInputs(
        command, speed, parameters, airframe.hover_speed(), log_parameters, torque_bias
    )


def _predict(flight: LoggedFlight, track: Track, legs: Legs, inputs: _RotorInputs) -> np.ndarray:
    """Return the predicted states (L, num_states, 13) of the legs."""
    return predict_legs(
        legs,
        track,
        inputs.command,
        inputs.speed,
        inputs.parameters,
        flight.dt,
        tilt_quaternion(inputs.log_parameters),
        inputs.torque_bias,
        inputs.hover_speed,
    )


def aligned_track(flight: LoggedFlight, log_parameters: np.ndarray) -> Track:
    """Return the measurements of a flight on the attitude's clock; see `LOG_PARAMETERS`."""
    return flight.align_track(DELAY_UNIT * log_parameters[7], DELAY_UNIT * log_parameters[8])


def tilt_quaternion(log_parameters: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion from the drone's body to the body whose attitude was measured."""
    return exp_map((TILT_UNIT * log_parameters[1], TILT_UNIT * log_parameters[2], 0.0))


def compute_differences(
    track: Track, legs: Legs, states: np.ndarray, log_parameters: np.ndarray
) -> np.ndarray:
    """Return predicted states minus measured states.

    Args:
        track: The measurements.
        legs: The L legs that were predicted.
        states: Predicted states, (L, num_states, 13).
        log_parameters: Per-log parameters, (9,).

    Returns:
        Differences of position, velocity, attitude (rotation vector in body axes) and body rates,
        (L, num_states, 12).
    """
    at = legs.start[:, None] + legs.stride * np.arange(1, legs.num_states + 1)
    measured = multiply_quaternions(track.quaternion[at], np.array(tilt_quaternion(log_parameters)))
    off = multiply_quaternions(conjugate(measured), states[..., 3:7])
    # Twice the vector part is the rotation vector of a small rotation; the sign selects the
    # shorter rotation
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


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverses of unit quaternions (..., 4)."""
    inverse: np.ndarray = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return inverse


def compute_errors(
    flight: LoggedFlight, windows: np.ndarray, airframe: Airframe, log_parameters: np.ndarray
) -> PredictionErrors:
    """Predict windows of a flight and compare the predictions with the measurements.

    Args:
        flight: The flight.
        windows: Indices of its windows, (K,).
        airframe: The airframe to simulate.
        log_parameters: Per-log parameters, (9,).

    Returns:
        The errors.
    """
    guided, free = make_legs(flight, windows)
    inputs = _make_inputs(flight, airframe, log_parameters)
    track = aligned_track(flight, log_parameters)
    translation, rotation = (
        compute_differences(track, legs, _predict(flight, track, legs, inputs), log_parameters)
        for legs in (guided, free)
    )
    return PredictionErrors(translation[..., :6], rotation[..., 6:].reshape(len(windows), -1, 6))


def compute_naive_errors(flight: LoggedFlight, windows: np.ndarray) -> PredictionErrors:
    """Return the errors of a naive prediction with constant velocity and body rates."""
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
        found.append(compute_differences(flight.track, legs, states, np.zeros(NUM_LOG_PARAMETERS)))
    return PredictionErrors(found[0][..., :6], found[1][..., 6:].reshape(len(windows), -1, 6))
