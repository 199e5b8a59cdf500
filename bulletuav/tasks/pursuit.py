"""Task `pursuit`: drones share a circular track at speeds of their own, and have to overtake."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, hypot, sin
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import as_sequence, finite
from bulletuav.registry import register
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.goal_flight import REWARD_WEIGHTS, TRAINING_WEIGHTS, FlightConfig, GoalFlight
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.airspace import (
    AirspaceOptions,
    circle_arena,
    clearance,
    min_start_distance,
)
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.forward_flight import (
    TURN_MARGIN,
    forward_sizes,
    kept_number,
    tightest_turn,
)
from bulletuav.tasks.parts.presets import UAVCONFLICT
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.envelope import find_envelope

PLATOON = 10
"""Number of drones in a platoon, in which the faster drones start behind the slower ones"""
MAX_SLACK = 0.1
"""Maximum `slack` as a fraction of the track: drones average 0.9 of their cruising speed or more"""
SPEED_RESERVE = 1.25
"""Ratio of the slowest cruising speed of aircraft that cannot hover to their minimum speed, and of
their maximum speed to the fastest one"""
MIN_SPEED = 0.1
"""Minimum cruising speed with aircraft that cannot hover, m/s"""
CLIMB_SPEED_FRACTION = 0.5
"""Speed of the climb for which goals wait, as a fraction of max_speed"""


@dataclass(frozen=True)
class PursuitConfig(AirspaceOptions, FlightConfig):
    """Options of `pursuit`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        radius: Radius of the circular track, m.
        spacing: Distance between neighbours along the track at the start, m.
        speed: Minimum and maximum cruising speed, m/s, drawn for each drone and episode.
        laps: Number of laps of each drone.
        slack: Maximum distance of a drone from its goal, which moves along the track, m.
        max_cut: Maximum distance of a drone inside the track, m, measured horizontally: with the
            slack alone, drones could fly much shorter laps.
        start_speed: Minimum and maximum speed at the start, m/s, limited to max_speed.
    """

    radius: float = 60.0
    spacing: float = 15.0
    speed: tuple[float, float] = (10.0, 18.0)
    laps: int = 1
    slack: float = 20.0
    max_cut: float = 15.0
    # Goals move at full speed from the start
    start_speed: tuple[float, float] = (10.0, 15.0)


@end
def off_schedule(is_on_schedule: bool) -> bool:
    """Return True before the end of the laps, if the drone is off its schedule.

    That is farther than `slack` from its goal, or farther than `max_cut` inside the track.
    """
    return not is_on_schedule


@reward
def lap(laps_due: float, is_on_schedule: bool, is_safe: bool) -> float:
    """Fraction of all laps due in the decision: of drones on schedule without conflict."""
    return laps_due if is_on_schedule and is_safe else 0.0


@reward
def safe_finish(reached: bool, is_safe: bool) -> float:
    """1 in the decision in which all laps are complete, without conflict or collision before."""
    return 1.0 if reached and is_safe else 0.0


@register("task")
class Pursuit(GoalFlight[PursuitConfig]):
    """Drones share a circular track, each at a cruising speed of its own, and have to overtake.

    Drones start in a queue on the track, drone 0 first, and fly clockwise. For each episode their
    cruising speeds v are drawn evenly from 10 to 18 m/s, and sorted in each platoon of ten drones,
    the slowest first. A drone's goal moves along the track at v for one lap. The drone has to stay
    within slack = 20 m of the goal, so that it averages 0.9 v or more: it may neither wait nor
    sprint, and drones that fly at one speed in convoy fail. It may also be no more than 15 m inside
    the track. With `take_off`, goals wait for a climb at half of max_speed, 4 s, then speed up for
    as long; the slack and the track count from then on.

    Observation, Box(58) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the goal's velocity (its norm is v), the nearest
    active drones, and the nearest obstacles. Drones and obstacles are relative to the drone, sorted
    by distance, and padded with zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - lap 500: fraction of all laps that the goal moved, while the drone is within the slack, does
      not cut the track, and had no conflict or collision.
    - goal 500: 1 when the goal completes its laps, under the same conditions.
    - progress 0: decrease of the distance to the moving goal, m.
    - conflict -200: number of drones whose separation falls below d_safe = 5 m.
    - warning -0.5: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the laps are complete, and per remaining decision on other
      ends.

    End: terminated when the laps are complete, farther than the slack from the goal, more than 15 m
    inside the track, on contact, when the battery is empty, or outside the arena. Truncated after
    500 decisions; extreme has 1,300.

    Success: the laps are complete, without conflict or collision in the episode.

    Info: `overtakes`, number of times that the drone passed another one along the track.

    Difficulties: easy has 4 drones and a slack of 25 m, hard has 20 drones and 17 m. extreme has
    100 drones at 12 to 18 m/s, a circle of 200 m, and 25 m. Uncertainty: see `GoalFlight`.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.

    Attributes:
        track_length: Length of all laps, m.
        climb_time: Time for which goals wait for drones that take off, and then speed up, s.
    """

    version = 2
    name = "pursuit"
    needs_hover = False
    places: ClassVar[tuple[str, ...]] = ("start",)
    observation = ("position", "velocity", "goal", "goal_velocity", "neighbours", "obstacles")
    reward: ClassVar = {
        **REWARD_WEIGHTS,
        "progress": 0.0,
        "warning": -0.5,
        "lap": (lap, 500.0),
        "goal": (safe_finish, 500.0),
    }
    ends: ClassVar = (off_schedule,)
    oracle = "pursuit_oracle"
    shirkers: ClassVar[tuple[str, ...]] = (
        "pursuit_convoy",
        "pursuit_slow_convoy",
        "pursuit_fast_convoy",
        "pursuit_queue",
        "pursuit_sprint_and_wait",
        "pursuit_wait_and_sprint",
        "pursuit_stop",
        "pursuit_shortcut",
        "pursuit_inner_lanes",
        "pursuit_orbit",
        "pursuit_climb",
        "pursuit_backwards",
    )
    training_weights: ClassVar[Mapping[str, float]] = {
        **TRAINING_WEIGHTS,
        # Paid for `lap` alone, drones hardly learn to stay with their goals
        "progress": 0.1,
        "lap": 10.0,
        "goal": 10.0,
        "time": 0.0,
    }
    presets: ClassVar = {
        "uavconflict": {**UAVCONFLICT, "weights": {**UAVCONFLICT["weights"], "lap": 0.0}}
    }
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, "slack": 25.0, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {"num_drones": 20, "slack": 17.0, **UNCERTAINTY["hard"]},
        "extreme": {
            "num_drones": 100,
            "radius": 200.0,
            "spacing": 12.0,
            "speed": (12.0, 18.0),
            "slack": 25.0,
            "horizon": 1300,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: PursuitConfig, context: TaskContext) -> None:
        """Check that drones start separated and are fast enough, and set the arena.

        Raises:
            ValueError: If drones could start in conflict or touching the ground, are too slow for
                the horizon, or the slack is smaller than the jitter or too large for the track.
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
        self.track_length = float(2 * np.pi * config.radius * config.laps)
        climb_speed = CLIMB_SPEED_FRACTION * context.max_speed
        self.climb_time = config.altitude / climb_speed if config.take_off else 0.0
        duration = context.duration - 1.5 * self.climb_time
        if self.track_length >= slowest * duration:
            raise ValueError(
                f"speed {slowest:g} m/s is too slow for {self.track_length:.4g} m of track "
                f"within {duration:g} s: raise horizon or speed, or fly fewer laps"
            )
        nearest, farthest = float(np.sqrt(3) * config.jitter), MAX_SLACK * self.track_length
        if not nearest < config.slack <= farthest:
            raise ValueError(
                f"slack is {config.slack:g} m: more than {nearest:.3g} m, by which jitter offsets "
                f"starts, and up to {farthest:.3g} m, {MAX_SLACK:g} of the track, is needed"
            )

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return a track of gentle turns, flown at speeds of the envelope; see the base class."""
        envelopes = [find_envelope(one) for one in airframes]
        slowest = SPEED_RESERVE * max(one.min_speed for one in envelopes)
        fastest = min(values["max_speed"], *(one.max_speed for one in envelopes)) / SPEED_RESERVE
        turn = math.ceil(tightest_turn(airframes))
        spacing = kept_number(kept, "spacing", turn)
        room = int(values["num_drones"]) * spacing / (2 * math.pi)
        radius = kept_number(kept, "radius", math.ceil(max(TURN_MARGIN * turn, room)))
        laps = 2 * math.pi * radius * kept_number(values, "laps", PursuitConfig.laps)
        speeds = as_sequence("speed", kept.get("speed", (slowest, fastest)), 2)
        sizes = forward_sizes(
            airframes, values, laps, min(finite("speed", one, MIN_SPEED) for one in speeds)
        )
        sizes.pop("goal_radius")  # the slack decides
        own = {"radius": radius, "spacing": spacing, "speed": (slowest, fastest)}
        return {**own, **sizes}

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

    def flown(self, cruising_speed: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return how far goals moved along the track, from 0 to the length of all laps, m.

        Args:
            cruising_speed: (..., N) speeds of the goals, m/s.
            time: (...) time since the start, s.
        """
        distance = cruising_speed * self._cruise(time)[0][..., None]
        flown: np.ndarray = np.minimum(distance, self.track_length)
        return flown

    def _cruise(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the movement of goals until times (...), s, in units of the cruising speed.

        Returns:
            Time for the distance at full cruising speed, s, and fraction of it at present, (...).
        """
        time, climb = np.asarray(time), self.climb_time
        if not climb:
            return time, np.ones_like(time)
        # Uniform acceleration, as drones cannot follow a jump from rest within the slack
        ramp = np.asarray(np.clip(time - climb, 0.0, climb))
        full = np.maximum(time - 2 * climb, 0.0)
        return np.asarray(ramp * ramp / (2 * climb) + full), ramp / climb

    def _track(self, cruising_speed: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (..., N, 3), m, and velocities (..., N, 3), m/s, of goals.

        Args:
            cruising_speed: (..., N) speeds of the goals, m/s.
            time: (...) time since the start, s.
        """
        config = self.config
        flown = self.flown(cruising_speed, time)
        # Clockwise from each drone's place in the queue, until the laps are complete
        queue = np.arange(self.context.num_drones) * config.spacing
        angle = (queue - flown) / config.radius
        height = np.full_like(angle, config.altitude)
        place = np.stack([config.radius * cos(angle), config.radius * sin(angle), height], axis=-1)
        speed = cruising_speed * self._cruise(time)[1][..., None]
        speed = np.where(flown < self.track_length, speed, 0.0)[..., None]
        return place, speed * np.stack([sin(angle), -cos(angle), np.zeros_like(angle)], axis=-1)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw cruising speeds, and starts of drones queued on the circle, in flight along it."""
        index = np.arange(self.context.num_drones)
        drawn = rng.uniform(*self.config.speed, len(index))
        speed = drawn[np.lexsort((drawn, index // PLATOON))]
        goal, velocity = self._track(speed, np.zeros(()))
        start = self.config.scattered(goal, rng)
        memory = {"cruising_speed": speed}
        return self.launch(start, goal, rng, velocity, goal_velocity=velocity, memory=memory)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of `GoalFlight` and of the task.

        Returns:
            "cruising_speed" (N,), m/s; "overtakes" (N,), number of overtakes.
        """
        shape = (self.context.num_drones,)
        return {**super().memory(), "cruising_speed": shape, "overtakes": shape}

    def quantities(self) -> Mapping[str, Any]:
        """Return those of `GoalFlight`, `is_on_schedule` and `laps_due`."""
        own = {"is_on_schedule": self.is_on_schedule, "laps_due": self.laps_due}
        return {**super().quantities(), **own}

    def laps_due(self, frame: Frame) -> np.ndarray:
        """Return the fraction of all laps that goals moved in the decision, (W, N)."""
        speed = frame.scene.memory["cruising_speed"]
        before = self.flown(speed, frame.time - self.context.period)
        due: np.ndarray = (self.flown(speed, frame.time) - before) / self.track_length
        return due

    def is_on_schedule(self, frame: Frame) -> np.ndarray:
        """Return which drones are near their goals and cut no corner, or were at the end, (W, N).

        While goals wait for the climb, all drones are on schedule.
        """
        config, place = self.config, frame.after.position
        inside = config.radius - hypot(place[..., 0], place[..., 1])
        within: np.ndarray = (frame.distance <= config.slack) & (inside <= config.max_cut)
        climbs = (frame.time < self.climb_time)[:, None]
        return within | climbs | (frame.scene.memory["reached"] > 0)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Count the overtakes."""
        super().update_memory(frame, rngs)
        overtakes = frame.scene.memory["overtakes"]
        count_overtakes(frame.before.position, frame.after.position, frame.alive, overtakes)

    def _laps_left(self, frame: Frame, time: np.ndarray) -> np.ndarray:
        """Return how far goals have yet to move at times (W,), s: (W, N) m."""
        flown: np.ndarray = self.flown(frame.scene.memory["cruising_speed"], time)
        return self.track_length - flown

    def remaining_distance(self, frame: Frame) -> np.ndarray:
        """Return the distance to the goal plus that which it has yet to move, (W, N) m."""
        remaining: np.ndarray = super().remaining_distance(frame)
        remaining = remaining + self._laps_left(frame, frame.time)
        return remaining

    def remaining_distance_before(self, frame: Frame) -> np.ndarray:
        """Return `remaining_distance` before the decision, (W, N) m."""
        remaining: np.ndarray = super().remaining_distance_before(frame)
        remaining = remaining + self._laps_left(frame, frame.time - self.context.period)
        return remaining

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the goals along the track."""
        speed = scene.memory["cruising_speed"]
        goal, velocity = self._track(speed, time + self.context.period)
        scene.goal[flying] = goal[flying]
        scene.goal_velocity[flying] = velocity[flying]
        return super().move_scene(scene, time, flying, rngs)

    def arrived(self, frame: Frame) -> np.ndarray:
        """Return which drones are within the slack of goals that completed their laps, (W, N)."""
        arrived: np.ndarray = frame.distance <= self.config.slack
        return arrived & (self._laps_left(frame, frame.time) <= 0.0)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the numbers of overtakes, (W, N)."""
        overtakes = frame.scene.memory["overtakes"].astype(int)
        return {**super().info(frame), "overtakes": overtakes}


@kernel
def count_overtakes(
    before: np.ndarray, after: np.ndarray, alive: np.ndarray, overtakes: np.ndarray
) -> None:
    """Count the drones that each drone passes clockwise around the centre in a decision.

    Args:
        before: (W, N, 3) positions before the decision, m.
        after: (W, N, 3) positions after the decision, m.
        alive: (W, N) bool, drones that flew the decision.
        overtakes: (W, N) counts, updated.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(alive.shape[1]):
                if not (alive[w, i] and alive[w, j]) or i == j:
                    continue
                x, y = before[w, i, 0], before[w, i, 1]
                behind = before[w, j, 0] * y - before[w, j, 1] * x > 0.0
                x, y = after[w, i, 0], after[w, i, 1]
                ahead = after[w, j, 0] * y - after[w, j, 1] * x <= 0.0
                # On the same side of the circle: the order changes on the opposite side, too
                near = after[w, j, 0] * x + after[w, j, 1] * y > 0.0
                if behind and ahead and near:
                    overtakes[w, i] += 1.0
