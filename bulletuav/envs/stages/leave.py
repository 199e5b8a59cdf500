"""Stage: end of episodes."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class EndEpisodes(Stage):
    """End episodes, and remove the drones that leave from the airspace."""

    name = "leave"
    reads = ("ended", "energy", "flown", "last")
    writes = ("terminated", "truncated", "present", "alive", "left", "engine")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        ends = (state.terminated, state.truncated, state.present, state.alive, state.left)
        charge = worlds.energy.readings()["charge"]
        if worlds.task.restarts is not None:
            charge = np.ones_like(charge)  # empty batteries do not end episodes
        given = (state.ended, charge, state.flown, state.last)

        def remove_left() -> None:
            worlds.any_left = True
            worlds.engine.park(state.left)

        program.call(end_episodes, *given, *ends, otherwise=remove_left)


@kernel
def end_episodes(
    ended: np.ndarray,
    charge: np.ndarray,
    flown: np.ndarray,
    last: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    present: np.ndarray,
    alive: np.ndarray,
    left: np.ndarray,
) -> bool:
    """Write which drones end their episodes.

    Args:
        ended: (W, N) bool, drones for which an end of the task is true.
        charge: (W, N) fraction of the charge; an empty battery ends an episode.
        flown: (W, N) bool, drones active before the decision.
        last: (W,) bool, whether the horizon is reached.
        terminated: (W, N) bool, written.
        truncated: (W, N) bool, written.
        present: (W, N) bool, written: drones that others observe in this decision, including
            truncated ones.
        alive: (W, N) bool, written: drones whose episode is running.
        left: (W, N) bool, written: drones that flew and are not alive any more.

    Returns:
        Whether any drone left.
    """
    any_left = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            terminated[w, i] = flown[w, i] and (ended[w, i] or charge[w, i] <= 0.0)
            present[w, i] = flown[w, i] and not terminated[w, i]
            # Terminated drones are not truncated
            truncated[w, i] = last[w] and present[w, i]
            alive[w, i] = present[w, i] and not truncated[w, i]
            left[w, i] = flown[w, i] and not alive[w, i]
            any_left = any_left or left[w, i]
    return any_left
