"""Users on the ground, who may walk, and the service that drones provide to them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from bulletuav.network.dwell_time import compute_steady_service, update_dwell_time
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.ground import Ground
from bulletuav.sensors.base import vector_labels
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.base import Part, Rngs
from bulletuav.tasks.parts.city_layouts import USER_HEIGHT, CityLayouts
from bulletuav.tasks.parts.mean_service import MeanService
from bulletuav.tasks.targets import get_served_fraction


@dataclass(frozen=True)
class UserOptions:
    """Options of users on the ground.

    Attributes:
        num_users: Number of users on the ground, outdoors.
        mobility: Mobility model of the users: "still", "gauss_markov", "manhattan", "hotspot" or
            "waypoint"; a dict that also sets options of the model, such as {"model": "waypoint",
            "pause": (0, 5)}; or a `Mobility`.
    """

    num_users: int = field(default=20, metadata={"most": 10_000})
    mobility: Any = "still"


class Users(Part):
    """Users on the ground of cities: positions, and times in sight of drones.

    Infos are "served", the fraction of users seen by at least one active drone, and "dwell_time",
    the time for which the drone has seen users without interruption, averaged over users, s.

    Attributes:
        mobility: Mobility model.
    """

    def __init__(self, task: Task[Any], city_layouts: CityLayouts) -> None:
        """Set up the mobility model in the cities.

        Args:
            task: The task, with options of users; its targets are set to the users.
            city_layouts: Its cities.

        Raises:
            ValueError: If a city has no space to walk, or the mobility model is unknown.
        """
        self._task, self._count = task, int(task.config.num_users)
        task.num_targets = self._count
        self.mobility = find_mobility(task.config.mobility)
        self._ground = Ground(city_layouts.cities, USER_HEIGHT)
        self.mobility.require(self._ground)

    def start(self, layout: int, rng: np.random.Generator) -> Mapping[str, np.ndarray]:
        """Draw the initial state of the users of a world, by name of its memory."""
        return self.mobility.start(rng, self._ground, layout, self._count)

    def places(self, scene: Scene) -> np.ndarray:
        """Return the positions of the users, (W, U, 3) m."""
        return scene.memory["users"]

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of users.

        Returns:
            "users" (U, 3), positions, m, and the state of the mobility model; "dwell_time" (N, U),
            time for which each drone has seen each user without interruption, s, and its mean over
            users, "mean_dwell_time" (N,).
        """
        drones = self._task.context.num_drones
        dwell = {"dwell_time": (drones, self._count), "mean_dwell_time": (drones,)}
        return {**self.mobility.state(self._count), **dwell}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of the state of the mobility model."""
        return self.mobility.bounds(self._ground)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the users, who are no obstacles."""
        period = self._task.context.period
        self.mobility.move(scene.memory, self._ground, scene.layout, flying, period, rngs)
        return False

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update the times for which active drones have seen users without interruption."""
        memory, period = frame.scene.memory, self._task.context.period
        times = (memory["dwell_time"], memory["mean_dwell_time"])
        update_dwell_time(*times, frame.readings["sight"], frame.alive, period)

    def served(self, frame: Frame) -> np.ndarray:
        """Compute the fraction of users seen by at least one active drone, (W, N)."""
        return get_served_fraction(self._task, frame)

    def quantities(self) -> Mapping[str, Any]:
        """Return the fraction of users in sight, and the saturated time in sight."""
        return {"served": self.served, "steady_service": _steady_service}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the served fraction and the mean dwell time."""
        mean = frame.scene.memory["mean_dwell_time"]
        return {"served": self.served(frame), "dwell_time": mean.copy()}

    def world_state(self) -> Mapping[str, Block]:
        """Return the positions of the users."""
        count, task = self._count, self._task
        names = (f"user {j}" for j in range(1, count + 1))
        labels = [vector_labels(one, "m", task.arena_low, task.arena_high) for one in names]

        def places(frame: Frame, present: np.ndarray) -> np.ndarray:
            return frame.scene.memory["users"].reshape(-1, 3 * count)

        return {"users": Block(tuple(chain(*labels)), places)}


class Service(Part):
    """Service of drones to users; this base class serves all users in sight, as a relay does."""

    def __init__(self, task: Task[Any], users: Users) -> None:
        """Set up the service to the users of a task.

        Args:
            task: The task, with the option `wanted`.
            users: Its users.
        """
        self._mean = task.add(MeanService(task, users.served))

    def links(self, frame: Frame) -> np.ndarray:
        """Return which drones serve which users, (W, N, U) bool: those in sight."""
        return frame.seen

    def quality(self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray) -> np.ndarray:
        """Return how well drones would serve users; see `Task.service_quality`."""
        return sight.astype(float)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether a drone saw enough users, on average over the episode, (W, N) bool."""
        return self._mean.succeeded(frame)


def _steady_service(frame: Frame) -> np.ndarray:
    """Compute the mean saturated time in sight, (W, N) from 0 to 1."""
    return compute_steady_service(frame.scene.memory["dwell_time"])
