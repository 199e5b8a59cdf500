"""How users on the ground move: models by name, all outdoors and in bounds."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import choose, unknown
from bulletuav.network.mobility.base import Mobility
from bulletuav.network.mobility.gauss_markov import GaussMarkov
from bulletuav.network.mobility.hotspot import Hotspot
from bulletuav.network.mobility.manhattan import Manhattan
from bulletuav.network.mobility.still import Still
from bulletuav.network.mobility.waypoint import Waypoint

MOBILITY_MODELS: dict[str, type[Mobility]] = {
    model.name: model for model in (Still, GaussMarkov, Manhattan, Hotspot, Waypoint)
}
MobilitySource = str | Mapping[str, Any] | Mobility
"""A model by its name, by a mapping of "model" to its name and options to their values, or made already"""


def find_mobility(source: MobilitySource) -> Mobility:
    """The model of that name, or with those options: {"model": "gauss_markov", "deviation": 0.3}.

    Raises ValueError with the nearest names for an unknown model or option, and for what an option cannot be.
    """
    if isinstance(source, Mobility):
        return source
    given: dict[str, Any] = dict(source) if isinstance(source, Mapping) else {"model": source}
    kind = choose("mobility model", given.pop("model", None), MOBILITY_MODELS)
    names = {"model"} | {field.name for field in dataclasses.fields(kind)}
    for name in given:
        if name not in names:
            raise unknown(f"option of mobility model {kind.name!r},", name, names)
    return kind(**given)
