"""Custom metrics: a function, class or object each, in the user's own file.

A metric is called with (step, aviary) after every decision and returns one number for each world,
(W,). Its value in the last decision of a world's episode is the value of the episode; NaN means
that the episode has no value:

    def final_height(step, aviary):
        '''Height of the drones at the end, m, mean of the drones.'''
        return aviary.swarm.position[:, :, 2].mean(axis=1)

    bulletuav.evaluate("hover", metrics=(final_height,))

A metric with state is a class. It is instantiated for every batch of episodes, with the aviary
right after its reset:

    class TopSpeed:
        '''Highest speed of any drone, m/s.'''

        name = "top_speed"

        def __init__(self, aviary):
            self.top = np.zeros(aviary.num_worlds)

        def __call__(self, step, aviary):
            speed = np.linalg.norm(aviary.swarm.velocity, axis=-1).max(axis=1)
            self.top = np.maximum(self.top, speed)
            return self.top

A callable object, for example one with its own parameters, is copied for every batch. The drones
that flew the decision are `aviary.alive | step.terminated | step.truncated`.
"""

import copy
import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from bulletuav.analysis.metrics.standard import METRICS, StandardMetric
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.errors import as_sequence, shown
from bulletuav.registry import find

MetricFunction = Callable[[Step, Aviary], np.ndarray]
"""Function that returns one number for each world, (W,), after a decision"""
MetricSource = str | Callable[..., Any]
"""Name of a metric or `module:Name`, or the function, class or object itself"""
ROW_LABELS = ("episode", "seed")
"""Columns of an episode's row that are not metrics"""


class MetricSpec(NamedTuple):
    """Specification of a custom metric.

    Attributes:
        name: Name of its column.
        about: Description: the first line of its docstring, empty if it has none.
        source: The function, class or object that measures.
    """

    name: str
    about: str
    source: Callable[..., Any]

    def start(self, aviary: Aviary) -> MetricFunction:
        """Return a metric function for the episodes that the aviary's worlds start now."""
        is_class = inspect.isclass(self.source)
        made = self.source(aviary) if is_class else copy.deepcopy(self.source)
        return cast(MetricFunction, made)


def find_metric(source: MetricSource) -> MetricSpec | StandardMetric:
    """Find a metric.

    Args:
        source: Name of a registered metric, including entry points of the group `bulletuav.metric`;
            `module:Name`; or the function, class or object itself.

    Returns:
        The metric; a `StandardMetric` for the name of a standard one.

    Raises:
        ValueError: If there is no metric of this name (the message suggests the nearest), or it
            cannot be imported or called, or it has no name.
    """
    found = find("metric", source, _is_metric)
    if isinstance(found, StandardMetric):
        return found
    name = getattr(found, "name", None) or getattr(found, "__name__", None)
    # A registered name, such as that of an entry point, takes precedence over the object's own.
    if isinstance(source, str) and ":" not in source:
        name = source
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(
            f"name of metric {shown(found)} is {shown(name)}: a word is needed; "
            "use a named function, or an attribute `name`"
        )
    if name in METRICS or name in ROW_LABELS:
        raise ValueError(f"metric {name!r} is a standard metric already: choose another name")
    lines = (inspect.getdoc(found) or "").splitlines()
    return MetricSpec(name=name, about=lines[0] if lines else "", source=found)


def find_metrics(sources: Sequence[MetricSource]) -> tuple[MetricSpec, ...]:
    """Find the custom metrics to measure in addition to the standard ones.

    Args:
        sources: Metrics as for `find_metric`; standard ones may be among them.

    Returns:
        The metrics that are not standard, in their order.

    Raises:
        ValueError: If a metric cannot be found, two have the same name, or `sources` is not a list
            or tuple.
    """
    found = [find_metric(source) for source in as_sequence("metrics", sources)]
    # Standard metrics are always measured.
    specs = tuple(one for one in found if isinstance(one, MetricSpec))
    names = [spec.name for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"metric {name!r} is given twice: choose another name for one of them")
    return specs


def _is_metric(source: object) -> bool:
    """Return True if an object can be a metric."""
    return callable(source) or isinstance(source, StandardMetric)


class CustomMetric:
    """A custom metric, measured while the worlds of an aviary fly an episode each.

    Attributes:
        name: Name of the metric.
        values: Its values in the last decision of each world, (W,); NaN before the first decision.
    """

    def __init__(self, spec: MetricSpec, aviary: Aviary) -> None:
        """Start to measure, right after the aviary's reset."""
        self.name = spec.name
        self.values = np.full(aviary.num_worlds, np.nan)
        self._measure = spec.start(aviary)
        if not callable(self._measure):
            raise ValueError(
                f"metric {self.name!r} constructs {shown(self._measure)}: "
                "a class needs a method __call__(step, aviary)"
            )

    def record(self, step: Step, aviary: Aviary, flying: np.ndarray) -> None:
        """Record one decision.

        Args:
            step: Result of the decision.
            aviary: The worlds after the decision.
            flying: Worlds in which any drone flew the decision, (W,) bool; others keep their
                values.

        Raises:
            ValueError: If the metric does not return one number for each world.
        """
        given = self._measure(step, aviary)
        values = given if isinstance(given, np.ndarray) else np.asarray(None)
        if values.shape != flying.shape or values.dtype.kind not in "biuf":
            form = (
                f"an array {values.shape} of {values.dtype}"
                if isinstance(given, np.ndarray)
                else shown(given)
            )
            raise ValueError(
                f"metric {self.name!r} returned {form}: an array {flying.shape} of numbers, "
                "one for each world, is needed"
            )
        self.values = np.where(flying, values, self.values)
