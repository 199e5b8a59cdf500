"""Shapes of formations: places relative to a leader, m forward, left and up."""

from collections.abc import Callable, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.errors import numbers_of, shown, unknown

LETTERS = "letters"
"""Name of the shape that writes the option `text`"""
GRID = {mark: (k % 3, 4 - k // 3) for k, mark in enumerate("abcdefghijklmno")}
"""Points of a letter's grid, three wide and five high: abc is its top row, mno its bottom row"""
ADVANCE = 3
"""Distance from one letter to the next, in steps of the grid"""
STROKES: Mapping[str, str] = MappingProxyType(
    {
        "A": "mgbio gi", "B": "mgabfhlnm gh", "C": "cbdjno", "D": "mabflnm", "E": "cagmo gh",
        "F": "cagm gh", "G": "cbdjnoih", "H": "agm cio gi", "I": "bn", "J": "clnj",
        "K": "agm gc go", "L": "amo", "M": "mahco", "N": "maoc", "O": "bdjnlfb", "P": "mgacig",
        "Q": "bdjnlfb no", "R": "mgacig go", "S": "cagiom", "T": "abc bn", "U": "ajnlc",
        "V": "anc", "W": "amhoc", "X": "aho chm", "Y": "ahc hn", "Z": "acmo", "0": "agmoica",
        "1": "dbn", "2": "acigmo", "3": "aciom hi", "4": "agi cio", "5": "cagiom",
        "6": "cagmoig", "7": "acn", "8": "agmoica gi", "9": "igaciom",
    }
)  # fmt: skip
"""Strokes of each letter along points of the grid; strokes meet only at these points"""


def wedge_places(count: int, spacing: float) -> np.ndarray:
    """Return places on the two arms of a V at right angles, the first at its tip.

    Args:
        count: N.
        spacing: Distance between neighbours on an arm, m.

    Returns:
        (N, 3) m.
    """
    index = np.arange(count)
    rank, side = (index + 1) // 2, np.where(index % 2, 1.0, -1.0)
    step = spacing * np.sqrt(0.5)
    return np.stack([-step * rank, step * rank * side, np.zeros(count)], axis=1)


def line_places(count: int, spacing: float) -> np.ndarray:
    """Return places on a line abreast, the first on the left; see `wedge_places`."""
    left = spacing * ((count - 1) / 2 - np.arange(count))
    return np.stack([np.zeros(count), left, np.zeros(count)], axis=1)


def ring_places(count: int, spacing: float) -> np.ndarray:
    """Return places evenly spaced on a circle, from the front to the left; see `wedge_places`."""
    if count == 1:
        return np.zeros((1, 3))
    angle = 2 * np.pi * np.arange(count) / count
    radius = spacing / (2 * sin(np.pi / count))
    return radius * np.stack([cos(angle), sin(angle), np.zeros(count)], axis=1)


SHAPES: Mapping[str, Callable[[int, float], np.ndarray]] = MappingProxyType(
    {"v": wedge_places, "line": line_places, "ring": ring_places}
)
"""Shapes that do not depend on a text, by name"""
NAMES = (*SHAPES, LETTERS)


def letter_places(count: int, spacing: float, text: str) -> np.ndarray:
    """Return places that write a text, seen from above with its top in front.

    Each corner and end of a stroke has a place. The remaining places are added one by one to the
    stroke with the widest spacing, and evenly spaced there.

    Args:
        count: N.
        spacing: Distance between the two nearest places, m.
        text: Letters, digits and spaces.

    Returns:
        (N, 3) m, with the centre of the text at the leader.

    Raises:
        ValueError: If a letter is unknown, the text is empty, or there are too few drones for it.
    """
    # Corners shared by strokes have one place
    edges = _edges(text)
    corners = list(dict.fromkeys(point for edge in edges for point in edge))
    if count < len(corners):
        raise ValueError(
            f"text {shown(text)} has {len(corners)} corners and ends, each of which needs a "
            f"drone: num_drones is {count}"
        )
    ends = np.array(edges, dtype=float)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    inner = np.zeros(len(edges), dtype=int)
    for _ in range(count - len(corners)):
        inner[np.argmax(length / (inner + 1))] += 1
    parts = [np.array(corners, dtype=float)]
    for (start, end), number in zip(ends, inner.tolist(), strict=True):
        share = np.arange(1, number + 1)[:, None] / (number + 1)
        parts.append(start + share * (end - start))
    # From page axes (right, up) to x forward and y left, centred at the leader
    right, forward = np.concatenate(parts).T
    middle = (right.max() + right.min()) / 2, (forward.max() + forward.min()) / 2
    place = np.stack([forward - middle[1], middle[0] - right, np.zeros(count)], axis=1)
    return place * (spacing / min_place_distance(place))


def _edges(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the straight segments of a text's strokes, as pairs of points of the grid."""
    if not isinstance(text, str):
        raise ValueError(f"text is {shown(text)}: letters, digits and spaces are needed")
    edges = []
    for k, letter in enumerate(text.upper()):
        if letter != " " and letter not in STROKES:
            raise ValueError(f"text is {shown(text)}: {unknown('letter', letter, STROKES)}")
        for stroke in STROKES.get(letter, "").split():
            points = [(GRID[mark][0] + ADVANCE * k, GRID[mark][1]) for mark in stroke]
            edges += list(pairwise(points))
    if not edges:
        raise ValueError(f"text is {shown(text)}: at least one letter is needed")
    return edges


def as_shape_list(shapes: Any) -> tuple[Any, ...]:
    """Return the shapes of an option that is one shape or a sequence of shapes.

    Args:
        shapes: A name, places (M, 3), or several of these in a list or tuple.
    """
    listed = isinstance(shapes, list | tuple) and any(map(_is_shape, shapes))
    return tuple(shapes) if listed else (shapes,)


def _is_shape(value: Any) -> bool:
    """Return True if an entry of a list is a shape rather than one place of a shape."""
    if isinstance(value, str):
        return True
    return isinstance(value, list | tuple | np.ndarray) and any(
        isinstance(one, list | tuple | np.ndarray) for one in value
    )


def find_places(shape: Any, count: int, spacing: float, text: str, apart: float) -> np.ndarray:
    """Return the places of a shape.

    Args:
        shape: A name, or places (M, 3) relative to the leader, m.
        count: Number of drones.
        spacing: Distance between neighbours in named shapes, m.
        text: Text of the letters.
        apart: Distance that the distances between places must exceed, m.

    Returns:
        (M, 3) m.

    Raises:
        ValueError: If the shape is unknown, has too few places, or places that are too close.
    """
    if not isinstance(shape, str):
        place = _given(shape, count)
    elif shape == LETTERS:
        place = letter_places(count, spacing, text)
    else:
        place = _named(shape)(count, spacing)
    nearest = min_place_distance(place)
    if nearest <= apart:
        raise ValueError(
            f"shapes: places of {shown(shape)} are {nearest:.3g} m apart, more than {apart:.3g} m "
            f"(d_safe) is needed: raise spacing, or lower d_safe"
        )
    return place


def min_place_distance(place: np.ndarray) -> float:
    """Return the distance between the two nearest of places (M, 3), m; infinite for one place."""
    from scipy.spatial import cKDTree  # slow to import

    distance, _ = cKDTree(place).query(place, k=2)
    return float(distance[:, 1].min())


def _named(shape: str) -> Callable[[int, float], np.ndarray]:
    if shape not in SHAPES:
        raise unknown("entry of shapes", shape, NAMES)
    return SHAPES[shape]


def _given(shape: Any, count: int) -> np.ndarray:
    """Return places set by the user, after checking their shape and number."""
    try:
        place = numbers_of("a shape is", shape)
    except ValueError:
        place = np.empty(0)
    if place.ndim != 2 or place.shape[1] != 3 or not np.isfinite(place).all():
        names = ", ".join(map(repr, NAMES))
        raise ValueError(
            f"shapes: {shown(shape)} is no shape: {names}, or finite places (M, 3), in metres "
            f"forward, left and up of the leader are needed"
        )
    if len(place) < count:
        raise ValueError(
            f"shapes: {len(place)} places are too few for {count} drones: one for each is needed"
        )
    return place
