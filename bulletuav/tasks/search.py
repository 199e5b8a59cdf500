"""Task `search`: drones look for victims near a clue, and hover above each of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.observations.neighbours import HEARD
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.city_layouts import (
    EDGE_MARGIN,
    MAX_TRIES,
    OPEN,
    USER_HEIGHT,
    CityOptions,
    add_city,
)
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.victims import Detection, Findings, update_findings

VICTIM = Obstacle("cylinder", (0.4, 0.8), (0.95, 0.35, 0.05, 1.0))
"""Body of a victim that sits on the ground, in the orange of life jackets"""
HALF_HEIGHT = VICTIM.size[1] / 2
TOP = np.array((0.0, 0.0, HALF_HEIGHT))
"""Offset from the centre of a victim's body to its top, m"""
SIGHT_POINT = np.array((0.0, 0.0, 0.2))
"""Offset from this top to the point that drones have to see, clear of the body, m"""
MAX_CELLS = 32
"""Maximum number of squares in a row of the map"""
ROUNDING = 1e-6
"""Tolerance of the number of decisions of a hover"""


@dataclass(frozen=True)
class SearchConfig(CityOptions, TaskConfig):
    """Options of `search`, in addition to those of cities (`CityOptions`).

    Attributes:
        num_victims: Number of victims.
        clue_radius: Maximum horizontal distance of a victim from the clue, m.
        victim_spacing: Minimum horizontal distance between victims, m.
        start_distance: Minimum and maximum horizontal distance of starts from the clue, m.
        sight_radius: Horizontal distance up to which drones see victims below them, m.
        sight_noise: Standard deviation of the observed offset to a victim on each axis, as a
            fraction of its distance.
        hover_time: Time of an uninterrupted hover that finds a victim, s.
        hover_height: Minimum and maximum height of the hover above the top of the victim, m.
        hover_radius: Maximum horizontal distance of the hover from the victim, m.
        cell: Maximum side of the squares into which the ground around the clue is divided, m.
        radio_range: Distance up to which drones share what they searched and found, m. With
            randomized communication, they also have to hear each other.
        d_safe: Separation below which two drones are in conflict, m.
        city: City or terrain, see `CityOptions`; "open" for flat ground.
        area: Side of the ground, or its lengths along x and y, m.
        height: Minimum and maximum height of starts above the ground, m.
        ceiling: Maximum height of the airspace above the highest ground, m.
        min_separation: Minimum distance between starts, m.
    """

    num_victims: int = field(default=1, metadata={"most": 64})
    clue_radius: float = 30.0
    victim_spacing: float = 8.0
    start_distance: tuple[float, float] = (20.0, 50.0)
    sight_radius: float = 10.0
    sight_noise: float = 0.05
    hover_time: float = 2.0
    hover_height: tuple[float, float] = (2.0, 4.0)
    hover_radius: float = 1.0
    cell: float = 8.0
    radio_range: float = 50.0
    d_safe: float = 2.0
    city: Any = OPEN
    area: float | tuple[float, float] = 200.0
    height: tuple[float, float] = (20.0, 30.0)
    ceiling: float = 40.0
    min_separation: float = 5.0

    def idle_options(self, num_drones: int) -> Mapping[str, str]:
        """Return those of cities, and the radio of a single drone; see `TaskConfig`."""
        idle = super().idle_options(num_drones)
        return {**idle, "radio_range": "num_drones is 1"} if num_drones == 1 else idle


@reward
def found(newly_found: float) -> float:
    """Fraction of the victims that any drone finds in the decision."""
    return newly_found


@reward
def searched(newly_searched: float) -> float:
    """Fraction of the cells that the drone searches first; shared by drones that do so together."""
    return newly_searched


@reward
def approach(approached: float) -> float:
    """Decrease of the distance to the hover above the victim in sight, m."""
    return approached


@reward
def time(
    collision: bool,
    outside: bool,
    depleted: bool,
    complete: bool,
    time: float,
    duration: float,
    period: float,
) -> float:
    """1 per decision, and 1 per remaining decision if the drone is lost before all finds."""
    is_lost = (collision or outside or depleted) and not complete
    return 1.0 + ((duration - time) / period if is_lost else 0.0)


@end
def complete(complete: bool) -> bool:
    """Return True once all victims are found."""
    return complete


@register("task")
class Search(Task[SearchConfig]):
    """Drones search the ground around a clue for victims, and hover above each of them.

    Victims sit on the ground in free view, within 30 m of the clue, and are solid. Drones start at
    rest, 20 to 50 m from the clue. A drone finds a victim by 2 s of hover within 1 m of it
    horizontally, 2 to 4 m above its top.

    A drone sees the nearest victim that is within 10 m horizontally, below it, in line of sight and
    not yet found as far as it knows. The ground within 30 m of the clue is divided into squares of
    up to 8 m. A drone searches a square by seeing a point of its free ground from so near that it
    would see a victim on any part of the square. Drones within 50 m of each other share which
    victims are found and which squares are searched, one step further with each decision.

    Observation, Box(102) per drone with the defaults, in world axes (east, north, up): position,
    velocity, offset to the clue, the victim in sight (a flag and its offset, with noise), the
    fraction of victims and the squares that the drone knows as found or searched, the other drones,
    and 24 ranges of a lidar, level and 30 and 60 degrees down. Cameras see victims, too.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 10 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - found 100: fraction of the victims that any drone finds in the decision.
    - searched 10: fraction of the squares that the drone is the first to search.
    - approach 0: decrease of the distance to the hover above the victim in sight, m.
    - conflict -20: number of drones whose separation falls below d_safe = 2 m.
    - collision -50: 1 on contact, also with a victim.
    - out_of_bounds -50: 1 outside the ground's square or above the ceiling.
    - time -0.1: 1 per decision, and per remaining decision if the drone is lost.

    End: terminated on contact, outside the ground's square or above the ceiling, when the battery
    is empty, and once all victims are found. Truncated after 600 decisions.

    Success: all victims are found, and the drone had no conflict or collision.

    Difficulties: easy has 1 drone and 1 victim on flat ground, medium 3 and 3 within 40 m of the
    clue in hills, hard 4 and 5 within 50 m in a forest, extreme 6 and 8 within 60 m in both.
    """

    name = "search"
    defaults: ClassVar = {
        "num_drones": 1,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 600,
        "max_speed": 10.0,
        "num_beams": 8,
        "lidar_elevations": (0.0, -30.0, -60.0),
    }
    difficulties: ClassVar = {
        "easy": UNCERTAINTY["easy"],
        "medium": {
            "num_drones": 3,
            "num_victims": 3,
            "city": "hills",
            "clue_radius": 40.0,
            "start_distance": (20.0, 60.0),
            **UNCERTAINTY["medium"],
        },
        "hard": {
            "num_drones": 4,
            "num_victims": 5,
            "city": "forest",
            "clue_radius": 50.0,
            "start_distance": (20.0, 70.0),
            **UNCERTAINTY["hard"],
        },
        "extreme": {
            "num_drones": 6,
            "num_victims": 8,
            "city": "wooded_hills",
            "clue_radius": 60.0,
            "start_distance": (20.0, 80.0),
            **UNCERTAINTY["extreme"],
        },
    }
    has_goals = False
    places: ClassVar[tuple[str, ...]] = ("start",)
    baseline = "sweep"
    oracle = "rescue_oracle"
    shirkers: ClassVar[tuple[str, ...]] = (
        "search_at_clue",
        "search_from_above",
        "search_touch",
        "search_together",
        "search_map",
    )
    observation = (
        "position",
        "velocity",
        "clue_offset",
        "sighting",
        "victims_found",
        "searched_cells",
        "all_neighbours",
        "lidar",
    )
    required_sensors = ("lidar",)
    reward: ClassVar = {
        "found": (found, 100.0),
        "searched": (searched, 10.0),
        "approach": (approach, 0.0),
        "conflict": -20.0,
        "collision": -50.0,
        "out_of_bounds": -50.0,
        "time": (time, -0.1),
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        "found": 5.0,
        "searched": 2.0,
        "approach": 0.1,
        "conflict": -1.0,
        "collision": -2.0,
        "out_of_bounds": -2.0,
        "time": -0.005,
    }
    shows: ClassVar = {
        "success": "success",
        "found": "found",
        "find_time": "until find (s)",
        "overlap": "searched twice",
        "collision": "collisions",
    }
    ends = (collision, leaves_arena, complete)
    success = complete

    def __init__(self, config: SearchConfig, context: TaskContext) -> None:
        """Create the ground, and check the options.

        Raises:
            ValueError: If options contradict each other, or the ground is too small.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.safety = self.add(Safety(context.num_drones))
        self.city_layouts = add_city(self)
        self._check()
        self.grid = make_grid(config.clue_radius, config.cell)
        self.num_targets = config.num_victims + len(self.grid)
        side = 2 * config.clue_radius / math.sqrt(len(self.grid))
        self.detection = Detection(
            sight_radius=float(config.sight_radius),
            cell_radius=float(config.sight_radius - side / math.sqrt(2)),
            hover_radius=float(config.hover_radius),
            hover_low=float(config.hover_height[0]),
            hover_high=float(config.hover_height[1]),
            hover_decisions=math.ceil(config.hover_time / context.period - ROUNDING),
            sight_noise=float(config.sight_noise),
            radio_range=float(config.radio_range),
        )

    def _check(self) -> None:
        """Check the options of hovers, squares and distances."""
        config, context = self.config, self.context
        low, high = config.hover_height
        if not context.collision_radius < low < high:
            raise ValueError(
                f"hover_height is {config.hover_height}: from low to high, above "
                f"{context.collision_radius:.3g} m, where a drone touches the victim, is needed"
            )
        if not config.hover_time > 0:
            raise ValueError(f"hover_time is {config.hover_time:g} s: it must be above 0")
        if not 0 < config.hover_radius <= config.sight_radius:
            raise ValueError(
                f"hover_radius is {config.hover_radius:g} m: above 0 and at most sight_radius "
                f"{config.sight_radius:g} m is needed"
            )
        if not 0 < config.cell < math.sqrt(2) * config.sight_radius:
            raise ValueError(
                f"cell is {config.cell:g} m: above 0 and less than "
                f"{math.sqrt(2) * config.sight_radius:.4g} m, so that a drone sees a whole square "
                f"with sight_radius {config.sight_radius:g} m, is needed"
            )
        if not config.cell <= config.clue_radius <= MAX_CELLS * config.cell / 2:
            raise ValueError(
                f"clue_radius is {config.clue_radius:g} m: from cell {config.cell:g} m to "
                f"{MAX_CELLS * config.cell / 2:g} m, {MAX_CELLS} squares in a row, is needed"
            )
        nearest, farthest = config.start_distance
        if not nearest <= farthest:
            raise ValueError(
                f"start_distance is {config.start_distance}: from low to high is needed"
            )
        smallest = min(float(city.sides.min()) for city in self.city_layouts.cities)
        needed = 2 * (config.clue_radius + EDGE_MARGIN)
        if smallest <= needed:
            raise ValueError(
                f"area is {smallest:g} m: more than {needed:g} m is needed around a clue with "
                f"clue_radius {config.clue_radius:g} m"
            )

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the bodies of the victims, which are the only obstacles."""
        return (VICTIM,) * self.config.num_victims

    def tops(self, scene: Scene) -> np.ndarray:
        """Return the tops of the victims' bodies, (W, M, 3) m."""
        tops: np.ndarray = scene.obstacle + TOP
        return tops

    def targets(self, scene: Scene) -> np.ndarray:
        """Return points above the victims and the points of the squares, (W, M + C, 3) m."""
        return np.concatenate([self.tops(scene) + SIGHT_POINT, scene.memory["cell"]], axis=1)

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Return all victims, and which squares have free ground, (W, M + C) bool."""
        has_ground = scene.memory["has_ground"] > 0
        victims = np.ones((len(has_ground), self.config.num_victims), dtype=bool)
        return np.concatenate([victims, has_ground], axis=1)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of N drones, M victims and C squares.

        Returns:
            "clue" (3,), position of the clue on the ground, m; "cell" (C, 3), point of free ground
            of each square, m; "has_ground" (C,), 1 for squares that have one. The others are those
            of `Findings`, by name.
        """
        drones, victims, cells = self.context.num_drones, self.config.num_victims, len(self.grid)
        return {
            **super().memory(),
            "clue": (3,),
            "cell": (cells, 3),
            "has_ground": (cells,),
            "found_at": (victims,),
            "finds": (drones,),
            "hover": (drones, victims),
            "known_found": (drones, victims),
            "own_cells": (drones, cells),
            "known_cells": (drones, cells),
            "sighting": (drones, 4),
            "sighted": (drones,),
            "newly_found": (drones,),
            "newly_searched": (drones,),
            "approached": (drones,),
        }

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the clue, victims near it, and starts at rest around it.

        Raises:
            ValueError: If there is no space for so many victims or drones.
        """
        config, layouts = self.config, self.city_layouts
        layout = layouts.draw(rng)
        city = layouts.cities[layout]
        reach = config.clue_radius + EDGE_MARGIN
        half = city.sides / 2 - reach
        drones, victims = self.context.num_drones, config.num_victims
        clue, plan, start = np.zeros(3), np.zeros((0, 2)), np.zeros((0, 2))
        for _ in range(MAX_TRIES):
            clue[:2] = rng.uniform(-half, half)
            near = (0.0, config.clue_radius)
            plan = layouts.outdoors_around(rng, layout, clue, near, config.victim_spacing, victims)
            start = layouts.outdoors_around(
                rng, layout, clue, config.start_distance, config.min_separation, drones
            )
            if len(plan) == victims and len(start) == drones:
                break
        else:
            what, remedy = f"{drones} drones", "start_distance or area, or lower min_separation"
            if len(plan) < victims:
                what, remedy = f"{victims} victims", "clue_radius, or lower victim_spacing"
            raise ValueError(f"no free ground was found for {what} near a clue: raise {remedy}")
        clue[2] = city.surface(clue)
        body = np.column_stack([plan, city.surface(plan) + HALF_HEIGHT])
        height = rng.uniform(*config.height, drones)
        position = layouts.raise_above_ground(layout, np.column_stack([start, height]))
        cell, has_ground = self._place_cells(layout, clue)
        return Spawn(
            position=position,
            goal=position,
            obstacle=body,
            obstacle_velocity=np.zeros(body.shape),
            layout=layout,
            memory={"clue": clue, "cell": cell, "has_ground": has_ground},
        )

    def _place_cells(self, layout: int, clue: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the point of free ground that is nearest to the middle of each square.

        Returns:
            (C, 3) points, m, and (C,) 1 for squares with free ground that are not beyond the
            clue's radius.
        """
        middle = self.grid + clue[:2]
        side = 2 * self.config.clue_radius / math.sqrt(len(self.grid))
        free = self.city_layouts.free_ground(layout)
        is_near = (np.abs(free - clue[:2]) <= self.config.clue_radius).all(axis=1)
        free = free[is_near]
        place, has_ground = middle.copy(), np.zeros(len(middle))
        if len(free):
            # Square of each point, by row and column
            count = round(math.sqrt(len(middle)))
            column = np.minimum((free - clue[:2] + self.config.clue_radius) // side, count - 1)
            own = (column[:, 0] * count + column[:, 1]).astype(int)
            gap = ((free - middle[own]) ** 2).sum(axis=1)
            # The nearest point is the first of each square in this order
            order = np.lexsort((gap, own))
            squares, first = np.unique(own[order], return_index=True)
            place[squares] = free[order[first]]
            has_ground[squares] = 1.0
        has_ground[(self.grid**2).sum(axis=1) > self.config.clue_radius**2] = 0.0
        surface = self.city_layouts.cities[layout].surface(place)
        return np.column_stack([place, surface + USER_HEIGHT]), has_ground

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update sightings, finds and searched squares, and share them by radio."""
        super().update_memory(frame, rngs)
        memory, shape = frame.scene.memory, frame.alive.shape
        noise = np.zeros((*shape, 3))
        if self.config.sight_noise:
            for w in np.flatnonzero(frame.alive.any(axis=1)).tolist():
                noise[w] = rngs[w].standard_normal(noise.shape[1:])
        everyone = np.ones((*shape, shape[1]), dtype=bool)
        update_findings(
            frame.before.position,
            frame.after.position,
            frame.alive,
            frame.time,
            frame.seen,
            self.tops(frame.scene),
            memory["cell"],
            memory["has_ground"],
            frame.readings.get(HEARD, everyone),
            noise,
            self.detection,
            Findings(**{name: memory[name] for name in Findings._fields}),
            memory["known_found"].copy(),
            memory["known_cells"].copy(),
        )

    def quantities(self) -> Mapping[str, Any]:
        """Return whether all victims are found."""
        return {**super().quantities(), "complete": self._is_complete}

    def _is_complete(self, frame: Frame) -> np.ndarray:
        """Return whether all victims of a world are found, (W, N) bool."""
        every = np.all(frame.scene.memory["found_at"] > 0, axis=1)
        return np.repeat(every[:, None], frame.alive.shape[1], axis=1)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the infos of the city and of the search, (W, N).

        Returns:
            The same for all drones of a world: "found", fraction of the victims found; "find_1",
                "find_2", ..., times of the finds in order, s, with the length of the episode for
                victims that are not found, and "find_time", their mean; "overlap", fraction of the
                searched squares that several drones searched. For each drone "finds", the number
                of victims that it found.
        """
        memory, shape = frame.scene.memory, frame.alive.shape
        found_at = memory["found_at"]
        was_found = found_at > 0
        times = np.sort(np.where(was_found, found_at, self.context.duration), axis=1)
        visits = memory["own_cells"].sum(axis=1)
        overlap = (visits > 1).sum(axis=1) / np.maximum((visits > 0).sum(axis=1), 1)
        shared = {
            "found": was_found.mean(axis=1),
            "find_time": times.mean(axis=1),
            "overlap": overlap,
            **{f"find_{k}": times[:, k - 1] for k in range(1, times.shape[1] + 1)},
        }
        of_all = {name: np.repeat(one[:, None], shape[1], axis=1) for name, one in shared.items()}
        return {**super().info(frame), **of_all, "finds": memory["finds"].copy()}


def make_grid(radius: float, cell: float) -> np.ndarray:
    """Return the middles of the squares around a clue, relative to it, (C, 2) m.

    Args:
        radius: Half of the side of the divided ground, m.
        cell: Maximum side of a square, m.
    """
    count = math.ceil(2 * radius / cell - ROUNDING)
    middles = (np.arange(count) + 0.5) * (2 * radius / count) - radius
    return np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)
