"""Task `interception`: drones find an evader that flees over terrain, and touch it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.rotation import Vec3, dot, minus, vec3
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.city_layouts import MAX_TRIES, CityOptions, add_city
from bulletuav.tasks.parts.fleeing_evader import BODY, EvaderOptions, FleeingEvader
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.target_track import TargetTrack
from bulletuav.vehicle.swarm import FIRST_OBSTACLE


@dataclass(frozen=True)
class InterceptionConfig(EvaderOptions, CityOptions, TaskConfig):
    """Options of `interception`, in addition to those of evaders and cities (`CityOptions`).

    Attributes:
        distance: Minimum and maximum distance between a drone and the evader at the start, m.
        capture_gap: Maximum gap between a drone's bounding sphere and the evader's body at which
            the evader is captured, m.
        clue_error: Maximum distance between the evader and the place at which drones suppose it at
            the start, m.
        city: Terrain of the arena, as in all tasks in cities.
        area: Side of the arena's square, or its lengths along x and y, m.
        num_layouts: Number of terrains that are generated; each world has one of them per episode.
        height: Minimum and maximum height of starts above the ground, m.
        ceiling: Maximum height of the airspace above the highest ground, m.
        min_separation: Minimum distance between starts, m.
    """

    distance: tuple[float, float] = (60.0, 100.0)
    capture_gap: float = 0.15
    clue_error: float = 10.0
    city: Any = "hills"
    area: float | tuple[float, float] = 200.0
    num_layouts: int = field(default=4, metadata={"most": 256})
    height: tuple[float, float] = (5.0, 15.0)
    ceiling: float = 40.0
    min_separation: float = 5.0


@end
def evader_captured(is_captured: bool) -> bool:
    """Return True if a drone of the world has captured the evader."""
    return is_captured


@reward
def capture(is_captured: bool, is_safe: bool) -> float:
    """1 for each safe drone in the decision in which a drone of its world captures the evader."""
    return 1.0 if is_captured and is_safe else 0.0


@reward
def closing(goal_before: Vec3, position_before: Vec3, distance: float) -> float:
    """Decrease of the distance to the evader in the decision, m."""
    before = minus(goal_before, position_before)
    return math.sqrt(dot(before, before)) - distance


@reward
def time(
    is_captured: bool,
    collision: bool,
    outside: bool,
    time: float,
    duration: float,
    period: float,
) -> float:
    """1 per decision until capture; if a drone's episode ends before, also 1 per remaining one."""
    if is_captured:
        return 0.0
    return 1.0 + ((duration - time) / period if collision or outside else 0.0)


@register("task")
class Interception(Task[InterceptionConfig]):
    """Drones find an evader that flees over hills or forests, and touch it.

    The evader, a body of radius 0.3 m, starts 60 to 100 m away and flees from the nearest drone at
    about half of its speed, 4 to 8 m above the terrain, in an arena of 200 m x 200 m. Drones start
    at rest, 5 to 15 m above the ground, and know where the evader is within 10 m. Then they know it
    only by their detectors, which see up to 100 m in all directions, but not through hills and
    trees. Drones of a world share their detections. Goals are the evader's true position.

    Observation, Box(44) per drone with the defaults, in world axes (east, north, up): position,
    velocity, the track of the evader (1 if it is detected now, its estimated offset and velocity,
    and the time since the last detection), distances to the sides of the arena, 24 ranges of the
    range finder, in eight directions at elevations of -45, 0 and 45 degrees, and the other drones.
    Pictures, such as `depth`, show the evader, too.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 6 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - capture 50: 1 for each safe drone when a drone of its world captures the evader.
    - closing 0.2: decrease of the distance to the evader, m.
    - conflict -10: number of drones whose separation falls below d_safe = 1 m.
    - collision -20: 1 on a contact other than with the evader.
    - out_of_bounds -20: 1 outside the arena.
    - time -0.05: 1 per decision until capture. If the drone's episode terminates before, it also
      gets 1 per remaining decision.

    End: terminated for all drones on capture, which is a contact with the evader or a gap of at
    most 0.15 m to it; on any other contact, and outside the arena. Truncated after 600 decisions.

    Success: the evader is captured while the drone flies, without conflict or collision.

    Infos: `captured` is 1 if the evader is captured, and `capture_time` the time until then, s, or
    the length of the episode.
    """

    name = "interception"
    defaults: ClassVar = {
        "num_drones": 1,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 600,
        "max_speed": 6.0,
        "num_beams": 8,
        "lidar_elevations": (-45.0, 0.0, 45.0),
        "difficulty": "medium",
    }
    difficulties: ClassVar = {
        "easy": {
            "city": {"kind": "hills", "relief": 10.0},
            "distance": (60.0, 80.0),
            "evader_speed": 2.0,
            "evader_weave": 0.1,
        },
        "medium": {},
        "hard": {
            "city": {"kind": "wooded_hills", "relief": 25.0, "tree_density": 40.0},
            "evader_speed": 4.2,
            "evader_weave": 0.6,
            "randomization": {
                "detector_range": 70.0,
                "detector_noise": 0.02,
                "detector_dropout": 0.2,
                "wind": (-2.0, 2.0),
            },
        },
        "extreme": {
            "num_drones": 2,
            "city": {"kind": "wooded_hills", "relief": 30.0, "tree_density": 80.0},
            "distance": (80.0, 100.0),
            "evader_speed": 4.5,
            "evader_weave": 0.9,
            "evader_acceleration": 5.0,
            "turbulence": "light",
            "randomization": {
                "detector_range": 60.0,
                "detector_noise": 0.03,
                "detector_dropout": 0.3,
                "wind": (-2.0, 2.0),
            },
        },
    }
    observation = ("position", "velocity", "target_track", "room", "lidar", "all_neighbours")
    required_sensors = ("detection",)
    reward: ClassVar = {
        "capture": (capture, 50.0),
        "closing": (closing, 0.2),
        "conflict": -10.0,
        "collision": -20.0,
        "out_of_bounds": -20.0,
        "time": (time, -0.05),
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        "capture": 5.0,
        "closing": 0.1,
        "conflict": -1.0,
        "collision": -2.0,
        "out_of_bounds": -2.0,
        "time": -0.005,
    }
    ends = (evader_captured, collision, leaves_arena)
    success = evader_captured
    baseline = "interceptor"
    oracle = "interception_oracle"
    shirkers: ClassVar = ("intercept_shadow", "intercept_blind", "intercept_ram")
    shows: ClassVar = {
        "success": "success",
        "captured": "captured",
        "capture_time": "until capture (s)",
        "goal_distance": "to evader (m)",
        "collision": "collisions",
    }

    def __init__(self, config: InterceptionConfig, context: TaskContext) -> None:
        """Create terrain and evader, and check the options.

        Raises:
            ValueError: If options contradict each other.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.city_layouts = add_city(self)
        self.evader = self.add(FleeingEvader(self, self.city_layouts))
        self.track = self.add(TargetTrack(context))
        self.safety = self.add(Safety(context.num_drones))
        if self.evader.highest >= self.arena_high[2]:
            raise ValueError(
                f"ceiling is {config.ceiling:g} m: more than "
                f"{config.ceiling + self.evader.highest - self.arena_high[2]:.4g} m is needed, "
                f"where the evader flies; or lower evader_height"
            )
        low, high = config.distance
        nearest = BODY.radius + context.collision_radius + config.capture_gap
        if not nearest < low <= high:
            raise ValueError(
                f"distance is {config.distance}: from low to high, more than {nearest:.3g} m, "
                f"where the evader is captured, is needed; raise it, or lower capture_gap"
            )
        self._reach = nearest

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw an evader, and starts at rest at some distance from it.

        Raises:
            ValueError: If there is no space for so many drones, or at that distance.
        """
        config, layout = self.config, self.city_layouts.draw(rng)
        drones = self.context.num_drones
        low, high = config.distance
        for _ in range(MAX_TRIES):
            height = self.evader.draw_height(rng)
            plan = self.city_layouts.outdoors(rng, layout, 1)
            (evader,) = self.evader.place(np.array([layout]), plan, np.array([height]))
            place = np.empty((0, 3))
            for _ in range(MAX_TRIES):
                one = self.city_layouts.places(rng, layout, 1)
                gaps = np.linalg.norm(place - one, axis=1)
                is_apart = gaps.min(initial=np.inf) >= config.min_separation
                if is_apart and low <= np.linalg.norm(one - evader) <= high:
                    place = np.concatenate([place, one])
                if len(place) == drones:
                    break
            else:
                continue
            break
        else:
            raise ValueError(
                f"distance is {config.distance}: there is no room for {drones} drones so far from "
                f"an evader; lower it or min_separation, or raise area"
            )
        direction = rng.normal(size=3)
        # The maximum of three uniform numbers is distributed as the radius of points in a ball
        radius = config.clue_error * rng.uniform(size=3).max()
        clue = evader + radius * direction / np.linalg.norm(direction)
        threat = place[np.linalg.norm(place - evader, axis=1).argmin()]
        return Spawn(
            position=place,
            goal=evader,
            obstacle=evader[None],
            obstacle_velocity=np.zeros((1, 3)),
            layout=layout,
            memory={
                **self.track.start(clue, config.clue_error / np.sqrt(5)),
                "threat": threat,
                "course": np.array(rng.uniform(-np.pi, np.pi)),
                "evader_height": np.array(height),
            },
        )

    def targets(self, scene: Scene) -> np.ndarray:
        """Return the evader's position, (W, 1, 3) m."""
        return scene.obstacle

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of "captured_at" (), time of the capture, s, and of the parts."""
        return {**super().memory(), "captured_at": ()}

    def start_memory(self, frame: Frame) -> None:
        """Start the tracks with the first detections."""
        self.track.first_update(frame)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Record captures; contacts with the evader alone are no collisions."""
        shape = frame.alive.shape
        touched = np.zeros(shape, dtype=bool)
        crashed = np.zeros(shape, dtype=bool)
        if frame.collision.any():
            world, drone, other, *_ = frame.contacts
            is_evader = other == FIRST_OBSTACLE
            touched[world[is_evader], drone[is_evader]] = True
            crashed[world[~is_evader], drone[~is_evader]] = True
            frame.collision[touched & ~crashed] = False
        gap = np.empty(shape)
        positions = frame.before.position, frame.after.position
        fill_closest(frame.goal_before, frame.scene.goal, *positions, gap)
        captors = frame.alive & ~crashed & (touched | (gap <= self._reach))
        captured = captors.any(axis=1)
        np.copyto(frame.scene.memory["captured_at"], frame.time, where=captured)
        super().update_memory(frame, rngs)

    def quantities(self) -> Mapping[str, Any]:
        """Return "is_captured", and the quantities of the parts."""
        return {**super().quantities(), "is_captured": self.is_captured}

    def is_captured(self, frame: Frame) -> np.ndarray:
        """Return whether the evader is captured, (W, N) bool, the same for a world."""
        captured = frame.scene.memory["captured_at"] > 0
        return np.broadcast_to(captured[:, None], frame.alive.shape).copy()

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return "captured" and "capture_time", s, (W, N), and the infos of the parts."""
        at = frame.scene.memory["captured_at"]
        spent = np.where(at > 0, at, self.context.duration)
        shape = frame.alive.shape
        return {
            **super().info(frame),
            "captured": np.broadcast_to(1.0 * (at > 0)[:, None], shape),
            "capture_time": np.broadcast_to(spent[:, None], shape),
        }


@kernel
def fill_closest(
    goal_before: np.ndarray,
    goal: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    distance: np.ndarray,
) -> None:
    """Write the minimum distances between drones and goals that move straight in a decision.

    Args:
        goal_before: (W, N, 3) goals before the decision, m.
        goal: (W, N, 3) goals after it, m.
        before: (W, N, 3) positions of drones before the decision, m.
        after: (W, N, 3) positions after it, m.
        distance: (W, N) minimum distances, m, written.
    """
    for w in range(distance.shape[0]):
        for i in range(distance.shape[1]):
            start = minus(vec3(goal_before, w, i), vec3(before, w, i))
            last = minus(vec3(goal, w, i), vec3(after, w, i))
            _, square = closest_squared_distances(start, last)
            distance[w, i] = math.sqrt(square)
