"""Rates from attitudes, and smoothing of what was measured."""

import numpy as np
from scipy.signal import savgol_filter


def savgol_window(seconds: float, dt: float, degree: int = 3) -> int:
    """Return the odd number of samples that spans a time, enough for a polynomial of a degree."""
    return max(degree + 1 + degree % 2, 2 * round(0.5 * seconds / dt) + 1)


def compute_body_rates(time: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return the body rates (n, 3) of attitudes (n, 4): twice the vector part of q* dq/dt, rad/s.

    Args:
        time: (n,) times, s; close to even.
        quaternion: (n, 4) unit quaternions without changes of sign.
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
    """Smooth columns by local polynomials (A. Savitzky, M. Golay, 1964).

    Args:
        values: (n, ...) values at even times.
        seconds: Time that a polynomial spans, s.
        dt: Time between samples, s.
        degree: Degree of the polynomials.
    """
    smoothed: np.ndarray = savgol_filter(values, savgol_window(seconds, dt, degree), degree, axis=0)
    return smoothed


def savgol_derivative(values: np.ndarray, seconds: float, dt: float, degree: int = 3) -> np.ndarray:
    """Return the derivatives of columns by local polynomials; see `savgol_smooth`."""
    found: np.ndarray = savgol_filter(
        values, savgol_window(seconds, dt, degree), degree, deriv=1, delta=dt, axis=0
    )
    return found
