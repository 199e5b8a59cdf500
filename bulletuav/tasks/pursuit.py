"""Task `pursuit`: drones queue on a circular track, the fastest last, so that they overtake."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.registry import register
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.goal_flight import REWARD_WEIGHTS, TRAINING_WEIGHTS, FlightConfig, GoalFlight
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.airspace import (
    AirspaceOptions,
    circle_arena,
    clearance,
    min_start_distance,
)
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES
from bulletuav.tasks.parts.presets import UAVCONFLICT

TOLERANCE = 0.5
"""Tolerance of the angle flown, rad: starts, and ends at the goal, are slightly offset"""


@dataclass(frozen=True)
class PursuitConfig(AirspaceOptions, FlightConfig):
    """Options of `pursuit`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        radius: Radius of the circular track, m.
        spacing: Distance between neighbours in the queue along the track, m.
        speed: Speed of the first and the last drone of the queue, m/s; evenly spaced in between.
        laps: Number of laps of each goal.
    """

    radius: float = 60.0
    spacing: float = 15.0
    speed: tuple[float, float] = (10.0, 18.0)
    laps: int = 1


@reward
def lap(
    remaining_distance: float, remaining_distance_before: float, radius: float, laps: int
) -> float:
    """Decrease of the remaining distance, by track and to the goal, as a fraction of all laps."""
    return (remaining_distance_before - remaining_distance) / (2 * np.pi * radius * laps)


@register("task")
class Pursuit(GoalFlight[PursuitConfig]):
    """Drones queue on a circular track, the faster behind the slower, and have to overtake.

    Each drone's goal moves along the circle, clockwise, at the drone's own pace. It makes one lap,
    back to the drone's start, and stops there. Drones have to fly the lap themselves: waiting for
    the goal is no success. Drone 0 leads and is the slowest.

    Observation, Box(58) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the goal's velocity, the nearest active drones,
    and the nearest obstacles. Drones and obstacles are relative to the drone, sorted by distance,
    and padded with zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - lap 1000: fraction of all laps gained, along the track and to the goal.
    - progress 0: decrease of the distance to the moving goal, m.
    - goal 50: 1 in the decision in which the drone reaches the goal after flying all laps.
    - conflict -200: number of drones whose separation falls below d_safe = 5 m.
    - warning -5: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the goal is reached, and per remaining decision on other ends.

    End: terminated within 2 m of the goal once the goal has stopped, on contact, when the battery
    is empty, or outside the arena. Truncated after 500 decisions; extreme has 1,000.

    Success: the goal is reached once it has stopped, without conflict or collision in the episode.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.
    """

    name = "pursuit"
    places: ClassVar[tuple[str, ...]] = ("start",)
    observation = ("position", "velocity", "goal", "goal_velocity", "neighbours", "obstacles")
    reward: ClassVar = {**REWARD_WEIGHTS, "progress": 0.0, "lap": (lap, 1000.0)}
    training_weights: ClassVar[Mapping[str, float]] = {
        **TRAINING_WEIGHTS,
        "progress": 0.0,
        "lap": 15.0,
    }
    presets: ClassVar = {
        "uavconflict": {**UAVCONFLICT, "weights": {**UAVCONFLICT["weights"], "lap": 0.0}}
    }
    difficulties: ClassVar = {
        "easy": AIRSPACE_DIFFICULTIES["easy"],
        "medium": AIRSPACE_DIFFICULTIES["medium"],
        "hard": AIRSPACE_DIFFICULTIES["hard"],
        "extreme": {
            "radius": 150.0,
            "spacing": 17.0,
            "speed": (12.0, 18.0),
            "horizon": 1000,
            **AIRSPACE_DIFFICULTIES["extreme"],
            "num_drones": 50,
        },
    }

    def __init__(self, config: PursuitConfig, context: TaskContext) -> None:
        """Check that drones start separated and are fast enough, and set the arena.

        Raises:
            ValueError: If drones could start in conflict or touching the ground, or are too slow
                for the horizon.
        """
        super().__init__(config, context)
        slowest, fastest = config.speed
        if not 0 < slowest <= fastest <= context.max_speed:
            raise ValueError(
                f"speed is {config.speed}: "
                f"from low to high, above 0 and up to max_speed {context.max_speed:g} m/s is needed"
            )
        self._check_spacing()
        self.arena_low, self.arena_high = circle_arena(config, context, config.radius)
        self._pace = np.linspace(slowest, fastest, context.num_drones)
        self._track_length = 2 * np.pi * config.radius * config.laps
        if self._track_length > slowest * context.duration:
            raise ValueError(
                f"speed {slowest:g} m/s is too slow for {self._track_length:.4g} m of track "
                f"within {context.duration:g} s: raise horizon or speed, or fly fewer laps"
            )

    def _check_spacing(self) -> None:
        """Check that the queue fits on the circle, and that its drones start without conflict."""
        config = self.config
        drones = self.context.num_drones
        if drones * config.spacing > 2 * np.pi * config.radius:
            raise ValueError(
                f"{drones} drones with spacing {config.spacing:g} m do not fit "
                f"on a circle of radius {config.radius:g} m"
            )
        # `spacing` is the arc length; the distance is the chord
        chord = 2 * config.radius * sin(config.spacing / (2 * config.radius))
        nearest = min_start_distance(config, chord)
        clear = clearance(config, self.context)
        if drones > 1 and nearest <= clear:
            raise ValueError(
                f"start positions may be in conflict: spacing {config.spacing:g} m with jitter "
                f"{config.jitter:g} m leaves {nearest:.3g} m between neighbours, "
                f"more than {clear:.3g} m (d_safe) is needed"
            )

    def _track(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (..., N, 3), m, and velocities (..., N, 3), m/s, of goals.

        Args:
            time: (...) time since the start, s.
        """
        radius = self.config.radius
        distance = self._pace * np.asarray(time)[..., None]
        # Clockwise from each drone's place in the queue, until the laps are complete
        queue = np.arange(len(self._pace)) * self.config.spacing
        angle = (queue - np.minimum(distance, self._track_length)) / radius
        zero = np.zeros_like(angle)
        circle = radius * np.stack([cos(angle), sin(angle), zero], axis=-1)
        place = circle + np.array((0.0, 0.0, self.config.altitude))
        pace = np.where(distance < self._track_length, self._pace, 0.0)[..., None]
        velocity = pace * np.stack([sin(angle), -cos(angle), zero], axis=-1)
        return place, velocity

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts of drones queued on the circle, in flight along it."""
        goal, velocity = self._track(np.zeros(()))
        start = self.config.scattered(goal, rng)
        return self.launch(start, goal, rng, velocity, goal_velocity=velocity)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of `GoalFlight` and of the laps.

        Returns:
            "swept" (N,), angle flown around the centre, clockwise, rad; "laps_left",
            "laps_left_before" (N,), see `remaining_distance`, m.
        """
        own = ("swept", "laps_left", "laps_left_before")
        return {**super().memory(), **dict.fromkeys(own, (self.context.num_drones,))}

    def start_memory(self, frame: Frame) -> None:
        """Compute the remaining distances at the start."""
        self._update_distances(frame)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update the angles flown and the remaining distances."""
        memory = frame.scene.memory
        turned = _bearing(frame.before.position) - _bearing(frame.after.position)
        # The smaller angle: no drone flies half a lap in one decision
        turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
        memory["swept"][:] += np.where(frame.alive, turned, 0.0)
        memory["laps_left_before"][:] = memory["laps_left"]
        self._update_distances(frame)
        super().update_memory(frame, rngs)

    def _update_distances(self, frame: Frame) -> None:
        """Update the remaining distances: along the track, and to the goal."""
        memory = frame.scene.memory
        angle = np.maximum(2 * np.pi * self.config.laps - memory["swept"], 0.0)
        memory["laps_left"][:] = self.config.radius * angle + super().remaining_distance(frame)

    def remaining_distance(self, frame: Frame) -> np.ndarray:
        """Return the remaining distance: the laps along the track, and to the goal, (W, N) m."""
        return frame.scene.memory["laps_left"]

    def remaining_distance_before(self, frame: Frame) -> np.ndarray:
        """Return `remaining_distance` before the decision, (W, N) m."""
        return frame.scene.memory["laps_left_before"]

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the goals along the track."""
        goal, velocity = self._track(time + self.context.period)
        scene.goal[flying] = goal[flying]
        scene.goal_velocity[flying] = velocity[flying]
        return super().move_scene(scene, time, flying, rngs)

    def arrived(self, frame: Frame) -> np.ndarray:
        """Return which drones flew their laps and are at their stopped goals, (W, N) bool."""
        has_stopped = self._pace * frame.time[:, None] >= self._track_length
        has_flown = frame.scene.memory["swept"] >= 2 * np.pi * self.config.laps - TOLERANCE
        arrived: np.ndarray = has_stopped & has_flown & super().arrived(frame)
        return arrived


def _bearing(position: np.ndarray) -> np.ndarray:
    """Return the bearing of positions (..., 3) from the centre, from east to north, rad."""
    bearing: np.ndarray = atan2(position[..., 1], position[..., 0])
    return bearing
