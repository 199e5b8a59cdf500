"""The engine: W worlds of N drones as tiles of one Bullet client, behind array calls. It and `calls` alone import pybullet.

What the rest of the package relies on, each held by a test: bodies without Bullet's hidden damping or velocity clamp;
resets in place that leave no trace of the past; a world that does not feel what other worlds do.
"""

import contextlib
import warnings
import weakref
from collections.abc import Sequence

import numpy as np

from bulletuav.kernel import kernel
from bulletuav.physics.airframe import Airframe
from bulletuav.physics.batch import POSTFIX, Batch, Port, load
from bulletuav.physics.calls import DISTANCE, DRONE_GROUP, SURFACE_GROUP, Calls, bullet
from bulletuav.physics.obstacle import Obstacle
from bulletuav.physics.quiet import silenced
from bulletuav.physics.rotation import to_world
from bulletuav.physics.screen import require_screen
from bulletuav.physics.swarm import FIRST_OBSTACLE, GROUND, Swarm
from bulletuav.physics.tiles import columns, land, localise, tile_offset
from bulletuav.physics.view import Picture, metres

ENGINE_VERSION = bullet.getAPIVersion()
EXTENSION = load(bullet.__file__)

FLOOR = 0.02  # m, thickness of the ground in pictures
PARKING_HEIGHT, PARKING_PITCH, PARKING_COLUMNS = 2000.0, 10.0, 100


def _shape(obstacle: Obstacle) -> dict[str, object]:
    """The engine's words for an obstacle's shape."""
    if obstacle.kind == "box":
        return {"shapeType": bullet.GEOM_BOX, "halfExtents": [edge / 2 for edge in obstacle.size]}
    return {"shapeType": bullet.GEOM_SPHERE, "radius": obstacle.size[0]}


@kernel
def _spins(quaternion, rates):
    """(M, 3) angular velocities in world axes."""
    omega = np.empty(rates.shape)
    for m in range(rates.shape[0]):
        omega[m] = to_world(quaternion[m], rates[m])
    return omega


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
        first_world: int = 0,
        live: bool = False,
    ):
        """Connect and build. `dt` is the substep, s; `first_world` the number of the first tile.

        `live` opens a window (RuntimeError where there is no screen).
        """
        if live:
            require_screen()
        with silenced():
            self._client = bullet.connect(bullet.GUI if live else bullet.DIRECT)
        self._finalizer = weakref.finalize(self, _disconnect, self._client)
        self.shape, self.dt, self.first_world = (num_worlds, len(airframes)), dt, first_world
        self._offset = np.array([tile_offset(first_world + k) for k in range(num_worlds)])[:, None, :]
        self._configure(dt, live)
        self._ground = self._make_ground()
        self._parking = self._offset + [
            (PARKING_PITCH * (i % PARKING_COLUMNS), PARKING_PITCH * (i // PARKING_COLUMNS), PARKING_HEIGHT)
            for i in range(len(airframes))
        ]
        self._body = np.array(
            [
                [self._make_drone(airframe, self._parking[w, i]) for i, airframe in enumerate(airframes)]
                for w in range(num_worlds)
            ],
            dtype=np.int32,
        )
        self._drone_of_body = {body: divmod(k, len(airframes)) for k, body in enumerate(self._body.ravel().tolist())}
        self.obstacle_radius = np.array([obstacle.radius for obstacle in obstacles])
        self._obstacle = self._make_obstacles(obstacles)
        self._obstacle_of_body = {body: FIRST_OBSTACLE - k for row in self._obstacle.tolist() for k, body in enumerate(row)}
        self._obstacle_place = np.full((*self._obstacle.shape, 3), -PARKING_HEIGHT)
        self._place = np.zeros((*self.shape, 3))  # positions as the engine gave them, for forces at the centre
        self._omega = np.zeros((*self.shape, 3))
        self._calls = self._make_calls(live)
        self.park(np.ones(self.shape, dtype=bool))

    def _make_calls(self, live: bool) -> Calls | Batch:
        plain = Calls(self._client, self._body.ravel())
        if live or EXTENSION.library is None:  # the engine of a live view runs in a thread of its own
            return plain
        with silenced():
            plugin = bullet.loadPlugin(EXTENSION.path, POSTFIX, physicsClientId=self._client)
        try:
            if plugin < 0:
                raise RuntimeError("the engine refused the plugin")
            return Batch(EXTENSION.library, self._body.ravel())
        except RuntimeError as error:
            warnings.warn(f"{error}: bulletuav flies without its extension, slower; see `bulletuav doctor`", stacklevel=3)
            return plain

    @property
    def port(self) -> Port | None:
        """For compiled code to run substeps, where the extension is active."""
        if not isinstance(self._calls, Batch):
            return None
        return Port(
            *self._calls.functions, self._place, self._omega, self._offset, self._obstacle_place, self.obstacle_radius
        )

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

    def _make_obstacles(self, obstacles: Sequence[Obstacle]) -> np.ndarray:
        """(W, K) bodies, parked far below the ground."""
        client = self._client
        bodies: list[list[int]] = [[] for _ in range(self.shape[0])]
        for obstacle in obstacles:
            collision = bullet.createCollisionShape(**_shape(obstacle), physicsClientId=client)
            visual = bullet.createVisualShape(**_shape(obstacle), rgbaColor=obstacle.colour, physicsClientId=client)
            for row in bodies:
                row.append(bullet.createMultiBody(0, collision, visual, [0, 0, -PARKING_HEIGHT], physicsClientId=client))
                bullet.setCollisionFilterGroupMask(row[-1], -1, SURFACE_GROUP, DRONE_GROUP, client)
        return np.array(bodies, dtype=np.int32).reshape(self.shape[0], len(obstacles))

    def set_obstacles(self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray) -> None:
        """Put the obstacles of `worlds` (W,) at position (W, K, 3) with quaternion (W, K, 4)."""
        if self.obstacle_radius.size:
            self._obstacle_place[worlds] = position[worlds]
            place = (position + self._offset)[worlds].reshape(-1, 3)
            self._calls.pose(self._obstacle[worlds].ravel(), place, quaternion[worlds].reshape(-1, 4))

    def set_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Put the drones of `mask` (W, N) where `swarm` says, with its velocities, free of anything from their past."""
        quaternion = swarm.quaternion[mask]
        self._put(
            mask,
            (swarm.position + self._offset)[mask],
            quaternion,
            swarm.velocity[mask],
            _spins(quaternion, swarm.rates[mask]),
            DRONE_GROUP | SURFACE_GROUP,
        )

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Give the drones of one world mass (N,) kg and principal moments of inertia (N, 3) kg m^2."""
        for body, m, moments in zip(self._body[world].tolist(), mass.tolist(), inertia.tolist(), strict=True):
            bullet.changeDynamics(body, -1, mass=m, localInertiaDiagonal=moments, physicsClientId=self._client)

    def set_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Show the drones of `mask` (W, N) where `swarm` says, without touching velocities or contacts."""
        self._calls.pose(self._body[mask], (swarm.position + self._offset)[mask], swarm.quaternion[mask])

    def park(self, mask: np.ndarray) -> None:
        """Take the drones of `mask` (W, N) out of the airspace, to rest where nothing touches or sees them."""
        if mask.any():
            still = np.zeros((int(mask.sum()), 3))
            level = np.tile([0.0, 0.0, 0.0, 1.0], (len(still), 1))
            self._put(mask, self._parking[mask], level, still, still, 0)

    def _put(
        self,
        mask: np.ndarray,
        place: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
        meets: int,
    ) -> None:
        body = self._body[mask]
        # Setting the filter anew drops the body's cached contacts, without which a reset would remember the last episode.
        self._calls.filter(body, DRONE_GROUP if meets else 0, meets)
        self._calls.pose(body, place, quaternion)
        self._calls.velocity(body, velocity, omega)
        self._place[mask] = place

    def read_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Write the engine's poses and velocities of the drones of `mask` (W, N) into `swarm`; rotor speeds stay."""
        self._calls.read(mask, self._place, swarm.quaternion, swarm.velocity, self._omega)
        localise(self._place, self._offset, self._omega, mask, swarm)

    def apply_wrenches(self, force: np.ndarray, torque: np.ndarray, mask: np.ndarray) -> None:
        """Give each drone of `mask` one force (W, N, 3; world axes, N) and one torque (body axes, N m) for the next step."""
        self._calls.apply(mask, self._place, force, torque)

    def step(self) -> None:
        """Advance everything by one substep."""
        self._calls.step()

    def contacts(self) -> list[tuple[int, int, int, float]]:
        """What touched in the last step: (world, drone, other, normal force in N), both sides of a pair; see `Contacts`."""
        rows = []
        for pair, force in zip(*map(np.ndarray.tolist, self._calls.contacts()), strict=True):
            for mine, other in (pair, pair[::-1]):
                drone = self._drone_of_body.get(mine)
                if drone is not None:
                    rows.append((*drone, self._other(other), force))
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
        return self._calls.rays(start + offset, end + offset, SURFACE_GROUP)

    def surface_below(self, position: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """(W, N) height z of the surface under each drone of `mask`, m; -inf outside `mask`."""
        surface = np.empty(self.shape)
        who, start, end = columns(position, mask, self._obstacle_place, self.obstacle_radius, surface)
        if len(who):
            land(surface, who, start, self.cast_rays(start, end, who[:, 0]))
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
            bodies.append(self._body[world, who] if drone else self._obstacle[world, FIRST_OBSTACLE - who])
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
        self._calls = Calls(self._client, self._body.ravel())  # which the engine's own errors guard from here on
        self._finalizer()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._finalizer.alive
