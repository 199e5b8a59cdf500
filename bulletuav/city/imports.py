"""Importers of cities from user files: footprints with heights, or meshes."""

from collections.abc import Callable
from pathlib import Path

from bulletuav.city.geojson import from_geojson
from bulletuav.city.model import City
from bulletuav.city.wavefront import from_obj

__all__ = ["CONVERTERS", "READERS", "from_geojson", "from_obj", "refuse"]

CONVERTERS = {
    ".gml": "CityGML: convert it to CityJSON, as by `citygml-tools to-cityjson FILE`",
    ".citygml": "CityGML: convert it to CityJSON, as by `citygml-tools to-cityjson FILE`",
    ".jsonl": "CityJSONSeq: convert it to CityJSON, as by `cjseq collect`",
    ".osm": "OpenStreetMap XML: convert it to GeoJSON, as by `osmtogeojson FILE`",
    ".pbf": "OpenStreetMap PBF: convert it to GeoJSON, as by `osmium export -f geojson FILE`",
}
"""Formats that are not read, with their converters, by file suffix"""


def refuse(path: str | Path) -> City:
    """Raise ValueError for a file of one of the `CONVERTERS`."""
    raise ValueError(f"{path} is {CONVERTERS[Path(path).suffix.lower()]}")


READERS: dict[str, Callable[..., City]] = {
    ".geojson": from_geojson,
    ".json": from_geojson,
    ".obj": from_obj,
    **dict.fromkeys(CONVERTERS, refuse),
}
"""Importers by file suffix"""
