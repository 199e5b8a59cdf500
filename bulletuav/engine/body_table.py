"""Table of an engine's bodies: which drone, obstacle or building each Bullet body represents."""

import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.engine.bodies import (
    Colour,
    Pose,
    make_floor,
    make_ground,
    make_solids,
)
from bulletuav.engine.calls import bullet
from bulletuav.engine.city_layouts import LEVEL, LayoutBodies
from bulletuav.engine.drones import drawn_files, make_drone
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.shapes import Shape
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND

SPREAD, IN_ROW = 4.0, 32
"""Spacing of unplaced obstacles below their world, m, and number of obstacles in a row"""


class Contents(NamedTuple):
    """Drones, obstacles and city layouts of W worlds of an engine.

    Attributes:
        airframes: Airframe of each of N drones.
        obstacles: The K obstacles of each world.
        layouts: The city layouts, one of which can be present in a world at a time.
        layout: (W,) present layout of each world, see `LayoutBodies`.
        offset: (W, 3) origins of the tiles, m.
        parking: (W, N, 3) positions of parked drones in Bullet's frame, m.
    """

    airframes: Sequence[Airframe]
    obstacles: Sequence[Obstacle]
    layouts: Sequence[Solids]
    layout: np.ndarray
    offset: np.ndarray
    parking: np.ndarray


class AddedPiece(NamedTuple):
    """A piece of a body that was added to an engine.

    Attributes:
        shape: Shape of the piece.
        colour: Red, green, blue and opacity, from 0 to 1.
        poses: Position (3,) in Bullet's frame, m, and quaternion (4,) of each copy.
        other: Index of the body in contacts, as `other` in `Contacts`.
        worlds: World of each copy.
        is_static: Whether the body never moves.
    """

    shape: Shape
    colour: Colour
    poses: Sequence[Pose]
    other: int
    worlds: np.ndarray
    is_static: bool


class BodyTable:
    """Bodies of W worlds of N drones, K obstacles and L city layouts.

    Attributes:
        floor: Visual body of the ground.
        ground: The plane z = 0 that drones and rays collide with.
        drone: (W, N) bodies of the drones.
        layouts: Bodies of the city layouts.
        added: Bodies of each piece of the bodies that users add.
    """

    def __init__(self, client: int, contents: Contents, at_once: bool) -> None:
        """Create the bodies, at positions where none touch.

        Args:
            client: Id of the client in Bullet.
            contents: Drones, obstacles and city layouts of the worlds.
            at_once: Whether to create the bodies of obstacles and cities now instead of at their
                first use: each body costs Bullet time when it is created, and in every step.
        """
        airframes, obstacles, layouts, layout, offset, parking = contents
        num_drones = len(airframes)
        # Body ids follow the order of creation, and Bullet solves contacts in the order of ids.
        self.floor = make_floor(client)
        self.ground = make_ground(client)
        with drawn_files(airframes) as files:
            drones = [
                [
                    make_drone(client, airframe, files.get(airframe.urdf), parking[w, i])
                    for i, airframe in enumerate(airframes)
                ]
                for w in range(len(offset))
            ]
        self.drone = np.array(drones, dtype=np.int32)
        self._client = client
        self._obstacles, self._offset = obstacles, offset
        # Obstacles and cities may be created later
        self._other_of_body: dict[int, int] = {}
        self._made_later = 0
        diameter = 2 * max(airframe.collision_radius for airframe in airframes)
        self.layouts = LayoutBodies(client, layouts, layout, offset, diameter)
        self._num_bodies: int = bullet.getNumBodies(client)
        if at_once:
            self.obstacle  # noqa: B018
            self.layouts.make()
        self.added: list[np.ndarray] = []
        # Number of unknown bodies at the last warning.
        self._strangers = 0
        # World and index of the drone of each body.
        self._drone_of_body = {
            body: divmod(k, num_drones) for k, body in enumerate(self.drone.ravel().tolist())
        }

    @cached_property
    def obstacle(self) -> np.ndarray:
        """(W, K) bodies of the obstacles, created at the first access."""
        # Bullet's broad-phase tree stays slow if many bodies are created at the same place.
        made = [
            make_solids(self._client, one.shape, one.colour, _below(self._offset, k))
            for k, one in enumerate(self._obstacles)
        ]
        for k, bodies in enumerate(made):
            self._other_of_body |= dict.fromkeys(bodies, FIRST_OBSTACLE - k)
        self._made_later = sum(map(len, made))
        bodies_of = np.array(made, dtype=np.int32).reshape(len(made), len(self._offset))
        return bodies_of.T.copy()

    def add(self, piece: AddedPiece) -> None:
        """Create the copies of a piece of a body."""
        made = make_solids(self._client, piece.shape, piece.colour, piece.poses)
        self.added.append(np.array(made, dtype=np.int32))
        self._other_of_body |= dict.fromkeys(made, piece.other)

    def warn_of_strangers(self) -> None:
        """Warn about new bodies that were created in the client without `add_body`."""
        of_layouts = len(self.layouts.numbers) + self.layouts.num_facades
        made_later = self._made_later + of_layouts + sum(map(len, self.added))
        known = self._num_bodies + made_later
        strangers = bullet.getNumBodies(self._client) - known
        if strangers > self._strangers:
            warnings.warn(
                f"bodies in the engine that bulletuav did not create: {strangers}; sensors and "
                f"dynamics ignore them; use add_body(source, position) of the environment instead",
                stacklevel=2,
            )
        self._strangers = strangers

    def drone_of(self, body: int) -> tuple[int, int] | None:
        """Return world and index of the drone of a body, None for other bodies."""
        return self._drone_of_body.get(body)

    def other(self, body: int) -> int:
        """Return the index of a body in contacts: that of a drone, or a negative constant."""
        if body in self._drone_of_body:
            return self._drone_of_body[body][1]
        return self._other_of_body.get(body, CITY if body in self.layouts.numbers else GROUND)

    def bodies_of(self, world: int, owner: int) -> list[int]:
        """Return the Bullet bodies of a drone, an obstacle, the ground or the city of a world.

        Args:
            world: Index of the world.
            owner: Index of a drone, `GROUND`, `CITY`, or `FIRST_OBSTACLE` - k for obstacle k.

        Returns:
            The bodies; a city may have many, or none.
        """
        if owner == GROUND:
            return [self.ground]
        if owner == CITY:
            return self.layouts.solid_bodies(world)
        if owner >= 0:
            return [self.drone[world, owner]]
        return [self.obstacle[world, FIRST_OBSTACLE - owner]]

    def pixel_labels(self) -> np.ndarray:
        """Return the segmentation label of each body id.

        Returns:
            (B,) uint8. The entry before the last is for all bodies that are created later. The last
            is for pixels without a body (-1).
        """
        obstacles = self.obstacle.ravel().tolist()
        added = [number for numbers in self.added for number in numbers.tolist()]
        last = max([self._num_bodies - 1, *added, *obstacles])
        label = np.full(last + 3, BUILDING, dtype=np.uint8)
        label[self.drone] = DRONE
        label[self.obstacle] = OBSTACLE
        label[added] = OBSTACLE
        label[self.floor] = LAND
        label[-1] = SKY
        return label


def _below(offset: np.ndarray, k: int) -> list[Pose]:
    """Return poses for obstacle k below the centres (W, 3) of all worlds."""
    place = np.array((SPREAD * (k % IN_ROW), SPREAD * (k // IN_ROW), -PARKING_HEIGHT))
    return [(tuple(one), LEVEL) for one in (offset + place).tolist()]
