"""City layouts as bodies of Bullet, and which of them stands in each world.

Bodies are made once. While their layout stands nowhere they wait offstage, far below the ground.
"""

from collections.abc import Sequence

import numpy as np

from bulletuav.engine.bodies import make_city, make_facades
from bulletuav.engine.c_extension import CExtension
from bulletuav.engine.calls import EngineCalls
from bulletuav.geometry.city_grid import NO_LAYOUT, make_city_grid
from bulletuav.geometry.solids import Solids

OFFSTAGE_PITCH = 4096.0
"""Depth of the first layout offstage below the ground, and of each one below the last, m"""
GAP = 1.0
"""Distance of the pieces of a compound beyond a drone's diameter, m"""
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
"""Quaternion of no rotation"""


class LayoutBodies:
    """Bodies of L city layouts in each of W worlds. In a world one layout stands, or none.

    Attributes:
        solids: The layouts.
        city_grid: The pieces of the layouts; its `layout` tells which stands in each world.
        body: For each layout, the bodies (W, B) that can stand for it in each world.
    """

    def __init__(
        self,
        client: int,
        solids: Sequence[Solids],
        offset: np.ndarray,
        diameter: float,
    ) -> None:
        """Make the bodies, all offstage.

        Args:
            client: Number that Bullet gave the client.
            solids: The layouts.
            offset: (W, 3) origins of the tiles, m.
            diameter: That of the largest drone, m.
        """
        self.solids = tuple(solids)
        self.city_grid = make_city_grid(solids, len(offset))
        self._client = client
        self._tile = offset
        self._offstage = [
            offset - [0, 0, OFFSTAGE_PITCH * (layout + 1)] for layout in range(len(self.solids))
        ]
        # For each layout and world, its meshes and its compounds.
        made = [
            make_city(client, one, diameter + GAP, places)
            for one, places in zip(self.solids, self._offstage, strict=True)
        ]
        self.body = [
            np.array([meshes + compounds for meshes, compounds in of_worlds], dtype=np.int32)
            for of_worlds in made
        ]
        self._solid = [[compounds for _, compounds in of_worlds] for of_worlds in made]
        # Made when a picture first needs them, as Bullet never frees their meshes.
        self._facade: dict[int, list[int]] = {}

    def put(self, layout: np.ndarray, worlds: np.ndarray, calls: EngineCalls | CExtension) -> None:
        """Change which layouts stand.

        Args:
            layout: (W,) layout that is to stand in each world, or `NO_LAYOUT`.
            worlds: (W,) bool, worlds to change; the others keep theirs.
            calls: That move bodies.
        """
        if not self.solids:
            return
        for w in np.flatnonzero(worlds & (layout != self.city_grid.layout)).tolist():
            old = int(self.city_grid.layout[w])
            new = int(layout[w])
            if old != NO_LAYOUT:
                self._move(calls, self.body[old][w], self._offstage[old][w])
            if new != NO_LAYOUT:
                self._move(calls, self.body[new][w], self._tile[w])
            self.city_grid.layout[w] = new

    @staticmethod
    def _move(calls: EngineCalls | CExtension, bodies: np.ndarray, place: np.ndarray) -> None:
        """Put bodies at one place."""
        count = len(bodies)
        calls.pose(bodies, np.tile(place, (count, 1)), np.tile(LEVEL, (count, 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """List the bodies that drones can touch in a world."""
        layout = self.city_grid.layout[world]
        return [] if layout == NO_LAYOUT else self._solid[layout][world]

    @property
    def num_facades(self) -> int:
        """Number of bodies that pictures show."""
        return sum(map(len, self._facade.values()))

    def facades(self, world: int) -> list[tuple[int, float]]:
        """List the bodies that pictures show, each with its height in a picture of a world.

        Args:
            world: Index of the world.

        Returns:
            Bodies and heights, m: 0 for those of the layout that stands there, else offstage.
        """
        shown = int(self.city_grid.layout[world])
        if shown != NO_LAYOUT and shown not in self._facade:
            self._facade[shown] = make_facades(self._client, self.solids[shown])
        return [
            (body, 0.0 if layout == shown else -OFFSTAGE_PITCH)
            for layout, bodies in self._facade.items()
            for body in bodies
        ]
