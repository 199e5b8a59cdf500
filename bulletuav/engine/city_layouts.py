"""Bullet bodies of city layouts, and the present layout of each world.

Bodies are created once, at their first use; compiled rays and contacts never use them. While a
layout is not present in a world, its bodies wait offstage, far below the ground.
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
"""Depth of the first offstage layout below the ground, and of each further one below it, m"""
GAP = 1.0
"""Minimum distance of the pieces of a compound beyond a drone's diameter, m"""
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
"""Identity quaternion"""


class LayoutBodies:
    """Bodies of L city layouts in each of W worlds; at most one is present in a world.

    Attributes:
        numbers: Ids of the bodies that were created.
    """

    def __init__(
        self,
        client: int,
        solids: Sequence[Solids],
        layout: np.ndarray,
        offset: np.ndarray,
        diameter: float,
    ) -> None:
        """Store the layouts; no bodies are created.

        Args:
            client: Id of the client in Bullet.
            solids: The layouts.
            layout: (W,) present layout of each world, or `NO_LAYOUT`; the array is read in each
                call.
            offset: (W, 3) origins of the tiles, m.
            diameter: Diameter of the largest drone, m.
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
        # Created at the first rendering that needs them, as Bullet never frees their meshes.
        self._facade: dict[int, list[int]] = {}

    def make(self) -> list[list[tuple[list[int], list[int]]]]:
        """Return meshes and compounds of each layout and world; the first call creates them."""
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
        """Move bodies after the layouts of worlds have changed.

        Args:
            before: (W,) previous layout of each world.
            calls: Functions of Bullet that move bodies.
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
        """Move meshes and compounds to a position."""
        bodies = np.array(made[0] + made[1], dtype=np.int32)
        count = len(bodies)
        calls.pose(bodies, np.tile(place, (count, 1)), np.tile(LEVEL, (count, 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """Return the bodies of a world's layout that drones can touch."""
        layout = self._layout[world]
        return [] if layout == NO_LAYOUT else self.make()[layout][world][1]

    @property
    def num_facades(self) -> int:
        """Number of visual bodies."""
        return sum(map(len, self._facade.values()))

    def facades(self, world: int) -> list[tuple[int, float]]:
        """Return the visual bodies, each with its height in an image of a world.

        Args:
            world: Index of the world.

        Returns:
            Bodies and heights, m: 0 for the layout that is present in the world, else offstage.
        """
        shown = int(self._layout[world])
        if shown != NO_LAYOUT and shown not in self._facade:
            self._facade[shown] = make_facades(self._client, self._solids[shown])
        return [
            (body, 0.0 if layout == shown else -OFFSTAGE_PITCH)
            for layout, bodies in self._facade.items()
            for body in bodies
        ]
