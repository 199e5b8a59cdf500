"""Task `pursuit_evasion`: chasers are to capture evaders, which are to get away."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.registry import register
from bulletuav.sensors.drone_sight import DRONE_SIGHT
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import REBOUND, TaskConfig
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.given import Given
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.city_layouts import MAX_TRIES, OPEN, CityOptions, add_city
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.obstacle_field import ObstacleField, ObstacleOptions
from bulletuav.tasks.parts.teams import (
    NOBODY,
    follow_chase,
    nearest_opponents,
    team_sizes,
    zero_sum,
)
from bulletuav.tasks.parts.urban import check_share


@dataclass(frozen=True)
class PursuitEvasionConfig(CityOptions, ObstacleOptions, TaskConfig):
    """Options of `pursuit_evasion`, beside those of cities (`CityOptions`).

    Attributes:
        teams: Chasers and evaders; when left out every fourth drone is an evader, but one at least.
        capture: How an evader is captured: by "distance" from a chaser, or by "contact" with one.
        capture_radius: Distance at which it is captured, m.
        chaser_speed: Greatest speed that chasers can ask for, as a share of max_speed.
        evader_speed: Greatest speed that evaders can ask for, as a share of max_speed.
        sight_range: How far drones see opponents, m. Buildings and obstacles hide them, too.
        head_start: Least distance between a chaser and an evader at the start, m.
        boundary: What happens at the bounds of the arena. "hard": drones stop there. "soft": they
            are thrown back with 0.8 of their speed. "end": the drone's episode ends outside.
        city: "open" for none, or what stands in the arena, as in all tasks in cities.
        area: Side of the arena's square, or its lengths along x and y, m.
        num_layouts: Number of cities that are made; a world has one of them for an episode.
        height: Least and greatest height of starts, m.
        ceiling: Greatest height of the airspace, m.
        min_separation: Least distance between starts, m.
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
    area: float | tuple[float, float] = 100.0
    num_layouts: int = field(default=1, metadata={"most": 256})
    height: tuple[float, float] = (10.0, 40.0)
    ceiling: float = 50.0
    min_separation: float = 5.0


@reward
def capture(capture_payoff: float) -> float:
    """Evaders captured or crashed: what each of C chasers gets is 1/C, the evader's is -1."""
    return capture_payoff


@reward
def closing(closing_payoff: float) -> float:
    """Metres that the nearest chaser came nearer to evaders: chasers share them, evaders lose."""
    return closing_payoff


@reward
def crash(lost: bool, collision: bool, captured: bool) -> float:
    """1 on a contact that ends the drone's episode and is no capture."""
    return 1.0 if lost and collision and not captured else 0.0


@reward
def time(
    chasing: bool, lost: bool, won: bool, time: float, duration: float, period: float
) -> float:
    """Decisions that chasers take; those that evaders lack, and chasers that end before.

    A chaser pays each decision until all evaders are gone. Whoever is lost pays all that are left.
    """
    left = (duration - time) / period if lost else 0.0
    if chasing:
        return 0.0 if won else 1.0 + left
    return left


@register("task")
class PursuitEvasion(Task[PursuitEvasionConfig]):
    """Pursuit of evaders by chasers, two teams whose main rewards add up to zero.

    Drones 0 to C - 1 are chasers, the others evaders: 3 and 1 of 4. They start at rest, 10 to 40 m
    high in a square of 100 m, chasers on one side. A chaser within 2 m captures an evader, which
    leaves. An evader that crashes is lost in the same way, so that no crash saves it. Each drone's
    goal is the nearest opponent, wherever it is; blocks such as `goal` tell it and know no sight.

    Observation, Box(83) per drone with the defaults, in world axes (east, north, up): position,
    velocity, team (one-hot), room to the sides of the arena, the nearest teammates, the nearest
    opponents in sight, and the nearest obstacles. All come nearest first, relative to the drone,
    and are zeros where there are fewer. Opponents are seen up to 60 m, unless something is in
    between; their first number is 1 where one is seen.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 10 m/s.
    Its norm is limited to max_speed, or to the team's own share of it. There are 10 decisions a
    second.

    Reward per decision, the sum of these terms times their weights. The first two add up to zero
    over the drones of a world, to the last bit, as long as their weights are whole or such as 1/16.

    - capture 30: -1 for an evader that is lost, which the chasers that fly share.
    - closing 0.0625: metres that the nearest chaser came nearer to an evader. Chasers share them,
      the evader has them with a minus.
    - collision -10: 1 on a contact that is no capture.
    - out_of_bounds -0.1: 1 at the bounds of the arena.
    - energy -0.0001: square of the velocity change, (m/s)^2.
    - time -0.02: 1 a decision for chasers, until all evaders are lost. Evaders that are lost, and
      chasers that crash, pay for all decisions that are left.

    End: terminated where captured, on any other contact, with an empty battery, and for all once a
    team is gone. Drones stop at the bounds of the arena. Truncated after 300 decisions.

    Success: for a chaser, all evaders are lost while it flies; for an evader, it flies at the end.
    """

    name = "pursuit_evasion"
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
            "chaser_speed": 0.8,
            **UNCERTAINTY["extreme"],
        },
    }
    observation = (
        "position",
        "velocity",
        "team",
        "room",
        "teammates",
        "opponents",
        "obstacles",
    )
    required_sensors = (DRONE_SIGHT,)
    reward: ClassVar = {
        "capture": (capture, 30.0),
        "closing": (closing, 0.0625),
        "collision": (crash, -10.0),
        "out_of_bounds": -0.1,
        "energy": -0.0001,
        "time": (time, -0.02),
    }
    events = ("lost", "captured", "won", "chasing", "capture_payoff", "closing_payoff")
    baseline = "lead vs flee"
    places = ("start",)
    shows: ClassVar = {
        "success": "won",
        "captured": "captured",
        "capture_time": "until capture (s)",
        "goal_distance": "to opponent (m)",
        "collision": "collisions",
    }

    def __init__(self, config: PursuitEvasionConfig, context: TaskContext) -> None:
        """Check the options, and share the drones out to the teams.

        Raises:
            ValueError: Options contradict each other.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.town = add_city(self)
        # One in four evades, unless teams are told
        drones = context.num_drones
        evaders = max(drones // 4, 1) if drones > 1 else 0
        chasers, _ = team_sizes(config.teams, drones, (drones - evaders, evaders))
        self.team[chasers:] = 1
        self._is_evader = self.team == 1
        self.rebound = REBOUND.get(config.boundary)
        self.sight_range = config.sight_range
        self._check_distances()
        # Teams may be slower than drones can fly, each by a share
        speeds = []
        for name in ("chaser_speed", "evader_speed"):
            check_share(name, getattr(config, name))
            speeds.append(getattr(config, name))
        if min(speeds) < 1:
            self.speed_limit = context.max_speed * np.array(speeds)[self.team]

    def _check_distances(self) -> None:
        """Refuse captures that come too late, or at once."""
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
        """Draw a start at rest, with the chasers on one side of the evaders.

        Raises:
            ValueError: There is no room for so many, or for the head start.
        """
        layout = self.town.draw(rng)
        chasers = self.context.num_drones - int(self._is_evader.sum())
        for _ in range(MAX_TRIES):
            place = self.town.places(rng, layout, self.context.num_drones)
            # In a random direction, those that are the farthest ahead are evaders.
            place = place[np.argsort(place[:, :2] @ rng.normal(size=2), kind="stable")]
            gaps = np.linalg.norm(place[:chasers, None] - place[None, chasers:], axis=-1)
            if gaps.min(initial=np.inf) >= self.config.head_start:
                return Spawn(position=place, goal=place, layout=layout)
        raise ValueError(
            f"head_start is {self.config.head_start:g} m: there is no room for it among "
            f"{self.context.num_drones} drones; lower it, or raise area"
        )

    def finish(self, spawn: Spawn, given: Given, rng: np.random.Generator) -> Spawn:
        """Put given places into a start; goals are the nearest opponents."""
        spawn = super().finish(spawn, given, rng)
        nearest = np.empty((1, len(spawn.position)), dtype=np.int64)
        everyone = np.ones(nearest.shape, dtype=bool)
        nearest_opponents(spawn.position[None], everyone, self.team, nearest)
        found = (nearest != NOBODY).T
        return spawn._replace(goal=np.where(found, spawn.position[nearest[0]], spawn.position))

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell the shapes of what is kept of each drone, all (N,).

        Returns:
            "lost_at" and "captured_at", time when it was lost, and captured, s, 0 before;
            "captures", how many evaders it captured; "closed", by how much the nearest chaser
            came nearer in the last decision, m.
        """
        drones = (self.context.num_drones,)
        return dict.fromkeys(("lost_at", "captured_at", "captures", "closed"), drones)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Note who was captured or lost, and set goals anew."""
        memory, flown = frame.scene.memory, frame.alive
        places = (frame.before.position, frame.after.position)
        least, closed = np.empty((2, *flown.shape))
        by = np.empty(flown.shape, dtype=np.int64)
        follow_chase(*places, flown, self.team, least, by, closed)
        memory["closed"][:] = closed
        harmless, touched = self._contacts(frame)
        if self.config.capture == "contact":
            captured = touched.any(axis=2)
            by = touched.argmax(axis=2)
        else:
            captured = least <= self.config.capture_radius
        captured = captured & flown & self._is_evader
        w, i = np.nonzero(captured)
        np.add.at(memory["captures"], (w, by[w, i]), 1.0)
        # Whoever crashes, leaves or runs empty is lost as well.
        lost = captured | (frame.collision & ~harmless) | frame.depleted
        if self.config.boundary == "end":
            lost |= self.outside(frame)
        now = np.broadcast_to(frame.time[:, None], flown.shape)
        np.copyto(memory["captured_at"], now, where=captured)
        np.copyto(memory["lost_at"], now, where=lost & flown)
        self._chase(frame, flown & ~lost)

    def _contacts(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Tell whose contacts were with opponents alone, (W, N), and with which, (W, N, N) bool."""
        touched = np.zeros((*frame.alive.shape, len(self.team)), dtype=bool)
        if not frame.collision.any():
            return touched[..., 0], touched
        world, drone, other, *_ = frame.contacts
        opposed = (other >= 0) & (self.team[drone] != self.team[other])
        touched[world[opposed], drone[opposed], other[opposed]] = True
        harmless = np.any(touched, axis=2)
        harmless[world[~opposed], drone[~opposed]] = False
        return harmless, touched

    def _chase(self, frame: Frame, present: np.ndarray) -> None:
        """Put goals where the nearest opponents of `present` (W, N) are; others stay."""
        scene, swarm = frame.scene, frame.after
        nearest = np.empty(present.shape, dtype=np.int64)
        nearest_opponents(swarm.position, present, self.team, nearest)
        found = (nearest != NOBODY)[..., None]
        for goal, own in ((scene.goal, swarm.position), (scene.goal_velocity, swarm.velocity)):
            np.copyto(goal, np.take_along_axis(own, nearest[..., None], axis=1), where=found)
        fill_paired_distances(scene.goal, swarm.position, frame.distance)
        fill_paired_distances(scene.goal, frame.known_position, frame.known_distance)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell who was lost in the decision, and where a team is gone; derive what terms read.

        Returns:
            (W, N) bool. `frame.derived` gets all of `events`.
        """
        memory, flown, evader = frame.scene.memory, frame.alive, self._is_evader
        # Lost in this decision, not in an earlier one
        now = frame.time[:, None]
        lost = flown & (memory["lost_at"] == now) & (now > 0)
        left = flown & ~lost
        # Chasers win when the last evader is gone; without chasers it is over
        won = evader.any() & ~np.any(left & evader, axis=1)
        gone = (~evader).any() & ~np.any(left & ~evader, axis=1)
        chasers, evaders = flown & ~evader, flown & evader
        # What reward terms and infos ask for by name
        frame.derived["lost"] = lost
        frame.derived["captured"] = lost & (memory["captured_at"] == now)
        frame.derived["won"] = np.broadcast_to(won[:, None], flown.shape) & left
        frame.derived["chasing"] = np.broadcast_to(~evader, flown.shape)
        frame.derived["capture_payoff"] = zero_sum(1.0 * lost, chasers, evaders)
        frame.derived["closing_payoff"] = zero_sum(memory["closed"], chasers, evaders)
        ended: np.ndarray = lost | (won | gone)[:, None]
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell which chasers fly when no evader does, and which evaders do at the end, (W, N)."""
        evader, lost = self._is_evader, frame.derived["lost"]
        chasers_left = np.any(frame.alive & ~lost & ~evader, axis=1)
        is_over = frame.last | ~chasers_left
        escaped = is_over[:, None] & frame.alive & ~lost & evader
        success: np.ndarray = escaped | (frame.derived["won"] & ~evader)
        return success

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell, beside the city's parameters, how the game stands, (W, N).

        Returns:
            The same for all drones of a world: "captured", the share of evaders captured, and
            "capture_time", the time until capture, s, mean of the evaders; for those that are not,
            that of the whole episode. Of each drone "captures", how many it captured.
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
