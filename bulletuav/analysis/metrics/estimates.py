"""Means of metrics over episodes, with their 95 % confidence intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.analysis.metrics.standard import RATES

RESAMPLES = 2000
"""Resamples of the bootstrap"""


class Estimate(NamedTuple):
    """Mean of a metric over episodes, with its 95 % confidence interval.

    Attributes:
        mean: Mean over the episodes that have the metric; NaN where none has it.
        low: Lower end of the interval.
        high: Upper end of the interval.
        episodes: How many episodes have the metric.
    """

    mean: float
    low: float
    high: float
    episodes: int


def estimate(metric: str, values: Sequence[float]) -> Estimate:
    """Estimate the mean of a metric over episodes.

    Args:
        metric: Its name. Those of `RATES` get Wilson's interval, others that of `mean_estimate`.
        values: Its value in each episode; NaN, of other metrics than rates, where it has none.

    Returns:
        The mean with its interval.
    """
    # SciPy's statistics take longer to import than everything else.
    from scipy import stats

    if metric not in RATES:
        return mean_estimate(values)
    sample = np.array(values)
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

    The resamples are always the same, so that the same values give the same interval.

    Args:
        values: Numbers, of which NaN are left out.

    Returns:
        The mean with its interval; NaN, with 0 episodes, where no number is left.
    """
    from scipy import stats

    sample = np.array([value for value in values if not np.isnan(value)])
    if not len(sample):
        return Estimate(np.nan, np.nan, np.nan, 0)
    # The bootstrap would warn of a sample without any spread.
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
