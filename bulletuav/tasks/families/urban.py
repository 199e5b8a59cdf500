"""Tasks in cities, and flights to goals through them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.city.statistics import MOST
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.families.airspace import Airspace
from bulletuav.tasks.families.city_layouts import CityLayouts, UrbanConfig
from bulletuav.tasks.families.difficulties import URBAN_DIFFICULTIES
from bulletuav.tasks.families.flight_config import FlightConfig
from bulletuav.tasks.families.obstacle_field import ObstacleTask
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.given import PLACES, Given
from bulletuav.tasks.observations.base import Block

URBAN_DEFAULTS: dict[str, Any] = {
    "num_drones": 3,
    "airframe": "hummingbird",
    "action": "velocity",
    "decision_hz": 10,
    "max_speed": 15.0,
    "battery_capacity": 23.3,
}
"""Common options of tasks in cities, unless a task says otherwise"""
CITY = ("city_alpha", "city_beta", "city_gamma")
"""Names of what infos and the global state tell of a city"""


def check_share(name: str, value: float) -> None:
    """Refuse what is not a share that can be reached.

    Args:
        name: Name of the option.
        value: Its value.

    Raises:
        ValueError: It is not above 0 and at most 1.
    """
    if not 0 < value <= 1:
        raise ValueError(f"{name} is {value:g}: a share above 0 and at most 1 is needed")


UrbanConfigT = TypeVar("UrbanConfigT", bound=UrbanConfig)


class UrbanTask(ObstacleTask[UrbanConfigT], Generic[UrbanConfigT]):
    """Base of tasks in a city; the arena is the city's ground, up to the ceiling.

    Attributes:
        town: Cities of the task, and places in them.
    """

    difficulties: ClassVar = URBAN_DIFFICULTIES
    places: ClassVar[tuple[str, ...]] = ("start",)

    def __init__(self, config: UrbanConfigT, context: TaskContext) -> None:
        """Make the cities.

        Raises:
            ValueError: They leave no room to fly.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        self.town = CityLayouts(config, context)
        self._measured: tuple[bytes, dict[str, np.ndarray]] = (b"", {})
        self.arena_low = self.town.low
        self.arena_high = self.town.high

    def layouts(self) -> Sequence[Solids]:
        """List the buildings of each city."""
        return self.town.solids

    def is_free(
        self,
        place: np.ndarray,
        radius: float,
        layout: int,
    ) -> bool:
        """Tell whether a ball at a place (3,), m, is off all buildings of a city; see `Task`."""
        city = self.town.cities[layout]
        # The highest roof below the ball, on a raster of it.
        steps = radius * np.linspace(-1.0, 1.0, 5)
        below = place[:2] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        is_above = place[2] - radius > float(city.roof(below).max())
        return bool(is_above) or bool(city.outdoors(place, radius))

    def finish(
        self,
        spawn: Spawn,
        given: Given,
        rng: np.random.Generator,
    ) -> Spawn:
        """Put given places into a start; where drones have no goals they are their starts.

        Raises:
            ValueError: There is no room for obstacles.
        """
        spawn = super().finish(spawn, given, rng)
        return spawn if "goal" in self.places else spawn._replace(goal=spawn.position)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell what the city of the world measures, (W, N), the same for all drones.

        Returns:
            "city_alpha", the built-up share; "city_beta", buildings per km^2; "city_gamma", the
            Rayleigh scale of heights, m.
        """
        return {**super().info(frame), **self._measures(frame.scene.layout)}

    def _measures(self, layout: np.ndarray) -> dict[str, np.ndarray]:
        """Tell what cities (W,) measure, see `info`; the same read-only arrays while they stand."""
        stands = layout.tobytes()
        if self._measured[0] != stands:
            rows = np.repeat(self.town.parameters[layout][..., None], self.context.num_drones, 2)
            own = {name: rows[:, k].copy() for k, name in enumerate(CITY)}
            for array in own.values():
                array.flags.writeable = False
            self._measured = (stands, own)
        return self._measured[1]

    def world_state(self) -> Mapping[str, Block]:
        """Tell the parameters of the city that stands in the world."""

        def measured(frame: Frame, present: np.ndarray) -> np.ndarray:
            parameters: np.ndarray = self.town.parameters[frame.scene.layout]
            return parameters

        labels = (
            Label(CITY[0], "1", 0.0, 1.0),
            Label(CITY[1], "1/km^2", 0.0, MOST["beta"]),
            Label(CITY[2], "m", 0.0, MOST["gamma"]),
        )
        return {**super().world_state(), "city": Block(labels, measured)}


@dataclass(frozen=True)
class StreetsConfig(UrbanConfig):
    """Options of tasks in the streets of a city, below most of its roofs, beside those of cities.

    Seven of ten houses of an urban city are higher than 12.5 m, 2.5 m below the ceiling. Straight
    lines of 200 m or more at that height miss all of them in 7 % of flights, most of them along a
    street. Below a ceiling of 30 m it would be half of the flights.

    Attributes:
        height: Least and greatest height of starts and goals, m. They are outdoors.
        ceiling: Greatest height of the airspace, m.
    """

    height: tuple[float, float] = (5.0, 12.0)
    ceiling: float = 15.0


@dataclass(frozen=True)
class UrbanFlightConfig(StreetsConfig, FlightConfig):
    """Options of flights to goals in cities, beside those of streets and of all flights.

    Attributes:
        leg: Least distance from a drone's start to its goal, m.
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Least and greatest speed at the start, m/s.
        at_goal: What happens at the goal: "leave", "land" or "hold", see `FlightConfig`; or
            "respawn": the drone gets another goal outdoors, at `leg` from there if it can be.
    """

    leg: float = 200.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)
    at_goal: Literal["leave", "land", "hold", "respawn"] = "leave"  # type: ignore[assignment]


UrbanFlightConfigT = TypeVar("UrbanFlightConfigT", bound=UrbanFlightConfig)


class UrbanFlight(
    UrbanTask[UrbanFlightConfigT], Airspace[UrbanFlightConfigT], Generic[UrbanFlightConfigT]
):
    """Base of flights to goals through a city; a task adds what drones observe.

    It is an `Airspace`, with these differences. Starts, at rest, and goals lie outdoors. The
    ceiling is below most roofs. d_safe is 2 m. Contact with a building is a collision. Time has a
    price. Episodes are truncated after 600 decisions.

    With at_goal="respawn" every goal counts for the term `goal`, and goals end nothing. Success is
    one goal or more, without a crash; infos count them as `goals`.
    """

    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600, "difficulty": "easy"}
    presets: ClassVar = {}
    places: ClassVar[tuple[str, ...]] = PLACES
    baseline = "planner"

    def __init__(self, config: UrbanFlightConfigT, context: TaskContext) -> None:
        """Make the cities, and check that legs fit into them.

        Raises:
            ValueError: A city leaves no room to fly, or is too small for a leg.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        self.town.require(config.leg)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start at rest outdoors, with goals outdoors."""
        layout = self.town.draw(rng)
        start, goal = self.town.legs(rng, layout, self.context.num_drones, self.config.leg)
        return self.launch(start, goal, rng, layout=layout)

    @property
    def _respawns(self) -> bool:
        """Whether goals are drawn anew when they are reached."""
        return self.config.at_goal == "respawn"

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell the shapes of what `Airspace` keeps, and of "goals" (N,) reached, where they count.

        "reached" is the time of the last goal then.
        """
        goals = {"goals": (self.context.num_drones,)} if self._respawns else {}
        return {**super().memory(), **goals}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Do as `Airspace`, and draw new goals for drones at theirs, where they respawn.

        Rewards and infos of the decision are about the goals before; observations tell the new.
        """
        super().update_memory(frame, rngs)
        if not self._respawns:
            return
        scene = frame.scene
        at_goal = self.arrived(frame) & frame.alive & ~frame.collision
        np.copyto(scene.memory["reached"], frame.time[:, None], where=at_goal)
        scene.memory["goals"][:] += at_goal
        for w, i in np.argwhere(at_goal).tolist():
            given = (rngs[w], int(scene.layout[w]), frame.after.position[w, i], self.config.leg)
            scene.goal[w, i] = self.town.goal_from(*given)
            frame.known_distance[w, i] = math.dist(scene.goal[w, i], frame.known_position[w, i])

    def finished(self, frame: Frame) -> np.ndarray:
        """Tell who is done at its goal; nobody where goals respawn, (W, N) bool."""
        if self._respawns:
            return np.zeros(frame.alive.shape, dtype=bool)
        return super().finished(frame)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell who is at its goal, or has reached one where they respawn; (W, N) bool."""
        if self._respawns:
            reached: np.ndarray = (frame.scene.memory["goals"] > 0) & ~frame.collision
            return reached
        return super().succeeded(frame)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell, beside the city's parameters, the goals reached, where they respawn."""
        memory = frame.scene.memory
        goals = {"goals": memory["goals"].copy()} if self._respawns else {}
        return {**super().info(frame), **goals}
