"""Data that tasks exchange with environments: starts, scenes, frames and step results."""

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
MAX_RESTING_SPEED = 0.01
"""Maximum speed of a drone at rest, m/s: above the residual of contacts, below any flight"""
MAX_RESTING_SPIN = 0.1
"""Maximum body rate of a drone at rest, rad/s; a rim at 0.1 m then moves at 0.01 m/s"""

MAX_TOUCHDOWN_SPEED = 2.0
"""Maximum impact speed of a landing, m/s; a fall from 0.2 m reaches it"""
MIN_TOUCHDOWN_COSINE = np.sqrt(0.75)
"""Minimum cosine of the tilt of a landing, before and after the decision: 30 degrees"""
STANDING_TOLERANCE = 0.001
"""Maximum height above the ground of kinematic drones that stand without contact, m"""


NO_MEMORY: Mapping[str, np.ndarray] = MappingProxyType({})
"""Memory of a start that sets none"""


class Spawn(NamedTuple):
    """Start of one world of N drones. Only position and goal are required.

    Attributes:
        position: (N, 3) m.
        goal: (N, 3) m, or (3,) for all drones.
        velocity: (N, 3) m/s, or one number or (3,) for all drones.
        quaternion: (N, 4) body to world (x, y, z, w), or (4,) for all drones; default level, facing
            east.
        rates: (N, 3) body rates, rad/s, or one number or (3,) for all drones.
        goal_velocity: (N, 3) m/s, or one number or (3,) for all drones.
        obstacle: (K, 3) positions of the task's obstacles, m.
        obstacle_velocity: (K, 3) m/s.
        obstacle_quaternion: (K, 4) body to world, or (4,) for all obstacles.
        layout: Index of the world's city in the task's `layouts`.
        memory: Initial values of the task's memory, by name.
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
    memory: Mapping[str, np.ndarray] = NO_MEMORY


class TaskMemory(Mapping[str, np.ndarray]):
    """Arrays that a task keeps over an episode, by name. Values are mutable, keys are fixed."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Store the arrays; names cannot be added later."""
        self._arrays = dict(arrays)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._arrays)

    def __len__(self) -> int:
        """Return the number of arrays."""
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        """Return True if there is an array of this name."""
        return name in self._arrays

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an array.

        Raises:
            KeyError: If the task's `memory` does not declare the name; the message suggests similar
                names.
        """
        try:
            return self._arrays[name]
        except KeyError:
            raise KeyError(str(unknown("memory", name, self))) from None

    def __setitem__(self, name: str, value: object) -> None:
        """Raise an error, as the environment owns the arrays.

        Raises:
            ValueError: Always; the message explains how to write into the array.
        """
        if name not in self:
            raise unknown("memory", name, self)
        raise ValueError(
            f"memory {name!r} cannot be replaced: write into it, memory[{name!r}][:] = ..."
        )


class Scene(NamedTuple):
    """Everything except the drones, in W worlds of N drones and K obstacles.

    Attributes:
        goal: (W, N, 3) m.
        goal_velocity: (W, N, 3) m/s.
        start: (W, N, 3) start positions of the drones, m.
        obstacle: (W, K, 3) m.
        obstacle_velocity: (W, K, 3) m/s.
        obstacle_quaternion: (W, K, 4) body to world.
        layout: (W,) index of the city in each world, or NO_LAYOUT.
        memory: The task's arrays (W, ...) by name, zero when a world starts unless its spawn or
            `Task.start_memory` sets them.
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
        """Return a scene with all positions at the origin.

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
            memory=TaskMemory(
                {name: np.zeros((num_worlds, *shape)) for name, shape in memory.items()}
            ),
        )


@dataclass(frozen=True)
class TaskContext:
    """Swarm and sensors for which a task is made.

    Attributes:
        num_drones: Drones per world.
        collision_radius: Collision radius of the largest drone, m.
        max_speed: Speed limit, m/s.
        period: Time between decisions, s.
        num_neighbours: Number of nearest drones, obstacles and buildings in observations.
        duration: Length of an episode, s.
        beams: Beams of the range finder.
        max_range: Maximum range of the range finder, m.
        standing_height: Height of each drone's centre of mass when it stands on the ground, m.
        turn_radius: Radius of the tightest turn at cruise speed of drones that cannot hover, m; 0
            if all can.
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
    turn_radius: float = 0.0


@dataclass(frozen=True)
class Frame:
    """One decision of W worlds of N drones, or a reset.

    An environment reuses one frame and overwrites its arrays in each decision: copy data to keep
    it.

    Attributes:
        before: Swarm before the decision.
        after: Swarm after the decision.
        action: (W, N, A) actions.
        scene: Goals, obstacles and memory, after the decision.
        read_contacts: Returns the contacts of the decision; see `contacts`.
        alive: (W, N) bool, drones that flew the decision.
        time: (W,) time since each world's reset, s.
        last: (W,) bool, whether the horizon is reached.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone around a drone ends, m.
        goal_before: (W, N, 3) goals before the decision, m; goals move before drones do.
        readings: Readings of sensors, by name; see `bulletuav.sensors`. Always present: "charge"
            (W, N), remaining fraction of the battery, "power" (W, N) W, and "sight" (W, N, U) bool,
            which of the task's targets are in sight. With GPS noise "position" and "velocity" (W,
            N, 3); with communication "heard_position", "heard_velocity" (W, N, N, 3) and "heard"
            (W, N, N).
        derived: Arrays that the task derives for its reward terms, by name; see `Task.events`.
    """

    before: Swarm
    after: Swarm
    action: np.ndarray
    scene: Scene
    read_contacts: Callable[[], Contacts]
    alive: np.ndarray
    time: np.ndarray
    last: np.ndarray
    d_safe: float
    zone: float
    goal_before: np.ndarray
    readings: Mapping[str, np.ndarray] = field(default_factory=dict)
    derived: dict[str, np.ndarray] = field(default_factory=dict)

    def without_readings(self) -> "Frame":
        """Return a frame of the same arrays whose known positions and velocities are the true."""
        # Faster than `dataclasses.replace`
        other = object.__new__(Frame)
        own = vars(self)
        vars(other).update({name: own[name] for name in self.__dataclass_fields__}, readings={})
        return other

    @property
    def contacts(self) -> Contacts:
        """Contacts of the decision."""
        return self.read_contacts()

    @cached_property
    def conflict(self) -> Conflict:
        """Separations and conflicts within the decision."""
        before, after = self.before.position, self.after.position
        return measure_conflict(before, after, self.alive, self.d_safe, self.zone)

    @property
    def known_position(self) -> np.ndarray:
        """(W, N, 3) positions as the drones measure them, m."""
        return self.readings.get("position", self.after.position)

    @property
    def known_velocity(self) -> np.ndarray:
        """(W, N, 3) velocities as the drones measure them, m/s."""
        return self.readings.get("velocity", self.after.velocity)

    @cached_property
    def known_distance(self) -> np.ndarray:
        """(W, N) distance from the measured position to the goal, m."""
        return paired_distances(self.scene.goal, self.known_position)

    @property
    def depleted(self) -> np.ndarray:
        """(W, N) bool, whether the battery is empty."""
        empty: np.ndarray = self.readings["charge"] <= 0
        return empty

    @property
    def seen(self) -> np.ndarray:
        """(W, N, U) bool, which of the task's targets are seen by drones that flew the decision."""
        seen: np.ndarray = self.readings["sight"] & self.alive[..., None]
        return seen

    @cached_property
    def collision(self) -> np.ndarray:
        """(W, N) bool, whether the collision shape touched anything."""
        return self.contacts.mask(self.alive.shape)

    @cached_property
    def resting(self) -> np.ndarray:
        """(W, N) bool, whether the drone touched something and is at rest after the decision.

        At rest means a speed of at most MAX_RESTING_SPEED and body rates of at most
        MAX_RESTING_SPIN. With contacts="stop" this includes every drone that a contact stopped.
        """
        resting = np.zeros(self.alive.shape, dtype=bool)
        if len(self.contacts.world):
            rows = self.contacts.world, self.contacts.drone
            speed = np.linalg.norm(self.after.velocity[rows], axis=-1)
            spin = np.linalg.norm(self.after.rates[rows], axis=-1)
            resting[rows] = (speed <= MAX_RESTING_SPEED) & (spin <= MAX_RESTING_SPIN)
        return resting

    @cached_property
    def landed(self) -> np.ndarray:
        """(W, N) bool, whether the drone stands or lands on the ground; only if `Task.lands`.

        A landing touches nothing but the ground, or the task's `landing_places`, at
        MAX_TOUCHDOWN_SPEED or less, and with a tilt of at most 30 degrees. It is not a collision.
        """
        return np.zeros(self.alive.shape, dtype=bool)

    @cached_property
    def impulse(self) -> np.ndarray:
        """(W, N) maximum impulse of a contact, summed over the decision, N s; 0 without contact."""
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
    """Evaluation of a frame by a task.

    Attributes:
        terms: Unweighted reward terms by name, (W, N) each. The reward is their weighted sum.
        terminated: (W, N) bool, drones whose episodes terminate, in success or failure.
        success: (W, N) bool, drones that are successful.
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
        "deflection": ("rad, of control surfaces", attrgetter("after.deflection")),
        "position_before": ("m, before the decision", attrgetter("before.position")),
        "velocity_before": ("m/s, before the decision", attrgetter("before.velocity")),
        "quaternion_before": ("before the decision", attrgetter("before.quaternion")),
        "rates_before": ("rad/s, before the decision", attrgetter("before.rates")),
        "known_position": ("m, as the drone measures it", attrgetter("known_position")),
        "known_velocity": ("m/s, as the drone measures it", attrgetter("known_velocity")),
        "known_distance": ("m, to the goal, as measured", attrgetter("known_distance")),
        "goal": ("m", attrgetter("scene.goal")),
        "goal_before": ("m, before the decision", attrgetter("goal_before")),
        "goal_velocity": ("m/s", attrgetter("scene.goal_velocity")),
        "start": ("m, start position", attrgetter("scene.start")),
        "obstacle": ("m, of all obstacles", attrgetter("scene.obstacle")),
        "obstacle_velocity": ("m/s, of all obstacles", attrgetter("scene.obstacle_velocity")),
        "distance": ("m, to the goal", attrgetter("distance")),
        "distance_before": ("m, to the goal, before", attrgetter("distance_before")),
        "action": ("the drone's action", attrgetter("action")),
        "alive": ("whether it flew the decision", attrgetter("alive")),
        "collision": ("whether the drone touched anything", attrgetter("collision")),
        "resting": ("whether it is at rest in contact", attrgetter("resting")),
        "landed": ("whether it stands on the ground", attrgetter("landed")),
        "impulse": ("N s, maximum over contacts", attrgetter("impulse")),
        "depleted": ("whether its battery is empty", attrgetter("depleted")),
        "conflicts": ("conflicts that began in the decision", attrgetter("conflict.onsets")),
        "separation": ("m, from the nearest drone", attrgetter("conflict.separation")),
        "nearness": ("depth in warning zones", attrgetter("conflict.nearness")),
        "time": ("s since the reset", attrgetter("time")),
        "last": ("whether the horizon is reached", attrgetter("last")),
    }
)
"""Fields of a frame that ingredients can request by name: unit or meaning, and how to read them.

The prefix `all_` requests the array of all drones (or obstacles) of the world.
"""
