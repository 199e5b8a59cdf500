"""Building heights from feature properties (tags) of OpenStreetMap.

By the wiki of OpenStreetMap, heights are metres unless a unit is given, and range from the ground
to the top of the roof. The levels of an elevated part include those below it.

References:
    OpenStreetMap wiki: Key:height, Key:min_height, Key:building:levels, Simple_3D_Buildings and
    Map_Features/Units.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

from bulletuav.city.assembly import MAX_HEIGHT, MIN_HEIGHT
from bulletuav.city.import_report import Notebook
from bulletuav.errors import finite, shown

LEVEL = 3.0
"""Height of a level, m, as in OSM Buildings 4.1 (METERS_PER_LEVEL)"""
GUESS = 10.0
"""Height of a building without any information, m, as in OSM Buildings 4.1 (DEFAULT_HEIGHT)"""
NEEDED = "metres above 0, or a default height, are needed"
FOOT = 0.3048
INCH = 0.0254
UNITS = {
    "": 1.0,
    "m": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "ft": FOOT,
    "foot": FOOT,
    "feet": FOOT,
    "'": FOOT,
}
"""Metres per unit of length"""
LENGTH = re.compile(r"([+-]?\d+(?:[.,]\d+)?)\s*([a-z']*)", re.IGNORECASE)
FEET_AND_INCHES = re.compile(r"(\d+)'\s*(\d+(?:\.\d+)?)\"")


def read_length(value: Any) -> tuple[float, str]:
    r"""Parse a length.

    Args:
        value: A number of metres, a text such as "12 m", "40 ft", "7'4\"" or "12;14", or a list.

    Returns:
        The length, m, NaN if it is invalid; the maximum of a list. Then the kind of import note:
        "" for a number, "unit", "list" or "unreadable".
    """
    if isinstance(value, str) and ";" in value:
        value = value.split(";")
    if isinstance(value, list):
        flat = [read_length(one)[0] for one in value if not isinstance(one, list)]
        known = [length for length in flat if not math.isnan(length)]
        return (max(known), "list") if known else (math.nan, "unreadable")
    try:
        # Some files contain heights as strings
        return finite("length", float(value) if isinstance(value, str) else value), ""
    except ValueError:
        length = _with_unit(value) if isinstance(value, str) else math.nan
    return length, "unreadable" if math.isnan(length) else "unit"


def _with_unit(text: str) -> float:
    """Parse a length with a unit or a decimal comma, m; NaN if it is invalid."""
    if both := FEET_AND_INCHES.fullmatch(text.strip()):
        return float(both[1]) * FOOT + float(both[2]) * INCH
    found = LENGTH.fullmatch(text.strip())
    if not found or found[2].lower() not in UNITS:
        return math.nan
    return float(found[1].replace(",", ".")) * UNITS[found[2].lower()]


class HeightReader:
    """Reader of the bottom and top heights of buildings.

    Attributes:
        name: Property with the height.
        default: Height of buildings without this property, m; None for an estimate.
        notes: Import notes.
    """

    def __init__(self, name: str, default: float | None, notes: Notebook) -> None:
        """Validate the property name and the default.

        Args:
            name: Property with the height.
            default: Height of buildings without this property, m; None for an estimate.
            notes: Import notes.

        Raises:
            ValueError: If an argument is invalid.
        """
        if not isinstance(name, str):
            raise ValueError(
                f"height is {shown(name)}: the name of a property of the features is needed"
            )
        if default is not None:
            default = finite("default_height", default, MIN_HEIGHT, MAX_HEIGHT)
        self.name = name
        self.default = default
        self.notes = notes

    def span(self, properties: Mapping[str, Any], where: str) -> tuple[float, float]:
        """Return bottom and top of a building or part above the ground, m.

        Args:
            properties: Properties of the feature.
            where: Name of the feature.

        Raises:
            ValueError: If strict mode forbids a property.
        """
        bottom = self._bottom(properties, where)
        # Height tags first, then levels, then an estimate
        top = self._tagged_height(properties, where)
        if top is None:
            top = self._by_levels(properties, where)
        if top is None:
            top = self._default_height(properties, where)
            # An estimated height is measured from the underside
            if 0 <= bottom <= MAX_HEIGHT - top:
                top += bottom
        # An underside above the top is a data error
        if not 0 <= bottom <= top - MIN_HEIGHT:
            self.notes.add(
                "underside", where, f"its underside is at {bottom:g} m, its top at {top:g} m"
            )
            bottom = 0.0
        if bottom > 0:
            self.notes.add("above", where, f"it begins {bottom:g} m above the ground")
        return bottom, top

    def _tagged_height(self, properties: Mapping[str, Any], where: str) -> float | None:
        """Return the height of the height tag, m; None if missing or invalid."""
        value = properties.get(self.name)
        if value is None:
            return None
        # Invalid and implausible values are noted and ignored
        length, oddity = read_length(value)
        if not 0 < length < math.inf:
            self.notes.add("unreadable", where, f"its {self.name} is {shown(value)}", NEEDED)
            return None
        if not MIN_HEIGHT <= length <= MAX_HEIGHT:
            self.notes.add(
                "unreadable",
                where,
                f"its {self.name} is {length:g} m",
                f"from {MIN_HEIGHT:g} to {MAX_HEIGHT:g} m is supported",
            )
            return None
        # Valid after an interpretation, such as a decimal comma
        if oddity:
            self.notes.add(
                oddity, where, f"its {self.name} is {shown(value)}, taken as {length:g} m", NEEDED
            )
        return length

    def _by_levels(self, properties: Mapping[str, Any], where: str) -> float | None:
        """Return the height estimated from levels, m; None if missing or in strict mode."""
        levels, _ = read_length(properties.get("building:levels"))
        if self.notes.strict or not levels > 0:
            return None
        rise, _ = read_length(properties.get("roof:height"))
        if not rise >= 0:
            rise = LEVEL * _count(properties, "roof:levels")
        height = LEVEL * levels + rise
        if height > MAX_HEIGHT:
            self.notes.add("unreadable", where, f"its {levels:g} levels would be {height:g} m high")
            return None
        self.notes.add("levels", where, f"its {levels:g} levels are taken as {height:g} m")
        return height

    def _default_height(self, properties: Mapping[str, Any], where: str) -> float:
        """Return the height of a building without information, m."""
        if self.default is not None:
            self.notes.add("default", where, f"it is taken as {self.default:g} m high")
            return self.default
        self.notes.add("guessed", where, f"its {self.name} is None", NEEDED)
        return GUESS

    def _bottom(self, properties: Mapping[str, Any], where: str) -> float:
        """Return the height of the underside above the ground, m."""
        value = properties.get("min_height")
        if value is None:
            key = "building:min_level" if "building:min_level" in properties else "min_level"
            return LEVEL * _count(properties, key)
        length, oddity = read_length(value)
        if oddity:
            kind = "underside" if oddity == "unreadable" else oddity
            self.notes.add(kind, where, f"its min_height is {shown(value)}", "metres are needed")
        return 0.0 if math.isnan(length) else length


def _count(properties: Mapping[str, Any], name: str) -> float:
    """Return a number of levels, 0 if missing."""
    levels, _ = read_length(properties.get(name))
    return levels if levels > 0 else 0.0
