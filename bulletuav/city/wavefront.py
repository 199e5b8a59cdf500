"""Cities from Wavefront OBJ files: convex pieces."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bulletuav.city.assembly import REMEDY, assemble, check_flags
from bulletuav.city.model import City
from bulletuav.errors import finite, read_file, require_file, shown

MOST_SCALE = 1e9
FARTHEST = 1e12
"""Of numbers in files"""


def from_obj(
    path: str | Path,
    side: float | None = None,
    scale: float = 1.0,
    y_up: bool = False,
) -> City:
    """Read a city from a Wavefront OBJ file.

    Every object (every group, where no object is named) is a convex piece: the convex hull of its
    faces' corners. Pieces whose names agree before `_piece_` make one building.

    Args:
        path: The file.
        side: Of the city's square, m, with coordinates taken as they are; None for the smallest
            square about the middle of the pieces.
        scale: Lengths in the file times this are metres.
        y_up: Whether y is up in the file, and not z.

    Returns:
        The city, with streets on its free ground.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line cannot be read, or a piece has no volume; it is named.
    """
    path = require_file("city", path, REMEDY)
    check_flags(y_up=y_up)
    vertices, corners = _faces(path)
    scale = finite("scale", scale, most=MOST_SCALE)
    points = scale * np.array(vertices).reshape(-1, 3)
    if y_up:
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    pieces = [
        (name.partition("_piece_")[0], points[np.unique(own)]) for name, own in corners.items()
    ]
    return assemble(path, pieces, side)


def _faces(path: Path) -> tuple[list[list[float]], dict[str, list[int]]]:
    """Read all vertices, and of each object by its name the vertices of its faces."""
    lines = [line.partition("#")[0].split() for line in read_file(path).splitlines()]
    starts = "o" if any(line[:1] == ["o"] for line in lines) else "g"
    vertices: list[list[float]] = []
    corners: dict[str, list[int]] = {}
    name = "unnamed"
    for number, line in enumerate(lines, 1):
        try:
            match line:
                case ["v", *words]:
                    vertices.append(_vertex(words))
                case ["f", *words]:
                    if len(words) < 3:
                        raise ValueError(f"a face has three corners or more, not {len(words)}")
                    corners.setdefault(name, []).extend(_indices(words, len(vertices)))
                case [word, *words] if word == starts:
                    name = " ".join(words)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from None
    return vertices, corners


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
