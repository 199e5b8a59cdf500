"""Policy `formation_pilot`: changes places in altitude layers, with collision avoidance."""

import numpy as np

from bulletuav.compiled.functions import hypot
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import MARGIN
from bulletuav.policies.orca import Orca
from bulletuav.registry import register
from bulletuav.tasks.formation import Formation
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.formations import max_place_speed
from bulletuav.vehicle.swarm import Swarm

LAYER_MARGIN = 0.5
"""Vertical distance between layers beyond the separation that drones maintain, m"""
FUNNEL = (2.0, 8.0)
"""Horizontal distances from the place at which a drone ends its descent and starts it, m; the
upper one is below the default spacing of places"""
LAYER_TOLERANCE = 3.0
"""Altitude error at which a drone moves horizontally at half speed, m"""
APPROACH = 1.5
"""Gain from distance to speed, 1/s"""
REASSIGNED_EVERY = 0.5
"""Time between assignments of layers, s"""
SAMPLES = 100
"""Number of times at which distances between paths are computed"""


@register("policy")
class FormationPilot(Orca):
    """Flight to the own place in a formation, in altitude layers where direct paths conflict.

    Policy `orca` in the plane of the formation gets blocked: drones that hold their places close
    the way of those that cross the formation. With this policy, drones whose straight paths to
    their places conflict fly them at different altitudes: layers are the colours of a greedy
    colouring of the graph of conflicts. A drone climbs or descends to its layer, flies there, and
    returns to the altitude of the formation above or below its place. Layers are farther apart
    than the separation, so that ORCA resolves only deviations, and conflicts with obstacles.

    Layers are assigned again every REASSIGNED_EVERY, as drones deviate and places change.
    """

    name = "formation_pilot"
    remembers = ("_layer",)

    def __init__(self, aviary: Aviary) -> None:
        """Find the layers that fit into the arena, and the speed relative to places; see `Policy`.

        Raises:
            ValueError: If the task is not `formation`.
        """
        super().__init__(aviary)
        task = aviary.task
        if not isinstance(task, Formation):
            raise ValueError(
                f"policy {self.name!r} supports task 'formation', not {task.name!r}: choose "
                f"another policy"
            )
        step = self.parameters.separation + LAYER_MARGIN
        altitude, body = task.config.altitude, self.clearance.body + MARGIN
        below = int(max(altitude - body, 0.0) / step)
        above = int(max(task.arena_high[2] - body - altitude, 0.0) / step)
        layers = np.arange(-below, above + 1) * step
        self._layers = layers[np.argsort(np.abs(layers), kind="stable")]
        places, turn = task.plan.shapes.reshape(-1, 3), task.course.turn
        fastest = max_place_speed(places, task.config.leader_speed, turn)
        self._speed = self.parameters.max_speed - fastest
        self.parameters = self.parameters._replace(horizon=2.0)
        self._every = max(1, round(REASSIGNED_EVERY / task.context.period))
        self._layer = np.zeros(aviary.alive.shape, dtype=np.int64)

    def reset(self, mask: np.ndarray) -> None:
        """Drop the layers of the worlds in `mask` (W,)."""
        self._layer[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command ORCA velocities close to those of `_preferred`; see `Policy.act`."""
        aviary, speed = self.aviary, self._speed
        is_due = aviary.alive.any(axis=1) & (aviary.steps % self._every == 0)
        for w in np.flatnonzero(is_due).tolist():
            i = np.flatnonzero(aviary.alive[w])
            paths = (swarm.position[w, i], aviary.scene.goal[w, i])
            separation, layers = self.parameters.separation, len(self._layers)
            self._layer[w, i] = assign_layers(*paths, self._layer[w, i], speed, separation, layers)
        traffic = self.traffic(observations, swarm)
        preferred = self._preferred(traffic.goal, traffic.goal_velocity)
        return self.encoded(self.avoid(traffic, preferred, self.parameters))

    def _preferred(self, goal: np.ndarray, goal_velocity: np.ndarray) -> np.ndarray:
        """Return velocities to the layer, along it, and to the place.

        Args:
            goal: (W, N, 3) offsets to the places, m.
            goal_velocity: (W, N, 3) velocities of the places, m/s.

        Returns:
            (W, N, 3) m/s.
        """
        inner, outer = FUNNEL
        distance = hypot(goal[..., 0], goal[..., 1])
        away = np.clip((distance - inner) / (outer - inner), 0.0, 1.0)
        climb = goal[..., 2] + away * self._layers[self._layer]
        # Wait for the layer before leaving the own column
        error = climb / LAYER_TOLERANCE
        pace = 1.0 / (1.0 + error * error)
        velocity = (
            limit_norm(APPROACH * goal * (1.0, 1.0, 0.0), self.parameters.max_speed)
            * pace[..., None]
        )
        velocity[..., 2] = np.clip(APPROACH * climb, -self._speed, self._speed)
        velocity += goal_velocity
        return limit_norm(velocity, self.parameters.max_speed)


def assign_layers(
    start: np.ndarray,
    goal: np.ndarray,
    current: np.ndarray,
    speed: float,
    separation: float,
    num_layers: int,
) -> np.ndarray:
    """Assign layers to drones so that straight paths in one layer do not conflict.

    All drones fly at the same speed. Drones that are near their goals keep their layers, but count
    as drones in layer 0, which they return to. The others choose the layer with the fewest
    conflicts, those with the longest paths first; the current layer is preferred to others with as
    many conflicts, and then the first one.

    Args:
        start: (N, 3) positions, m.
        goal: (N, 3) goals, m.
        current: (N,) index of each drone's current layer.
        speed: Speed of all drones, m/s.
        separation: Distance below which drones are in conflict, m.
        num_layers: Number of layers.

    Returns:
        (N,) index of each drone's layer.
    """
    way = (goal - start)[:, :2]
    length = hypot(way[:, 0], way[:, 1])
    is_near = length < FUNNEL[1]
    if is_near.all():
        return current
    time = np.linspace(0.0, length.max() / speed, SAMPLES)[:, None]
    fraction = np.minimum(speed * time / np.maximum(length, FUNNEL[0]), 1.0)
    path = start[:, :2] + fraction[..., None] * way
    in_conflict = np.zeros((len(start), len(start)), dtype=bool)
    for at in path:
        offset = at[:, None] - at
        in_conflict |= (offset**2).sum(axis=-1) < separation**2
    layer = np.zeros(len(start), dtype=np.int64)
    is_assigned = is_near.copy()
    for i in np.argsort(-length, kind="stable").tolist():
        if not is_near[i]:
            cost = np.bincount(layer[is_near & in_conflict[i]], minlength=num_layers) + 0.5
            cost[current[i]] -= 0.5
            layer[i] = cost.argmin()
            is_assigned[i] = True
    return np.where(is_near, current, layer)
