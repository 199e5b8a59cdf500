"""The engine: W worlds of N drones as tiles of one Bullet client, behind array calls. The only module that imports pybullet.

What the rest of the package relies on, each held by a test: bodies without Bullet's hidden damping or velocity clamp;
resets in place that leave no trace of the past; a world that does not feel what other worlds do.
"""

import contextlib
import weakref
from collections.abc import Sequence

import numpy as np

from bulletuav.kernel import kernel
from bulletuav.physics.airframe import Airframe
from bulletuav.physics.obstacle import Obstacle
from bulletuav.physics.quiet import silenced
from bulletuav.physics.rotation import to_body, to_world
from bulletuav.physics.screen import require_screen
from bulletuav.physics.swarm import FIRST_OBSTACLE, GROUND, Swarm
from bulletuav.physics.view import Picture, metres

with silenced():
    import pybullet as bullet

ENGINE_VERSION = bullet.getAPIVersion()

TILE_PITCH = 4096.0  # m; a power of two, larger than any arena
FLOOR = 0.02  # m, thickness of the ground in pictures
RAY_LENGTH = 1000.0  # m, downwards to the surface
PARKING_HEIGHT, PARKING_PITCH, PARKING_COLUMNS = 2000.0, 10.0, 100
DRONE_GROUP, SURFACE_GROUP = 1, 2
MAX_RAYS = 16383  # per call; one more and Bullet answers none

# Columns of a row of getContactPoints.
BODY_A, BODY_B, DISTANCE, NORMAL_FORCE = 1, 2, 8, 9


def tile_offset(world: int) -> np.ndarray:
    """(3,) origin of a world in the engine's frame, m: its index on a Morton curve, whatever the number of worlds."""
    column = sum((world >> 2 * bit & 1) << bit for bit in range(16))
    row = sum((world >> 2 * bit + 1 & 1) << bit for bit in range(16))
    return np.array([column * TILE_PITCH, row * TILE_PITCH, 0.0])


def _shape(obstacle: Obstacle) -> dict[str, object]:
    """The engine's words for an obstacle's shape."""
    if obstacle.kind == "box":
        return {"shapeType": bullet.GEOM_BOX, "halfExtents": [edge / 2 for edge in obstacle.size]}
    return {"shapeType": bullet.GEOM_SPHERE, "radius": obstacle.size[0]}


@kernel
def _world_rates_to_body(quaternion, rates):
    for w in range(rates.shape[0]):
        for i in range(rates.shape[1]):
            rates[w, i] = to_body(quaternion[w, i], rates[w, i])


def _disconnect(client: int) -> None:
    with contextlib.suppress(bullet.error):  # a live view may already have been closed by its user
        bullet.disconnect(client)


class World:
    """W tiles of N drones and K obstacles over one ground plane at z = 0. Poses are in each world's own frame."""

    def __init__(
        self,
        airframes: Sequence[Airframe],
        num_worlds: int,
        dt: float,
        obstacles: Sequence[Obstacle] = (),
        live: bool = False,
    ):
        """Connect and build. `dt` is the substep, s; `live` opens a window (RuntimeError where there is no screen)."""
        if live:
            require_screen()
        with silenced():
            self._client = bullet.connect(bullet.GUI if live else bullet.DIRECT)
        self._finalizer = weakref.finalize(self, _disconnect, self._client)
        self.shape, self.dt = (num_worlds, len(airframes)), dt
        self._offset = np.array([tile_offset(k) for k in range(num_worlds)])[:, None, :]
        self._configure(dt, live)
        self._ground = self._make_ground()
        self._parking = self._offset + [
            (PARKING_PITCH * (i % PARKING_COLUMNS), PARKING_PITCH * (i // PARKING_COLUMNS), PARKING_HEIGHT)
            for i in range(len(airframes))
        ]
        self._body = [
            self._make_drone(airframe, self._parking[w, i])
            for w in range(num_worlds)
            for i, airframe in enumerate(airframes)
        ]
        self._drone_of_body = {body: divmod(k, len(airframes)) for k, body in enumerate(self._body)}
        self.obstacle_radius = np.array([obstacle.radius for obstacle in obstacles])
        self._obstacle = self._make_obstacles(obstacles)
        self._obstacle_of_body = {body: FIRST_OBSTACLE - k for row in self._obstacle for k, body in enumerate(row)}
        self._reported: list = [None] * len(self._body)  # positions as the engine gave them, for forces at the centre
        self.park(np.ones(self.shape, dtype=bool))

    def _configure(self, dt: float, live: bool) -> None:
        # Islands solved one by one and to the full iteration count, pairs in a fixed order: worlds cannot feel each other.
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=dt,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            minimumSolverIslandSize=1,
            solverResidualThreshold=0,
            physicsClientId=self._client,
        )
        bullet.setGravity(0, 0, 0, physicsClientId=self._client)  # weight is part of each drone's wrench
        if live:
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)

    def _make_ground(self) -> int:
        client = self._client
        collision = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        floor = bullet.createVisualShape(
            bullet.GEOM_BOX,
            halfExtents=[1000, 1000, FLOOR / 2],
            rgbaColor=[0.86, 0.88, 0.85, 1],
            specularColor=[0, 0, 0],
            physicsClientId=client,
        )
        self._floor = bullet.createMultiBody(
            0, -1, floor, physicsClientId=client
        )  # only seen; moves to where pictures are taken
        # Without a visual of its own the plane would be drawn as an endless chequerboard.
        speck = bullet.createVisualShape(bullet.GEOM_SPHERE, radius=1e-3, physicsClientId=client)
        ground = bullet.createMultiBody(0, collision, speck, physicsClientId=client)
        bullet.setCollisionFilterGroupMask(ground, -1, SURFACE_GROUP, DRONE_GROUP, physicsClientId=client)
        return ground

    def _make_drone(self, airframe: Airframe, place: np.ndarray) -> int:
        flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_IMPLICIT_CYLINDER
        flags |= bullet.URDF_USE_MATERIAL_COLORS_FROM_MTL
        try:
            with silenced():
                body = bullet.loadURDF(str(airframe.urdf), place.tolist(), flags=flags, physicsClientId=self._client)
        except bullet.error as error:
            raise ValueError(f"{airframe.urdf}: the engine cannot load it: {error}") from None
        # Bullet damps velocities by 4 % a second and clamps them at 100 unless told otherwise; mass and inertia are ours, as
        # its own reading of the file may round or scale them.
        bullet.changeDynamics(
            body,
            -1,
            mass=airframe.mass,
            localInertiaDiagonal=airframe.inertia,
            linearDamping=0,
            angularDamping=0,
            maxJointVelocity=1e4,
            physicsClientId=self._client,
        )
        return body

    def _make_obstacles(self, obstacles: Sequence[Obstacle]) -> list[list[int]]:
        """(W, K) bodies, parked far below the ground."""
        client = self._client
        bodies: list[list[int]] = [[] for _ in range(self.shape[0])]
        for obstacle in obstacles:
            collision = bullet.createCollisionShape(**_shape(obstacle), physicsClientId=client)
            visual = bullet.createVisualShape(**_shape(obstacle), rgbaColor=obstacle.colour, physicsClientId=client)
            for row in bodies:
                row.append(bullet.createMultiBody(0, collision, visual, [0, 0, -PARKING_HEIGHT], physicsClientId=client))
                bullet.setCollisionFilterGroupMask(row[-1], -1, SURFACE_GROUP, DRONE_GROUP, client)
        return bodies

    def set_obstacles(self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray) -> None:
        """Put the obstacles of `worlds` (W,) at position (W, K, 3) with quaternion (W, K, 4)."""
        place = position + self._offset
        for w in np.flatnonzero(worlds):
            for k, body in enumerate(self._obstacle[w]):
                bullet.resetBasePositionAndOrientation(body, place[w, k], quaternion[w, k], self._client)

    def set_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Put the drones of `mask` (W, N) where `swarm` says, with its velocities, free of anything from their past."""
        position = swarm.position + self._offset
        for w, i in np.argwhere(mask):
            quaternion = swarm.quaternion[w, i]
            omega = to_world(quaternion, swarm.rates[w, i])
            self._place((w, i), position[w, i].tolist(), quaternion.tolist(), swarm.velocity[w, i].tolist(), omega)

    def set_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Show the drones of `mask` (W, N) where `swarm` says, without touching velocities or contacts."""
        position = swarm.position + self._offset
        for w, i in np.argwhere(mask):
            body = self._body[w * self.shape[1] + i]
            bullet.resetBasePositionAndOrientation(body, position[w, i], swarm.quaternion[w, i], self._client)

    def park(self, mask: np.ndarray) -> None:
        """Take the drones of `mask` (W, N) out of the airspace, to rest where nothing touches or sees them."""
        for w, i in np.argwhere(mask):
            self._place((w, i), self._parking[w, i].tolist(), (0, 0, 0, 1), (0, 0, 0), (0, 0, 0), meets=0)

    def _place(self, drone, position, quaternion, velocity, omega, meets=DRONE_GROUP | SURFACE_GROUP) -> None:
        index = drone[0] * self.shape[1] + drone[1]
        body, client = self._body[index], self._client
        # Setting the filter anew drops the body's cached contacts, without which a reset would remember the last episode.
        bullet.setCollisionFilterGroupMask(body, -1, DRONE_GROUP if meets else 0, meets, client)
        bullet.resetBasePositionAndOrientation(body, position, quaternion, client)
        bullet.resetBaseVelocity(body, velocity, omega, client)
        self._reported[index] = position

    def read_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Write the engine's poses and velocities of the drones of `mask` (W, N) into `swarm`; rotor speeds stay."""
        client, body = self._client, self._body
        chosen = np.flatnonzero(mask)
        poses = [bullet.getBasePositionAndOrientation(body[k], client) for k in chosen]
        velocities = [bullet.getBaseVelocity(body[k], client) for k in chosen]
        for k, pose in zip(chosen, poses, strict=True):
            self._reported[k] = pose[0]
        if len(chosen):
            offset = np.broadcast_to(self._offset, swarm.position.shape)[mask]
            swarm.position[mask] = np.array([pose[0] for pose in poses]) - offset
            swarm.quaternion[mask] = [pose[1] for pose in poses]
            swarm.velocity[mask] = [velocity[0] for velocity in velocities]
            rates = np.array([[velocity[1] for velocity in velocities]])
            _world_rates_to_body(swarm.quaternion[mask][None], rates)
            swarm.rates[mask] = rates[0]

    def apply_wrenches(self, force: np.ndarray, torque: np.ndarray, mask: np.ndarray) -> None:
        """Give each drone of `mask` one force (W, N, 3; world axes, N) and one torque (body axes, N m) for the next step."""
        client, body, reported = self._client, self._body, self._reported
        forces, torques = force.reshape(-1, 3).tolist(), torque.reshape(-1, 3).tolist()
        for k in np.flatnonzero(mask).tolist():
            bullet.applyExternalForce(body[k], -1, forces[k], reported[k], bullet.WORLD_FRAME, client)
            bullet.applyExternalTorque(body[k], -1, torques[k], bullet.LINK_FRAME, client)

    def step(self) -> None:
        """Advance everything by one substep."""
        bullet.stepSimulation(self._client)

    def contacts(self) -> list[tuple[int, int, int, float]]:
        """What touched in the last step: (world, drone, other, normal force in N), both sides of a pair; see `Contacts`."""
        rows = []
        for point in bullet.getContactPoints(physicsClientId=self._client):
            force = point[NORMAL_FORCE]
            if force > 0 or point[DISTANCE] < 0:
                for mine, theirs in ((BODY_A, BODY_B), (BODY_B, BODY_A)):
                    drone = self._drone_of_body.get(point[mine])
                    if drone is not None:
                        rows.append((*drone, self._other(point[theirs]), force))
        return rows

    def _other(self, body: int) -> int:
        """What a contact calls this body."""
        if body in self._drone_of_body:
            return self._drone_of_body[body][1]
        return self._obstacle_of_body.get(body, GROUND)

    def cast_rays(self, start: np.ndarray, end: np.ndarray, world: np.ndarray) -> np.ndarray:
        """(M,) fraction of each ray from `start` to `end` (M, 3) in world `world` (M,) before a surface; 1 where none.

        Surfaces are everything but drones.
        """
        offset = self._offset[world, 0]
        fraction = np.ones(len(start))
        for first in range(0, len(start), MAX_RAYS):
            part = slice(first, first + MAX_RAYS)
            hits = bullet.rayTestBatch(
                start[part] + offset[part],
                end[part] + offset[part],
                collisionFilterMask=SURFACE_GROUP,
                physicsClientId=self._client,
            )
            fraction[part] = [hit[2] for hit in hits]
        return fraction

    def surface_below(self, position: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """(W, N) height z of the surface under each drone of `mask`, m; -inf where there is none and outside `mask`."""
        surface = np.full(self.shape, -np.inf)
        start = position[mask]
        if len(start):
            fraction = self.cast_rays(start, start - [0, 0, RAY_LENGTH], np.nonzero(mask)[0])
            surface[mask] = np.where(fraction < 1, start[:, 2] - RAY_LENGTH * fraction, -np.inf)
        return surface

    def separation(self, world: int, one: tuple, two: tuple, within: float) -> float:
        """Closest distance of two collision shapes, negative when they overlap, inf beyond `within` (m).

        `one` and `two` are (who, position, quaternion), who as in `Contacts`, and move the engine's bodies there.
        """
        bodies = []
        for who, position, quaternion in (one, two):
            if who == GROUND:
                bodies.append(self._ground)
                continue
            drone = who >= 0
            bodies.append(self._body[world * self.shape[1] + who] if drone else self._obstacle[world][FIRST_OBSTACLE - who])
            place = position + self._offset[world, 0]
            bullet.resetBasePositionAndOrientation(bodies[-1], place, quaternion, self._client)
        points = bullet.getClosestPoints(bodies[0], bodies[1], within, physicsClientId=self._client)
        return min((point[DISTANCE] for point in points), default=np.inf)

    def picture(self, world: int, view: np.ndarray, projection: np.ndarray, size: tuple[int, int]) -> Picture:
        """What a camera given by matrices (see `view`) in the world's own frame sees; needs no screen."""
        floor = self._offset[world, 0] - [0, 0, FLOOR / 2]
        bullet.resetBasePositionAndOrientation(self._floor, floor, [0, 0, 0, 1], self._client)
        shift = np.eye(4)
        shift[:3, 3] = -self._offset[world, 0]
        width, height = size
        _, _, pixels, buffer, bodies = bullet.getCameraImage(
            width,
            height,
            (view @ shift).T.ravel().tolist(),  # Bullet wants columns first
            projection.T.ravel().tolist(),
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        bodies = np.asarray(bodies).reshape(height, width)
        pixels = np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        depth = metres(np.asarray(buffer, dtype=np.float64).reshape(height, width)).astype(np.float32)
        return Picture(pixels, depth, bodies == self._floor, bodies < 0)

    def look_at(self, world: int, target: np.ndarray, distance: float) -> None:
        """Point the live view at `target` (3,) of a world from `distance` metres."""
        place = (target + self._offset[world, 0]).tolist()
        bullet.resetDebugVisualizerCamera(distance, 45, -35, place, physicsClientId=self._client)

    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._finalizer()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._finalizer.alive
