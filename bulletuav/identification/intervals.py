"""Robust confidence intervals for errors that correlate within a window and with its neighbours."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

LEVEL = 0.95
"""Confidence level of intervals"""
MAX_HALF_WIDTH = 0.69
"""Half width of a logarithm's interval above which a constant counts as not identified: the ends of
the interval are then a factor of 4 apart
"""


def quantile(count: int, numbers: int) -> float:
    """Return the half width of intervals in standard deviations (Student's t).

    Args:
        count: Number of fitted windows.
        numbers: Number of parameters that every window informs about.
    """
    return float(student.ppf(0.5 + LEVEL / 2, max(count - numbers, 1)))


@dataclass(frozen=True)
class Information:
    """Information of the windows about the parameters.

    Attributes:
        curves: Curvature of the loss of each window, (K, P, P) for each part.
        scores: Gradient of the loss of each window, (K, P) for each part.
        prior_curve: Curvature of the priors, (P,).
        prior_square: Squared gradients of the priors, (P,).
    """

    curves: list[np.ndarray]
    scores: list[np.ndarray]
    prior_curve: np.ndarray
    prior_square: np.ndarray

    def covariance(self, rest: np.ndarray) -> np.ndarray:
        """Return the robust covariance of some parameters, (F, F), while the others are fixed.

        Each window's score is corrected for the window's own leverage (jackknife), so that the
        intervals of few windows are wide enough.

        Args:
            rest: Indices of the parameters, (F,).

        References:
            R. Bell, D. McCaffrey, Bias reduction in standard errors for linear regression with
            multi-stage samples, Survey Methodology 2002.
        """
        grid = np.ix_(rest, rest)
        bread = np.diag(self.prior_curve[rest])
        for curves in self.curves:
            bread += curves.sum(axis=0)[grid]
        meat = np.diag(self.prior_square[rest])
        for curves, scores in zip(self.curves, self.scores, strict=True):
            without = bread - curves[:, rest][:, :, rest]
            own = (scores - scores.mean(axis=0))[:, rest, None]
            meat += newey_west((bread @ np.linalg.solve(without, own))[..., 0])
        inverse = np.linalg.inv(bread)
        covariance: np.ndarray = inverse @ meat @ inverse
        return covariance


def newey_west(scores: np.ndarray) -> np.ndarray:
    """Return the Newey-West covariance of a sum of autocorrelated scores (K, P)."""
    total: np.ndarray = scores.T @ scores
    reach = min(round(len(scores) ** (1 / 3)) + 1, len(scores) - 1)
    for lag in range(1, reach + 1):
        product = scores[lag:].T @ scores[:-lag]
        total = total + (1 - lag / (reach + 1)) * (product + product.T)
    return total
