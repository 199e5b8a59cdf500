"""Cities with the statistics of ITU-R P.1410 on a grid of streets, regular or not."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, Statistics
from bulletuav.city.streets import grid_streets
from bulletuav.compiled.functions import power
from bulletuav.errors import choose, finite, shown
from bulletuav.geometry.solids import Solids

MOST_BLOCKS = 128
"""Blocks along a side"""
BOULEVARDS = 0.2
"""Share of the streets, at irregularity 1"""
PARKS = 0.3
"""Share of parks, at irregularity 1: this times the share of a block's side that is street"""
ANGLED = 0.5
"""Share of L-shaped buildings, at irregularity 1"""
NOTCH = (0.1, 0.3)
"""Least and greatest share that an L-shaped building lacks of its rectangle"""


def generate(
    kind: str | Statistics,
    side: float | tuple[float, float],
    rng: np.random.Generator,
    irregularity: float = 0.0,
) -> City:
    """Generate a city of one of `KINDS`, or of statistics of one's own.

    Each side is cut into that whole number of blocks whose size is nearest to what beta asks for.
    A block holds one building, of boxes along x and y. The built-up share of the ground is alpha
    exactly. Heights are Rayleigh distributed with no floor: a few buildings are very low.

    At `irregularity` 0 buildings are square and centred. Towards 1 they vary in size, shape and
    place, up to half of them are L-shaped (two boxes), and some blocks are parks. Up to a fifth of
    the streets are boulevards; the others may be down to half as wide as in a regular grid of such
    blocks, not less.

    Args:
        kind: Name of one of `KINDS`, or the statistics.
        side: Of the square that the city covers, or its lengths along x and y, m.
        rng: Source of all random numbers.
        irregularity: From 0 to 1.

    Returns:
        The city, with streets between its blocks.

    Raises:
        ValueError: The kind is unknown, the side is less than two blocks or too many, or the
            irregularity is not in [0, 1].
    """
    if not isinstance(rng, np.random.Generator):
        raise ValueError(
            f"rng is {shown(rng)}: a generator such as np.random.default_rng(0) is needed"
        )
    statistics = kind if isinstance(kind, Statistics) else choose("kind of city", kind, KINDS)
    if not 0 <= finite("irregularity", irregularity) <= 1:
        raise ValueError(
            f"irregularity is {irregularity!r}: a number from 0 (regular) to 1 is needed"
        )
    irregularity = finite("irregularity", irregularity)
    sides = tuple(
        finite("side", one) for one in (side if isinstance(side, tuple) else (side, side))
    )

    # Blocks, smaller where parks take some of them
    parks = PARKS * irregularity * (1 - math.sqrt(statistics.alpha))
    pitch = statistics.pitch * math.sqrt(1 - parks)
    counts = tuple(_blocks(one, pitch) for one in sides)
    lots = _lots(statistics.alpha, sides, counts, rng, irregularity)
    built = rng.permutation(len(lots))[int(parks * len(lots)) :]
    lots = lots[np.sort(built)]

    # Buildings and their heights
    boxes, building = _buildings(statistics.alpha * math.prod(sides), lots, rng, irregularity)
    heights = rng.rayleigh(statistics.gamma, building.max() + 1)
    boxes[:, 1, 2] = heights[building]

    lines = [_lines(one, count)[1:-1] for one, count in zip(sides, counts, strict=True)]
    streets = grid_streets(lines, np.array(sides))
    name = kind if isinstance(kind, str) else "own"
    return City(name, sides[0], Solids(boxes), building, streets, sides[1])


def _lines(side: float, count: int) -> np.ndarray:
    """Return where `count` blocks along a side begin and end, m."""
    return np.linspace(-side / 2, side / 2, count + 1)


def _blocks(side: float, pitch: float) -> int:
    """Return how many blocks of about `pitch` m go along a side."""
    few = int(finite("side", side) / pitch)
    if few < 2:
        raise ValueError(
            f"side is {side!r} m: two blocks need at least {2 * pitch:.4g} m; "
            f"give that, or a greater beta"
        )
    if few > MOST_BLOCKS:
        raise ValueError(
            f"side is {side!r} m: at most {MOST_BLOCKS * pitch:.4g} m, {MOST_BLOCKS} blocks, "
            f"are made; give that, or a smaller beta"
        )
    return min(few, few + 1, key=lambda count: abs(side / count - pitch))


def _lots(
    alpha: float,
    sides: Sequence[float],
    counts: Sequence[int],
    rng: np.random.Generator,
    irregularity: float,
) -> np.ndarray:
    """Return (blocks, 2, 2) low and high corner, m, of the ground that may be built on.

    Boulevards take less from it than narrow streets add: there is always enough for alpha, parks
    taken out.
    """
    low: list[np.ndarray] = []
    high: list[np.ndarray] = []
    for side, count in zip(sides, counts, strict=True):
        width = side / count * math.sqrt(alpha)
        street = side / count - width
        # Half of a street's width, for the lines of this axis
        half = np.full(count + 1, (1 - irregularity / 2) * street / 2)
        # No block lies between two boulevards
        apart = np.arange(1 + rng.integers(2), count, 2)
        boulevards = int(BOULEVARDS * irregularity * (count - 1))
        wide = rng.permutation(apart)[:boulevards]
        half[wide] = street / 2 + min(street / 2, width / 4)
        lines = _lines(side, count)
        low.append(lines[:-1] + half[:-1])
        high.append(lines[1:] - half[1:])
    grids = [np.meshgrid(*edges, indexing="ij") for edges in (low, high)]
    corners = [np.stack(grid, axis=-1).reshape(-1, 2) for grid in grids]
    return np.stack(corners, axis=1)


def _buildings(
    ground: float, lots: np.ndarray, rng: np.random.Generator, irregularity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes (P, 2, 3) without height that cover `ground` m^2, and their lots (P,)."""
    count = len(lots)
    sizes = lots[:, 1] - lots[:, 0]
    areas = sizes.prod(axis=1)

    # Share of its lot that a building covers; what is covered in all does not depend on luck
    fill = ground / areas.sum()
    luck = rng.uniform(-1, 1, count)
    luck -= np.average(luck, weights=areas)
    share = fill + irregularity / 2 * min(fill, 1 - fill) * luck

    # Some lack a corner, and have the greater rectangle for it
    chosen = rng.random(count) < ANGLED * irregularity
    angled = chosen & (1 - share > NOTCH[0])
    room = np.minimum(NOTCH[1], 1 - share) - NOTCH[0]
    notch = angled * (NOTCH[0] + rng.random(count) * room)

    # Length, width and place of the rectangles
    slim = 0.5 + 0.3 * irregularity * rng.uniform(-1, 1, count)
    powers = np.stack([slim, 1 - slim], axis=1)
    extents = sizes * power((share / (1 - notch))[:, None], powers)
    place = 0.5 + irregularity * (rng.random((count, 2)) - 0.5)
    corners = lots[:, 0] + (sizes - extents) * place

    # Rectangles have the first arm alone
    mirrored = rng.random((count, 2)) < 0.5
    arms = _arms(np.sqrt(notch), mirrored)
    plan = corners[:, None, None] + extents[:, None, None] * arms
    boxes = np.zeros((count + angled.sum(), 2, 3))
    boxes[..., :2] = np.concatenate([plan[:, 0], plan[angled, 1]])
    building = np.concatenate([np.arange(count), np.flatnonzero(angled)])
    return boxes, building


def _arms(notch: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Return (B, 2, 2, 2) low and high corner of the two boxes of an L in the unit square.

    A corner is missing that is `notch` (B,) long each way; `mirrored` (B, 2) tells whether it is at
    the low x and low y.
    """
    zero = np.zeros_like(notch)
    one = np.ones_like(notch)
    rest = one - notch
    first = [[zero, zero], [one, rest]]
    second = [[zero, rest], [rest, one]]
    arms = np.array([first, second]).transpose(3, 0, 1, 2)
    flipped = 1 - arms[:, :, ::-1]
    return np.where(mirrored[:, None, None], flipped, arms)
