"""Policies that avoid the task `search`."""

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.readings import CEILING_MARGIN
from bulletuav.policies.search import Sweep
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

RADIUS_FRACTION = 0.1
"""Radius of the circle on which drones search the same ground, in radii of the clue"""
SPEED = 1.0
"""Speed on this circle, m/s"""

GROUND_DEPTH = 10.0
"""Depth of the ground as the drone that touches victims believes it, m"""


class IgnoreVictims(Sweep):
    """Base class of policies that do not look at victims."""

    def sightings(self, seen: dict[str, np.ndarray], swarm: Swarm) -> tuple[np.ndarray, np.ndarray]:
        """Return that no victim is seen; see `Sweep.sightings`."""
        return np.zeros(swarm.position.shape[:2], dtype=bool), np.zeros(swarm.position.shape)


@register("policy")
class SearchMap(IgnoreVictims):
    """Search all squares, which is paid, and find no victim: the baseline without its detector."""

    name = "search_map"


@register("policy")
class SearchAtClue(IgnoreVictims):
    """Hover above the clue."""

    name = "search_at_clue"

    def search_goals(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return offsets to the clue; see `Sweep.search_goals`."""
        return seen["clue_offset"][..., :2]


@register("policy")
class SearchFromAbove(IgnoreVictims):
    """Search all squares from the ceiling, and never descend to a victim."""

    name = "search_from_above"

    def search_height(self) -> np.ndarray:
        """Return the ceiling; see `Sweep.search_height`."""
        ceiling = self._task.arena_high[2] - CEILING_MARGIN
        return np.full(self.aviary.alive.shape, ceiling)


@register("policy")
class SearchTouch(Sweep):
    """Search as the baseline does, and descend until the drone touches the victim."""

    name = "search_touch"

    def __init__(self, aviary: Aviary) -> None:
        """Drop the ground from what is avoided; see `Policy`."""
        super().__init__(aviary)
        self.box = self.box[0] - (0.0, 0.0, GROUND_DEPTH), self.box[1]

    def sightings(self, seen: dict[str, np.ndarray], swarm: Swarm) -> tuple[np.ndarray, np.ndarray]:
        """Return places below the victims; see `Sweep.sightings`."""
        is_seen, offset = super().sightings(seen, swarm)
        return is_seen, offset - (0.0, 0.0, 2 * self._hover_height)


@register("policy")
class SearchTogether(Sweep):
    """Search with all drones the ground on one circle around the clue, again and again."""

    name = "search_together"

    def search_goals(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return offsets to a point that moves on the circle; see `Sweep.search_goals`."""
        radius = RADIUS_FRACTION * self._task.config.clue_radius
        angle = (self._period * SPEED / radius * self.aviary.steps)[:, None, None]
        circle = radius * np.concatenate([cos(angle), sin(angle)], axis=-1)
        offset: np.ndarray = seen["clue_offset"][..., :2] + circle
        return offset
