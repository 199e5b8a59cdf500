"""Task `pad_landing`: drones find landing pads by a clue and their cameras, and land on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, dot, minus, quat4, vec3
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.pads import PAD_RADIUS, PAD_THICKNESS, STABLE_TIME, PadMotion, Pads
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.waiting import decisions_waited
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

START_GAP = 0.12
"""Height at which drones start above their platforms, m"""
START_CLEARANCE = 1e-3
"""Height above their platforms of drones that take off from them, m"""
START_SPACING = 4.0
"""Distance between the start platforms, which are in a row from south to north, m"""
CELL = 1.5
"""Size of the grid cells of pads, by the minimum distance of pads"""
MAX_OFFSET = 5.0
"""Maximum offset of the pads from the middle of the row of starts, m"""
CLUE_HEIGHT_NOISE = 2.0
"""Maximum error of the height of the clue, m"""
TIME_MARGIN = 1.06
"""Time for a perfect score by the time of a straight flight at max_speed"""
SAFE_DISTANCE = 1.0
"""Separation from other drones for a perfect score, m"""
MARGIN, CEILING = 15.0, 12.0
"""Distance of the arena's bounds from starts and pads, m: to each side, and above"""
SCORE = {"success": 0.45, "time": 0.45, "safety": 0.10}
"""Weights of the score"""
GREY = (0.55, 0.57, 0.62, 1.0)
"""Colour of start platforms, RGBA"""


@dataclass(frozen=True)
class PadLandingConfig(TaskConfig):
    """Options of `pad_landing`, in addition to those of every task.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        extra_pads: Number of pads in addition to one for each drone.
        pad_spacing: Minimum distance between the centres of two pads, m.
        pad_height: Minimum and maximum height of the tops of pads, m.
        start_height: Minimum and maximum height of the tops of the start platforms, m.
        distance: Distance from the row of starts to the nearest place of a pad, m.
        clue_noise: Maximum error of the clue to the east and to the north, m; its height has up to
            2 m of error. Without noise, the clue is the mean of the places of the pads.
        pad_speed: Speed of the pads, which move together on circles, m/s. Drones that stop at
            contacts (contacts="stop", as in "point_mass") cannot land on pads faster than 0.6 m/s.
        pad_circle: Radius of these circles, m.
        pad_tilt: Amplitude by which pads rock, rad.
        pad_period: Period of the rocking, s.
    """

    d_safe: float = 0.4
    extra_pads: int = field(default=2, metadata={"least": 0, "most": 50})
    pad_spacing: float = field(default=4.0, metadata={"most": 100.0})
    pad_height: tuple[float, float] = (0.2, 3.0)
    start_height: tuple[float, float] = (0.2, 3.0)
    distance: float = field(default=12.0, metadata={"most": 500.0})
    clue_noise: float = field(default=3.0, metadata={"most": 100.0})
    pad_speed: float = field(default=0.0, metadata={"most": 10.0})
    pad_circle: float = field(default=4.0, metadata={"most": 100.0})
    pad_tilt: float = field(default=0.0, metadata={"most": 0.5})
    pad_period: float = field(default=4.0, metadata={"most": 1000.0})

    def idle_options(self, num_drones: int) -> Mapping[str, str]:
        """Return the sizes of motions that pads do not do; see `TaskConfig.idle_options`."""
        idle = {} if self.pad_speed else {"pad_circle": "pad_speed is 0"}
        return idle if self.pad_tilt else {**idle, "pad_period": "pad_tilt is 0"}


@end
def has_pad(has_pad: float) -> bool:
    """Return True if the drone has claimed a pad."""
    return has_pad > 0.0


@reward
def progress(progress: float) -> float:
    """Decrease of the distance to the nearest unclaimed pad, m."""
    return progress


@reward
def landing(landing: float, is_safe: bool) -> float:
    """1 on claiming a pad, without conflict or collision before."""
    return landing if is_safe else 0.0


@reward
def early(landing: float, is_safe: bool, time_factor: float) -> float:
    """On claiming a pad safely: 1 up to the target time, then linear to 0 at the horizon."""
    return landing * time_factor if is_safe else 0.0


@reward
def clear(landing: float, is_safe: bool, safety_factor: float) -> float:
    """On claiming a pad safely: 1 if no drone was within 1 m, linear to 0 at d_safe."""
    return landing * safety_factor if is_safe else 0.0


@reward
def touching(stable_growth: float, period: float) -> float:
    """1 in stable contact with an unclaimed pad, if the contact is the longest so far."""
    return stable_growth / period


@reward
def waiting(
    has_pad: float,
    collision: bool,
    outside: bool,
    depleted: bool,
    time: float,
    duration: float,
    period: float,
) -> float:
    """1 per decision until a pad is claimed; on other ends 1 per remaining decision, too."""
    is_lost = collision or outside or depleted
    return decisions_waited(has_pad > 0.0, is_lost, time, duration, period)


@register("task")
class PadLanding(Task[PadLandingConfig]):
    """Drones find landing pads by a common clue and their cameras, and each claims one by landing.

    Pads are discs with a radius of 0.6 m, at least 4 m apart, east of the drones. Any drone may
    claim any pad: by stable contact with its top for 0.5 s, with a vertical speed of at most 0.5
    m/s, a horizontal speed of at most 0.6 m/s, and roll and pitch of at most 0.26 rad, relative to
    the pad. Each pad can be claimed once. Drones start at rest 0.12 m above platforms in a row, and
    look east. All get the same clue, a noisy mean of the places of the pads. A drone that claimed a
    pad is taken away; the pad remains.

    Observation, Box(39) per drone with the defaults, as `vector`: attitude as a quaternion, body to
    world; velocity in world axes (east, north, up); rates in body axes; offset to the clue; range
    to the surface below; pads that other drones claimed, relative to the drone; the nearest active
    drones. Drones report claims by radio. And as `depth`: 128 x 128 depths, m, of a camera that
    looks 45 degrees below the nose, with a field of view of 90 degrees.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 3 m/s, facing east. There are 50 decisions a second.

    Reward per decision, the weighted sum of these terms; the drone's goal is the nearest unclaimed
    pad:

    - progress 0.2: decrease of the distance to the goal, m.
    - landing 45: 1 on claiming a pad, without conflict or collision before.
    - early 45: then 1 up to 1.06 times the time of a straight flight, linear to 0 at the horizon.
    - clear 10: then 1 if no other drone was within 1 m, linear to 0 at d_safe.
    - touching 0: 1 in stable contact with an unclaimed pad, if it is the longest so far.
    - waiting -0.01: 1 per decision until then; on other ends also 1 per remaining decision.
    - conflict -10: number of drones whose separation falls below d_safe = 0.4 m.
    - collision -10: 1 on contact, except landings on pads and platforms.
    - out_of_bounds -10: 1 outside the arena.

    End: terminated on claiming a pad, on contact with anything but pads and platforms, on hard
    contact or contact with their sides, or outside the arena. Truncated after 3000 decisions.

    Success: the drone claimed a pad, without conflict or collision in the episode.

    Infos: `score`, 0.45 success + 0.45 time + 0.10 safety as in `early` and `clear`; `stable_time`,
    time of stable contact, s.

    References:
        Scores, limits of the landing, pads and speed are those of the family swarm_autopilot of the
        Swarm subnet (github.com/swarm-subnet/swarm), on a fork of gym-pybullet-drones.
    """

    name = "pad_landing"
    baseline = "pad_seeker"
    oracle = "pad_pilot"
    shirkers: ClassVar = (
        "pad_ground",
        "pad_hover",
        "pad_same",
        "pad_drop",
        "pad_late",
        "pad_touch",
        "pad_blind",
    )
    turns_obstacles = True
    defaults: ClassVar = {
        "num_drones": 2,
        "airframe": "cf2x",
        "action": "velocity",
        "decision_hz": 50,
        "physics_hz": 250,
        "horizon": 3000,
        "max_speed": 3.0,
        "num_neighbours": 3,
        "camera_size": (128, 128),
        "camera_mounts": {"pitch": -45.0},
        "num_beams": 1,
        "lidar_elevations": (-90.0,),
        "max_range": 30.0,
    }
    difficulties: ClassVar = {
        "easy": {},
        "medium": {
            "num_drones": 4,
            "num_neighbours": 3,
            "extra_pads": 1,
            "pad_height": (0.2, 10.0),
            "start_height": (0.2, 10.0),
            "clue_noise": 6.0,
            "pad_speed": 0.5,
            "randomization": {"wind": (-0.5, 0.5)},
        },
        "hard": {
            "num_drones": 6,
            "num_neighbours": 5,
            "extra_pads": 1,
            "pad_height": (0.2, 10.0),
            "start_height": (0.2, 10.0),
            "clue_noise": 8.0,
            "pad_speed": 1.0,
            "pad_tilt": 0.1,
            "randomization": {"wind": (-1.0, 1.0)},
        },
        "extreme": {
            "num_drones": 8,
            "num_neighbours": 7,
            "extra_pads": 0,
            "pad_height": (0.2, 10.0),
            "start_height": (0.2, 10.0),
            "clue_noise": 10.0,
            "pad_speed": 2.0,
            "pad_tilt": 0.2,
            "randomization": {"wind": (-1.0, 1.0)},
        },
    }
    observation: ClassVar[tuple[Any, ...]] = (
        *("attitude", "velocity", "rates", "pad_clue", "lidar", "claimed_pads", "neighbours"),
        "depth",
    )
    reward: ClassVar = {
        "progress": (progress, 0.2),
        "landing": (landing, 45.0),
        "early": (early, 45.0),
        "clear": (clear, 10.0),
        "touching": (touching, 0.0),
        "waiting": (waiting, -0.01),
        "conflict": -10.0,
        "collision": -10.0,
        "out_of_bounds": -10.0,
    }
    # Paid for longer contact than before, drones learn the last centimetres
    training_weights: ClassVar[Mapping[str, float]] = {
        "progress": 0.2,
        "landing": 5.0,
        "early": 5.0,
        "clear": 0.0,
        "touching": 0.1,
        "waiting": -0.002,
        "conflict": -1.0,
        "collision": -2.0,
        "out_of_bounds": -2.0,
    }
    shows: ClassVar = {
        "success": "success",
        "score": "score",
        "goal_distance": "to pad (m)",
        "separation": "nearest (m)",
        "collision": "collisions",
    }
    ends = (collision, leaves_arena, has_pad)
    success = has_pad

    def __init__(self, config: PadLandingConfig, context: TaskContext) -> None:
        """Lay out starts and pads, and set the arena.

        Raises:
            ValueError: If pads or platforms could overlap, or a height, a motion or d_safe is out
                of bounds.
        """
        super().__init__(config, context)
        self._check(config)
        self.lands = True
        self.zone = max(SAFE_DISTANCE, config.d_safe)
        self.safety = self.add(Safety(context.num_drones))
        motion = PadMotion(config.pad_speed, config.pad_circle, config.pad_tilt, config.pad_period)
        count = context.num_drones + config.extra_pads
        self.pads = self.add(Pads(count, context.num_drones, context.period, motion))
        solids = count + context.num_drones
        self.landing_places = tuple(FIRST_OBSTACLE - k for k in range(solids))
        # Grid of places: a pad is in a cell, with an offset that keeps neighbours apart
        self._cells = int(np.ceil(np.sqrt(count)))
        self._cell = CELL * config.pad_spacing
        circle = config.pad_circle if config.pad_speed else 0.0
        self._west = config.distance + circle
        east = self._west + self._cells * self._cell + circle
        row = (context.num_drones - 1) * START_SPACING / 2
        field_side = self._cells * self._cell / 2 + MAX_OFFSET + circle
        half = max(row, field_side) + MARGIN
        top = max(config.pad_height[1], config.start_height[1]) + CEILING
        self.arena_low = np.array([-MARGIN, -half, 0.0])
        self.arena_high = np.array([east + MARGIN, half, top])
        self._standing = np.array(context.standing_height)

    def _check(self, config: PadLandingConfig) -> None:
        """Check options that depend on each other."""
        for name in ("pad_height", "start_height"):
            low, high = getattr(config, name)
            if not PAD_THICKNESS <= low <= high <= 100.0:
                raise ValueError(
                    f"{name} is {(low, high)}: from low to high, from {PAD_THICKNESS:g} m, the "
                    f"thickness, to 100 m, is needed"
                )
        clear_spacing = 2 * PAD_RADIUS + 2 * self.context.collision_radius
        if config.pad_spacing <= clear_spacing:
            raise ValueError(
                f"pad_spacing is {config.pad_spacing:g} m: more than {clear_spacing:.3g} m, two "
                f"radii of pads and drones, is needed"
            )
        if config.distance <= clear_spacing:
            raise ValueError(
                f"distance is {config.distance:g} m: more than {clear_spacing:.3g} m is needed "
                f"between start platforms and pads"
            )
        if config.pad_speed and not config.pad_circle:
            raise ValueError("pad_circle is 0 m: above 0 is needed if pads move; or pad_speed=0")
        if config.pad_tilt and not config.pad_period:
            raise ValueError("pad_period is 0 s: above 0 is needed if pads rock; or pad_tilt=0")
        if not config.d_safe < SAFE_DISTANCE:
            raise ValueError(
                f"d_safe is {config.d_safe:g} m: below {SAFE_DISTANCE:g} m, the distance of a "
                f"perfect score, is needed"
            )

    def on_ground(self, positions: np.ndarray) -> np.ndarray:
        """Return the positions of drones that stand on their platforms, below the starts."""
        standing: np.ndarray = positions - (0.0, 0.0, START_GAP - START_CLEARANCE)
        return standing

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the pads, then the start platforms."""
        platform = Obstacle("cylinder", (PAD_RADIUS, PAD_THICKNESS), GREY)
        return (*super().obstacles(), *(platform,) * self.context.num_drones)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of the parts and of the task.

        Returns:
            "clue" (3,), m; "target_time" (N,), time for a perfect score, s; "closest" (N,),
            smallest separation so far, at most `zone`, m; "progress" (N,), see `progress`; "aim"
            (N,), index of the nearest unclaimed pad; "longest_stable" (N,), longest time of stable
            contact so far, s; "stable_growth" (N,), its growth in the decision, s; "score" (N,).
        """
        drones = (self.context.num_drones,)
        names = ("target_time", "closest", "progress", "aim", "longest_stable", "stable_growth")
        own = dict.fromkeys((*names, "score"), drones)
        return {**super().memory(), "clue": (3,), **own}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of indices."""
        return {**super().memory_bounds(), "aim": (0, self.pads.count - 1)}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw platforms, pads and their motion, and the clue."""
        config, count = self.config, self.pads.count
        drones = self.context.num_drones
        platform = np.zeros((drones, 3))
        platform[:, 1] = START_SPACING * (np.arange(drones) - (drones - 1) / 2)
        platform[:, 2] = rng.uniform(*config.start_height, drones)
        # Places of pads: different cells of the grid, and an offset in each
        cell = rng.permutation(self._cells**2)[:count]
        offset = (self._cell - config.pad_spacing) / 2
        place = np.zeros((count, 3))
        place[:, 0] = self._west + self._cell * (cell % self._cells + 0.5)
        place[:, 1] = self._cell * (cell // self._cells + 0.5 - self._cells / 2)
        place[:, :2] += rng.uniform(-offset, offset, (count, 2))
        place[:, 1] += rng.uniform(-MAX_OFFSET, MAX_OFFSET)
        place[:, 2] = rng.uniform(*config.pad_height, count)
        noise = config.clue_noise, config.clue_noise, CLUE_HEIGHT_NOISE * (config.clue_noise > 0)
        clue = place.mean(axis=0) + rng.uniform(-1.0, 1.0, 3) * noise
        # Discs are below their tops
        down = np.array((0.0, 0.0, PAD_THICKNESS / 2))
        drawn = self.pads.draw(place - down, rng)
        world = {name: array[None] for name, array in drawn.items()}
        position, velocity, quaternion, spin = self.pads.poses(world, np.zeros(1))
        still = np.zeros((drones, 3))
        start = platform + (0.0, 0.0, START_GAP) + self._standing[:, None] * (0.0, 0.0, 1.0)
        separation = np.sqrt(((start[:, None] - position[0]) ** 2).sum(axis=-1))
        nearest = separation.min(axis=1)
        upright = np.tile((0.0, 0.0, 0.0, 1.0), (drones, 1))
        return Spawn(
            position=start,
            goal=start,
            obstacle=np.concatenate([position[0], platform - down]),
            obstacle_velocity=np.concatenate([velocity[0], still]),
            obstacle_quaternion=np.concatenate([quaternion[0], upright]),
            memory={
                **drawn,
                "pad_spin": spin[0],
                "clue": clue,
                "closest": np.full(drones, self.zone),
                "score": np.zeros(drones),
                "target_time": TIME_MARGIN * (nearest / self.context.max_speed) + STABLE_TIME,
            },
        )

    def start_memory(self, frame: Frame) -> None:
        """Set the goals to the nearest pads."""
        self._aim(frame)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the pads, and goals with them."""
        moved = super().move_scene(scene, time, flying, rngs)
        if moved:
            self._place_goals(scene)
        return moved

    def _place_goals(self, scene: Scene) -> None:
        """Set goals to the places where drones stand on the pads that they aim at."""
        place_goals(
            scene.memory["aim"],
            scene.obstacle,
            scene.obstacle_quaternion,
            scene.obstacle_velocity,
            self._standing,
            scene.goal,
            scene.goal_velocity,
        )

    def _aim(self, frame: Frame) -> None:
        """Set goals to the nearest unclaimed pads, and recompute the distances to them."""
        scene = frame.scene
        memory = scene.memory
        find_nearest_pads(
            frame.after.position,
            scene.obstacle,
            memory["claimed"],
            memory["has_pad"],
            memory["aim"],
        )
        self._place_goals(scene)
        fill_paired_distances(scene.goal, frame.after.position, frame.distance)
        fill_paired_distances(scene.goal, frame.known_position, frame.known_distance)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update landings, the progress, the smallest separations and the goals."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
        before = np.zeros(frame.alive.shape)
        # From the goal before the decision, so that progress sums up to the distance
        fill_paired_distances(frame.goal_before, frame.before.position, before)
        memory["progress"][:] = np.where(frame.alive, before - frame.distance, 0.0)
        closest = np.minimum(memory["closest"], frame.conflict.separation)
        memory["closest"][:] = np.where(frame.alive, closest, memory["closest"])
        longest = np.maximum(memory["longest_stable"], memory["stable_time"])
        memory["stable_growth"][:] = longest - memory["longest_stable"]
        memory["longest_stable"][:] = longest
        self._update_scores(frame)
        self._aim(frame)

    def _update_scores(self, frame: Frame) -> None:
        """Write the scores of drones that land in this decision."""
        assert self.safety is not None
        memory = frame.scene.memory
        done = (memory["landing"] > 0) & self.safety.is_safe(frame)
        score = SCORE["success"] + SCORE["time"] * self.time_factor(frame)
        score = score + SCORE["safety"] * self.safety_factor(frame)
        memory["score"][done] = score[done]

    def quantities(self) -> Mapping[str, Any]:
        """Return those of the parts, `time_factor` and `safety_factor`."""
        own = {"time_factor": self.time_factor, "safety_factor": self.safety_factor}
        return {**super().quantities(), **own}

    def time_factor(self, frame: Frame) -> np.ndarray:
        """Return 1 up to the target time, then linear to 0 at the horizon, (W, N)."""
        target, duration = frame.scene.memory["target_time"], self.context.duration
        left = duration - np.maximum(frame.time[:, None], target)
        factor: np.ndarray = np.maximum(left / np.maximum(duration - target, 1e-9), 0.0)
        return factor

    def safety_factor(self, frame: Frame) -> np.ndarray:
        """Return the factor of the smallest separation so far: 0 at d_safe, 1 at 1 m, (W, N)."""
        closest, least = frame.scene.memory["closest"], self.config.d_safe
        factor: np.ndarray = np.clip((closest - least) / (self.zone - least), 0.0, 1.0)
        return factor

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the scores in addition to the infos of the parts."""
        return {**super().info(frame), "score": frame.scene.memory["score"].copy()}


@kernel
def find_nearest_pads(
    position: np.ndarray,
    pad: np.ndarray,
    claimed: np.ndarray,
    has_pad: np.ndarray,
    aim: np.ndarray,
) -> None:
    """Write the index of the nearest unclaimed pad of each drone that has claimed none.

    Args:
        position: (W, N, 3) positions of drones, m.
        pad: (W, K, 3) positions of obstacles, of which the first P are pads, m.
        claimed: (W, P) above 0 for claimed pads.
        has_pad: (W, N) above 0 for drones that claimed a pad.
        aim: (W, N) indices, written.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            if has_pad[w, i] > 0.0:
                continue
            least = np.inf
            for p in range(claimed.shape[1]):
                if claimed[w, p] > 0.0:
                    continue
                between = minus(vec3(pad, w, p), vec3(position, w, i))
                square = dot(between, between)
                if square < least:
                    least = square
                    aim[w, i] = p


@kernel
def place_goals(
    aim: np.ndarray,
    pad: np.ndarray,
    quaternion: np.ndarray,
    velocity: np.ndarray,
    standing: np.ndarray,
    goal: np.ndarray,
    goal_velocity: np.ndarray,
) -> None:
    """Write the centres (W, N, 3) of drones that stand on the pads they aim at, and velocities.

    Args:
        aim: (W, N) indices of pads.
        pad: (W, K, 3) positions of pads, m.
        quaternion: (W, K, 4) attitudes of pads.
        velocity: (W, K, 3) velocities of pads, m/s.
        standing: (N,) heights of standing drones, m.
        goal: (W, N, 3) m, written.
        goal_velocity: (W, N, 3) m/s, written.
    """
    for w in range(aim.shape[0]):
        for i in range(aim.shape[1]):
            p = int(aim[w, i])
            _, _, up = axes(quat4(quaternion, w, p))
            for k in range(3):
                goal[w, i, k] = pad[w, p, k] + (0.5 * PAD_THICKNESS + standing[i]) * up[k]
                goal_velocity[w, i, k] = velocity[w, p, k]
