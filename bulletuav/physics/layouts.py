"""Which city stands in which world: bodies that are made once, and moved between a world's tile and the cellar below it."""

from collections.abc import Sequence

import numpy as np

from bulletuav.physics.atlas import NOWHERE, make_atlas
from bulletuav.physics.batch import Batch
from bulletuav.physics.bodies import make_city, make_facade
from bulletuav.physics.calls import Calls
from bulletuav.physics.solids import Solids

CELLAR_PITCH = 4096.0  # m, below each other and the ground wait the layouts that stand nowhere
GAP = 1.0  # m, beyond a drone's diameter, between pieces of a compound
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class Layouts:
    """L layouts, one of which, or none, stands in each of W worlds.

    Public, to read: solids, atlas (whose `layout` tells what stands where), body: of each layout the bodies (W, .) that can
    stand for it, that which rays meet first; facade (L,) the bodies that pictures show.
    """

    def __init__(self, client: int, solids: Sequence[Solids], offset: np.ndarray, diameter: float):
        """`offset` (W, 3) of the tiles, m; `diameter` of the largest drone, m."""
        self.solids, self.atlas = tuple(solids), make_atlas(solids, len(offset))
        self._tile = offset
        self._cellar = [offset - [0, 0, CELLAR_PITCH * (layout + 1)] for layout in range(len(self.solids))]
        self.body = [
            np.array(make_city(client, one, diameter + GAP, places), dtype=np.int32)
            for one, places in zip(self.solids, self._cellar, strict=True)
        ]
        nowhere = (0.0, 0.0, -CELLAR_PITCH)
        self.facade = np.array([make_facade(client, one, nowhere) for one in self.solids], dtype=np.int32)

    def put(self, layout: np.ndarray, worlds: np.ndarray, calls: Calls | Batch) -> None:
        """Have layout `layout` (W,) stand in each of `worlds` (W,) bool; the others keep theirs."""
        for w in np.flatnonzero(worlds & (layout != self.atlas.layout)).tolist():
            old, new = int(self.atlas.layout[w]), int(layout[w])
            if old != NOWHERE:
                self._move(calls, self.body[old][w], self._cellar[old][w])
            if new != NOWHERE:
                self._move(calls, self.body[new][w], self._tile[w])
            self.atlas.layout[w] = new

    @staticmethod
    def _move(calls: Calls | Batch, bodies: np.ndarray, place: np.ndarray) -> None:
        calls.pose(bodies, np.tile(place, (len(bodies), 1)), np.tile(LEVEL, (len(bodies), 1)))

    def solid_bodies(self, world: int) -> list[int]:
        """What drones touch in a world."""
        layout = self.atlas.layout[world]
        return [] if layout == NOWHERE else self.body[layout][world, 1:].tolist()

    def facades(self, world: int) -> list[tuple[int, float]]:
        """The bodies that pictures show, each with the height, m, at which it belongs in a picture of a world."""
        shown = self.atlas.layout[world]
        return [(body, 0.0 if k == shown else -CELLAR_PITCH) for k, body in enumerate(self.facade.tolist())]
