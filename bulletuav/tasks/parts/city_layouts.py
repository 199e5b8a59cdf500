"""Cities of a task: options, layouts, and random places in them."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.city.generator import generate
from bulletuav.city.imports import READERS
from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, MOST, Statistics, parameters
from bulletuav.city.streets import Streets
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_sequence, choose, finite, shown
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.base import Part

RASTER_CELL = 4.0
"""Side of the cells of the raster from which places are drawn, m"""
BUILDING_MARGIN = 1.0
"""Distance beyond its radius between a drone that starts, or a goal, and buildings, m"""
EDGE_MARGIN = 10.0
"""Distance between drones that start, or goals, and the city's edge, m"""
USER_HEIGHT = 1.5
"""Height of a user's device above the ground, m"""
OPEN = "open"
"""Name of the city in which nothing stands"""
MEASURES = (
    Label("city_alpha", "1", 0.0, 1.0),
    Label("city_beta", "1/km^2", 0.0, MOST["beta"]),
    Label("city_gamma", "m", 0.0, MOST["gamma"]),
)
"""What infos and the global state have of a city"""
MAX_TRIES = 200
"""Random draws of a place before it counts as impossible"""


@dataclass(frozen=True)
class CityOptions:
    """Options of cities, and of obstacles in them (`ObstacleOptions`).

    Attributes:
        city: "suburban", "urban", "dense" or "high_rise"; "open" for none; (alpha, beta, gamma),
            see `bulletuav.city.statistics.Statistics`; the path of a .geojson or .obj file; or a
            `City`.
        area: Side of the city's square, or its lengths along x and y, m. Files have the smallest
            square that holds all.
        irregularity: Irregularity of the city, from 0, a regular grid, to 1.
        num_layouts: Number of cities that are made; a world has one of them for an episode. Files
            give one.
        city_seed: Seed of the first city, the same for all worlds. Layout k is what
            `bulletuav city` makes of this seed + k.
        height: Least and greatest height of starts and goals, m. They are outdoors.
        ceiling: Greatest height of the airspace, m.
        min_separation: Least distance between starts, and between goals, m.
        obstacle_radius: Least and greatest radius of the obstacles' bounding spheres, m: they have
            to fit into streets.
        obstacle_speed: Greatest speed of an obstacle on each axis, m/s.
    """

    city: Any = "urban"
    area: float | tuple[float, float] = 500.0
    irregularity: float = 0.0
    num_layouts: int = field(default=4, metadata={"most": 256})
    city_seed: int = field(default=0, metadata={"least": 0, "most": 2**32})
    height: tuple[float, float] = (5.0, 25.0)
    ceiling: float = 120.0
    min_separation: float = 20.0
    obstacle_radius: tuple[float, float] = (0.5, 2.0)
    obstacle_speed: float = field(default=2.0, metadata={"most": 100.0})


def make_cities(config: CityOptions) -> tuple[City, ...]:
    """Make the cities that the options ask for.

    Args:
        config: Options, of which `city`, `area`, `irregularity`, `num_layouts` and `city_seed`
            count.

    Returns:
        A city for each layout.

    Raises:
        ValueError: There can be no such city.
        FileNotFoundError: `city` is the path of a file that is not there.
    """
    sides = _sides(config.area)
    kind = config.city
    # A city that is ready, or a file of one.
    if isinstance(kind, City):
        return (kind,)
    ending = Path(kind).suffix.lower() if isinstance(kind, str | Path) else ""
    if isinstance(kind, Path) or ending in READERS:
        read = choose(f"kind of file for city {str(kind)!r},", ending, READERS)
        return (read(Path(kind)),)
    # Cities made at random, of a known kind or of given statistics.
    if isinstance(kind, str):
        choose("kind of city", kind, {**KINDS, OPEN: None})
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
    if kind == OPEN:
        return (open_ground(sides),)
    seeds = range(config.city_seed, config.city_seed + config.num_layouts)
    try:
        return tuple(_generated(kind, sides, seed, config.irregularity) for seed in seeds)
    except ValueError as error:
        raise ValueError(f"area is {min(sides):g} m: its {error}") from None


@lru_cache(32)
def _generated(
    kind: str | Statistics, sides: tuple[float, float], seed: int, irregularity: float
) -> City:
    """Generate a city, of which several environments of a process share all that it knows."""
    city = generate(kind, sides, np.random.default_rng(seed), irregularity)
    for array in (city.solids.boxes, city.building, city.streets.nodes, city.streets.edges):
        array.setflags(write=False)
    return city


def open_ground(sides: tuple[float, float]) -> City:
    """Make ground of these lengths along x and y, m, on which nothing stands."""
    nothing = Solids(np.zeros((0, 2, 3)))
    nowhere = Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int))
    return City(OPEN, sides[0], nothing, np.zeros(0, dtype=int), nowhere, sides[1])


def _sides(area: Any) -> tuple[float, float]:
    """Make lengths along x and y, m, of one number or two."""
    single = not isinstance(area, list | tuple)
    given = (area, area) if single else as_sequence("area", area, 2)
    sides = (finite("area", given[0]), finite("area", given[1]))
    if min(sides) <= 0:
        raise ValueError(f"area is {min(sides):g} m: it must be above 0")
    return sides


def _given_statistics(given: Any) -> Statistics:
    """Make statistics of the three numbers that the option `city` gives."""
    try:
        return Statistics(*as_sequence("city", given, 3))
    except ValueError as error:
        raise ValueError(
            f"city is {shown(given)}, (alpha, beta, gamma) or a name or file: {error}"
        ) from None


class CityLayouts(Part):
    """Cities of a task by layout, and random places outdoors in them.

    Infos are "city_alpha", the built-up share of the world's city; "city_beta", buildings per
    km^2; and "city_gamma", the Rayleigh scale of heights, m. The global state has them, too.

    Attributes:
        config: Options of the cities.
        cities: City of each layout.
        solids: Buildings of each layout, for the engine.
        low: (3,) lower corner of the airspace above all layouts, m.
        high: (3,) upper corner of the airspace, m.
        parameters: alpha, beta and gamma (L + 1, 3) of each city, see `parameters`; then zeros, for
            worlds without a city.
    """

    def __init__(self, task: Task[Any]) -> None:
        """Make the cities, and rasters of the places where drones have room.

        Args:
            task: The task, with options of cities, whose drones are to have room.

        Raises:
            ValueError: The options leave no room to fly.
            FileNotFoundError: The city's file is not there.
        """
        config: CityOptions = task.config
        context, self._takes_off = task.context, task.takes_off
        _check_heights(config, context)
        self.config = config
        self._num_drones = context.num_drones
        self._measured: tuple[bytes, dict[str, np.ndarray]] = (b"", {})
        self.cities = make_cities(config)
        self.solids: tuple[Solids, ...] = tuple(city.solids for city in self.cities)
        self.parameters = np.array([*map(parameters, self.cities), (0.0, 0.0, 0.0)])
        # The airspace holds the widest city, and must hold drones as far apart as asked for.
        reach = np.max([city.sides for city in self.cities], axis=0) / 2
        self.low = np.array([-reach[0], -reach[1], 0.0])
        self.high = np.array([reach[0], reach[1], config.ceiling])
        diagonal = math.dist(self.low, self.high)
        if context.num_drones > 1 and config.min_separation >= diagonal:
            raise ValueError(
                f"min_separation is {config.min_separation:g} m: less than {diagonal:.4g} m, "
                f"as far as the city's airspace reaches, is needed"
            )
        # Wherever in a free cell a drone starts, it is clear of buildings.
        margin = context.collision_radius + BUILDING_MARGIN + RASTER_CELL / np.sqrt(2)
        self._raster = [
            _outdoor_cells(city, RASTER_CELL, margin, EDGE_MARGIN) for city in self.cities
        ]
        for city, raster in zip(self.cities, self._raster, strict=True):
            if not len(raster):
                raise ValueError(
                    f"city {city.name!r} has no street {2 * margin:.3g} m wide, "
                    f"{EDGE_MARGIN:g} m off its edge: drones have no room; "
                    f"lower alpha, or raise area"
                )

    def layouts(self) -> Sequence[Solids]:
        """List the buildings of each city."""
        return self.solids

    def is_free(self, place: np.ndarray, radius: float, layout: int) -> bool:
        """Return whether a ball at a place (3,), m, is off all buildings of a city."""
        city = self.cities[layout]
        # The highest roof below the ball, on a raster of it.
        steps = radius * np.linspace(-1.0, 1.0, 5)
        below = place[:2] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        is_above = place[2] - radius > float(city.roof(below).max())
        return bool(is_above) or bool(city.outdoors(place, radius))

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return what the cities of the worlds measure, the same for all drones of a world."""
        layout = frame.scene.layout
        # The same read-only arrays while the same cities stand
        stands = layout.tobytes()
        if self._measured[0] != stands:
            rows = np.repeat(self.parameters[layout][..., None], self._num_drones, 2)
            own = {label.name: rows[:, k].copy() for k, label in enumerate(MEASURES)}
            for array in own.values():
                array.flags.writeable = False
            self._measured = (stands, own)
        return dict(self._measured[1])

    def world_state(self) -> Mapping[str, Block]:
        """Return what the city that stands in the world measures."""

        def measured(frame: Frame, present: np.ndarray) -> np.ndarray:
            parameters: np.ndarray = self.parameters[frame.scene.layout]
            return parameters

        return {"city": Block(MEASURES, measured)}

    def require(self, leg: float) -> None:
        """Refuse a distance from start to goal that a city is too small for.

        Args:
            leg: Distance, m.

        Raises:
            ValueError: In some city no two places are that far apart.
        """
        diagonals = (
            np.linalg.norm(np.ptp(raster, axis=0) + RASTER_CELL) for raster in self._raster
        )
        widest = min(float(diagonal) for diagonal in diagonals)
        if leg >= widest:
            raise ValueError(
                f"leg is {leg:g} m: less than {widest:.4g} m is needed in this city, or raise area"
            )

    def draw(self, rng: np.random.Generator) -> int:
        """Draw a layout, all with the same chance."""
        return int(rng.integers(len(self.cities)))

    def outdoors(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw places outdoors with room for a drone.

        Args:
            rng: Random generator.
            layout: Which city.
            count: Number of places.

        Returns:
            (count, 2) m.
        """
        raster = self._raster[layout]
        cell = raster[rng.integers(len(raster), size=count)]
        place: np.ndarray = cell + rng.uniform(-RASTER_CELL / 2, RASTER_CELL / 2, (count, 2))
        return place

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw places for drones, `min_separation` apart.

        Args:
            rng: Random generator.
            layout: Which city.
            count: Number of places.

        Returns:
            (count, 3) m.

        Raises:
            ValueError: There is no room for so many.
        """
        return self._draw_positions(rng, layout, count, None, 0.0)

    def legs(
        self, rng: np.random.Generator, layout: int, count: int, leg: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw starts and goals; starts, and goals, are `min_separation` apart.

        Args:
            rng: Random generator.
            layout: Which city.
            count: Number of drones.
            leg: Least distance from a drone's start to its goal, m.

        Returns:
            Starts (count, 3) and goals (count, 3), m.

        Raises:
            ValueError: There is no room for so many.
        """
        for _ in range(MAX_TRIES):
            start = self.places(rng, layout, count)
            # A start in the middle may have nowhere so far away: then others are drawn.
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
        """Draw places (count, 3), each `leg` from its entry of `start` where that is given."""
        lowest, highest = self.config.height
        if start is None and self._takes_off:
            highest = lowest  # apart as seen from above
        places = np.empty((count, 3))
        for i in range(count):
            for _ in range(MAX_TRIES):
                places[i, :2] = self.outdoors(rng, layout, 1)[0]
                places[i, 2] = rng.uniform(lowest, highest)
                # Most goals are too near their starts, which takes less time to see
                if start is not None and math.dist(start[i], places[i]) < leg:
                    continue
                gaps = np.linalg.norm(places[:i] - places[i], axis=1)
                if gaps.min(initial=np.inf) >= self.config.min_separation:
                    break
            else:
                raise self._make_room_error(layout, count, "")
        return places

    def _make_room_error(self, layout: int, count: int, also: str) -> ValueError:
        """Make the error for a city that is too small for so many drones."""
        return ValueError(
            f"no places for {count} drones with min_separation "
            f"{self.config.min_separation:g} m{also} in a city of side "
            f"{self.cities[layout].sides.min():g} m: lower these, or raise area"
        )

    def draw_goal(
        self, rng: np.random.Generator, layout: int, place: np.ndarray, leg: float
    ) -> np.ndarray:
        """Draw a goal (3,), m, for a drone at `place` (3,): the first that is `leg` m away.

        Where none of many is, the farthest.
        """
        farthest, reach = place, -1.0
        for _ in range(MAX_TRIES):
            goal = np.append(self.outdoors(rng, layout, 1)[0], rng.uniform(*self.config.height))
            distance = math.dist(place, goal)
            if distance > reach:
                farthest, reach = goal, distance
            if distance >= leg:
                break
        return farthest

    def hovering(self, rng: np.random.Generator, layout: int, count: int) -> Spawn:
        """Draw a start at rest at random places, which are the drones' goals too.

        Args:
            rng: Random generator.
            layout: Which city.
            count: Number of drones.

        Raises:
            ValueError: There is no room for so many.
        """
        place = self.places(rng, layout, count)
        return Spawn(position=place, goal=place, layout=layout)


def add_city(task: Task[Any]) -> CityLayouts:
    """Add cities to a task; its arena is their ground, up to the ceiling.

    Args:
        task: The task, with options of cities.

    Returns:
        The cities.

    Raises:
        ValueError: They leave no room to fly.
        FileNotFoundError: The city's file is not there.
    """
    city_layouts = task.add(CityLayouts(task))
    task.arena_low, task.arena_high = city_layouts.low, city_layouts.high
    return city_layouts


def _check_heights(config: CityOptions, context: TaskContext) -> None:
    """Refuse heights outside the airspace, and drones that could start in touch."""
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
    """Return the middles (M, 2) of a raster's cells that are outdoors, m.

    They are `margin` m from footprints and `edge` m from the city's edge.
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


def ground_cells(city: City, cell: float) -> np.ndarray:
    """Return the middles of the cells of a square raster that are outdoors.

    Args:
        city: The city.
        cell: Side of the cells, m.

    Returns:
        (M, 3) m, at the height of a user's device.
    """
    places = _outdoor_cells(city, cell, 0.0)
    height = np.full((len(places), 1), USER_HEIGHT)
    return np.concatenate([places, height], axis=1)
