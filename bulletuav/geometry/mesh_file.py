"""Reading of Wavefront OBJ files: the corners of each of their objects."""

import re
from pathlib import Path

import numpy as np

from bulletuav.errors import read_file, require_file, shown
from bulletuav.parsing import parse_number, plain_digits

MAX_LINES = 1_000_000
"""Most lines of a file"""
WORD = re.compile("[^ \t]+")


def read_obj(path: str | Path) -> list[np.ndarray]:
    """Read the corners of each object of a Wavefront OBJ file.

    An object begins with a line `o`, and has the corners that its faces name: the engine, too,
    takes no others.

    Args:
        path: Where the file is.

    Returns:
        Corners (V, 3) of each object, in the file's units.

    Raises:
        ValueError: A line cannot be read, or there is no face.
        FileNotFoundError: There is no such file.
    """
    # A limit, as files may be of anybody
    path = require_file("mesh", path, "pass the path of a Wavefront OBJ file")
    # Lines and words end where the engine takes them to end: it must count the same corners
    lines = read_file(path, newline="").split("\n")
    if len(lines) > MAX_LINES:
        raise ValueError(f"{path}: {len(lines)} lines, at most {MAX_LINES} are read: simplify it")
    corners: list[tuple[float, ...]] = []
    objects: list[set[int]] = [set()]
    for number, line in enumerate(lines, start=1):
        # Empty lines and comments have words that mean nothing here
        word, *values = WORD.findall(line.rstrip("\r")) or [""]
        try:
            if word == "o":
                objects.append(set())
            elif word == "v":
                corners.append(_parse_vertex(values))
            elif word == "f":
                objects[-1].update(_parse_index(value, len(corners)) for value in values)
        except ValueError:
            raise ValueError(f"{path}: line {number} is {shown(line)}: it cannot be read") from None
    # Objects without faces have no corners to take
    points = np.array(corners).reshape(-1, 3)
    found = [points[sorted(one)] for one in objects if one]
    if not found:
        raise ValueError(f"{path}: faces are needed (lines `f 1 2 3` after the corners `v x y z`)")
    return found


def _parse_vertex(values: list[str]) -> tuple[float, ...]:
    """Read the coordinates of a corner.

    Raises:
        ValueError: They are not finite numbers.
    """
    x, y, z = map(parse_number, values[:3])
    return x, y, z


def _parse_index(text: str, count: int) -> int:
    """Read the index of a corner, such as 3, 3/1/2 or -1 (the last one), of those so far.

    Raises:
        ValueError: There is no such corner.
    """
    index = int(plain_digits(text.split("/")[0]))
    place = index - 1 if index > 0 else count + index
    if not 0 <= place < count:
        raise ValueError
    return place
