"""Rigid-body model of the nano-drone benchmark, and its fit by least squares on rollouts.

The laws are those of `rigid_body`, with measured rotor speeds. Constants of the airframe and of the
measurement are fitted together: gains of the rotors, a torque bias, clock offsets, biases and
tilts. All flights share them, as the protocol gives nothing else about a held-out flight.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from bulletuav.geometry.quaternions import multiply_quaternions
from bulletuav.identification.constants import BY_NAME, Constant
from bulletuav.identification.errors import conjugate, with_constants
from bulletuav.identification.fit import DIFFERENCE_STEP
from bulletuav.identification.rollout import Legs, Track, compute_accelerations, roll_out
from bulletuav.reproduction.nanodrone_protocol import NUM_STEPS, STEP, NanodroneWindows
from bulletuav.reproduction.rotation_vectors import from_rotation_vectors, to_rotation_vectors
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wakes import Wakes

CHUNK = 1000
"""Number of windows that are predicted together"""
FIT_HORIZONS = np.array([1, 3, 6, 10, 15, 20, 30, 40, 50])
"""Samples whose errors are fitted"""
MAX_RESIDUAL = 1e3
"""Bound of residuals, for trial constants whose predictions diverge"""
FIRST_SCALE = 3.0
"""Scale of the soft L1 loss of a first fit, from which the fit with the objective's scale starts"""
TOLERANCE_OF_FIT = 1e-5
"""Relative change of the cost, or of the constants, at which a fit ends"""
NO_TILT = (0.0, 0.0, 0.0, 1.0)

MEASUREMENT_UNITS = {
    "gain_1": 0.02,
    "gain_2": 0.02,
    "gain_3": 0.02,
    "delay": 0.01,
    "torque_x": 1e-4,
    "torque_y": 1e-4,
    "torque_z": 2e-5,
    "tilt_x": 0.02,
    "tilt_y": 0.02,
    "gyro_x": 0.05,
    "gyro_y": 0.05,
    "gyro_z": 0.05,
    "attitude_offset": 0.01,
    "velocity_offset": 0.01,
    "position_offset": 0.01,
    "lift": 0.02,
}
"""Further fitted constants, and the unit in which each is fitted: thrust gains of rotors 1 to 3
(that of rotor 4 balances them), delay of the rotor speeds (s), torque bias (N m), tilt of the
measured body (rad), gyroscope bias (rad/s), clock offsets of attitude, velocity and position (s),
and translational lift (s^2/m^2)
"""


def _rotor_inertia(airframe: Airframe, value: float) -> Airframe:
    return dataclasses.replace(airframe, rotor_inertia=value)


def _body_drag(airframe: Airframe, value: float) -> Airframe:
    return dataclasses.replace(airframe, body_drag=(value, value))


AIRFRAME_CONSTANTS = {
    **{
        name: BY_NAME[name]
        for name in (
            "thrust_coefficient",
            "torque_ratio",
            "drag_xy",
            "drag_z",
            "drag_height",
            "inertia_x",
            "inertia_y",
            "damping_x",
            "damping_y",
            "damping_z",
        )
    },
    "rotor_inertia": Constant(
        "rotor_inertia", "", "kg m^2", lambda one: one.rotor_inertia, _rotor_inertia, 4e-8, 0, 0.0
    ),
    "body_drag": Constant(
        "body_drag", "", "m^2", lambda one: one.body_drag[0], _body_drag, 1e-3, 0, 0.0
    ),
}
"""Fitted constants of the airframe"""
INERTIA = ("inertia_x", "inertia_y")
BIASES = ("gain_1", "gain_2", "gain_3", "torque_x", "torque_y", "torque_z", "tilt_x", "tilt_y")
GYRO = ("gyro_x", "gyro_y", "gyro_z")
CLOCKS = ("attitude_offset", "velocity_offset", "position_offset")


class NanodroneModel(NamedTuple):
    """A model of the drone and its measurements.

    Attributes:
        airframe: The airframe.
        measurement: Values of `MEASUREMENT_UNITS`; those that are missing are 0.
    """

    airframe: Airframe
    measurement: dict[str, float]


class FitObjective(NamedTuple):
    """Weights of the errors in a fit.

    Attributes:
        scale: Weighted error above which the soft L1 loss grows less than quadratically.
        velocity: Weight of velocities relative to the other quantities.
        decay: Exponent by which weights decrease with the horizon.
    """

    scale: float
    velocity: float
    decay: float


def predict_states(
    model: NanodroneModel, windows: NanodroneWindows, horizons: np.ndarray
) -> np.ndarray:
    """Predict what is measured in windows.

    Args:
        model: The model.
        windows: K windows.
        horizons: H numbers of samples, ascending, from 1 to 50.

    Returns:
        Predicted states, (K, H, 13).
    """
    starts = range(0, len(windows.state), CHUNK)
    return np.concatenate([_predict_chunk(model, windows, horizons, k) for k in starts])


def _predict_chunk(
    model: NanodroneModel, windows: NanodroneWindows, horizons: np.ndarray, first: int
) -> np.ndarray:
    """Predict the windows of one chunk, (K, H, 13)."""
    own = {name: model.measurement.get(name, 0.0) for name in MEASUREMENT_UNITS}
    start = windows.state[first : first + CHUNK, 0]
    count = len(start)
    speed = shift_speeds(windows.speed[first : first + CHUNK], own["delay"])
    gains = 1.0 + np.array([own["gain_1"], own["gain_2"], own["gain_3"], 0.0])
    gains[3] -= gains[:3].sum() - 3.0
    # A rotor's thrust is proportional to the square of its speed
    speed = speed * np.sqrt(np.maximum(gains, 0.0))
    parameters = parameter_rows([model.airframe])[None]
    begin = to_body_state(start, speed[:, 0], own, parameters)
    # Legs begin at every 51st sample; measured states are read there only
    rows = (NUM_STEPS + 1) * np.arange(count)
    track = np.zeros((count * (NUM_STEPS + 1), 13))
    track[rows] = begin
    states = np.empty((count, NUM_STEPS, 13))
    roll_out(
        Legs(rows, NUM_STEPS, 1, False, True),
        Track(
            track[:, :3].copy(),
            track[:, 3:7].copy(),
            track[:, 7:10].copy(),
            track[:, 10:].copy(),
            np.zeros((0, 3)),
        ),
        np.zeros((len(track), 4)),
        speed.reshape(-1, 4),
        NO_TILT,
        (own["torque_x"], own["torque_y"], own["torque_z"]),
        parameters,
        0.0,
        STANDARD_GRAVITY,
        STEP,
        Wakes.of(1, 1),
        states,
        own["lift"],
    )
    kept = states[:, horizons - 1].reshape(-1, 13)
    measured = to_measured_state(kept, speed[:, horizons].reshape(-1, 4), own, parameters)
    return measured.reshape(count, len(horizons), 13)


def shift_speeds(speed: np.ndarray, delay: float) -> np.ndarray:
    """Return rotor speeds at the 51 samples of windows, some time after they were measured.

    Args:
        speed: Measured speeds at the first 50 samples, (K, 50, 4), rad/s.
        delay: Delay of the speeds against their measurement, s.

    Returns:
        Speeds (K, 51, 4), linear between samples. Outside of the 50 samples, the nearest applies:
        a window gives no others.
    """
    last = NUM_STEPS - 1
    at = np.clip(np.arange(NUM_STEPS + 1) - delay / STEP, 0.0, last)
    below = np.minimum(at.astype(int), last - 1)
    part = (at - below)[:, None]
    shifted: np.ndarray = (1.0 - part) * speed[:, below] + part * speed[:, below + 1]
    return shifted


def to_body_state(
    state: np.ndarray, speed: np.ndarray, own: dict[str, float], parameters: np.ndarray
) -> np.ndarray:
    """Return the states (K, 13) of the drone's body at the time of measured states (K, 13).

    Clocks are corrected to first order: positions by the velocity, velocities by the model's
    acceleration, attitudes by the body rates.
    """
    found = state.copy()
    found[:, 10:] -= [own["gyro_x"], own["gyro_y"], own["gyro_z"]]
    turn = from_rotation_vectors(own["attitude_offset"] * found[:, 10:])
    tilt = from_rotation_vectors(np.array([own["tilt_x"], own["tilt_y"], 0.0]))
    found[:, 3:7] = multiply_quaternions(multiply_quaternions(state[:, 3:7], tilt), turn)
    found[:, 7:10] += own["velocity_offset"] * _accelerations(found, speed, own, parameters)
    found[:, :3] += own["position_offset"] * found[:, 7:10]
    return found


def to_measured_state(
    state: np.ndarray, speed: np.ndarray, own: dict[str, float], parameters: np.ndarray
) -> np.ndarray:
    """Return the measured states (K, 13) of states (K, 13) of the body; see `to_body_state`."""
    found = state.copy()
    found[:, :3] -= own["position_offset"] * state[:, 7:10]
    found[:, 7:10] -= own["velocity_offset"] * _accelerations(state, speed, own, parameters)
    turn = from_rotation_vectors(-own["attitude_offset"] * state[:, 10:])
    tilt = from_rotation_vectors(-np.array([own["tilt_x"], own["tilt_y"], 0.0]))
    found[:, 3:7] = multiply_quaternions(multiply_quaternions(state[:, 3:7], turn), tilt)
    found[:, 10:] += [own["gyro_x"], own["gyro_y"], own["gyro_z"]]
    return found


def _accelerations(
    state: np.ndarray, speed: np.ndarray, own: dict[str, float], parameters: np.ndarray
) -> np.ndarray:
    """Return the accelerations (K, 3) of the model in states (K, 13)."""
    found = np.empty((len(state), 3))
    compute_accelerations(state, speed, parameters, STANDARD_GRAVITY, own["lift"], found)
    return found


def fit_nanodrone_model(
    windows: NanodroneWindows,
    start: NanodroneModel,
    names: Sequence[str],
    objective: FitObjective,
    unit: np.ndarray,
    max_iterations: int,
    progress: Callable[[], None] = lambda: None,
) -> NanodroneModel:
    """Fit constants by least squares with a soft L1 loss on errors of predictions.

    Args:
        windows: Windows of training flights.
        start: The initial model.
        names: Names of `AIRFRAME_CONSTANTS` and `MEASUREMENT_UNITS` to fit.
        objective: Weights of the errors.
        unit: Errors by which errors are divided, (len(FIT_HORIZONS), 4).
        max_iterations: Maximum number of iterations of each of the two fits.
        progress: Callback after each prediction of all windows.

    Returns:
        The fitted model.
    """
    constants = [AIRFRAME_CONSTANTS[name] for name in names if name in AIRFRAME_CONSTANTS]
    others = [name for name in names if name in MEASUREMENT_UNITS]
    weights = np.array([1.0, objective.velocity, 1.0, 1.0]) / unit
    weights *= (FIT_HORIZONS[:, None] / FIT_HORIZONS[-1]) ** -objective.decay
    weight = np.repeat(weights, 3, axis=1)
    true = windows.state[:, FIT_HORIZONS]

    def unpack(theta: np.ndarray) -> NanodroneModel:
        airframe = with_constants(start.airframe, constants, theta[: len(constants)])
        values = theta[len(constants) :]
        fitted = {
            name: float(value) * MEASUREMENT_UNITS[name]
            for name, value in zip(others, values, strict=True)
        }
        return NanodroneModel(airframe, {**start.measurement, **fitted})

    def differences(predicted: np.ndarray) -> np.ndarray:
        turn = multiply_quaternions(conjugate(true[..., 3:7]), predicted[..., 3:7])
        return np.concatenate(
            [
                predicted[..., :3] - true[..., :3],
                predicted[..., 7:10] - true[..., 7:10],
                to_rotation_vectors(turn),
                predicted[..., 10:] - true[..., 10:],
            ],
            axis=-1,
        )

    def residuals(theta: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):  # trial constants may diverge
            predicted = predict_states(unpack(theta), windows, FIT_HORIZONS)
            errors = differences(predicted)
        progress()
        found = np.nan_to_num(weight * errors, nan=MAX_RESIDUAL)
        return np.asarray(np.clip(found, -MAX_RESIDUAL, MAX_RESIDUAL).ravel())

    def jacobian(theta: np.ndarray) -> np.ndarray:
        base = residuals(theta)
        slopes = np.empty((len(base), len(theta)))
        for k in range(len(theta)):
            moved = theta.copy()
            moved[k] += DIFFERENCE_STEP
            slopes[:, k] = (residuals(moved) - base) / DIFFERENCE_STEP
        return slopes

    theta = np.array(
        [one.encode(start.airframe) for one in constants]
        + [start.measurement.get(name, 0.0) / MEASUREMENT_UNITS[name] for name in others]
    )
    # Far from the solution, large errors must count: a small scale alone converges slowly
    for scale in (FIRST_SCALE, objective.scale):
        theta = least_squares(
            residuals,
            theta,
            jac=jacobian,
            loss="soft_l1",
            f_scale=scale,
            ftol=TOLERANCE_OF_FIT,
            xtol=TOLERANCE_OF_FIT,
            max_nfev=max_iterations,
        ).x
    return unpack(theta)
