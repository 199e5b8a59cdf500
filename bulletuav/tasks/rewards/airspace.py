"""Reward terms of flights to goals through a shared airspace."""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.closest_approach import closest_squared_distances, offset
from bulletuav.geometry.rotation import Vec3, dot, minus, vec3
from bulletuav.registry import register
from bulletuav.tasks.ingredients import reward
from bulletuav.vehicle.swarm import Swarm


@register("reward")
@reward
def progress(distance_before: float, distance: float) -> float:
    """Decrease of the distance to the goal in the decision, m."""
    return distance_before - distance


@register("reward")
@reward
def goal(reached: bool) -> float:
    """1 in the decision in which the goal is reached."""
    return 1.0 if reached else 0.0


@register("reward")
@reward
def conflict(conflicts: int) -> float:
    """Count the other drones with which a conflict began in the decision."""
    return float(conflicts)


@register("reward")
@reward
def warning(nearness: float) -> float:
    """Sum over other drones of their proximity: 0 at `warning_zone` times d_safe, 1 at d_safe."""
    return nearness


@register("reward")
@reward
def obstacle_warning(obstacle_nearness: float) -> float:
    """Sum over obstacles of their proximity: 0 at d_safe from the bounding sphere, 1 at contact."""
    return obstacle_nearness


@register("reward")
@reward
def collision(collision: bool) -> float:
    """1 on contact of collision shapes."""
    return 1.0 if collision else 0.0


@register("reward")
@reward
def out_of_bounds(outside: bool) -> float:
    """1 outside the arena, or at its bounds."""
    return 1.0 if outside else 0.0


@register("reward")
@reward
def energy(velocity: Vec3, velocity_before: Vec3) -> float:
    """Squared change of velocity, (m/s)^2."""
    x = velocity[0] - velocity_before[0]
    y = velocity[1] - velocity_before[1]
    z = velocity[2] - velocity_before[2]
    return x * x + y * y + z * z


@register("reward")
@reward
def efficiency(remaining_distance: float, initial_distance: float, goal_radius: float) -> float:
    """1 - d / max(d0, goal_radius): 1 at the goal, 0 at the initial distance d0, negative beyond.

    d is the remaining distance.
    """
    return 1 - remaining_distance / max(initial_distance, goal_radius)


@register("reward")
@reward
def speed_keeping(velocity: Vec3, max_speed: float) -> float:
    """1 at a speed between 0.3 and 0.8 of max_speed."""
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    fraction = speed / max_speed
    return 1.0 if 0.3 < fraction < 0.8 else 0.0


@register("reward")
@reward
def time(terminated: bool, finished: bool, time: float, duration: float, period: float) -> float:
    """1 per decision until the drone has finished. Use a negative weight.

    In a decision in which the episode of the drone terminates otherwise, the term also has 1 per
    remaining decision, so that no drone saves time by crashing or leaving.
    """
    if finished:
        return 0.0
    return 1.0 + (duration - time) / period if terminated else 1.0


@register("reward")
@reward
def shaping(
    remaining_distance: float, remaining_distance_before: float, terminated: bool, discount: float
) -> float:
    """Potential-based shaping with the negative remaining distance as potential.

    The term is the discounted potential after the decision minus the potential before. The
    potential is minus the remaining distance, m, and 0 if the episode terminates. Shaping preserves
    optimal policies: A. Ng, D. Harada, S. Russell, Policy invariance under reward transformations,
    1999.
    """
    return remaining_distance_before - discount * (0.0 if terminated else remaining_distance)


@register("reward")
@reward
def concession(
    i: int, encounter: np.ndarray, effort: np.ndarray, all_effort: np.ndarray, ended: bool
) -> float:
    """At the end: number of drones to which the drone gave way, minus those that gave way to it.

    At least 0. Only encounters without a conflict count. Of the two drones of an encounter, the one
    with the larger effort gave way; see `update_encounters`.

    Args:
        i: Index of the drone.
        encounter: (N,) state of the pairs of the drone with all drones.
        effort: (N,) effort of the drone towards each other drone, m/s: row i of `all_effort`.
        all_effort: (N, N) efforts of all drones, m/s.
        ended: Whether the episode of the drone ends.
    """
    balance = 0.0
    if ended:
        for j in range(len(effort)):
            if encounter[j] == CLEAR:
                balance += np.sign(effort[j] - all_effort[j, i])
    return max(balance, 0.0)


@register("reward")
@reward
def proximity(lidar: np.ndarray, proximity_range: float) -> float:
    """Linear in the shortest range: 0 at `proximity_range`, 1 at 0 m."""
    shortest = lidar[0]
    for k in range(1, len(lidar)):
        shortest = min(shortest, lidar[k])
    nearness: float = max(0.0, 1 - shortest / proximity_range)
    return nearness


NONE, CLEAR, CONFLICT = 0.0, 1.0, 2.0
"""State of a pair of drones: no encounter yet, an encounter without conflict, a conflict"""
LOOK_AHEAD = 10.0
"""Time within which drones have to approach for an encounter, s"""


@func
def _velocity_change(before: Swarm, after: Swarm, w: int, i: int) -> float:
    """Compute the magnitude of a drone's velocity change, m/s."""
    own, new = vec3(before.velocity, w, i), vec3(after.velocity, w, i)
    return math.sqrt((new[0] - own[0]) ** 2 + (new[1] - own[1]) ** 2 + (new[2] - own[2]) ** 2)


@kernel
def update_encounters(
    encounter: np.ndarray,
    effort: np.ndarray,
    before: Swarm,
    after: Swarm,
    d_safe: float,
    alive: np.ndarray,
) -> None:
    """Update the encounters of all pairs of drones after a decision.

    An encounter begins when the closest approach of two active drones in straight flight is less
    than `LOOK_AHEAD` = 10 s away and closer than d_safe. From then on `effort` accumulates the
    velocity changes of each drone while the two approach each other, also in later approaches. The
    drone with the larger sum gave way. A pair is in conflict once it is closer than d_safe at any
    time in a decision, also without an encounter.

    Args:
        encounter: (W, N, N) state of each pair: NONE, CLEAR or CONFLICT; updated.
        effort: (W, N, N) accumulated velocity change of drone i while it approaches drone j, at
            [w, i, j], m/s; updated.
        before: Swarm before the decision.
        after: Swarm after the decision.
        d_safe: Separation below which two drones are in conflict, m.
        alive: (W, N) bool, drones active before the decision.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                # Relative motion, and closest approach within the decision
                gap, speed = offset(before.position, w, i, j), offset(before.velocity, w, i, j)
                along, fast = dot(gap, speed), dot(speed, speed)
                _, least = closest_squared_distances(gap, offset(after.position, w, i, j))
                state = encounter[w, i, j]
                # Only approaching drones begin encounters and make efforts
                if along < 0.0:
                    # Time until the closest approach in straight flight
                    meeting = -along / fast
                    if (
                        state == NONE
                        and meeting < LOOK_AHEAD
                        and dot(gap, gap) + meeting * along < d_safe * d_safe
                    ):
                        state = CLEAR
                    if state != NONE:
                        effort[w, i, j] += _velocity_change(before, after, w, i)
                        effort[w, j, i] += _velocity_change(before, after, w, j)
                # Conflicts depend on the actual paths
                if least < d_safe * d_safe:
                    state = CONFLICT
                encounter[w, i, j] = encounter[w, j, i] = state


@allocating
def variance_nearby(
    reward: np.ndarray, position: np.ndarray, alive: np.ndarray, max_distance: float
) -> np.ndarray:
    """Compute the variance of rewards over the active drones near each drone, itself included.

    Args:
        reward: (W, N).
        position: (W, N, 3) m.
        alive: (W, N) bool, drones active before the decision.
        max_distance: Maximum distance of nearby drones, m.

    Returns:
        (W, N), 0 for inactive drones.
    """
    result = np.zeros(reward.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            count, total, square = 0, 0.0, 0.0
            for j in range(alive.shape[1]):
                gap = 0.0
                for k in range(3):
                    gap += (position[w, j, k] - position[w, i, k]) ** 2
                if alive[w, j] and gap <= max_distance * max_distance:
                    count += 1
                    total += reward[w, j]
                    square += reward[w, j] ** 2
            if alive[w, i]:
                result[w, i] = max(0.0, square / count - (total / count) ** 2)
    return result


@kernel
def sum_obstacle_nearness(
    position: np.ndarray,
    obstacle: np.ndarray,
    contact_distance: np.ndarray,
    d_safe: float,
    out: np.ndarray,
) -> None:
    """Sum over obstacles their proximity to each drone.

    The proximity is linear in the distance: 0 at d_safe from contact, 1 at contact or overlap.

    Args:
        position: (W, N, 3) m.
        obstacle: (W, K, 3) m.
        contact_distance: (K,) distance between the centres of obstacle and drone at contact, m.
        d_safe: Distance from contact at which the proximity begins, m.
        out: (W, N) output.
    """
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = 0.0
            for k in range(obstacle.shape[1]):
                away = minus(vec3(obstacle, w, k), vec3(position, w, i))
                gap = math.sqrt(dot(away, away)) - contact_distance[k]
                out[w, i] += min(max(1.0 - gap / d_safe, 0.0), 1.0)
