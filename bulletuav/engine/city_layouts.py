"""Which city stands in which world: bodies that are made once, and moved between a world's tile and the cellar below it."""

from collections.abc import Sequence

import numpy as np

from bulletuav.engine.bodies import make_city, make_facades
from bulletuav.engine.c_extension import CExtension
from bulletuav.engine.calls import EngineCalls
from bulletuav.geometry.city_grid import NO_LAYOUT, make_city_grid
from bulletuav.geometry.solids import Solids

OFFSTAGE_PITCH = 4096.0  # m, below each other and the ground wait the layouts that stand nowhere
GAP = 1.0  # m, beyond a drone's diameter, between pieces of a compound
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class LayoutBodies:
    """L layouts, one of which, or none, stands in each of W worlds.

    Public, to read: solids, atlas (whose `layout` tells what stands where), body: of each layout the bodies (W, .) that can
    stand for it.
    """

    def __init__(self, client: int, solids: Sequence[Solids], offset: np.ndarray, diameter: float):
        """`offset` (W, 3) of the tiles, m; `diameter` of the largest drone, m."""
        self.solids, self.city_grid = tuple(solids), make_city_grid(solids, len(offset))
        self._tile = offset
        self._cellar = [
            offset - [0, 0, OFFSTAGE_PITCH * (layout + 1)] for layout in range(len(self.solids))
        ]
        pairs = [
            make_city(client, one, diameter + GAP, places)
            for one, places in zip(self.solids, self._cellar, strict=True)
        ]
        self.body = [
            np.array([meshes + compounds for meshes, compounds in of_worlds], dtype=np.int32)
            for of_worlds in pairs
        ]
        self._solid = [[compounds for _, compounds in of_worlds] for of_worlds in pairs]
        self._client = client
        self._facade: dict[
            int, list[int]
        ] = {}  # made when a picture first needs them: the engine never frees their meshes

    def put(self, layout: np.ndarray, worlds: np.ndarray, calls: EngineCalls | CExtension) -> None:
        """Have layout `layout` (W,) stand in each of `worlds` (W,) bool; the others keep theirs."""
        for w in np.flatnonzero(worlds & (layout != self.city_grid.layout)).tolist():
            old, new = int(self.city_grid.layout[w]), int(layout[w])
            if old != NO_LAYOUT:
                self._move(calls, self.body[old][w], self._cellar[old][w])
            if new != NO_LAYOUT:
                self._move(calls, self.body[new][w], self._tile[w])
            self.city_grid.layout[w] = new

    @staticmethod
    def _move(calls: EngineCalls | CExtension, bodies: np.ndarray, place: np.ndarray) -> None:
        calls.pose(bodies, np.tile(place, (len(bodies), 1)), np.tile(LEVEL, (len(bodies), 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """What drones touch in a world."""
        layout = self.city_grid.layout[world]
        return [] if layout == NO_LAYOUT else self._solid[layout][world]

    def facades(self, world: int) -> list[tuple[int, float]]:
        """The bodies that pictures show, each with the height, m, at which it belongs in a picture of a world."""
        shown = int(self.city_grid.layout[world])
        if shown != NO_LAYOUT and shown not in self._facade:
            self._facade[shown] = make_facades(self._client, self.solids[shown])
        return [
            (body, 0.0 if layout == shown else -OFFSTAGE_PITCH)
            for layout, bodies in self._facade.items()
            for body in bodies
        ]
