"""The engine: W worlds of N drones as tiles of one Bullet client, behind array calls.

It, `calls` and `bodies` alone import pybullet.

What the rest of the package relies on, each held by a test: bodies without Bullet's hidden damping or velocity clamp;
resets in place that leave no trace of the past; a world that does not feel what other worlds do.
"""

import contextlib
import itertools
import warnings
import weakref
from collections.abc import Sequence

import numpy as np

from bulletuav.engine.bodies import FLOOR, make_drone, make_floor, make_ground, make_obstacles
from bulletuav.engine.c_extension import POSTFIX, CExtension, Port, load
from bulletuav.engine.calls import DISTANCE, DRONE_GROUP, SOLID, VISIBLE, EngineCalls, bullet
from bulletuav.engine.city_layouts import LayoutBodies
from bulletuav.engine.screen import require_screen
from bulletuav.engine.silence import silenced
from bulletuav.engine.tiles import columns, land, localise, tile_offset, within_tile
from bulletuav.geometry.city_grid import CityGrid
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.raycast import walk
from bulletuav.geometry.rotation import to_world
from bulletuav.geometry.shapes import meet_drones
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY, Picture, metres
from bulletuav.kernel import kernel
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Swarm

ENGINE_VERSION = bullet.getAPIVersion()
EXTENSION = load(bullet.__file__)

PARKING_HEIGHT, PARKING_PITCH, PARKING_COLUMNS = 2000.0, 10.0, 100
LIGHT = (0.4, -0.7, 1.0)  # towards the sun of pictures: walls differ


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


class Engine:
    """W tiles of N drones and K obstacles over one ground plane at z = 0. Poses are in each world's own frame."""

    def __init__(
        self,
        airframes: Sequence[Airframe],
        num_worlds: int,
        dt: float,
        obstacles: Sequence[Obstacle] = (),
        layouts: Sequence[Solids] = (),
        first_world: int = 0,
        live: bool = False,
    ):
        """Connect and build. `dt` is the substep, s; `first_world` the number of the first tile.

        `layouts` are what can stand in a world, one at a time; none does before `set_layouts`. `live` opens a window
        (RuntimeError where there is no screen).
        """
        if live:
            require_screen()
        with silenced():
            self._client = bullet.connect(bullet.GUI if live else bullet.DIRECT)
        self._finalizer = weakref.finalize(self, _disconnect, self._client)
        self.shape, self.dt, self.first_world, self._live = (
            (num_worlds, len(airframes)),
            dt,
            first_world,
            live,
        )
        self._offset = np.array([tile_offset(first_world + k) for k in range(num_worlds)])[
            :, None, :
        ]
        self._configure(dt, live)
        self._floor, self._ground = make_floor(self._client), make_ground(self._client)
        self._parking = self._offset + [
            (
                PARKING_PITCH * (i % PARKING_COLUMNS),
                PARKING_PITCH * (i // PARKING_COLUMNS),
                PARKING_HEIGHT,
            )
            for i in range(len(airframes))
        ]
        self._body = np.array(
            [
                [
                    make_drone(self._client, airframe, self._parking[w, i])
                    for i, airframe in enumerate(airframes)
                ]
                for w in range(num_worlds)
            ],
            dtype=np.int32,
        )
        self.obstacle_radius = np.array([obstacle.radius for obstacle in obstacles])
        below = [(0, 0, -PARKING_HEIGHT)] * num_worlds
        self._obstacle = np.array(
            [make_obstacles(self._client, one, below) for one in obstacles], dtype=np.int32
        )
        self._obstacle = self._obstacle.reshape(len(obstacles), num_worlds).T.copy()
        self._obstacle_place = np.full((*self._obstacle.shape, 3), -PARKING_HEIGHT)
        shapes = [airframe.shape for airframe in airframes]
        self._shapes = (
            np.array([shape.kind for shape in shapes]),
            np.array([shape.half for shape in shapes]),
        )
        diameter = 2 * max(airframe.collision_radius for airframe in airframes)
        self._layout_bodies = LayoutBodies(self._client, layouts, self._offset[:, 0], diameter)
        self._drone_of_body = {
            body: divmod(k, len(airframes)) for k, body in enumerate(self._body.ravel().tolist())
        }
        self._label = np.full(
            bullet.getNumBodies(self._client) + 2, BUILDING, dtype=np.uint8
        )  # and of bodies made later
        for bodies, label in (
            (self._body, DRONE),
            (self._obstacle, OBSTACLE),
            (self._floor, LAND),
            (-1, SKY),
        ):
            self._label[bodies] = label
        self._meaning = {
            body: FIRST_OBSTACLE - k
            for row in self._obstacle.tolist()
            for k, body in enumerate(row)
        }
        self._meaning |= {
            body: CITY for bodies in self._layout_bodies.body for body in bodies.ravel().tolist()
        }
        self._place = np.zeros(
            (*self.shape, 3)
        )  # positions as the engine gave them, for forces at the centre
        self._omega = np.zeros((*self.shape, 3))
        self._calls = self._make_calls(live)
        self.park(np.ones(self.shape, dtype=bool))

    def _make_calls(self, live: bool) -> EngineCalls | CExtension:
        plain = EngineCalls(self._client, self._body.ravel())
        if (
            live or EXTENSION.library is None
        ):  # the engine of a live view runs in a thread of its own
            return plain
        with silenced():
            plugin = bullet.loadPlugin(EXTENSION.path, POSTFIX, physicsClientId=self._client)
        try:
            if plugin < 0:
                raise RuntimeError("the engine refused the plugin")
            return CExtension(EXTENSION.library, self._body.ravel())
        except RuntimeError as error:
            warnings.warn(
                f"{error}: bulletuav flies without its extension, slower; see `bulletuav doctor`",
                stacklevel=3,
            )
            return plain

    @property
    def port(self) -> Port | None:
        """For compiled code to run substeps, where the extension is active."""
        if not isinstance(self._calls, CExtension):
            return None
        return Port(
            *self._calls.functions,
            self._place,
            self._omega,
            self._offset,
            self._obstacle_place,
            self.obstacle_radius,
            self.city_grid,
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
        bullet.setGravity(
            0, 0, 0, physicsClientId=self._client
        )  # weight is part of each drone's wrench
        if live:
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)

    def set_layouts(self, layout: np.ndarray, worlds: np.ndarray) -> None:
        """Have layout `layout` (W,) of the city stand in each of `worlds` (W,) bool; the others keep theirs."""
        self._layout_bodies.put(layout, worlds, self._calls)
        if self._live:
            self._show_city(0)

    def _show_city(self, world: int) -> None:
        """Have the floor and the right facade stand where pictures of a world are taken."""
        for body, height in [(self._floor, -FLOOR / 2), *self._layout_bodies.facades(world)]:
            bullet.resetBasePositionAndOrientation(
                body, self._offset[world, 0] + [0, 0, height], [0, 0, 0, 1], self._client
            )

    @property
    def city_grid(self) -> CityGrid:
        """Where the pieces of the layouts are, and which layout stands in each world."""
        return self._layout_bodies.city_grid

    def set_obstacles(
        self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray
    ) -> None:
        """Put the obstacles of `worlds` (W,) at position (W, K, 3) with quaternion (W, K, 4)."""
        if self.obstacle_radius.size:
            self._obstacle_place[worlds] = position[worlds]
            place = (position + self._offset)[worlds].reshape(-1, 3)
            self._calls.pose(
                self._obstacle[worlds].ravel(), place, quaternion[worlds].reshape(-1, 4)
            )

    def set_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Put the drones of `mask` (W, N) where `swarm` says, with its velocities, free of anything from their past."""
        quaternion = swarm.quaternion[mask]
        self._put(
            mask,
            (swarm.position + self._offset)[mask],
            quaternion,
            swarm.velocity[mask],
            _spins(quaternion, swarm.rates[mask]),
            DRONE_GROUP | SOLID,
        )

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Give the drones of one world mass (N,) kg and principal moments of inertia (N, 3) kg m^2."""
        for body, m, moments in zip(
            self._body[world].tolist(), mass.tolist(), inertia.tolist(), strict=True
        ):
            bullet.changeDynamics(
                body, -1, mass=m, localInertiaDiagonal=moments, physicsClientId=self._client
            )

    def set_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Show the drones of `mask` (W, N) where `swarm` says, without touching velocities or contacts."""
        self._calls.pose(
            self._body[mask], (swarm.position + self._offset)[mask], swarm.quaternion[mask]
        )

    def park(self, mask: np.ndarray) -> None:
        """Take the drones of `mask` (W, N) out of the airspace, to rest where nothing touches or sees them."""
        if mask.any():
            still = np.zeros((int(mask.sum()), 3))
            upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(still), 1))
            self._put(mask, self._parking[mask], upright, still, still, 0)

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
        return self._meaning.get(body, GROUND)

    def cast_rays(
        self,
        start: np.ndarray,
        end: np.ndarray,
        world: np.ndarray,
        drones: tuple[Swarm, np.ndarray] | None = None,
    ) -> np.ndarray:
        """(M,) fraction of each ray from `start` to `end` (M, 3) in world `world` (M,) before it meets something; 1 if not.

        That is ground, obstacle, building, or one of `drones`, a swarm and a mask (W, N) of it, in which it does not start.
        The engine is asked where there is more than ground and boxes; of drones it knows where its last step began.
        """
        fraction, left = walk(self.city_grid, start, end, world, self.obstacle_radius.size > 0)
        if len(left):
            last, share = within_tile(start[left], end[left])
            offset = self._offset[world[left], 0]
            met = self._calls.rays(start[left] + offset, last + offset, VISIBLE)
            fraction[left] = np.where(met < 1, met * share, 1.0)
        if drones is not None:
            meet_drones(fraction, start, end, world, *drones, *self._shapes)
        return fraction

    def surface_below(self, position: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """(W, N) height z of the surface under each drone of `mask`, m; -inf outside `mask`."""
        surface = np.empty(self.shape)
        who, start, end = columns(
            position, mask, self._obstacle_place, self.obstacle_radius, self.city_grid, surface
        )
        if len(who):
            land(surface, who, start, self.cast_rays(start, end, who[:, 0]))
        return surface

    def separation(self, world: int, one: tuple, two: tuple, within: float) -> float:
        """Closest distance of two collision shapes, negative when they overlap, inf beyond `within` (m).

        `one` and `two` are (who, position, quaternion), who as in `Contacts`, and move the engine's bodies there; without a
        position they are where they are.
        """
        bodies = [self._bodies_at(world, *one) for one in (one, two)]
        return min(
            (
                point[DISTANCE]
                for a, b in itertools.product(*bodies)
                for point in bullet.getClosestPoints(a, b, within, physicsClientId=self._client)
            ),
            default=np.inf,
        )

    def _bodies_at(
        self, world: int, who: int, position: np.ndarray | None, quaternion: np.ndarray | None
    ) -> list[int]:
        """The bodies of someone in a world, put there."""
        if who == GROUND:
            return [self._ground]
        if who == CITY:
            return self._layout_bodies.solid_bodies(world)
        body = self._body[world, who] if who >= 0 else self._obstacle[world, FIRST_OBSTACLE - who]
        if position is not None:
            bullet.resetBasePositionAndOrientation(
                body, position + self._offset[world, 0], quaternion, self._client
            )
        return [body]

    def picture(
        self, world: int, view: np.ndarray, projection: np.ndarray, size: tuple[int, int]
    ) -> Picture:
        """What a camera given by matrices (see `view`) in the world's own frame sees; needs no screen."""
        self._show_city(world)
        shift = np.eye(4)
        shift[:3, 3] = -self._offset[world, 0]
        width, height = size
        _, _, pixels, buffer, bodies = bullet.getCameraImage(
            width,
            height,
            (view @ shift).T.ravel().tolist(),  # Bullet wants columns first
            projection.T.ravel().tolist(),
            lightDirection=LIGHT,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        bodies = np.asarray(bodies).reshape(height, width)
        pixels = np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        depth = metres(np.asarray(buffer, dtype=np.float64).reshape(height, width)).astype(
            np.float32
        )
        return Picture(pixels, depth, self._label[np.minimum(bodies, len(self._label) - 2)])

    def look_at(self, world: int, target: np.ndarray, distance: float) -> None:
        """Point the live view at `target` (3,) of a world from `distance` metres."""
        place = (target + self._offset[world, 0]).tolist()
        bullet.resetDebugVisualizerCamera(distance, 45, -35, place, physicsClientId=self._client)

    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._calls = EngineCalls(
            self._client, self._body.ravel()
        )  # which the engine's own errors guard from here on
        self._finalizer()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._finalizer.alive
