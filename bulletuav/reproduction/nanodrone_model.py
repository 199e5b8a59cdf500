"""Rigid-body model of the nano-drone benchmark, and its fit by least squares on rollouts.

The laws are those of `rigid_body`, with measured rotor speeds. Constants of the airframe and the
delay of the measured speeds are fitted together. All flights share them, as the protocol gives
nothing else about a held-out flight.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bulletuav.geometry.quaternions import multiply_quaternions
from bulletuav.identification.constants import BY_NAME, Constant
from bulletuav.identification.errors import conjugate, with_constants
from bulletuav.identification.fit import DIFFERENCE_STEP
from bulletuav.identification.rollout import NO_TILT, Legs, make_track, predict_legs
from bulletuav.reproduction.nanodrone_protocol import NUM_STEPS, STEP, NanodroneWindows
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.parameters import parameter_rows

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
DELAY = "delay"
"""Name of the delay of the rotor speeds among fitted constants"""
DELAY_SCALE = 0.01
"""Unit in which it is fitted, s"""


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


class NanodroneModel(NamedTuple):
    """A model of the drone and its measurements.

    Attributes:
        airframe: The airframe.
        delay: Delay of the rotor speeds against their measurement, s.
    """

    airframe: Airframe
    delay: float = 0.0


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
    start = windows.state[first : first + CHUNK, 0]
    count = len(start)
    speed = shift_speeds(windows.speed[first : first + CHUNK], model.delay)
    # Legs begin at every 51st sample; measured states are read there only
    rows = (NUM_STEPS + 1) * np.arange(count)
    track = np.zeros((count * (NUM_STEPS + 1), 13))
    track[rows] = start
    states = predict_legs(
        Legs(rows, NUM_STEPS, 1, guided=False, measured=True),
        make_track(track),
        np.zeros((len(track), 4)),
        speed.reshape(-1, 4),
        parameter_rows([model.airframe])[None],
        STEP,
    )
    return states[:, horizons - 1]


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


def weigh_errors(objective: FitObjective, unit: np.ndarray) -> np.ndarray:
    """Return the weights of the errors of position, velocity, rotation and rates, (H, 4).

    Args:
        objective: Weights relative to each other.
        unit: Errors by which errors are divided, (H, 4), H = len(FIT_HORIZONS).
    """
    weights = np.array([1.0, objective.velocity, 1.0, 1.0]) / unit
    decayed: np.ndarray = weights * (FIT_HORIZONS[:, None] / FIT_HORIZONS[-1]) ** -objective.decay
    return decayed


def fit_nanodrone_model(
    windows: NanodroneWindows,
    start: NanodroneModel,
    names: Sequence[str],
    objective: FitObjective,
    unit: np.ndarray,
    max_iterations: int,
) -> NanodroneModel:
    """Fit constants by least squares with a soft L1 loss on errors of predictions.

    Args:
        windows: Windows of training flights.
        start: The initial model.
        names: Names of `AIRFRAME_CONSTANTS` to fit, and `DELAY`.
        objective: Weights of the errors.
        unit: Errors by which errors are divided, (len(FIT_HORIZONS), 4).
        max_iterations: Maximum number of iterations of each of the two fits.

    Returns:
        The fitted model.
    """
    constants = [AIRFRAME_CONSTANTS[name] for name in names if name in AIRFRAME_CONSTANTS]
    has_delay = DELAY in names
    weight = np.repeat(weigh_errors(objective, unit), 3, axis=1)
    true = windows.state[:, FIT_HORIZONS]

    def unpack(theta: np.ndarray) -> NanodroneModel:
        airframe = with_constants(start.airframe, constants, theta[: len(constants)])
        delay = float(theta[-1]) * DELAY_SCALE if has_delay else start.delay
        return NanodroneModel(airframe, delay)

    def differences(predicted: np.ndarray) -> np.ndarray:
        turn = multiply_quaternions(conjugate(true[..., 3:7]), predicted[..., 3:7])
        # Attitudes that diverged count by the other errors, which diverged as well
        turn[~(np.abs(np.linalg.norm(turn, axis=-1) - 1.0) < 0.5)] = NO_TILT
        return np.concatenate(
            [
                predicted[..., :3] - true[..., :3],
                predicted[..., 7:10] - true[..., 7:10],
                Rotation.from_quat(turn).as_rotvec(),
                predicted[..., 10:] - true[..., 10:],
            ],
            axis=-1,
        )

    def residuals(theta: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):  # trial constants may diverge
            predicted = predict_states(unpack(theta), windows, FIT_HORIZONS)
            errors = differences(predicted)
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
        [one.encode(start.airframe) for one in constants] + [start.delay / DELAY_SCALE] * has_delay
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
