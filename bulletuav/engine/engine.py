"""The engine: W worlds of N drones as tiles of Bullet clients, with array arguments.

Only modules of `bulletuav.engine` call pybullet. The rest of the package relies on three
properties, which tests check: bodies have neither Bullet's default damping nor its velocity limit;
resets in place leave no trace of the past; worlds do not influence each other.
"""

import hashlib
import weakref
from collections.abc import Callable, Sequence
from ctypes import PyDLL
from functools import cached_property

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.engine.bodies import Colour
from bulletuav.engine.body_source import BodySource, check_pose, pieces_of
from bulletuav.engine.body_table import IN_ROW, SPREAD, AddedPiece, Contents
from bulletuav.engine.c_extension import (
    NO_SESSION,
    CExtension,
    EnginePort,
    bring_out,
    load_extension,
)
from bulletuav.engine.calls import DRONE_GROUP, SOLID, bullet
from bulletuav.engine.client import disconnect
from bulletuav.engine.drones import require_loadable
from bulletuav.engine.in_bullet import InBullet, group_worlds, make_in_bullet
from bulletuav.engine.parking import PARKING_HEIGHT, parking_places
from bulletuav.engine.queries import EngineQueries
from bulletuav.engine.tiles import globalise, localise, localise_velocities, tile_offset
from bulletuav.engine.visual_scene import ScenePoses
from bulletuav.errors import find_choice, finite
from bulletuav.geometry.obstacle import MAX_FRICTION, Obstacle
from bulletuav.geometry.scenery import NOWHERE, Scenery, place_body
from bulletuav.geometry.scenery import add_body as add_body_to_scenery
from bulletuav.geometry.shapes import Shape
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Swarm

EXTENSION = load_extension(getattr(bullet, "__file__", None))

RAY_METHODS = {"compiled": True, "bullet": False}
"""Ray casting methods by name, and whether they are compiled code"""
PLAIN = Obstacle("sphere", (1.0,))
"""Obstacle whose colour, friction and restitution are the defaults of added bodies"""


class Engine(EngineQueries):
    """W tiles of N drones and K obstacles over one ground plane at z = 0.

    Poses are in each world's own frame, east, north and up from the centre of its tile. The Bullet
    clients are opened, and the bodies are created, at their first use; flights and sensors of
    compiled code never use them.

    Attributes:
        dt: Duration of a substep, s.
        first_world: Index of the first tile.
        velocity: (W, N, 3) velocities of the drones in Bullet, world axes, m/s.
        omega: (W, N, 3) angular velocities of the drones in Bullet, world axes, rad/s.
        bodies: (W,) uint64, a hash of the bodies added by `add_body` in each world; 0 for none.
        closed: True after `close`.
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
        """Create the worlds, with all drones parked.

        Args:
            airframes: Airframe of each of the N drones of a world.
            num_worlds: Number of worlds.
            dt: Duration of a substep, s.
            obstacles: The K obstacles of each world.
            layouts: The city layouts, one of which can be present in a world at a time; none is
                before `set_layouts`.
            first_world: Index of the first tile.
            live: Whether to open a window.
            rays: "compiled", or "bullet" to cast rays by Bullet's `rayTestBatch`: slower, accurate
                to a millimetre, for comparison.
            contacts: Whether Bullet resolves contacts, instead of `bulletuav.contact`.

        Raises:
            RuntimeError: If there is no screen for a window.
            ValueError: If Bullet cannot load the URDF of an airframe, or `rays` is neither.
        """
        find_choice("rays", rays, dict.fromkeys(RAY_METHODS))
        require_loadable(airframes)
        offset = np.array([tile_offset(first_world + k) for k in range(num_worlds)])
        super().__init__(
            airframes=airframes,
            obstacles=obstacles,
            layouts=layouts,
            offset=offset,
            compiled=RAY_METHODS[rays],
        )
        self.dt = dt
        self._extension = EXTENSION
        self.first_world = first_world
        self._live, self._contacts = live, contacts
        self._num_added = 0
        self._added_pieces: list[AddedPiece] = []
        self.bodies = np.zeros(num_worlds, dtype=np.uint64)
        # Masses and inertias of bodies that are not created yet
        self._masses: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        # Whether `set_obstacles` was called before the bodies are created
        self._has_placed_obstacles = False
        self._contents = Contents(
            airframes,
            obstacles,
            layouts,
            self.city_grid.layout,
            offset,
            parking_places(offset, len(airframes)),
        )
        # Positions from Bullet, at which forces act
        self._place = self._contents.parking.copy()
        self.velocity, self.omega = np.zeros((2, *self.shape, 3))
        # Drones whose bodies are not parked: none before they are created
        self._out = np.zeros(self.shape, dtype=bool)
        self.closed = False
        self._open: list[int] = []
        self._finalizer = weakref.finalize(self, disconnect, self._open)
        if self.asks_bodies:
            self.make_bodies()

    def make_bodies(self) -> None:
        """Create all bodies now instead of at their first use."""
        self._groups  # noqa: B018

    @cached_property
    def _groups(self) -> list[InBullet]:
        """Open the Bullet clients and create all bodies, with the drones parked."""
        if self.closed:
            raise RuntimeError("the engine is closed")
        how = (self.dt, self._live, self.asks_bodies)
        # One window shows all worlds; Bullet's contacts and rays are for comparison, and the meshes
        # of cities are created for each client
        parts = [slice(0, self.shape[0])] if self.asks_bodies else group_worlds(*self.shape)
        groups = [
            make_in_bullet(worlds, self._contents, *how, self._open, self._extension)
            for worlds in parts
        ]
        everyone = np.ones(self.shape, dtype=bool)
        for group in groups:
            self._rest(group, everyone)
            # Apply the calls that came before
            for world, masses in self._masses.items():
                if group.has(world):
                    group.set_masses(world, *masses)
            if self._has_placed_obstacles:
                self._move_obstacles(group, everyone[:, 0])
            for added in self._added_pieces:
                group.add(added)
            self._move_bodies(group)
        return groups

    @property
    def _bullet(self) -> InBullet:
        """The only group of worlds in Bullet of an engine that `asks_bodies`."""
        return self._groups[0]

    def _group_of(self, world: int) -> InBullet:
        """Return the group of a world in Bullet."""
        size: int = self._groups[0].worlds.stop
        return self._groups[world // size]

    @property
    def _is_made(self) -> bool:
        """Whether the bodies in Bullet are created."""
        return "_groups" in self.__dict__

    @property
    def contents(self) -> Contents:
        """Drones, obstacles and city layouts of the worlds, without added bodies."""
        return self._contents

    @property
    def added_shapes(self) -> tuple[tuple[Shape, Colour], ...]:
        """Shape and colour of each piece of the added bodies."""
        return tuple((piece.shape, piece.colour) for piece in self._added_pieces)

    def scene_poses(self, swarm: Swarm) -> ScenePoses:
        """Return a copy of the poses of all bodies in pictures, with the drones' from a swarm."""
        return ScenePoses(
            swarm.position.copy(),
            swarm.quaternion.copy(),
            self._scenery.place.copy(),
            self._scenery.quaternion.copy(),
            self.city_grid.layout.copy(),
            self.added_shapes,
        )

    @property
    def ports(self) -> list[EnginePort]:
        """Port of each group of worlds, for flight in compiled code; none without the extension."""
        ports = [
            self._port(group.calls.session, group.calls.library, group.worlds)
            for group in self._groups
            if isinstance(group.calls, CExtension)
        ]
        # Flights use either the extension or the calls of pybullet in all worlds
        return ports if len(ports) == len(self._groups) else []

    @property
    def surface_port(self) -> EnginePort | None:
        """Port of all worlds for `surface_below` only: compiled rays do not need Bullet."""
        if self._extension.library is None:
            return None
        if not self._compiled:
            return next(iter(self.ports), None)
        return self._port(NO_SESSION, self._extension.library, slice(0, self.shape[0]))

    def _port(self, session: int, library: PyDLL, worlds: slice) -> EnginePort:
        """Build the port of a session."""
        return EnginePort(
            session=session,
            first=worlds.start,
            last=worlds.stop,
            substep=library.batch_substep,
            write=library.batch_write,
            rays=library.batch_rays,
            place=self._place,
            velocity=self.velocity,
            omega=self.omega,
            offset=self._offset,
            obstacle_radius=self.obstacle_radius,
            city_grid=self.city_grid,
            scenery=self.scenery,
            compiled=self._compiled,
        )

    def set_layouts(self, layout: np.ndarray, worlds: np.ndarray) -> None:
        """Change the city layouts of worlds.

        Args:
            layout: (W,) new layout of each world, or `NO_LAYOUT`.
            worlds: (W,) bool, worlds to change.
        """
        before = self.city_grid.layout.copy()
        self.city_grid.layout[worlds] = layout[worlds]
        if self._is_made:
            for group in self._groups:
                group.bodies.warn_of_strangers()
                group.bodies.layouts.follow(before[group.worlds], group.calls)
        if self._live:
            self._bullet.renderer.show_city(0)

    def note_obstacles(
        self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray
    ) -> None:
        """Set poses of obstacles like `set_obstacles`, without moving Bullet's bodies.

        `show_obstacles` moves the bodies later.
        """
        count = self.obstacle_radius.size
        if count:
            self._scenery.place[worlds, :count] = position[worlds]
            self._scenery.quaternion[worlds, :count] = quaternion[worlds]

    def set_obstacles(
        self, position: np.ndarray, quaternion: np.ndarray, worlds: np.ndarray
    ) -> None:
        """Set poses of obstacles.

        Args:
            position: (W, K, 3) positions, m.
            quaternion: (W, K, 4) attitudes, body to world.
            worlds: (W,) bool, worlds whose obstacles to move.
        """
        if self.obstacle_radius.size:
            self.note_obstacles(position, quaternion, worlds)
            self._has_placed_obstacles = True
            if self._is_made:
                for group in self._groups:
                    self._move_obstacles(group, worlds)

    @property
    def asks_bodies(self) -> bool:
        """Whether flights and sensors need Bullet bodies at the poses of the obstacles."""
        return self._live or self._contacts or not self._compiled

    def show_obstacles(self) -> None:
        """Move the bodies of obstacles and of added bodies to the poses in the scenery."""
        for group in self._groups:
            if self.obstacle_radius.size:
                self._move_obstacles(group, np.ones(self.shape[0], dtype=bool))
            self._move_bodies(group)

    def _move_obstacles(self, group: InBullet, worlds: np.ndarray) -> None:
        """Move the obstacles' bodies in the worlds of `worlds` (W,) to the poses in the scenery."""
        count = self.obstacle_radius.size
        moved = np.flatnonzero(worlds[group.worlds])
        indices = moved + group.worlds.start
        place = (self._scenery.place[indices, :count] + self._offset[indices]).reshape(-1, 3)
        turn = self._scenery.quaternion[indices, :count].reshape(-1, 4)
        group.calls.pose(group.bodies.obstacle[moved].ravel(), place, turn)

    def _move_bodies(self, group: InBullet) -> None:
        """Move added bodies that can move to the poses in the scenery."""
        first = self.obstacle_radius.size
        for p, (added, numbers) in enumerate(
            zip(self._added_pieces, group.bodies.added, strict=True)
        ):
            if not added.is_static:
                worlds = added.worlds[group.has(added.worlds)]
                place = self._scenery.place[worlds, first + p].copy()
                gone = place[:, 2] == NOWHERE
                place[gone] = (SPREAD * (p % IN_ROW), SPREAD * (p // IN_ROW), -2 * PARKING_HEIGHT)
                turn = self._scenery.quaternion[worlds, first + p]
                group.calls.pose(numbers, place + self._offset[worlds, 0], turn)

    def place_bodies(self, worlds: Sequence[int]) -> None:
        """Move the pieces of added bodies of worlds to the poses in `scenery.bodies`."""
        for w in worlds:
            for b in range(len(self._scenery.bodies.reach)):
                place_body(self._scenery, w, b)
        if self._is_made:
            for group in self._groups:
                self._move_bodies(group)

    def add_body(
        self,
        source: BodySource,
        position: Sequence[float],
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        world: int | None = None,
        friction: float | None = None,
        restitution: float | None = None,
        check: Callable[[Scenery], None] | None = None,
        is_static: bool = True,
    ) -> int:
        """Add a body; see `Aviary.add_body`.

        `check` is called with the new scenery, and may raise an error before anything has changed.
        A body that is not static moves by its velocities in `scenery.bodies`, or to another pose
        that is written there before `place_bodies`.
        """
        place, turn = check_pose(position, quaternion)
        pieces = pieces_of(source)
        # Only an obstacle has its own colour, friction and restitution.
        like = source if isinstance(source, Obstacle) else PLAIN
        friction = like.friction if friction is None else friction
        friction = finite("friction", friction, 0, MAX_FRICTION)
        restitution = like.restitution if restitution is None else restitution
        restitution = finite("restitution", restitution, 0, 1)
        worlds = np.arange(self.shape[0]) if world is None else np.array([world])
        other = FIRST_OBSTACLE - self.obstacle_radius.size - self._num_added
        shape = (self.shape[0], 1)
        places, turns = np.full((self.shape[0], 3), NOWHERE), np.tile(turn, shape)
        places[worlds] = place
        scenery = add_body_to_scenery(
            self._scenery,
            pieces,
            position=places,
            quaternion=turns,
            other=other,
            friction=friction,
            restitution=restitution,
        )
        if check is not None:
            check(scenery)
        for p, piece in enumerate(pieces, self._scenery.place.shape[1]):
            in_bullet = scenery.place[worlds, p] + self._offset[worlds, 0]
            poses = list(
                zip(in_bullet.tolist(), scenery.quaternion[worlds, p].tolist(), strict=True)
            )
            added = AddedPiece(piece.shape, like.colour, poses, other, worlds, is_static)
            if self._is_made:
                for group in self._groups:
                    group.add(added)
            self._added_pieces.append(added)
        self._scenery = scenery
        self._num_added += 1
        added_bodies = repr(
            ([tuple(piece) for piece in pieces], position, turn, friction, restitution)
        )
        for w in worlds:
            text = f"{self.bodies[w]} {added_bodies}".encode()
            digest = hashlib.blake2b(text, digest_size=8).digest()
            self.bodies[w] = int.from_bytes(digest, "little")
        return other

    def set_masses(self, world: int, mass: np.ndarray, inertia: np.ndarray) -> None:
        """Change the masses of the drones of one world.

        Args:
            world: Index of the world.
            mass: (N,) masses, kg.
            inertia: (N, 3) principal moments of inertia, kg m^2.
        """
        if self._is_made:
            self._group_of(world).set_masses(world, mass, inertia)
        else:
            self._masses[world] = mass.copy(), inertia.copy()

    def set_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set poses and velocities of drones, and clear Bullet's cached contacts of these drones.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to set.
        """
        if self._contacts:
            self._filter(mask, DRONE_GROUP | SOLID)
        self.write_states(swarm, mask)

    def add_states(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add a call equivalent to `set_states` to a program."""
        ports = self.ports
        if not ports or self._contacts:
            program.callback(lambda: self.set_states(swarm, mask))
            return
        for port in ports:
            program.call(bring_out, port, swarm, mask, self._out)

    def write_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set poses and velocities of drones; Bullet's cached contacts stay.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to set.
        """
        self._out |= mask
        moves = (self._place, self._offset, self.velocity, self.omega)
        globalise(*moves, mask, swarm, 0, self.shape[0])
        self._write(swarm, mask)

    def restore_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set poses and velocities of drones to earlier ones from Bullet, equal to the bit.

        Args:
            swarm: The poses; velocities are those in `velocity` and `omega`.
            mask: (W, N) bool, drones to set.
        """
        self._out |= mask
        self._place[mask] = (swarm.position + self._offset)[mask]
        self._write(swarm, mask)

    def _write(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set poses and velocities of drones in Bullet."""
        states = (mask, self._place, swarm.quaternion, self.velocity, self.omega)
        for group in self._groups:
            group.calls.write(*(array[group.worlds] for array in states))

    def set_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Set poses of drones' bodies for rendering; velocities and contacts do not change.

        Args:
            swarm: The states.
            mask: (W, N) bool, drones to move.
        """
        self._out |= mask
        place = swarm.position + self._offset
        for group in self._groups:
            moved = mask[group.worlds]
            poses = (place[group.worlds][moved], swarm.quaternion[group.worlds][moved])
            group.calls.pose(group.bodies.drone[moved], *poses)

    def park(self, mask: np.ndarray) -> None:
        """Park drones outside the airspace, where they neither touch anything nor are visible.

        Args:
            mask: (W, N) bool, drones to park; loads, which follow drones, may be left out.
        """
        every = np.zeros_like(self._out)
        every[:, : mask.shape[1]] = mask
        mask = every & self._out
        if mask.any():
            self._out &= ~mask
            if self._contacts:
                self._filter(mask, 0)
            self._place[mask] = self._contents.parking[mask]
            for group in self._groups:
                self._rest(group, mask)

    def _rest(self, group: InBullet, mask: np.ndarray) -> None:
        """Set the bodies of drones of `mask` (W, N) to rest at their parking positions."""
        parking = self._contents.parking[group.worlds]
        still = np.zeros(parking.shape)
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (*parking.shape[:2], 1))
        group.calls.write(mask[group.worlds], parking, upright, still, still)

    def _filter(self, mask: np.ndarray, meets: int) -> None:
        """Set the collision groups that drones collide with.

        This clears the bodies' cached contacts, so that no contacts of the last episode remain.
        """
        for group in self._groups:
            bodies = group.bodies.drone[mask[group.worlds]]
            group.calls.filter(bodies, DRONE_GROUP if meets else 0, meets)

    def read_poses(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Read poses of drones from Bullet into a swarm, and velocities into the engine's arrays.

        Args:
            swarm: State of all drones; positions and attitudes are written.
            mask: (W, N) bool, drones to read.
        """
        states = (mask, self._place, swarm.quaternion, self.velocity, self.omega)
        for group in self._groups:
            group.calls.read(*(array[group.worlds] for array in states))
        localise(self._place, self._offset, mask, swarm, 0, self.shape[0])

    def read_states(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Read poses and velocities of drones from Bullet into a swarm; rotor speeds stay."""
        self.read_poses(swarm, mask)
        localise_velocities(self.velocity, self.omega, mask, swarm)

    def apply_wrenches(self, force: np.ndarray, torque: np.ndarray, mask: np.ndarray) -> None:
        """Apply a force and a torque to each drone in the next step.

        Args:
            force: (W, N, 3) forces at the centre of mass, world axes, N.
            torque: (W, N, 3) torques, body axes, N m.
            mask: (W, N) bool, drones to apply them to.
        """
        wrenches = (mask, self._place, force, torque)
        for group in self._groups:
            group.calls.apply(*(array[group.worlds] for array in wrenches))

    def step(self) -> None:
        """Advance the simulation by one substep."""
        for group in self._groups:
            group.calls.step()

    def close(self) -> None:
        """Close Bullet's clients; a second call does nothing."""
        if self._is_made:
            # Later calls through pybullet raise errors instead of accessing freed memory.
            self._groups = [group.without_extension() for group in self._groups]
        self.closed = True
        self._finalizer()
