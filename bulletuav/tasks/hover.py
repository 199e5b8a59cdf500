"""Task `hover`: every drone reaches its own target and holds it."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.rotation import exponential
from bulletuav.registry import register
from bulletuav.tasks.base import Task, TaskConfig, refuse_early_end
from bulletuav.tasks.check import refuse_overlap
from bulletuav.tasks.ends import at_goal, collision, too_far
from bulletuav.tasks.frame import Spawn, TaskContext


@dataclass(frozen=True)
class HoverConfig(TaskConfig):
    """Options of `hover`, m, m/s, degrees, rad/s.

    Targets stand `spacing` apart on a square grid at `height`. A drone starts within `start_offset` of its target on each
    axis, with a velocity, a tilt about a random axis and body rates up to those given; `start` (N, 3) fixes the positions.
    """

    d_safe: float = 1.0
    height: float = 2.0
    spacing: float = 2.0
    start_offset: float = 0.5
    start_speed: float = field(default=0.0, metadata={"most": 100.0})
    start_tilt: float = field(default=0.0, metadata={"most": 180.0})
    start_rates: float = field(default=0.0, metadata={"most": 100.0})
    start: tuple[tuple[float, float, float], ...] | None = None
    goal_radius: float = 0.1
    max_distance: float = 20.0


def _positions(start: object, count: int) -> np.ndarray:
    """(N, 3) m. Raises ValueError for anything but so many finite positions."""
    try:
        positions = numbers_of("start is", start)
    except ValueError:
        positions = np.empty(0)
    if positions.shape != (count, 3) or not np.isfinite(positions).all():
        raise ValueError(
            f"start is {shown(start)}: {count} finite positions (x, y, z) in metres are needed"
        )
    return positions


@register("task")
class Hover(Task[HoverConfig]):
    """Reach a target and hold it, each drone its own.

    Observation, per drone, Box(13) with the defaults; `bulletuav tasks hover` lists each number:
    Quaternion body to world; goal offset from the drone to its target and velocity in world axes (east, north, up); rates in
    body axes (forward, left, up).

    Action, per drone, by default `rotor`, Box(4) in [-1, 1]: thrust of each rotor, -1 none, 1 the most;
    30 decisions a second.

    Reward, per decision: alive 1, distance -0.1 a metre to the target, speed -0.05 per m/s (weights by name).

    End: terminated on any contact of collision shapes or further than 20 m from the target; truncated after 240 decisions.
    Success: within 0.1 m of the target.

    Difficulty, start within / speed / tilt / rates / height: easy 0.5 m, at rest, 2 m; medium 1 m, 1 m/s, 20 degrees, 3 m;
    hard 1.5 m, 2 m/s, 60 degrees, 3 rad/s, 5 m; extreme 1.5 m, 4 m/s, 180 degrees, 6 rad/s, 15 m.

    Preset hover_aviary: cf2x, 240 Hz physics, 30 Hz decisions, 240 decisions, action `hover_rpm`, as in gym-pybullet-drones.
    """

    name = "hover"
    defaults: ClassVar = {
        "num_drones": 1,
        "airframe": "cf2x",
        "action": "rotor",
        "decision_hz": 30,
        "horizon": 240,
        "max_speed": 5.0,
    }
    difficulties: ClassVar = {
        "easy": {},
        "medium": {
            "height": 3.0,
            "spacing": 4.0,
            "start_offset": 1.0,
            "start_speed": 1.0,
            "start_tilt": 20.0,
        },
        "hard": {
            "height": 5.0,
            "spacing": 5.0,
            "start_offset": 1.5,
            "start_speed": 2.0,
            "start_tilt": 60.0,
            "start_rates": 3.0,
        },
        "extreme": {
            "height": 15.0,
            "spacing": 5.0,
            "start_offset": 1.5,
            "start_speed": 4.0,
            "start_tilt": 180.0,
            "start_rates": 6.0,
        },
    }
    presets: ClassVar = {
        # frequencies, horizon and action of gym-pybullet-drones' HoverAviary, to compare speed and learning with it
        "hover_aviary": {
            "airframe": "cf2x",
            "physics_hz": 240,
            "decision_hz": 30,
            "horizon": 240,
            "action": "hover_rpm",
        }
    }
    observation = ("attitude", "goal_offset", "velocity", "rates")
    reward: ClassVar = {"alive": 1.0, "distance": -0.1, "speed": -0.05}
    ends = (collision, too_far)
    success = at_goal

    def __init__(self, config: HoverConfig, context: TaskContext):
        """Raises ValueError where start positions could overlap each other or the ground."""
        super().__init__(config, context)
        refuse_early_end(config.max_distance, config.start_offset)
        columns = int(np.ceil(np.sqrt(context.num_drones)))
        index = np.arange(context.num_drones)
        grid = np.stack([index % columns, index // columns], axis=1) * config.spacing
        self.target = np.concatenate(
            [grid - grid.mean(axis=0), np.full((len(index), 1), config.height)], axis=1
        )
        self.arena_low = self.target.min(axis=0) - config.max_distance
        self.arena_high = self.target.max(axis=0) + config.max_distance
        self.arena_low[2] = 0.0
        self._check_start()

    def _check_start(self) -> None:
        config, radius = self.config, self.context.collision_radius
        if config.start is not None:
            start = _positions(config.start, len(self.target))
            if ((start < self.arena_low) | (start > self.arena_high)).any():
                raise ValueError(
                    f"start is {shown(config.start)}: positions inside the arena are needed"
                )
            refuse_overlap(start, radius)
            lowest = start[:, 2].min()
        else:
            if len(self.target) > 1 and config.spacing - 2 * config.start_offset <= 2 * radius:
                raise ValueError(
                    f"start positions may overlap: spacing {config.spacing:g} m less twice start_offset "
                    f"{config.start_offset:g} m must exceed {2 * radius:.3g} m"
                )
            lowest = config.height - config.start_offset
        if lowest <= radius:
            raise ValueError(
                f"start positions may touch the ground: the lowest is {lowest:g} m up, more than {radius:.3g} needed; raise "
                f"{'start' if config.start is not None else 'height, or lower start_offset'}"
            )

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Near the targets, disturbed as much as the difficulty says."""
        config, shape = self.config, self.target.shape
        offset = rng.uniform(-config.start_offset, config.start_offset, shape)
        position = (
            self.target + offset if config.start is None else np.asarray(config.start, dtype=float)
        )
        axis = rng.normal(size=shape)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.radians(config.start_tilt) * rng.uniform(0, 1, (len(axis), 1))
        quaternion = np.array([exponential(turn) for turn in angle * axis])
        velocity = rng.uniform(-1, 1, shape) / np.sqrt(3) * config.start_speed
        rates = rng.uniform(-1, 1, shape) / np.sqrt(3) * config.start_rates
        return Spawn(
            position=position,
            goal=self.target.copy(),
            velocity=velocity,
            quaternion=quaternion,
            rates=rates,
        )
