"""Cities from Wavefront OBJ files: meshes, in convex pieces."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bulletuav.city.assembly import REMEDY, assemble, check_flags
from bulletuav.city.decomposer import Decomposer
from bulletuav.city.decomposition import split
from bulletuav.city.import_report import Notebook
from bulletuav.city.mesh import make_mesh
from bulletuav.city.model import City
from bulletuav.errors import choose, finite, read_file, require_file, shown

MOST_SCALE = 1e9
FARTHEST = 1e12
"""Of numbers in files"""
GROUND_LEVEL = 1e-3
"""Height of a model's lowest point, m, above which it is taken to be in absolute elevations"""
ELEVATIONS = {
    "auto": "as `ground` where the whole model is above the ground, else as `keep`",
    "ground": "each building is put on the ground",
    "keep": "heights are those of the file",
}
"""What can be done with elevations"""


def from_obj(
    path: str | Path,
    side: float | None = None,
    scale: float = 1.0,
    y_up: bool = False,
    elevation: str = "auto",
    strict: bool = False,
) -> City:
    """Read a city from a Wavefront OBJ file.

    Every object (every group, where no object is named) is a building or a part of one. Objects
    whose names agree before `_piece_` make one building. What is convex in an object is a piece.
    Other closed meshes are split into convex pieces, see `decomposition.split`; that needs the
    extra `city`. Meshes that are not closed are filled to their convex hulls.

    Args:
        path: The file.
        side: Of the city's square, m, with coordinates taken as they are; None for the smallest
            square about the middle of the pieces.
        scale: Lengths in the file times this are metres.
        y_up: Whether y is up in the file, and not z.
        elevation: "ground" puts the lowest point of each building on the ground, "keep" leaves all
            heights, "auto" does the first where the whole model is above the ground, as models in
            metres above the sea are.
        strict: Whether to refuse what is filled or left out otherwise.

    Returns:
        The city, with streets on its free ground. Its `report` tells what was mended, and the
        measured errors of the pieces.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The extra is needed, and not installed.
        ValueError: A line cannot be read, or an object is refused; it is named.
    """
    # Options before the file, which may be large
    path = require_file("city", path, REMEDY)
    check_flags(y_up=y_up, strict=strict)
    choose("elevation", elevation, ELEVATIONS)
    vertices, faces = _faces(path)
    # To metres with z up
    scale = finite("scale", scale, -MOST_SCALE, MOST_SCALE)
    points = scale * np.array(vertices).reshape(-1, 3)
    if y_up:
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    # Objects become convex pieces, with the name of their building
    notes = Notebook(path, strict)
    with Decomposer() as decompose:
        pieces = [
            (name.partition("_piece_")[0], piece)
            for name, own in faces.items()
            for piece in split(make_mesh(points, own), f"object {name}", notes, decompose)
        ]
    return assemble(path, _on_the_ground(pieces, elevation, notes), side, notes)


def _on_the_ground(
    pieces: list[tuple[str, np.ndarray]], elevation: str, notes: Notebook
) -> list[tuple[str, np.ndarray]]:
    """Put buildings of pieces on the ground where that is asked for."""
    lowest: dict[str, float] = {}
    for name, points in pieces:
        lowest[name] = min(lowest.get(name, np.inf), float(points[:, 2].min()))
    floats = min(lowest.values(), default=0.0) > GROUND_LEVEL
    if elevation == "keep" or (elevation == "auto" and not floats):
        for name, bottom in lowest.items():
            if bottom > GROUND_LEVEL:
                notes.add("above", f"object {name}", f"it begins {bottom:g} m above the ground")
        return pieces
    for name, bottom in lowest.items():
        if bottom != 0:
            notes.add("moved", f"object {name}", f"it is moved by {-bottom:g} m")
    return [(name, points - [0, 0, lowest[name]]) for name, points in pieces]


def _faces(path: Path) -> tuple[list[list[float]], dict[str, list[list[int]]]]:
    """Read all vertices, and of each object by its name the vertices of each of its faces."""
    # Words of each line, without comments
    lines = [line.partition("#")[0].split() for line in read_file(path).splitlines()]
    # Buildings are objects, or groups in a file without objects
    starts = "o" if any(line[:1] == ["o"] for line in lines) else "g"
    vertices: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {}
    name = "unnamed"
    for number, line in enumerate(lines, 1):
        try:
            match line:
                # Texture, normals and materials are passed over
                case ["v", *words]:
                    vertices.append(_vertex(words))
                case ["f", *words]:
                    if len(words) < 3:
                        raise ValueError(f"a face has three corners or more, not {len(words)}")
                    # Indices may count from the end, so they depend on the vertices so far
                    face = list(_indices(words, len(vertices)))
                    faces.setdefault(name, []).append(face)
                case [word, *words] if word == starts:
                    name = " ".join(words)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from None
    return vertices, faces


def _vertex(words: Sequence[str]) -> list[float]:
    """Read x, y and z."""
    if len(words) < 3:
        raise ValueError(f"not enough values: a vertex is x, y and z, not {len(words)} numbers")
    return [finite("a coordinate", float(word), -FARTHEST, FARTHEST) for word in words[:3]]


def _indices(words: Sequence[str], known: int) -> Iterator[int]:
    """Yield the vertices of a face, from 0.

    In the file they count from 1, or back from the latest.
    """
    for word in words:
        digits = word.partition("/")[0]
        if not digits.removeprefix("-").isdecimal() or len(digits) > 18:
            raise ValueError(f"{shown(word)} is no number of a vertex")
        index = int(digits)
        if not 1 <= abs(index) <= known:
            raise ValueError(f"there is no vertex {index} among the {known} before it")
        yield index - 1 if index > 0 else known + index
