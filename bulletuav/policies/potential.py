"""Policy `potential`: an artificial potential field.

The goal attracts; drones, obstacles and the ground repel. O. Khatib, Real-time obstacle avoidance
for manipulators and mobile robots (1986), with velocities in place of forces.
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
"""Reach of the repulsion, d_safe: two drones that meet at 20 m/s have a second to turn"""
STRENGTH = 4.0
"""Strength, max_speed: with twice as much, formations 12 m apart keep drones off their goals"""
SURFACES = 0.5
"""Scale of surfaces, d_safe: these need only not be touched, and goals may be near them"""
CONTACT = 0.01
"""Distance below which the repulsion grows no more, d_safe"""


class Field(NamedTuple):
    """Parameters of the repulsion.

    Attributes:
        strength: Speed of the push at a distance of one scale, far within the influence, m/s.
        drones: Scale of the repulsion from drones, m.
        surfaces: Scale of the repulsion from surfaces, m.
        influence: Distance beyond which nothing repels, m.
        contact: Distance below which the repulsion grows no more, m.
        body: Radius of a drone, m.
    """

    strength: float
    drones: float
    surfaces: float
    influence: float
    contact: float
    body: float


def make_field(aviary: Aviary, surfaces: float = SURFACES) -> Field:
    """Make the field for the drones of an aviary.

    Args:
        aviary: The worlds that are flown.
        surfaces: Scale of the repulsion from surfaces, d_safe; 0 for none.
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
    """Flight towards the goal, repelled by living drones, obstacles and the ground.

    Obstacles are known by their bounding spheres. A drone may get stuck where all that acts on it
    cancels. It does not land.
    """

    name = "potential"
    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Add attraction, as of policy `straight`, and `repulsion`; see `Policy.act`.

        Together they are limited to max_speed.
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
    """Compute velocities away from living drones, obstacles and the ground.

    Distances are between centres of drones, as in d_safe, but from the surfaces of other bodies
    to that of the drone.

    Args:
        position: (W, N, 3) positions of the drones, m.
        alive: (W, N) bool, which of them fly.
        obstacle: (W, K, 3) centres of balls, m.
        obstacle_radius: (K,) their radii, m.
        field: The field's parameters.

    Returns:
        (W, N, 3) velocities, m/s; zero for drones that do not fly.
    """
    result = np.zeros(position.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not alive[w, i]:
                continue
            # Other drones, centre from centre.
            for j in range(alive.shape[1]):
                if j != i and alive[w, j]:
                    away = offset(position, w, j, i)
                    _push(result, w, i, away, 0.0, field.drones, field)
            # Obstacles, surface from surface.
            here = vec3(position, w, i)
            for k in range(obstacle_radius.size):
                away = (
                    here[0] - obstacle[w, k, 0],
                    here[1] - obstacle[w, k, 1],
                    here[2] - obstacle[w, k, 2],
                )
                radius = obstacle_radius[k] + field.body
                _push(result, w, i, away, radius, field.surfaces, field)
            # The ground, which is at height 0.
            up = (0.0, 0.0, here[2])
            _push(result, w, i, up, field.body, field.surfaces, field)
    return result


@func
def _push(
    result: np.ndarray, w: int, i: int, away: Vec3, radius: float, scale: float, field: Field
) -> None:
    """Add the push along `away` from a body's centre, whose surface is `radius` nearer."""
    length = math.sqrt(dot(away, away))
    size = strength(length - radius, scale, field) / max(length, field.contact)
    for axis in range(3):
        result[w, i, axis] += size * away[axis]


@func
def strength(distance: float, scale: float, field: Field) -> float:
    """Compute the speed away from a body, as the potential's derivative (Khatib 1986).

    It is -dU/drho of U = eta / 2 (1 / rho - 1 / rho0)^2 within rho0, where
    eta = strength scale^3.

    Args:
        distance: Distance rho from the body, m.
        scale: Distance at which the repulsion has its strength, m.
        field: The field's parameters; rho0 is its influence.

    Returns:
        The speed, m/s.
    """
    # Beyond the influence there is none, within contact it grows no more.
    rho = max(distance, field.contact)
    inverse = 1.0 / rho - 1.0 / field.influence
    return field.strength * scale**3 * max(inverse, 0.0) / (rho * rho)
