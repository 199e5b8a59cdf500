"""Policy `rescue_oracle`: flies to the victims of task `search`, whose places it knows."""

import numpy as np

from bulletuav.policies.search import Sweep
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class RescueOracle(Sweep):
    """Policy `sweep` in which drones see the victims at any distance, each drone another one.

    Pairs of drones and victims that are not found are chosen from the nearest pair on.
    """

    name = "rescue_oracle"
    reads_swarm = True

    def sightings(self, seen: dict[str, np.ndarray], swarm: Swarm) -> tuple[np.ndarray, np.ndarray]:
        """Return the true offsets to the victims of the drones; see `Sweep.sightings`."""
        scene, alive = self.aviary.scene, self.aviary.alive
        offset = self._task.tops(scene)[:, None] - swarm.position[:, :, None]
        distance = np.sqrt((offset[..., :2] ** 2).sum(axis=-1))
        is_left = scene.memory["found_at"] == 0
        distance = np.where(alive[..., None] & is_left[:, None], distance, np.inf)
        is_seen, chosen = np.zeros(alive.shape, dtype=bool), np.zeros(swarm.position.shape)
        for w, gaps in enumerate(distance):
            for _ in range(min(gaps.shape)):
                i, j = np.unravel_index(int(gaps.argmin()), gaps.shape)
                if not np.isfinite(gaps[i, j]):
                    break
                is_seen[w, i], chosen[w, i] = True, offset[w, i, j]
                gaps[i], gaps[:, j] = np.inf, np.inf
        return is_seen, chosen
