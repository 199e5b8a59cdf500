"""Savitzky-Golay smoothing of logged signals, and body rates from attitudes."""

import numpy as np
from scipy.signal import savgol_filter


def savgol_window(seconds: float, dt: float, degree: int = 3) -> int:
    """Return the odd window length, in samples, that spans a time and fits the degree."""
    return max(degree + 1 + degree % 2, 2 * round(0.5 * seconds / dt) + 1)


def compute_body_rates(time: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Compute body rates from attitudes: twice the vector part of q* dq/dt.

    Args:
        time: Times, (n,), s; nearly equally spaced.
        quaternion: Unit quaternions, body to world, (n, 4), without sign changes.

    Returns:
        Body rates, (n, 3), rad/s.
    """
    dt = float(np.median(np.diff(time)))
    slope = savgol_filter(quaternion, savgol_window(0.07, dt), 3, deriv=1, delta=dt, axis=0)
    x, y, z, w = quaternion.T
    dx, dy, dz, dw = slope.T
    return 2 * np.stack(
        [
            w * dx - x * dw - y * dz + z * dy,
            w * dy - y * dw - z * dx + x * dz,
            w * dz - z * dw - x * dy + y * dx,
        ],
        axis=1,
    )


def savgol_smooth(values: np.ndarray, seconds: float, dt: float, degree: int = 3) -> np.ndarray:
    """Smooth each column by local polynomials (Savitzky-Golay filter).

    Args:
        values: Samples at equally spaced times, (n, ...).
        seconds: Duration of the filter window, s.
        dt: Sample interval, s.
        degree: Degree of the polynomials.

    Returns:
        Smoothed samples, (n, ...).

    References:
        A. Savitzky, M. Golay, Smoothing and differentiation of data by simplified least squares
        procedures, Analytical Chemistry 36, 1964.
    """
    smoothed: np.ndarray = savgol_filter(values, savgol_window(seconds, dt, degree), degree, axis=0)
    return smoothed


def savgol_derivative(values: np.ndarray, seconds: float, dt: float, degree: int = 3) -> np.ndarray:
    """Return the time derivative of each column by local polynomials; see `savgol_smooth`."""
    found: np.ndarray = savgol_filter(
        values, savgol_window(seconds, dt, degree), degree, deriv=1, delta=dt, axis=0
    )
    return found
