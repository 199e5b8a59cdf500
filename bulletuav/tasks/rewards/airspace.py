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
    """Metres nearer to the goal than before the decision."""
    return distance_before - distance


@register("reward")
@reward
def goal(reached: bool) -> float:
    """1 on reaching it, once."""
    return 1.0 if reached else 0.0


@register("reward")
@reward
def conflict(conflicts: int) -> float:
    """Other drones with which a conflict began."""
    return float(conflicts)


@register("reward")
@reward
def warning(nearness: float) -> float:
    """Sum over other drones: from 0 at the edge of the warning zone, linear, to 1 at d_safe."""
    return nearness


@register("reward")
@reward
def obstacle_warning(obstacle_nearness: float) -> float:
    """Sum over obstacles: 0 at d_safe from the bounding sphere, linear, to 1 at contact."""
    return obstacle_nearness


@register("reward")
@reward
def collision(collision: bool) -> float:
    """1 on contact of collision shapes."""
    return 1.0 if collision else 0.0


@register("reward")
@reward
def out_of_bounds(outside: bool) -> float:
    """1 outside the arena, or thrown back at its bounds."""
    return 1.0 if outside else 0.0


@register("reward")
@reward
def energy(velocity: Vec3, velocity_before: Vec3) -> float:
    """Square of the velocity change, (m/s)^2."""
    x = velocity[0] - velocity_before[0]
    y = velocity[1] - velocity_before[1]
    z = velocity[2] - velocity_before[2]
    return x * x + y * y + z * z


@register("reward")
@reward
def efficiency(way: float, first_way: float, goal_radius: float) -> float:
    """1 at the goal, 0 as far from it as at the start: 1 - d / d0, of the way to its end."""
    return 1 - way / max(first_way, goal_radius)


@register("reward")
@reward
def speed_keeping(velocity: Vec3, max_speed: float) -> float:
    """1 at a speed between 0.3 and 0.8 of max_speed."""
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    share = speed / max_speed
    return 1.0 if 0.3 < share < 0.8 else 0.0


@register("reward")
@reward
def time(terminated: bool, finished: bool, time: float, duration: float, period: float) -> float:
    """1 a decision until the drone has finished; an end before that costs all that are left.

    So no drone saves time by crashing or leaving.
    """
    if finished:
        return 0.0
    return 1.0 + (duration - time) / period if terminated else 1.0


@register("reward")
@reward
def shaping(way: float, way_before: float, terminated: bool, discount: float) -> float:
    """Gain of the discounted potential.

    That is the discounted potential after the decision, less that before. It is minus the way to
    where the goal stops, m, and 0 where the episode terminates. It leaves optimal policies as they
    are: A. Ng, D. Harada, S. Russell, Policy invariance under reward transformations, 1999.
    """
    return way_before - discount * (0.0 if terminated else way)


@register("reward")
@reward
def concession(
    i: int, encounter: np.ndarray, effort: np.ndarray, all_effort: np.ndarray, ended: bool
) -> float:
    """At the end of an episode: for how many drones it made way, less how many made way for it.

    0 at least; see `follow_encounters`.
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
    """From 0 where the shortest range is `proximity_range`, linear, to 1 at 0 m."""
    shortest = lidar[0]
    for k in range(1, len(lidar)):
        shortest = min(shortest, lidar[k])
    nearness: float = max(0.0, 1 - shortest / proximity_range)
    return nearness


NONE, CLEAR, CONFLICT = 0.0, 1.0, 2.0
"""Between two drones: no encounter yet, one that stayed clear, one that became a conflict"""
LOOK_AHEAD = 10.0
"""s"""


@func
def _change(before: Swarm, after: Swarm, w: int, i: int) -> float:
    """Compute the size of a drone's velocity change, m/s."""
    own, new = vec3(before.velocity, w, i), vec3(after.velocity, w, i)
    return math.sqrt((new[0] - own[0]) ** 2 + (new[1] - own[1]) ** 2 + (new[2] - own[2]) ** 2)


@kernel
def follow_encounters(
    encounter: np.ndarray,
    effort: np.ndarray,
    before: Swarm,
    after: Swarm,
    d_safe: float,
    alive: np.ndarray,
) -> None:
    """Bring the encounters of all pairs up to date after a decision.

    An encounter begins when two living drones would come closer than d_safe within 10 s, if both
    flew straight on from where they were. From then on `effort` sums up each one's changes of
    velocity while they near each other, at a second approach, too. Of the two, the drone with the
    larger sum makes way. It is a conflict once they are closer than d_safe.

    Args:
        encounter: (W, N, N) state of each pair: NONE, CLEAR or CONFLICT; changed in place.
        effort: (W, N, N) m/s; changed in place.
        before: Swarm before the decision.
        after: Swarm after it.
        d_safe: m.
        alive: (W, N) bool, drones that flew the decision.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                # How the two move towards each other, and how close they come in the decision.
                gap, speed = offset(before.position, w, i, j), offset(before.velocity, w, i, j)
                along, fast = dot(gap, speed), dot(speed, speed)
                _, least = closest_squared_distances(gap, offset(after.position, w, i, j))
                state = encounter[w, i, j]
                # While they near each other an encounter may begin, and efforts count.
                if along < 0.0:
                    # Time until they are closest, and the square of their distance then
                    meeting = -along / fast
                    if (
                        state == NONE
                        and meeting < LOOK_AHEAD
                        and dot(gap, gap) + meeting * along < d_safe * d_safe
                    ):
                        state = CLEAR
                    # Changes of velocity count only while there is something to avoid
                    if state != NONE:
                        effort[w, i, j] += _change(before, after, w, i)
                        effort[w, j, i] += _change(before, after, w, j)
                # Told by the way flown, not by the one foreseen
                if least < d_safe * d_safe:
                    state = CONFLICT
                encounter[w, i, j] = encounter[w, j, i] = state


@allocating
def variance_nearby(
    reward: np.ndarray, position: np.ndarray, alive: np.ndarray, reach: float
) -> np.ndarray:
    """Compute the variance of the rewards of living drones near each one, itself among them.

    Args:
        reward: (W, N).
        position: (W, N, 3) m.
        alive: (W, N) bool.
        reach: How far the others may be, m.

    Returns:
        (W, N), 0 for drones that are not alive.
    """
    result = np.zeros(reward.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            # Count, sum and sum of squares of those within reach.
            count, total, square = 0, 0.0, 0.0
            for j in range(alive.shape[1]):
                gap = 0.0
                for k in range(3):
                    gap += (position[w, j, k] - position[w, i, k]) ** 2
                if alive[w, j] and gap <= reach * reach:
                    count += 1
                    total += reward[w, j]
                    square += reward[w, j] ** 2
            if alive[w, i]:
                result[w, i] = max(0.0, square / count - (total / count) ** 2)
    return result


@kernel
def sum_obstacle_nearness(
    position: np.ndarray, obstacle: np.ndarray, reach: np.ndarray, d_safe: float, out: np.ndarray
) -> None:
    """Sum up how deep drones are within d_safe of obstacles.

    Args:
        position: (W, N, 3) m.
        obstacle: (W, K, 3) m.
        reach: (K,) distances of the middles at which they touch, m.
        d_safe: m.
        out: (W, N), overwritten; of each obstacle 0 at d_safe from touch, 1 in touch.
    """
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = 0.0
            for k in range(obstacle.shape[1]):
                away = minus(vec3(obstacle, w, k), vec3(position, w, i))
                # 0 at d_safe and beyond, 1 in touch
                gap = math.sqrt(dot(away, away)) - reach[k]
                out[w, i] += min(max(1.0 - gap / d_safe, 0.0), 1.0)
