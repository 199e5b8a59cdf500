"""Policies that avoid the task `formation`. All of them avoid collisions, as `orca` does."""

from abc import abstractmethod

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.oracles.formation import FormationPilot
from bulletuav.policies.orca import Orca
from bulletuav.policies.shirkers.displaced import HALF, LATE
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.formation import Formation
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.formations import Leader, in_world
from bulletuav.vehicle.swarm import Swarm

UP = np.array((0.0, 0.0, 1.0))
ABOVE = 8.0
"""Height above the own place, m"""
SHIFT = 15.0
"""Displacement of the whole formation, m"""


class FormationShirker(Orca):
    """Base class of policies that fly to other positions than their places."""

    def __init__(self, aviary: Aviary) -> None:
        """Check the task; see `Policy`.

        Raises:
            ValueError: If the task is not `formation`.
        """
        super().__init__(aviary)
        self._plan = require_supported_task(self, Formation).plan

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic, with other goals; see `Avoidance.traffic`."""
        goal, goal_velocity = self.targets()
        traffic = super().traffic(observations, swarm)
        return traffic._replace(goal=goal - swarm.position, goal_velocity=goal_velocity)

    @abstractmethod
    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions, m, and velocities, m/s, to fly to, (W, N, 3) each."""

    def _in_world(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities of places (W, N, 3) in the leader's frame, m."""
        memory = self.aviary.scene.memory
        leader, turn = memory["leader"], memory["turn"]
        return in_world(place, Leader(leader[:, :3], memory["leader_velocity"], leader[:, 3], turn))


@register("policy")
class FormationUnchanged(FormationShirker):
    """Hold the first place for the whole episode, without any change of shape or place."""

    name = "formation_unchanged"
    remembers = ("_first",)

    def __init__(self, aviary: Aviary) -> None:
        """Start without places; see `Policy`."""
        super().__init__(aviary)
        self._first = np.full(aviary.alive.shape, -1)

    def reset(self, mask: np.ndarray) -> None:
        """Drop the places of the worlds in `mask` (W,)."""
        self._first[mask] = -1

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the first places in the first shape; see `FormationShirker.targets`."""
        place = self.aviary.scene.memory["place"].astype(np.int64)
        self._first = np.where(self._first < 0, place, self._first)
        return self._in_world(self._plan.shapes[0, self._first])


@register("policy")
class FormationLate(FormationShirker):
    """Hover above the own place, clear of all others, and descend at the end of the episode."""

    name = "formation_late"

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions above the places; see `FormationShirker.targets`."""
        aviary = self.aviary
        late = aviary.steps >= LATE * aviary.options.horizon
        above = np.where(late, 0.0, ABOVE)[:, None, None] * UP
        return aviary.scene.goal + above, aviary.scene.goal_velocity


@register("policy")
class FormationHalf(FormationPilot):
    """Hold the own place for half of the episode, then climb away from the formation."""

    name = "formation_half"

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command a climb in the second half; see `Policy.act`."""
        aviary = self.aviary
        leaves = aviary.steps >= HALF * aviary.options.horizon
        climb = self.encoded(np.zeros(swarm.position.shape) + aviary.options.max_speed * UP)
        return np.where(leaves[:, None, None], climb, super().act(observations, swarm))


@register("policy")
class FormationNeighbour(FormationShirker):
    """Hold the place of the next drone, so that the shape is filled by the wrong drones."""

    name = "formation_neighbour"

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the places of other drones; see `FormationShirker.targets`."""
        scene = self.aviary.scene
        return np.roll(scene.goal, 1, axis=1), np.roll(scene.goal_velocity, 1, axis=1)


@register("policy")
class FormationShifted(FormationShirker):
    """Hold a perfect shape beside the leader instead of around it."""

    name = "formation_shifted"

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return shifted places; see `FormationShirker.targets`."""
        scene = self.aviary.scene
        return scene.goal + np.array((SHIFT, 0.0, 0.0)), scene.goal_velocity


@register("policy")
class FormationOnLeader(FormationShirker):
    """Fly to the leader, as near as the other drones permit."""

    name = "formation_on_leader"

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the position of the leader; see `FormationShirker.targets`."""
        return self._in_world(np.zeros(self.aviary.scene.goal.shape))
