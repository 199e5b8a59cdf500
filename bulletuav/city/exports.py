"""A city as a Wavefront OBJ file."""

from pathlib import Path

from bulletuav.city.model import City
from bulletuav.files import replace_file
from bulletuav.geometry.solids import obj_lines


def write_obj(city: City, path: str | Path) -> None:
    """Write every convex piece as an object `building_K_piece_P` of a Wavefront OBJ file: metres, z up, faces turn left.

    Coordinates keep all their digits: `imports.from_obj` with the city's side reads the same pieces.
    """
    about = f"# city {city.name}: a square of {city.side:g} m about the origin; metres, x east, y north, z up"
    pieces = (
        (f"building_{building}_piece_{piece}", corners, faces)
        for piece, (building, (corners, faces)) in enumerate(
            zip(city.building, city.solids.faces, strict=True)
        )
    )
    replace_file(path, "\n".join([about, *obj_lines(pieces)]) + "\n")
