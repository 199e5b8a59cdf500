"""Cities of a task: options, layouts, and random positions in them."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.city.generator import generate
from bulletuav.city.heightfield import surface_height
from bulletuav.city.imports import READERS
from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, MAX_VALUES, Statistics, parameters
from bulletuav.city.streets import Streets
from bulletuav.city.terrain import TERRAINS, Terrain, find_terrain, generate_terrain
from bulletuav.compiled.kernel import func, kernel
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_sequence, find_choice, finite, shown
from bulletuav.geometry.rotation import dot, minus, point
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.airspace import LARGE_SWARM
from bulletuav.tasks.parts.base import Part
from bulletuav.tasks.parts.charging_pads import ChargingPads, has_pads
from bulletuav.tasks.parts.draws import (
    RandomSource,
    draw_integer,
    draw_uniform,
    get_random_source,
)

RASTER_CELL = 4.0
"""Side of the cells of the raster from which positions are drawn, m"""
TERRAIN_CELL = 1.0
"""Side of these cells in terrain, where gaps between trees are narrower than streets, m"""
STEEP = 1.5
"""Minimum height of starts above slopes, in radii of a drone: more than 1 / cos(45 degrees)"""
BUILDING_MARGIN = 1.0
"""Distance beyond its radius between a starting drone, or a goal, and buildings, m"""
EDGE_MARGIN = 10.0
"""Distance between starts, or goals, and the city's edge, m"""
USER_HEIGHT = 1.5
"""Height of a user's device above the ground, m"""
OPEN = "open"
"""Name of the city without buildings"""
MEASURES = (
    Label("city_alpha", "1", 0.0, 1.0),
    Label("city_beta", "1/km^2", 0.0, MAX_VALUES["beta"]),
    Label("city_gamma", "m", 0.0, MAX_VALUES["gamma"]),
)
"""City parameters in infos and the global state"""
MAX_OCCUPANCY = 0.2
"""Maximum fraction of a city that has grown which discs of diameter `min_separation` cover, so that
random positions are found fast"""
MAX_TRIES = 200
"""Maximum number of draws of a position before an error is raised"""
NO_HILLS, NO_STARTS = np.zeros((0, 0)), np.zeros((0, 3))
"""Arguments of `draw_positions` for flat ground, and for positions without a start"""


@dataclass(frozen=True)
class CityOptions:
    """Options of cities.

    Attributes:
        city: "suburban", "urban", "dense" or "high_rise"; "open" for none; (alpha, beta, gamma),
            see `bulletuav.city.statistics.Statistics`; "hills", "forest" or "wooded_hills"; a dict
            that also sets numbers of the terrain, such as {"kind": "forest", "tree_density": 50},
            see `bulletuav.city.terrain.Terrain`; the path of a .geojson, .json or .obj file; or a
            `City`.
        area: Side of the city's square, or its lengths along x and y, m. More than 256 drones have
            a larger one if they need it. Cities from files have their smallest bounding square.
        irregularity: Irregularity of the city, from 0, a regular grid, to 1; without effect in
            terrain.
        num_layouts: Number of cities that are generated; each world has one of them per episode.
            Files give one.
        city_seed: Seed of the first city, the same for all worlds. Layout k is the city that
            `bulletuav city` generates with this seed + k.
        height: Minimum and maximum height of starts and goals above the ground, m. They are
            outdoors.
        ceiling: Maximum height of the airspace above the highest ground, m.
        min_separation: Minimum distance between starts, and between goals, m.
        charging_pads: Number of pads on the ground that charge batteries, drawn outdoors in each
            episode; or their positions (K, 2), m. See `ChargingPads`. Observations then include
            the block `pads`, unless `observation` is given.
        pad_power: Power that a pad delivers to a drone's battery, W.
        pad_radius: Maximum horizontal distance from a pad at which it charges a drone, m.
        pad_height: Maximum height above a pad at which it charges a drone, m.
    """

    city: Any = "urban"
    area: float | tuple[float, float] = 500.0
    irregularity: float = 0.0
    num_layouts: int = field(default=4, metadata={"most": 256})
    city_seed: int = field(default=0, metadata={"least": 0, "most": 2**32})
    height: tuple[float, float] = (5.0, 25.0)
    ceiling: float = 120.0
    min_separation: float = 20.0
    charging_pads: Any = 0
    pad_power: float = 250.0
    pad_radius: float = 2.0
    pad_height: float = 3.0

    def idle_options(self, num_drones: int) -> Mapping[str, str]:
        """Return the options of missing pads, and of cities that are not generated."""
        idle = {}
        if not has_pads(self):
            idle = dict.fromkeys(("pad_power", "pad_radius", "pad_height"), "charging_pads is 0")
        kind = self.city
        text = f"city {shown(kind.name if isinstance(kind, City) else kind)}"
        is_name = isinstance(kind, str)
        if isinstance(kind, Path | City) or (is_name and Path(kind).suffix.lower() in READERS):
            # Of a file, or made by a user
            names = ("area", "num_layouts", "city_seed", "irregularity")
            idle |= dict.fromkeys(names, f"{text} is already complete")
        elif isinstance(kind, Mapping) or (is_name and kind in (*TERRAINS, OPEN)):
            idle["irregularity"] = f"{text} has no generated streets"
        return idle


def make_cities(config: CityOptions, num_drones: int = 1) -> tuple[City, ...]:
    """Create the cities that the options describe.

    Args:
        config: Options; `city`, `area`, `irregularity`, `num_layouts`, `city_seed` and
            `min_separation` are used.
        num_drones: Number of drones in a city; many need a larger area.

    Returns:
        A city for each layout.

    Raises:
        ValueError: If the options are invalid.
        FileNotFoundError: If `city` is the path of a file that does not exist.
    """
    sides = _sides(config.area)
    kind = config.city
    if isinstance(kind, City):
        return (kind,)
    ending = Path(kind).suffix.lower() if isinstance(kind, str | Path) else ""
    if isinstance(kind, Path) or ending in READERS:
        read = find_choice(f"kind of file for city {str(kind)!r},", ending, READERS)
        return (read(Path(kind)),)
    if isinstance(kind, Mapping):
        kind = _given_terrain(kind)
    elif isinstance(kind, str):
        find_choice("kind of city", kind, {**KINDS, **TERRAINS, OPEN: None})
    else:
        kind = _given_statistics(kind)
    if config.irregularity > 1:
        raise ValueError(
            f"irregularity is {config.irregularity!r}: a number from 0 (regular) to 1 is needed"
        )
    if max(sides) >= TILE_PITCH:
        raise ValueError(
            f"area is {max(sides):g} m: "
            f"less than {TILE_PITCH:g} m is needed, where other worlds begin"
        )
    if num_drones > LARGE_SWARM:
        sides = _enlarged(sides, num_drones, config.min_separation)
    if kind == OPEN:
        return (open_ground(sides),)
    seeds = range(config.city_seed, config.city_seed + config.num_layouts)
    try:
        return tuple(_generated(kind, sides, seed, config.irregularity) for seed in seeds)
    except ValueError as error:
        raise ValueError(f"area is {min(sides):g} m: its {error}") from None


@lru_cache(32)
def _generated(
    kind: str | Statistics | Terrain, sides: tuple[float, float], seed: int, irregularity: float
) -> City:
    """Generate a read-only city; environments of a process share it through the cache."""
    rng = np.random.default_rng(seed)
    if isinstance(kind, Terrain) or kind in TERRAINS:
        city = generate_terrain(kind, sides, rng)
    else:
        city = generate(kind, sides, rng, irregularity)
    for array in (city.solids.boxes, city.building, city.streets.nodes, city.streets.edges):
        array.setflags(write=False)
    return city


def open_ground(sides: tuple[float, float]) -> City:
    """Return a city without buildings, with the given lengths along x and y, m."""
    nothing = Solids(np.zeros((0, 2, 3)))
    nowhere = Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int))
    return City(OPEN, sides[0], nothing, np.zeros(0, dtype=int), nowhere, sides[1])


def _sides(area: Any) -> tuple[float, float]:
    """Return lengths along x and y, m, from one number or two."""
    single = not isinstance(area, list | tuple)
    given = (area, area) if single else as_sequence("area", area, 2)
    sides = (finite("area", given[0]), finite("area", given[1]))
    if min(sides) <= 0:
        raise ValueError(f"area is {min(sides):g} m: it must be above 0")
    return sides


def _enlarged(
    sides: tuple[float, float], num_drones: int, min_separation: float
) -> tuple[float, float]:
    """Return the sides of a city, m, enlarged if it is too small for the drones."""
    needed = num_drones * math.pi / 4 * min_separation**2 / MAX_OCCUPANCY
    growth = max(math.sqrt(needed / (sides[0] * sides[1])), 1.0)
    if growth * max(sides) >= TILE_PITCH:
        raise ValueError(
            f"{num_drones} drones with min_separation {min_separation:g} m need a city of side "
            f"{growth * max(sides):.4g} m: less than {TILE_PITCH:g} m is possible; "
            f"lower min_separation or num_drones"
        )
    return growth * sides[0], growth * sides[1]


def _given_terrain(given: Mapping[Any, Any]) -> Terrain:
    """Return the terrain of a dict with its kind and options."""
    if "kind" not in given:
        raise ValueError(
            f"city is {shown(dict(given))}: a dict of terrain needs the key 'kind', "
            f"one of {', '.join(TERRAINS)}"
        )
    options = {name: value for name, value in given.items() if name != "kind"}
    return find_terrain(given["kind"], options)


def _given_statistics(given: Any) -> Statistics:
    try:
        return Statistics(*as_sequence("city", given, 3))
    except ValueError as error:
        raise ValueError(
            f"city is {shown(given)}, (alpha, beta, gamma) or a name or file: {error}"
        ) from None


class CityLayouts(Part):
    """Cities of a task by layout, and random positions outdoors in them.

    Infos are "city_alpha", the built-up fraction of the world's city; "city_beta", buildings per
    km^2; and "city_gamma", the Rayleigh scale of heights, m. They are also in the global state.

    Attributes:
        config: Options of the cities.
        cities: City of each layout.
        solids: Buildings of each layout, for the engine.
        low: (3,) lower corner of the airspace above all layouts, m.
        high: (3,) upper corner of the airspace, m.
        parameters: alpha, beta and gamma (L + 1, 3) of each city, see `parameters`; the last row is
            zero, for worlds without a city.
    """

    def __init__(self, task: Task[Any]) -> None:
        """Create the cities, and rasters of the positions with space for a drone.

        Args:
            task: The task, with options of cities.

        Raises:
            ValueError: If the options leave no space to fly.
            FileNotFoundError: If the city's file does not exist.
        """
        config: CityOptions = task.config
        context, self._takes_off = task.context, task.takes_off
        _check_heights(config, context)
        self.config = config
        self._num_drones = context.num_drones
        self._measured: tuple[bytes, dict[str, np.ndarray]] = (b"", {})
        self.cities = make_cities(config, context.num_drones)
        self._check_hills(task)
        self.solids: tuple[Solids, ...] = tuple(city.solids for city in self.cities)
        self.parameters = np.array([*map(parameters, self.cities), (0.0, 0.0, 0.0)])
        # The airspace contains the widest city, and must be larger than `min_separation`
        half_sides = np.max([city.sides for city in self.cities], axis=0) / 2
        highest = max(city.ground.corners.max() if city.ground else 0.0 for city in self.cities)
        self.low = np.array([-half_sides[0], -half_sides[1], 0.0])
        self.high = np.array([half_sides[0], half_sides[1], config.ceiling + highest])
        diagonal = math.dist(self.low, self.high)
        if context.num_drones > 1 and config.min_separation >= diagonal:
            raise ValueError(
                f"min_separation is {config.min_separation:g} m: less than {diagonal:.4g} m, "
                f"as far as the city's airspace reaches, is needed"
            )
        # Any position in a free cell is clear of buildings
        margin = context.collision_radius + BUILDING_MARGIN
        self._cells = [TERRAIN_CELL if city.is_terrain else RASTER_CELL for city in self.cities]
        margins = [margin + cell / np.sqrt(2) for cell in self._cells]
        self._raster = [
            _outdoor_cells(city, cell, own, EDGE_MARGIN)
            for city, cell, own in zip(self.cities, self._cells, margins, strict=True)
        ]
        for city, raster, own in zip(self.cities, self._raster, margins, strict=True):
            if not len(raster):
                gap, remedy = "street", "alpha"
                if city.is_terrain:
                    gap, remedy = "gap between trees", "tree_density"
                raise ValueError(
                    f"city {city.name!r} has no {gap} {2 * own:.3g} m wide, "
                    f"{EDGE_MARGIN:g} m off its edge: drones do not fit; "
                    f"lower {remedy}, or raise area"
                )

    def _check_hills(self, task: Task[Any]) -> None:
        """Check that drones do not have to stand on hills, and start clear of them."""
        hilly = [city.name for city in self.cities if city.ground is not None]
        if hilly and (task.lands or has_pads(self.config)):
            raise ValueError(
                f"city {hilly[0]!r} has hills, and drones land on flat ground only: "
                f"turn off take-off, landing and charging pads, or choose terrain with relief 0"
            )
        lowest = STEEP * task.context.collision_radius
        if hilly and self.config.height[0] < lowest:
            raise ValueError(
                f"height is {self.config.height}: at least {lowest:.3g} m above the slopes "
                f"of city {hilly[0]!r} is needed"
            )

    def layouts(self) -> Sequence[Solids]:
        """Return the buildings of each city."""
        return self.solids

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return True if a ball at a position (3,), m, intersects no building of a city."""
        city = self.cities[layout]
        # Highest roof below the ball, sampled on a grid
        steps = radius * np.linspace(-1.0, 1.0, 5)
        below = place[:2] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        is_above = place[2] - radius > float(city.roof(below).max())
        if is_above or city.ground is None:
            return bool(is_above) or bool(city.outdoors(place, radius))
        is_off_ground = place[2] - radius > float(city.surface(below).max())
        return is_off_ground and bool(city.outdoors(place, radius))

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the parameters of the worlds' cities, the same for all drones of a world."""
        layout = frame.scene.layout
        # Cached read-only arrays until a layout changes
        stands = layout.tobytes()
        if self._measured[0] != stands:
            rows = np.repeat(self.parameters[layout][..., None], self._num_drones, 2)
            own = {label.name: rows[:, k].copy() for k, label in enumerate(MEASURES)}
            for array in own.values():
                array.flags.writeable = False
            self._measured = (stands, own)
        return dict(self._measured[1])

    def world_state(self) -> Mapping[str, Block]:
        """Return the parameters of the world's city."""

        def measured(frame: Frame, present: np.ndarray) -> np.ndarray:
            parameters: np.ndarray = self.parameters[frame.scene.layout]
            return parameters

        return {"city": Block(MEASURES, measured)}

    def require(self, leg: float) -> None:
        """Check that all cities are large enough for a distance from start to goal.

        Args:
            leg: Distance, m.

        Raises:
            ValueError: If in some city no two positions are that far apart.
        """
        diagonals = (
            np.linalg.norm(np.ptp(raster, axis=0) + cell)
            for raster, cell in zip(self._raster, self._cells, strict=True)
        )
        widest = min(float(diagonal) for diagonal in diagonals)
        if leg >= widest:
            raise ValueError(
                f"leg is {leg:g} m: less than {widest:.4g} m is needed in this city, or raise area"
            )

    def draw(self, rng: np.random.Generator) -> int:
        """Draw a layout uniformly."""
        return int(rng.integers(len(self.cities)))

    def outdoors(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw positions outdoors, clear of buildings and trees, with space for a drone.

        Args:
            rng: Random generator.
            layout: Index of the city.
            count: Number of positions.

        Returns:
            (count, 2) m.
        """
        raster, half = self._raster[layout], self._cells[layout] / 2
        cell = raster[rng.integers(len(raster), size=count)]
        place: np.ndarray = cell + rng.uniform(-half, half, (count, 2))
        return place

    def free_ground(self, layout: int) -> np.ndarray:
        """Return the middles (M, 2) of the raster's cells from which `outdoors` draws, m."""
        return self._raster[layout]

    def outdoors_around(
        self,
        rng: np.random.Generator,
        layout: int,
        centre: np.ndarray,
        distance: tuple[float, float],
        spacing: float,
        count: int,
    ) -> np.ndarray:
        """Draw positions outdoors at a distance from a centre, at least `spacing` apart.

        Args:
            rng: Random generator.
            layout: Index of the city.
            centre: (2 or 3,) position, m; z is ignored.
            distance: Minimum and maximum horizontal distance from it, m.
            spacing: Minimum horizontal distance between the positions, m.
            count: Number of positions.

        Returns:
            (count, 2) m; fewer if the others were not found.
        """
        low, high = distance
        # Discs of diameter `spacing` around the positions cannot be denser than a hexagonal lattice
        ring = math.pi * ((high + spacing / 2) ** 2 - max(low - spacing / 2, 0.0) ** 2)
        if count * math.pi / 4 * spacing**2 > math.pi / math.sqrt(12) * ring:
            return np.zeros((0, 2))
        half = self._cells[layout] / 2
        raster = self._raster[layout]
        gap = np.sqrt(((raster - centre[:2]) ** 2).sum(axis=1))
        raster = raster[(gap >= low - 2 * half) & (gap <= high + 2 * half)]
        places: list[np.ndarray] = []
        for _ in range(MAX_TRIES * count if len(raster) else 0):
            place = raster[rng.integers(len(raster))] + rng.uniform(-half, half, 2)
            if not low <= math.dist(place, centre[:2]) <= high:
                continue
            if all(math.dist(place, other) >= spacing for other in places):
                places.append(place)
                if len(places) == count:
                    break
        return np.array(places).reshape(-1, 2)

    def raise_above_ground(self, layout: int, places: np.ndarray) -> np.ndarray:
        """Return positions whose z is the given height above the ground of a city.

        Args:
            layout: Index of the city.
            places: (..., 3) x, y, and height above the ground, m.

        Returns:
            (..., 3) m.
        """
        city = self.cities[layout]
        if city.ground is None:
            return places
        raised = places.copy()
        raised[..., 2] += city.surface(places)
        return raised

    def cell_centres(self, layout: int, cell: float) -> np.ndarray:
        """Return the centres of the cells of a square raster that are outdoors.

        Args:
            layout: Index of the city.
            cell: Side of the cells, m.

        Returns:
            (M, 3) m, at the height of a user's device.
        """
        city = self.cities[layout]
        places = _outdoor_cells(city, cell, 0.0)
        return np.column_stack([places, city.surface(places) + USER_HEIGHT])

    def viewpoints(self, layout: int, cell: float) -> np.ndarray:
        """Return a place outdoors in each square of a grid that has space for a drone.

        Args:
            layout: Index of the city.
            cell: Side of the squares, m; the grid begins at the lower corner of the city.

        Returns:
            (M, 3) place nearest to the centre of each square, m, at the height of a user's device.
        """
        raster, low = self._raster[layout], -self.cities[layout].sides / 2
        square = np.floor((raster - low) / cell).astype(int)
        offset = raster - low - (square + 0.5) * cell
        order = np.lexsort((offset[:, 0] ** 2 + offset[:, 1] ** 2, square[:, 1], square[:, 0]))
        is_first = np.any(np.diff(square[order], axis=0, prepend=-1) != 0, axis=1)
        places = raster[order[is_first]]
        heights = np.full(len(places), USER_HEIGHT)
        return self.raise_above_ground(layout, np.column_stack([places, heights]))

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw positions of drones, at least `min_separation` apart.

        Args:
            rng: Random generator.
            layout: Index of the city.
            count: Number of positions.

        Returns:
            (count, 3) m.

        Raises:
            ValueError: If no such positions were found.
        """
        return self._draw_positions(rng, layout, count, None, 0.0)

    def legs(
        self, rng: np.random.Generator, layout: int, count: int, leg: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw starts and goals; starts, and goals, are at least `min_separation` apart.

        Args:
            rng: Random generator.
            layout: Index of the city.
            count: Number of drones.
            leg: Minimum distance from a drone's start to its goal, m.

        Returns:
            Starts (count, 3) and goals (count, 3), m.

        Raises:
            ValueError: If no such positions were found.
        """
        for _ in range(MAX_TRIES):
            start = self.places(rng, layout, count)
            # A start near the centre may have no goal that far away: draw again
            with contextlib.suppress(ValueError):
                return start, self._draw_positions(rng, layout, count, start, leg)
        raise self._make_room_error(layout, count, f" and leg {leg:g} m")

    def _draw_positions(
        self,
        rng: np.random.Generator,
        layout: int,
        count: int,
        start: np.ndarray | None,
        leg: float,
    ) -> np.ndarray:
        """Draw positions (count, 3), m, each at least `leg` from its entry of `start` if given."""
        lowest, highest = self.config.height
        if start is None and self._takes_off:
            highest = lowest  # so that `min_separation` holds on the ground
        city, places = self.cities[layout], np.empty((count, 3))
        corners = NO_HILLS if city.ground is None else city.ground.corners
        ground = (self._raster[layout], self._cells[layout] / 2, corners, city.sides)
        rules = (float(lowest), float(highest), float(self.config.min_separation), leg)
        starts = NO_STARTS if start is None else start
        if draw_positions(get_random_source(rng), ground, rules, starts, places):
            raise self._make_room_error(layout, count, "")
        return places

    def _make_room_error(self, layout: int, count: int, also: str) -> ValueError:
        return ValueError(
            f"no places for {count} drones with min_separation "
            f"{self.config.min_separation:g} m{also} in a city of side "
            f"{self.cities[layout].sides.min():g} m: lower these, or raise area"
        )

    def draw_goal(
        self, rng: np.random.Generator, layout: int, place: np.ndarray, leg: float
    ) -> np.ndarray:
        """Draw a goal (3,), m, at least `leg` from a drone at `place` (3,), m.

        Returns the farthest of MAX_TRIES goals if none is that far away.
        """
        farthest, longest = place, -1.0
        for _ in range(MAX_TRIES):
            goal = np.append(self.outdoors(rng, layout, 1)[0], rng.uniform(*self.config.height))
            goal = self.raise_above_ground(layout, goal)
            distance = math.dist(place, goal)
            if distance > longest:
                farthest, longest = goal, distance
            if distance >= leg:
                break
        return farthest

    def hovering(self, rng: np.random.Generator, layout: int, count: int) -> Spawn:
        """Draw a start at rest at random positions, which are also the goals.

        Args:
            rng: Random generator.
            layout: Index of the city.
            count: Number of drones.

        Raises:
            ValueError: If no such positions were found.
        """
        place = self.places(rng, layout, count)
        return Spawn(position=place, goal=place, layout=layout)


@kernel
def draw_positions(
    source: RandomSource,
    ground: tuple[np.ndarray, float, np.ndarray, np.ndarray],
    rules: tuple[float, float, float, float],
    start: np.ndarray,
    places: np.ndarray,
) -> bool:
    """Draw positions outdoors, one after the other, by rejection sampling.

    Args:
        source: Source of random numbers.
        ground: Centres (M, 2) of the raster's cells outdoors, m, and half their side, m; heights at
            the corners of the ground's cells, m, and (2,) sides of the ground, m; see
            `surface_height`.
        rules: Minimum and maximum height above the ground, minimum distance from each other, and
            minimum distance from the start, m.
        start: (N, 3) start of each drone, m, or empty.
        places: (N, 3) output, m.

    Returns:
        Whether no position was found for one of the drones, in MAX_TRIES draws.
    """
    raster, half, corners, sides = ground
    lowest, highest, apart, leg = rules
    for i in range(places.shape[0]):
        is_found = False
        for _ in range(MAX_TRIES):
            cell = draw_integer(source, raster.shape[0])
            x = raster[cell, 0] + draw_uniform(source, -half, half)
            y = raster[cell, 1] + draw_uniform(source, -half, half)
            z = draw_uniform(source, lowest, highest) + surface_height(corners, sides, x, y)
            # First, as most goals are too close
            if start.shape[0] and _distance(start, i, x, y, z) < leg:
                continue
            is_found = True
            for k in range(i):
                if _distance(places, k, x, y, z) < apart:
                    is_found = False
                    break
            if is_found:
                places[i, 0], places[i, 1], places[i, 2] = x, y, z
                break
        if not is_found:
            return True
    return False


@func
def _distance(places: np.ndarray, k: int, x: float, y: float, z: float) -> float:
    """Return the distance of a point from the k-th of positions (N, 3), m."""
    gap = minus(point(places, k), (x, y, z))
    return math.sqrt(dot(gap, gap))


def add_city(task: Task[Any]) -> CityLayouts:
    """Add cities, and pads in them, to a task; its arena is their ground, up to the ceiling.

    Args:
        task: The task, with options of cities.

    Returns:
        The cities.

    Raises:
        ValueError: If the cities leave no space to fly, or options of pads are invalid.
        FileNotFoundError: If the city's file does not exist.
    """
    city_layouts = task.add(CityLayouts(task))
    task.arena_low, task.arena_high = city_layouts.low, city_layouts.high
    if has_pads(task.config):
        task.add(ChargingPads(task, city_layouts.outdoors))
    return city_layouts


def _check_heights(config: CityOptions, context: TaskContext) -> None:
    """Check that heights are inside the airspace, and that drones cannot start in contact."""
    lowest, highest = config.height
    if not context.collision_radius < lowest <= highest < config.ceiling:
        raise ValueError(
            f"height is {config.height}: from low to high within "
            f"{context.collision_radius:.3g} m, where a drone touches the ground, "
            f"and ceiling {config.ceiling:g} m is needed"
        )
    largest_drone = 2 * context.collision_radius
    if config.min_separation <= largest_drone:
        raise ValueError(
            f"min_separation is {config.min_separation:g} m: "
            f"more than {largest_drone:.3g} m is needed, the largest drone's size"
        )


@lru_cache(32)
def _outdoor_cells(city: City, cell: float, margin: float, edge: float = 0.0) -> np.ndarray:
    """Return the centres (M, 2) of a raster's cells that are outdoors, m.

    They are at least `margin` m from footprints and `edge` m from the city's edge.
    """
    middles = [
        (np.arange(count) + 0.5) * side / count - side / 2
        for side, count in ((side, int(side / cell)) for side in city.sides)
    ]
    places = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    is_inside = (np.abs(places) <= city.sides / 2 - edge).all(axis=1)
    cells: np.ndarray = places[is_inside & city.outdoors(places, margin)]
    cells.setflags(write=False)
    return cells
