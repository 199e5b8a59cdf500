"""Task `pursuit`: a queue of drones on one circular track, the fastest last, so that they have to overtake."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.families.airspace import (
    UNCERTAINTY,
    Airspace,
    AirspaceConfig,
    between_neighbours,
    circle_arena,
    clearance,
)
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext


@dataclass(frozen=True)
class PursuitConfig(AirspaceConfig):
    """Options of `pursuit` beside those of every shared airspace, m, m/s.

    Drones queue on a circle of `radius`, `spacing` apart along it, and fly `laps` clockwise, the first of the queue at
    `speed[0]`, the last at `speed[1]`.
    """

    radius: float = 60.0
    spacing: float = 15.0
    speed: tuple[float, float] = (10.0, 18.0)
    laps: int = 1


@register("task")
class Pursuit(Airspace[PursuitConfig]):
    """A queue on a circle, clockwise; who follows is faster than who leads, so overtaking conflicts arise.

    Each drone's goal runs ahead on the circle at the drone's own pace, from the drone's start round to it again, where it
    stops. Drone 0 leads.

    Observation, per drone, Box(34) with the defaults; `bulletuav tasks pursuit` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`.
    Beside that: a goal counts as reached once it has stopped; the horizon of extreme is 1,000 decisions.
    Success: goal reached without any conflict.

    Difficulty, drones / radius / spacing / speeds: easy 4, 60 m, 15 m, 10 to 18 m/s; medium 8, the same; hard 20,
    the same; extreme 100, 150 m, 8.5 m, 12 to 18 m/s.
    """

    name = "pursuit"
    observation = ("position", "velocity", "goal", "goal_velocity", "neighbours")
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {"num_drones": 20, **UNCERTAINTY["hard"]},
        "extreme": {
            "num_drones": 100,
            "radius": 150.0,
            "spacing": 8.5,
            "speed": (12.0, 18.0),
            "horizon": 1000,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: PursuitConfig, context: TaskContext):
        """Raises ValueError where drones could start in conflict or in touch with the ground, or are too slow."""
        super().__init__(config, context)
        if not 0 < config.speed[0] <= config.speed[1] <= context.max_speed:
            raise ValueError(
                f"speed is {config.speed}: from low to high, above 0 and up to max_speed {context.max_speed:g}"
            )
        if context.num_drones * config.spacing > 2 * np.pi * config.radius:
            raise ValueError(
                f"{context.num_drones} drones with spacing {config.spacing:g} m do not fit on a circle of radius "
                f"{config.radius:g} m"
            )
        chord = 2 * config.radius * np.sin(config.spacing / (2 * config.radius))
        nearest, clear = between_neighbours(config, chord), clearance(config, context)
        if context.num_drones > 1 and nearest <= clear:
            raise ValueError(
                f"start positions may be in conflict: spacing {config.spacing:g} m with jitter {config.jitter:g} m leaves "
                f"{nearest:.3g} m between neighbours, more than {clear:.3g} m (d_safe) is needed"
            )
        self.arena_low, self.arena_high = circle_arena(config, context, config.radius)
        self._pace = np.linspace(*config.speed, context.num_drones)
        self._way = 2 * np.pi * config.radius * config.laps
        if self._way > config.speed[0] * context.duration:
            raise ValueError(
                f"speed {config.speed[0]:g} m/s is too slow for {self._way:.4g} m of way within {context.duration:g} s: "
                f"raise horizon or speed, or fly fewer laps"
            )

    def _track(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Goals (..., N, 3) m and their velocities at `time` (...,) s."""
        way = self._pace * np.asarray(time)[..., None]
        angle = (
            np.arange(len(self._pace)) * self.config.spacing - np.minimum(way, self._way)
        ) / self.config.radius
        zero = np.zeros_like(angle)
        place = self.config.radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
        pace = np.where(way < self._way, self._pace, 0.0)[..., None]
        return place + np.array((0.0, 0.0, self.config.altitude)), pace * np.stack(
            [np.sin(angle), -np.cos(angle), zero], axis=-1
        )

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Queued on the circle, in flight along it."""
        goal, velocity = self._track(np.zeros(()))
        return self.launch(self.config.scattered(goal, rng), goal, rng, velocity)._replace(
            goal_velocity=velocity
        )

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Beside those of every airspace `conflicts`: how many each drone has had."""
        return {**super().memory(), "conflicts": (self.context.num_drones,)}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Count conflicts, too."""
        super().update_memory(frame, rngs)
        frame.scene.memory["conflicts"][:] += np.where(frame.alive, frame.conflict.onsets, 0)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Let goals run on."""
        goal, velocity = self._track(time + self.context.period)
        scene.goal[flying], scene.goal_velocity[flying] = goal[flying], velocity[flying]
        return super().move_scene(scene, time, flying, rngs)

    def ahead(self, goal: np.ndarray, time: np.ndarray) -> np.ndarray:
        """What is left of the laps, m."""
        return super().ahead(goal, time) + np.maximum(
            self._way - self._pace * np.asarray(time)[:, None], 0.0
        )

    def arrived(self, frame: Frame) -> np.ndarray:
        """At the goal, which has come to its end."""
        ended = self._pace * frame.time[:, None] >= self._way
        return ended & super().arrived(frame)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell who finished without any conflict."""
        return super().succeeded(frame) & (frame.scene.memory["conflicts"] == 0)
