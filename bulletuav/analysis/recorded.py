"""What a recording of an episode holds, and how the episode went by it."""

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
"""Beginning of the names that infos have in files"""
READING = "reading/"
"""Beginning of the names that readings of sensors have in files"""
SCENE = "scene/"
"""Beginning of the names that parts of the scene have in files"""
VERSION = 5
"""Version of the form of recordings"""


@dataclass(frozen=True)
class Recording:
    """One episode of one world: T decisions of N drones, and C contacts in the order of time.

    States have T + 1 rows, of which the first is the start. A drone that left keeps its last state.
    Contacts are told as in `vehicle.swarm.Contacts`.

    Attributes:
        time: Time since the start, (T+1,), s.
        position: Positions, (T+1, N, 3), m.
        quaternion: Attitudes, (T+1, N, 4), x, y, z, w.
        velocity: Velocities, (T+1, N, 3), m/s.
        rates: Body rates, (T+1, N, 3), rad/s.
        alive: Drones in the airspace, (T+1, N) bool.
        action: Actions, (T, N, A).
        reward: Rewards, (T, N).
        separation: Least separation within the decision, (T, N), m; inf when alone.
        conflicts: Conflicts that began, (T, N).
        collision: Drones whose collision shapes touched something, (T, N) bool.
        contact_step: Decision of each contact, (C,), from 0 to T - 1.
        contact_drone: Drone that touched, (C,).
        contact_other: Drone that it touched, (C,), or below zero what else.
        contact_impulse: Impulse along the normals, summed over the decision, (C,), N s.
        contact_point: Where they touched first in the decision, (C, 3), m.
        contact_normal: Unit vector in which the drone was pushed there, (C, 3).
        contact_velocity: Of the drone's surface against the other's just before, (C, 3), m/s.
        success: Drones that are where the task wants them, (T, N) bool.
        goal: Goals, (T+1, N, 3), m; (T+1, 0, 3) of a task without goals.
        obstacle: Middles of the K obstacles, (T+1, K, 3), m.
        obstacle_radius: Radii of their bounding spheres, (K,), m.
        obstacle_axis: From the middle of each that is a bar to its end, (K, 3), m; zeros of others.
        building: Lower and upper corners of the bounding boxes of buildings' pieces, (P, 2, 3), m.
        target: Targets of the task that count, (T+1, U, 3), m.
        seen: Targets that some drone sees, (T+1, U) bool.
        info: What infos tell of each decision beside these arrays, (T, N, ...) by name. Weighted
            reward terms are among them, such as "reward/progress".
        reading: What sensors measured, (T+1, N, ...) by name, without pictures.
        scene: What a replay shows beside all this, by name; see `analysis.scene`.
        version: Version of the form that it was read from.
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
        """Hash everything, to the last bit; equal flights have equal hashes.

        Args:
            like: Of version 4: what it has no entries for is left out.
        """
        told = self.everything()
        if like is not None and like.version < VERSION:
            told = {name: told[name] for name in like.everything() if name in told}
        return hash_arrays(told)

    def everything(self) -> dict[str, np.ndarray]:
        """Return all arrays by the names that files give them."""
        more = {INFO: self.info, READING: self.reading, SCENE: self.scene}
        named = {
            f"{prefix}{name}": np.asarray(values)
            for prefix, told in more.items()
            for name, values in told.items()
        }
        return {**self.arrays(), **named}

    def get_info(self, name: str) -> np.ndarray:
        """Look up what infos told of each decision, (T, N, ...), by the name that they use.

        Raises:
            ValueError: They told nothing of that name; the nearest are offered.
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
"""Those of them that infos tell"""


class Outcome(NamedTuple):
    """How one drone's episode went.

    Attributes:
        drone: Number of the drone.
        reached: Success in the last decision that it flew.
        min_separation: Least separation, m.
        conflicts: Conflicts that began.
        collisions: Decisions with a contact of its collision shape.
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
    """Sum up how the episode of each drone went, in their order."""
    rows = []
    for drone in range(recording.position.shape[1]):
        # A drone flies from the start on without a gap, so that counting tells its last decision.
        last = int(recording.alive[:-1, drone].sum()) - 1
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
    """Sum up infos over the decisions that each drone flew.

    Args:
        recording: The episode.
        names: Of infos of one number a drone.

    Returns:
        For each drone a bool, int or float by name: of separations the least, of conflicts and
        collisions the sum, and else what infos told of its last decision.

    Raises:
        ValueError: Infos told nothing of a name.
    """
    told = {name: recording.get_info(name) for name in names}
    flown = recording.alive[:-1].sum(axis=0).tolist()
    return [
        {
            name: INFO_REDUCTIONS.get(name, _last_value)(row[:end, i]).item()
            for name, row in told.items()
        }
        for i, end in enumerate(flown)
    ]


def _last_value(row: np.ndarray) -> Any:
    """Return the last of the numbers (T,)."""
    return row[-1]


INFO_REDUCTIONS: Mapping[str, Callable[[np.ndarray], Any]] = MappingProxyType(
    {"separation": np.min, "conflicts": np.sum, "collision": np.sum}
)
"""How infos are summed up of which not the last one counts"""
