"""How users on the ground move: mobility models by name, all outdoors and in bounds.

Each model is a class in a module of its own, registered by `@register("mobility")`.
"""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import unknown
from bulletuav.network.mobility.base import Mobility
from bulletuav.registry import find, names

MobilitySource = str | Mapping[str, Any] | type[Mobility] | Mobility
"""A model by its name, as an object, or by a mapping of "model" and options to their values"""


def find_mobility(source: MobilitySource) -> Mobility:
    """Find a mobility model, or make one with given options.

    Args:
        source: A name, such as "gauss_markov"; `module:Name`; a class; or a model made already.
            A mapping has one of the first three under "model", and options of it, such as
            {"model": "gauss_markov", "deviation": 0.3}.

    Returns:
        The model.

    Raises:
        ValueError: There is no such model or option (the nearest names are told), or an option
            cannot have that value.
    """
    if isinstance(source, Mobility):
        return source
    options: dict[str, Any] = dict(source) if isinstance(source, Mapping) else {"model": source}
    model = _find_model(options.pop("model", None))
    # The fields of a model are its options
    known = {"model"} | {field.name for field in dataclasses.fields(model)}
    for name in options:
        if name not in known:
            label = getattr(model, "name", model.__name__)
            raise unknown(f"option of mobility model {label!r},", name, known)
    return model(**options)


def _find_model(source: Any) -> type[Mobility]:
    """Find the class of a model by its name, by `module:Name`, or as given."""
    # Messages of this room say "mobility model", those of the registry only its kind
    is_named = isinstance(source, str) and (":" in source or source in names("mobility"))
    if not is_named and not _is_model(source):
        raise unknown("mobility model", source, names("mobility"))
    model: type[Mobility] = find("mobility", source, _is_model)
    return model


def _is_model(candidate: Any) -> bool:
    """Tell whether an object is a class of mobility models that can be made."""
    is_class = isinstance(candidate, type) and issubclass(candidate, Mobility)
    return is_class and not inspect.isabstract(candidate)
