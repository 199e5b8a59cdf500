"""City layouts as bodies of Bullet, and which of them stands in each world.

Bodies are made once, when somebody first asks for them: compiled rays and contacts never do. While
their layout stands nowhere they wait offstage, far below the ground.
"""

import itertools
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
        numbers: The bodies that were made.
    """

    def __init__(
        self,
        client: int,
        solids: Sequence[Solids],
        offset: np.ndarray,
        diameter: float,
    ) -> None:
        """Note the layouts, none of which stands.

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
        self._apart = diameter + GAP
        self._made: list[list[tuple[list[int], list[int]]]] = []
        self.numbers: set[int] = set()
        # Made when a picture first needs them, as Bullet never frees their meshes.
        self._facade: dict[int, list[int]] = {}

    def make(self) -> list[list[tuple[list[int], list[int]]]]:
        """Give meshes and compounds for each layout and world; the first call makes them."""
        if not self._made:
            stands = self.city_grid.layout[:, None]
            made = [
                make_city(
                    self._client, one, self._apart, np.where(stands == k, self._tile, offstage)
                )
                for k, (one, offstage) in enumerate(zip(self.solids, self._offstage, strict=True))
            ]
            worlds = itertools.chain.from_iterable(made)
            self.numbers = {body for meshes, compounds in worlds for body in meshes + compounds}
            self._made = made
        return self._made

    def put(
        self,
        layout: np.ndarray,
        worlds: np.ndarray,
        calls: EngineCalls | CExtension,
    ) -> None:
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
            self.city_grid.layout[w] = new
            if self._made and old != NO_LAYOUT:
                self._move(calls, self._made[old][w], self._offstage[old][w])
            if self._made and new != NO_LAYOUT:
                self._move(calls, self._made[new][w], self._tile[w])

    @staticmethod
    def _move(
        calls: EngineCalls | CExtension,
        made: tuple[list[int], list[int]],
        place: np.ndarray,
    ) -> None:
        """Put meshes and compounds at one place."""
        bodies = np.array(made[0] + made[1], dtype=np.int32)
        count = len(bodies)
        calls.pose(bodies, np.tile(place, (count, 1)), np.tile(LEVEL, (count, 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """List the bodies that drones can touch in a world."""
        layout = self.city_grid.layout[world]
        return [] if layout == NO_LAYOUT else self.make()[layout][world][1]

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
