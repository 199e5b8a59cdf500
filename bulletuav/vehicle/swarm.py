"""The state of all drones of all worlds, and what touched what."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Quat4, Vec3, quat4, vec3

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position, quaternion, velocity and rates of one drone, as in `Swarm`."""


class Swarm(NamedTuple):
    """State of W worlds of N drones, float64, SI units; compiled functions take it as it is.

    World axes are ENU, body axes FLU.

    Attributes:
        position: (W, N, 3) centre of mass in the world's own frame, m.
        quaternion: (W, N, 4) attitude, body to world, (x, y, z, w).
        velocity: (W, N, 3) velocity of the centre of mass, world axes, m/s.
        rates: (W, N, 3) angular velocity, body axes, rad/s.
        rotor_speed: (W, N, R) rotor speeds, rad/s; R is the largest rotor count in the swarm.
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    rotor_speed: np.ndarray

    @classmethod
    def zeros(cls, num_worlds: int, num_drones: int, num_rotors: int) -> "Swarm":
        """Make a swarm at rest at the origin, level, with stopped rotors.

        Args:
            num_worlds: W.
            num_drones: N.
            num_rotors: R.
        """
        shape = (num_worlds, num_drones)
        swarm = cls(*(np.zeros((*shape, size)) for size in (3, 4, 3, 3, num_rotors)))
        swarm.quaternion[..., 3] = 1
        return swarm

    def copy(self) -> "Swarm":
        """Return the same state in arrays of its own."""
        return Swarm(*[array.copy() for array in self])

    def world(self, index: int) -> "Swarm":
        """Return the state of one world, as views: each array loses its first axis."""
        return Swarm(*(array[index] for array in self))


class DroneArrays(NamedTuple):
    """The drones of W worlds of N drones: their state, and what they are.

    Attributes:
        swarm: State of all drones.
        alive: (W, N) bool, drones that fly; the others neither move nor act.
        parameters: (W, N) rows of `PARAMETERS`, with which they fly.
    """

    swarm: Swarm
    alive: np.ndarray
    parameters: np.ndarray


class TimeStep(NamedTuple):
    """How a decision is divided.

    Attributes:
        substeps: Number of substeps.
        dt: Duration of a substep, s.
    """

    substeps: int
    dt: float


@func
def get_state(swarm: Swarm, w: int, i: int) -> State:
    """Return the state of one drone as tuples."""
    return (
        vec3(swarm.position, w, i),
        quat4(swarm.quaternion, w, i),
        vec3(swarm.velocity, w, i),
        vec3(swarm.rates, w, i),
    )


@func
def set_state(swarm: Swarm, w: int, i: int, state: State) -> None:
    """Set the state of one drone, in the form that `get_state` returns."""
    position, quaternion, velocity, rates = state
    for k in range(3):
        swarm.position[w, i, k] = position[k]
        swarm.velocity[w, i, k] = velocity[k]
        swarm.rates[w, i, k] = rates[k]
    for k in range(4):
        swarm.quaternion[w, i, k] = quaternion[k]


@func
def _reflect(velocity: float, beyond: float, rebound: float) -> float:
    """Return a velocity across a side, turned back if it leads further beyond that side."""
    return -rebound * velocity if velocity * beyond > 0.0 else velocity


@kernel
def confine(
    swarm: Swarm,
    commanded: np.ndarray,
    flown: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    rebound: float,
    moved: np.ndarray,
) -> bool:
    """Put drones that left a box back to its sides.

    Across a side that they left, their velocity turns back, and so does the commanded one.

    Args:
        swarm: The state; changed in place.
        commanded: (W, N, 3) commanded velocities, m/s; changed in place.
        flown: (W, N) bool, the drones that count.
        low: (3,) low corner of the box, m.
        high: (3,) high corner of the box, m.
        rebound: Share of the velocity that turns back.
        moved: (W, N) bool, written: the drones that were put back.

    Returns:
        Whether there are any.
    """
    any_moved = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            moved[w, i] = False
            if not flown[w, i]:
                continue
            for k in range(3):
                # Each axis by itself: a drone in a corner has left two or three sides.
                place = swarm.position[w, i, k]
                inside = min(max(place, low[k]), high[k])
                if inside == place:
                    continue
                moved[w, i] = any_moved = True
                beyond = place - inside
                swarm.velocity[w, i, k] = _reflect(swarm.velocity[w, i, k], beyond, rebound)
                commanded[w, i, k] = _reflect(commanded[w, i, k], beyond, rebound)
                swarm.position[w, i, k] = inside
    return any_moved


class ObstacleMotion(NamedTuple):
    """Motion of the K obstacles of each world during a decision: straight, without turning.

    Attributes:
        before: (W, K, 3) positions at the start, m.
        after: (W, K, 3) positions at the end, m.
        quaternion: (W, K, 4) attitudes.
    """

    before: np.ndarray
    after: np.ndarray
    quaternion: np.ndarray

    @classmethod
    def none(cls, num_worlds: int) -> "ObstacleMotion":
        """Make the motion of no obstacles."""
        nowhere = np.zeros((num_worlds, 0, 3))
        return cls(before=nowhere, after=nowhere, quaternion=np.zeros((num_worlds, 0, 4)))


GROUND = -1
"""`other` of a contact with the ground."""
CITY = -2
"""`other` of a contact with the city."""
FIRST_OBSTACLE = -3
"""`other` of a contact with obstacle 0; it is FIRST_OBSTACLE - k for obstacle k.

Bodies that users add go on from there: FIRST_OBSTACLE - K - b for body b beside K obstacles.
"""


class Contacts(NamedTuple):
    """Contacts of collision shapes during one decision, sorted by world, drone and other.

    There is one row for each touching drone, so a pair gives two rows.

    Attributes:
        world: (C,) index of the world.
        drone: (C,) index of the drone.
        other: (C,) index of the drone that it touches, GROUND, CITY, or FIRST_OBSTACLE - k for
            obstacle k.
        impulse: (C,) impulse along the contact normals, summed over the decision, N s.
        point: (C, 3) where they touched first, m.
        normal: (C, 3) unit vector in which the drone was pushed there.
        velocity: (C, 3) velocity of the drone's surface against the other's just before, m/s.
        depth: (C,) how deep their shapes overlapped there, m. Above 0 only in Bullet's own
            contacts, and where `Dynamics.overlaps` looks: in flight they meet at their surfaces.
    """

    world: np.ndarray
    drone: np.ndarray
    other: np.ndarray
    impulse: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    velocity: np.ndarray
    depth: np.ndarray

    @classmethod
    def none(cls) -> "Contacts":
        """Make no contacts."""
        nobody = np.zeros(0, dtype=np.int64)
        nowhere = np.zeros((0, 3))
        nothing = np.zeros(0)
        return cls(nobody, nobody, nobody, nothing, nowhere, nowhere, nowhere, nothing)

    @classmethod
    def merged(cls, **columns: np.ndarray) -> "Contacts":
        """Make contacts of rows of which several may be of the same drone and other.

        Args:
            **columns: Attributes by name. Of rows that are one, impulses are added, and the first
                tells the rest.
        """
        rows = cls(**columns)
        if not len(rows.world):
            return rows
        order = np.lexsort((rows.other, rows.drone, rows.world))
        key = np.stack([rows.world, rows.drone, rows.other])[:, order]
        new = np.ones(len(order), dtype=bool)
        new[1:] = np.any(key[:, 1:] != key[:, :-1], axis=0)
        first = np.flatnonzero(new)
        firsts = cls(*(column[order][first] for column in rows))
        return firsts._replace(impulse=np.add.reduceat(rows.impulse[order], first))

    def joined(self, others: "Contacts") -> "Contacts":
        """Return these and other contacts; of a touch that is in both, these tell the first."""
        columns = map(np.concatenate, zip(self, others, strict=True))
        return Contacts.merged(**dict(zip(Contacts._fields, columns, strict=True)))

    def of_worlds(self, mask: np.ndarray) -> "Contacts":
        """Return copies of the rows of some worlds.

        Args:
            mask: (W,) bool, the worlds.
        """
        rows = mask[self.world]
        return Contacts(*(column[rows] for column in self))

    def mask(self, shape: tuple[int, int]) -> np.ndarray:
        """Tell which drones touched anything.

        Args:
            shape: (W, N).

        Returns:
            (W, N) bool.
        """
        touched = np.zeros(shape, dtype=bool)
        if len(self.world):
            touched[self.world, self.drone] = True
        return touched
