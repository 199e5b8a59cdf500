"""Policies of evaders: `flee`, `flee_weighted`, `flee_gap` and `wander`."""

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.conflict.measures import pair_offsets
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.game import Game
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

HEADINGS = 16
"""Number of headings that `flee_gap` compares"""
CLIMBS = (-0.5, 0.0, 0.5)
"""Climb angles that `flee_gap` compares, rad"""
AHEAD = 2.0
"""Time for which a direction must stay inside the arena, s"""
STRAIGHT = 2.0
"""Time for which `wander` keeps a direction, s"""
NEAR = 1e-9
"""Minimum distance that has a direction, m"""


@register("policy")
class Flee(Game):
    """Flight at full speed straight away from the nearest opponent."""

    name = "flee"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities away from the goal; see `Game.velocities`."""
        return self.full(swarm.position - self.aviary.scene.goal)


@register("policy")
class FleeWeighted(Game):
    """Flight at full speed away from all other drones and walls, weighted by proximity.

    Each drone and wall repels with the inverse square of its distance. Teammates repel, too:
    without them, evaders would meet where the other repulsions cancel.
    """

    name = "flee_weighted"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return full-speed velocities along the summed repulsion; see `Game.velocities`."""
        ways = pair_offsets(swarm.position)
        distance = np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), NEAR)
        there = self.aviary.alive[:, None, :, None]
        push = np.where(there, -ways / distance**3, 0.0).sum(axis=2)
        low, high = self.box
        body = self.clearance.body
        push += 1 / np.maximum(swarm.position - low, body) ** 2
        push -= 1 / np.maximum(high - swarm.position, body) ** 2
        return self.full(push)


@register("policy")
class FleeGap(Game):
    """Flight at full speed into the widest angular gap between opponents.

    The chosen direction, among headings all around and three climb angles, has the largest angle to
    its nearest opponent. Directions that leave the arena within 2 s are excluded.
    """

    name = "flee_gap"

    def __init__(self, aviary: Aviary) -> None:
        """Compute the candidate directions; see `Policy`."""
        super().__init__(aviary)
        angle, climb = np.meshgrid(2 * np.pi * np.arange(HEADINGS) / HEADINGS, CLIMBS)
        level = cos(climb)
        parts = (level * cos(angle), level * sin(angle), sin(climb))
        self._directions = np.stack(parts, axis=-1).reshape(-1, 3)

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities into the widest gap; see `Game.velocities`."""
        ways = pair_offsets(swarm.position)
        ways = ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), NEAR)
        # Cosine of the angle between each direction and its nearest opponent.
        cosine = ways @ self._directions.T
        cosine = np.where(self.opponents()[..., None], cosine, -1.0).max(axis=2)
        reach = AHEAD * self.speed[:, None, None] * self._directions
        place = swarm.position[:, :, None] + reach
        low, high = self.box
        leaves = np.any((place < low) | (place > high), axis=-1)
        best = np.where(leaves, cosine + 2.0, cosine).argmin(axis=2)
        return self.full(self._directions[best])


@register("policy")
class Wander(Game):
    """Flight at full speed in random directions, each for 2 s."""

    name = "wander"
    remembers = ("_rng", "_way")

    def __init__(self, aviary: Aviary) -> None:
        """Allocate the random generators and directions; see `Policy`."""
        super().__init__(aviary)
        self._rng: dict[int, np.random.Generator] = {}
        self._way = np.zeros((*aviary.alive.shape, 3))
        self._decisions = max(round(STRAIGHT * aviary.options.decision_hz), 1)

    def reset(self, mask: np.ndarray) -> None:
        """Seed a generator for each world in `mask` (W,)."""
        for k in np.flatnonzero(mask).tolist():
            generator = self.aviary.rng[k]
            assert generator is not None  # set by the reset of the world
            self._rng[k] = np.random.default_rng(generator.integers(2**63))

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Draw a new direction every 2 s; see `Game.velocities`."""
        for k, rng in self._rng.items():
            if self.aviary.steps[k] % self._decisions == 0:
                self._way[k] = rng.normal(size=self._way.shape[1:])
        return self.full(self._way)
