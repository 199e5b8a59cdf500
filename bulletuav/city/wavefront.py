"""Import of cities from Wavefront OBJ files: meshes in convex pieces."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bulletuav.city.assembly import REMEDY, assemble, check_flags
from bulletuav.city.decomposition import split_mesh
from bulletuav.city.import_report import Notebook
from bulletuav.city.model import City
from bulletuav.errors import find_choice, finite, read_file, require_file, shown
from bulletuav.geometry.decomposer import Decomposer
from bulletuav.geometry.mesh import make_mesh

MAX_SCALE = 1e9
MAX_COORDINATE = 1e12
"""Maximum magnitude of numbers in files"""
GROUND_LEVEL = 1e-3
"""Height of a model's lowest point, m, above which elevations count as absolute"""
ELEVATIONS = {
    "auto": "as `ground` if the whole model is above the ground, else as `keep`",
    "ground": "each building is put on the ground",
    "keep": "heights are those of the file",
}
"""Treatments of elevations"""


def from_obj(
    path: str | Path,
    side: float | None = None,
    scale: float = 1.0,
    y_up: bool = False,
    elevation: str = "auto",
    strict: bool = False,
) -> City:
    """Read a city from a Wavefront OBJ file.

    Every object (every group, if there are no objects) is a building or a part of one. Objects
    whose names are equal up to `_piece_` form one building. Each convex component of an object is a
    piece. Other closed meshes are split into convex pieces, see `decomposition.split_mesh`, which
    requires the extra `city`. Meshes that are not closed are replaced by their convex hulls.

    Args:
        path: The file.
        side: Side of the city's square, m, with unchanged coordinates; None for the smallest square
            around the pieces.
        scale: Metres per unit of length in the file.
        y_up: Whether y is up in the file, instead of z.
        elevation: "ground" puts the lowest point of each building on the ground, "keep" leaves all
            heights unchanged, "auto" selects "ground" if the whole model is above the ground, as
            are models in metres above sea level.
        strict: Whether to raise an error instead of replacing or skipping meshes.

    Returns:
        The city, with streets on its free ground. Its `report` lists all repairs, and the errors of
        the decompositions.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the extra is required, and not installed.
        ValueError: If a line cannot be read, or strict mode forbids an object; the message names
            it.
    """
    # Validate options before reading the file, which may be large
    path = require_file("city", path, REMEDY)
    check_flags(y_up=y_up, strict=strict)
    find_choice("elevation", elevation, ELEVATIONS)
    vertices, faces = _faces(path)
    # To metres with z up
    scale = finite("scale", scale, -MAX_SCALE, MAX_SCALE)
    points = scale * np.array(vertices).reshape(-1, 3)
    if y_up:
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    # Split objects into convex pieces, with the name of their building
    notes = Notebook(path, strict)
    with Decomposer() as decompose:
        pieces = [
            (name.partition("_piece_")[0], piece)
            for name, own in faces.items()
            for piece in split_mesh(make_mesh(points, own), f"object {name}", notes, decompose)
        ]
    return assemble(path, _on_the_ground(pieces, elevation, notes), side, notes)


def _on_the_ground(
    pieces: list[tuple[str, np.ndarray]], elevation: str, notes: Notebook
) -> list[tuple[str, np.ndarray]]:
    """Move the buildings to the ground if requested."""
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
    """Read all vertices, and the vertex indices of the faces of each object."""
    # Words of each line, without comments
    lines = [line.partition("#")[0].split() for line in read_file(path).splitlines()]
    # Buildings are objects, or groups if there are no objects
    starts = "o" if any(line[:1] == ["o"] for line in lines) else "g"
    vertices: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {}
    name = "unnamed"
    for number, line in enumerate(lines, 1):
        try:
            match line:
                # Textures, normals and materials are ignored
                case ["v", *words]:
                    vertices.append(_vertex(words))
                case ["f", *words]:
                    if len(words) < 3:
                        raise ValueError(f"a face needs at least three corners, not {len(words)}")
                    # Negative indices are relative to the number of vertices so far
                    face = list(_indices(words, len(vertices)))
                    faces.setdefault(name, []).append(face)
                case [word, *words] if word == starts:
                    name = " ".join(words)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from None
    return vertices, faces


def _vertex(words: Sequence[str]) -> list[float]:
    if len(words) < 3:
        raise ValueError(f"not enough values: a vertex needs x, y and z, not {len(words)} numbers")
    return [
        finite("a coordinate", float(word), -MAX_COORDINATE, MAX_COORDINATE) for word in words[:3]
    ]


def _indices(words: Sequence[str], known: int) -> Iterator[int]:
    """Yield the zero-based vertex indices of a face.

    Indices in the file are one-based, or negative from the latest vertex.
    """
    for word in words:
        digits = word.partition("/")[0]
        if not digits.removeprefix("-").isdecimal() or len(digits) > 18:
            raise ValueError(f"{shown(word)} is not a vertex index")
        index = int(digits)
        if not 1 <= abs(index) <= known:
            raise ValueError(f"there is no vertex {index} among the {known} before it")
        yield index - 1 if index > 0 else known + index
