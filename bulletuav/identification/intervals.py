"""Intervals that hold for errors of any distribution, correlated within a window and near it."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

LEVEL = 0.95
"""Level of intervals"""
MAX_HALF_WIDTH = 0.69
"""Half of the length of a logarithm's interval from which on a log does not tell a constant: its
ends are a factor of 4 apart"""


def quantile(count: int, numbers: int) -> float:
    """Return how many standard deviations it is to the ends of intervals.

    Args:
        count: Windows that were fitted.
        numbers: Numbers that every window tells.
    """
    return float(student.ppf(0.5 + LEVEL / 2, max(count - numbers, 1)))


@dataclass(frozen=True)
class Information:
    """What windows tell about numbers.

    Attributes:
        curves: (K, P, P) curvature of the squares of each window's errors, of each part.
        scores: (K, P) their slopes, of each part.
        prior_curve: (P,) curvature of the priors.
        prior_square: (P,) squares of the slopes of the priors.
    """

    curves: list[np.ndarray]
    scores: list[np.ndarray]
    prior_curve: np.ndarray
    prior_square: np.ndarray

    def covariance(self, rest: np.ndarray) -> np.ndarray:
        """Return the robust covariance of some of the numbers, (F, F), while others are held.

        Each window counts as far as it would be off if it had not been fitted (jackknife: R. Bell,
        D. McCaffrey, Survey Methodology 2002), so that intervals of few windows are wide enough.

        Args:
            rest: (F,) indices of the numbers.
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
    """Return the covariance of a sum of scores (K, P) that are correlated with those near them."""
    total: np.ndarray = scores.T @ scores
    reach = min(round(len(scores) ** (1 / 3)) + 1, len(scores) - 1)
    for lag in range(1, reach + 1):
        product = scores[lag:].T @ scores[:-lag]
        total = total + (1 - lag / (reach + 1)) * (product + product.T)
    return total
