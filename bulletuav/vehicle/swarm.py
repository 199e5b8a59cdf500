"""The state of all drones of all worlds, and what touched what."""

from typing import NamedTuple

import numpy as np

from bulletuav.geometry.rotation import quat4, vec3
from bulletuav.kernel import func, kernel


class Swarm(NamedTuple):
    """State of W worlds of N drones, float64, SI units, world ENU, body FLU. Compiled functions take it as it is.

    position    (W, N, 3) centre of mass in the world's own frame, m
    quaternion  (W, N, 4) body to world, (x, y, z, w)
    velocity    (W, N, 3) of the centre of mass, world axes, m/s
    rates       (W, N, 3) angular velocity, body axes, rad/s
    rotor_speed (W, N, R) rad/s, R the largest rotor count in the swarm
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    rotor_speed: np.ndarray

    @classmethod
    def zeros(cls, num_worlds: int, num_drones: int, num_rotors: int) -> "Swarm":
        """At rest at the origin, level, rotors stopped."""
        shape = (num_worlds, num_drones)
        swarm = cls(*(np.zeros((*shape, size)) for size in (3, 4, 3, 3, num_rotors)))
        swarm.quaternion[..., 3] = 1
        return swarm

    def copy(self) -> "Swarm":
        """The same state in arrays of its own."""
        return Swarm(*[array.copy() for array in self])

    def world(self, index: int) -> "Swarm":
        """One world's state; each array loses its first axis. A view, not a copy."""
        return Swarm(*(array[index] for array in self))


@func
def get(swarm, w, i):
    """(position, quaternion, velocity, rates) of one drone, as tuples."""
    return (
        vec3(swarm.position, w, i),
        quat4(swarm.quaternion, w, i),
        vec3(swarm.velocity, w, i),
        vec3(swarm.rates, w, i),
    )


@func
def put(swarm, w, i, state):
    """Set what `get` gets."""
    position, quaternion, velocity, rates = state
    for k in range(3):
        swarm.position[w, i, k], swarm.velocity[w, i, k], swarm.rates[w, i, k] = (
            position[k],
            velocity[k],
            rates[k],
        )
    for k in range(4):
        swarm.quaternion[w, i, k] = quaternion[k]


@func
def _turned(velocity, beyond, rebound):
    return -rebound * velocity if velocity * beyond > 0.0 else velocity


@kernel
def confine(swarm, commanded, flown, low, high, rebound):
    """Put drones of `flown` (W, N) outside a box (3,), m, back to its sides; (W, N) bool: which.

    Across a side that they left their velocity, and that `commanded` (W, N, 3), turns back, to the share `rebound`.
    """
    moved = np.zeros(flown.shape, dtype=np.bool_)
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            if not flown[w, i]:
                continue
            for k in range(3):
                place = swarm.position[w, i, k]
                inside = min(max(place, low[k]), high[k])
                if inside == place:
                    continue
                moved[w, i] = True
                swarm.velocity[w, i, k] = _turned(swarm.velocity[w, i, k], place - inside, rebound)
                commanded[w, i, k] = _turned(commanded[w, i, k], place - inside, rebound)
                swarm.position[w, i, k] = inside
    return moved


class Motion(NamedTuple):
    """Where the K obstacles of each world go during a decision: straight from `before` to `after`, without turning.

    before, after (W, K, 3) m, the same array where nothing moves; quaternion (W, K, 4)
    """

    before: np.ndarray
    after: np.ndarray
    quaternion: np.ndarray

    @classmethod
    def none(cls, num_worlds: int) -> "Motion":
        """No obstacles."""
        nowhere = np.zeros((num_worlds, 0, 3))
        return cls(nowhere, nowhere, np.zeros((num_worlds, 0, 4)))

    @property
    def moving(self) -> bool:
        """Whether any obstacle changes its place."""
        return self.after is not self.before

    def at(self, share: float | np.ndarray) -> np.ndarray:
        """(W, K, 3) positions after a share of the decision, or (S, W, K, 3) after shares (S, 1, 1, 1)."""
        return self.before + share * (self.after - self.before)


GROUND, CITY = -1, -2
FIRST_OBSTACLE = -3
"""`other` of a contact: a drone's index, GROUND, CITY, or FIRST_OBSTACLE - k for obstacle k"""


class Contacts(NamedTuple):
    """Contacts of collision shapes during one decision, one row per touching drone (a pair gives two rows).

    world   (C,) index of the world
    drone   (C,) index of the drone
    other   (C,) index of the drone that it touches, GROUND, CITY, or FIRST_OBSTACLE - k for obstacle k
    impulse (C,) N s along the contact normal, summed over the decision
    """

    world: np.ndarray
    drone: np.ndarray
    other: np.ndarray
    impulse: np.ndarray

    @classmethod
    def merge(cls, rows: dict[tuple[int, int, int], float]) -> "Contacts":
        """From {(world, drone, other): impulse}, in sorted order."""
        if not rows:
            nothing = np.zeros(0, dtype=np.int64)
            return cls(nothing, nothing, nothing, np.zeros(0))
        keys = sorted(rows)
        world, drone, other = np.array(keys, dtype=np.int64).reshape(len(keys), 3).T
        return cls(world, drone, other, np.array([rows[key] for key in keys], dtype=np.float64))

    def joined(self, others: "Contacts") -> "Contacts":
        """These and others, one after the other."""
        return Contacts(*(np.concatenate(columns) for columns in zip(self, others, strict=True)))

    def mask(self, shape: tuple[int, int]) -> np.ndarray:
        """(W, N) bool: which drones touched anything."""
        touched = np.zeros(shape, dtype=bool)
        if len(self.world):
            touched[self.world, self.drone] = True
        return touched
