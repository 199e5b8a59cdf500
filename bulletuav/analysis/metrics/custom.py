"""Metrics of users: one function, class or object each, in a file of their own.

A metric is called with (step, aviary) after every decision and gives one number for each world,
(W,). What it gave in the last decision of a world's episode is the episode's value, NaN for none:

    def final_height(step, aviary):
        '''Height of the drones at the end, m, mean of the drones.'''
        return aviary.swarm.position[:, :, 2].mean(axis=1)

    bulletuav.evaluate("hover", metrics=(final_height,))

A metric that has to remember what was before is a class. For every batch of episodes it is made
anew, from the aviary right after its reset:

    class TopSpeed:
        '''Highest speed of any drone, m/s.'''

        name = "top_speed"

        def __init__(self, aviary):
            self.top = np.zeros(aviary.num_worlds)

        def __call__(self, step, aviary):
            speed = np.linalg.norm(aviary.swarm.velocity, axis=-1).max(axis=1)
            self.top = np.maximum(self.top, speed)
            return self.top

An object that can be called, such as one with parameters of its own, is copied for every batch.
The drones that flew the decision are `aviary.alive | step.terminated | step.truncated`.
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
"""One number for each world, (W,), after a decision"""
MetricSource = str | Callable[..., Any]
"""A metric by its name or as `module:Name`, or the function, class or object itself"""
ROW_LABELS = ("episode", "seed")
"""Columns of an episode's row that are no metrics"""


class MetricSpec(NamedTuple):
    """A metric before any episode begins.

    Attributes:
        name: Name of its column.
        about: What it is: the first line of its docstring, empty where it has none.
        source: The function, class or object that measures.
    """

    name: str
    about: str
    source: Callable[..., Any]

    def start(self, aviary: Aviary) -> MetricFunction:
        """Return what measures the episodes that the aviary's worlds now begin."""
        is_class = inspect.isclass(self.source)
        made = self.source(aviary) if is_class else copy.deepcopy(self.source)
        return cast(MetricFunction, made)


def find_metric(source: MetricSource) -> MetricSpec | StandardMetric:
    """Find a metric.

    Args:
        source: Name of a registered metric, also of an entry point of the group
            `bulletuav.metric`; `module:Name`; or the function, class or object itself.

    Returns:
        The metric; a `StandardMetric` for the name of one that is measured anyway.

    Raises:
        ValueError: There is none of that name (the nearest are told), it cannot be imported or
            called, or it has no name of its own.
    """
    found = find("metric", source, _is_metric)
    if isinstance(found, StandardMetric):
        return found
    name = getattr(found, "name", None) or getattr(found, "__name__", None)
    # A name of the registry, such as that of an entry point, wins over the object's own.
    if isinstance(source, str) and ":" not in source:
        name = source
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(
            f"name of metric {shown(found)} is {shown(name)}: a word is needed; "
            "use a named function, or an attribute `name`"
        )
    if name in METRICS or name in ROW_LABELS:
        raise ValueError(f"metric {name!r} is measured already: choose another name")
    lines = (inspect.getdoc(found) or "").splitlines()
    return MetricSpec(name=name, about=lines[0] if lines else "", source=found)


def find_metrics(sources: Sequence[MetricSource]) -> tuple[MetricSpec, ...]:
    """Find the metrics that are to be measured beside the standard ones.

    Args:
        sources: Metrics as `find_metric` takes them; standard ones may be among them.

    Returns:
        Those that are not standard, in their order.

    Raises:
        ValueError: One cannot be found, two have the same name, or `sources` is no list or tuple.
    """
    found = [find_metric(source) for source in as_sequence("metrics", sources)]
    # Standard metrics are measured anyway.
    specs = tuple(one for one in found if isinstance(one, MetricSpec))
    names = [spec.name for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"metric {name!r} is given twice: choose another name for one of them")
    return specs


def _is_metric(source: object) -> bool:
    """Tell whether an object can be a metric."""
    return callable(source) or isinstance(source, StandardMetric)


class CustomMetric:
    """One metric of a user, while the worlds of an aviary fly an episode each.

    Attributes:
        name: Name of the metric.
        values: What it gave in the last decision of each world, (W,); NaN before the first.
    """

    def __init__(self, spec: MetricSpec, aviary: Aviary) -> None:
        """Begin to measure, right after the aviary's reset."""
        self.name = spec.name
        self.values = np.full(aviary.num_worlds, np.nan)
        self._measure = spec.start(aviary)
        if not callable(self._measure):
            raise ValueError(
                f"metric {self.name!r} makes {shown(self._measure)}: "
                "a class needs a method __call__(step, aviary)"
            )

    def record(self, step: Step, aviary: Aviary, flying: np.ndarray) -> None:
        """Take one decision.

        Args:
            step: What the decision gave.
            aviary: The worlds after it.
            flying: Worlds in which some drone flew it, (W,) bool; others keep their values.

        Raises:
            ValueError: The metric gave something else than one number for each world.
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
                f"metric {self.name!r} gave {form}: an array {flying.shape} of numbers, "
                "one for each world, is needed"
            )
        self.values = np.where(flying, values, self.values)
