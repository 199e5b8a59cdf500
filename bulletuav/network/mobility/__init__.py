"""Mobility models of ground users, by name. All models keep users outdoors and in bounds.

Each model is a class in its own module, registered by `@register("mobility")`.
"""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import unknown
from bulletuav.network.mobility.base import Mobility
from bulletuav.registry import find, names

MobilitySource = str | Mapping[str, Any] | type[Mobility] | Mobility
"""Name, class or object of a model, or a mapping with "model" and options"""


def find_mobility(source: MobilitySource) -> Mobility:
    """Find a mobility model, and create it with the given options.

    Args:
        source: A name, such as "gauss_markov"; `module:Name`; a class; or a model object. A mapping
            contains one of the first three under "model", and options, such as {"model":
            "gauss_markov", "deviation": 0.3}.

    Returns:
        The model.

    Raises:
        ValueError: If there is no such model or option (the message suggests similar names), or a
            value is invalid.
    """
    if isinstance(source, Mobility):
        return source
    options: dict[str, Any] = dict(source) if isinstance(source, Mapping) else {"model": source}
    model = _find_model(options.pop("model", None))
    # The dataclass fields of a model are its options
    known = {"model"} | {field.name for field in dataclasses.fields(model)}
    for name in options:
        if name not in known:
            label = getattr(model, "name", model.__name__)
            raise unknown(f"option of mobility model {label!r},", name, known)
    return model(**options)


def _find_model(source: Any) -> type[Mobility]:
    """Find the class of a model by name, `module:Name`, or class."""
    # Messages say "mobility model"; those of the registry would say "mobility" only
    is_named = isinstance(source, str) and (":" in source or source in names("mobility"))
    if not is_named and not _is_model(source):
        raise unknown("mobility model", source, names("mobility"))
    model: type[Mobility] = find("mobility", source, _is_model)
    return model


def _is_model(candidate: Any) -> bool:
    """Return True if an object is a concrete class of mobility models."""
    is_class = isinstance(candidate, type) and issubclass(candidate, Mobility)
    return is_class and not inspect.isabstract(candidate)
