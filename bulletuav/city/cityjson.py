"""CityJSON: buildings as columns below the surfaces of their roofs.

References:
    CityJSON specification 2.0: City Objects, Geometry objects, transform.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.city.assembly import MIN_HEIGHT
from bulletuav.city.building_tags import MAX_NAME
from bulletuav.city.import_report import Notebook
from bulletuav.city.reference_systems import find_code, read_units
from bulletuav.city.tags import HeightReader
from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.polygons import SLIVER, area_of, convex_pieces, extruded, import_shapely

BUILDINGS = ("Building", "BuildingPart")
SURFACES = ("MultiSurface", "CompositeSurface", "Solid", "MultiSolid", "CompositeSolid")
COARSEST = 100.0
"""Penalty of levels below 1, which are footprints or roof edges"""
FINEST = 3.0
"""Level of detail from which geometries have windows and doors; coarser ones are preferred"""
STEEP = 1e-3
"""Vertical part of the normal of a surface up to which it is a wall"""
GROUND_LEVEL = 1e-3
"""Elevation of a building, m, from which it is moved to the ground"""
Rings = list[np.ndarray]
"""Corners (V, 3) of the outer and the inner rings of a surface, m"""


class BuildingPart(NamedTuple):
    """Building or part of one.

    Attributes:
        where: Its name.
        building: Name of its building.
        attributes: Its attributes.
        surfaces: Its surfaces.
    """

    where: str
    building: str
    attributes: Mapping[str, Any]
    surfaces: list[Rings]

    @property
    def bottom(self) -> float:
        """Lowest elevation, m."""
        return min(float(ring[:, 2].min()) for rings in self.surfaces for ring in rings)

    @property
    def top(self) -> float:
        """Highest elevation, m."""
        return max(float(ring[:, 2].max()) for rings in self.surfaces for ring in rings)


def read_buildings(
    path: Path, content: Mapping[str, Any], reader: HeightReader, notes: Notebook
) -> list[tuple[str, np.ndarray]]:
    """Read the buildings of a CityJSON file, put on the ground and centred.

    A roof is divided into convex columns, from each surface down to the lowest point of its part.
    Overhangs are filled. Of several levels of detail the finest below 3 is read. A part that is
    flat, as footprints are, has the height of its attributes.

    Args:
        path: The file, for messages.
        content: The file's content.
        reader: Reader of the heights of flat parts.
        notes: Import notes.

    Returns:
        Name of the building and points (V, 3), m, of each convex piece.

    Raises:
        ValueError: If the file is not CityJSON of version 1 or 2 in metres, or strict mode forbids
            a part; the message names it.
    """
    parts = list(_parts(content, _vertices(path, content), notes))
    with_volume = {part.building for part in parts if part.top - part.bottom >= MIN_HEIGHT}
    ground: dict[str, float] = {}
    for part in parts:
        ground[part.building] = min(part.bottom, ground.get(part.building, np.inf))
    for building, level in ground.items():
        if abs(level) > GROUND_LEVEL:
            notes.add("moved", building[:MAX_NAME], f"it is moved by {-level:g} m")
    pieces: list[tuple[str, np.ndarray]] = []
    for part in parts:
        if part.top - part.bottom >= MIN_HEIGHT:
            found = _columns(part, notes)
        elif part.building in with_volume:
            notes.add("outline", part.where, "the solids of its building replace it")
            continue
        else:
            found = _extrusions(part, reader, notes)
        count = len(pieces)
        lift = np.array((0.0, 0.0, -ground[part.building]))
        pieces += [(part.building, points + lift) for points in found]
        if len(pieces) == count:
            notes.add("skipped", part.where, "it has no volume")
    if pieces:
        corners = np.concatenate([points[:, :2] for _, points in pieces])
        middle = np.append((corners.min(axis=0) + corners.max(axis=0)) / 2, 0.0)
        pieces = [(name, points - middle) for name, points in pieces]
    return pieces


def _vertices(path: Path, content: Mapping[str, Any]) -> np.ndarray:
    """Return the vertices (V, 3) of a file, m."""
    version = content.get("version")
    if not isinstance(version, str) or version[:2] not in ("1.", "2."):
        raise ValueError(
            f"{path} has version {shown(version)} of CityJSON: 1.0 to 2.0 are read; upgrade it, as "
            f"by `cjio in.json upgrade save out.json`"
        )
    metadata = content.get("metadata")
    system = metadata.get("referenceSystem") if isinstance(metadata, dict) else None
    code = find_code(system)
    units = np.ones(3) if code is None else read_units(code, path)
    vertices = numbers_of(f"vertices of {path} are", content.get("vertices"))
    if not vertices.size:
        vertices = vertices.reshape(0, 3)
    transform = content.get("transform", {"scale": [1, 1, 1], "translate": [0, 0, 0]})
    known = transform if isinstance(transform, dict) else {}
    scale, shift = (
        numbers_of(f"{name} of {path} is", known.get(name)) for name in ("scale", "translate")
    )
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not scale.shape == shift.shape == (3,):
        raise ValueError(f"{path} has no vertices of three numbers, or no transform for them")
    if not all(np.isfinite(one).all() for one in (vertices, scale, shift)):
        raise ValueError(f"{path} has vertices or a transform that are not finite")
    points: np.ndarray = (vertices * scale + shift) * units
    return points


def _parts(
    content: Mapping[str, Any], vertices: np.ndarray, notes: Notebook
) -> Iterator[BuildingPart]:
    """Yield the buildings and their parts that have surfaces."""
    objects = content.get("CityObjects")
    if not isinstance(objects, dict):
        raise ValueError(f"{notes.path} has {shown(objects)} as CityObjects: objects are needed")
    known_buildings: dict[str, str] = {}
    for name, one in objects.items():
        where = name[:MAX_NAME]
        kind = one.get("type") if isinstance(one, dict) else None
        if kind not in BUILDINGS:
            notes.add("other", where, str(kind)[:MAX_NAME])
            continue
        attributes = one.get("attributes")
        try:
            surfaces = _surfaces(one.get("geometry"), vertices)
        except (ValueError, TypeError, IndexError, KeyError) as error:
            notes.add("skipped", where, f"its geometry cannot be read: {error}")
            continue
        if surfaces:
            known = attributes if isinstance(attributes, dict) else {}
            yield BuildingPart(where, _building_of(name, objects, known_buildings), known, surfaces)
        elif not one.get("children"):
            notes.add("skipped", where, f"it has no geometry of {', '.join(SURFACES)}")


def _building_of(name: str, objects: Mapping[str, Any], found: dict[str, str]) -> str:
    """Return the name of the outermost parent of an object; `found` has those of others.

    Objects whose parents form a circle are buildings of their own.
    """
    seen = dict.fromkeys([name])  # in order
    last, is_circle = name, False
    while last not in found:
        one = objects.get(last)
        parents = one.get("parents") if isinstance(one, dict) else None
        parent = parents[0] if isinstance(parents, list) and parents else None
        if not isinstance(parent, str) or parent not in objects:
            break
        if parent in seen:
            is_circle = True
            break
        seen[parent] = None
        last = parent
    outermost = found.get(last, last)
    found.update({one: one if is_circle else outermost for one in seen})
    return found[name]


def _surfaces(geometries: Any, vertices: np.ndarray) -> list[Rings]:
    """Return the surfaces of the preferred geometry. Raises ValueError or TypeError."""
    listed = geometries if isinstance(geometries, list) else []
    usable = [one for one in listed if isinstance(one, dict) and one.get("type") in SURFACES]
    if not usable:
        return []
    chosen = max(usable, key=lambda one: _preference(one.get("lod")))
    boundaries = chosen["boundaries"] if isinstance(chosen.get("boundaries"), list) else []
    # Only outer shells: of inner ones, rooms without doors, nothing is seen
    if chosen["type"] == "Solid":
        boundaries = boundaries[0]
    elif chosen["type"] in ("MultiSolid", "CompositeSolid"):
        boundaries = [surface for solid in boundaries for surface in solid[0]]
    return [[_ring(ring, vertices) for ring in surface] for surface in boundaries if surface]


def _preference(lod: object) -> float:
    """Return the rank of a level of detail: the finest from 1 to 3, finer ones, footprints."""
    try:
        level = float(str(lod))
    except ValueError:
        return -np.inf
    if level < 1.0:
        return level - COARSEST
    return level if level < FINEST else -level


def _ring(ring: Any, vertices: np.ndarray) -> np.ndarray:
    index = np.array(ring)
    if index.ndim != 1 or index.dtype.kind not in "iu" or len(index) < 3:
        raise ValueError(f"a ring is {shown(ring)}: three numbers of vertices, or more, are needed")
    outside = index[(index < 0) | (index >= len(vertices))]
    if len(outside):
        raise ValueError(
            f"a ring has the vertex {outside[0]}, and there are {len(vertices)}, from 0 on: write "
            f"the file again"
        )
    corners: np.ndarray = vertices[index]
    return corners


def _columns(part: BuildingPart, notes: Notebook) -> Iterator[np.ndarray]:
    """Yield the convex columns (2 V, 3) from the surfaces of a part down to its lowest point."""
    bottom = part.bottom
    for rings in part.surfaces:
        outer = rings[0]
        # Newell's normal; its length is twice the area
        middle = outer.mean(axis=0)
        centred = outer - middle
        normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
        if abs(normal[2]) <= STEEP * np.sqrt((normal**2).sum()):
            continue
        low, high = outer[:, 2].min(), outer[:, 2].max()
        if high - bottom < MIN_HEIGHT:
            continue
        for outline in _outlines(rings, part.where, notes):
            along = (outline - middle[:2]) @ normal[:2]
            top = np.clip(middle[2] - along / normal[2], low, high)
            if top.max() - bottom >= MIN_HEIGHT:
                column = extruded(outline, bottom, bottom)
                column[len(outline) :, 2] = top
                yield column


def _extrusions(part: BuildingPart, reader: HeightReader, notes: Notebook) -> Iterator[np.ndarray]:
    """Yield the prisms over a flat part, with the height of its attributes."""
    attributes = dict(part.attributes)
    attributes.setdefault(reader.name, attributes.get("measuredHeight"))
    attributes.setdefault("building:levels", attributes.get("storeysAboveGround"))
    bottom, top = reader.span(attributes, part.where)
    for rings in part.surfaces:
        for outline in _outlines(rings, part.where, notes):
            yield extruded(outline, part.bottom + bottom, part.bottom + top)


def _outlines(rings: Rings, where: str, notes: Notebook) -> Iterator[np.ndarray]:
    """Yield the convex pieces (V, 2) of a surface seen from above."""
    shapely = import_shapely("reading CityJSON")
    shape = shapely.Polygon(rings[0][:, :2], [ring[:, :2] for ring in rings[1:]])
    if not shape.is_valid:
        notes.add("repaired", where, f"a surface is not a valid polygon: {_reason(shape)}")
        shape = shapely.make_valid(shape)
    for polygon in shapely.get_parts(shapely.get_parts(shape)):
        if polygon.geom_type == "Polygon" and polygon.area > SLIVER:
            for piece in convex_pieces(polygon):
                if area_of(piece - piece[0]) > SLIVER:
                    yield piece


def _reason(shape: Any) -> str:
    reason: str = import_shapely("reading CityJSON").is_valid_reason(shape)
    return reason
