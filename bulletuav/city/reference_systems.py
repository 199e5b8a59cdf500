"""Coordinate reference systems of maps: their names in files, and conversion to degrees."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.errors import missing_extra, shown
from bulletuav.geometry.polygons import import_shapely

DEGREES = {4326, 4979, 4258, 4937, 4269}
"""EPSG codes of longitudes and latitudes that agree with WGS-84 to 2 m"""
CRS84 = re.compile(r"CRS84h?$", re.IGNORECASE)
EPSG = re.compile(r"EPSG\b.*?(\d{1,6})$", re.IGNORECASE)
REMEDY = "convert the file to degrees, as by `ogr2ogr -t_srs EPSG:4326 out.geojson in.geojson`"


def read_code(path: Path, crs: Any) -> int | None:
    """Return the EPSG code of a member `crs` of GeoJSON, or None for degrees.

    Args:
        path: The file, for the message.
        crs: The member, as the specification of GeoJSON of 2008 defines it; None if there is none.

    Raises:
        ValueError: If the member has no name of a known form.
    """
    if crs is None:
        return None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    known = properties if isinstance(properties, dict) else {}
    name = f"EPSG:{known['code']}" if "code" in known else known.get("name")
    code = find_code(name)
    if code is None:
        raise ValueError(f"{path} has a crs {shown(crs)}, whose name is unknown: {REMEDY}")
    return None if code in DEGREES else code


def find_code(name: object) -> int | None:
    """Return the EPSG code in the name of a reference system, None if there is none."""
    if not isinstance(name, str):
        return None
    if CRS84.search(name):
        return 4326
    found = EPSG.search(name)
    return int(found[1]) if found else None


def convert_to_degrees(shapes: np.ndarray, code: int, path: Path) -> np.ndarray:
    """Convert shapes from a reference system to longitudes and latitudes of WGS-84.

    Raises:
        ImportError: If the extra `city` is not installed.
        ValueError: If the code is unknown, or coordinates are outside of its area.
    """
    shapely = import_shapely("reading GeoJSON")
    try:
        import pyproj
    except ImportError:
        raise missing_extra(f"reading coordinates in EPSG:{code}", "city") from None
    try:
        system = pyproj.CRS.from_epsg(code)
        transformer = pyproj.Transformer.from_crs(system, 4326, always_xy=True)
    except pyproj.exceptions.ProjError as error:
        raise ValueError(f"{path} has the crs EPSG:{code}, which is unknown: {error}") from None

    def convert(points: np.ndarray) -> np.ndarray:
        return np.stack(transformer.transform(points[:, 0], points[:, 1]), axis=1)

    converted: np.ndarray = shapely.transform(shapes, convert)
    if not np.isfinite(shapely.total_bounds(converted)).all():
        raise ValueError(f"{path} has coordinates outside of its crs EPSG:{code}: {REMEDY}")
    return converted
