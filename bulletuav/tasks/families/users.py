"""Drones over a city that serve users on the ground, who may walk."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from bulletuav.network.dwell_time import watch
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.ground import Ground
from bulletuav.tasks.base import REBOUND, Rngs, affected
from bulletuav.tasks.families.urban import (
    DEFAULTS,
    USER_HEIGHT,
    UrbanConfig,
    UrbanTask,
    check_share,
)
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.targets import TargetTask


@dataclass(frozen=True)
class UsersConfig(UrbanConfig):
    """Options of service to users beside those of cities.

    num_users   users on the ground, outdoors
    mobility    how they walk: "still", "gauss_markov", "manhattan", "hotspot", "waypoint"; a dict with options of that model
                too, such as {"model": "waypoint", "pause": (0, 5)}; or a `Mobility`
    wanted      success is to serve this share
    boundary    "end": a drone outside the airspace is done; "soft", "hard": it is thrown back, or stops, at the bounds
    contact_ends  whose episode contact of shapes ends: the "drone"'s, or that of its whole "world"
    """

    d_safe: float = 2.0
    num_users: int = field(default=20, metadata={"most": 10_000})
    mobility: Any = "still"
    wanted: float = 0.9
    boundary: Literal["end", "soft", "hard"] = "hard"
    contact_ends: Literal["drone", "world"] = "drone"
    height: tuple[float, float] = (20.0, 60.0)


UsersConfigT = TypeVar("UsersConfigT", bound=UsersConfig)


class UsersTask(UrbanTask[UsersConfigT], TargetTask[UsersConfigT], Generic[UsersConfigT]):
    """A task over users: drones start at rest anywhere outdoors, and so do users.

    It ends for a drone on contact of collision shapes and with an empty battery; at the bounds of the city's square and its
    ceiling drones stop.
    """

    baseline = "kmeans"
    defaults: ClassVar = {
        **DEFAULTS,
        "dynamics": "single_integrator",
        "decision_hz": 1,
        "horizon": 100,
    }

    def __init__(self, config: UsersConfigT, context: TaskContext) -> None:
        """Raises ValueError where the city leaves no room to fly or to walk."""
        super().__init__(config, context)
        check_share("wanted", config.wanted)
        self.num_targets, self.rebound = config.num_users, REBOUND.get(config.boundary)
        self.mobility = find_mobility(config.mobility)
        self.ground = Ground(self.town.cities, USER_HEIGHT)
        self.mobility.require(self.ground)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """`users`, where they are, m, and what their walk keeps; `dwell_time`, how long drones see them, s, and its mean."""
        count, drones = self.config.num_users, self.context.num_drones
        return {
            **self.mobility.state(count),
            "dwell_time": (drones, count),
            "mean_dwell_time": (drones,),
        }

    def targets(self, scene: Scene) -> np.ndarray:
        """The users."""
        return scene.memory["users"]

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Drones at rest and users, outdoors."""
        layout = self.town.draw(rng)
        start = self.town.hovering(rng, layout, self.context.num_drones)
        return start._replace(
            memory=self.mobility.start(rng, self.ground, layout, self.config.num_users)
        )

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Let users walk."""
        period = self.context.period
        self.mobility.move(scene.memory, self.ground, scene.layout, flying, period, rngs)
        return False

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Note for how long each living drone has seen each user without a break."""
        memory, sight = frame.scene.memory, frame.readings["sight"]
        times = (memory["dwell_time"], memory["mean_dwell_time"])
        watch(*times, sight, frame.alive, self.context.period)

    def quantities(self) -> Mapping[str, Any]:
        """Tell the share of users that is served."""
        return {"served": self.served}

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell whose episode ends in contact, or outside the airspace where that ends it."""
        ended = affected(frame.collision, frame, self.config.contact_ends)
        return ended | self.outside(frame) if self.config.boundary == "end" else ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell whether the wanted share of users is served."""
        return self.served(frame) >= self.config.wanted
