"""Squares into which the ground outdoors in the cities of a task is divided."""

from collections.abc import Callable

import numpy as np

from bulletuav.tasks.frame import Scene
from bulletuav.tasks.parts.city_layouts import CityLayouts

MAX_CELLS = 1e6
"""Maximum number of squares into which the ground of a city can be divided"""


class GroundCells:
    """Squares of the ground in each layout of a task, 1.5 m above the ground.

    Attributes:
        count: Maximum number of squares over all layouts.
    """

    def __init__(
        self, city_layouts: CityLayouts, cell: float, find: Callable[[int, float], np.ndarray]
    ) -> None:
        """Find the squares of all layouts, and pad their lists to equal length.

        Args:
            city_layouts: Cities of the task.
            cell: Side of the squares, m.
            find: Function of the index of a layout and of `cell` that returns the centres (M, 3) of
                its squares, m.

        Raises:
            ValueError: If squares are larger than a city, or too many, or a layout has none.
        """
        sides = np.array([city.sides for city in city_layouts.cities])
        if not 0 < cell <= sides.min():
            raise ValueError(
                f"cell is {cell:g} m: it must be above 0 and at most the side of the city"
            )
        count = (sides / cell).prod(axis=1).max()
        if count > MAX_CELLS:
            raise ValueError(
                f"cell is {cell:g} m: {count:.3g} squares on a side of {sides.max():g} m, "
                f"at most {MAX_CELLS:g} are possible; make it larger, or area smaller"
            )
        cells = [find(layout, cell) for layout in range(len(sides))]
        if not all(map(len, cells)):
            raise ValueError(
                f"cell is {cell:g} m: no such square has its centre outdoors; make it smaller"
            )
        # Inactive copies of the first squares
        counts = [len(own) for own in cells]
        self.count = max(counts)
        padding = [
            np.repeat(own[:1], self.count - count, axis=0)
            for own, count in zip(cells, counts, strict=True)
        ]
        self._cells = np.array(
            [np.concatenate(parts) for parts in zip(cells, padding, strict=True)]
        )
        self._is_own = np.array([np.arange(self.count) < count for count in counts])

    def centres(self, scene: Scene) -> np.ndarray:
        """Return the centres of the squares outdoors, (W, count, 3) m."""
        centres: np.ndarray = self._cells[scene.layout]
        return centres

    def active(self, scene: Scene) -> np.ndarray:
        """Return which of them are squares rather than padding, (W, count) bool."""
        is_own: np.ndarray = self._is_own[scene.layout]
        return is_own
