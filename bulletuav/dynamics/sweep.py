"""Contacts of the levels that Bullet does not integrate: a drone stops at its first touch and never passes through.

A compiled broad phase finds the pairs whose bounding spheres, swept along the decision's path, come close; for those alone
conservative advancement (B. Mirtich, 1996) on Bullet's exact shape distances finds the time of the first touch: no motion
can close a gap faster than its bound, so stepping by gap / bound skips nothing, however thin or fast.
"""

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from bulletuav.dynamics.path import Path, inner, length
from bulletuav.engine.engine import Engine
from bulletuav.geometry.city_grid import meets
from bulletuav.geometry.closest_approach import closest_squared
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Contacts, Swarm

TOUCH = 1e-3  # m; closer counts as touching


@kernel
def _reaches(track):
    """(W, N) how far from where it begins each of the tracks (S + 1, W, N, 3) gets, m; 0 for who does not fly."""
    reach = np.zeros(track.shape[1:3])
    for w in range(reach.shape[0]):
        for i in range(reach.shape[1]):
            for s in range(1, track.shape[0]):
                square = 0.0
                for k in range(3):
                    square += (track[s, w, i, k] - track[0, w, i, k]) ** 2
                reach[w, i] = max(reach[w, i], square)
            reach[w, i] = math.sqrt(reach[w, i])
    return reach


@func
def _meets_ground(position, radius, w, i):
    for s in range(position.shape[0]):
        if position[s, w, i, 2] < radius[w, i] + TOUCH:
            return True
    return False


@func
def _meets_city(position, radius, city_grid, w, i):
    """Whether the box about the drone's bounding sphere in some substep overlaps that about a piece of the city."""
    margin = radius[w, i] + TOUCH
    for s in range(position.shape[0] - 1):
        one, two = vec3(position[s], w, i), vec3(position[s + 1], w, i)
        low = (
            min(one[0], two[0]) - margin,
            min(one[1], two[1]) - margin,
            min(one[2], two[2]) - margin,
        )
        high = (
            max(one[0], two[0]) + margin,
            max(one[1], two[1]) + margin,
            max(one[2], two[2]) + margin,
        )
        if meets(city_grid, w, low, high):
            return True
    return False


@func
def _near(one, two, w, i, j, within):
    """Whether tracks i and j begin closer to each other than `within` m."""
    gap = _gap(one, two, 0, w, i, j)
    return dot(gap, gap) < within * within


@func
def _meets(one, two, w, i, j, within):
    """Whether tracks i of `one` and j of `two` (S + 1, W, ., 3) come closer than `within` m."""
    for s in range(one.shape[0] - 1):
        if (
            closest_squared(_gap(one, two, s, w, i, j), _gap(one, two, s + 1, w, i, j))[1]
            < within * within
        ):
            return True
    return False


@func
def _gap(one, two, s, w, i, j):
    return (
        two[s, w, j, 0] - one[s, w, i, 0],
        two[s, w, j, 1] - one[s, w, i, 1],
        two[s, w, j, 2] - one[s, w, i, 2],
    )


@kernel
def _candidates(position, obstacle, alive, radius, obstacle_radius, city_grid):
    """Pairs (world, drone, other) that may come within TOUCH during the path; `other` as in `Contacts`."""
    found = [(0, 0, 0) for _ in range(0)]
    reach, obstacle_reach = _reaches(position), _reaches(obstacle)
    for w in range(alive.shape[0]):
        order = np.argsort(position[0, w, :, 0])
        widest = (reach[w] + radius[w]).max()
        for a in range(order.shape[0]):
            i = order[a]
            if not alive[w, i]:
                continue
            if _meets_ground(position, radius, w, i):
                found.append((w, i, GROUND))
            if _meets_city(position, radius, city_grid, w, i):
                found.append((w, i, CITY))
            for k in range(obstacle.shape[2]):
                within = radius[w, i] + obstacle_radius[k] + TOUCH
                near = _near(
                    position, obstacle, w, i, k, within + reach[w, i] + obstacle_reach[w, k]
                )
                if near and _meets(position, obstacle, w, i, k, within):
                    found.append((w, i, FIRST_OBSTACLE - k))
            farthest = position[0, w, i, 0] + radius[w, i] + reach[w, i] + widest + TOUCH
            for b in range(a + 1, order.shape[0]):
                j = order[b]
                if position[0, w, j, 0] > farthest:
                    break
                within = radius[w, i] + radius[w, j] + TOUCH
                near = alive[w, j] and _near(
                    position, position, w, i, j, within + reach[w, i] + reach[w, j]
                )
                if near and _meets(position, position, w, i, j, within):
                    found.append((w, min(i, j), max(i, j)))
    return found


@func
def _place(path, w, i, time):
    """Where a drone is at `time`."""
    held = min(time, path.stop[w, i]) / path.span
    s = min(int(held), path.position.shape[0] - 2)
    share, one, two = held - s, vec3(path.position[s], w, i), vec3(path.position[s + 1], w, i)
    return (
        one[0] + share * (two[0] - one[0]),
        one[1] + share * (two[1] - one[1]),
        one[2] + share * (two[2] - one[2]),
    )


@func
def _between(one, two):
    return two[0] - one[0], two[1] - one[1], two[2] - one[2]


@func
def _meets_held(path, w, i, j, within):
    """As `_meets`, of two drones that may have stopped."""
    for s in range(path.position.shape[0] - 1):
        begin, end = s * path.span, (s + 1) * path.span
        one, two = min(max(path.stop[w, i], begin), end), min(max(path.stop[w, j], begin), end)
        time, before = begin, _between(_place(path, w, i, begin), _place(path, w, j, begin))
        for later in (min(one, two), max(one, two), end):
            if later > time:
                after = _between(_place(path, w, i, later), _place(path, w, j, later))
                if closest_squared(before, after)[1] < within * within:
                    return True
                time, before = later, after
    return False


@kernel
def _partners(path, alive, radius, w, i):
    """The pairs of `_candidates` between drone `i` and another drone, as far as they go before they stop."""
    found = [(0, 0, 0) for _ in range(0)]
    for j in range(alive.shape[1]):
        within = radius[w, i] + radius[w, j] + TOUCH
        if j != i and alive[w, j] and _meets_held(path, w, i, j, within):
            found.append((w, min(i, j), max(i, j)))
    return found


def _speed_bound(
    path: Path, pair: tuple[int, int, int], radius: np.ndarray, begin: float, end: float
) -> float:
    """Most metres by which the gap between the shapes can shrink between two times: translation plus rotation of each."""
    w, one, two = pair
    s = path.piece(begin)
    bound = length(path.change(w, one, begin, end) - path.change(w, two, begin, end))
    for drone in (one, two):
        if drone >= 0 and begin < path.stop[w, drone]:
            cosine = abs(inner(path.quaternion[s, w, drone], path.quaternion[s + 1, w, drone]))
            turned = min(
                2 * np.arccos(min(1.0, cosine)), 2.0
            )  # no rotation moves a point by more than a diameter
            bound += float(turned * radius[w, drone])
    return bound


def first_touch(
    engine: Engine, path: Path, pair: tuple[int, int, int], radius: np.ndarray
) -> float:
    """Time in substeps of the pair's first touch, inf if none. A pair that starts in touch and parts does not count."""
    w, one, two = pair

    def gap(time: float, within: float) -> float:
        return engine.separation(w, path.pose(w, one, time), path.pose(w, two, time), within)

    for time, end in itertools.pairwise(path.breaks(w, (one, two))):
        rate = _speed_bound(path, pair, radius, time, end) / (end - time)
        while time < end:
            remaining = end - time
            distance = gap(time, rate * remaining + TOUCH)
            if distance <= TOUCH:
                later = end if rate * remaining <= TOUCH else time + TOUCH / rate
                if gap(later, 2 * TOUCH) < distance:
                    return time
                time = later  # parting, or at rest
            elif distance >= rate * remaining:
                time = end
            else:
                time += (distance - 0.5 * TOUCH) / rate
    return np.inf


def _in_order(
    path: Path,
    pairs: list[tuple[int, int, int]],
    alive: np.ndarray,
    radius: np.ndarray,
    touch: Callable,
) -> Iterator[tuple[float, tuple[int, int, int]]]:
    """Touches (time, pair) in order of time, `touch` telling a pair's; after each its drones stop in the path.

    Whoever was to meet one that stopped, and whoever meets it now, is asked anew.
    """
    times = {pair: touch(pair) for pair in pairs}
    done = set()
    while times:
        time, pair = min((time, pair) for pair, time in times.items())
        if time == np.inf:
            return
        del times[pair]
        done.add(pair)
        yield time, pair
        w, *ends = pair
        for drone in ends:
            if drone >= 0 and path.stop[w, drone] == np.inf:
                path.stop[w, drone] = time
                pending = [other for other in times if other[0] == w and drone in other[1:]]
                for met in {*pending, *_partners(path, alive, radius, w, drone)} - done:
                    times[met] = touch(met)


def stop_at_first_touch(
    engine: Engine, path: Path, swarm: Swarm, alive: np.ndarray, parameters: np.ndarray
) -> Contacts:
    """Stop every drone that touched something where it did, in order of time, and tell the contacts.

    The impulse is that of a stop: mass times the speed at the touch.
    """
    radius = parameters["collision_radius"]
    pairs = _candidates(
        path.position, path.obstacle, alive, radius, engine.obstacle_radius, engine.city_grid
    )
    rows: dict[tuple[int, int, int], float] = {}
    for time, (w, i, j) in _in_order(
        path, pairs, alive, radius, lambda pair: first_touch(engine, path, pair, radius)
    ):
        for drone, other in _both_sides(i, j):
            begin = path.piece(time) * path.span
            speed = length(path.change(w, drone, begin, begin + path.span)) / (
                path.span * engine.dt
            )
            rows[w, drone, other] = (
                float(parameters["mass"][w, drone]) * speed * (time < path.stop[w, drone])
            )
    for w, i, _ in rows:
        _, swarm.position[w, i], swarm.quaternion[w, i] = path.pose(w, i, np.inf)
        swarm.velocity[w, i] = swarm.rates[w, i] = 0
    return Contacts.merge(rows)


@kernel
def _crowded(position, moved, alive, radius, city_grid):
    """Pairs of living drones, or of one and the city, of which one was `moved` and whose spheres or boxes overlap."""
    found = [(0, 0, 0) for _ in range(0)]
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not (moved[w, i] and alive[w, i]):
                continue
            here, margin = vec3(position, w, i), radius[w, i] + TOUCH
            low, high = (
                (here[0] - margin, here[1] - margin, here[2] - margin),
                (here[0] + margin, here[1] + margin, here[2] + margin),
            )
            if meets(city_grid, w, low, high):
                found.append((w, i, CITY))
            for j in range(alive.shape[1]):
                gap, within = _between(here, vec3(position, w, j)), margin + radius[w, j]
                if j != i and alive[w, j] and dot(gap, gap) < within * within:
                    found.append((w, min(i, j), max(i, j)))
    return found


def overlaps(
    engine: Engine, swarm: Swarm, moved: np.ndarray, alive: np.ndarray, parameters: np.ndarray
) -> Contacts:
    """Contacts, without impulse, of what the drones that were `moved` (W, N) touch where they are now."""
    rows: dict[tuple[int, int, int], float] = {}
    for w, one, two in _crowded(
        swarm.position, moved, alive, parameters["collision_radius"], engine.city_grid
    ):
        there = (
            (two, None, None)
            if two == CITY
            else (two, swarm.position[w, two], swarm.quaternion[w, two])
        )
        if (
            engine.separation(
                w, (one, swarm.position[w, one], swarm.quaternion[w, one]), there, TOUCH
            )
            <= TOUCH
        ):
            rows |= {(w, drone, other): 0.0 for drone, other in _both_sides(one, two)}
    return Contacts.merge(rows)


def _both_sides(one: int, two: int) -> list[tuple[int, int]]:
    """(drone, other) of each drone of a pair."""
    return [(drone, other) for drone, other in ((one, two), (two, one)) if drone >= 0]


@kernel
def _any_fast(position, obstacle, alive, parameters):
    """Whether a living drone, or an obstacle, moved by more than a quarter of the drone's thinnest extent."""
    moved, swept = _reaches(position), _reaches(obstacle)
    for w in range(alive.shape[0]):
        farthest = 0.0
        for k in range(swept.shape[1]):
            farthest = max(farthest, swept[w, k])
        for i in range(alive.shape[1]):
            if alive[w, i] and max(moved[w, i], farthest) > 0.25 * parameters[w, i].thinnest:
                return True
    return False


@kernel
def suspects(path, alive, parameters, obstacle_radius, city_grid):
    """Whether `catch_fast` has anything to look at."""
    if not _any_fast(path.position, path.obstacle, alive, parameters):
        return False
    radius = parameters.collision_radius
    return (
        len(_candidates(path.position, path.obstacle, alive, radius, obstacle_radius, city_grid))
        > 0
    )


def catch_fast(
    engine: Engine, path: Path, swarm: Swarm, alive: np.ndarray, parameters: np.ndarray
) -> list[tuple[int, int, int]]:
    """Continuous collision detection for one engine substep (a path with S = 1): no drone may jump over a contact.

    The engine looks for contacts only where a substep begins. Pairs that moved against each other by more than a quarter of
    the drone's thinnest extent are checked along the way; those that touched are put back to where they did, with their
    velocities, for the engine to resolve the contact in its next substep. Pairs that were in touch already are held only
    where they would go deeper.

    Returns (engine, drone, other) of what was caught, both sides of a pair.
    """
    if not _any_fast(path.position, path.obstacle, alive, parameters):
        return []
    path.stop[:] = np.inf
    radius, far = parameters["collision_radius"], 0.25 * parameters["thinnest"]
    asked = np.zeros(alive.shape, dtype=bool)

    def touch(pair: tuple[int, int, int]) -> float:
        w, one, two = pair
        if length(path.change(w, one, 0.0, 1.0) - path.change(w, two, 0.0, 1.0)) <= far[w, one]:
            return np.inf
        for drone, _ in _both_sides(one, two):
            asked[w, drone] = True
        before, after = (
            engine.separation(w, path.pose(w, one, time), path.pose(w, two, time), 2 * TOUCH)
            for time in (0.0, 1.0)
        )
        if before > TOUCH:
            return first_touch(engine, path, pair, radius)
        return 0.0 if after < before - far[w, one] else np.inf

    pairs = _candidates(
        path.position, path.obstacle, alive, radius, engine.obstacle_radius, engine.city_grid
    )
    caught = [
        (w, drone, other)
        for _, (w, one, two) in _in_order(path, pairs, alive, radius, touch)
        for drone, other in _both_sides(one, two)
    ]
    for w, drone, _ in caught:
        _, swarm.position[w, drone], swarm.quaternion[w, drone] = path.pose(w, drone, 1.0)
    if asked.any():
        engine.set_states(swarm, asked)
    return caught
