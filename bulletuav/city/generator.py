"""Generator of cities with ITU-R P.1410 statistics on a regular or irregular street grid."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, Statistics
from bulletuav.city.streets import grid_streets
from bulletuav.compiled.functions import power
from bulletuav.errors import find_choice, finite, shown
from bulletuav.geometry.solids import Solids

MAX_BLOCKS = 128
"""Maximum number of blocks along a side"""
BOULEVARDS = 0.2
"""Fraction of boulevards among the streets, at irregularity 1"""
PARKS = 0.3
"""Fraction of parks, at irregularity 1, per fraction of a block's side that is street"""
ANGLED = 0.5
"""Fraction of L-shaped buildings, at irregularity 1"""
NOTCH = (0.1, 0.3)
"""Minimum and maximum fraction of its rectangle that an L-shaped building lacks"""


def generate(
    kind: str | Statistics,
    side: float | tuple[float, float],
    rng: np.random.Generator,
    irregularity: float = 0.0,
) -> City:
    """Generate a city of one of `KINDS`, or with custom statistics.

    Each side is divided into the number of blocks whose size is nearest to the one given by beta. A
    block contains one building, made of axis-aligned boxes. The built-up fraction of the ground is
    exactly alpha. Heights are Rayleigh distributed without a lower bound: a few buildings are very
    low.

    At `irregularity` 0 buildings are square and centred. Towards 1 they vary in size, shape and
    position, up to half of them are L-shaped (two boxes), and some blocks are parks. Up to a fifth
    of the streets are boulevards; the others have at least half the width of those in a regular
    grid of such blocks.

    Args:
        kind: Name of one of `KINDS`, or the statistics.
        side: Side of the square city, or its lengths along x and y, m.
        rng: Random generator.
        irregularity: From 0 to 1.

    Returns:
        The city, with streets between its blocks.

    Raises:
        ValueError: If the kind is unknown, the side is less than two blocks or too long, or the
            irregularity is not in [0, 1].
    """
    if not isinstance(rng, np.random.Generator):
        raise ValueError(
            f"rng is {shown(rng)}: a generator such as np.random.default_rng(0) is needed"
        )
    statistics = kind if isinstance(kind, Statistics) else find_choice("kind of city", kind, KINDS)
    if not 0 <= finite("irregularity", irregularity) <= 1:
        raise ValueError(
            f"irregularity is {irregularity!r}: a number from 0 (regular) to 1 is needed"
        )
    irregularity = finite("irregularity", irregularity)
    sides = tuple(
        finite("side", one) for one in (side if isinstance(side, tuple) else (side, side))
    )

    # Blocks, smaller if some of them are parks
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
    """Return the boundaries of `count` blocks along a side, m."""
    return np.linspace(-side / 2, side / 2, count + 1)


def _blocks(side: float, pitch: float) -> int:
    """Return the number of blocks of about `pitch` m along a side."""
    few = int(finite("side", side) / pitch)
    if few < 2:
        raise ValueError(
            f"side is {side!r} m: two blocks need at least {2 * pitch:.4g} m; increase side or beta"
        )
    if few > MAX_BLOCKS:
        raise ValueError(
            f"side is {side!r} m: at most {MAX_BLOCKS * pitch:.4g} m, {MAX_BLOCKS} blocks, "
            f"are supported; decrease side or beta"
        )
    return min(few, few + 1, key=lambda count: abs(side / count - pitch))


def _lots(
    alpha: float,
    sides: Sequence[float],
    counts: Sequence[int],
    rng: np.random.Generator,
    irregularity: float,
) -> np.ndarray:
    """Return lower and upper corner (blocks, 2, 2), m, of the building lots.

    Boulevards remove less ground than narrow streets add, so that there is always enough for alpha,
    even with parks.
    """
    low: list[np.ndarray] = []
    high: list[np.ndarray] = []
    for side, count in zip(sides, counts, strict=True):
        width = side / count * math.sqrt(alpha)
        street = side / count - width
        # Half the width of each street along this axis
        half = np.full(count + 1, (1 - irregularity / 2) * street / 2)
        # No block is adjacent to two boulevards
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

    # Covered fraction of each lot; the total covered area is not random
    fill = ground / areas.sum()
    noise = rng.uniform(-1, 1, count)
    noise -= np.average(noise, weights=areas)
    fraction = fill + irregularity / 2 * min(fill, 1 - fill) * noise

    # L-shaped buildings lack a corner, and have a larger rectangle
    chosen = rng.random(count) < ANGLED * irregularity
    angled = chosen & (1 - fraction > NOTCH[0])
    margin = np.minimum(NOTCH[1], 1 - fraction) - NOTCH[0]
    notch = angled * (NOTCH[0] + rng.random(count) * margin)

    # Length, width and position of the rectangles
    slim = 0.5 + 0.3 * irregularity * rng.uniform(-1, 1, count)
    powers = np.stack([slim, 1 - slim], axis=1)
    extents = sizes * power((fraction / (1 - notch))[:, None], powers)
    place = 0.5 + irregularity * (rng.random((count, 2)) - 0.5)
    corners = lots[:, 0] + (sizes - extents) * place

    # Rectangles consist of the first arm only
    mirrored = rng.random((count, 2)) < 0.5
    arms = _arms(np.sqrt(notch), mirrored)
    plan = corners[:, None, None] + extents[:, None, None] * arms
    boxes = np.zeros((count + angled.sum(), 2, 3))
    boxes[..., :2] = np.concatenate([plan[:, 0], plan[angled, 1]])
    building = np.concatenate([np.arange(count), np.flatnonzero(angled)])
    return boxes, building


def _arms(notch: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Return the corners (B, 2, 2, 2) of the two boxes of an L in the unit square.

    The missing corner is a square of side `notch` (B,); `mirrored` (B, 2) moves it to low x and low
    y.
    """
    zero = np.zeros_like(notch)
    one = np.ones_like(notch)
    rest = one - notch
    first = [[zero, zero], [one, rest]]
    second = [[zero, rest], [rest, one]]
    arms = np.array([first, second]).transpose(3, 0, 1, 2)
    flipped = 1 - arms[:, :, ::-1]
    return np.where(mirrored[:, None, None], flipped, arms)
