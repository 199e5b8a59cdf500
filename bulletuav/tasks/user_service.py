"""Base class of tasks in which drones over a city serve users on the ground."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.config import REBOUND, TaskConfig
from bulletuav.tasks.ends import affected_drones
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.mean_service import SERVICE_SHIRKERS
from bulletuav.tasks.parts.obstacle_field import (
    CityObstacleOptions,
    ObstacleField,
    ObstacleOptions,
)
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS, check_fraction
from bulletuav.tasks.parts.users import Service, UserOptions, Users

TRAINING_WEIGHTS = {
    "served": 3.0,
    "tasks": 3.0,
    "latency": 0.0,
    "energy": 0.0,
    "service_time": 0.0,
    "conflict": -2.0,
    "collision": -2.0,
}
"""Weights for training in tasks with users: only the service that decides success is rewarded"""


@dataclass(frozen=True)
class UserServiceConfig(UserOptions, CityOptions, CityObstacleOptions, ObstacleOptions, TaskConfig):
    """Options of tasks with users, in addition to those of users, cities and obstacles.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        wanted: Fraction of service from which the task is successful: of users in sight, averaged
            over the episode, unless the task defines another.
        boundary: Behaviour at the bounds of the airspace. "end": the drone's episode ends. "soft":
            the drone rebounds. "hard": the drone stops.
        contact_ends: Episode that a contact of collision shapes ends: that of the "drone", or of
            its whole "world".
        city: The city, see `CityOptions`, by default "dense": few places see much of it.
        height: Minimum and maximum height of starts, m.
        ceiling: Maximum height of the airspace, m: low enough that not every position sees all
            users.
    """

    d_safe: float = 2.0
    wanted: float = 0.9
    boundary: Literal["end", "soft", "hard"] = "hard"
    contact_ends: Literal["drone", "world"] = "drone"
    city: Any = "dense"
    height: tuple[float, float] = (20.0, 45.0)
    ceiling: float = 50.0


UserServiceConfigT = TypeVar("UserServiceConfigT", bound=UserServiceConfig)


class UserService(Task[UserServiceConfigT], Generic[UserServiceConfigT]):
    """Base class of tasks with users: drones start at rest outdoors, and users are outdoors.

    A drone's episode ends on contact of collision shapes and when the battery is empty. Drones stop
    at the bounds of the city's square and at its ceiling, unless the option `boundary` changes
    this. The task is successful if a drone saw at least
    the fraction `wanted` of users, on average over the episode.

    Attributes:
        city_layouts: The cities.
        users: The users, which are the targets.
        service_kind: Class of `service`.
        service: Service that drones provide to users.
    """

    has_goals = False
    places: ClassVar[tuple[str, ...]] = ("start",)
    shows: ClassVar = {"served": "served by all", "collision": "collisions"}
    service_kind: ClassVar[type[Service]] = Service
    baseline = "oracle"
    training_weights: ClassVar[Mapping[str, float]] = TRAINING_WEIGHTS
    shirkers = (*SERVICE_SHIRKERS, "service_follow_one")
    defaults: ClassVar = {
        **URBAN_DEFAULTS,
        "dynamics": "single_integrator",
        "decision_hz": 1,
        "horizon": 100,
    }

    def __init__(self, config: UserServiceConfigT, context: TaskContext) -> None:
        """Create the cities and the users' mobility model.

        Raises:
            ValueError: If a city has no space to fly or to walk.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.safety = self.add(Safety(context.num_drones))
        self.city_layouts = add_city(self)
        check_fraction("wanted", config.wanted)
        self.rebound = REBOUND.get(config.boundary)
        self.users = self.add(Users(self, self.city_layouts))
        self.service = self.add(self.service_kind(self, self.users))

    def targets(self, scene: Scene) -> np.ndarray:
        """Return the positions of the users, (W, U, 3) m."""
        return self.users.places(scene)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts of drones, at rest, and of users, all outdoors."""
        layout = self.city_layouts.draw(rng)
        start = self.city_layouts.hovering(rng, layout, self.context.num_drones)
        return start._replace(memory=self.users.start(layout, rng))

    def terminated(self, frame: Frame) -> np.ndarray:
        """Return which drones' episodes end by contact, outside (`boundary` "end") or by `ends`.

        Returns:
            (W, N) bool.
        """
        ended = affected_drones(frame.collision, frame, self.config.contact_ends)
        if self.config.boundary == "end":
            ended = ended | self.outside(frame)
        if self.ends:
            ended = ended | super().terminated(frame)
        return ended

    def links(self, frame: Frame) -> np.ndarray:
        """Return which drones serve which users, (W, N, U) bool."""
        return self.service.links(frame)

    def service_quality(
        self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray
    ) -> np.ndarray:
        """Return how well drones would serve users; see `Task`."""
        return self.service.quality(place, targets, sight)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether the required fraction of service is reached, (W, N) bool."""
        return self.service.succeeded(frame)
