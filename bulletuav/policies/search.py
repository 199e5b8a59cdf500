"""Policy `sweep`: searches the ground square by square, and hovers above victims that it sees."""

import numpy as np

from bulletuav.compiled.functions import atan2, sin
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.observed import NO_BUILDINGS
from bulletuav.policies.orca import Orca
from bulletuav.policies.readings import CEILING_MARGIN, require_blocks, unpack_blocks
from bulletuav.policies.traffic import Traffic, find_surfaces
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.search import Search
from bulletuav.vehicle.swarm import Swarm

BLOCKS = (
    "position",
    "velocity",
    "clue_offset",
    "sighting",
    "victims_found",
    "searched_cells",
    "all_neighbours",
    "lidar",
)
CLEARANCE = 7.0
"""Height of the search above the highest ground or tree that the drone has measured, m"""
LEVEL_RANGE = 8.0
"""Range of a level beam below which the drone climbs, if no other drone is near, m"""
POSITION_GAIN, OFFSET_GAIN = 0.15, 0.4
"""Weights of a new position, and of a new offset to a victim, in filtered ones"""
MEMORY = 15
"""Decisions after which a victim that is no longer seen is given up"""
ABOVE = 1.5
"""Horizontal distance from the victim within which drones descend to it, m"""
VISITED = 1.5
"""Horizontal distance from the middle of a square at which it counts as visited, m"""
OTHER_SECTOR = 60.0
"""Detour for which a drone prefers squares in its own sector, m"""
YIELD = 8.0
"""Distance from a victim within which a nearer drone gets it, m"""
BELOW = 2.0
"""Height below that of the search from which drones climb before they fly on, m"""
DESCENT = 4.0
"""Maximum speed of a descent, m/s"""


def blend(ahead: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return predictions corrected by measurements; measurements where there is no prediction."""
    corrected = ahead + POSITION_GAIN * (measured - ahead)
    return np.where(np.isnan(ahead), measured, corrected)


@register("policy")
class Sweep(Orca):
    """Search of one sector of the ground for each drone, from the nearest square to the next.

    Drones fly above everything that their range finders have measured, and help in other sectors
    when their own is searched. A drone that sees a victim flies above it, descends and hovers,
    unless another drone is nearer to the victim. Positions and offsets are filtered. Only the
    observation is used; ORCA keeps the drones apart.
    """

    name = "sweep"
    reads_swarm = False
    remembers = (
        "_position",
        "_others",
        "_highest",
        "_offset",
        "_unseen",
        "_known",
        "_visited",
        "_again",
    )

    def __init__(self, aviary: Aviary) -> None:
        """Check the task and its observation; see `Policy`.

        Raises:
            ValueError: If the task is another one, or a block is not observed.
        """
        super().__init__(aviary)
        self._task = require_supported_task(self, Search)
        require_blocks(self.name, aviary, BLOCKS)
        self._period = 1.0 / aviary.options.decision_hz
        elevation = np.radians([beam.elevation for beam in self._task.context.beams])
        self._rise = sin(elevation)
        shape = aviary.alive.shape
        self._position = np.full((*shape, 3), np.nan)
        self._highest = np.zeros(shape)
        self._offset = np.full((*shape, 3), np.nan)
        self._others = np.full((*shape, shape[1] - 1, 3), np.nan)
        self._unseen = np.zeros(shape, dtype=int)
        self._known = np.zeros(shape)
        self._visited = np.zeros((*shape, len(self._task.grid)), dtype=bool)
        self._again = np.zeros(shape, dtype=bool)
        # Each drone's sector of the ground around the clue
        grid, drones = self._task.grid, shape[1]
        turn = atan2(grid[:, 1], grid[:, 0]) / (2 * np.pi) % 1.0
        owner = np.minimum((turn * drones).astype(int), drones - 1)
        self._detour = np.where(owner == np.arange(drones)[:, None], 0.0, OTHER_SECTOR)
        low, high = self._task.config.hover_height
        self._hover_height = 0.5 * (low + high)

    def reset(self, mask: np.ndarray) -> None:
        """Drop what was measured in the worlds of `mask` (W,)."""
        self._position[mask] = np.nan
        self._offset[mask] = np.nan
        self._others[mask] = np.nan
        for array in (self._highest, self._unseen, self._known, self._visited, self._again):
            array[mask] = 0

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic around each drone as observed; see `Avoidance.traffic`."""
        seen = unpack_blocks(self.aviary, observations)
        velocity = seen["velocity"]
        others = self._filter(seen)
        self._measure_heights(seen, others)
        is_seen, offset = self.sightings(seen, swarm)
        self._track(seen, is_seen, offset)
        goal = self._choose_goals(seen, others)
        zeros = np.zeros(velocity.shape)
        nowhere = np.full(len(velocity), -1)
        return Traffic(
            velocity=velocity,
            goal=goal,
            goal_velocity=zeros,
            offset=np.nan_to_num(others),
            other_velocity=self._relative_velocity(seen) + velocity[:, :, None],
            known=~np.isnan(others[..., 0]),
            sphere=zeros[:, :, None][:, :, :0],
            sphere_velocity=zeros[:, :, None][:, :, :0],
            sphere_radius=zeros[..., :0],
            surface=find_surfaces(
                seen["position"], self.box, nowhere, NO_BUILDINGS, self.clearance
            ),
        )

    def preferred(self, traffic: Traffic, swarm: Swarm) -> np.ndarray:
        """Return the velocities to the goals, with slow descents; see `Avoidance.preferred`."""
        velocity = super().preferred(traffic, swarm)
        velocity[..., 2] = np.maximum(velocity[..., 2], -DESCENT)
        return velocity

    def sightings(self, seen: dict[str, np.ndarray], swarm: Swarm) -> tuple[np.ndarray, np.ndarray]:
        """Return which drones see a victim, (W, N) bool, and its offset, (W, N, 3) m."""
        return seen["sighting"][..., 0] > 0.5, seen["sighting"][..., 1:]

    def _filter(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Update filtered positions and offsets, and return those to other drones.

        Returns:
            (W, N, N - 1, 3) m; NaN for drones that are not known.
        """
        moved = self._period * seen["velocity"]
        self._position = blend(self._position + moved, seen["position"])
        self._offset -= moved
        measured = seen["all_neighbours"].reshape(*self._others.shape[:3], 6)[..., :3]
        ahead = self._others + self._period * self._relative_velocity(seen)
        is_known = (measured != 0).any(axis=-1, keepdims=True)
        self._others = np.where(is_known, blend(ahead, measured), np.nan)
        return self._others

    def _relative_velocity(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return the relative velocities of other drones, (W, N, N - 1, 3) m/s."""
        rows = seen["all_neighbours"].reshape(*self._others.shape[:3], 6)
        return rows[..., 3:].copy()

    def _measure_heights(self, seen: dict[str, np.ndarray], others: np.ndarray) -> None:
        """Update the heights of the highest surfaces that beams have hit."""
        ranges = seen["lidar"]
        height = self._position[..., 2:] + ranges * self._rise
        hits = ranges < self._task.context.max_range - 1e-3
        # Level beams hit other drones, too
        is_near = (others**2).sum(axis=-1) < (2 * LEVEL_RANGE) ** 2  # False for NaN
        is_blocked = (ranges < LEVEL_RANGE) & ~is_near.any(axis=-1, keepdims=True)
        hits &= (self._rise < -1e-3) | is_blocked
        self._highest = np.maximum(self._highest, np.where(hits, height, 0.0).max(axis=-1))

    def _track(self, seen: dict[str, np.ndarray], is_seen: np.ndarray, offset: np.ndarray) -> None:
        """Update the offsets to the victims that drones fly to."""
        known = seen["victims_found"][..., 0]
        is_news = known > self._known + 1e-6
        self._known = known.copy()
        self._unseen = np.where(is_seen, 0, self._unseen + 1)
        self._offset[~is_seen & (is_news | (self._unseen > MEMORY))] = np.nan
        error = offset - self._offset
        is_same = (error**2).sum(axis=-1) < YIELD**2  # False for NaN
        gain = np.where(is_same & ~is_news, OFFSET_GAIN, 1.0)[..., None]
        updated = np.where(np.isnan(error), offset, self._offset + gain * error)
        self._offset = np.where(is_seen[..., None], updated, self._offset)

    def _choose_goals(self, seen: dict[str, np.ndarray], others: np.ndarray) -> np.ndarray:
        """Return offsets (W, N, 3), m, to victims in sight or to the next squares."""
        goal = np.empty(self._position.shape)
        goal[..., :2] = self.search_goals(seen)
        goal[..., 2] = self.search_height() - self._position[..., 2]
        target = self._offset
        flat = np.sqrt((target[..., :2] ** 2).sum(axis=-1))
        # A nearer drone gets the victim
        gap = np.sqrt(((others[..., :2] - target[:, :, None, :2]) ** 2).sum(axis=-1))
        theirs = np.where(np.isnan(gap), np.inf, gap).min(axis=-1, initial=np.inf)
        follows = ~np.isnan(flat) & ~(theirs < np.minimum(flat, YIELD))
        goal[..., :2] = np.where(follows[..., None], target[..., :2], goal[..., :2])
        descends = follows & (flat < ABOVE)
        # Climb before flying on
        is_low = (goal[..., 2] > BELOW) & ~descends
        goal[..., :2] = np.where(is_low[..., None], 0.0, goal[..., :2])
        goal[..., 2] = np.where(descends, target[..., 2] + self._hover_height, goal[..., 2])
        return goal

    def search_height(self) -> np.ndarray:
        """Return the height of the search, (W, N) m."""
        highest = float(self._task.arena_high[2]) - CEILING_MARGIN
        height: np.ndarray = np.minimum(self._highest + CLEARANCE, highest)
        return height

    def search_goals(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return offsets (W, N, 2), m, to the squares that the drones search next."""
        clue = seen["position"][..., :2] + seen["clue_offset"][..., :2]
        away = clue[:, :, None] + self._task.grid - self._position[:, :, None, :2]
        distance = np.sqrt((away**2).sum(axis=-1))
        self._visited |= distance < VISITED
        done = self._visited | ((seen["searched_cells"] > 0.5) & ~self._again[..., None])
        # All squares are searched again if not all victims were in sight
        restarts = np.all(done, axis=-1)
        self._again |= restarts
        self._visited[restarts] = False
        done = np.where(restarts[..., None], False, done)
        cost = np.where(done, np.inf, distance + self._detour)
        chosen = cost.argmin(axis=-1)[..., None, None]
        goal: np.ndarray = np.take_along_axis(away, chosen, axis=2)[:, :, 0]
        return goal
