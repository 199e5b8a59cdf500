"""Importers of cities from user files: footprints with heights, or meshes."""

from collections.abc import Callable

from bulletuav.city.geojson import from_geojson
from bulletuav.city.model import City
from bulletuav.city.wavefront import from_obj

__all__ = ["READERS", "from_geojson", "from_obj"]

READERS: dict[str, Callable[..., City]] = {
    ".geojson": from_geojson,
    ".json": from_geojson,
    ".obj": from_obj,
}
"""Importers by file suffix"""
