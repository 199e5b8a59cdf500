"""The engine: W worlds of N drones as tiles of one Bullet client, behind calls that take arrays.

The modules of this room alone know pybullet. The rest of the package relies on three properties,
each held by a test. Bodies are free of Bullet's hidden damping and velocity clamp. Resets in place
leave no trace of the past. A world does not feel what other worlds do.
"""

import warnings
import weakref
from collections.abc import Callable, Sequence

import numpy as np

from bulletuav.engine.body_source import BodySource, pieces_of, pose_of
from bulletuav.engine.body_table import BodyTable
from bulletuav.engine.c_extension import POSTFIX, CExtension, Port, bring_out, load
from bulletuav.engine.calls import DRONE_GROUP, SOLID, EngineCalls, bullet
from bulletuav.engine.client import configure, connect, disconnect
from bulletuav.engine.parking import PARKING_HEIGHT, parking_places
from bulletuav.engine.queries import EngineQueries
from bulletuav.engine.silence import silenced
from bulletuav.engine.tiles import globalise, localise, tile_offset
from bulletuav.errors import choose, finite
from bulletuav.geometry.obstacle import MOST_FRICTION, Obstacle
from bulletuav.geometry.rotation import product, to_world
from bulletuav.geometry.scenery import NOWHERE, Scenery, add_pieces
from bulletuav.geometry.solids import Solids
from bulletuav.program import Program
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Swarm

ENGINE_VERSION: int = bullet.getAPIVersion()
EXTENSION = load(bullet.__file__)

RAY_METHODS = {"compiled": True, "bullet": False}
"""Who answers rays, and whether it is compiled code"""
PLAIN = Obstacle("sphere", (1.0,))
"""Whose colour and contact a body has that tells none"""


class Engine(EngineQueries):
    """W tiles of N drones and K obstacles over one ground plane at z = 0.

    Poses are in each world's own frame, east, north and up from the middle of its tile.

    Attributes:
        dt: Length of a substep, s.
        first_world: Number of the first tile.
    """

    def __init__(
        self,
        airframes: Sequence[Airframe],
        num_worlds: int,
        dt: float,
        obstacles: Sequence[Obstacle] = (),
        layouts: Sequence[Solids] = (),
        first_world: int = 0,
        live: bool = False,
        rays: str = "compiled",
        contacts: bool = False,
    ) -> None:
        """Connect to Bullet and make all bodies; the drones are parked.

        Args:
            airframes: Airframe of each of the N drones of a world.
            num_worlds: Number of worlds.
            dt: Length of a substep, s.
            obstacles: The K obstacles of each world.
            layouts: What can stand in a world, one at a time; none does before `set_layouts`.
            first_world: Number of the first tile.
            live: Whether to open a window.
            rays: "compiled", or "bullet" to ask Bullet where there is more than ground and boxes:
                slower, to a millimetre, for comparison.
            contacts: Whether Bullet lets drones touch, instead of `bulletuav.contact`.

        Raises:
            RuntimeError: There is no screen for a window.
            ValueError: Bullet cannot load the URDF of an airframe, or `rays` is neither.
        """
        choose("rays", rays, dict.fromkeys(RAY_METHODS))
        client = connect(live)
        self._open = [client]
        self._finalizer = weakref.finalize(self, disconnect, self._open)
        configure(client, dt, live)

        offset = np.array([tile_offset(first_world + k) for k in range(num_worlds)])
        self._parking = parking_places(offset, len(airframes))
        bodies = BodyTable(
            client,
            airframes=airframes,
            obstacles=obstacles,
            layouts=layouts,
            offset=offset,
            parking=self._parking,
            depth=PARKING_HEIGHT,
            at_once=live or contacts or not RAY_METHODS[rays],
        )
        super().__init__(
            client,
            bodies,
            airframes=airframes,
            obstacles=obstacles,
            offset=offset,
            compiled=RAY_METHODS[rays],
        )
        self.dt = dt
        self.first_world = first_world
        self._live = live
        self._contacts = contacts
        self._num_added = 0
        # Positions as Bullet gave them, at which forces act, and angular velocities.
        self._place = np.zeros((*self.shape, 3))
        self._omega = np.zeros((*self.shape, 3))
        # Drones whose bodies are not parked
        self._out = np.ones(self.shape, dtype=bool)
        self._calls = self._make_calls(live)
        self._filter(self._out, 0)
        self.park(self._out)

    def _make_calls(self, live: bool) -> EngineCalls | CExtension:
        """Choose the C extension where it works, else the calls through pybullet."""
        # Bullet runs in a thread of its own behind a live window.
        if live or EXTENSION.library is None:
            return self._calls
        with silenced():
            plugin = bullet.loadPlugin(EXTENSION.path, POSTFIX, physicsClientId=self._client)
        try:
            if plugin < 0:
                raise RuntimeError("the engine refused the plugin")
            return CExtension(EXTENSION.library, self._bodies.drone.ravel())
        except RuntimeError as error:
            warnings.warn(
                f"{error}: bulletuav flies without its extension, slower; see `bulletuav doctor`",
                stacklevel=3,
            )
            return self._calls

    @property
    def port(self) -> Port | None:
        """Arrays and functions for compiled code to run substeps; None without the C extension."""
        if not isinstance(self._calls, CExtension):
            return None
        session, substep, write, rays = self._calls.functions
        return Port(
            session=session,
            substep=substep,
            write=write,
            rays=rays,
            place=self._place,
            omega=self._omega,
            offset=self._offset,
            obstacle_radius=self.obstacle_radius,
            city_grid=self.city_grid,
            scenery=self.scenery,
            compiled=self._compiled,
        )

    def set_layouts(self, layout: np.ndarray, worlds: np.ndarray) -> None:
        """Change which city layouts stand.

        Args:
            layout: (W,) layout that is to stand in each world, or `NO_LAYOUT`.
            worlds: (W,) bool, worlds to change; the others keep theirs.
        """
        self._bodies.warn_of_strangers()
        self._bodies.layouts.put(layout, worlds, self._calls)
        if self._live:
            self._renderer.show_city(0)

    def note_obstacles(
        self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray
    ) -> None:
        """Do what `set_obstacles` does but for Bullet's bodies; see `show_obstacles`."""
        count = self.obstacle_radius.size
        if count:
            self._scenery.place[worlds, :count] = position[worlds]
            self._scenery.quaternion[worlds, :count] = quaternion[worlds]

    def set_obstacles(
        self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray
    ) -> None:
        """Put obstacles somewhere.

        Args:
            position: (W, K, 3) m.
            quaternion: (W, K, 4) body to world.
            worlds: (W,) bool, worlds whose obstacles move.
        """
        if self.obstacle_radius.size:
            self.note_obstacles(position, quaternion, worlds)
            bodies = self._bodies.obstacle[worlds].ravel()
            place = (position + self._offset)[worlds].reshape(-1, 3)
            self._calls.pose(bodies, place, quaternion[worlds].reshape(-1, 4))

    @property
    def asks_bodies(self) -> bool:
        """Whether flights and sensors need the obstacles' bodies where obstacles are."""
        return self._live or self._contacts or not self._compiled

    def show_obstacles(self) -> None:
        """Put the obstacles' bodies where the scenery tells that obstacles are."""
        count = self.obstacle_radius.size
        if count:
            place = (self._scenery.place[:, :count] + self._offset).reshape(-1, 3)
            turn = self._scenery.quaternion[:, :count].reshape(-1, 4)
            self._calls.pose(self._bodies.obstacle.ravel(), place, turn)

    def add_body(
        self,
        source: BodySource,
        position: Sequence[float],
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        world: int | None = None,
        friction: float | None = None,
        restitution: float | None = None,
        check: Callable[[Scenery], None] | None = None,
    ) -> int:
        """Put up a body that stands still, for good; see `Worlds.add_body`.

        `check` is shown what would stand then, and may raise an error before anything has changed.
        """
        place, turn = pose_of(position, quaternion)
        pieces = pieces_of(source)
        # An obstacle tells what a mesh does not.
        like = source if isinstance(source, Obstacle) else PLAIN
        friction = like.friction if friction is None else friction
        friction = finite("friction", friction, 0, MOST_FRICTION)
        restitution = like.restitution if restitution is None else restitution
        restitution = finite("restitution", restitution, 0, 1)
        worlds = np.arange(self.shape[0]) if world is None else np.array([world])
        other = FIRST_OBSTACLE - self.obstacle_radius.size - self._num_added
        # Where each piece is: that of the body, and the piece's own in it.
        places = np.full((self.shape[0], len(pieces), 3), NOWHERE)
        turns = np.tile([0.0, 0.0, 0.0, 1.0], (*places.shape[:2], 1))
        for p, piece in enumerate(pieces):
            places[worlds, p] = place + to_world(turn, piece.place)
            turns[worlds, p] = product(turn, piece.quaternion)
        scenery = add_pieces(
            self._scenery,
            [piece.shape for piece in pieces],
            place=places,
            quaternion=turns,
            other=other,
            friction=friction,
            restitution=restitution,
        )
        if check is not None:
            check(scenery)
        for p, piece in enumerate(pieces):
            in_bullet = places[worlds, p] + self._offset[worlds, 0]
            poses = zip(in_bullet.tolist(), turns[worlds, p].tolist(), strict=True)
            self._bodies.add(piece.shape, like.colour, poses, other)
        self._scenery = scenery
        self._num_added += 1
        return other

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Change the masses of the drones of one world.

        Args:
            world: Index of the world.
            mass: (N,) kg.
            inertia: (N, 3) principal moments of inertia, kg m^2.
        """
        bodies = self._bodies.drone[world].tolist()
        for body, kilograms, moments in zip(bodies, mass.tolist(), inertia.tolist(), strict=True):
            bullet.changeDynamics(
                body,
                -1,
                mass=kilograms,
                localInertiaDiagonal=moments,
                physicsClientId=self._client,
            )

    def set_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Give drones the poses and velocities of a swarm, free of anything from their past.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to set.
        """
        if self._contacts:
            self._filter(mask, DRONE_GROUP | SOLID)
        self.write_states(swarm, mask)

    def add_states(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add to a program what `set_states` does."""
        port = self.port
        if port is None or self._contacts:
            program.turn(lambda: self.set_states(swarm, mask))
        else:
            program.call(bring_out, port, swarm, mask, self._out)

    def write_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Give drones the poses and velocities of a swarm; what Bullet knows of contacts stays.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to set.
        """
        self._out |= mask
        globalise(self._place, self._offset, self._omega, mask, swarm)
        self._calls.write(mask, self._place, swarm.quaternion, swarm.velocity, self._omega)

    @property
    def omega(self) -> np.ndarray:
        """(W, N, 3) angular velocities as Bullet gave them last, world axes, rad/s."""
        return self._omega

    def restore_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Give drones the poses and velocities that Bullet gave once, to the last bit.

        Args:
            swarm: The states; angular velocities are those of `omega`.
            mask: (W, N) bool, drones to set.
        """
        self._out |= mask
        self._place[mask] = (swarm.position + self._offset)[mask]
        self._calls.write(mask, self._place, swarm.quaternion, swarm.velocity, self._omega)

    def set_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Show drones where a swarm is, without a change to velocities or contacts.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to show.
        """
        self._out |= mask
        place = (swarm.position + self._offset)[mask]
        self._calls.pose(self._bodies.drone[mask], place, swarm.quaternion[mask])

    def park(self, mask: np.ndarray) -> None:
        """Take drones out of the airspace, to rest where nothing touches or sees them.

        Args:
            mask: (W, N) bool, drones to park.
        """
        mask = mask & self._out
        if mask.any():
            self._out &= ~mask
            if self._contacts:
                self._filter(mask, 0)
            self._place[mask] = self._parking[mask]
            still = np.zeros((*self.shape, 3))
            upright = np.tile([0.0, 0.0, 0.0, 1.0], (*self.shape, 1))
            self._calls.write(mask, self._place, upright, still, still)

    def _filter(self, mask: np.ndarray, meets: int) -> None:
        """Set the collision groups that drones meet.

        It drops the bodies' cached contacts, without which a reset would remember the last episode.
        """
        bodies = self._bodies.drone[mask]
        self._calls.filter(bodies, DRONE_GROUP if meets else 0, meets)

    def read_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Write Bullet's poses and velocities of drones into a swarm; rotor speeds stay.

        Args:
            swarm: Whose states are written.
            mask: (W, N) bool, drones to read.
        """
        self._calls.read(mask, self._place, swarm.quaternion, swarm.velocity, self._omega)
        localise(self._place, self._offset, self._omega, mask, swarm)

    def apply_wrenches(self, force: np.ndarray, torque: np.ndarray, mask: np.ndarray) -> None:
        """Give drones one force and one torque each for the next step.

        Args:
            force: (W, N, 3) N, world axes, at the centre of mass.
            torque: (W, N, 3) N m, body axes.
            mask: (W, N) bool, drones to drive.
        """
        self._calls.apply(mask, self._place, force, torque)

    def step(self) -> None:
        """Advance everything by one substep."""
        self._calls.step()

    def close(self) -> None:
        """Free Bullet's client; a second call does nothing."""
        # From here on calls end in Bullet's own errors, not in freed memory.
        self._calls = EngineCalls(self._client, self._bodies.drone.ravel())
        self._finalizer()

    @property
    def closed(self) -> bool:
        """True after `close`."""
        return not self._open
