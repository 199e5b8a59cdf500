"""Stage: actions of drones that do not decide."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class HoldActions(Stage):
    """Replace the actions of drones that do not decide, with the option `decision_every`."""

    name = "hold"
    reads = ("steps", "action")
    writes = ("given",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        program.call(
            hold_actions, state.steps, worlds.spec.decision_every, state.action, state.given
        )


@kernel
def hold_actions(
    steps: np.ndarray, every: np.ndarray, action: np.ndarray, given: np.ndarray
) -> None:
    """Replace the actions of drones that do not decide by their last ones.

    Args:
        steps: (W,) decisions since the reset.
        every: (N,) decisions of the world for each one of a drone.
        action: (W, N, A) last actions.
        given: (W, N, A) actions of the caller, which are replaced.
    """
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            if steps[w] % every[i] != 0:
                for k in range(given.shape[2]):
                    given[w, i, k] = action[w, i, k]
