"""All bodies of an engine, and what each of them stands for."""

from collections.abc import Sequence

import numpy as np

from bulletuav.engine.bodies import make_drone, make_floor, make_ground, make_obstacles
from bulletuav.engine.calls import bullet
from bulletuav.engine.city_layouts import LayoutBodies
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND


class BodyTable:
    """Bodies of W worlds of N drones, K obstacles and L city layouts.

    Attributes:
        floor: The ground that pictures show.
        ground: The plane z = 0 that drones and rays meet.
        drone: (W, N) the drones.
        obstacle: (W, K) the obstacles.
        layouts: The city layouts.
    """

    def __init__(
        self,
        client: int,
        airframes: Sequence[Airframe],
        obstacles: Sequence[Obstacle],
        layouts: Sequence[Solids],
        offset: np.ndarray,
        parking: np.ndarray,
        depth: float,
    ) -> None:
        """Make all bodies, out of each other's way.

        Args:
            client: Number that Bullet gave the client.
            airframes: Airframe of each of N drones.
            obstacles: The K obstacles of each world.
            layouts: What can stand in a world, one at a time.
            offset: (W, 3) origins of the tiles, m.
            parking: (W, N, 3) places of the drones in Bullet's frame, m.
            depth: Depth of the obstacles below the ground, m.
        """
        num_worlds = len(offset)
        num_drones = len(airframes)
        # Bullet numbers bodies in the order in which they are made, and solves contacts by number.
        self.floor = make_floor(client)
        self.ground = make_ground(client)
        drones = [
            [make_drone(client, airframe, parking[w, i]) for i, airframe in enumerate(airframes)]
            for w in range(num_worlds)
        ]
        self.drone = np.array(drones, dtype=np.int32)
        below = [(0, 0, -depth)] * num_worlds
        of_obstacles = [make_obstacles(client, obstacle, below) for obstacle in obstacles]
        by_obstacle = np.array(of_obstacles, dtype=np.int32).reshape(len(obstacles), num_worlds)
        self.obstacle = by_obstacle.T.copy()
        diameter = 2 * max(airframe.collision_radius for airframe in airframes)
        self.layouts = LayoutBodies(client, layouts, offset, diameter)

        self._num_bodies: int = bullet.getNumBodies(client)
        # World and index of the drone that a body is.
        self._drone_of_body = {
            body: divmod(k, num_drones) for k, body in enumerate(self.drone.ravel().tolist())
        }
        # What a contact calls other bodies; those that are left out are the ground.
        self._other_of_body = {
            body: FIRST_OBSTACLE - k
            for bodies in self.obstacle.tolist()
            for k, body in enumerate(bodies)
        }
        self._other_of_body |= {
            body: CITY for bodies in self.layouts.body for body in bodies.ravel().tolist()
        }

    def contacts(self, pairs: np.ndarray, force: np.ndarray) -> list[tuple[int, int, int, float]]:
        """Tell which drones touch what.

        Args:
            pairs: (C, 2) bodies that touch.
            force: (C,) normal forces, N.

        Returns:
            (world, drone, other, normal force in N), both sides of a pair of drones; `other` as in
            `Contacts`.
        """
        rows = []
        for (one, two), newtons in zip(pairs.tolist(), force.tolist(), strict=True):
            for mine, theirs in ((one, two), (two, one)):
                drone = self._drone_of_body.get(mine)
                if drone is not None:
                    rows.append((*drone, self._other(theirs), newtons))
        return rows

    def _other(self, body: int) -> int:
        """Give what a contact calls a body: the index of a drone, or one of its numbers below 0."""
        if body in self._drone_of_body:
            return self._drone_of_body[body][1]
        return self._other_of_body.get(body, GROUND)

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
        label = np.full(self._num_bodies + 2, BUILDING, dtype=np.uint8)
        label[self.drone] = DRONE
        label[self.obstacle] = OBSTACLE
        label[self.floor] = LAND
        label[-1] = SKY
        return label
