"""Export of a city as a Wavefront OBJ file."""

from pathlib import Path

from bulletuav.city.model import GROUND, City
from bulletuav.files import replace_file
from bulletuav.geometry.solids import format_obj_lines


def write_obj(city: City, path: str | Path) -> None:
    """Write a city as a Wavefront OBJ file in metres, z up, with counter-clockwise faces.

    Each convex piece is an object `building_K_piece_P`, or `ground_piece_P` for hills. Coordinates
    are written with full precision, so `imports.from_obj` with the city's side reads identical
    pieces. It does not read hills, which leave no ground for streets.

    Args:
        city: The city.
        path: The file, which is replaced if it exists.
    """
    about = (
        f"# city {city.name}: {city.sides[0]:g} m x {city.sides[1]:g} m about the origin; "
        f"metres, x east, y north, z up"
    )
    owners = zip(city.building, city.solids.faces, strict=True)
    pieces = (
        (f"{_owner(building)}_piece_{piece}", corners, faces)
        for piece, (building, (corners, faces)) in enumerate(owners)
    )
    lines = [about, *format_obj_lines(pieces)]
    replace_file(path, "\n".join(lines) + "\n")


def _owner(building: int) -> str:
    return "ground" if building == GROUND else f"building_{building}"
