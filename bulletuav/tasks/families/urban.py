"""Flight in a city: its options, where drones and users can be in it, and what its tasks have in common."""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from bulletuav.city.generator import generate
from bulletuav.city.imports import READERS
from bulletuav.city.model import City
from bulletuav.city.statistics import KINDS, Statistics
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import as_sequence, choose, shown
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.base import Task, TaskConfig
from bulletuav.tasks.families.airspace import UNCERTAINTY, Airspace, FlightConfig
from bulletuav.tasks.frame import Spawn, TaskContext

PLACES_CELL = 4.0  # m, of the raster from which places are drawn
ROOM = 1.0  # m, beyond its radius, between a drone that starts, or a goal, and buildings
USER_HEIGHT = 1.5  # m, of a user's device above the ground
EDGE = 10.0  # m, between drones that start, or goals, and the city's edge
TRIES = 200
URBAN_DIFFICULTIES: dict[str, dict[str, Any]] = {
    "easy": UNCERTAINTY["easy"],
    "medium": {"num_drones": 5, "irregularity": 0.5, **UNCERTAINTY["medium"]},
    "hard": {"num_drones": 8, "city": "dense", "irregularity": 0.5, **UNCERTAINTY["hard"]},
    "extreme": {
        "num_drones": 16,
        "city": "high_rise",
        "irregularity": 1.0,
        **UNCERTAINTY["extreme"],
    },
}
"""What a difficulty makes of a city and of its airspace"""


DEFAULTS: dict[str, Any] = {
    "num_drones": 3,
    "airframe": "hummingbird",
    "action": "velocity",
    "decision_hz": 10,
    "max_speed": 15.0,
    "battery_capacity": 23.3,
}
"""What tasks in cities start from"""


@dataclass(frozen=True)
class UrbanConfig(TaskConfig):
    """Options of flights in a city, m.

    city           "suburban", "urban", "dense", "high_rise"; (alpha, beta, gamma), see `city.statistics.Statistics`; the
                   path of a .geojson or .obj file; or a `City`
    area           side of the city's square; of files the smallest that holds all
    irregularity   from 0, a regular grid, to 1
    num_layouts    how many cities are made, one of which stands in a world during an episode; of files there is one
    city_seed      of the first of them (layout k is what `bulletuav city` makes of this seed + k), for all worlds the same
    height         of starts and goals, from low to high; those are outdoors
    ceiling        of the airspace
    min_separation  between starts, and between goals
    """

    city: Any = "urban"
    area: float = 500.0
    irregularity: float = 0.0
    num_layouts: int = field(default=4, metadata={"most": 256})
    city_seed: int = field(default=0, metadata={"least": 0, "most": 2**32})
    height: tuple[float, float] = (5.0, 25.0)
    ceiling: float = 120.0
    min_separation: float = 20.0


def make_cities(config: UrbanConfig) -> tuple[City, ...]:
    """The cities that the options ask for. Raises ValueError for what cannot be, FileNotFoundError for a missing file."""
    kind = config.city
    if isinstance(kind, City):
        return (kind,)
    ending = Path(kind).suffix.lower() if isinstance(kind, str | Path) else ""
    if isinstance(kind, Path) or ending in READERS:
        return (choose(f"kind of file for city {str(kind)!r},", ending, READERS)(Path(kind)),)
    if isinstance(kind, str):
        choose("kind of city", kind, KINDS)
    else:
        kind = _own_statistics(kind)
    if config.irregularity > 1:
        raise ValueError(
            f"irregularity is {config.irregularity!r}: a number from 0 (regular) to 1 is needed"
        )
    if config.area >= TILE_PITCH:
        raise ValueError(
            f"area is {config.area:g} m: less than {TILE_PITCH:g} m is needed, where other worlds begin"
        )
    seeds = range(config.city_seed, config.city_seed + config.num_layouts)
    try:
        return tuple(
            generate(kind, config.area, np.random.default_rng(seed), config.irregularity)
            for seed in seeds
        )
    except ValueError as error:
        raise ValueError(f"area is {config.area:g} m: its {error}") from None


def _own_statistics(given: Any) -> Statistics:
    try:
        return Statistics(*as_sequence("city", given, 3))
    except ValueError as error:
        raise ValueError(
            f"city is {shown(given)}, (alpha, beta, gamma) or a name or file: {error}"
        ) from None


def check_share(name: str, value: float) -> None:
    """Raise ValueError unless it is a share that can be reached."""
    if not 0 < value <= 1:
        raise ValueError(f"{name} is {value:g}: a share above 0 and at most 1 is needed")


class CityLayouts:
    """The cities of a task by layout: `cities` and, for the engine, `solids`; corners `low`, `high` (3,) of the airspace."""

    def __init__(self, config: UrbanConfig, context: TaskContext):
        """Raises ValueError where the options leave no room to fly."""
        low, high = config.height
        if not context.collision_radius < low <= high < config.ceiling:
            raise ValueError(
                f"height is {config.height}: from low to high within {context.collision_radius:.3g} m, where a drone "
                f"touches the ground, and ceiling {config.ceiling:g} m is needed"
            )
        if config.min_separation <= 2 * context.collision_radius:
            raise ValueError(
                f"min_separation is {config.min_separation:g} m: more than {2 * context.collision_radius:.3g} m is "
                f"needed, the largest drone's size"
            )
        self.config, self.cities = config, make_cities(config)
        self.solids: tuple[Solids, ...] = tuple(city.solids for city in self.cities)
        reach = max(city.side for city in self.cities) / 2
        self.low, self.high = (
            np.array([-reach, -reach, 0.0]),
            np.array([reach, reach, config.ceiling]),
        )
        if context.num_drones > 1 and config.min_separation >= math.dist(self.low, self.high):
            raise ValueError(
                f"min_separation is {config.min_separation:g} m: less than {math.dist(self.low, self.high):.4g} m, as far "
                f"as the city's airspace reaches, is needed"
            )
        margin = context.collision_radius + ROOM + PLACES_CELL / np.sqrt(2)
        self._raster = [_outdoors(city, PLACES_CELL, margin, EDGE) for city in self.cities]
        for city, raster in zip(self.cities, self._raster, strict=True):
            if not len(raster):
                raise ValueError(
                    f"city {city.name!r} has no street {2 * margin:.3g} m wide, {EDGE:g} m off its edge: drones have no "
                    f"room; lower alpha, or raise area"
                )

    def require(self, leg: float) -> None:
        """Raise ValueError unless in every city two places are `leg` m apart."""
        widest = min(
            float(np.linalg.norm(np.ptp(raster, axis=0) + PLACES_CELL)) for raster in self._raster
        )
        if leg >= widest:
            raise ValueError(
                f"leg is {leg:g} m: less than {widest:.4g} m is needed in this city, or raise area"
            )

    def draw(self, rng: np.random.Generator) -> int:
        """A layout."""
        return int(rng.integers(len(self.cities)))

    def outdoors(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """(count, 2) random places outdoors, with room for a drone, m."""
        raster = self._raster[layout]
        return raster[rng.integers(len(raster), size=count)] + rng.uniform(
            -PLACES_CELL / 2, PLACES_CELL / 2, (count, 2)
        )

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """(count, 3) places for drones, `min_separation` apart. Raises ValueError where there is no room for so many."""
        return self._drawn(rng, layout, count, None, 0.0)

    def legs(
        self, rng: np.random.Generator, layout: int, count: int, leg: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(count, 3) starts and goals, `leg` m or more between the two of each drone; else as `places`."""
        for _ in range(TRIES):
            start = self.places(rng, layout, count)
            with contextlib.suppress(
                ValueError
            ):  # a start in the middle may have nowhere so far away
                return start, self._drawn(rng, layout, count, start, leg)
        raise self._no_room(layout, count, f" and leg {leg:g} m")

    def _drawn(
        self,
        rng: np.random.Generator,
        layout: int,
        count: int,
        start: np.ndarray | None,
        leg: float,
    ) -> np.ndarray:
        low, high = self.config.height
        found = np.empty((count, 3))
        for i in range(count):
            for _ in range(TRIES):
                found[i, :2], found[i, 2] = self.outdoors(rng, layout, 1)[0], rng.uniform(low, high)
                apart = (
                    np.linalg.norm(found[:i] - found[i], axis=1).min(initial=np.inf)
                    >= self.config.min_separation
                )
                if apart and (start is None or np.linalg.norm(start[i] - found[i]) >= leg):
                    break
            else:
                raise self._no_room(layout, count, "")
        return found

    def _no_room(self, layout: int, count: int, also: str) -> ValueError:
        return ValueError(
            f"no places for {count} drones with min_separation {self.config.min_separation:g} m{also} in a city of side "
            f"{self.cities[layout].side:g} m: lower these, or raise area"
        )

    def hovering(self, rng: np.random.Generator, layout: int, count: int) -> Spawn:
        """Drones at rest at random places, which are their goals too."""
        place = self.places(rng, layout, count)
        return Spawn(position=place, goal=place, layout=layout)


def _outdoors(city: City, cell: float, margin: float, edge: float = 0.0) -> np.ndarray:
    """(M, 2) middles of the cells of a square raster, `margin` m from footprints and `edge` m from the city's edge."""
    count = int(city.side / cell)
    middle = (np.arange(count) + 0.5) * city.side / count - city.side / 2
    places = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.abs(places).max(axis=1, initial=0.0) <= city.side / 2 - edge
    return places[inside & city.outdoors(places, margin)]


def ground_cells(city: City, cell: float) -> np.ndarray:
    """(M, 3) middles of the outdoor cells of a square raster, at the height of a user's device, m."""
    places = _outdoors(city, cell, 0.0)
    return np.concatenate([places, np.full((len(places), 1), USER_HEIGHT)], axis=1)


UrbanConfigT = TypeVar("UrbanConfigT", bound=UrbanConfig)


class UrbanTask(Task[UrbanConfigT], Generic[UrbanConfigT]):
    """A task in a city: its bounds are those of the city and its ceiling."""

    difficulties: ClassVar = URBAN_DIFFICULTIES

    def __init__(self, config: UrbanConfigT, context: TaskContext) -> None:
        """Raises ValueError where the city leaves no room to fly."""
        super().__init__(config, context)
        self.town = CityLayouts(config, context)
        self.arena_low, self.arena_high = self.town.low, self.town.high

    def layouts(self) -> Sequence[Solids]:
        """The cities."""
        return self.town.solids


@dataclass(frozen=True)
class UrbanFlightConfig(UrbanConfig, FlightConfig):
    """Options of flights to goals in cities, beside those of all such flights; goals are `leg` m or farther from starts."""

    leg: float = 150.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)


UrbanFlightConfigT = TypeVar("UrbanFlightConfigT", bound=UrbanFlightConfig)


class UrbanFlight(
    UrbanTask[UrbanFlightConfigT], Airspace[UrbanFlightConfigT], Generic[UrbanFlightConfigT]
):
    """A task of flights to goals through a city; a task adds what drones observe.

    Starts, at rest, and goals lie outdoors. d_safe is 2 m, episodes are truncated after 600 decisions. Contact with a
    building is a collision.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1.
    """

    defaults: ClassVar = {**DEFAULTS, "horizon": 600, "difficulty": "easy"}
    presets: ClassVar = {}
    baseline = "planner"

    def __init__(self, config: UrbanFlightConfigT, context: TaskContext) -> None:
        """Raises ValueError where the city leaves no room to fly, or is too small for a leg."""
        super().__init__(config, context)
        self.town.require(config.leg)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """At rest outdoors, goals outdoors."""
        layout, count = self.town.draw(rng), self.context.num_drones
        start, goal = self.town.legs(rng, layout, count, self.config.leg)
        return self.launch(start, goal, rng)._replace(layout=layout)
