"""What a decision gives."""

from typing import NamedTuple

import numpy as np

from bulletuav.tasks.observations.observer import Observation


class Step(NamedTuple):
    """Outcome of a decision: observations (W, N, D) float32; rewards, terminated, truncated (W, N); info name -> (W, N).

    With camera pictures among the observations they are a dict of such arrays.
    """

    observations: Observation
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, np.ndarray]
