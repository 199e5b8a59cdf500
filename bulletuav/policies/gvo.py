"""Policy `gvo`: generalized velocity obstacles, for aircraft whose turns need room.

Velocity obstacles assume that a drone takes a new velocity immediately. Generalized velocity
obstacles are sets of controls instead of velocities: those whose motion, with the limits of the
drone, comes into conflict. A control here is a course, a speed and a climb. The drone turns to the
course as tightly as it can, then flies straight.

The policy chooses the free control that deviates least from the velocity of policy `orca`. The
drones of a world share their plans, one after the other: each avoids the chosen motion of those
before it, and the expected motion of those after it.

References:
    D. Wilkie, J. van den Berg, D. Manocha, Generalized velocity obstacles, IROS 2009.
"""

import itertools
import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import Vec3, axes, dot, minus, plus, point, quat4, vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import AvoidanceParameters, max_conflict_distance
from bulletuav.policies.orca import orca_velocities
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

STEP = 0.25
"""Duration of the straight pieces of a predicted motion, s"""
STEPS = 32
"""Number of these pieces, for 8 s: twice a turn of 180 degrees at cruise speed or so"""
LATER = 8
"""Number of pieces after which drones in conflict should be as far apart as possible"""
TURN_TIME = 1.5
"""Time for which others are expected to keep turning, s"""
COURSES = (0, 10, 20, 30, 45, 60, 75, 90, 120, 150, 180)
"""Deviations from the preferred course to either side, degrees"""
LEFT_COST = 1.3
"""Cost of a deviation to the left in units of one to the right, which is the rule of the air"""
SPEED_COST, CLIMB_COST = 0.5, 0.4
"""Cost of the lowest speed, and of a climb or descent, in rad of a deviation to the right"""
PREFERRED, LOWEST, HIGHEST = range(3)
"""Choices of a speed (the first two) and of a climb"""
GROWTH = 0.3
"""Growth of the distance to maintain over the time ahead, m/s: what others do in it is unknown"""
USED_TURN = 0.8
"""Fraction of the largest lateral acceleration that is used, as controllers need some"""
DELAY = 0.5
"""Time before a turn or climb begins, s: an aeroplane rolls and pitches in about as long"""
SLOWEST = 1e-6
"""Speed below which a drone has no course, m/s"""


@register("policy")
class GeneralizedVelocityObstacles(Avoidance):
    """Flight to the goal by turns that each drone can fly, by generalized velocity obstacles.

    Minimum speed, bank and climb of aircraft that cannot hover limit the turns; all others are
    limited by the largest tilt. Obstacles (bounding spheres) are predicted at constant velocity.
    The ground, buildings and the bounds of the arena are avoided for the time of a turn away from
    them.
    """

    name = "gvo"
    searches_drones = True

    def __init__(self, aviary: Aviary) -> None:
        """Tabulate the controls and the limits of the drones; see `Avoidance`."""
        super().__init__(aviary)
        self._controls = tabulate_controls()
        gains = aviary.worlds.cascade.gains[0]
        speed = np.minimum(gains["max_speed"], self.parameters.max_speed)
        hovers = gains["min_speed"] == 0
        bank = np.where(hovers, gains["max_tilt"], gains["max_bank"])
        climb = np.where(hovers, speed / 2, gains["max_climb"])
        sink = np.where(hovers, speed / 2, gains["max_sink"])
        gravity = aviary.options.gravity
        lateral = USED_TURN * gravity * bank
        # Excess power changes the speed of aircraft that cannot hover
        cruise = np.where(hovers, 1.0, gains["cruise_speed"])
        faster = np.where(hovers, lateral, gravity * climb / cruise)
        slower = np.where(hovers, lateral, gravity * sink / cruise)
        limits = (gains["min_speed"], speed, lateral, climb, sink, faster, slower)
        self._limits = np.stack(limits, axis=1)
        self._goal_radius = float(getattr(aviary.task.config, "goal_radius", 0.0))
        self._turns = ~hovers
        self.max_distance = max_conflict_distance(self.parameters)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Choose the best control of each drone; see `Avoidance.avoid`."""
        swarm, alive = self.aviary.swarm, self.aviary.alive
        worlds, drones = alive.shape
        others = np.empty((worlds, drones, STEPS + 1, 3))
        predict_others(swarm, self._turns, self.aviary.options.gravity, others)
        wanted = orca_velocities(traffic, preferred, parameters)
        numbers = (parameters.separation, self._goal_radius)
        given = (others, alive, self._limits, self._controls)
        return gvo_velocities(traffic, wanted, *given, *numbers)


def tabulate_controls() -> np.ndarray:
    """Return all controls, (C, 4), by increasing cost.

    Returns:
        Deviation from the preferred course, rad, positive to the left; choice of the speed and of
        the climb; cost.
    """
    rows = []
    for degrees, side, speed, climb in itertools.product(
        COURSES, (-1, 1), (PREFERRED, LOWEST), (PREFERRED, LOWEST, HIGHEST)
    ):
        if degrees in (0, 180) and side == 1:
            continue
        turn = math.radians(degrees)
        cost = turn * (LEFT_COST if side == 1 else 1.0)
        cost += SPEED_COST * (speed != PREFERRED) + CLIMB_COST * (climb != PREFERRED)
        rows.append((side * turn, speed, climb, cost))
    return np.array(sorted(rows, key=lambda row: row[3]))


@kernel
def predict_others(swarm: Swarm, turns: np.ndarray, gravity: float, others: np.ndarray) -> None:
    """Predict the positions of all drones, as others expect them.

    Velocities stay, except those of banked aircraft: they turn for `TURN_TIME` at the rate of a
    coordinated turn, g tan(bank) / V.

    Args:
        swarm: State of the drones.
        turns: (N,) bool, aircraft that turn by their bank.
        gravity: Gravitational acceleration, m/s^2.
        others: (W, N, STEPS + 1, 3) positions at intervals of `STEP`, m; written.
    """
    for w in range(others.shape[0]):
        for i in range(others.shape[1]):
            place, velocity = vec3(swarm.position, w, i), vec3(swarm.velocity, w, i)
            square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
            change = 0.0
            if turns[i] and square > SLOWEST:
                _, left, up = axes(quat4(swarm.quaternion, w, i))
                # Upside down there is no coordinated turn
                if up[2] > 0.0:
                    change = -gravity * left[2] / up[2] / math.sqrt(square) * STEP
            c, s = cos(change), sin(change)
            for k in range(STEPS + 1):
                others[w, i, k, 0], others[w, i, k, 1], others[w, i, k, 2] = place
                if k * STEP < TURN_TIME:
                    x, y, z = velocity
                    velocity = (c * x - s * y, s * x + c * y, z)
                place = plus(place, STEP, velocity)


@allocating
def gvo_velocities(
    traffic: Traffic,
    preferred: np.ndarray,
    others: np.ndarray,
    alive: np.ndarray,
    limits: np.ndarray,
    controls: np.ndarray,
    separation: float,
    goal_radius: float,
) -> np.ndarray:
    """Choose the velocity of the best control of each drone.

    Without a control that is free of conflicts, the one with the latest conflict is chosen, and
    among those in conflict already the one that ends it at the largest distance.

    Args:
        traffic: The traffic around each drone.
        preferred: (W, N, 3) velocities of `orca`, m/s.
        others: (W, N, STEPS + 1, 3) result of `predict_others`, m; chosen motions are written.
        alive: (W, N) bool, which drones fly.
        limits: (N, 7) minimum and maximum speed (m/s), lateral acceleration (m/s^2), maximum climb
            and sink (m/s), maximum acceleration and deceleration along the course (m/s^2).
        controls: (C, 4) result of `tabulate_controls`.
        separation: Distance to maintain from other drones, m.
        goal_radius: Distance from a goal at which a flight ends, m.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(preferred.shape)
    path = np.empty((STEPS + 1, 3))
    fastest = limits[:, 1].max()
    for w in range(preferred.shape[0]):
        for i in range(preferred.shape[1]):
            if not alive[w, i]:
                result[w, i] = 0.0
                continue
            wish, own = vec3(preferred, w, i), vec3(traffic.velocity, w, i)
            speed, course, ahead = _prefer(traffic, w, i, wish, limits[i], goal_radius)
            # Flights end at the goal, and with them their conflicts
            goal = vec3(traffic.goal, w, i)
            left = math.sqrt(dot(goal, goal)) / max(speed, SLOWEST)
            steps = min(STEPS, int(left / STEP) + 1)
            horizon = steps * STEP
            best_time, best_distance = -1.0, -1.0
            best = (0.0, 0.0, 0.0)
            for c in range(controls.shape[0]):
                target, turned = _target(controls, c, speed, course, wish[2], limits[i])
                _predict(path, point(others[w, i], 0), own, ahead, target, turned, limits[i])
                wall = 0.5 * math.pi * turned / limits[i, 2]
                total = math.sqrt(max(dot(target, target), dot(own, own)))
                time, distance = _first_conflict(
                    path, others, alive, w, i, separation, total + fastest, steps, best_time
                )
                time = _first_obstacle(path, traffic, w, i, total, wall, time)
                if time > best_time or (time == best_time and distance > best_distance):
                    best_time, best_distance, best = time, distance, target
                if best_time >= horizon:
                    break
            for axis in range(3):
                result[w, i, axis] = best[axis]
            turned = math.sqrt(best[0] * best[0] + best[1] * best[1])
            _predict(path, point(others[w, i], 0), own, ahead, best, turned, limits[i])
            others[w, i] = path
    return result


@func
def _prefer(
    traffic: Traffic, w: int, i: int, wish: Vec3, limits: np.ndarray, goal_radius: float
) -> tuple[float, float, float]:
    """Return the preferred speed (m/s) and course, and the present course, rad.

    A goal within the circle of the tightest turn is reached by a slower turn, or left behind first.
    """
    own = vec3(traffic.velocity, w, i)
    course = atan2(wish[1], wish[0])
    is_moving = own[0] * own[0] + own[1] * own[1] > SLOWEST * SLOWEST
    ahead = atan2(own[1], own[0]) if is_moving else course
    speed = math.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
    speed = min(max(speed, limits[0]), limits[1])
    if limits[0] > 0.0 and _is_inside_turn(traffic, w, i, ahead, speed, limits, goal_radius):
        speed = limits[0]
        if _is_inside_turn(traffic, w, i, ahead, speed, limits, goal_radius):
            course = ahead
    return speed, course, ahead


@func
def _is_inside_turn(
    traffic: Traffic,
    w: int,
    i: int,
    ahead: float,
    speed: float,
    limits: np.ndarray,
    goal_radius: float,
) -> bool:
    """Return True if the goal is out of reach within the circle of the tightest turn."""
    goal, drift = vec3(traffic.goal, w, i), vec3(traffic.goal_velocity, w, i)
    # A moving goal is followed, not reached
    if dot(drift, drift) > 0.0:
        return False
    radius = speed * speed / limits[2]
    along = cos(ahead) * goal[0] + sin(ahead) * goal[1]
    aside = abs(cos(ahead) * goal[1] - sin(ahead) * goal[0]) - radius
    reach = radius - goal_radius
    return bool(reach > 0.0 and along * along + aside * aside < reach * reach)


@func
def _target(
    controls: np.ndarray, c: int, speed: float, course: float, climb: float, limits: np.ndarray
) -> tuple[Vec3, float]:
    """Return the velocity that a control leads to, and its horizontal speed, m/s."""
    if controls[c, 1] == LOWEST:
        speed = max(limits[0], 0.5 * speed)
    if controls[c, 2] == LOWEST:
        climb = -limits[4]
    elif controls[c, 2] == HIGHEST:
        climb = limits[3]
    climb = min(max(climb, -limits[4]), limits[3])
    angle = course + controls[c, 0]
    return (speed * cos(angle), speed * sin(angle), climb), speed


@func
def _predict(
    path: np.ndarray,
    place: Vec3,
    own: Vec3,
    ahead: float,
    target: Vec3,
    speed: float,
    limits: np.ndarray,
) -> None:
    """Write the positions (STEPS + 1, 3) of a tight turn to a velocity and straight flight.

    The turn and the climb begin after `DELAY`.

    Args:
        path: Positions at intervals of `STEP`, m; written.
        place: Present position, m.
        own: Present velocity, m/s.
        ahead: Present course, rad.
        target: Velocity at the end of the turn, m/s.
        speed: Its horizontal speed, m/s.
        limits: (7,) limits of the drone.
    """
    now = math.sqrt(own[0] * own[0] + own[1] * own[1])
    x, y = cos(ahead), sin(ahead)
    turn = atan2(x * target[1] - y * target[0], x * target[0] + y * target[1])
    done = 0.0
    for k in range(STEPS + 1):
        path[k, 0], path[k, 1], path[k, 2] = place
        if k * STEP < DELAY:
            place = plus(place, STEP, own)
            continue
        now += min(max(speed - now, -STEP * limits[6]), STEP * limits[5])
        # Chords of the circle
        most = limits[2] / max(now, SLOWEST) * STEP
        change = min(max(turn - done, -most), most)
        angle = ahead + done + 0.5 * change
        done += change
        place = plus(place, STEP, (now * cos(angle), now * sin(angle), target[2]))


@kernel
def _first_conflict(
    path: np.ndarray,
    others: np.ndarray,
    alive: np.ndarray,
    w: int,
    i: int,
    separation: float,
    closing: float,
    steps: int,
    earliest: float,
) -> tuple[float, float]:
    """Find the first conflict of a predicted motion with other drones.

    Args:
        path: (STEPS + 1, 3) predicted positions, m.
        others: (W, N, STEPS + 1, 3) predicted positions of all drones, m.
        alive: (W, N) bool, which drones fly.
        w: Index of the world.
        i: Index of the drone.
        separation: Distance to maintain, m.
        closing: Largest speed at which others approach, m/s.
        steps: Number of pieces of the path that count.
        earliest: The search may stop at conflicts before this time, s.

    Returns:
        Time of the first conflict, s, that of all pieces if there is none; and the smallest
        distance to drones in conflict already after `LATER` pieces, m.
    """
    first, last = steps * STEP, np.inf
    for j in range(alive.shape[1]):
        if j == i or not alive[w, j]:
            continue
        offset = minus(point(others[w, j], 0), point(path, 0))
        if dot(offset, offset) < separation * separation:
            first = 0.0
            after = minus(point(others[w, j], LATER), point(path, LATER))
            last = min(last, math.sqrt(dot(after, after)))
        k = 0
        while k * STEP < first:
            before = minus(point(others[w, j], k), point(path, k))
            kept = separation + GROWTH * k * STEP
            # Pieces in which the drones cannot come together
            free = int((math.sqrt(dot(before, before)) - kept) / ((closing + GROWTH) * STEP))
            if free > 0:
                k += free
                continue
            after = minus(point(others[w, j], k + 1), point(path, k + 1))
            if _comes_within(before, after, kept):
                first = k * STEP
            k += 1
        if first < earliest:
            break
    return first, last


@kernel
def _first_obstacle(
    path: np.ndarray, traffic: Traffic, w: int, i: int, speed: float, wall: float, first: float
) -> float:
    """Return the time of the first conflict of a predicted motion, also with obstacles, s.

    Args:
        path: (STEPS + 1, 3) predicted positions, m.
        traffic: Spheres and surfaces around each drone.
        w: Index of the world.
        i: Index of the drone.
        speed: Largest speed of the motion, m/s.
        wall: Time in which static surfaces count, s.
        first: Time of the first conflict with other drones, s.
    """
    here = point(path, 0)
    for m in range(traffic.sphere_radius.shape[2]):
        radius = traffic.sphere_radius[w, i, m]
        if radius <= 0.0:
            continue
        offset, velocity = vec3(traffic.sphere[w], i, m), vec3(traffic.sphere_velocity[w], i, m)
        closing = max(speed + math.sqrt(dot(velocity, velocity)), SLOWEST)
        k = 0
        while k * STEP < first:
            before = minus(plus(offset, k * STEP, velocity), minus(point(path, k), here))
            free = int((math.sqrt(dot(before, before)) - radius) / (closing * STEP))
            if free > 0:
                k += free
                continue
            moved = minus(point(path, k + 1), here)
            after = minus(plus(offset, (k + 1) * STEP, velocity), moved)
            if _comes_within(before, after, radius):
                first = k * STEP
            k += 1
    for p in range(traffic.surface.shape[2]):
        distance = traffic.surface[w, i, p, 3]
        if distance < np.inf:
            normal = point(traffic.surface[w, i], p)
            k = 0
            while k * STEP < first and k * STEP <= wall:
                if dot(normal, minus(point(path, k + 1), here)) + distance < 0.0:
                    first = k * STEP
                k += 1
    return first


@func
def _comes_within(before: Vec3, after: Vec3, distance: float) -> bool:
    """Return True if the straight piece between two offsets comes within a distance of 0."""
    along = minus(after, before)
    square = dot(along, along)
    share = -dot(before, along) / square if square > 0.0 else 0.0
    nearest = plus(before, min(max(share, 0.0), 1.0), along)
    return dot(nearest, nearest) < distance * distance
