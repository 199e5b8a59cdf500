"""Protocol of the nano-drone identification benchmark: windows, errors, and its two plain models.

A model predicts 50 samples from a measured state, with the 50 rotor speeds of the window. Errors
are means over all windows of the held-out flights, for each horizon: Euclidean distances of
positions, velocities and body rates, and rotation angles of attitudes.

References:
    R. Busetto et al., Nonlinear system identification for a nano-drone benchmark, Control
    Engineering Practice 172, 2026. Errors as in `utils/metrics_utils.py` of their repository.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.quaternions import multiply_quaternions, rotate_vectors
from bulletuav.reproduction.flight_series import compute_state_errors
from bulletuav.reproduction.nanodrone_data import SAMPLE_RATE, NanodroneFlight

NUM_STEPS = 50
"""Number of predicted samples of a window"""
STEP = 1.0 / SAMPLE_RATE
"""Time between samples, s"""
BENCHMARK_GRAVITY = 9.81
BENCHMARK_MASS = 0.045
"""Mass of the benchmark's physical model, kg"""
BENCHMARK_THRUST = 3.72e-8
"""Its thrust coefficient, N s^2"""
BENCHMARK_MAX_THRUST = 2.0 * BENCHMARK_MASS * BENCHMARK_GRAVITY
"""Its maximum thrust, N"""


@dataclass(frozen=True)
class NanodroneWindows:
    """Consecutive windows of several flights.

    Attributes:
        state: States at the start of each window and at the 50 samples after it, (K, 51, 13).
        speed: Rotor speeds at the start and the 49 samples after it, (K, 50, 4), rad/s.
        run: Index of the flight of each window, (K,).
    """

    state: np.ndarray
    speed: np.ndarray
    run: np.ndarray


def cut_windows(
    flights: Sequence[NanodroneFlight], stride: int = 1, count: int | None = None
) -> NanodroneWindows:
    """Cut flights into windows.

    Args:
        flights: The flights.
        stride: Number of samples between the starts of windows.
        count: Number of windows of each flight, from its start; None for all.

    Returns:
        The windows. The last start of a flight is 51 samples before its end.
    """
    states, speeds, runs = [], [], []
    for run, flight in enumerate(flights):
        starts = np.arange(0, len(flight.state) - NUM_STEPS, stride)[:count]
        states.append(flight.state[starts[:, None] + np.arange(NUM_STEPS + 1)])
        speeds.append(flight.speed[starts[:, None] + np.arange(NUM_STEPS)])
        runs.append(np.full(len(starts), run))
    return NanodroneWindows(np.concatenate(states), np.concatenate(speeds), np.concatenate(runs))


def score_windows(predicted: np.ndarray, windows: NanodroneWindows) -> np.ndarray:
    """Compute the errors of each window and horizon as the benchmark's notebook does.

    The notebook reads the truth at horizon h from the window h - 1 rows further down, across the
    borders of runs: 49 windows before a border are compared with states of the next flight, and
    the last 49 windows are left out.

    Args:
        predicted: Predicted states, (K, 50, 13).
        windows: All windows of the held-out flights, in order.

    Returns:
        Errors, (K, 50, 4), NaN for windows that are left out.
    """
    errors = np.full((*predicted.shape[:2], 4), np.nan)
    first = windows.state[:, 1]
    for h in range(NUM_STEPS):
        kept = len(first) - h
        errors[:kept, h] = compute_state_errors(predicted[:kept, h], first[h:])
    return errors


def score_runs_apart(predicted: np.ndarray, windows: NanodroneWindows) -> np.ndarray:
    """Compute the errors (K, 50, 4) of each window against the states of its own flight."""
    return compute_state_errors(predicted, windows.state[:, 1:])


def summarise_errors(errors: np.ndarray) -> np.ndarray:
    """Return the mean errors after 1, 10 and 50 samples and the sum over all samples, (4, 4).

    Args:
        errors: Errors of K windows, (K, 50, 4); NaN are ignored.

    Returns:
        A row for position, velocity, rotation and rates.
    """
    return pick_columns(np.nanmean(errors, axis=0))


def pick_columns(means: np.ndarray) -> np.ndarray:
    """Return the columns of the table (..., 4, 4) of mean errors (..., 50, 4)."""
    kept = [means[..., h - 1, :] for h in (1, 10, NUM_STEPS)]
    return np.stack([*kept, means.sum(axis=-2)], axis=-1)


def hold_state(windows: NanodroneWindows) -> np.ndarray:
    """Predict that the state remains as it is (the benchmark's naive model)."""
    return np.repeat(windows.state[:, :1], NUM_STEPS, axis=1)


def predict_benchmark_physics(windows: NanodroneWindows) -> np.ndarray:
    """Predict with the benchmark's physical model: thrust, gravity and constant body rates.

    Rotor speeds are held between samples. The published code multiplies the angular acceleration
    by zero, so that neither torques nor the inertia have an effect.
    """
    state = windows.state[:, 0]
    thrust = np.minimum(BENCHMARK_THRUST * (windows.speed**2).sum(axis=-1), BENCHMARK_MAX_THRUST)
    rates = np.concatenate([state[:, 10:], np.zeros((len(state), 1))], axis=1)
    x, q, v = state[:, :3], state[:, 3:7], state[:, 7:10]
    predicted = np.empty((len(state), NUM_STEPS, 13))
    predicted[..., 10:] = state[:, None, 10:]
    down = np.array([0.0, 0.0, BENCHMARK_GRAVITY])
    for h in range(NUM_STEPS):
        up = np.zeros_like(v)
        up[:, 2] = thrust[:, h] / BENCHMARK_MASS

        def slopes(quaternion: np.ndarray, up: np.ndarray = up) -> tuple[np.ndarray, np.ndarray]:
            turning = 0.5 * multiply_quaternions(quaternion, rates)
            return turning, rotate_vectors(quaternion, up) - down

        # Classical Runge-Kutta; stages at unit quaternions, as in the benchmark
        q1, a1 = slopes(q)
        q2, a2 = slopes(_unit(q + 0.5 * STEP * q1))
        q3, a3 = slopes(_unit(q + 0.5 * STEP * q2))
        q4, a4 = slopes(_unit(q + STEP * q3))
        x = x + STEP * v + STEP**2 / 6 * (a1 + a2 + a3)
        v = v + STEP / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        q = _unit(q + STEP / 6 * (q1 + 2 * q2 + 2 * q3 + q4))
        predicted[:, h, :3], predicted[:, h, 3:7], predicted[:, h, 7:10] = x, q, v
    return predicted


def _unit(q: np.ndarray) -> np.ndarray:
    unit: np.ndarray = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return unit
