"""Policies of chasers: `pure_pursuit`, `lead` and `area_minimising`."""

import numpy as np

from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.policies.game import Game
from bulletuav.policies.intercept import interception, shared_face
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class PurePursuit(Game):
    """Flight at full speed to where the nearest opponent is now."""

    name = "pure_pursuit"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the way to the goal; see `Game.velocities`."""
        return self.full(self.aviary.scene.goal - swarm.position)


@register("policy")
class Lead(Game):
    """Flight at full speed to where the nearest opponent will be, if it flies straight on."""

    name = "lead"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose `constant_bearing`; see `Game.velocities`."""
        scene = self.aviary.scene
        return interception(swarm.position, scene.goal, scene.goal_velocity, self.speed)


CLOSE = 15.0
"""Distance from the opponent at which the face no longer counts, m: its middle is then aside"""


@register("policy")
class AreaMinimising(Game):
    """Flight that makes the room smaller in which the nearest opponent is first.

    That is its Voronoi cell among the drone's team. Each drone whose cell is beside it flies to the
    middle of the face between the two. The others, and those that are close, fly at it as `lead`
    does. In two dimensions: H. Huang et al., Guaranteed decentralized
    pursuit-evasion in the plane with multiple pursuers (2011); Z. Zhou et al., Cooperative pursuit
    with Voronoi partitions (2016). In a box the cell is a volume, and its gradient by a drone's
    place is along the same line.
    """

    name = "area_minimising"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the way to the shared face; see `Game.velocities`."""
        position, task, scene = swarm.position, self.aviary.task, self.aviary.scene
        face, is_beside = np.zeros(position.shape), np.zeros(position.shape[:2], dtype=bool)
        low, high = self.box
        far = paired_distances(scene.goal, position) > CLOSE
        chasing = self.aviary.alive & self.opponents().any(axis=2) & far
        for w, i in np.argwhere(chasing).tolist():
            mates = np.flatnonzero(self.aviary.alive[w] & (task.team == task.team[i]))
            among = int(np.searchsorted(mates, i))
            told = shared_face(scene.goal[w, i], position[w, mates], among, low, high)
            is_beside[w, i], face[w, i] = told
        lead = interception(position, scene.goal, scene.goal_velocity, self.speed)
        return np.where(is_beside[..., None], self.full(face - position), lead)
