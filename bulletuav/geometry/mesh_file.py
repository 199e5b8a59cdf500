"""Reader of Wavefront OBJ files: the vertices and faces of each object."""

import re
from pathlib import Path

import numpy as np

from bulletuav.errors import read_file, require_file, shown
from bulletuav.parsing import parse_number, plain_digits

MAX_LINES = 1_000_000
"""Maximum number of lines of a file"""
WORD = re.compile("[^ \t]+")


def read_obj(path: str | Path) -> list[np.ndarray]:
    """Read the vertices of each object of a Wavefront OBJ file.

    An object starts with a line `o`. Only the vertices that its faces use are read, as Bullet does.

    Args:
        path: Path of the file.

    Returns:
        Vertices (V, 3) of each object, in the units of the file.

    Raises:
        ValueError: If a line cannot be parsed, or there is no face.
        FileNotFoundError: If the file does not exist.
    """
    points, objects = read_obj_faces(path)
    return [points[sorted(set().union(*faces))] for faces in objects]


def read_obj_faces(path: str | Path) -> tuple[np.ndarray, list[list[list[int]]]]:
    """Read the vertices of a Wavefront OBJ file, and the faces of each object.

    Args:
        path: Path of the file.

    Returns:
        Vertices (V, 3) of the file, in its units; and for each object that has faces, the indices
        of the vertices of each face.

    Raises:
        ValueError: If a line cannot be parsed, or there is no face.
        FileNotFoundError: If the file does not exist.
    """
    # Files may come from untrusted sources, so their size is limited
    path = require_file("mesh", path, "pass the path of a Wavefront OBJ file")
    # Split lines and words exactly as Bullet does, so that both read the same vertices
    lines = read_file(path, newline="").split("\n")
    if len(lines) > MAX_LINES:
        raise ValueError(f"{path}: {len(lines)} lines, at most {MAX_LINES} are read: simplify it")
    corners: list[tuple[float, ...]] = []
    objects: list[list[list[int]]] = [[]]
    for number, line in enumerate(lines, start=1):
        # Empty lines, comments and unknown keywords are ignored
        word, *values = WORD.findall(line.rstrip("\r")) or [""]
        try:
            if word == "o":
                objects.append([])
            elif word == "v":
                corners.append(_parse_vertex(values))
            elif word == "f":
                face = [_parse_index(value, len(corners)) for value in values]
                if face:
                    objects[-1].append(face)
        except ValueError:
            raise ValueError(f"{path}: line {number} is {shown(line)}: it cannot be read") from None
    found = [faces for faces in objects if faces]
    if not found:
        raise ValueError(f"{path}: faces are needed (lines `f 1 2 3` after the corners `v x y z`)")
    return np.array(corners).reshape(-1, 3), found


def _parse_vertex(values: list[str]) -> tuple[float, ...]:
    """Parse the coordinates of a vertex.

    Raises:
        ValueError: If they are not finite numbers.
    """
    x, y, z = map(parse_number, values[:3])
    return x, y, z


def _parse_index(text: str, count: int) -> int:
    """Parse a vertex index, such as 3, 3/1/2 or -1 (the last vertex), of `count` vertices so far.

    Raises:
        ValueError: If there is no such vertex.
    """
    index = int(plain_digits(text.split("/")[0]))
    place = index - 1 if index > 0 else count + index
    if not 0 <= place < count:
        raise ValueError
    return place
