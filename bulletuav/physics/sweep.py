"""Contacts of the levels that Bullet does not integrate: a drone stops at its first touch and never passes through.

A compiled broad phase finds the pairs whose bounding spheres, swept along the decision's path, come close; for those alone
conservative advancement (B. Mirtich, 1996) on Bullet's exact shape distances finds the time of the first touch: no motion
can close a gap faster than its bound, so stepping by gap / bound skips nothing, however thin or fast.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from bulletuav.kernel import formula, kernel
from bulletuav.physics.approach import closest_squared
from bulletuav.physics.atlas import meets
from bulletuav.physics.rotation import dot, three
from bulletuav.physics.swarm import CITY, FIRST_OBSTACLE, GROUND, Contacts, Motion, Swarm
from bulletuav.physics.world import World

TOUCH = 1e-3  # m; closer counts as touching


class Path(NamedTuple):
    """Poses at the substeps' ends of one decision: position (S + 1, W, N, 3) m, quaternion (S + 1, W, N, 4).

    Of the obstacles position (S + 1, W, K, 3) and quaternion (W, K, 4).
    """

    position: np.ndarray
    quaternion: np.ndarray
    obstacle: np.ndarray
    obstacle_quaternion: np.ndarray

    @classmethod
    def begin(cls, swarm: Swarm, motion: Motion, substeps: int) -> "Path":
        """Room for a decision, with the present poses first."""
        position, quaternion = (np.empty((substeps + 1, *array.shape)) for array in (swarm.position, swarm.quaternion))
        obstacle = np.empty((substeps + 1, *motion.before.shape))
        obstacle[:] = motion.at(np.arange(substeps + 1)[:, None, None, None] / substeps) if motion.moving else motion.before
        position[0], quaternion[0] = swarm.position, swarm.quaternion
        return cls(position, quaternion, obstacle, motion.quaternion)

    def pose(self, world: int, who: int, time: float) -> tuple[int, np.ndarray, np.ndarray]:
        """(who, position, quaternion) at `time` in substeps, between two of them by straight interpolation."""
        s = min(int(time), len(self.position) - 2)
        share = time - s
        if who in (GROUND, CITY):
            return who, np.zeros(3), np.zeros(4)
        if who <= FIRST_OBSTACLE:
            k = FIRST_OBSTACLE - who
            position = (1 - share) * self.obstacle[s, world, k] + share * self.obstacle[s + 1, world, k]
            return who, position, self.obstacle_quaternion[world, k]
        position = (1 - share) * self.position[s, world, who] + share * self.position[s + 1, world, who]
        before, after = self.quaternion[s, world, who], self.quaternion[s + 1, world, who]
        quaternion = (1 - share) * before + share * after * (1 if before @ after >= 0 else -1)
        return who, position, quaternion / np.linalg.norm(quaternion)

    def change(self, world: int, who: int, s: int) -> np.ndarray:
        """(3,) displacement in substep s, m."""
        if who in (GROUND, CITY):
            return np.zeros(3)
        track = self.position[:, world, who] if who >= 0 else self.obstacle[:, world, FIRST_OBSTACLE - who]
        return track[s + 1] - track[s]

    def freeze(self, world: int, drone: int, time: float) -> None:
        """Hold the drone at its pose of `time` from there on."""
        _, position, quaternion = self.pose(world, drone, time)
        later = slice(int(np.ceil(time)), None)
        self.position[later, world, drone] = position
        self.quaternion[later, world, drone] = quaternion


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


@formula
def _meets_ground(position, radius, w, i):
    for s in range(position.shape[0]):
        if position[s, w, i, 2] < radius[w, i] + TOUCH:
            return True
    return False


@formula
def _meets_city(position, radius, atlas, w, i):
    """Whether the box about the drone's bounding sphere in some substep overlaps that about a piece of the city."""
    margin = radius[w, i] + TOUCH
    for s in range(position.shape[0] - 1):
        one, two = three(position[s], w, i), three(position[s + 1], w, i)
        low = min(one[0], two[0]) - margin, min(one[1], two[1]) - margin, min(one[2], two[2]) - margin
        high = max(one[0], two[0]) + margin, max(one[1], two[1]) + margin, max(one[2], two[2]) + margin
        if meets(atlas, w, low, high):
            return True
    return False


@formula
def _near(one, two, w, i, j, within):
    """Whether tracks i and j begin closer to each other than `within` m."""
    gap = _gap(one, two, 0, w, i, j)
    return dot(gap, gap) < within * within


@formula
def _meets(one, two, w, i, j, within):
    """Whether tracks i of `one` and j of `two` (S + 1, W, ., 3) come closer than `within` m."""
    for s in range(one.shape[0] - 1):
        if closest_squared(_gap(one, two, s, w, i, j), _gap(one, two, s + 1, w, i, j))[1] < within * within:
            return True
    return False


@formula
def _gap(one, two, s, w, i, j):
    return two[s, w, j, 0] - one[s, w, i, 0], two[s, w, j, 1] - one[s, w, i, 1], two[s, w, j, 2] - one[s, w, i, 2]


@kernel
def _candidates(position, obstacle, alive, radius, obstacle_radius, atlas):
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
            if _meets_city(position, radius, atlas, w, i):
                found.append((w, i, CITY))
            for k in range(obstacle.shape[2]):
                within = radius[w, i] + obstacle_radius[k] + TOUCH
                near = _near(position, obstacle, w, i, k, within + reach[w, i] + obstacle_reach[w, k])
                if near and _meets(position, obstacle, w, i, k, within):
                    found.append((w, i, FIRST_OBSTACLE - k))
            farthest = position[0, w, i, 0] + radius[w, i] + reach[w, i] + widest + TOUCH
            for b in range(a + 1, order.shape[0]):
                j = order[b]
                if position[0, w, j, 0] > farthest:
                    break
                within = radius[w, i] + radius[w, j] + TOUCH
                near = alive[w, j] and _near(position, position, w, i, j, within + reach[w, i] + reach[w, j])
                if near and _meets(position, position, w, i, j, within):
                    found.append((w, min(i, j), max(i, j)))
    return found


@kernel
def _partners(position, alive, radius, w, i):
    """The pairs of `_candidates` between drone `i` and another drone."""
    found = [(0, 0, 0) for _ in range(0)]
    for j in range(alive.shape[1]):
        within = radius[w, i] + radius[w, j] + TOUCH
        if j != i and alive[w, j] and _meets(position, position, w, i, j, within):
            found.append((w, min(i, j), max(i, j)))
    return found


def _speed_bound(path: Path, pair: tuple[int, int, int], radius: np.ndarray, s: int) -> float:
    """Most metres by which the gap between the shapes can shrink in substep s: translation plus rotation of each."""
    w, one, two = pair
    bound = float(np.linalg.norm(path.change(w, one, s) - path.change(w, two, s)))
    for drone in (one, two):
        if drone >= 0:
            cosine = abs(path.quaternion[s, w, drone] @ path.quaternion[s + 1, w, drone])
            turned = min(2 * np.arccos(min(1.0, cosine)), 2.0)  # no rotation moves a point by more than a diameter
            bound += float(turned * radius[w, drone])
    return bound


def first_touch(world: World, path: Path, pair: tuple[int, int, int], radius: np.ndarray) -> float:
    """Time in substeps of the pair's first touch, inf if none. A pair that starts in touch and parts does not count."""
    w, one, two = pair
    last = len(path.position) - 1

    def gap(time: float, within: float) -> float:
        return world.separation(w, path.pose(w, one, time), path.pose(w, two, time), within)

    time = 0.0
    while time < last:
        s = int(time)
        bound = _speed_bound(path, pair, radius, s)
        remaining = s + 1 - time
        distance = gap(time, bound * remaining + TOUCH)
        if distance <= TOUCH:
            later = s + 1.0 if bound * remaining <= TOUCH else time + TOUCH / bound
            if gap(later, 2 * TOUCH) < distance:
                return time
            time = later  # parting, or at rest
        elif distance >= bound * remaining:
            time = s + 1.0
        else:
            time += (distance - 0.5 * TOUCH) / bound
    return np.inf


def _in_order(
    path: Path, pairs: list[tuple[int, int, int]], alive: np.ndarray, radius: np.ndarray, touch: Callable
) -> Iterator[tuple[float, tuple[int, int, int]]]:
    """Touches (time, pair) in order of time, `touch` telling a pair's; after each its drones are frozen in the path.

    Whoever was to meet a frozen drone, and whoever meets it now, is asked anew.
    """
    times = {pair: touch(pair) for pair in pairs}
    done, frozen = set(), set()
    while times:
        time, pair = min((time, pair) for pair, time in times.items())
        if time == np.inf:
            return
        del times[pair]
        done.add(pair)
        yield time, pair
        w, *ends = pair
        for drone in ends:
            if drone >= 0 and (w, drone) not in frozen:
                frozen.add((w, drone))
                path.freeze(w, drone, time)
                pending = [other for other in times if other[0] == w and drone in other[1:]]
                for met in {*pending, *_partners(path.position, alive, radius, w, drone)} - done:
                    times[met] = touch(met)


def stop_at_first_touch(world: World, path: Path, swarm: Swarm, alive: np.ndarray, parameters: np.ndarray) -> Contacts:
    """Stop every drone that touched something where it did, in order of time, and tell the contacts.

    The impulse is that of a stop: mass times the speed at the touch.
    """
    radius = parameters["collision_radius"]
    pairs = _candidates(path.position, path.obstacle, alive, radius, world.obstacle_radius, world.atlas)
    rows: dict[tuple[int, int, int], float] = {}
    for time, (w, i, j) in _in_order(path, pairs, alive, radius, lambda pair: first_touch(world, path, pair, radius)):
        for drone, other in _both_sides(i, j):
            speed = float(np.linalg.norm(path.change(w, drone, int(time)))) / world.dt
            rows[w, drone, other] = float(parameters["mass"][w, drone]) * speed
    for w, i, _ in rows:
        swarm.position[w, i], swarm.quaternion[w, i] = path.position[-1, w, i], path.quaternion[-1, w, i]
        swarm.velocity[w, i] = swarm.rates[w, i] = 0
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
def suspects(path, alive, parameters, obstacle_radius, atlas):
    """Whether `catch_fast` has anything to look at."""
    if not _any_fast(path.position, path.obstacle, alive, parameters):
        return False
    radius = parameters.collision_radius
    return len(_candidates(path.position, path.obstacle, alive, radius, obstacle_radius, atlas)) > 0


def catch_fast(
    world: World, path: Path, swarm: Swarm, alive: np.ndarray, parameters: np.ndarray
) -> list[tuple[int, int, int]]:
    """Continuous collision detection for one engine substep (a path with S = 1): no drone may jump over a contact.

    The engine looks for contacts only where a substep begins. Pairs that moved against each other by more than a quarter of
    the drone's thinnest extent are checked along the way; those that touched are put back to where they did, with their
    velocities, for the engine to resolve the contact in its next substep. Pairs that were in touch already are held only
    where they would go deeper.

    Returns (world, drone, other) of what was caught, both sides of a pair.
    """
    if not _any_fast(path.position, path.obstacle, alive, parameters):
        return []
    radius, far = parameters["collision_radius"], 0.25 * parameters["thinnest"]
    asked = np.zeros(alive.shape, dtype=bool)

    def touch(pair: tuple[int, int, int]) -> float:
        w, one, two = pair
        if float(np.linalg.norm(path.change(w, one, 0) - path.change(w, two, 0))) <= far[w, one]:
            return np.inf
        for drone, _ in _both_sides(one, two):
            asked[w, drone] = True
        before, after = (
            world.separation(w, path.pose(w, one, time), path.pose(w, two, time), 2 * TOUCH) for time in (0.0, 1.0)
        )
        if before > TOUCH:
            return first_touch(world, path, pair, radius)
        return 0.0 if after < before - far[w, one] else np.inf

    pairs = _candidates(path.position, path.obstacle, alive, radius, world.obstacle_radius, world.atlas)
    caught = [
        (w, drone, other)
        for _, (w, one, two) in _in_order(path, pairs, alive, radius, touch)
        for drone, other in _both_sides(one, two)
    ]
    for w, drone, _ in caught:
        swarm.position[w, drone], swarm.quaternion[w, drone] = path.position[1, w, drone], path.quaternion[1, w, drone]
    if asked.any():
        world.set_states(swarm, asked)
    return caught
