"""Policy `potential`: an artificial potential field, attraction to the goal and repulsion from all else that is near.

O. Khatib, Real-time obstacle avoidance for manipulators and mobile robots (1986), with velocities in place of forces.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.kernel import func, kernel
from bulletuav.policies.base import Policy
from bulletuav.policies.straight import preferred_velocity
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

INFLUENCE = 8.0  # d_safe; two drones that meet at 20 m/s have a second to turn
STRENGTH = 4.0  # max_speed; with twice as much, formations 12 m apart keep drones off their goals
SURFACES = 0.5  # d_safe; scale of the push from surfaces, which need only not be touched: goals may be near them
CONTACT = 0.01  # d_safe; nearer than this the push grows no more


class Field(NamedTuple):
    """Strength of the repulsion, m/s; scales for drones and surfaces, influence, least distance, radius of a drone, m."""

    strength: float
    drones: float
    surfaces: float
    influence: float
    contact: float
    body: float


def make_field(aviary: Aviary, surfaces: float = SURFACES) -> Field:
    """The field for the drones of an aviary; `surfaces` is the scale of the push from these, d_safe."""
    body = aviary.task.context.collision_radius
    scale = float(max(aviary.task.config.d_safe, 2 * body))
    return Field(
        STRENGTH * aviary.options.max_speed,
        scale,
        surfaces * scale,
        INFLUENCE * scale,
        CONTACT * scale,
        body,
    )


class PotentialField(Policy):
    """Towards the goal, pushed off by living drones, obstacles (bounding spheres) and the ground; it may get stuck."""

    name = "potential"
    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """The attraction, like that of policy `straight`, and `repulsion`, together limited to max_speed."""
        aviary, scene, task = self.aviary, self.aviary.scene, self.aviary.task
        speed = aviary.options.max_speed
        radius = np.array([obstacle.radius for obstacle in task.obstacles()])
        wanted = preferred_velocity(scene.goal, scene.goal_velocity, swarm.position, speed)
        push = repulsion(swarm.position, aviary.alive, scene.obstacle, radius, make_field(aviary))
        return self.encoded(limit_norm(wanted + push, speed))


@kernel
def repulsion(position, alive, obstacle, obstacle_radius, field):
    """Velocities (W, N, 3), m/s, away from living drones (W, N), balls (W, K, 3) m, (K,) m and the ground; else zero.

    Distances are between centres of drones, as in d_safe, but from the surfaces of other bodies to that of the drone.
    """
    result = np.zeros(position.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not alive[w, i]:
                continue
            for j in range(alive.shape[1]):
                if j != i and alive[w, j]:
                    _push(result, w, i, offset(position, w, j, i), 0.0, field.drones, field)
            here = vec3(position, w, i)
            for k in range(obstacle_radius.size):
                away = (
                    here[0] - obstacle[w, k, 0],
                    here[1] - obstacle[w, k, 1],
                    here[2] - obstacle[w, k, 2],
                )
                _push(result, w, i, away, obstacle_radius[k] + field.body, field.surfaces, field)
            _push(result, w, i, (0.0, 0.0, here[2]), field.body, field.surfaces, field)
    return result


@func
def _push(result, w, i, away, radius, scale, field):
    """Add the push along `away` from a body's centre, whose surface is `radius` nearer."""
    length = math.sqrt(dot(away, away))
    size = strength(length - radius, scale, field) / max(length, field.contact)
    for axis in range(3):
        result[w, i, axis] += size * away[axis]


@func
def strength(distance, scale, field):
    """-dU/drho of U = eta / 2 (1 / rho - 1 / rho0)^2 within rho0, with eta = strength scale^3, m/s (Khatib 1986)."""
    rho = max(distance, field.contact)
    inverse = 1.0 / rho - 1.0 / field.influence
    return field.strength * scale**3 * max(inverse, 0.0) / (rho * rho)
