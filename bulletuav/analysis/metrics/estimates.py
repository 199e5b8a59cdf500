"""Means of metrics over episodes, with 95 % confidence intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.analysis.metrics.standard import RATES, SHARES

RESAMPLES = 2000
"""Number of bootstrap resamples"""


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
    # Imported here, as SciPy's statistics take longer to import than all other modules.
    from scipy import stats

    sample = np.array(values)
    is_extreme = metric in SHARES and (np.all(sample == 0) or np.all(sample == 1))
    if metric not in RATES and not is_extreme:
        return mean_estimate(values)
    happened = int(sample.sum())
    low, high = stats.binomtest(happened, len(sample)).proportion_ci(method="wilson")
    return Estimate(
        mean=float(sample.mean()),
        low=float(low),
        high=float(high),
        episodes=len(sample),
    )


def mean_estimate(values: Sequence[float]) -> Estimate:
    """Estimate a mean with the interval of the percentile bootstrap.

    The resampling seed is fixed, so that the same values give the same interval.

    Args:
        values: Numbers; NaN are ignored.

    Returns:
        The mean with its interval; NaN, with 0 episodes, if there are no numbers.
    """
    from scipy import stats

    sample = np.array([value for value in values if not np.isnan(value)])
    if not len(sample):
        return Estimate(np.nan, np.nan, np.nan, 0)
    # The bootstrap would warn about a constant sample.
    if np.ptp(sample) == 0:
        mean = float(sample[0])
        return Estimate(mean, mean, mean, len(sample))
    interval = stats.bootstrap(
        (sample,),
        np.mean,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Estimate(
        mean=float(sample.mean()),
        low=float(interval.low),
        high=float(interval.high),
        episodes=len(sample),
    )
