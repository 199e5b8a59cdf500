"""Policies of pursuers: `pure_pursuit`, `lead` and `area_minimising`."""

import numpy as np

from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.policies.game import Game
from bulletuav.policies.intercept import interception, shared_face
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class PurePursuit(Game):
    """Flight at full speed to the current position of the nearest opponent."""

    name = "pure_pursuit"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities straight to the goal; see `Game.velocities`."""
        return self.full(self.aviary.scene.goal - swarm.position)


@register("policy")
class Lead(Game):
    """Flight at full speed to the intercept point of the nearest opponent at constant velocity."""

    name = "lead"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities by `constant_bearing`; see `Game.velocities`."""
        scene = self.aviary.scene
        return interception(swarm.position, scene.goal, scene.goal_velocity, self.speed)


CLOSE = 15.0
"""Distance to the opponent below which the shared face is ignored, m: its centroid is then off
to the side"""


@register("policy")
class AreaMinimising(Game):
    """Pursuit that minimises the Voronoi cell of the nearest opponent among the drone's team.

    A drone whose cell shares a face with that of the opponent flies to the centroid of the face.
    All other drones, and those close to the opponent, fly as in `lead`. In a box the cell is a
    volume, and the gradient of the volume with respect to the position of a drone has the same
    direction as in the plane.

    References:
        In two dimensions: H. Huang et al., Guaranteed decentralized pursuit-evasion in the plane
        with multiple pursuers (2011); Z. Zhou et al., Cooperative pursuit with Voronoi partitions
        (2016).
    """

    name = "area_minimising"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the shared faces; see `Game.velocities`."""
        position, task, scene = swarm.position, self.aviary.task, self.aviary.scene
        face, is_beside = np.zeros(position.shape), np.zeros(position.shape[:2], dtype=bool)
        low, high = self.box
        far = paired_distances(scene.goal, position) > CLOSE
        chasing = self.aviary.alive & self.opponents().any(axis=2) & far
        for w, i in np.argwhere(chasing).tolist():
            mates = np.flatnonzero(self.aviary.alive[w] & (task.team == task.team[i]))
            among = int(np.searchsorted(mates, i))
            found = shared_face(scene.goal[w, i], position[w, mates], among, low, high)
            is_beside[w, i], face[w, i] = found
        lead = interception(position, scene.goal, scene.goal_velocity, self.speed)
        return np.where(is_beside[..., None], self.full(face - position), lead)
