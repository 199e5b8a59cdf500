"""A rig for contacts: worlds of drones among things to touch, flown freely or by a dynamics."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from bulletuav.compiled.kernel import allocating
from bulletuav.control.cascade import Cascade
from bulletuav.control.gains import gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import find_dynamics
from bulletuav.dynamics.base import FlightSetup
from bulletuav.engine.engine import Engine
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.gjk import gjk_distance, make_scratch
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes
from bulletuav.geometry.scenery import NOWHERE
from bulletuav.geometry.shapes import HALF_SPACE
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.swarm import Contacts, ObstacleMotion, Swarm

CLIMB = (0.0, 0.0, 1.0, 0.0)
"""Setpoint of a velocity: 1 m/s upwards"""


def random_attitudes(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Draw attitudes (..., 4), all equally likely."""
    quaternion = rng.normal(size=(*shape, 4))
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def random_directions(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Draw unit vectors (..., 3), all equally likely."""
    way = rng.normal(size=(*shape, 3))
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


class Rig:
    """W worlds of N drones, 5 m apart at 10 m, level, at rest.

    Without setpoints rotors stand still and air does nothing: six degrees of freedom under gravity
    alone (rigid_body and bullet), straight flight at the present velocity (the kinematic ones).

    Attributes:
        swarm: State of all drones; write to it, then call `place`.
        alive: (W, N) bool, drones that fly.
        obstacle: (W, K, 3) positions of the obstacles, m; NOWHERE until they are written.
        turn: (W, K, 4) their attitudes.
        drift: (W, K, 3) their velocities, m/s.
        time: Since the beginning, s.
    """

    def __init__(
        self,
        airframes: Sequence[str] = ("cf2x",),
        *,
        dynamics: str = "rigid_body",
        worlds: int = 1,
        hz: int = 240,
        substeps: int = 1,
        gravity: float = STANDARD_GRAVITY,
        obstacles: Sequence[Obstacle] = (),
        boxes: Sequence = (),
        contacts: str | None = None,
        friction: float = 0.5,
        restitution: float = 0.0,
        first_world: int = 0,
        extended: Sequence[str] = (),
    ) -> None:
        """Build the worlds.

        Args:
            airframes: Of the N drones of a world.
            dynamics: A name of `DYNAMICS`.
            worlds: W.
            hz: Substeps a second.
            substeps: Of a decision.
            gravity: m/s^2.
            obstacles: The K obstacles of a world.
            boxes: Low and high corner of each box of the city, m.
            contacts: What contacts do; None for what is usual for the dynamics.
            friction: Of the ground, the city, and all drones.
            restitution: Of the same.
            first_world: Number of the first world.
            extended: Effects of rotors that act.
        """
        self.airframes = [load_airframe(name) for name in airframes]
        self.dt, self.substeps, self.gravity = 1 / hz, substeps, gravity
        layouts = [Solids(np.array(boxes, dtype=float).reshape(-1, 2, 3))] if len(boxes) else []
        self.engine = Engine(self.airframes, worlds, self.dt, obstacles, layouts, first_world)
        everywhere = np.ones(worlds, dtype=bool)
        if layouts:
            self.engine.set_layouts(np.zeros(worlds, dtype=int), everywhere)
        rows = np.tile(parameter_rows(self.airframes, extended), (worlds, 1))
        rows["friction"], rows["restitution"] = friction, restitution
        cascade = Cascade.of("lee", rows, np.tile(gain_rows(self.airframes, 100.0), (worlds, 1)))
        found = find_dynamics(dynamics)
        self.contacts = contacts or found.contacts[0]
        flight = FlightSetup(
            self.engine,
            rows,
            cascade,
            self.dt,
            substeps,
            gravity,
            self.contacts,
            friction,
            restitution,
        )
        self.dynamics = found(flight)
        self.rows = rows
        num_drones = len(self.airframes)
        most_rotors = max(len(one.rotors) for one in self.airframes)
        self.swarm = Swarm.zeros(worlds, num_drones, most_rotors)
        self.swarm.position[..., 0] = 5 * np.arange(num_drones)
        self.swarm.position[..., 2] = 10
        self.alive = np.ones((worlds, num_drones), dtype=bool)
        self.wind = np.zeros((worlds, num_drones, 3))
        self.obstacle = np.full((worlds, len(obstacles), 3), NOWHERE)
        self.turn = np.tile([0.0, 0, 0, 1], (worlds, len(obstacles), 1))
        self.drift = np.zeros(self.obstacle.shape)
        self._everywhere = everywhere
        self.time = 0.0

    def place(self) -> "Rig":
        """Start the drones from what is written to the swarm, and put the obstacles up."""
        self.engine.set_obstacles(self.obstacle, self.turn, self._everywhere)
        self.dynamics.place(self.swarm, self.alive)
        return self

    def fly(self, level: SetpointLevel | None = None, setpoint: Sequence = ()) -> Contacts:
        """Fly one decision: under a setpoint (of all drones), or freely."""
        if level is None:
            level, setpoint = self._free()
        shape = (*self.alive.shape, np.shape(setpoint)[-1])
        wanted = np.broadcast_to(np.asarray(setpoint, dtype=float), shape).copy()
        before = self.obstacle
        after = before
        if self.drift.any():
            after = before + self.substeps * self.dt * self.drift
        motion = ObstacleMotion(before, after, self.turn)
        contacts = self.dynamics.fly(self.swarm, self.alive, level, wanted, self.wind, motion)
        self.obstacle = after
        self.engine.set_obstacles(after, self.turn, self._everywhere)
        self.time += self.substeps * self.dt
        return contacts

    def fly_for(self, seconds: float) -> Contacts:
        """Fly freely for a time; returns all contacts, merged."""
        recorded = [self.fly() for _ in range(round(seconds / (self.substeps * self.dt)))]
        return Contacts.merged(
            **{
                name: np.concatenate([getattr(c, name) for c in recorded])
                for name in Contacts._fields
            }
        )

    def _free(self) -> tuple[SetpointLevel, np.ndarray]:
        """Return the setpoint under which nothing but gravity acts."""
        consumes = self.dynamics.consumes
        if consumes == SetpointLevel.VELOCITY:
            yaw = np.zeros((*self.alive.shape, 1))
            return consumes, np.concatenate([self.swarm.velocity, yaw], axis=-1)
        size = self.swarm.rotor_speed.shape[-1] if consumes == SetpointLevel.ROTOR else 4
        return consumes, np.zeros(size)

    def energy(self) -> np.ndarray:
        """Return the mechanical energy of each drone (W, N), J."""
        swarm = self.swarm
        moving = 0.5 * self.rows["mass"] * (swarm.velocity**2).sum(axis=-1)
        turning = 0.5 * (self.rows["inertia"] * swarm.rates**2).sum(axis=-1)
        return moving + turning + self.rows["mass"] * self.gravity * swarm.position[..., 2]

    def momentum(self) -> np.ndarray:
        """Return the linear momentum of each drone (W, N, 3), N s."""
        return self.rows["mass"][..., None] * self.swarm.velocity

    def spin_momentum(self) -> np.ndarray:
        """Return the angular momentum of each drone about the origin (W, N, 3), N m s."""
        turn = Rotation.from_quat(self.swarm.quaternion.reshape(-1, 4))
        own = turn.apply((self.rows["inertia"] * self.swarm.rates).reshape(-1, 3))
        own = own.reshape(self.swarm.rates.shape)
        return own + np.cross(self.swarm.position, self.momentum())

    def gaps(self, drone: int, other: int) -> np.ndarray:
        """Return the distance of a drone from shape `other` of the scenery in each world (W,), m.

        Shapes are numbered as in `Scenery`: drones, obstacles, pieces of the city, the ground.
        """
        scenery = self.engine.scenery
        swarm = self.swarm
        still = np.array([0.0, 0.0, 0.0, 1.0])
        if other < scenery.first_body:
            place, turn = swarm.position[:, other], swarm.quaternion[:, other]
        elif other < scenery.first_piece:
            k = other - scenery.first_body
            place, turn = self.obstacle[:, k], self.turn[:, k]
        elif other < scenery.ground:
            place, turn = scenery.piece_place[other - scenery.first_piece], still
        else:
            place, turn = np.zeros(3), still
        return measure_gaps(
            scenery.table,
            drone,
            other,
            swarm.position[:, drone],
            swarm.quaternion[:, drone],
            np.broadcast_to(place, (len(self.alive), 3)),
            np.broadcast_to(turn, (len(self.alive), 4)),
        )

    @property
    def ground(self) -> int:
        """Number of the ground's shape."""
        return self.engine.scenery.ground

    @property
    def everything(self) -> list[int]:
        """Numbers of all shapes: the drones, what stands, the ground."""
        return list(range(self.engine.scenery.ground + 1))

    def lowest(self, drone: int = 0) -> np.ndarray:
        """Return the height of the lowest point of a drone in each world (W,), m.

        In closed form: all airframes are upright cylinders.
        """
        up = Rotation.from_quat(self.swarm.quaternion[:, drone]).as_matrix()[:, 2, 2]
        across, _, half = self.airframes[drone].shape.half
        deep = across * np.sqrt(np.maximum(0.0, 1 - up**2)) + half * np.abs(up)
        return self.swarm.position[:, drone, 2] - deep

    def close(self) -> None:
        """Free the engine."""
        self.engine.close()

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@allocating
def _gaps(table, a, b, place_a, turn_a, place_b, turn_b, room):  # type: ignore[no-untyped-def]
    """Return the distances (M,) of shape a from shape b at M pairs of poses, m."""
    found = np.zeros(len(place_a))
    level = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for m in range(len(found)):
        qa = (turn_a[m, 0], turn_a[m, 1], turn_a[m, 2], turn_a[m, 3])
        qb = (turn_b[m, 0], turn_b[m, 1], turn_b[m, 2], turn_b[m, 3])
        offset = (
            place_b[m, 0] - place_a[m, 0],
            place_b[m, 1] - place_a[m, 1],
            place_b[m, 2] - place_a[m, 2],
        )
        turn = level if table.kind[b] == HALF_SPACE else axes(qb)
        found[m] = gjk_distance(table, a, axes(qa), b, turn, offset, (0.0, 0.0, 0.0), room)[0]
    return found


def measure_gaps(
    table: ShapeTable,
    a: int,
    b: int,
    place_a: np.ndarray,
    turn_a: np.ndarray,
    place_b: np.ndarray,
    turn_b: np.ndarray,
) -> np.ndarray:
    """Return the distances (M,) of shape a from shape b of a table at M pairs of poses, m."""
    found: np.ndarray = _gaps(table, a, b, place_a, turn_a, place_b, turn_b, make_scratch())
    return found
