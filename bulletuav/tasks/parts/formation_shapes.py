"""Shapes of formations: places about a leader, m forward, left and up of it."""

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
"""Points of a letter's grid, three wide and five high: abc is its upper row, mno its lower one"""
ADVANCE = 3
"""From one letter to the next, in steps of the grid"""
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
"""Strokes of each letter along points of the grid; strokes meet at these points only"""


def wedge_places(count: int, spacing: float) -> np.ndarray:
    """Place drones on the two arms of a V, which are at right angles, the first at its tip.

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
    """Place drones side by side, the first on the left; see `wedge_places`."""
    left = spacing * ((count - 1) / 2 - np.arange(count))
    return np.stack([np.zeros(count), left, np.zeros(count)], axis=1)


def ring_places(count: int, spacing: float) -> np.ndarray:
    """Place drones evenly on a circle, the first in front, the next to its left; see `wedge_places`."""
    if count == 1:
        return np.zeros((1, 3))
    angle = 2 * np.pi * np.arange(count) / count
    radius = spacing / (2 * sin(np.pi / count))
    return radius * np.stack([cos(angle), sin(angle), np.zeros(count)], axis=1)


SHAPES: Mapping[str, Callable[[int, float], np.ndarray]] = MappingProxyType(
    {"v": wedge_places, "line": line_places, "ring": ring_places}
)
"""Shapes that are the same for any text, by name"""
NAMES = (*SHAPES, LETTERS)


def letter_places(count: int, spacing: float, text: str) -> np.ndarray:
    """Write a text that is read from above, its top in front.

    A drone is on each corner and end of a stroke. The others go, one by one, to the stroke on
    which drones are farthest apart, and spread evenly there.

    Args:
        count: N.
        spacing: Distance between the two nearest places, m.
        text: Letters, digits and spaces.

    Returns:
        (N, 3) m, with the middle of the text at the leader.

    Raises:
        ValueError: A letter is unknown, nothing is to be written, or drones are too few for it.
    """
    # Corners that strokes share take one drone
    edges = _edges(text)
    corners = list(dict.fromkeys(point for edge in edges for point in edge))
    if count < len(corners):
        raise ValueError(
            f"text {shown(text)} has {len(corners)} corners and ends, each of which needs a "
            f"drone: num_drones is {count}"
        )
    # The others: always one more to the stroke with the widest gaps
    ends = np.array(edges, dtype=float)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    inner = np.zeros(len(edges), dtype=int)
    for _ in range(count - len(corners)):
        inner[np.argmax(length / (inner + 1))] += 1
    # Even shares between the ends of each stroke
    parts = [np.array(corners, dtype=float)]
    for (start, end), number in zip(ends, inner.tolist(), strict=True):
        share = np.arange(1, number + 1)[:, None] / (number + 1)
        parts.append(start + share * (end - start))
    # From a page to x ahead and y to the left, the middle at the leader
    right, forward = np.concatenate(parts).T
    middle = (right.max() + right.min()) / 2, (forward.max() + forward.min()) / 2
    place = np.stack([forward - middle[1], middle[0] - right, np.zeros(count)], axis=1)
    return place * (spacing / min_place_distance(place))


def _edges(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """List the straight pieces of a text's strokes, from point to point of the grid."""
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
    """Tell the shapes of an option that may be one shape, or several in a list or tuple.

    Args:
        shapes: A name, places (M, 3), or several of these.
    """
    listed = isinstance(shapes, list | tuple) and any(map(_is_shape, shapes))
    return tuple(shapes) if listed else (shapes,)


def _is_shape(value: Any) -> bool:
    """Tell whether an entry of a list is a shape, and not one place of a shape."""
    if isinstance(value, str):
        return True
    return isinstance(value, list | tuple | np.ndarray) and any(
        isinstance(one, list | tuple | np.ndarray) for one in value
    )


def find_places(shape: Any, count: int, spacing: float, text: str, apart: float) -> np.ndarray:
    """Find the places of a shape.

    Args:
        shape: A name, or places (M, 3) about the leader, m.
        count: Number of drones.
        spacing: Distance between neighbours in shapes that have names, m.
        text: What the letters write.
        apart: Distance that all places exceed, m.

    Returns:
        (M, 3) m.

    Raises:
        ValueError: The shape is unknown, has too few places, or places that are too close.
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
    """Compute the distance between the two nearest of places (M, 3), m; infinite of one."""
    from scipy.spatial import cKDTree  # which takes long to import

    distance, _ = cKDTree(place).query(place, k=2)
    return float(distance[:, 1].min())


def _named(shape: str) -> Callable[[int, float], np.ndarray]:
    """Find a shape by its name."""
    if shape not in SHAPES:
        raise unknown("entry of shapes", shape, NAMES)
    return SHAPES[shape]


def _given(shape: Any, count: int) -> np.ndarray:
    """Take places that a user gives, and refuse what are none, or too few."""
    try:
        place = numbers_of("a shape is", shape)
    except ValueError:
        place = np.empty(0)
    if place.ndim != 2 or place.shape[1] != 3 or not np.isfinite(place).all():
        names = ", ".join(map(repr, NAMES))
        raise ValueError(
            f"shapes: {shown(shape)} is no shape: {names}, or finite places (M, 3) in metres "
            f"forward, left and up of the leader are needed"
        )
    if len(place) < count:
        raise ValueError(
            f"shapes: {len(place)} places are too few for {count} drones: one for each is needed"
        )
    return place
