"""Means of metrics over episodes, with 95 % confidence intervals."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.analysis.metrics.standard import RATES, SHARES

RESAMPLES = 2000
"""Number of bootstrap resamples"""
TAIL = (1.0 - 0.95) / 2.0
"""Probability of each side outside an interval"""
NORMAL_QUANTILE = 1.959963984540054
"""Quantile of the standard normal distribution at 1 - `TAIL`"""


class Estimate(NamedTuple):
    """Mean of a metric over episodes, with its 95 % confidence interval.

    Attributes:
        mean: Mean over the episodes that have the metric; NaN if none has it.
        low: Lower end of the interval.
        high: Upper end of the interval.
        episodes: Number of episodes that have the metric.
    """

    mean: float
    low: float
    high: float
    episodes: int


def estimate(metric: str, values: Sequence[float]) -> Estimate:
    """Estimate the mean of a metric over episodes.

    Args:
        metric: Name of the metric. Rates (`RATES`) get Wilson's interval, and so do fractions of
            drones (`SHARES`) that are all 0 or all 1, for which the bootstrap would claim
            certainty. Other metrics get the interval of `mean_estimate`.
        values: Value of each episode; NaN, for metrics other than rates, if an episode has none.

    Returns:
        The mean with its interval.
    """
    sample = np.array(values)
    is_extreme = metric in SHARES and (np.all(sample == 0) or np.all(sample == 1))
    if metric not in RATES and not is_extreme:
        return mean_estimate(values)
    happened = int(sample.sum())
    low, high = wilson_interval(happened, len(sample))
    return Estimate(float(sample.mean()), low, high, len(sample))


def wilson_interval(happened: int, count: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a probability.

    References:
        R. G. Newcombe, Two-sided confidence intervals for the single proportion: comparison of
        seven methods (1998), method 3.

    Args:
        happened: Number of episodes in which the event happened.
        count: Number of episodes.
    """
    # Written out, as importing SciPy's statistics takes half a second
    rate, square = happened / count, NORMAL_QUANTILE**2
    scale = 2 * (count + square)
    center = (2 * count * rate + square) / scale
    half = NORMAL_QUANTILE / scale * math.sqrt(4 * count * rate * (1 - rate) + square)
    low = 0.0 if happened == 0 else center - half
    high = 1.0 if happened == count else center + half
    return low, high


def mean_estimate(values: Sequence[float]) -> Estimate:
    """Estimate a mean with the interval of the percentile bootstrap.

    The resampling seed is fixed, so that the same values give the same interval.

    Args:
        values: Numbers; NaN are ignored.

    Returns:
        The mean with its interval; NaN, with 0 episodes, if there are no numbers.
    """
    sample = np.array([value for value in values if not np.isnan(value)])
    if not len(sample):
        return Estimate(np.nan, np.nan, np.nan, 0)
    if np.ptp(sample) == 0:
        mean = float(sample[0])
        return Estimate(mean, mean, mean, len(sample))
    chosen = np.random.default_rng(0).integers(0, len(sample), (RESAMPLES, len(sample)))
    means = np.sort(sample[chosen].mean(axis=-1))
    low, high = _quantile(means, TAIL), _quantile(means, 1.0 - TAIL)
    return Estimate(float(sample.mean()), low, high, len(sample))


def _quantile(ordered: np.ndarray, probability: float) -> float:
    """Return a quantile of sorted numbers, interpolated linearly."""
    place = probability * len(ordered) + (1.0 - probability)
    whole = math.floor(place)
    part = place - whole
    return float((1.0 - part) * ordered[whole - 1] + part * ordered[whole])
