"""All bodies of an engine, and what each of them stands for."""

import warnings
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.engine.bodies import (
    Colour,
    Pose,
    make_floor,
    make_ghost,
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

GHOST_COLOUR = (0.98, 0.62, 0.15, 1.0)
"""Colour of the collision shapes of drones in pictures"""
SPREAD, IN_ROW = 4.0, 32
"""How far apart obstacles are made below their world, m, and how many in a row"""


class Contents(NamedTuple):
    """What is in W worlds of an engine.

    Attributes:
        airframes: Airframe of each of N drones.
        obstacles: The K obstacles of each world.
        layouts: What can stand in a world, one at a time.
        layout: (W,) which of them stands, see `LayoutBodies`.
        offset: (W, 3) origins of the tiles, m.
        parking: (W, N, 3) places of parked drones in Bullet's frame, m.
    """

    airframes: Sequence[Airframe]
    obstacles: Sequence[Obstacle]
    layouts: Sequence[Solids]
    layout: np.ndarray
    offset: np.ndarray
    parking: np.ndarray


class BodyTable:
    """Bodies of W worlds of N drones, K obstacles and L city layouts.

    Attributes:
        floor: The ground that pictures show.
        ground: The plane z = 0 that drones and rays meet.
        drone: (W, N) the drones.
        layouts: The city layouts.
    """

    def __init__(self, client: int, contents: Contents, at_once: bool) -> None:
        """Make the bodies, out of each other's way.

        Args:
            client: Number that Bullet gave the client.
            contents: What is in the worlds.
            at_once: Whether obstacles and cities are made now, or when somebody first asks for
                them: Bullet takes time to make each body, and in every step.
        """
        airframes, obstacles, layouts, layout, offset, parking = contents
        num_drones = len(airframes)
        # Bullet numbers bodies in the order in which they are made, and solves contacts by number.
        self.floor = make_floor(client)
        self.ground = make_ground(client)
        with drawn_files(airframes) as files:
            drones = [
                [
                    make_drone(client, airframe, files[airframe.urdf], parking[w, i])
                    for i, airframe in enumerate(airframes)
                ]
                for w in range(len(offset))
            ]
        self.drone = np.array(drones, dtype=np.int32)
        self._client = client
        self._obstacles, self._offset = obstacles, offset
        # Obstacles and cities, which may be made later
        self._other_of_body: dict[int, int] = {}
        self._made_later = 0
        diameter = 2 * max(airframe.collision_radius for airframe in airframes)
        self.layouts = LayoutBodies(client, layouts, layout, offset, diameter)
        self._num_bodies: int = bullet.getNumBodies(client)
        if at_once:
            self.obstacle  # noqa: B018
            self.layouts.make()
        self._airframes = tuple(airframes)
        self._added: list[int] = []
        self._ghosts: list[int] = []
        # Bodies that nobody told us of when somebody was last warned of them.
        self._strangers = 0
        # World and index of the drone that a body is.
        self._drone_of_body = {
            body: divmod(k, num_drones) for k, body in enumerate(self.drone.ravel().tolist())
        }

    @cached_property
    def obstacle(self) -> np.ndarray:
        """(W, K) the obstacles; they are made when this is first asked for."""
        # Bullet's tree of bodies stays slow forever where many are made at the same place.
        made = [
            make_solids(self._client, one.shape, one.colour, _below(self._offset, k))
            for k, one in enumerate(self._obstacles)
        ]
        for k, bodies in enumerate(made):
            self._other_of_body |= dict.fromkeys(bodies, FIRST_OBSTACLE - k)
        self._made_later = sum(map(len, made))
        bodies_of = np.array(made, dtype=np.int32).reshape(len(made), len(self._offset))
        return bodies_of.T.copy()

    def add(self, shape: Shape, colour: Colour, poses: Iterable[Pose], other: int) -> None:
        """Make a piece of a body that stands still.

        Args:
            shape: Its shape.
            colour: Red, green, blue and opacity, from 0 to 1.
            poses: Position (3,) in Bullet's frame, m, and quaternion (4,) of each copy.
            other: What a contact calls the body.
        """
        made = make_solids(self._client, shape, colour, poses)
        self._added += made
        self._other_of_body |= dict.fromkeys(made, other)

    def warn_of_strangers(self) -> None:
        """Warn, once each, of bodies that someone made in our client without `add_body`."""
        of_layouts = len(self.layouts.numbers) + self.layouts.num_facades
        made_later = self._made_later + of_layouts + len(self._added + self._ghosts)
        known = self._num_bodies + made_later
        strangers = bullet.getNumBodies(self._client) - known
        if strangers > self._strangers:
            warnings.warn(
                f"bodies made in the engine by others: {strangers}; sensors and dynamics do not "
                f"know them; use add_body(source, position) of the environment instead",
                stacklevel=2,
            )
        self._strangers = strangers

    def ghosts(self) -> list[int]:
        """List the bodies that show the collision shapes of the drones; the first call makes them.

        Returns:
            N bodies, one for each drone of a world.
        """
        if not self._ghosts:
            self._ghosts = [
                make_ghost(self._client, airframe.shape, GHOST_COLOUR)
                for airframe in self._airframes
            ]
        return self._ghosts

    def drone_of(self, body: int) -> tuple[int, int] | None:
        """Give world and index of the drone that a body is, None for other bodies."""
        return self._drone_of_body.get(body)

    def other(self, body: int) -> int:
        """Give what a contact calls a body: the index of a drone, or one of its numbers below 0."""
        if body in self._drone_of_body:
            return self._drone_of_body[body][1]
        return self._other_of_body.get(body, CITY if body in self.layouts.numbers else GROUND)

    def bodies_of(self, world: int, who: int) -> list[int]:
        """List the bodies of someone in a world.

        Args:
            world: Index of the world.
            who: Index of a drone, `GROUND`, `CITY`, or `FIRST_OBSTACLE` - k for obstacle k.

        Returns:
            Their bodies; a city may have many, or none.
        """
        if who == GROUND:
            return [self.ground]
        if who == CITY:
            return self.layouts.solid_bodies(world)
        if who >= 0:
            return [self.drone[world, who]]
        return [self.obstacle[world, FIRST_OBSTACLE - who]]

    def pixel_labels(self) -> np.ndarray:
        """Make the table of what pixels show, by the body that Bullet sees in them.

        Returns:
            (B,) uint8. The entry before the last is for all bodies that are made later. The last is
            for pixels without a body (-1).
        """
        obstacles = self.obstacle.ravel().tolist()
        last = max([self._num_bodies - 1, *self._added, *self._ghosts, *obstacles])
        label = np.full(last + 3, BUILDING, dtype=np.uint8)
        label[self.drone] = DRONE
        label[self._ghosts] = DRONE
        label[self.obstacle] = OBSTACLE
        label[self._added] = OBSTACLE
        label[self.floor] = LAND
        label[-1] = SKY
        return label


def _below(offset: np.ndarray, k: int) -> list[Pose]:
    """Choose places for obstacle k below the middles (W, 3) of all worlds."""
    place = np.array((SPREAD * (k % IN_ROW), SPREAD * (k // IN_ROW), -PARKING_HEIGHT))
    return [(tuple(one), LEVEL) for one in (offset + place).tolist()]
