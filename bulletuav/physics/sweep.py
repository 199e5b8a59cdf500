"""Contacts of the levels that Bullet does not integrate: a drone stops at its first touch and never passes through.

A compiled broad phase finds the pairs whose bounding spheres, swept along the decision's path, come close; for those alone
conservative advancement (B. Mirtich, 1996) on Bullet's exact shape distances finds the time of the first touch: no motion
can close a gap faster than its bound, so stepping by gap / bound skips nothing, however thin or fast.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.kernel import kernel
from bulletuav.physics.swarm import GROUND, Contacts, Swarm
from bulletuav.physics.world import World

TOUCH = 1e-3  # m; closer counts as touching


class Path(NamedTuple):
    """Poses at the substeps' ends of one decision: position (S + 1, W, N, 3) m, quaternion (S + 1, W, N, 4)."""

    position: np.ndarray
    quaternion: np.ndarray

    @classmethod
    def begin(cls, swarm: Swarm, substeps: int) -> "Path":
        """Room for a decision, with the present poses first."""
        path = cls(*(np.empty((substeps + 1, *array.shape)) for array in (swarm.position, swarm.quaternion)))
        path.position[0], path.quaternion[0] = swarm.position, swarm.quaternion
        return path

    def pose(self, world: int, drone: int, time: float) -> tuple[int, np.ndarray, np.ndarray]:
        """(drone, position, quaternion) at `time` in substeps, between two of them by straight interpolation."""
        s = min(int(time), len(self.position) - 2)
        share = time - s
        position = (1 - share) * self.position[s, world, drone] + share * self.position[s + 1, world, drone]
        before, after = self.quaternion[s, world, drone], self.quaternion[s + 1, world, drone]
        quaternion = (1 - share) * before + share * after * (1 if before @ after >= 0 else -1)
        return drone, position, quaternion / np.linalg.norm(quaternion)

    def freeze(self, world: int, drone: int, time: float) -> None:
        """Hold the drone at its pose of `time` from there on."""
        _, position, quaternion = self.pose(world, drone, time)
        later = slice(int(np.ceil(time)), None)
        self.position[later, world, drone] = position
        self.quaternion[later, world, drone] = quaternion


@kernel
def _meets_ground(position, radius, w, i):
    return position[:, w, i, 2].min() < radius[w, i] + TOUCH


@kernel
def _meets(position, radius, w, i, j):
    reach = radius[w, i] + radius[w, j] + TOUCH
    for s in range(position.shape[0] - 1):
        if _closest_squared(position, s, w, i, j) < reach * reach:
            return True
    return False


@kernel
def _candidates(position, alive, radius):
    """Pairs (world, drone, other or GROUND) whose bounding spheres come within TOUCH during the path."""
    found = [(0, 0, 0) for _ in range(0)]
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i]:
                if _meets_ground(position, radius, w, i):
                    found.append((w, i, GROUND))
                for j in range(i + 1, alive.shape[1]):
                    if alive[w, j] and _meets(position, radius, w, i, j):
                        found.append((w, i, j))
    return found


@kernel
def _partners(position, alive, radius, w, i):
    """The pairs of `_candidates` between drone `i` and another drone."""
    found = [(0, 0, 0) for _ in range(0)]
    for j in range(alive.shape[1]):
        if j != i and alive[w, j] and _meets(position, radius, w, min(i, j), max(i, j)):
            found.append((w, min(i, j), max(i, j)))
    return found


@kernel
def _closest_squared(position, s, w, i, j):
    """Least squared distance of two centres between substeps s and s + 1, both moving straight."""
    along = square = start = 0.0
    for k in range(3):
        gap = position[s, w, j, k] - position[s, w, i, k]
        change = position[s + 1, w, j, k] - position[s + 1, w, i, k] - gap
        along += gap * change
        square += change * change
        start += gap * gap
    if along >= 0.0:
        return start
    time = min(1.0, -along / square)
    return start + 2.0 * time * along + time * time * square


def _speed_bound(path: Path, world: int, drones: list[int], radius: np.ndarray, s: int) -> float:
    """Most metres by which the gap between the shapes can shrink in substep s: translation plus rotation of each."""
    change = path.position[s + 1, world] - path.position[s, world]
    bound = float(np.linalg.norm(change[drones[0]] - (change[drones[1]] if len(drones) == 2 else 0)))
    for i in drones:
        cosine = abs(path.quaternion[s, world, i] @ path.quaternion[s + 1, world, i])
        bound += float(2 * np.arccos(min(1.0, cosine)) * radius[world, i])
    return bound


def first_touch(world: World, path: Path, pair: tuple[int, int, int], radius: np.ndarray) -> float:
    """Time in substeps of the pair's first touch, inf if none. A pair that starts in touch and parts does not count."""
    w, i, j = pair
    drones = [i] if j == GROUND else [i, j]
    last = len(path.position) - 1
    within = 2.0 * float(radius[w, drones].sum())

    def gap(time: float) -> float:
        return world.separation(w, path.pose(w, i, time), None if j == GROUND else path.pose(w, j, time), within)

    time = 0.0
    while time < last:
        s = int(time)
        bound = _speed_bound(path, w, drones, radius, s)
        distance = gap(time)
        remaining = s + 1 - time
        if distance <= TOUCH:
            later = s + 1.0 if bound * remaining <= TOUCH else time + TOUCH / bound
            if gap(later) < distance:
                return time
            time = later  # parting, or at rest
        elif min(distance, within) >= bound * remaining:
            time = s + 1.0
        else:
            time += (min(distance, within) - 0.5 * TOUCH) / bound
    return np.inf


def stop_at_first_touch(world: World, path: Path, swarm: Swarm, alive: np.ndarray, parameters: np.ndarray) -> Contacts:
    """Stop every drone that touched something where it did, in order of time, and tell the contacts.

    The impulse is that of a stop: mass times the speed lost. Drones that were to meet a stopped one are checked anew.
    """
    radius = parameters["collision_radius"]
    rows: dict[tuple[int, int, int], float] = {}
    stopped: set[tuple[int, int]] = set()
    touches = {pair: first_touch(world, path, pair, radius) for pair in _candidates(path.position, alive, radius)}
    while touches:
        time, pair = min((time, pair) for pair, time in touches.items())
        if time == np.inf:
            break
        del touches[pair]
        w, i, j = pair
        for drone, other in ((i, j),) if j == GROUND else ((i, j), (j, i)):
            speed = float(np.linalg.norm(swarm.velocity[w, drone]))
            rows[w, drone, other] = float(parameters["mass"][w, drone]) * speed
            if (w, drone) not in stopped:
                stopped.add((w, drone))
                path.freeze(w, drone, time)
                for met in _partners(path.position, alive, radius, w, drone):
                    if (w, met[1], met[2]) not in rows:
                        touches[met] = first_touch(world, path, met, radius)
    for w, i in sorted(stopped):
        swarm.position[w, i], swarm.quaternion[w, i] = path.position[-1, w, i], path.quaternion[-1, w, i]
        swarm.velocity[w, i] = swarm.rates[w, i] = 0
    return Contacts.merge(rows)
