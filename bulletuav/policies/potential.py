"""Policy `potential`: an artificial potential field.

The goal attracts; drones, obstacles and the ground repel. Velocities take the place of forces.

References:
    O. Khatib, Real-time obstacle avoidance for manipulators and mobile robots (1986).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.rotation import Vec3, dot, vec3
from bulletuav.policies.base import Policy
from bulletuav.policies.straight import preferred_velocity
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

INFLUENCE = 8.0
"""Influence distance of the repulsion, in d_safe: two drones that approach at 20 m/s have a
second to turn"""
STRENGTH = 4.0
"""Strength of the repulsion, in max_speed; at twice this value, formations 12 m apart keep
drones off their goals"""
SURFACES = 0.5
"""Length scale of surfaces, in d_safe: contact is to be avoided only, and goals may be near
surfaces"""
CONTACT = 0.01
"""Distance below which the repulsion is constant, in d_safe"""


class Field(NamedTuple):
    """Parameters of the repulsion.

    Attributes:
        strength: Repulsive speed at a distance of one length scale, far below the influence
            distance, m/s.
        drones: Length scale of the repulsion from drones, m.
        surfaces: Length scale of the repulsion from surfaces, m.
        influence: Influence distance, beyond which nothing repels, m.
        contact: Distance below which the repulsion is constant, m.
        body: Radius of a drone, m.
    """

    strength: float
    drones: float
    surfaces: float
    influence: float
    contact: float
    body: float


def make_field(aviary: Aviary, surfaces: float = SURFACES) -> Field:
    """Compute the field parameters for the drones of an aviary.

    Args:
        aviary: The controlled worlds.
        surfaces: Length scale of the repulsion from surfaces, in d_safe; 0 for none.
    """
    body = aviary.task.context.collision_radius
    scale = float(max(aviary.task.config.d_safe, 2 * body))
    return Field(
        strength=STRENGTH * aviary.options.max_speed,
        drones=scale,
        surfaces=surfaces * scale,
        influence=INFLUENCE * scale,
        contact=CONTACT * scale,
        body=body,
    )


@register("policy")
class PotentialField(Policy):
    """Flight to the goal with repulsion from active drones, obstacles and the ground.

    Obstacles are represented by their bounding spheres. A drone may get stuck in a local minimum,
    where attraction and repulsion cancel. The policy does not land.
    """

    name = "potential"
    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Add the attraction of policy `straight` and `repulsion`; see `Policy.act`.

        The sum is limited to max_speed.
        """
        aviary = self.aviary
        scene = aviary.scene
        speed = aviary.options.max_speed
        radius = np.array([obstacle.radius for obstacle in aviary.task.obstacles()])
        wanted = preferred_velocity(scene.goal - swarm.position, scene.goal_velocity, speed)
        push = repulsion(swarm.position, aviary.alive, scene.obstacle, radius, make_field(aviary))
        return self.encoded(limit_norm(wanted + push, speed))


@allocating
def repulsion(
    position: np.ndarray,
    alive: np.ndarray,
    obstacle: np.ndarray,
    obstacle_radius: np.ndarray,
    field: Field,
) -> np.ndarray:
    """Compute the repulsive velocities away from active drones, obstacles and the ground.

    Distances between drones are measured between centres, as in d_safe; all other distances between
    surfaces.

    Args:
        position: (W, N, 3) positions of the drones, m.
        alive: (W, N) bool, which drones fly.
        obstacle: (W, K, 3) centres of spheres, m.
        obstacle_radius: (K,) radii of the spheres, m.
        field: Parameters of the repulsion.

    Returns:
        (W, N, 3) velocities, m/s; zero for drones that do not fly.
    """
    result = np.zeros(position.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not alive[w, i]:
                continue
            # Other drones, between centres.
            for j in range(alive.shape[1]):
                if j != i and alive[w, j]:
                    away = offset(position, w, j, i)
                    _push(result, w, i, away, 0.0, field.drones, field)
            # Obstacles, between surfaces.
            here = vec3(position, w, i)
            for k in range(obstacle_radius.size):
                away = (
                    here[0] - obstacle[w, k, 0],
                    here[1] - obstacle[w, k, 1],
                    here[2] - obstacle[w, k, 2],
                )
                radius = obstacle_radius[k] + field.body
                _push(result, w, i, away, radius, field.surfaces, field)
            # The ground, at height 0.
            up = (0.0, 0.0, here[2])
            _push(result, w, i, up, field.body, field.surfaces, field)
    return result


@func
def _push(
    result: np.ndarray, w: int, i: int, away: Vec3, radius: float, scale: float, field: Field
) -> None:
    """Add the repulsion along `away`; the surface of the body is at `radius` from its centre."""
    length = math.sqrt(dot(away, away))
    size = strength(length - radius, scale, field) / max(length, field.contact)
    for axis in range(3):
        result[w, i, axis] += size * away[axis]


@func
def strength(distance: float, scale: float, field: Field) -> float:
    """Compute the repulsive speed, the negative derivative of the potential.

    The potential is U = eta / 2 (1 / rho - 1 / rho0)^2 for rho < rho0, with eta = strength scale^3;
    the speed is -dU/drho (Khatib 1986).

    Args:
        distance: Distance rho from the body, m.
        scale: Length scale of the repulsion, m.
        field: Parameters of the repulsion; rho0 is the influence distance.

    Returns:
        The speed, m/s.
    """
    # Zero beyond the influence distance, constant below the contact distance.
    rho = max(distance, field.contact)
    inverse = 1.0 / rho - 1.0 / field.influence
    return field.strength * scale**3 * max(inverse, 0.0) / (rho * rho)
