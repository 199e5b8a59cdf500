"""State of all drones of all worlds, motion of obstacles, and contacts."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Quat4, Vec3, quat4, vec3

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position, quaternion, velocity and rates of one drone, as in `Swarm`."""


class Swarm(NamedTuple):
    """State of W worlds of N drones, float64, SI units; compiled functions accept it directly.

    World axes are ENU, body axes FLU.

    Attributes:
        position: (W, N, 3) centre of mass in the frame of the world, m.
        quaternion: (W, N, 4) attitude, body to world, (x, y, z, w).
        velocity: (W, N, 3) velocity of the centre of mass, world axes, m/s.
        rates: (W, N, 3) angular velocity, body axes, rad/s.
        rotor_speed: (W, N, R) rotor speeds, rad/s; R is the largest number of rotors in the swarm.
        deflection: (W, N, S) deflections of control surfaces, rad; S is the largest number of them
            in the swarm, 0 for multirotors.
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    rotor_speed: np.ndarray
    deflection: np.ndarray

    @classmethod
    def zeros(
        cls, num_worlds: int, num_drones: int, num_rotors: int, num_surfaces: int = 0
    ) -> "Swarm":
        """Make a swarm at rest at the origin, level, with stopped rotors.

        Args:
            num_worlds: W.
            num_drones: N.
            num_rotors: R.
            num_surfaces: S.
        """
        shape, sizes = (num_worlds, num_drones), (3, 4, 3, 3, num_rotors, num_surfaces)
        swarm = cls(*(np.zeros((*shape, size)) for size in sizes))
        swarm.quaternion[..., 3] = 1
        return swarm

    def copy(self) -> "Swarm":
        """Return a deep copy."""
        return Swarm(*[array.copy() for array in self])

    def world(self, index: int) -> "Swarm":
        """Return the state of one world, as views: each array loses its first axis."""
        return Swarm(*(array[index] for array in self))


class DroneArrays(NamedTuple):
    """State and constants of the drones of W worlds of N drones.

    Attributes:
        swarm: State of all drones.
        alive: (W, N) bool, drones that fly; all others neither move nor act.
        parameters: (W, N) rows of `PARAMETERS`.
    """

    swarm: Swarm
    alive: np.ndarray
    parameters: np.ndarray


class TimeStep(NamedTuple):
    """Division of a decision into substeps.

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
    """Set the state of one drone, in the form of `get_state`."""
    position, quaternion, velocity, rates = state
    for k in range(3):
        swarm.position[w, i, k] = position[k]
        swarm.velocity[w, i, k] = velocity[k]
        swarm.rates[w, i, k] = rates[k]
    for k in range(4):
        swarm.quaternion[w, i, k] = quaternion[k]


@func
def _reflect(velocity: float, beyond: float, rebound: float) -> float:
    """Return a velocity component across a side, reflected if it leads further beyond this side."""
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
    """Move drones that left a box back to its sides, and reflect their velocities.

    The components across the sides that they left are reflected, of the velocity and of the
    commanded velocity.

    Args:
        swarm: The state; changed in place.
        commanded: (W, N, 3) commanded velocities, m/s; changed in place.
        flown: (W, N) bool, the drones to confine.
        low: (3,) low corner of the box, m.
        high: (3,) high corner of the box, m.
        rebound: Fraction of the velocity that is reflected.
        moved: (W, N) bool, written: the drones that were moved back.

    Returns:
        True if any drone was moved back.
    """
    any_moved = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            moved[w, i] = False
            if not flown[w, i]:
                continue
            for k in range(3):
                # Each axis separately: a drone in a corner has left two or three sides.
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
    """Motion of the K obstacles of each world during a decision: straight, without rotation.

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
        """Make the motion of zero obstacles."""
        nowhere = np.zeros((num_worlds, 0, 3))
        return cls(before=nowhere, after=nowhere, quaternion=np.zeros((num_worlds, 0, 4)))


GROUND = -1
"""`other` of a contact with the ground."""
CITY = -2
"""`other` of a contact with the city."""
FIRST_OBSTACLE = -3
"""`other` of a contact with obstacle 0; it is FIRST_OBSTACLE - k for obstacle k.

Bodies that users add follow: FIRST_OBSTACLE - K - b for body b in a world of K obstacles.
"""


class Contacts(NamedTuple):
    """Contacts of collision shapes during one decision, sorted by world, drone and other.

    There is one row for each drone in contact, so a pair of drones has two rows.

    Attributes:
        world: (C,) index of the world.
        drone: (C,) index of the drone.
        other: (C,) index of the drone in contact with it, GROUND, CITY, or FIRST_OBSTACLE - k for
            obstacle k.
        impulse: (C,) normal impulse, summed over the decision, N s.
        point: (C, 3) position of the first contact point, m.
        normal: (C, 3) contact normal there, towards the drone.
        velocity: (C, 3) relative velocity of the drone's surface to the other's before the impact,
            m/s.
        depth: (C,) penetration depth there, m. It is greater than 0 only in Bullet's own contacts,
            and where `Dynamics.overlaps` is used: in flight, shapes touch at their surfaces.
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
        """Make an empty table of contacts."""
        indices = np.zeros(0, dtype=np.int64)
        vectors = np.zeros((0, 3))
        scalars = np.zeros(0)
        return cls(indices, indices, indices, scalars, vectors, vectors, vectors, scalars)

    @classmethod
    def merged(cls, **columns: np.ndarray) -> "Contacts":
        """Make contacts from rows, of which several may have the same drone and other.

        Args:
            **columns: Attributes by name. Impulses of rows with the same drone and other are added;
                all other attributes are those of the first such row.

        Returns:
            The sorted contacts.
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
        """Merge these contacts with others; of a contact in both, these contacts come first."""
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
        """Return which drones have a contact.

        Args:
            shape: (W, N).

        Returns:
            (W, N) bool.
        """
        touched = np.zeros(shape, dtype=bool)
        if len(self.world):
            touched[self.world, self.drone] = True
        return touched
