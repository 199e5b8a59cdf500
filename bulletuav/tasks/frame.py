"""What a task works on: starts, scenes, decisions, and what it makes of them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from bulletuav.conflict.separation import Conflict, measure_conflict
from bulletuav.errors import unknown
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.sensors.lidar import Beam
from bulletuav.vehicle.swarm import Contacts, Swarm

NO_OBSTACLES = np.zeros((0, 3))
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
RESTING_SPEED = 0.01
"""m/s, of a drone at rest at most: far above what contacts leave over, far below any flight"""
RESTING_SPIN = 0.1
"""rad/s, of a drone at rest at most; a rim at 0.1 m from the middle then moves at 0.01 m/s"""

TOUCHDOWN_SPEED = 2.0
"""m/s against the ground, of a landing at most; a fall from 0.2 m ends with it"""
TOUCHDOWN_UPRIGHT = np.sqrt(0.75)
"""Cosine of the tilt of a landing at least, before and after the decision: 30 degrees"""
STANDING_GAP = 0.001
"""m, above the ground at most, of kinematic drones that stand there without a touch"""


NOTHING: Mapping[str, np.ndarray] = MappingProxyType({})
"""Memory of a start that gives none"""


class Spawn(NamedTuple):
    """Start of one world of N drones. Only position and goal are needed.

    Attributes:
        position: (N, 3) m.
        goal: (N, 3) m, or one (3,) for all.
        velocity: (N, 3) m/s, or one number or (3,) for all.
        quaternion: (N, 4) body to world (x, y, z, w), or one (4,) for all; level, nose to the east.
        rates: (N, 3) rad/s, body axes, or one number or (3,) for all.
        goal_velocity: (N, 3) m/s, or one number or (3,) for all.
        obstacle: (K, 3) position of the task's obstacles, m.
        obstacle_velocity: (K, 3) m/s.
        obstacle_quaternion: (K, 4) body to world, or one (4,) for all.
        layout: Index of the city that stands in the world, among the task's `layouts`.
        memory: What the task remembers from the start, by name.
    """

    position: np.ndarray
    goal: np.ndarray
    velocity: np.ndarray | float = 0.0
    quaternion: np.ndarray | tuple[float, float, float, float] = UPRIGHT
    rates: np.ndarray | float = 0.0
    goal_velocity: np.ndarray | float = 0.0
    obstacle: np.ndarray = NO_OBSTACLES
    obstacle_velocity: np.ndarray = NO_OBSTACLES
    obstacle_quaternion: np.ndarray | tuple[float, float, float, float] = UPRIGHT
    layout: int = NO_LAYOUT
    memory: Mapping[str, np.ndarray] = NOTHING


class Memory(Mapping[str, np.ndarray]):
    """Arrays that a task keeps over an episode, by name: written into, never replaced."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of these names, and no others."""
        self._arrays = dict(arrays)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._arrays)

    def __len__(self) -> int:
        """Count the arrays."""
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        """Tell whether there is an array of that name."""
        return name in self._arrays

    def __getitem__(self, name: str) -> np.ndarray:
        """Look up an array.

        Raises:
            KeyError: The task's `memory` does not tell the name; the nearest are told.
        """
        try:
            return self._arrays[name]
        except KeyError:
            raise KeyError(str(unknown("memory", name, self))) from None

    def __setitem__(self, name: str, value: object) -> None:
        """Refuse: the environment keeps the arrays.

        Raises:
            ValueError: Always; the remedy is told.
        """
        if name not in self:
            raise unknown("memory", name, self)
        raise ValueError(
            f"memory {name!r} cannot be replaced: write into it, memory[{name!r}][:] = ..."
        )


class Scene(NamedTuple):
    """What is there beside the drones, in W worlds of N drones and K obstacles.

    Attributes:
        goal: (W, N, 3) m.
        goal_velocity: (W, N, 3) m/s.
        start: (W, N, 3) where the drones started, m.
        obstacle: (W, K, 3) m.
        obstacle_velocity: (W, K, 3) m/s.
        obstacle_quaternion: (W, K, 4) body to world.
        layout: (W,) index of the city that stands in each world, or NO_LAYOUT.
        memory: The task's own arrays (W, ...) by name, zero when a world starts unless its spawn
            or the task's `start_memory` says otherwise.
    """

    goal: np.ndarray
    goal_velocity: np.ndarray
    start: np.ndarray
    obstacle: np.ndarray
    obstacle_velocity: np.ndarray
    obstacle_quaternion: np.ndarray
    layout: np.ndarray
    memory: Mapping[str, np.ndarray]

    @classmethod
    def empty(
        cls,
        num_worlds: int,
        num_drones: int,
        num_obstacles: int,
        memory: Mapping[str, tuple[int, ...]],
    ) -> "Scene":
        """Make a scene with everything at the origin.

        Args:
            num_worlds: W.
            num_drones: N.
            num_obstacles: K.
            memory: Shape of each of the task's arrays in one world, by name.
        """
        of_drones = (num_worlds, num_drones, 3)
        of_obstacles = (num_worlds, num_obstacles, 3)
        return cls(
            goal=np.zeros(of_drones),
            goal_velocity=np.zeros(of_drones),
            start=np.zeros(of_drones),
            obstacle=np.zeros(of_obstacles),
            obstacle_velocity=np.zeros(of_obstacles),
            obstacle_quaternion=np.tile(UPRIGHT, (num_worlds, num_obstacles, 1)),
            layout=np.full(num_worlds, NO_LAYOUT),
            memory=Memory({name: np.zeros((num_worlds, *shape)) for name, shape in memory.items()}),
        )


@dataclass(frozen=True)
class TaskContext:
    """The swarm and the sensors that a task is made for.

    Attributes:
        num_drones: Drones in a world.
        collision_radius: Of the largest drone, m.
        max_speed: Speed limit, m/s.
        period: Time between decisions, s.
        num_neighbours: How many of the nearest drones, obstacles and buildings a drone observes.
        duration: Of an episode, s.
        beams: Of the range finder.
        max_range: How far the range finder reaches, m.
        standing_height: How high each drone's centre of mass is when it stands on the ground, m.
    """

    num_drones: int
    collision_radius: float
    max_speed: float
    period: float
    num_neighbours: int
    duration: float
    beams: tuple[Beam, ...]
    max_range: float
    standing_height: tuple[float, ...]


@dataclass(frozen=True)
class Frame:
    """One decision of W worlds of N drones, or a reset.

    An environment has one frame, whose arrays it writes anew in each decision: copy what you keep.

    Attributes:
        before: Swarm before the decision.
        after: Swarm after it.
        action: (W, N, A) what the drones were told.
        scene: Goals, obstacles and memory, after the decision.
        tell: Tells what touched what; see `contacts`.
        alive: (W, N) bool, drones that flew the decision.
        time: (W,) since each world's reset, s.
        last: (W,) bool, where the horizon is reached.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone about a drone ends, m.
        goal_before: (W, N, 3) where goals were before the decision, m; they move before drones do.
        readings: What sensors measured, by name; see `bulletuav.sensors`. Always there: "charge"
            (W, N), share left in batteries, "power" (W, N) W, and "sight" (W, N, U) bool, which of
            the task's targets are seen. With GPS noise "position" and "velocity" (W, N, 3), with
            communication "heard_position", "heard_velocity" (W, N, N, 3) and "heard" (W, N, N).
        derived: What the task works out of the decision for its terms, by name; see `Task.events`.
    """

    before: Swarm
    after: Swarm
    action: np.ndarray
    scene: Scene
    tell: Callable[[], Contacts]
    alive: np.ndarray
    time: np.ndarray
    last: np.ndarray
    d_safe: float
    zone: float
    goal_before: np.ndarray
    readings: Mapping[str, np.ndarray] = field(default_factory=dict)
    derived: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def contacts(self) -> Contacts:
        """What touched what."""
        return self.tell()

    @cached_property
    def conflict(self) -> Conflict:
        """Separations within the decision."""
        before, after = self.before.position, self.after.position
        return measure_conflict(before, after, self.alive, self.d_safe, self.zone)

    @property
    def known_position(self) -> np.ndarray:
        """(W, N, 3) where the drones think that they are, m."""
        return self.readings.get("position", self.after.position)

    @property
    def known_velocity(self) -> np.ndarray:
        """(W, N, 3) how they think that they move, m/s."""
        return self.readings.get("velocity", self.after.velocity)

    @cached_property
    def known_distance(self) -> np.ndarray:
        """(W, N) from there to the goal, m."""
        return paired_distances(self.scene.goal, self.known_position)

    @property
    def depleted(self) -> np.ndarray:
        """(W, N) bool: the battery is empty."""
        empty: np.ndarray = self.readings["charge"] <= 0
        return empty

    @property
    def seen(self) -> np.ndarray:
        """(W, N, U) bool: which of the task's targets the drones saw that flew the decision."""
        seen: np.ndarray = self.readings["sight"] & self.alive[..., None]
        return seen

    @cached_property
    def collision(self) -> np.ndarray:
        """(W, N) bool: contact of collision shapes."""
        return self.contacts.mask(self.alive.shape)

    @cached_property
    def resting(self) -> np.ndarray:
        """(W, N) bool: touched something, and hardly moves at the end of the decision.

        Speed is at most RESTING_SPEED, spin at most RESTING_SPIN. With contacts="stop" a drone that
        was stopped counts as well: it moves no more, whatever it touched.
        """
        resting = np.zeros(self.alive.shape, dtype=bool)
        if len(self.contacts.world):
            rows = self.contacts.world, self.contacts.drone
            speed = np.linalg.norm(self.after.velocity[rows], axis=-1)
            spin = np.linalg.norm(self.after.rates[rows], axis=-1)
            resting[rows] = (speed <= RESTING_SPEED) & (spin <= RESTING_SPIN)
        return resting

    @cached_property
    def landed(self) -> np.ndarray:
        """(W, N) bool: stands or lands on the ground, told where `Task.lands` allows it.

        It touches nothing else, met the ground at TOUCHDOWN_SPEED or less, and is tilted by
        30 degrees at most. Such a touch is no collision.
        """
        return np.zeros(self.alive.shape, dtype=bool)

    @cached_property
    def impulse(self) -> np.ndarray:
        """(W, N) greatest impulse of a contact, each summed over the decision, N s; 0 of none."""
        impulse = np.zeros(self.alive.shape)
        np.maximum.at(impulse, (self.contacts.world, self.contacts.drone), self.contacts.impulse)
        return impulse

    @cached_property
    def distance(self) -> np.ndarray:
        """(W, N) distance to the goal after the decision, m."""
        return paired_distances(self.scene.goal, self.after.position)

    @cached_property
    def distance_before(self) -> np.ndarray:
        """(W, N) distance to the goal before the decision, m."""
        return paired_distances(self.scene.goal, self.before.position)


class StepResult(NamedTuple):
    """What a task makes of a frame.

    Attributes:
        terms: Unweighted reward terms by name, (W, N) each. The reward is their sum, each times
            its weight.
        terminated: (W, N) bool, drones whose episode ends here, in success or failure.
        success: (W, N) bool, drones that are where the task wants them.
    """

    terms: dict[str, np.ndarray]
    terminated: np.ndarray
    success: np.ndarray


Reader = Callable[[Frame], np.ndarray]
FIELDS: Mapping[str, tuple[str, Reader]] = MappingProxyType(
    {
        "position": ("m", attrgetter("after.position")),
        "velocity": ("m/s", attrgetter("after.velocity")),
        "quaternion": ("body to world", attrgetter("after.quaternion")),
        "rates": ("rad/s, body axes", attrgetter("after.rates")),
        "rotor_speed": ("rad/s", attrgetter("after.rotor_speed")),
        "position_before": ("m, before the decision", attrgetter("before.position")),
        "velocity_before": ("m/s, before the decision", attrgetter("before.velocity")),
        "quaternion_before": ("before the decision", attrgetter("before.quaternion")),
        "rates_before": ("rad/s, before the decision", attrgetter("before.rates")),
        "known_position": ("m, as the drone knows it", attrgetter("known_position")),
        "known_velocity": ("m/s, as the drone knows it", attrgetter("known_velocity")),
        "known_distance": ("m, to the goal, as known", attrgetter("known_distance")),
        "goal": ("m", attrgetter("scene.goal")),
        "goal_before": ("m, before the decision", attrgetter("goal_before")),
        "goal_velocity": ("m/s", attrgetter("scene.goal_velocity")),
        "start": ("m, where it started", attrgetter("scene.start")),
        "obstacle": ("m, of all obstacles", attrgetter("scene.obstacle")),
        "obstacle_velocity": ("m/s, of all obstacles", attrgetter("scene.obstacle_velocity")),
        "distance": ("m, to the goal", attrgetter("distance")),
        "distance_before": ("m, to the goal, before", attrgetter("distance_before")),
        "action": ("what it was told", attrgetter("action")),
        "alive": ("whether it flew the decision", attrgetter("alive")),
        "collision": ("whether its shape touched anything", attrgetter("collision")),
        "resting": ("whether it touches and hardly moves", attrgetter("resting")),
        "landed": ("whether it stands on the ground", attrgetter("landed")),
        "impulse": ("N s, the greatest of a contact", attrgetter("impulse")),
        "depleted": ("whether its battery is empty", attrgetter("depleted")),
        "conflicts": ("conflicts that began", attrgetter("conflict.onsets")),
        "separation": ("m, from the nearest drone", attrgetter("conflict.separation")),
        "nearness": ("depth in warning zones", attrgetter("conflict.nearness")),
        "time": ("s since the reset", attrgetter("time")),
        "last": ("whether the horizon is reached", attrgetter("last")),
    }
)
"""What ingredients can ask for by argument name: unit or meaning, and how it is read from a frame.

`all_` before a name asks for the array of all drones (or obstacles) of the world.
"""
