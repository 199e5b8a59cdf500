"""Result of one decision."""

from typing import NamedTuple

import numpy as np

from bulletuav.tasks.observations.observer import Observation


class Step(NamedTuple):
    """Result of one decision of all worlds.

    Attributes:
        observations: (W, N, D) float32; a dict of arrays (W, N, ...) with pictures, or in the
            format "dict".
        rewards: (W, N) rewards; 0 for drones that did not fly.
        terminated: (W, N) bool, drones whose episode the task ended.
        truncated: (W, N) bool, drones whose episode the horizon ended.
        info: (W, N) arrays by name.
    """

    observations: Observation
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, np.ndarray]
