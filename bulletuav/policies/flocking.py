"""Policies `reynolds`, `olfati_saber` and `vasarhelyi` of the task `flocking`.

All three read observations only, fly level at the altitude of the leader, and share the feedback
from the leader: its velocity, and a pull towards it from beyond the radius of a lattice of the
whole flock. The pull of the papers on every drone would compress large flocks. Without a leader
drones keep their direction of motion at the speed of the flock.

References:
    C. Reynolds, Flocks, herds, and schools: a distributed behavioral model (1987).
    R. Olfati-Saber, Flocking for multi-agent dynamic systems: algorithms and theory (2006).
    G. Vasarhelyi et al., Optimized flocking of autonomous drones in confined environments (2018).
"""

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos
from bulletuav.compiled.kernel import allocating, func
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.observed import Observed
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.flocking import Flocking

PULL = 0.5
"""Gain from the distance beyond the radius of the lattice to the speed towards the leader, 1/s"""
MAX_PULL = 4.0
"""Maximum speed towards the leader, relative to it, m/s"""
CLIMB = 1.0
"""Gain from the altitude error to the climb speed, 1/s"""
MAX_CLIMB = 3.0
"""Maximum climb speed, m/s"""
TINY = 1e-9
"""Minimum length of a vector that has a direction, m or m/s"""
Vec2 = tuple[float, float]


class FlockRules(NamedTuple):
    """Numbers of the task that the policies use.

    Attributes:
        spacing: Distance between neighbours, m.
        link_range: Distance at which two drones are linked, m.
        radius: Distance from the leader beyond which drones fly towards it, m.
        speed: Speed of the flock, m/s.
        leads: Whether there is a leader.
    """

    spacing: float
    link_range: float
    radius: float
    speed: float
    leads: bool


class FlockPolicy(Observed):
    """Base class of the flocking policies, which compute velocities by `avoid`.

    Attributes:
        rules: Numbers of the task.
    """

    needed = (("position",), ("velocity",), ("goal_offset",), ("goal_velocity",), ("neighbours",))

    def __init__(self, aviary: Aviary) -> None:
        """Read the numbers of the task; see `Policy`.

        Raises:
            ValueError: If the task is not `flocking`, or the observation lacks a block.
        """
        super().__init__(aviary)
        task = require_supported_task(self, Flocking)
        config = task.config
        self.rules = FlockRules(
            spacing=float(config.spacing),
            link_range=float(config.link_range),
            radius=task.lattice_radius,
            speed=float(config.flock_speed),
            leads=config.leader,
        )

    @abstractmethod
    def flock_velocities(self, traffic: Traffic) -> np.ndarray:
        """Return the velocities that the rules of the algorithm ask for, (W, N, 3) m/s."""

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return `flock_velocities`, limited to the maximum speed; see `Avoidance.avoid`."""
        return limit_norm(self.flock_velocities(traffic), parameters.max_speed)


@func
def _away(vectors: np.ndarray, row: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return the horizontal unit vector of vectors[w, i, k], and the horizontal length."""
    w, i, k = row
    x, y = vectors[w, i, k, 0], vectors[w, i, k, 1]
    length = math.sqrt(x * x + y * y)
    return x / max(length, TINY), y / max(length, TINY), length


@func
def _navigation(traffic: Traffic, rules: FlockRules, w: int, i: int) -> Vec2:
    """Return the velocity of the leader plus the pull, or without it the own course, m/s."""
    if not rules.leads:
        x, y = traffic.velocity[w, i, 0], traffic.velocity[w, i, 1]
        length = max(math.sqrt(x * x + y * y), TINY)
        return rules.speed * x / length, rules.speed * y / length
    x, y = traffic.goal[w, i, 0], traffic.goal[w, i, 1]
    distance = max(math.sqrt(x * x + y * y), TINY)
    pull = min(PULL * max(distance - rules.radius, 0.0), MAX_PULL) / distance
    return traffic.goal_velocity[w, i, 0] + pull * x, traffic.goal_velocity[w, i, 1] + pull * y


@func
def _store(result: np.ndarray, traffic: Traffic, velocity: Vec2, w: int, i: int) -> None:
    """Write a horizontal velocity, with the climb to the altitude of the leader."""
    result[w, i, 0], result[w, i, 1] = velocity
    result[w, i, 2] = min(max(CLIMB * traffic.goal[w, i, 2], -MAX_CLIMB), MAX_CLIMB)


@func
def _nearest_point(traffic: Traffic, w: int, i: int, k: int) -> tuple[float, float, float]:
    """Return the horizontal direction from an obstacle or wall, and the distance from it, m.

    The first rows are spheres, in their horizontal outline, and the others are surfaces. The
    distance is infinite for unused rows, floors and ceilings.
    """
    spheres = traffic.sphere_radius.shape[2]
    if k < spheres:
        if traffic.sphere_radius[w, i, k] <= 0.0:
            return 0.0, 0.0, np.inf
        x, y, length = _away(traffic.sphere, (w, i, k))
        return -x, -y, length - traffic.sphere_radius[w, i, k]
    row = k - spheres
    x, y = traffic.surface[w, i, row, 0], traffic.surface[w, i, row, 1]
    if x * x + y * y < 0.5:
        return 0.0, 0.0, np.inf
    return x, y, traffic.surface[w, i, row, 3]


@func
def braking_curve(distance: float, acceleration: float, gain: float) -> float:
    """Compute the speed D(r, a, p) from which a drone can stop within a distance, m/s.

    The speed grows linearly with the distance r near the stopping point, as p r, and from p r = a /
    p on with constant deceleration, as sqrt(2 a r - a^2 / p^2) (Vasarhelyi et al. 2018, eq. 3).

    Args:
        distance: r, m.
        acceleration: a, m/s^2.
        gain: p, 1/s.
    """
    if distance <= 0.0:
        return 0.0
    if distance * gain < acceleration / gain:
        return distance * gain
    return math.sqrt(2.0 * acceleration * distance - (acceleration / gain) ** 2)


# ---- Reynolds


class ReynoldsGains(NamedTuple):
    """Gains of the three rules of boids; Reynolds (1987) gives no values.

    Attributes:
        separation: Speed away from another drone at contact of centres, m/s.
        alignment: Fraction of the mean velocity difference to neighbours that is corrected.
        cohesion: Gain from the offset of the neighbours' centre to speed, 1/s.
        obstacles: Speed away from an obstacle at contact, m/s.
        reach: Distance at which obstacles repel, m.
    """

    separation: float
    alignment: float
    cohesion: float
    obstacles: float
    reach: float


REYNOLDS = ReynoldsGains(separation=12.0, alignment=0.3, cohesion=0.1, obstacles=12.0, reach=15.0)
"""Gains for drones that follow velocities with a lag of some tenths of a second"""


@register("policy")
class Reynolds(FlockPolicy):
    """Reynolds' boids: separation, velocity matching and flock centring among neighbours.

    Separation grows linearly within the spacing of the flock, matching and centring count
    neighbours within the link range. Obstacles and walls repel in the same way as drones.
    """

    name = "reynolds"

    def flock_velocities(self, traffic: Traffic) -> np.ndarray:
        """Return `reynolds_velocities`; see `FlockPolicy`."""
        return reynolds_velocities(traffic, self.rules, REYNOLDS)


@allocating
def reynolds_velocities(traffic: Traffic, rules: FlockRules, gains: ReynoldsGains) -> np.ndarray:
    """Compute the sum of the leader's velocity and the corrections of the three rules.

    Args:
        traffic: The traffic around each drone.
        rules: Numbers of the task.
        gains: Gains of the rules.

    Returns:
        (W, N, 3) m/s.
    """
    result = np.empty(traffic.velocity.shape)
    for w in range(traffic.velocity.shape[0]):
        for i in range(traffic.velocity.shape[1]):
            x, y = _navigation(traffic, rules, w, i)
            number, middle_x, middle_y, match_x, match_y = 0, 0.0, 0.0, 0.0, 0.0
            for k in range(traffic.known.shape[2]):
                to_x, to_y, distance = _away(traffic.offset, (w, i, k))
                if not traffic.known[w, i, k] or distance > rules.link_range:
                    continue
                number += 1
                middle_x += distance * to_x
                middle_y += distance * to_y
                match_x += traffic.other_velocity[w, i, k, 0] - traffic.velocity[w, i, 0]
                match_y += traffic.other_velocity[w, i, k, 1] - traffic.velocity[w, i, 1]
                push = gains.separation * max(1.0 - distance / rules.spacing, 0.0)
                x -= push * to_x
                y -= push * to_y
            if number > 0:
                x += (gains.cohesion * middle_x + gains.alignment * match_x) / number
                y += (gains.cohesion * middle_y + gains.alignment * match_y) / number
            for k in range(traffic.sphere_radius.shape[2] + traffic.surface.shape[2]):
                off_x, off_y, distance = _nearest_point(traffic, w, i, k)
                push = gains.obstacles * max(1.0 - max(distance, 0.0) / gains.reach, 0.0)
                x += push * off_x
                y += push * off_y
            _store(result, traffic, (x, y), w, i)
    return result


# ---- Olfati-Saber


class OlfatiSaberGains(NamedTuple):
    """Parameters of Olfati-Saber's algorithm.

    Attributes:
        epsilon: Parameter of the sigma-norm.
        slope: a = b of the action function phi, of the paper's simulations.
        bump: h of the bump function.
        gradient: c1 of the gradient term between drones.
        consensus: c2 of the consensus term between drones, 1/s.
        leader: c2 of the feedback of the leader's velocity, 1/s.
        obstacle_gradient: c1 of the gradient term of obstacles.
        obstacle_consensus: c2 of the consensus term of obstacles, 1/s.
        obstacle_bump: h of the bump function of obstacles.
        reach: Distance at which obstacles act, r', in units of the spacing.
        horizon: Time for which the acceleration is added to the velocity, s.
        max_acceleration: m/s^2.
    """

    epsilon: float
    slope: float
    bump: float
    gradient: float
    consensus: float
    leader: float
    obstacle_gradient: float
    obstacle_consensus: float
    obstacle_bump: float
    reach: float
    horizon: float
    max_acceleration: float


OLFATI_SABER = OlfatiSaberGains(
    epsilon=0.1,
    slope=5.0,
    bump=0.2,
    gradient=0.4,
    consensus=0.8,
    leader=1.0,
    obstacle_gradient=1.0,
    obstacle_consensus=0.5,
    obstacle_bump=0.9,
    reach=1.0,
    horizon=0.5,
    max_acceleration=8.0,
)
"""epsilon, a = b and both h of section VIII of the paper, which leaves the gains c1 and c2 open.
They are chosen for drones of limited acceleration"""


@register("policy")
class OlfatiSaber(FlockPolicy):
    """Olfati-Saber's algorithm: a lattice by gradient and consensus terms, with obstacles.

    The accelerations u = f_g + f_d + f_gamma of algorithms 2 and 3, of observed neighbours only,
    are added to the velocity. Obstacles and walls are beta-agents: the nearest point of an
    obstacle, which moves with the drone's velocity along its surface.
    """

    name = "olfati_saber"

    def flock_velocities(self, traffic: Traffic) -> np.ndarray:
        """Return `olfati_saber_velocities`; see `FlockPolicy`."""
        return olfati_saber_velocities(traffic, self.rules, OLFATI_SABER)


@func
def sigma_norm(length: float, epsilon: float) -> float:
    """Compute the sigma-norm (sqrt(1 + epsilon |z|^2) - 1) / epsilon of a vector of a length."""
    return (math.sqrt(1.0 + epsilon * length * length) - 1.0) / epsilon


@func
def bump(z: float, h: float) -> float:
    """Compute the bump function: 1 below h, then a half wave of a cosine to 0 at 1."""
    if z < h:
        return 1.0
    if z >= 1.0:
        return 0.0
    return 0.5 * (1.0 + cos(math.pi * (z - h) / (1.0 - h)))


@func
def sigma_1(z: float) -> float:
    """Compute z / sqrt(1 + z^2)."""
    return z / math.sqrt(1.0 + z * z)


@allocating
def olfati_saber_velocities(
    traffic: Traffic, rules: FlockRules, gains: OlfatiSaberGains
) -> np.ndarray:
    """Add the limited accelerations of algorithms 2 and 3 to the velocities.

    Args:
        traffic: The traffic around each drone.
        rules: Numbers of the task.
        gains: Parameters of the algorithm.

    Returns:
        (W, N, 3) m/s.
    """
    result = np.empty(traffic.velocity.shape)
    epsilon = gains.epsilon
    reach, spacing = sigma_norm(rules.link_range, epsilon), sigma_norm(rules.spacing, epsilon)
    obstacle_spacing = gains.reach * rules.spacing
    obstacle_reach = sigma_norm(obstacle_spacing, epsilon)
    for w in range(traffic.velocity.shape[0]):
        for i in range(traffic.velocity.shape[1]):
            own_x, own_y = traffic.velocity[w, i, 0], traffic.velocity[w, i, 1]
            # Feedback of the navigation, f_gamma
            wanted_x, wanted_y = _navigation(traffic, rules, w, i)
            x, y = gains.leader * (wanted_x - own_x), gains.leader * (wanted_y - own_y)
            # Gradient and consensus among drones, f_g and f_d
            for k in range(traffic.known.shape[2]):
                to_x, to_y, distance = _away(traffic.offset, (w, i, k))
                if not traffic.known[w, i, k] or distance >= rules.link_range:
                    continue
                norm = sigma_norm(distance, epsilon)
                near = bump(norm / reach, gains.bump)
                # phi with a = b, so that c = 0, times the norm of n_ij
                size = near * gains.slope * sigma_1(norm - spacing)
                size *= gains.gradient * distance / math.sqrt(1.0 + epsilon * distance * distance)
                match = gains.consensus * near
                x += size * to_x + match * (traffic.other_velocity[w, i, k, 0] - own_x)
                y += size * to_y + match * (traffic.other_velocity[w, i, k, 1] - own_y)
            # The same from obstacles, which only repel
            for k in range(traffic.sphere_radius.shape[2] + traffic.surface.shape[2]):
                off_x, off_y, distance = _nearest_point(traffic, w, i, k)
                if distance >= obstacle_spacing:
                    continue
                distance = max(distance, 0.0)
                norm = sigma_norm(distance, epsilon)
                near = bump(norm / obstacle_reach, gains.obstacle_bump)
                size = -gains.obstacle_gradient * near * (sigma_1(norm - obstacle_reach) - 1.0)
                size *= math.sqrt(1.0 / epsilon)
                # The beta-agent has the drone's velocity without its part towards the surface
                towards = gains.obstacle_consensus * near * (own_x * off_x + own_y * off_y)
                x += (size - towards) * off_x
                y += (size - towards) * off_y
            length = math.sqrt(x * x + y * y)
            scale = gains.horizon * min(1.0, gains.max_acceleration / max(length, TINY))
            _store(result, traffic, (own_x + scale * x, own_y + scale * y), w, i)
    return result


# ---- Vasarhelyi


class VasarhelyiGains(NamedTuple):
    """Parameters of the algorithm of Vasarhelyi et al., by their names in the paper.

    Attributes:
        p_rep: Gain of the repulsion, 1/s; its range r0_rep is the spacing of the flock.
        r0_frict: Stopping distance of the alignment, m.
        c_frict: Coefficient of the alignment.
        v_frict: Velocity slack of the alignment, m/s.
        p_frict: Gain of the braking curve of the alignment, 1/s.
        a_frict: Deceleration of this braking curve, m/s^2.
        r0_shill: Stopping distance of walls and obstacles, m.
        v_shill: Speed of shill agents, m/s.
        p_shill: Gain of the braking curve of walls and obstacles, 1/s.
        a_shill: Deceleration of this braking curve, m/s^2.
    """

    p_rep: float
    r0_frict: float
    c_frict: float
    v_frict: float
    p_frict: float
    a_frict: float
    r0_shill: float
    v_shill: float
    p_shill: float
    a_shill: float


VASARHELYI = VasarhelyiGains(
    p_rep=1.0,
    r0_frict=85.3,
    c_frict=0.2,
    v_frict=0.63,
    p_frict=3.2,
    a_frict=4.16,
    r0_shill=0.3,
    v_shill=10.0,
    p_shill=3.55,
    a_shill=8.0,
)
"""Parameters that the paper found by evolution for 4 m/s, with four changes.

The paper has p_rep 0.13, c_frict 0.05, v_shill 13.6 and a_shill 3.02, for neighbours 25 m apart and
drones that slow down 37 m before a wall. Here neighbours are 10 m apart, and only some observed.
"""
LAG = 0.3
"""Time constant with which drones of `single_integrator` follow velocities of `vasarhelyi`, s"""


@register("policy")
class Vasarhelyi(FlockPolicy):
    """Flocking of Vasarhelyi et al.: repulsion, alignment by the braking curve, and shill agents.

    A shill agent is a virtual drone at the nearest point of a wall or obstacle, which moves away
    from it and with which drones align. That of a moving obstacle has its velocity, too.

    The sum over neighbours corrects differences of velocity by more than their size. Drones that
    follow velocities with a lag converge nevertheless. In `single_integrator` velocities would
    alternate from decision to decision, and are therefore filtered by a lag of `LAG`.
    """

    name = "vasarhelyi"

    def flock_velocities(self, traffic: Traffic) -> np.ndarray:
        """Return `vasarhelyi_velocities`, with a lag where drones have none; see `FlockPolicy`."""
        wanted: np.ndarray = vasarhelyi_velocities(traffic, self.rules, VASARHELYI)
        options = self.aviary.options
        if options.dynamics_name != "single_integrator":
            return wanted
        fraction = min(1.0 / (LAG * options.decision_hz), 1.0)
        wanted = traffic.velocity + fraction * (wanted - traffic.velocity)
        return wanted


@func
def _aligned(difference: Vec2, slack: float, coefficient: float) -> Vec2:
    """Return the correction of a velocity difference beyond a slack, m/s."""
    x, y = difference
    size = math.sqrt(x * x + y * y)
    factor = coefficient * max(size - slack, 0.0) / max(size, TINY)
    return factor * x, factor * y


@allocating
def vasarhelyi_velocities(
    traffic: Traffic, rules: FlockRules, gains: VasarhelyiGains
) -> np.ndarray:
    """Compute the sum of self-propulsion, repulsion, alignment, walls and obstacles.

    Args:
        traffic: The traffic around each drone.
        rules: Numbers of the task.
        gains: Parameters of the algorithm.

    Returns:
        (W, N, 3) m/s.
    """
    result = np.empty(traffic.velocity.shape)
    for w in range(traffic.velocity.shape[0]):
        for i in range(traffic.velocity.shape[1]):
            own_x, own_y = traffic.velocity[w, i, 0], traffic.velocity[w, i, 1]
            x, y = _navigation(traffic, rules, w, i)
            for k in range(traffic.known.shape[2]):
                if not traffic.known[w, i, k]:
                    continue
                to_x, to_y, distance = _away(traffic.offset, (w, i, k))
                push = gains.p_rep * max(rules.spacing - distance, 0.0)
                brake = braking_curve(distance - gains.r0_frict, gains.a_frict, gains.p_frict)
                difference = (
                    traffic.other_velocity[w, i, k, 0] - own_x,
                    traffic.other_velocity[w, i, k, 1] - own_y,
                )
                add_x, add_y = _aligned(difference, max(gains.v_frict, brake), gains.c_frict)
                x += add_x - push * to_x
                y += add_y - push * to_y
            for k in range(traffic.sphere_radius.shape[2] + traffic.surface.shape[2]):
                off_x, off_y, distance = _nearest_point(traffic, w, i, k)
                if distance == np.inf:
                    continue
                brake = braking_curve(distance - gains.r0_shill, gains.a_shill, gains.p_shill)
                shill_x, shill_y = gains.v_shill * off_x, gains.v_shill * off_y
                if k < traffic.sphere_radius.shape[2]:
                    shill_x += traffic.sphere_velocity[w, i, k, 0]
                    shill_y += traffic.sphere_velocity[w, i, k, 1]
                difference = (shill_x - own_x, shill_y - own_y)
                add_x, add_y = _aligned(difference, brake, 1.0)
                x += add_x
                y += add_y
            _store(result, traffic, (x, y), w, i)
    return result
