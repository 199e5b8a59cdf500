"""Totals of the episode of each drone, which trainers log next to the return."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.results import INFOS
from bulletuav.envs.stages import Stage
from bulletuav.envs.worlds import Worlds

SUCCESS, COLLISION, CONFLICTS = map(list(INFOS).index, ("success", "collision", "conflicts"))
"""Rows of `Results.infos` that totals are computed from"""


class EpisodeTotals(Stage):
    """Add the results of the decision to the totals of the episode of each drone.

    The stage is part of the compiled decision. Totals start from zero in the first decision after a
    reset of the world.
    """

    name = "totals"
    reads = ("flown", "steps", "rewards", "results")
    writes = ()

    def __init__(self, aviary: Aviary) -> None:
        """Insert the stage into the decisions of worlds that have not been started."""
        self._aviary = aviary
        self._names: list[str] = []
        self._sums, self._return = np.zeros(0), np.zeros(0)
        aviary.simulation.insert(self, after="report")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, results = worlds.state, worlds.results
        if not self._names:
            terms = [f"reward/{name}" for name in results.names]
            self._names = ["success", "conflicts", "collision", *terms]
            self._sums = np.zeros((len(self._names), *state.flown.shape))
            self._return = np.zeros(state.flown.shape)
        given = (state.flown, state.steps, state.rewards, results.weighted, results.infos)
        program.call(add_totals, *given, self._sums, self._return)

    @property
    def success(self) -> np.ndarray:
        """(W, N) 1.0 for drones that fulfilled the task in their last decision, else 0.0."""
        success: np.ndarray = self._sums[0]
        return success

    def return_of(self, world: int, drone: int) -> float:
        """Return the sum of the rewards of a drone."""
        return float(self._return[world, drone])

    def of_drone(self, world: int, drone: int) -> dict[str, float]:
        """Return the totals of a drone.

        "success" and "collision" are 0 or 1, "conflicts" and the return of each reward term
        ("reward/goal", ...) are sums.
        """
        return dict(zip(self._names, self._sums[:, world, drone].tolist(), strict=True))

    def of_world(self, world: int) -> dict[str, float]:
        """Return the means of the totals over the drones of a world's episode."""
        own = self._sums[:, world, self._aviary.members[world]].mean(axis=1)
        return dict(zip(self._names, own.tolist(), strict=True))


@kernel
def add_totals(
    flown: np.ndarray,
    steps: np.ndarray,
    rewards: np.ndarray,
    terms: np.ndarray,
    infos: np.ndarray,
    sums: np.ndarray,
    returns: np.ndarray,
) -> None:
    """Add a decision to the totals of the drones that flew it.

    Args:
        flown: (W, N) bool, drones active before the decision.
        steps: (W,) decisions since the reset, including this one.
        rewards: (W, N).
        terms: (T, W, N) weighted reward terms.
        infos: (9, W, N) `INFOS`.
        sums: (3 + T, W, N) success (of the last decision), conflicts, collision (of any decision)
            and reward terms, written.
        returns: (W, N) sums of rewards, written.
    """
    for w in range(flown.shape[0]):
        is_first = steps[w] == 1
        for i in range(flown.shape[1]):
            if not flown[w, i]:
                continue
            if is_first:
                for k in range(sums.shape[0]):
                    sums[k, w, i] = 0.0
                returns[w, i] = 0.0
            sums[0, w, i] = infos[SUCCESS, w, i]
            sums[1, w, i] += infos[CONFLICTS, w, i]
            sums[2, w, i] = max(sums[2, w, i], infos[COLLISION, w, i])
            for k in range(terms.shape[0]):
                sums[3 + k, w, i] += terms[k, w, i]
            returns[w, i] += rewards[w, i]
