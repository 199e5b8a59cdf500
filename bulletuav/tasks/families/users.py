"""Drones over a city that serve users on the ground, who may walk."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from bulletuav.network.dwell_time import watch
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.ground import Ground
from bulletuav.tasks.base import REBOUND, Frame, Scene, Spawn, TaskContext, affected
from bulletuav.tasks.families.urban import (
    DEFAULTS,
    USER_HEIGHT,
    UrbanConfig,
    UrbanTask,
    check_share,
)

DWELL_TIME_SCALE = 0.1  # 1/s


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
    weights: Mapping[str, float] = field(default_factory=dict)


class UsersTask(UrbanTask):
    """A task over users: drones start at rest anywhere outdoors, and so do users.

    It ends for a drone on contact of collision shapes and with an empty battery; at the bounds of the city's square and its
    ceiling drones stop.
    """

    config: UsersConfig
    baseline = "kmeans"
    defaults: ClassVar = {
        **DEFAULTS,
        "dynamics": "single_integrator",
        "decision_hz": 1,
        "horizon": 100,
    }

    def __init__(self, config: UsersConfig, context: TaskContext):
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

    def advance(
        self,
        scene: Scene,
        time: np.ndarray,
        flying: np.ndarray,
        rng: Sequence[np.random.Generator | None],
    ) -> bool:
        """Users walk."""
        self.mobility.move(
            scene.memory, self.ground, scene.layout, flying, self.context.period, rng
        )
        return False

    def update_memory(self, frame: Frame, rng: Sequence[np.random.Generator | None]) -> None:
        """For how long each living drone has seen each user without a break."""
        memory = frame.scene.memory
        watch(
            memory["dwell_time"],
            memory["mean_dwell_time"],
            frame.readings["sight"],
            frame.alive,
            self.context.period,
        )

    def ends(self, frame: Frame) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(W, N) bool, whose episode ends in contact or outside the airspace, and the terms that say so."""
        outside, ended = (
            self.outside(frame),
            affected(frame.collision, frame, self.config.contact_ends),
        )
        if self.config.boundary == "end":
            ended = ended | outside
        return ended, {
            "collision": frame.collision.astype(float),
            "out_of_bounds": outside.astype(float),
        }


def dwell_time_bonus(frame: Frame) -> np.ndarray:
    """(W, N) tanh(0.1 s) of the mean seconds s for which the drone has seen users without a break: from 0 to 1."""
    return np.tanh(DWELL_TIME_SCALE * frame.scene.memory["mean_dwell_time"])
