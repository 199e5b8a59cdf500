"""Task `hover`: every drone reaches its own target and holds it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import exp_map, point
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, held, too_far
from bulletuav.tasks.frame import Spawn, TaskContext
from bulletuav.tasks.given import PLACES
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.draws import scale_to_range
from bulletuav.tasks.parts.holding import Holding
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.starts import check_start_distance

SQRT_3 = math.sqrt(3.0)


@dataclass(frozen=True)
class HoverConfig(TaskConfig):
    """Options of `hover`, in addition to those of every task.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        height: Height of the targets above ground, m.
        spacing: Distance between neighbouring targets of the square grid, m.
        start_offset: Maximum offset of a start from its target on each axis, m.
        start_speed: Maximum speed at the start, m/s.
        start_tilt: Maximum tilt at the start, about a random axis, degrees.
        start_rates: Maximum body rate at the start, rad/s.
        goal_radius: Distance from the target within which a drone is in place, m.
        min_in_place: Fraction of the episode that a drone has to be in place.
        max_distance: Distance from the target at which an episode ends, m.
        land: Whether targets are on the ground below. A drone then holds its target only by
            standing there, see `Frame.landed`.
    """

    d_safe: float = 1.0
    height: float = 2.0
    spacing: float = 2.0
    start_offset: float = 0.5
    start_speed: float = field(default=0.0, metadata={"most": 100.0})
    start_tilt: float = field(default=0.0, metadata={"most": 180.0})
    start_rates: float = field(default=0.0, metadata={"most": 100.0})
    goal_radius: float = 0.1
    min_in_place: float = 0.7
    max_distance: float = 20.0
    land: bool = False


@reward
def holding(distance: float, goal_radius: float, landed: bool, land: bool) -> float:
    """1 at the target; if the drone has to land, only on the ground."""
    return 1.0 if distance <= goal_radius and (landed or not land) else 0.0


@kernel
def _disturb(
    offset: np.ndarray,
    axis: np.ndarray,
    disturbed: np.ndarray,
    middle: np.ndarray,
    limits: tuple[float, float, float, float],
    position: np.ndarray,
    quaternion: np.ndarray,
    velocity: np.ndarray,
    rates: np.ndarray,
) -> None:
    """Write the disturbed starts of N drones in W worlds.

    Args:
        offset: (W, N, 3) random offsets from the nominal positions, from 0 to 1.
        axis: (W, N, 3) axes of the tilts, of any length.
        disturbed: (W, 7 N) random tilts, velocities and body rates, from 0 to 1.
        middle: (N, 3) nominal positions, m.
        limits: Maximum offset on each axis (m), tilt (rad), speed (m/s) and body rate (rad/s).
        position: (W, N, 3) output, m.
        quaternion: (W, N, 4) output.
        velocity: (W, N, 3) output, m/s.
        rates: (W, N, 3) output, rad/s.
    """
    far, tilt, speed, rate = limits
    drones = middle.shape[0]
    for w in range(offset.shape[0]):
        for i in range(drones):
            x, y, z = point(axis[w], i)
            length = math.sqrt(x * x + y * y + z * z)
            angle = tilt * disturbed[w, i]
            turned = exp_map((angle * (x / length), angle * (y / length), angle * (z / length)))
            for k in range(4):
                quaternion[w, i, k] = turned[k]
            # Components are limited to the maximum over sqrt(3), so that norms stay below it
            for k in range(3):
                position[w, i, k] = middle[i, k] + scale_to_range(offset[w, i, k], -far, far)
                moving = disturbed[w, drones + 3 * i + k]
                spinning = disturbed[w, 4 * drones + 3 * i + k]
                velocity[w, i, k] = scale_to_range(moving, -1.0, 1.0) / SQRT_3 * speed
                rates[w, i, k] = scale_to_range(spinning, -1.0, 1.0) / SQRT_3 * rate


@register("task")
class Hover(Task[HoverConfig]):
    """Each drone flies to its own target and holds it.

    By default targets are on a square grid with a spacing of 2 m, at a height of 2 m. Drones start
    near their targets.

    Observation, Box(13) per drone with the defaults: attitude as a quaternion, body to world;
    offset from the drone to its target and velocity in world axes (east, north, up); rates in body
    axes (forward, left, up).

    Action, by default `rotor`, Box(4) per drone in [-1, 1]: thrust of each rotor, from -1 for none
    to 1 for the maximum. Dynamics without rotors use the highest level of action that they accept,
    such as `velocity` in `point_mass`. There are 30 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - alive 1: 1 per decision.
    - holding 1: 1 within 0.1 m of the target; with `land` only if the drone stands on the ground.
    - distance -0.1: distance to the target, m.
    - speed -0.05: speed, m/s.

    End: terminated on any contact of collision shapes, or farther than 20 m from the target.
    Truncated after 240 decisions.

    Success: the drone was within 0.1 m of its target for 70 % of the episode (medium 65 %, hard and
    extreme 60 %), without conflict or collision; with `land` it also stood on the ground. Drones
    need up to a third of the episode to reach their targets.

    Infos: `in_place` is the fraction of the time for which the drone was there.

    Preset hover_aviary: cf2x, 240 Hz physics, 30 Hz decisions, 240 decisions and action
    `hover_rpm`, as in gym-pybullet-drones.
    """

    version = 2
    name = "hover"
    shirkers: ClassVar = ("hover_beside", "hover_late", "hover_half", "hover_passing")
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
            "min_in_place": 0.65,
            "height": 3.0,
            "spacing": 4.0,
            "start_offset": 1.0,
            "start_speed": 1.0,
            "start_tilt": 20.0,
        },
        "hard": {
            "min_in_place": 0.6,
            "height": 5.0,
            "spacing": 5.0,
            "start_offset": 1.5,
            "start_speed": 2.0,
            "start_tilt": 60.0,
            "start_rates": 3.0,
        },
        "extreme": {
            "min_in_place": 0.6,
            "height": 15.0,
            "spacing": 5.0,
            "start_offset": 1.5,
            "start_speed": 4.0,
            "start_tilt": 180.0,
            "start_rates": 6.0,
        },
    }
    presets: ClassVar = {
        # Frequencies, horizon and action of HoverAviary in gym-pybullet-drones, to compare
        # speed and learning
        "hover_aviary": {
            "airframe": "cf2x",
            "physics_hz": 240,
            "decision_hz": 30,
            "horizon": 240,
            "action": "hover_rpm",
        }
    }
    observation = ("attitude", "goal_offset", "velocity", "rates")
    reward: ClassVar = {"alive": 1.0, "holding": (holding, 1.0), "distance": -0.1, "speed": -0.05}
    # Beyond 1.3 m a decision costs, and closer by a centimetre pays as much at any distance
    training_weights: ClassVar[Mapping[str, float]] = {
        "alive": 0.2,
        "holding": 0.1,
        "distance": -0.15,
        "speed": -0.02,
    }
    places: ClassVar[tuple[str, ...]] = PLACES
    shows: ClassVar = {
        "success": "success",
        "in_place": "at target",
        "collision": "collisions",
        "goal_distance": "to target (m)",
    }
    ends = (collision, too_far)
    success = held

    def __init__(self, config: HoverConfig, context: TaskContext) -> None:
        """Place the targets, set the arena, and check the starts.

        Raises:
            ValueError: If starts could overlap each other or the ground.
        """
        super().__init__(config, context)
        self.safety = self.add(Safety(context.num_drones))
        self.add(Holding(config.min_in_place, context, config.goal_radius, config.land))
        if config.land and config.take_off:
            raise ValueError(
                "land and take_off are both on: choose one, as drones would start at their targets"
            )
        rise = config.height if config.land or config.take_off else 0.0
        check_start_distance(config.max_distance, config.start_offset, rise)
        # Targets on a square grid around the origin
        columns = int(np.ceil(np.sqrt(context.num_drones)))
        index = np.arange(context.num_drones)
        grid = np.stack([index % columns, index // columns], axis=1) * config.spacing
        height = np.full((len(index), 1), config.height)
        self.lands |= config.land
        self._middle = np.concatenate([grid - grid.mean(axis=0), height], axis=1)
        self.target = self.on_ground(self._middle) if config.land else self._middle
        self.arena_low = self.target.min(axis=0) - config.max_distance
        self.arena_high = self.target.max(axis=0) + config.max_distance
        self.arena_low[2] = 0.0
        if config.start is None:
            self._check_start()

    def _check_start(self) -> None:
        """Check that drawn starts cannot overlap or touch the ground."""
        config = self.config
        radius = self.context.collision_radius
        gap = config.spacing - 2 * config.start_offset
        if len(self.target) > 1 and gap <= 2 * radius:
            raise ValueError(
                f"start positions may overlap: spacing {config.spacing:g} m less twice "
                f"start_offset {config.start_offset:g} m must exceed {2 * radius:.3g} m"
            )
        lowest = config.height - config.start_offset
        if lowest <= radius and not config.take_off:
            raise ValueError(
                f"start positions may touch the ground: the lowest is {lowest:g} m up, "
                f"more than {radius:.3g} needed; raise height, or lower start_offset"
            )

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts near the targets, disturbed according to the difficulty."""
        return self._draw([rng])[0]

    def spawn_many(self, rngs: Rngs) -> Sequence[Spawn]:
        """Draw the starts of several worlds; by `spawn` if a subclass overrides it."""
        is_own = getattr(self.spawn, "__func__", None) is not Hover.spawn
        return super().spawn_many(rngs) if is_own else self._draw(rngs)

    def _draw(self, rngs: Rngs) -> list[Spawn]:
        """Draw starts, each from its own generator, and compute the poses of all of them together.

        Draws are in this order: offsets, axes of tilts, tilts, velocities, rates.
        """
        config = self.config
        drones, shape = len(self.target), (len(rngs), *self.target.shape)
        offset, axis = np.empty((2, *shape))
        disturbed = np.empty((len(rngs), 7 * drones))
        for rng, *rows in zip(rngs, offset, axis, disturbed, strict=True):
            rng.random(out=rows[0])
            rng.standard_normal(out=rows[1])
            rng.random(out=rows[2])
        limits = (
            float(config.start_offset),
            math.radians(config.start_tilt),
            float(config.start_speed),
            float(config.start_rates),
        )
        position, velocity, rates, goal = np.empty((4, *shape))
        quaternion = np.empty((*shape[:2], 4))
        starts = (position, quaternion, velocity, rates)
        _disturb(offset, axis, disturbed, self._middle, limits, *starts)
        goal[:] = self.target
        parts = zip(position, goal, velocity, quaternion, rates, strict=True)
        return [
            Spawn(position=one, goal=two, velocity=three, quaternion=four, rates=five)
            for one, two, three, four, five in parts
        ]
