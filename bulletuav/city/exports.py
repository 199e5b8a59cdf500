"""A city as a Wavefront OBJ file."""

from collections.abc import Iterator
from pathlib import Path

from bulletuav.city.model import City


def write_obj(city: City, path: str | Path) -> None:
    """Write every convex piece as an object `building_K_piece_P` of a Wavefront OBJ file: metres, z up, faces turn left.

    Coordinates keep all their digits: `imports.from_obj` with the city's side reads the same pieces.
    """
    Path(path).write_text("\n".join(_obj_lines(city)) + "\n")


def _obj_lines(city: City) -> Iterator[str]:
    yield f"# city {city.name}: a square of {city.side:g} m about the origin; metres, x east, y north, z up"
    first = 1
    for piece, (building, (corners, faces)) in enumerate(zip(city.building, city.solids.faces, strict=True)):
        yield f"o building_{building}_piece_{piece}"
        yield from (f"v {x} {y} {z}" for x, y, z in corners.tolist())
        yield from (f"f {a} {b} {c}" for a, b, c in (faces + first).tolist())
        first += len(corners)
