"""Metrics of an episode, and their estimates over many episodes.

The standard metrics of `METRICS` are measured in every evaluation by `Meter`. Custom metrics are
registered under the kind "metric": a function, a class or an object in the user's own file, see
`bulletuav.analysis.metrics.custom`.
"""

from bulletuav.analysis.metrics.custom import (
    ROW_LABELS,
    MetricSource,
    MetricSpec,
    find_metric,
    find_metrics,
)
from bulletuav.analysis.metrics.estimates import (
    Estimate,
    estimate,
    mean_estimate,
)
from bulletuav.analysis.metrics.formulas import jain, soonest_conflict
from bulletuav.analysis.metrics.meter import Meter
from bulletuav.analysis.metrics.standard import METRICS, RATES, StandardMetric

__all__ = [
    "METRICS",
    "RATES",
    "ROW_LABELS",
    "Estimate",
    "Meter",
    "MetricSource",
    "MetricSpec",
    "StandardMetric",
    "estimate",
    "find_metric",
    "find_metrics",
    "jain",
    "mean_estimate",
    "soonest_conflict",
]
