"""Cities with the statistics of ITU-R P.1410 on a grid of streets, regular or not."""

import math

import numpy as np

from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, Statistics
from bulletuav.city.streets import grid_streets
from bulletuav.errors import choose, finite, shown
from bulletuav.geometry.solids import Solids

MOST_BLOCKS = 128  # along a side
BOULEVARDS = 0.2  # share of the streets, at irregularity 1
PARKS = 0.3  # parks among the blocks, at irregularity 1: this times the share of a block's side that is street
ANGLED = 0.5  # share of L-shaped buildings, at irregularity 1
NOTCH = (0.1, 0.3)  # least and greatest share that an L-shaped building lacks of its rectangle


def generate(
    kind: str | Statistics, side: float, rng: np.random.Generator, irregularity: float = 0.0
) -> City:
    """A city of one of `KINDS`, or of statistics of one's own, whose square has this `side`, m.

    The ground is cut into that whole number of square blocks whose size is nearest to what beta asks for; a block holds one
    building, of boxes along x and y. The built-up share of the ground is alpha exactly. Heights are Rayleigh distributed
    with no floor: a few buildings are very low. At `irregularity` 0 buildings are square and centred. Towards 1 they vary
    in size, shape and place, up to half of them are L-shaped (two boxes), some blocks are parks, up to a fifth of the
    streets are boulevards, and the others may be down to half as wide as in a regular grid of such blocks, not less.

    All random numbers are taken from `rng`. Raises ValueError for an unknown kind, a side of less than two blocks, and an
    irregularity that is not in [0, 1].
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
    irregularity, side = finite("irregularity", irregularity), finite("side", side)
    parks = PARKS * irregularity * (1 - math.sqrt(statistics.alpha))
    count = _blocks(side, statistics.pitch * math.sqrt(1 - parks))
    lots = _lots(statistics.alpha, side, count, rng, irregularity)
    lots = lots[np.sort(rng.permutation(count**2)[int(parks * count**2) :])]
    boxes, building = _buildings(statistics.alpha * side**2, lots, rng, irregularity)
    boxes[:, 1, 2] = rng.rayleigh(statistics.gamma, building.max() + 1)[building]
    streets = grid_streets(np.linspace(-side / 2, side / 2, count + 1)[1:-1], side)
    return City(
        kind if isinstance(kind, str) else "own", float(side), Solids(boxes), building, streets
    )


def _blocks(side: float, pitch: float) -> int:
    """How many blocks of about `pitch` m go along a side."""
    few = int(finite("side", side) / pitch)
    if few < 2:
        raise ValueError(
            f"side is {side!r} m: two blocks need at least {2 * pitch:.4g} m; give that, or a greater beta"
        )
    if few > MOST_BLOCKS:
        raise ValueError(
            f"side is {side!r} m: at most {MOST_BLOCKS * pitch:.4g} m, {MOST_BLOCKS} blocks, are made; give that, or a "
            f"smaller beta"
        )
    return min(few, few + 1, key=lambda count: abs(side / count - pitch))


def _lots(
    alpha: float, side: float, count: int, rng: np.random.Generator, irregularity: float
) -> np.ndarray:
    """(count^2, 2, 2) low and high corner, m, of the ground in each block that may be built on.

    Boulevards take less from it than narrow streets add: there is always enough for alpha, parks taken out.
    """
    width = side / count * math.sqrt(alpha)
    street = side / count - width
    half = np.full(
        (2, count + 1), (1 - irregularity / 2) * street / 2
    )  # of a street's width, for the lines of each axis
    for axis in range(2):
        apart = np.arange(1 + rng.integers(2), count, 2)  # no block lies between two boulevards
        wide = rng.permutation(apart)[: int(BOULEVARDS * irregularity * (count - 1))]
        half[axis, wide] = street / 2 + min(street / 2, width / 4)
    lines = np.linspace(-side / 2, side / 2, count + 1)
    low, high = lines[:-1] + half[:, :-1], lines[1:] - half[:, 1:]
    corners = [
        np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 2)
        for edges in (low, high)
    ]
    return np.stack(corners, axis=1)


def _buildings(
    ground: float, lots: np.ndarray, rng: np.random.Generator, irregularity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (P, 2, 3) without height that cover `ground` m^2 in all, and the lots (P,) that they stand on."""
    count, sizes = len(lots), lots[:, 1] - lots[:, 0]
    areas = sizes.prod(axis=1)
    fill = ground / areas.sum()
    luck = rng.uniform(-1, 1, count)
    luck -= np.average(luck, weights=areas)  # so that what is covered in all does not depend on it
    share = (
        fill + irregularity / 2 * min(fill, 1 - fill) * luck
    )  # of its lot that a building covers
    angled = (rng.random(count) < ANGLED * irregularity) & (1 - share > NOTCH[0])
    notch = angled * (NOTCH[0] + rng.random(count) * (np.minimum(NOTCH[1], 1 - share) - NOTCH[0]))
    slim = 0.5 + 0.3 * irregularity * rng.uniform(-1, 1, count)
    extents = sizes * (share / (1 - notch))[:, None] ** np.stack([slim, 1 - slim], axis=1)
    place = 0.5 + irregularity * (rng.random((count, 2)) - 0.5)
    corners = lots[:, 0] + (sizes - extents) * place
    arms = _arms(np.sqrt(notch), rng.random((count, 2)) < 0.5)
    plan = corners[:, None, None] + extents[:, None, None] * arms
    boxes = np.zeros((count + angled.sum(), 2, 3))
    boxes[..., :2] = np.concatenate([plan[:, 0], plan[angled, 1]])
    return boxes, np.concatenate([np.arange(count), np.flatnonzero(angled)])


def _arms(notch: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """(B, 2, 2, 2) low and high corner of the two boxes of an L in the unit square.

    A corner is missing that is `notch` (B,) long each way; `mirrored` (B, 2) tells whether it is at the low x and low y.
    """
    zero, one = np.zeros_like(notch), np.ones_like(notch)
    rest = one - notch
    arms = np.array([[[zero, zero], [one, rest]], [[zero, rest], [rest, one]]]).transpose(
        3, 0, 1, 2
    )
    return np.where(mirrored[:, None, None], 1 - arms[:, :, ::-1], arms)
