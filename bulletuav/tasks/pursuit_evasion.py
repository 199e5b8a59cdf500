"""Task `pursuit_evasion`: chasers try to capture evaders, which try to escape."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.geometry.rotation import Vec3, dot, minus
from bulletuav.registry import register
from bulletuav.sensors.drone_sight import DRONE_SIGHT
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import REBOUND, TaskConfig
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.given import GivenPositions
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.city_layouts import MAX_TRIES, OPEN, CityOptions, add_city
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.obstacle_field import (
    CityObstacleOptions,
    ObstacleField,
    ObstacleOptions,
)
from bulletuav.tasks.parts.teams import (
    NO_OPPONENT,
    measure_chase,
    nearest_opponents,
    team_sizes,
    zero_sum,
)
from bulletuav.tasks.parts.urban import check_fraction


@dataclass(frozen=True)
class PursuitEvasionConfig(CityOptions, CityObstacleOptions, ObstacleOptions, TaskConfig):
    """Options of `pursuit_evasion`, in addition to those of cities (`CityOptions`).

    Attributes:
        teams: Numbers of chasers and evaders; by default every fourth drone is an evader, at least
            one.
        capture: Condition for capture: "distance" to a chaser, or "contact" with one.
        capture_radius: Distance at which an evader is captured, m.
        chaser_speed: Maximum commanded speed of chasers, as a fraction of max_speed.
        evader_speed: Maximum commanded speed of evaders, as a fraction of max_speed.
        sight_range: Distance up to which drones see opponents, m. Buildings and obstacles occlude
            them.
        head_start: Minimum distance between a chaser and an evader at the start, m.
        boundary: Behaviour at the bounds of the arena. "hard": drones stop there. "soft": drones
            rebound with 0.8 of their speed. "end": the drone's episode ends outside.
        city: City in the arena, as in all tasks in cities; "open" for none.
        area: Side of the arena's square, or its lengths along x and y, m.
        num_layouts: Number of cities that are generated; each world has one of them per episode.
        height: Minimum and maximum height of starts, m.
        ceiling: Maximum height of the airspace, m.
        min_separation: Minimum distance between starts, m.
    """

    teams: tuple[int, int] | None = None
    capture: Literal["distance", "contact"] = "distance"
    capture_radius: float = 2.0
    chaser_speed: float = 1.0
    evader_speed: float = 1.0
    sight_range: float = 60.0
    head_start: float = 15.0
    boundary: Literal["hard", "soft", "end"] = "hard"
    city: Any = OPEN
    area: float | tuple[float, float] = 60.0
    num_layouts: int = field(default=1, metadata={"most": 256})
    height: tuple[float, float] = (10.0, 40.0)
    ceiling: float = 50.0
    min_separation: float = 5.0


@reward
def capture(capture_payoff: float) -> float:
    """Payoff of lost evaders: -1 for the evader, 1/C for each of C chasers."""
    return capture_payoff


@reward
def closing(closing_payoff: float) -> float:
    """Decrease of an evader's distance to the nearest chaser, m; negative for the evader."""
    return closing_payoff


@reward
def approach(distance_before: float, goal_before: Vec3, position: Vec3, chasing: bool) -> float:
    """Own motion towards the position of the nearest opponent before the decision, m.

    It is negative for evaders. Unlike `closing`, each drone is paid for its own motion alone.
    """
    left = minus(goal_before, position)
    moved = distance_before - math.sqrt(dot(left, left))
    return moved if chasing else -moved


@reward
def crash(lost: bool, collision: bool, captured: bool) -> float:
    """1 on a contact that ends the drone's episode and is no capture."""
    return 1.0 if lost and collision and not captured else 0.0


@reward
def time(
    chasing: bool, lost: bool, won: bool, time: float, duration: float, period: float
) -> float:
    """1 per decision for chasers, and the remaining decisions of lost drones.

    A chaser pays for each decision until all evaders are lost. A lost drone also pays for all
    remaining decisions.
    """
    left = (duration - time) / period if lost else 0.0
    if chasing:
        return 0.0 if won else 1.0 + left
    return left


@register("task")
class PursuitEvasion(Task[PursuitEvasionConfig]):
    """Chasers pursue evaders: a game of two teams whose main rewards are zero-sum.

    Drones 0 to C - 1 are chasers, the others evaders: 3 and 1 of 4. They start at rest at heights
    of 10 to 40 m in a square of 60 m, with the chasers on one side. A chaser within 2 m of an
    evader captures it, and the evader leaves. An evader that crashes counts as lost in the same
    way, so crashing never pays. Each drone's goal is the nearest opponent, whether in sight or not;
    blocks such as `goal` show its true position.

    Observation, Box(83) per drone with the defaults, in world axes (east, north, up): position,
    velocity, team (one-hot), distances to the sides of the arena, the nearest teammates, the
    nearest opponents in sight, and the nearest obstacles. All are relative to the drone, sorted by
    distance, and padded with zeros. Opponents are seen up to 60 m if nothing occludes them; their
    first number is 1 for an opponent in sight.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 10 m/s. Its norm is limited to max_speed, or to the team's own fraction of it. There
    are 10 decisions a second.

    Reward per decision, the weighted sum of these terms. The first two sum to zero over the drones
    of a world, exactly if their weights are integers or fractions such as 1/16.

    - capture 30: -1 for an evader that is lost, and 1 shared equally by the flying chasers.
    - closing 0.0625: decrease of an evader's distance to the nearest chaser, m: shared equally by
      the chasers, and negative for the evader.
    - approach 0: own motion towards the nearest opponent, m; negative for evaders.
    - collision -10: 1 on a contact other than a capture.
    - out_of_bounds -0.1: 1 at the bounds of the arena.
    - energy -0.0001: squared change of velocity, (m/s)^2.
    - time -0.02: 1 per decision for chasers, until all evaders are lost. Evaders that are lost, and
      chasers that crash, also get 1 per remaining decision.

    End: terminated on capture, on any other contact, when the battery is empty, and for all drones
    once a team is eliminated. Drones stop at the bounds of the arena. Truncated after 300
    decisions.

    Success: for a chaser, all evaders are lost while it flies; for an evader, it flies at the end.

    Chasers have to work together: of evaders that flee from walls, too (`flee_weighted`), three
    chasers capture all at medium, and a single one less than half. At easy, evaders have 0.6 of the
    speed, and one chaser can capture them.
    """

    version = 2
    name = "pursuit_evasion"
    is_game = True
    shirkers: ClassVar[tuple[str, ...]] = ("chase_shadow", "chase_free_ride", "chase_once")
    team_names = ("chasers", "evaders")
    defaults: ClassVar = {
        "num_drones": 4,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 300,
        "max_speed": 10.0,
        "difficulty": "medium",
    }
    difficulties: ClassVar = {
        "easy": {"evader_speed": 0.6, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {
            "num_drones": 8,
            "area": 120.0,
            "chaser_speed": 0.9,
            "num_obstacles": 6,
            "num_moving": 3,
            **UNCERTAINTY["hard"],
        },
        "extreme": {
            "num_drones": 12,
            "city": "urban",
            "area": 200.0,
            "num_layouts": 4,
            **UNCERTAINTY["extreme"],
        },
    }
    observation = ("position", "velocity", "team", "room", "teammates", "opponents", "obstacles")
    required_sensors = (DRONE_SIGHT,)
    reward: ClassVar = {
        "capture": (capture, 30.0),
        "closing": (closing, 0.0625),
        "approach": (approach, 0.0),
        "collision": (crash, -10.0),
        "out_of_bounds": -0.1,
        "energy": -0.0001,
        "time": (time, -0.02),
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        "capture": 4.0,
        "closing": 0.0,
        "approach": 0.1,
        "collision": -2.0,
        "time": -0.01,
    }
    events = ("lost", "captured", "won", "chasing", "capture_payoff", "closing_payoff")
    baseline = "lead vs flee_weighted"
    places = ("start",)
    shows: ClassVar = {
        "success": "won",
        "captured": "captured",
        "capture_time": "until capture (s)",
        "goal_distance": "to opponent (m)",
        "collision": "collisions",
    }

    def __init__(self, config: PursuitEvasionConfig, context: TaskContext) -> None:
        """Check the options, and assign the drones to the teams.

        Raises:
            ValueError: If options contradict each other.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.city_layouts = add_city(self)
        # By default one in four is an evader
        drones = context.num_drones
        evaders = max(drones // 4, 1) if drones > 1 else 0
        chasers, _ = team_sizes(config.teams, drones, (drones - evaders, evaders))
        self.team[chasers:] = 1
        self._is_evader = self.team == 1
        self.rebound = REBOUND.get(config.boundary)
        self.sight_range = config.sight_range
        self._check_distances()
        speeds = []
        for name in ("chaser_speed", "evader_speed"):
            check_fraction(name, getattr(config, name))
            speeds.append(getattr(config, name))
        if min(speeds) < 1:
            self.speed_limit = context.max_speed * np.array(speeds)[self.team]

    def _check_distances(self) -> None:
        """Check that captures happen before contact, and not at the start."""
        config, touch = self.config, 2 * self.context.collision_radius
        if config.capture == "distance" and config.capture_radius <= touch:
            raise ValueError(
                f"capture_radius is {config.capture_radius:g} m: more than {touch:.3g} m is "
                f"needed, where drones touch; or capture='contact'"
            )
        if config.head_start <= max(config.capture_radius, touch):
            raise ValueError(
                f"head_start is {config.head_start:g} m: more than the capture_radius of "
                f"{config.capture_radius:g} m is needed"
            )

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts at rest, with the chasers on one side of the evaders.

        Raises:
            ValueError: If there is no space for so many drones, or for the head start.
        """
        layout = self.city_layouts.draw(rng)
        chasers = self.context.num_drones - int(self._is_evader.sum())
        for _ in range(MAX_TRIES):
            place = self.city_layouts.places(rng, layout, self.context.num_drones)
            # Evaders are the foremost drones in a random direction
            place = place[np.argsort(place[:, :2] @ rng.normal(size=2), kind="stable")]
            gaps = np.linalg.norm(place[:chasers, None] - place[None, chasers:], axis=-1)
            if gaps.min(initial=np.inf) >= self.config.head_start:
                return Spawn(position=place, goal=place, layout=layout)
        raise ValueError(
            f"head_start is {self.config.head_start:g} m: there is no room for it among "
            f"{self.context.num_drones} drones; lower it, or raise area"
        )

    def finish(self, spawn: Spawn, given: GivenPositions, rng: np.random.Generator) -> Spawn:
        """Apply given positions to a start, and set goals to the nearest opponents."""
        spawn = super().finish(spawn, given, rng)
        nearest = np.empty((1, len(spawn.position)), dtype=np.int64)
        everyone = np.ones(nearest.shape, dtype=bool)
        nearest_opponents(spawn.position[None], everyone, self.team, nearest)
        found = (nearest != NO_OPPONENT).T
        return spawn._replace(goal=np.where(found, spawn.position[nearest[0]], spawn.position))

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the per-drone memory, all (N,).

        Returns:
            "lost_at" and "captured_at", time at which the drone was lost or captured, s, 0 before;
            "captures", number of evaders that it captured; "closed", decrease of the distance to
            the nearest chaser in the last decision, m.
        """
        drones = (self.context.num_drones,)
        own = dict.fromkeys(("lost_at", "captured_at", "captures", "closed"), drones)
        return {**super().memory(), **own}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Record captures and losses, and update goals."""
        super().update_memory(frame, rngs)
        memory, flown = frame.scene.memory, frame.alive
        places = (frame.before.position, frame.after.position)
        min_distance, closed = np.empty((2, *flown.shape))
        by = np.empty(flown.shape, dtype=np.int64)
        measure_chase(*places, flown, self.team, min_distance, by, closed)
        memory["closed"][:] = closed
        harmless, touched = self._contacts(frame)
        if self.config.capture == "contact":
            captured = touched.any(axis=2)
            by = touched.argmax(axis=2)
        else:
            captured = min_distance <= self.config.capture_radius
        captured = captured & flown & self._is_evader
        w, i = np.nonzero(captured)
        np.add.at(memory["captures"], (w, by[w, i]), 1.0)
        # Drones that crash, leave the arena or have empty batteries are lost, too
        lost = captured | (frame.collision & ~harmless) | frame.depleted
        if self.config.boundary == "end":
            lost |= self.outside(frame)
        now = np.broadcast_to(frame.time[:, None], flown.shape)
        np.copyto(memory["captured_at"], now, where=captured)
        np.copyto(memory["lost_at"], now, where=lost & flown)
        self._update_goals(frame, flown & ~lost)

    def _contacts(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Return which drones touched opponents only, (W, N), and which ones, (W, N, N) bool."""
        touched = np.zeros((*frame.alive.shape, len(self.team)), dtype=bool)
        if not frame.collision.any():
            return touched[..., 0], touched
        world, drone, other, *_ = frame.contacts
        opposed = (other >= 0) & (self.team[drone] != self.team[other])
        touched[world[opposed], drone[opposed], other[opposed]] = True
        harmless = np.any(touched, axis=2)
        harmless[world[~opposed], drone[~opposed]] = False
        return harmless, touched

    def _update_goals(self, frame: Frame, present: np.ndarray) -> None:
        """Set goals to the nearest opponents of `present` (W, N); others keep their goals."""
        scene, swarm = frame.scene, frame.after
        nearest = np.empty(present.shape, dtype=np.int64)
        nearest_opponents(swarm.position, present, self.team, nearest)
        found = (nearest != NO_OPPONENT)[..., None]
        for goal, own in ((scene.goal, swarm.position), (scene.goal_velocity, swarm.velocity)):
            np.copyto(goal, np.take_along_axis(own, nearest[..., None], axis=1), where=found)
        fill_paired_distances(scene.goal, swarm.position, frame.distance)
        fill_paired_distances(scene.goal, frame.known_position, frame.known_distance)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Return which drones are lost or without opponents; derive the events that terms read.

        Returns:
            (W, N) bool. Sets all `events` in `frame.derived`.
        """
        memory, flown, evader = frame.scene.memory, frame.alive, self._is_evader
        now = frame.time[:, None]
        lost = flown & (memory["lost_at"] == now) & (now > 0)
        left = flown & ~lost
        # Chasers win when no evader is left; the game also ends without chasers
        won = evader.any() & ~np.any(left & evader, axis=1)
        gone = (~evader).any() & ~np.any(left & ~evader, axis=1)
        chasers, evaders = flown & ~evader, flown & evader
        frame.derived["lost"] = lost
        frame.derived["captured"] = lost & (memory["captured_at"] == now)
        frame.derived["won"] = np.broadcast_to(won[:, None], flown.shape) & left
        frame.derived["chasing"] = np.broadcast_to(~evader, flown.shape)
        frame.derived["capture_payoff"] = zero_sum(1.0 * lost, chasers, evaders)
        frame.derived["closing_payoff"] = zero_sum(memory["closed"], chasers, evaders)
        ended: np.ndarray = lost | (won | gone)[:, None]
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones win: chasers without evaders left, evaders alive at the end.

        Returns:
            (W, N) bool.
        """
        evader, lost = self._is_evader, frame.derived["lost"]
        chasers_left = np.any(frame.alive & ~lost & ~evader, axis=1)
        is_over = frame.last | ~chasers_left
        escaped = is_over[:, None] & frame.alive & ~lost & evader
        success: np.ndarray = escaped | (frame.derived["won"] & ~evader)
        return success

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the infos of the city and of the game, (W, N).

        Returns:
            The same for all drones of a world: "captured", the fraction of evaders captured, and
                "capture_time", the mean time until capture over evaders, s, with the length of the
                episode for those not captured. For each drone "captures", the number of evaders
                that it captured.
        """
        memory, shape = frame.scene.memory, frame.alive.shape
        evaders = max(int(self._is_evader.sum()), 1)
        was = (memory["captured_at"] > 0) & self._is_evader
        share = was.sum(axis=1) / evaders
        spent = np.where(was, memory["captured_at"], 0.0).sum(axis=1) / evaders
        mean = spent + (1 - share) * self.context.duration
        return {
            **super().info(frame),
            "captured": np.broadcast_to(share[:, None], shape),
            "capture_time": np.broadcast_to(mean[:, None], shape),
            "captures": memory["captures"].copy(),
        }
