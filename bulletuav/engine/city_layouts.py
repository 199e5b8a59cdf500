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
from bulletuav.geometry.city_grid import NO_LAYOUT
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
        numbers: The bodies that were made.
    """

    def __init__(
        self,
        client: int,
        solids: Sequence[Solids],
        layout: np.ndarray,
        offset: np.ndarray,
        diameter: float,
    ) -> None:
        """Note the layouts.

        Args:
            client: Number that Bullet gave the client.
            solids: The layouts.
            layout: (W,) which of them stands in each world, or `NO_LAYOUT`; it is looked at again
                in each call.
            offset: (W, 3) origins of the tiles, m.
            diameter: That of the largest drone, m.
        """
        self._solids = tuple(solids)
        self._layout = layout
        self._client = client
        self._tile = offset
        self._offstage = [
            offset - [0, 0, OFFSTAGE_PITCH * (layout + 1)] for layout in range(len(self._solids))
        ]
        self._apart = diameter + GAP
        self._made: list[list[tuple[list[int], list[int]]]] = []
        self.numbers: set[int] = set()
        # Made when a picture first needs them, as Bullet never frees their meshes.
        self._facade: dict[int, list[int]] = {}

    def make(self) -> list[list[tuple[list[int], list[int]]]]:
        """Give meshes and compounds for each layout and world; the first call makes them."""
        if not self._made:
            stands = self._layout[:, None]
            made = [
                make_city(
                    self._client, one, self._apart, np.where(stands == k, self._tile, offstage)
                )
                for k, (one, offstage) in enumerate(zip(self._solids, self._offstage, strict=True))
            ]
            worlds = itertools.chain.from_iterable(made)
            self.numbers = {body for meshes, compounds in worlds for body in meshes + compounds}
            self._made = made
        return self._made

    def follow(self, before: np.ndarray, calls: EngineCalls | CExtension) -> None:
        """Move bodies after a change of which layouts stand.

        Args:
            before: (W,) layouts that stood until now.
            calls: That move bodies.
        """
        if not self._made:
            return
        for w in np.flatnonzero(before != self._layout).tolist():
            old, new = int(before[w]), int(self._layout[w])
            if old != NO_LAYOUT:
                self._move(calls, self._made[old][w], self._offstage[old][w])
            if new != NO_LAYOUT:
                self._move(calls, self._made[new][w], self._tile[w])

    @staticmethod
    def _move(
        calls: EngineCalls | CExtension, made: tuple[list[int], list[int]], place: np.ndarray
    ) -> None:
        """Put meshes and compounds at one place."""
        bodies = np.array(made[0] + made[1], dtype=np.int32)
        count = len(bodies)
        calls.pose(bodies, np.tile(place, (count, 1)), np.tile(LEVEL, (count, 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """List the bodies that drones can touch in a world."""
        layout = self._layout[world]
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
        shown = int(self._layout[world])
        if shown != NO_LAYOUT and shown not in self._facade:
            self._facade[shown] = make_facades(self._client, self._solids[shown])
        return [
            (body, 0.0 if layout == shown else -OFFSTAGE_PITCH)
            for layout, bodies in self._facade.items()
            for body in bodies
        ]
