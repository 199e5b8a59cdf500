"""Reward terms and infos of a decision."""

from collections.abc import Mapping

import numpy as np

from bulletuav.envs.infos import InfoTable, is_immutable

INFOS = {
    "success": bool,
    "collision": bool,
    "resting": bool,
    "impulse": float,
    "conflicts": np.int64,
    "separation": float,
    "goal_distance": float,
    "power": float,
    "charge": float,
}
"""Names and types of infos in addition to reward terms, in the order of `report.fill_infos`.

Tasks without goals have no "goal_distance".
"""


class Results:
    """Arrays of reward terms and infos.

    Attributes:
        names: Names of the T reward terms.
        unweighted: (T, W, N) reward terms.
        weighted: (T, W, N) weighted reward terms; the first rows of the table.
        infos: (9, W, N) `INFOS`; the next rows of the table.
        of_parts: Infos (W, N) of the task's parts, by name; the last rows of the table.
    """

    def __init__(
        self, terms: list[str], of_parts: list[str], shape: tuple[int, int], has_goals: bool
    ) -> None:
        """Allocate the arrays.

        Args:
            terms: Names of the task's reward terms.
            of_parts: Names of the infos of `Task.compiled_info_names`.
            shape: (W, N).
            has_goals: Whether infos have the distance to the goal.
        """
        self.names = terms
        self.unweighted = np.zeros((len(terms), *shape))
        first, last = len(terms), len(terms) + len(INFOS)
        self._table = np.zeros((last + len(of_parts), *shape))
        self.weighted = self._table[:first]
        self.infos = self._table[first:last]
        self.of_parts = dict(zip(of_parts, self._table[last:], strict=True))
        left_out = None if has_goals else "goal_distance"
        standard = [(None if name == left_out else name, kind) for name, kind in INFOS.items()]
        added = [(name, float) for name in of_parts]
        self._rows = [*((f"reward/{name}", float) for name in terms), *standard, *added]

    @property
    def named_terms(self) -> dict[str, np.ndarray]:
        """Unweighted reward terms (W, N) by name."""
        return dict(zip(self.names, self.unweighted, strict=True))

    @property
    def named_weighted(self) -> dict[str, np.ndarray]:
        """Weighted reward terms (W, N) by name."""
        return dict(zip(self.names, self.weighted, strict=True))

    def info_table(self, more: Mapping[str, np.ndarray], world: object) -> InfoTable:
        """Copy the results of the last decision; calling the returned object makes infos.

        Args:
            more: Further arrays (W, N) of infos, by name.
            world: Index of the world of the infos; `...` for all.
        """
        # Immutable arrays are copied only when infos are read
        copies = {name: one if is_immutable(one) else np.array(one) for name, one in more.items()}
        return InfoTable(self._table.copy(), self._rows, copies, world)
