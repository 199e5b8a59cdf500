"""Policy `formation_pilot`: changes places above or below the formation where it is blocked."""

import numpy as np

from bulletuav.compiled.functions import hypot
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.orca import Orca
from bulletuav.registry import register
from bulletuav.tasks.formation import Formation
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 1.5
"""Time horizon of conflict detection, s: neighbours in a formation are nearer than elsewhere"""
BYPASS_MARGIN = 0.5
"""Vertical distance from the formation beyond the separation that drones maintain, m"""
FUNNEL = (2.0, 8.0)
"""Horizontal distances from the place at which a drone ends its return to the altitude of the
formation and starts it, m; the upper one is below the default spacing of places"""
ALTITUDE_TOLERANCE = 3.0
"""Altitude error at which a drone moves horizontally at half speed, m"""
APPROACH = 1.5
"""Gain from distance to speed, 1/s"""
BRAKING = 5.0
"""Deceleration towards the place, m/s^2: drones that have to tilt stop by it without overshoot"""


@register("policy")
class FormationPilot(Orca):
    """Flight to the own place in a formation, over or under drones that hold their places.

    Policy `orca` gets blocked in the plane of a formation: drones that hold their places close the
    way of those that cross it. With this policy a drone whose straight path is blocked in this way
    climbs or descends, flies above or below the formation, and returns to its altitude at its
    place. ORCA resolves the other conflicts.
    """

    name = "formation_pilot"
    remembers = ("_bypasses",)

    def __init__(self, aviary: Aviary) -> None:
        """Set the altitudes of bypasses; see `Policy`.

        Raises:
            ValueError: If the task is not `formation`.
        """
        super().__init__(aviary)
        task = require_supported_task(self, Formation)
        self.parameters = self.parameters._replace(horizon=HORIZON)
        height = self.parameters.separation + BYPASS_MARGIN
        # Every second drone flies below the formation if the ground permits
        flies_below = np.arange(aviary.num_drones) % 2 > 0
        flies_below &= task.config.altitude > height + self.clearance.body
        self._height = np.where(flies_below, -height, height)
        self._bypasses = np.zeros(aviary.alive.shape, dtype=bool)

    def reset(self, mask: np.ndarray) -> None:
        """End the bypasses in the worlds in `mask` (W,)."""
        self._bypasses[mask] = False

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command ORCA velocities close to those of `_preferred`; see `Policy.act`."""
        traffic = self.traffic(observations, swarm)
        distance = hypot(traffic.goal[..., 0], traffic.goal[..., 1])
        holds = self.aviary.alive & (distance < FUNNEL[1])
        blocked = find_blocked(swarm.position, traffic.goal, holds, self.parameters.separation)
        self._bypasses |= blocked & ~holds
        self._bypasses &= distance > FUNNEL[0]
        preferred = self._preferred(traffic.goal, distance) + traffic.goal_velocity
        preferred = limit_norm(preferred, self.parameters.max_speed)
        return self.encoded(self.avoid(traffic, preferred, self.parameters))

    def _preferred(self, goal: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Return velocities relative to the places: to the altitude of the bypass, and along it.

        Args:
            goal: (W, N, 3) offsets to the places, m.
            distance: (W, N) horizontal distances to the places, m.

        Returns:
            (W, N, 3) m/s.
        """
        inner, outer = FUNNEL
        away = np.clip((distance - inner) / (outer - inner), 0.0, 1.0)
        climb = goal[..., 2] + away * np.where(self._bypasses, self._height, 0.0)
        # Climb or descend before leaving the own column
        error = climb / ALTITUDE_TOLERANCE
        pace = 1.0 / (1.0 + error * error)
        fastest = self.parameters.max_speed
        fastest_stop = np.sqrt(2.0 * BRAKING * distance)
        speed = np.minimum(np.minimum(APPROACH * distance, fastest_stop), fastest) * pace
        velocity: np.ndarray = goal * (1.0, 1.0, 0.0) * (speed / np.maximum(distance, 1e-9))[..., None]
        velocity[..., 2] = np.clip(APPROACH * climb, -fastest, fastest)
        return velocity


def find_blocked(
    position: np.ndarray, goal: np.ndarray, holds: np.ndarray, separation: float
) -> np.ndarray:
    """Return which drones' straight paths are blocked by drones that hold their places.

    Args:
        position: (W, N, 3) m.
        goal: (W, N, 3) offsets to the goals, m; only the horizontal parts matter.
        holds: (W, N) bool, drones that hold their places.
        separation: Horizontal distance from a path at which a drone blocks it, m.

    Returns:
        (W, N) bool.
    """
    x, y = np.moveaxis(position[:, None, :, :2] - position[:, :, None, :2], -1, 0)
    to_x, to_y = goal[..., 0, None], goal[..., 1, None]
    # Nearest point of each path to each other drone, as a fraction of the path
    square = np.maximum(to_x * to_x + to_y * to_y, 1e-9)
    fraction = np.clip((x * to_x + y * to_y) / square, 0.0, 1.0)
    distance = hypot(x - fraction * to_x, y - fraction * to_y)
    is_other = ~np.eye(position.shape[1], dtype=bool)
    blocked: np.ndarray = ((distance < separation) & holds[:, None] & is_other).any(axis=-1)
    return blocked
