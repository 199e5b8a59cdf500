"""Generator of terrain: hills and forests, as a city of convex pieces without streets."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.city.heightfield import Heightfield
from bulletuav.city.model import GROUND, City
from bulletuav.city.streets import Streets
from bulletuav.compiled.functions import cos, sin
from bulletuav.errors import find_choice, finite, shown, unknown
from bulletuav.geometry.solids import Solids

CELLS = 6
"""Minimum number of cells of the ground per wavelength"""
MAX_CELLS = 64
"""Maximum number of cells along a side"""
MAX_TREES = 20_000
MAX_STEEPNESS = 1 / 3
"""Maximum ratio of relief and wavelength: the steepest slopes are then about 45 degrees"""
WAVES = 16
"""Number of plane waves that make hills"""
MIN_TREE = 1.0
MAX_TREE = 100.0
"""Minimum and maximum height of a tree, m"""
SPREAD = 0.25
"""Heights of trees are uniformly distributed within this fraction of `tree_height`"""
CROWN_BASE = 0.35
"""Height of the lowest point of a crown, in heights of its tree"""
CROWN_WIDEST = 0.5
"""Height at which a crown is widest, and its trunk ends, in heights of the tree"""
CROWN_RADIUS = 0.2
"""Maximum radius of a crown, in heights of its tree"""
TRUNK_SIDES = 6
CROWN_SIDES = 4
VARIETIES = 8
"""Number of different trunks, and of different crowns"""
RESOLUTION = 2.0**-10
"""Step of the coordinates of trees, m: copies of a trunk or crown are exactly equal, and the
computation of their hulls, which is slow, is shared"""
ROOT = 1.0
"""Depth to which trunks reach below the surface, beyond their radius, m"""
GROUND_COLOUR = (120.0, 128.0, 86.0)
TRUNK_COLOUR = (106.0, 82.0, 60.0)
CROWN_COLOUR = (72.0, 108.0, 58.0)


@dataclass(frozen=True)
class Terrain:
    """Hills and trees.

    Attributes:
        relief: Height of the highest point above the lowest, which is at z = 0, m; 0 for flat
            ground. At most a third of `wavelength`, so that slopes are below about 45 degrees.
        wavelength: Shortest distance between two hills, m. The longest is twice as long.
        tree_density: Trees per hectare (10,000 m^2); 0 for none.
        tree_height: Mean height of trees, m. Heights are uniformly distributed within 25 % of it.
        trunk_radius: Radius of trunks, m.

    Raises:
        ValueError: If a number is out of bounds.
    """

    relief: float = 0.0
    wavelength: float = 100.0
    tree_density: float = 0.0
    tree_height: float = 12.0
    trunk_radius: float = 0.2

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            object.__setattr__(self, name, finite(name, value))
        for name in ("relief", "tree_density"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name):g}: it must not be below 0")
        for name in ("wavelength", "trunk_radius"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} is {getattr(self, name):g} m: it must be above 0")
        if self.relief > MAX_STEEPNESS * self.wavelength:
            raise ValueError(
                f"relief is {self.relief:g} m: at most {MAX_STEEPNESS * self.wavelength:.4g} m, "
                f"a third of wavelength, is supported; lower relief or raise wavelength"
            )
        if not MIN_TREE <= self.tree_height <= MAX_TREE:
            raise ValueError(
                f"tree_height is {self.tree_height:g} m: "
                f"from {MIN_TREE:g} to {MAX_TREE:g} m is supported"
            )
        thickest = CROWN_RADIUS * (1 - SPREAD) * self.tree_height
        if self.trunk_radius >= thickest:
            raise ValueError(
                f"trunk_radius is {self.trunk_radius:g} m: less than {thickest:.4g} m, "
                f"the radius of the smallest crown, is needed; raise tree_height"
            )


TERRAINS = {
    "hills": Terrain(relief=20.0),
    "forest": Terrain(tree_density=200.0),
    "wooded_hills": Terrain(relief=20.0, tree_density=100.0),
}
"""Terrain by name of the kind"""
WITHOUT_EFFECT = {
    "relief": ("wavelength",),
    "tree_density": ("tree_height", "trunk_radius"),
}
"""Options that have no effect where the option that is the key is 0"""


def find_terrain(name: str, options: Mapping[str, Any]) -> Terrain:
    """Return the terrain of a kind, with some of its numbers changed.

    Args:
        name: Name of one of `TERRAINS`.
        options: Attributes of `Terrain` that differ from those of the kind.

    Raises:
        ValueError: If the name or an option is unknown, a number is out of bounds, or an option has
            no effect.
    """
    kind = find_choice("kind of terrain", name, TERRAINS)
    known = [field.name for field in dataclasses.fields(Terrain)]
    for option in options:
        if option not in known:
            raise unknown(f"option of terrain {name!r}:", option, known)
    terrain = dataclasses.replace(kind, **options)
    for key, others in WITHOUT_EFFECT.items():
        idle = [other for other in others if other in options]
        if idle and getattr(terrain, key) == 0:
            raise ValueError(
                f"{idle[0]} has no effect in terrain {name!r} with {key} 0: "
                f"leave it out, or raise {key}"
            )
    return terrain


def generate_terrain(
    kind: str | Terrain, side: float | tuple[float, float], rng: np.random.Generator
) -> City:
    """Generate terrain of one of `TERRAINS`, or with custom numbers.

    Hills are a sum of plane waves of random directions and phases, sampled at the corners of
    rectangular cells, of which a wavelength has at least six. At the edge of the ground the
    terrain ends in walls. Trees stand at random places (a binomial point process), upright, and may
    overlap. A tree is a building of two pieces, a trunk and a crown.

    Args:
        kind: Name of one of `TERRAINS`, or the numbers.
        side: Side of the square ground, or its lengths along x and y, m.
        rng: Random generator.

    Returns:
        A city without streets.

    Raises:
        ValueError: If the kind is unknown, or a number does not fit the side.
    """
    if not isinstance(rng, np.random.Generator):
        raise ValueError(
            f"rng is {shown(rng)}: a generator such as np.random.default_rng(0) is needed"
        )
    terrain = kind if isinstance(kind, Terrain) else find_terrain(kind, {})
    given = side if isinstance(side, tuple) else (side, side)
    sides = np.array([finite("side", one) for one in given])
    ground = _make_hills(terrain, sides, rng) if terrain.relief else None
    columns = ground.columns() if ground else []
    trees = _make_trees(terrain, sides, ground, rng)
    hulls = tuple(columns + trees)
    count = len(trees) // 2
    building = np.concatenate([np.full(len(columns), GROUND), np.arange(2 * count) % max(count, 1)])
    colours = np.repeat(
        [GROUND_COLOUR, TRUNK_COLOUR, CROWN_COLOUR], [len(columns), count, count], axis=0
    )
    for array in (*hulls, colours):
        array.setflags(write=False)
    return City(
        name=kind if isinstance(kind, str) else "own",
        side=float(sides[0]),
        solids=Solids(np.zeros((0, 2, 3)), hulls, colours),
        building=building.astype(int),
        streets=Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int)),
        depth=float(sides[1]),
        ground=ground,
        is_terrain=True,
    )


def measure_terrain(city: City) -> dict[str, float]:
    """Measure terrain.

    Args:
        city: The terrain.

    Returns:
        Value by the name of each statistic, with its unit. Heights of trees are above the ground
        next to them.
    """
    found = {"relief, m": 0.0, "steepest slope, degrees": 0.0}
    if city.ground is not None:
        found["relief, m"] = float(np.ptp(city.ground.corners))
        found["steepest slope, degrees"] = math.degrees(math.atan(city.ground.steepest))
    found["trees per hectare"] = len(city.heights) / (city.sides / 100).prod()
    if len(city.heights):
        crowns = city.raised.bounds[len(city.heights) :].mean(axis=1)
        found["mean height of trees, m"] = float(np.mean(city.heights - city.surface(crowns)))
    return found


def _make_hills(terrain: Terrain, sides: np.ndarray, rng: np.random.Generator) -> Heightfield:
    """Draw hills; raise ValueError for a wavelength that does not fit the ground."""
    cell = terrain.wavelength / CELLS
    if not terrain.wavelength <= sides.min():
        raise ValueError(
            f"wavelength is {terrain.wavelength:g} m: at most the side of the ground, "
            f"{sides.min():g} m, is needed; lower wavelength and relief"
        )
    if sides.max() > MAX_CELLS * cell:
        raise ValueError(
            f"wavelength is {terrain.wavelength:g} m: at least {sides.max() / MAX_CELLS * CELLS:g} "
            f"m is needed on a ground of {sides.max():g} m; raise wavelength"
        )
    x, y = (np.linspace(-one / 2, one / 2, math.ceil(one / cell) + 1) for one in sides)
    # Wavelengths of one octave, with amplitudes that give equal slopes
    direction = rng.uniform(0, 2 * math.pi, WAVES)
    length = rng.uniform(1, 2, WAVES)
    phase = rng.uniform(0, 2 * math.pi, WAVES)
    height = np.zeros((len(x), len(y)))
    for k in range(WAVES):
        number = 2 * math.pi / (length[k] * terrain.wavelength)
        along = x[:, None] * cos(float(direction[k])) + y * sin(float(direction[k]))
        height += length[k] * sin(number * along + phase[k])
    height -= height.min()
    height *= terrain.relief / height.max()
    height.setflags(write=False)
    return Heightfield(height, sides)


def _make_trees(
    terrain: Terrain, sides: np.ndarray, ground: Heightfield | None, rng: np.random.Generator
) -> list[np.ndarray]:
    """Draw trees; return the corners of all trunks, then of all crowns, m."""
    if not terrain.tree_density:
        return []
    count = round(terrain.tree_density * float(sides.prod()) / 1e4)
    if not 0 < count <= MAX_TREES:
        raise ValueError(
            f"tree_density is {terrain.tree_density:g} per hectare, which makes {count} trees on "
            f"{sides[0]:g} m x {sides[1]:g} m: from 1 to {MAX_TREES} are supported; "
            f"change tree_density or the side"
        )
    # Crowns are inside the ground
    widest = CROWN_RADIUS * (1 + SPREAD) * terrain.tree_height
    if not sides.min() > 2 * widest:
        raise ValueError(
            f"tree_height is {terrain.tree_height:g} m: its crowns are wider than the ground, "
            f"{sides.min():g} m; lower tree_height"
        )
    place = _rounded(rng.uniform(-1, 1, (count, 2)) * (sides / 2 - widest))
    foot = np.zeros(count) if ground is None else ground.height(place)
    shift = np.column_stack([place, _rounded(foot)])
    models = [_make_tree(terrain, rng) for _ in range(VARIETIES)]
    chosen = rng.integers(VARIETIES, size=count).tolist()
    return [models[k][part] + one for part in (0, 1) for k, one in zip(chosen, shift, strict=True)]


def _make_tree(terrain: Terrain, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a tree at the origin; return the corners of its trunk and its crown, m."""
    size = terrain.tree_height * rng.uniform(1 - SPREAD, 1 + SPREAD)
    turn = rng.uniform(0, 2 * math.pi)
    bottom, middle, top = (part * size for part in (CROWN_BASE, CROWN_WIDEST, 1.0))
    outline = terrain.trunk_radius * _polygon(TRUNK_SIDES, turn)
    trunk = _stack(outline, (-ROOT - terrain.trunk_radius, middle))
    ring = _stack(CROWN_RADIUS * size * _polygon(CROWN_SIDES, turn), (middle,))
    crown = np.concatenate([ring, [(0.0, 0.0, bottom), (0.0, 0.0, top)]])
    return _rounded(trunk), _rounded(crown)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Round to multiples of `RESOLUTION`."""
    return np.round(values / RESOLUTION) * RESOLUTION


def _polygon(sides: int, turn: float) -> np.ndarray:
    """Return the corners (sides, 2) of a regular polygon of radius 1, counter-clockwise."""
    angle = turn + 2 * math.pi * np.arange(sides) / sides
    corners: np.ndarray = np.stack([cos(angle), sin(angle)], axis=1)
    return corners


def _stack(outline: np.ndarray, heights: tuple[float, ...]) -> np.ndarray:
    """Return the points (len(heights) V, 3) of an outline (V, 2) at several heights."""
    return np.concatenate(
        [np.column_stack([outline, np.full(len(outline), height)]) for height in heights]
    )
