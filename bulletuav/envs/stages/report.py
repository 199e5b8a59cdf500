"""Stage: infos."""

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class WriteInfos(Stage):
    """Write infos in addition to reward terms, also those of the task's parts."""

    name = "report"
    reads = ("success", "flown", "account", "energy", "scene", "time")
    writes = ("results",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, account, energy = worlds.state, worlds.account, worlds.energy.readings()
        program.call(
            fill_infos,
            state.success,
            state.flown,
            (account.collision, account.resting, account.impulse),
            (account.conflict.onsets, account.conflict.separation, account.distance),
            (energy["power"], energy["charge"]),
            worlds.results.infos,
        )
        for part in worlds.task.parts:
            for call in part.info_calls(worlds.frame, worlds.results.of_parts):
                program.call(*call)


@kernel
def fill_infos(
    success: np.ndarray,
    flown: np.ndarray,
    touched: tuple[np.ndarray, np.ndarray, np.ndarray],
    apart: tuple[np.ndarray, np.ndarray, np.ndarray],
    energy: tuple[np.ndarray, np.ndarray],
    rows: np.ndarray,
) -> None:
    """Write infos to a table (9, W, N), in this order.

    Args:
        success: (W, N) bool, drones that fulfil the task; counts only for drones that flew.
        flown: (W, N) bool, drones active before the decision.
        touched: Collision and resting (W, N) bool, and impulse (W, N), N s.
        apart: Conflicts, separation and distance to the goal (W, N).
        energy: Power and charge (W, N).
        rows: The table, written.
    """
    # Row by row, in the order of `INFOS` in `bulletuav.envs.results`: rows may be a power of two
    # apart, and interleaved writes to all of them would then evict each other from the cache
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            rows[0, w, i] = 1.0 if success[w, i] and flown[w, i] else 0.0
    _copy(touched[0], rows, 1)
    _copy(touched[1], rows, 2)
    _copy(touched[2], rows, 3)
    _copy(apart[0], rows, 4)
    _copy(apart[1], rows, 5)
    _copy(apart[2], rows, 6)
    _copy(energy[0], rows, 7)
    _copy(energy[1], rows, 8)


@func
def _copy(given: np.ndarray, rows: np.ndarray, k: int) -> None:
    """Copy an array (W, N) to row k of a table (K, W, N)."""
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            rows[k, w, i] = given[w, i]
