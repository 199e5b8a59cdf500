"""Contents of a recording of an episode, and its outcome."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.seals import hash_arrays
from bulletuav.errors import unknown

INFO = "info/"
"""Prefix of the names of infos in files"""
READING = "reading/"
"""Prefix of the names of sensor readings in files"""
SCENE = "scene/"
"""Prefix of the names of the scene's parts in files"""
VERSION = 5
"""Version of the recording format"""


@dataclass(frozen=True)
class Recording:
    """One episode of one world: T decisions of N drones, and C contacts in chronological order.

    States have T + 1 rows, the first of which is the start. A drone that has finished keeps its
    last state. Contacts are defined as in `vehicle.swarm.Contacts`.

    Attributes:
        time: Time since the start, (T+1,), s.
        position: Positions, (T+1, N, 3), m.
        quaternion: Attitudes, (T+1, N, 4), x, y, z, w.
        velocity: Velocities, (T+1, N, 3), m/s.
        rates: Body rates, (T+1, N, 3), rad/s.
        alive: Drones in the airspace, (T+1, N) bool.
        action: Actions, (T, N, A).
        reward: Rewards, (T, N).
        separation: Minimum separation within the decision, (T, N), m; inf for a single drone.
        conflicts: Number of conflicts that began, (T, N).
        collision: Drones whose collision shapes were in contact, (T, N) bool.
        contact_step: Decision of each contact, (C,), from 0 to T - 1.
        contact_drone: Drone in contact, (C,).
        contact_other: The other drone, (C,), or a negative code of another body.
        contact_impulse: Impulse along the normals, summed over the decision, (C,), N s.
        contact_point: First contact point of the decision, (C, 3), m.
        contact_normal: Unit normal there, towards the drone, (C, 3).
        contact_velocity: Velocity of the drone's surface relative to the other just before, (C, 3),
            m/s.
        success: Drones that meet the task's success criterion, (T, N) bool.
        goal: Goals, (T+1, N, 3), m; (T+1, 0, 3) for a task without goals.
        obstacle: Centres of the K obstacles, (T+1, K, 3), m.
        obstacle_radius: Radii of their bounding spheres, (K,), m.
        obstacle_axis: Vector from the centre of each bar to its end, (K, 3), m; zeros for other
            shapes.
        building: Lower and upper corners of the bounding boxes of buildings' pieces, (P, 2, 3), m.
        target: Active targets of the task, (T+1, U, 3), m.
        seen: Targets in sight of any drone, (T+1, U) bool.
        info: Further infos of each decision, (T, N, ...) by name, including the weighted reward
            terms, such as "reward/progress".
        reading: Sensor readings, (T+1, N, ...) by name, without pictures.
        scene: Further data for replays, by name; see `analysis.scene`.
        version: Version of the format that the recording was read from.
    """

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    alive: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    separation: np.ndarray
    conflicts: np.ndarray
    collision: np.ndarray
    contact_step: np.ndarray
    contact_drone: np.ndarray
    contact_other: np.ndarray
    contact_impulse: np.ndarray
    contact_point: np.ndarray
    contact_normal: np.ndarray
    contact_velocity: np.ndarray
    success: np.ndarray
    goal: np.ndarray
    obstacle: np.ndarray
    obstacle_radius: np.ndarray
    obstacle_axis: np.ndarray
    building: np.ndarray
    target: np.ndarray
    seen: np.ndarray
    info: Mapping[str, np.ndarray] = field(default_factory=dict)
    reading: Mapping[str, np.ndarray] = field(default_factory=dict)
    scene: Mapping[str, np.ndarray] = field(default_factory=dict)
    version: int = VERSION

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, without infos, readings and the scene."""
        return {name: getattr(self, name) for name in ARRAYS}

    def hash(self, like: "Recording | None" = None) -> str:
        """Hash all arrays, to the last bit; equal flights have equal hashes.

        Args:
            like: A recording of an earlier version: arrays that it does not have are ignored.
        """
        arrays = self.everything()
        if like is not None and like.version < VERSION:
            arrays = {name: arrays[name] for name in like.everything() if name in arrays}
        return hash_arrays(arrays)

    def everything(self) -> dict[str, np.ndarray]:
        """Return all arrays by the names that are used in files."""
        more = {INFO: self.info, READING: self.reading, SCENE: self.scene}
        named = {
            f"{prefix}{name}": np.asarray(values)
            for prefix, arrays in more.items()
            for name, values in arrays.items()
        }
        return {**self.arrays(), **named}

    def get_info(self, name: str) -> np.ndarray:
        """Return an info of each decision, (T, N, ...), by its name in infos.

        Raises:
            ValueError: If there is no info of this name; the message suggests the nearest names.
        """
        if name in self.info:
            return self.info[name]
        if name not in INFO_ARRAYS:
            raise unknown("info of the recording", name, [*INFO_ARRAYS, *self.info])
        array: np.ndarray = getattr(self, name)
        return array


ARRAYS = tuple(
    one.name
    for one in dataclasses.fields(Recording)
    if one.name not in ("info", "reading", "scene", "version")
)
"""Names of the arrays that every recording has"""
INFO_ARRAYS = ("success", "separation", "conflicts", "collision")
"""Names of those arrays that come from infos"""


class Outcome(NamedTuple):
    """Outcome of one drone's episode.

    Attributes:
        drone: Number of the drone.
        reached: Success in the last decision that it flew.
        min_separation: Minimum separation, m.
        conflicts: Number of conflicts that began.
        collisions: Number of decisions with a contact of its collision shape.
        final_distance: Distance to the goal at its end, m; inf without goals.
        time: Time of its last decision, s.
    """

    drone: int
    reached: bool
    min_separation: float
    conflicts: int
    collisions: int
    final_distance: float
    time: float


def outcomes(recording: Recording) -> list[Outcome]:
    """Return the outcome of each drone that flew, in order."""
    rows = []
    for drone in range(recording.position.shape[1]):
        # A drone is alive without interruption from the start: the count gives its last decision.
        last = int(recording.alive[:-1, drone].sum()) - 1
        if last < 0:  # absent in this episode
            continue
        flown = slice(0, last + 1)
        distance = math.inf
        if recording.goal.shape[1]:
            offset = recording.goal[last + 1, drone] - recording.position[last + 1, drone]
            distance = float(np.linalg.norm(offset))
        rows.append(
            Outcome(
                drone=drone,
                reached=bool(recording.success[last, drone]),
                min_separation=float(recording.separation[flown, drone].min()),
                conflicts=int(recording.conflicts[flown, drone].sum()),
                collisions=int(recording.collision[flown, drone].sum()),
                final_distance=distance,
                time=float(recording.time[last + 1]),
            )
        )
    return rows


def summarize_infos(recording: Recording, names: Iterable[str]) -> list[dict[str, float]]:
    """Reduce infos over the decisions that each drone flew.

    Args:
        recording: The episode.
        names: Names of infos with one number per drone.

    Returns:
        For each drone that flew a bool, int or float by name: the minimum of separations, the sum
        of conflicts and collisions, and the last value of other infos.

    Raises:
        ValueError: If there is no info of a name.
    """
    infos = {name: recording.get_info(name) for name in names}
    flown = recording.alive[:-1].sum(axis=0).tolist()
    return [
        {
            name: INFO_REDUCTIONS.get(name, _last_value)(row[:end, i]).item()
            for name, row in infos.items()
        }
        for i, end in enumerate(flown)
        if end
    ]


def _last_value(row: np.ndarray) -> Any:
    return row[-1]


INFO_REDUCTIONS: Mapping[str, Callable[[np.ndarray], Any]] = MappingProxyType(
    {"separation": np.min, "conflicts": np.sum, "collision": np.sum}
)
"""Reductions of infos over time; others are reduced to their last value"""
