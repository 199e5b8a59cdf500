"""Selection of buildings by their properties (tags) of OpenStreetMap.

References:
    OpenStreetMap wiki: Key:building, Simple_3D_Buildings, Lifecycle_prefix, Key:location,
    Key:layer, Key:building:levels.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from bulletuav.city.tags import read_length

MAX_NAME = 80
"""Maximum length of names and kinds of features in reports"""
BUILDING_KEYS = ("building", "building:part")
LIFECYCLE = (
    "abandoned",
    "demolished",
    "destroyed",
    "dismantled",
    "disused",
    "planned",
    "proposed",
    "razed",
    "removed",
    "was",
)
"""Prefixes of tags of objects that are not there, or not in use, as what they are tagged"""
GONE = ("demolished", "destroyed", "dismantled", "planned", "proposed", "razed", "removed")
"""Values of `building`, and tags with the value "yes", of buildings that do not stand"""
FEATURE_KEYS = (
    "aeroway",
    "aerialway",
    "amenity",
    "barrier",
    "boundary",
    "bridge",
    "bridge:support",
    "emergency",
    "geological",
    "highway",
    "historic",
    "indoor",
    "landcover",
    "landuse",
    "leisure",
    "man_made",
    "military",
    "natural",
    "office",
    "place",
    "power",
    "public_transport",
    "railway",
    "route",
    "shop",
    "tourism",
    "tunnel",
    "water",
    "waterway",
)
"""Keys by which OpenStreetMap classifies features"""
HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"=>"((?:[^"\\]|\\.)*)"')
"""Entry of the property `other_tags` that GDAL writes"""


def read_tags(properties: object) -> dict[str, Any]:
    """Return the tags of a feature, also those that converters nest.

    Args:
        properties: Properties of the feature. Tags may be in a mapping `tags`, as in some files of
            osmtogeojson, or in a text `other_tags`, as in files of GDAL.
    """
    known = dict(properties) if isinstance(properties, Mapping) else {}
    nested = known.get("tags")
    if isinstance(nested, Mapping):
        known = {**known, **nested}
    others = known.get("other_tags")
    if isinstance(others, str):
        for name, value in HSTORE.findall(others):
            known.setdefault(_unescaped(name), _unescaped(value))
    return known


def _unescaped(text: str) -> str:
    return re.sub(r"\\(.)", r"\1", text)


def has_building_tags(all_tags: Iterable[Mapping[str, Any]]) -> bool:
    """Return True if any feature has a tag of buildings, so that those without are no buildings."""
    return any(_is_set(tags.get(key)) for tags in all_tags for key in BUILDING_KEYS)


def find_other_kind(tags: Mapping[str, Any], height: str, is_tagged: bool) -> str | None:
    """Return the kind of a feature that is no building above the ground, or None for a building.

    Args:
        tags: Tags of the feature.
        height: Property with the height of a building.
        is_tagged: Whether any feature of the file has a tag of buildings. Then a feature without
            is a building if it has a height, and no tag of another kind. Otherwise it is a building
            if it has a height, or no tag of another kind.

    Returns:
        A tag, such as "landuse=residential"; a state, such as "underground building"; or
        "without tags of a building".
    """
    if any(_is_set(tags.get(key)) for key in BUILDING_KEYS):
        return _absent_state(tags)
    kind = next(
        (f"{key}={tags[key]}"[:MAX_NAME] for key in tags if _is_other(key, tags[key])), None
    )
    denied = [f"{key}=no" for key in BUILDING_KEYS if tags.get(key) == "no"]
    if denied:
        return kind or denied[0]
    has_height = tags.get(height) is not None
    if is_tagged and kind is None:
        return None if has_height else "without tags of a building"
    return kind if is_tagged or not has_height else None


def _absent_state(tags: Mapping[str, Any]) -> str | None:
    """Return the state of a tagged building that is not above the ground, or None."""
    for state in GONE:
        if state in (tags.get("building"), tags.get("building:part")) or _is_set(tags.get(state)):
            return f"{state} building"
    is_above = _number(tags, "building:levels") > 0 or _number(tags, "height") > 0
    is_below = (
        tags.get("location") == "underground"
        or (_number(tags, "layer") < 0 and not is_above)
        or (_number(tags, "building:levels") == 0 < _number(tags, "building:levels:underground"))
    )
    return "underground building" if is_below else None


def _is_other(key: str, value: object) -> bool:
    """Return True if a tag classifies a feature that is no building."""
    prefix, _, rest = key.partition(":")
    is_state = bool(rest) and prefix in LIFECYCLE
    return (key in FEATURE_KEYS or is_state or key in GONE) and _is_set(value)


def _is_set(value: object) -> bool:
    return value not in (None, False, "", "no")


def _number(tags: Mapping[str, Any], key: str) -> float:
    """Return the number of a tag, NaN if there is none."""
    return read_length(tags.get(key))[0]
