"""Task `landing_strip`: aircraft share the approach to a runway, and touch down one by one."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin, tan
from bulletuav.geometry.rotation import axes
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.airspace import clearance
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.forward_flight import DETOUR, TURN_MARGIN, kept_number, tightest_turn
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.waiting import decisions_waited
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.envelope import find_envelope

APPROACH_FACTOR = 1.5
"""Maximum ground speed at the touchdown in minimum speeds of the aircraft, which leaves room for
some tailwind"""
DOWN, SAFELY = 1.0, 2.0
"""Values of the memory "down": after any touchdown, and after one within all limits"""


@dataclass(frozen=True)
class LandingStripConfig(TaskConfig):
    """Options of `landing_strip`, in addition to those of every task.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        length: Length of the touchdown zone, from the threshold on, m.
        width: Width of the runway, m.
        glide_angle: Angle of the glide path, degrees.
        flare_height: Height of the lowest point of a standing drone above the runway at which the
            touchdown is decided, m.
        distance: Distance of the first start from the touchdown point, m.
        spacing: Distance between successive starts, m.
        spread: Maximum angle between the runway and the direction from a start to it, degrees.
        runway_time: Time for which a touchdown occupies the runway, s.
        touchdown_speed: Maximum horizontal speed at the touchdown, m/s.
        sink_rate: Maximum rate of descent at the touchdown, m/s.
        bank: Maximum angle of bank at the touchdown, degrees.
        course: Maximum angle between the motion and the runway at the touchdown, degrees.
    """

    d_safe: float = 5.0
    length: float = field(default=60.0, metadata={"most": 5000.0})
    width: float = field(default=12.0, metadata={"most": 200.0})
    glide_angle: float = field(default=4.0, metadata={"most": 20.0})
    flare_height: float = field(default=1.0, metadata={"most": 10.0})
    distance: float = field(default=250.0, metadata={"most": 1000.0})
    spacing: float = field(default=65.0, metadata={"most": 500.0})
    spread: float = field(default=20.0, metadata={"most": 45.0})
    runway_time: float = field(default=7.0, metadata={"most": 600.0})
    touchdown_speed: float = 14.0
    sink_rate: float = 1.5
    bank: float = field(default=15.0, metadata={"most": 90.0})
    course: float = field(default=10.0, metadata={"most": 90.0})


@end
def touched_down(down: float) -> bool:
    """Return True if the drone touched down, on the runway or elsewhere."""
    return down > 0.0


@end
def landed_safely(down: float) -> bool:
    """Return True if the drone touched down within all limits."""
    return down == SAFELY


@reward
def progress(distance_before: float, distance: float) -> float:
    """Decrease of the distance to the touchdown point, m."""
    return distance_before - distance


@reward
def landing(down: float, is_safe: bool) -> float:
    """1 at a touchdown within all limits, without conflict or collision before."""
    return 1.0 if down == SAFELY and is_safe else 0.0


@reward
def bad_landing(down: float) -> float:
    """1 at a touchdown beyond a limit."""
    return 1.0 if down == DOWN else 0.0


@reward
def waiting(
    down: float,
    collision: bool,
    outside: bool,
    depleted: bool,
    time: float,
    duration: float,
    period: float,
) -> float:
    """1 per decision until a safe touchdown; on other ends 1 per remaining decision, too."""
    is_lost = down == DOWN or collision or outside or depleted
    return decisions_waited(down == SAFELY, is_lost, time, duration, period)


@register("task")
class LandingStrip(Task[LandingStripConfig]):
    """Aircraft share the approach to a runway in crosswind, and touch down one by one.

    The runway leads east from its threshold at the origin, is 12 m wide, and has a touchdown zone
    of 60 m. Aircraft start in flight on the glide path of 4 degrees, 250 m before the touchdown
    point, the next ones 65 m behind each other, up to 20 degrees aside. The touchdown is decided
    when the lowest point of the drone falls to 1 m above the runway, where the flare begins; flare
    and roll-out are not part of the task, so that it is the same in all dynamics. The touchdown
    occupies the runway for 7 s. An aircraft that touched down is taken away.

    A touchdown is safe in the touchdown zone, on a free runway, with at most: 1.5 m/s of sink rate,
    15 degrees of bank, 10 degrees between the motion and the runway, and 1.5 times the airframe's
    minimum speed over ground.

    Observation, Box(36) per drone with the defaults, in world axes (east, north, up): position,
    velocity, attitude as a quaternion, direction and distance of the touchdown point, the time
    until the runway is free, and the nearest active drones.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - progress 0.05: decrease of the distance to the touchdown point, m.
    - landing 100: 1 at a safe touchdown, without conflict or collision before.
    - bad_landing -20: 1 at any other touchdown.
    - waiting -0.02: 1 per decision until a safe touchdown; on other ends also 1 per remaining
      decision.
    - conflict -50: number of drones whose separation falls below d_safe = 5 m.
    - collision -50: 1 on contact.
    - out_of_bounds -20: 1 outside the arena.

    End: terminated at a touchdown, on contact, when the battery is empty, or outside the arena.
    Truncated after 900 decisions, more with more aircraft.

    Success: a safe touchdown, without conflict or collision in the episode.

    Infos: `sink_rate`, m/s, `centreline`, the distance from it, m, and `touchdown`, the distance
    from the threshold, m, at the touchdown; 0 before.

    Difficulties: easy is calm with 2 aircraft. All others have 1 m/s of headwind; medium has 4
    aircraft and 2 m/s of crosswind from the south, hard 6 and 3.5 m/s, on 10 m of width, extreme 8
    and 5 m/s, 60 m apart, up to 30 degrees aside, on 8 m. Wind acts on `point_mass`, `rigid_body`
    and `bullet`.

    65 m at 9.6 m/s, slightly above the trainer's minimum speed, are 6.8 s, less than the 7 s for
    which the runway is occupied: with more aircraft, flying slowly is not enough of a delay, and
    turns are needed. The horizon is 1.5 times the time that all touchdowns need, or more.
    """

    name = "landing_strip"
    needs_hover = False
    has_absent = True
    baseline = "final_approach"
    oracle = "approach_oracle"
    shirkers: ClassVar = ("strip_low_pass", "strip_hold", "strip_rush", "strip_undershoot")
    defaults: ClassVar = {
        "airframe": "trainer",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 900,
        "max_speed": 20.0,
        "difficulty": "medium",
    }
    difficulties: ClassVar = {
        "easy": {"num_drones": 2},
        "medium": {"num_drones": 4, "wind": (-1.0, 2.0, 0.0)},
        "hard": {"num_drones": 6, "width": 10.0, "wind": (-1.0, 3.5, 0.0)},
        "extreme": {
            "num_drones": 8,
            "width": 8.0,
            "spacing": 60.0,
            "spread": 30.0,
            "wind": (-1.0, 5.0, 0.0),
        },
    }
    observation: ClassVar[tuple[str, ...]] = (
        "position",
        "velocity",
        "attitude",
        "goal",
        "runway",
        "neighbours",
    )
    reward: ClassVar = {
        "progress": (progress, 0.05),
        "landing": (landing, 100.0),
        "bad_landing": (bad_landing, -20.0),
        "waiting": (waiting, -0.02),
        "conflict": -50.0,
        "collision": -50.0,
        "out_of_bounds": -20.0,
    }
    # Touchdowns that cost much would teach drones to circle
    training_weights: ClassVar[Mapping[str, float]] = {
        "progress": 0.02,
        "landing": 5.0,
        "bad_landing": -0.2,
        "waiting": -0.002,
        "conflict": -2.0,
        "collision": -2.0,
        "out_of_bounds": -1.0,
    }
    ends = (collision, leaves_arena, touched_down)
    success = landed_safely

    def __init__(self, config: LandingStripConfig, context: TaskContext) -> None:
        """Set the touchdown point and the arena.

        Raises:
            ValueError: If a size is 0, or starts may be in conflict.
        """
        super().__init__(config, context)
        for name in ("length", "width", "glide_angle", "distance", "touchdown_speed", "sink_rate"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is 0: it must be above 0")
        clear = clearance(config, context)
        if context.num_drones > 1 and config.spacing / 2 <= clear:
            raise ValueError(
                f"starts may be in conflict: spacing {config.spacing:g} m must exceed "
                f"{2 * clear:.3g} m, twice d_safe or the drones' size"
            )
        self.safety = self.add(Safety(context.num_drones))
        self.slope = tan(math.radians(config.glide_angle))
        standing = np.array(context.standing_height)
        self.flare = standing + config.flare_height
        self.touchdown = np.zeros((context.num_drones, 3))
        self.touchdown[:, 0], self.touchdown[:, 2] = config.length / 2, self.flare
        farthest = config.distance + context.num_drones * config.spacing
        room = TURN_MARGIN * max(context.turn_radius, 10.0)
        half = farthest * sin(math.radians(config.spread)) + room
        self.arena_low = np.array([-farthest - room, -half, 0.0])
        top = farthest * self.slope + room
        self.arena_high = np.array([config.length + room, half, top])

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return touchdown speed, distance and horizon; see the base class."""
        slowest = max(find_envelope(one).min_speed for one in airframes)
        radius = tightest_turn(airframes)
        most = {one.name: one.metadata.get("most") for one in fields(LandingStripConfig)}
        sizes = {
            name: kept_number(values, name, getattr(LandingStripConfig, name), most[name])
            for name in ("distance", "spacing", "runway_time")
        }
        distance = max(sizes["distance"], 5 * TURN_MARGIN * radius)
        interval = max(sizes["spacing"] / slowest, sizes["runway_time"])
        duration = DETOUR * (distance / slowest + int(values["num_drones"]) * interval)
        return {
            "touchdown_speed": APPROACH_FACTOR * slowest,
            "distance": distance,
            "horizon": max(int(values["horizon"]), math.ceil(duration * values["decision_hz"])),
        }

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of the parts and of the task.

        Returns:
            "down" (N,), 0 in flight, DOWN or SAFELY after a touchdown; "runway_free" (1,), time at
            which the runway is free, s; "sink_rate", "centreline" and "touchdown" (N,), see the
            infos.
        """
        drones = (self.context.num_drones,)
        own = dict.fromkeys(("down", "sink_rate", "centreline", "touchdown"), drones)
        return {**super().memory(), **own, "runway_free": (1,)}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts on the glide path, one behind the other, in a random order of the drones."""
        config, drones = self.config, self.context.num_drones
        order = rng.permutation(drones)
        # Successive starts are half a spacing apart or more
        distance = config.distance + config.spacing * (order + rng.uniform(0.0, 0.5, drones))
        angle = np.radians(config.spread) * rng.uniform(-1.0, 1.0, drones)
        offset = np.zeros((drones, 3))
        offset[:, 0], offset[:, 1] = -distance * cos(angle), distance * sin(angle)
        offset[:, 2] = distance * self.slope
        heading = -atan2(offset[:, 1], -offset[:, 0])
        along = np.stack([cos(heading), sin(heading), np.zeros(drones)], axis=1)
        speed = min(self.config.touchdown_speed, self.context.max_speed)
        half = heading / 2
        turn = np.stack([np.zeros(drones), np.zeros(drones), sin(half), cos(half)], axis=1)
        return Spawn(
            position=self.touchdown + offset,
            goal=self.touchdown,
            velocity=speed * along,
            quaternion=turn,
            memory={"runway_free": np.zeros(1)},
        )

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Decide the touchdowns of the decision, in the order of the drones."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
        place = frame.after.position
        due = (place[..., 2] <= self.flare) & frame.alive & (memory["down"] == 0)
        for w, i in np.argwhere(due).tolist():
            is_free = frame.time[w] >= memory["runway_free"][w, 0]
            safe = is_free and self._is_within_limits(frame, w, i)
            memory["down"][w, i] = SAFELY if safe else DOWN
            memory["sink_rate"][w, i] = -frame.after.velocity[w, i, 2]
            memory["centreline"][w, i] = abs(place[w, i, 1])
            memory["touchdown"][w, i] = place[w, i, 0]
            if self._is_on_runway(place[w, i]):
                memory["runway_free"][w, 0] = frame.time[w] + self.config.runway_time

    def _is_on_runway(self, place: np.ndarray) -> bool:
        """Return True if a position (3,) is above the touchdown zone."""
        config = self.config
        return bool(0 <= place[0] <= config.length and abs(place[1]) <= config.width / 2)

    def _is_within_limits(self, frame: Frame, w: int, i: int) -> bool:
        """Return True if a touchdown is in the zone, and slow, level and aligned enough."""
        config = self.config
        vx, vy, vz = frame.after.velocity[w, i].tolist()
        _, left, _ = axes(tuple(frame.after.quaternion[w, i].tolist()))
        return (
            self._is_on_runway(frame.after.position[w, i])
            and math.sqrt(vx * vx + vy * vy) <= config.touchdown_speed
            and -vz <= config.sink_rate
            and abs(left[2]) <= sin(math.radians(config.bank))
            and abs(atan2(vy, vx)) <= math.radians(config.course)
        )

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the numbers of the touchdowns in addition to the infos of the parts."""
        memory = frame.scene.memory
        names = ("sink_rate", "centreline", "touchdown")
        return {**super().info(frame), **{name: memory[name].copy() for name in names}}
