"""Stage: rewards."""

import math

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.check import require_finite


class Reward(Stage):
    """Compute the weighted sum of reward terms."""

    name = "reward"
    reads = ("results", "flown")
    writes = ("results", "rewards")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, task, results = worlds.state, worlds.task, worlds.results
        weights = np.array([float(task.weights[name]) for name in results.names])

        def raise_error() -> None:
            require_finite(task, results.named_weighted, state.rewards)

        sums = (results.unweighted, weights, state.flown, results.weighted, state.rewards)
        program.call(sum_rewards, *sums, otherwise=raise_error)


@kernel
def sum_rewards(
    terms: np.ndarray,
    weights: np.ndarray,
    flown: np.ndarray,
    weighted: np.ndarray,
    reward: np.ndarray,
) -> bool:
    """Compute the weighted sum of reward terms (T, W, N); it is 0 for drones that did not fly.

    Returns whether any reward is not finite.
    """
    broken = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            # In the order of the terms, so that sums have the same bits on all machines
            total = 0.0
            for k in range(weights.shape[0]):
                weighted[k, w, i] = weights[k] * terms[k, w, i] if flown[w, i] else 0.0
                total += weighted[k, w, i]
            reward[w, i] = total
            # Python finds the drone and the term for the message
            broken = broken or not math.isfinite(total)
    return broken
