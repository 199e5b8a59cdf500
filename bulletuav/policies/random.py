"""Policy `random`: actions drawn uniformly, the floor of every comparison."""

import numpy as np

from bulletuav.control.actions import ACTIONS
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


class RandomActions(Policy):
    """Any action with equal probability, anew at every decision; each world's follow from its own random numbers."""

    name = "random"
    actions = tuple(ACTIONS)
    reads_swarm = False

    def __init__(self, aviary: Aviary):
        super().__init__(aviary)
        self._rng: dict[int, np.random.Generator] = {}

    def reset(self, mask: np.ndarray) -> None:
        """Generators of their own for the worlds that start."""
        for k in np.flatnonzero(mask).tolist():
            generator = self.aviary.rng[k]
            assert generator is not None  # a world that starts has one
            self._rng[k] = np.random.default_rng(generator.integers(2**63))

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Uniform between the bounds of each number, or one of the choices."""
        action = self.aviary.action
        actions = np.zeros((self.aviary.num_worlds, *action.low.shape))
        for k, rng in self._rng.items():
            if action.choices is not None:
                actions[k] = rng.integers(action.choices, size=action.low.shape)
            else:
                actions[k] = rng.uniform(action.low, action.high)
        return actions
