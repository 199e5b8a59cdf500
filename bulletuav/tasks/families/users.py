"""Tasks in which drones over a city serve users on the ground, who may walk."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.network.dwell_time import watch
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.ground import Ground
from bulletuav.sensors.base import vector_labels
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.config import REBOUND
from bulletuav.tasks.ends import affected
from bulletuav.tasks.families.city_layouts import USER_HEIGHT, UrbanConfig
from bulletuav.tasks.families.urban import URBAN_DEFAULTS, UrbanTask, check_share
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.targets import TargetTask


@dataclass(frozen=True)
class UsersConfig(UrbanConfig):
    """Options of tasks over users, beside those of cities.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        num_users: Number of users on the ground, outdoors.
        mobility: How users walk: "still", "gauss_markov", "manhattan", "hotspot" or "waypoint"; a
            dict with options of that model too, such as {"model": "waypoint", "pause": (0, 5)};
            or a `Mobility`.
        wanted: Share of service that is success; of users served, unless the task says otherwise.
        boundary: What happens at the bounds of the airspace. "end": the drone's episode ends.
            "soft": it is thrown back. "hard": it stops there.
        contact_ends: Whose episode a contact of collision shapes ends: that of the "drone", or
            of its whole "world".
        height: Least and greatest height of starts, m.
        ceiling: Greatest height of the airspace, m: low enough that not every place sees all.
    """

    d_safe: float = 2.0
    num_users: int = field(default=20, metadata={"most": 10_000})
    mobility: Any = "still"
    wanted: float = 0.9
    boundary: Literal["end", "soft", "hard"] = "hard"
    contact_ends: Literal["drone", "world"] = "drone"
    height: tuple[float, float] = (20.0, 60.0)
    ceiling: float = 70.0


UsersConfigT = TypeVar("UsersConfigT", bound=UsersConfig)


class UsersTask(UrbanTask[UsersConfigT], TargetTask[UsersConfigT], Generic[UsersConfigT]):
    """Base of tasks over users: drones start at rest anywhere outdoors, and so do users.

    A drone's episode ends on contact of collision shapes and with an empty battery. At the bounds
    of the city's square and at its ceiling drones stop, unless the option `boundary` says
    otherwise.
    """

    baseline = "oracle"
    defaults: ClassVar = {
        **URBAN_DEFAULTS,
        "dynamics": "single_integrator",
        "decision_hz": 1,
        "horizon": 100,
    }

    def __init__(self, config: UsersConfigT, context: TaskContext) -> None:
        """Make the cities, and find where users can walk.

        Raises:
            ValueError: A city leaves no room to fly or to walk.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        check_share("wanted", config.wanted)
        self.num_targets = config.num_users
        self.rebound = REBOUND.get(config.boundary)
        self.mobility = find_mobility(config.mobility)
        self.ground = Ground(self.town.cities, USER_HEIGHT)
        self.mobility.require(self.ground)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell the shapes of what is kept of users.

        Returns:
            "users" (U, 3), where they are, m, and what their mobility model keeps; "dwell_time"
            (N, U), for how long each drone has seen each user without a break, s, and its mean
            over users, "mean_dwell_time" (N,).
        """
        users = self.config.num_users
        drones = self.context.num_drones
        return {
            **self.mobility.state(users),
            "dwell_time": (drones, users),
            "mean_dwell_time": (drones,),
        }

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of what the mobility model keeps."""
        return self.mobility.bounds(self.ground)

    def targets(self, scene: Scene) -> np.ndarray:
        """Tell where the users are, (W, U, 3) m."""
        return scene.memory["users"]

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start of drones at rest, and of users, all outdoors."""
        layout = self.town.draw(rng)
        start = self.town.hovering(rng, layout, self.context.num_drones)
        users = self.mobility.start(rng, self.ground, layout, self.config.num_users)
        return start._replace(memory=users)

    def move_scene(
        self,
        scene: Scene,
        time: np.ndarray,
        flying: np.ndarray,
        rngs: Rngs,
    ) -> bool:
        """Let users walk."""
        period = self.context.period
        self.mobility.move(scene.memory, self.ground, scene.layout, flying, period, rngs)
        return super().move_scene(scene, time, flying, rngs)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Note for how long each living drone has seen each user without a break."""
        memory = frame.scene.memory
        times = (memory["dwell_time"], memory["mean_dwell_time"])
        watch(*times, frame.readings["sight"], frame.alive, self.context.period)

    def quantities(self) -> Mapping[str, Any]:
        """Tell the share of users that some drone sees, and how long they have been seen, s."""
        return {"served": self.served, "mean_service_time": _mean_service_time}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell, beside `served`, for how long the drone has seen users, mean of all, s."""
        mean = frame.scene.memory["mean_dwell_time"]
        return {**super().info(frame), "dwell_time": mean.copy()}

    def world_state(self) -> Mapping[str, Block]:
        """Tell, beside the city's parameters, where the users are."""
        count = self.config.num_users
        names = (f"user {j}" for j in range(1, count + 1))
        labels = [vector_labels(one, "m", self.arena_low, self.arena_high) for one in names]

        def places(frame: Frame, present: np.ndarray) -> np.ndarray:
            return frame.scene.memory["users"].reshape(-1, 3 * count)

        return {**super().world_state(), "users": Block(tuple(chain(*labels)), places)}

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell whose episode ends by contact, or outside the airspace where options say so.

        Returns:
            (W, N) bool.
        """
        ended = affected(frame.collision, frame, self.config.contact_ends)
        if self.config.boundary == "end":
            ended = ended | self.outside(frame)
        return ended

    def links(self, frame: Frame) -> np.ndarray:
        """Tell which drones see which users, (W, N, U) bool."""
        return frame.seen

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell whether some drone sees the wanted share of users, (W, N) bool."""
        return self.served(frame) >= self.config.wanted


def _mean_service_time(frame: Frame) -> np.ndarray:
    """Compute for how long users have been seen, by whom longest, mean of all, (W, N) s."""
    longest = np.maximum.reduce(frame.scene.memory["dwell_time"], axis=1)
    # As `np.mean` adds and divides, in fewer calls
    mean: np.ndarray = np.add.reduce(longest, axis=-1, keepdims=True) / longest.shape[-1]
    return mean + np.zeros(frame.alive.shape)
