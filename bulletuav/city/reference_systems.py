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
EPSG = re.compile(r"EPSG\b[^,]*?(\d{1,6})(?:,|$)", re.IGNORECASE)
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


def read_units(code: int, path: Path) -> np.ndarray:
    """Return the units of x, y and z of a reference system, m (3,).

    Heights without a unit of their own have that of x.

    Raises:
        ImportError: If the extra `city` is not installed.
        ValueError: If the code is unknown, or coordinates are angles.
    """
    system = _find_system(code, path)
    axes = system.axis_info
    if any("degree" in axis.unit_name or axis.unit_conversion_factor <= 0 for axis in axes):
        raise ValueError(
            f"{path} has its coordinates in degrees (EPSG:{code}): metres are needed; convert it, "
            f"as by `cjio in.json crs_reproject 25832 save out.json`"
        )
    units = [float(axis.unit_conversion_factor) for axis in axes]
    return np.array([*units, units[0]][:3])


def _find_system(code: int, path: Path) -> Any:
    """Return a reference system of pyproj."""
    try:
        import pyproj
    except ImportError:
        raise missing_extra(f"reading coordinates in EPSG:{code}", "city") from None
    try:
        return pyproj.CRS.from_epsg(code)
    except pyproj.exceptions.ProjError as error:
        raise ValueError(f"{path} has the crs EPSG:{code}, which is unknown: {error}") from None


def convert_to_degrees(shapes: np.ndarray, code: int, path: Path) -> np.ndarray:
    """Convert shapes from a reference system to longitudes and latitudes of WGS-84.

    Raises:
        ImportError: If the extra `city` is not installed.
        ValueError: If the code is unknown, or coordinates are outside of its area.
    """
    shapely = import_shapely("reading GeoJSON")
    system = _find_system(code, path)
    import pyproj

    transformer = pyproj.Transformer.from_crs(system, 4326, always_xy=True)

    def convert(points: np.ndarray) -> np.ndarray:
        return np.stack(transformer.transform(points[:, 0], points[:, 1]), axis=1)

    converted: np.ndarray = shapely.transform(shapes, convert)
    if not np.isfinite(shapely.total_bounds(converted)).all():
        raise ValueError(f"{path} has coordinates outside of its crs EPSG:{code}: {REMEDY}")
    return converted
