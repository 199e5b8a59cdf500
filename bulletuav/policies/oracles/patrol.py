"""Policy `patrol_oracle`: patrol with the true idleness of all squares and all plans."""

import numpy as np

from bulletuav.policies.coverage_geometry import pairwise_distances
from bulletuav.policies.patrol import CHARGES, PATROLS, PatrolReactive
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

SAME_PAD = 15.0
"""Horizontal distance up to which two drones fly to the same pad, m: above errors of positions"""


@register("policy")
class PatrolOracle(PatrolReactive):
    """Policy `patrol_reactive` without noise, which knows all squares and where others fly.

    It leaves squares to drones whose destination is nearer, rather than to drones that are nearer,
    and pads to drones that fly to them.
    """

    name = "patrol_oracle"

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Return squares or pads to fly to, from true positions; see `PatrolPolicy.goals`."""
        self.seen["position"] = swarm.position
        return super().goals(swarm)

    def squares(self, w: int, i: int) -> np.ndarray:
        """Return all squares (K, 3); see `PatrolPolicy.squares`."""
        scene, here = self.aviary.scene, self.aviary.swarm.position[w, i, :2]
        active = self.task.active_targets(scene)[w]
        offset = self.task.targets(scene)[w, active, :2] - here
        idle = scene.memory["idleness"][w, active]
        squares: np.ndarray = np.column_stack([offset, idle])
        return squares

    def others(self, w: int, i: int) -> np.ndarray:
        """Return the offsets of the destinations of other drones; see `PatrolReactive.others`."""
        flies = self.aviary.alive[w] & (self._mode[w] == PATROLS)
        flies &= ~np.isnan(self._square[w, :, 0])
        flies[i] = False
        offset: np.ndarray = self._square[w, flies] - self.aviary.swarm.position[w, i, :2]
        return offset

    def _pads(self, w: int, i: int) -> np.ndarray:
        """Return the pads, of which those that others fly down to count as taken."""
        pads = super()._pads(w, i).copy()
        taken = self.aviary.alive[w] & (self._mode[w] == CHARGES)
        # Drones that wait fly level
        taken &= self._target[w, :, 2] < 0.5 * self.height
        taken[i] = False
        if taken.any():
            place = self.aviary.swarm.position[w, i, :2] + pads[:, :2]
            nearest = pairwise_distances(place, self._target[w, taken, :2]).min(axis=1)
            pads[nearest < SAME_PAD, 3] = 1.0
        return pads
