"""Policy `random`, which draws actions uniformly: the floor of every comparison."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class RandomActions(Policy):
    """Any action with equal probability, drawn anew at every decision.

    Each world's actions follow from its own random numbers.
    """

    name = "random"
    actions = ()
    reads_swarm = False
    remembers = ("_rng",)

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`."""
        super().__init__(aviary)
        self._rng: dict[int, np.random.Generator] = {}

    def reset(self, mask: np.ndarray) -> None:
        """Give the worlds of `mask` (W,) generators of their own."""
        for k in np.flatnonzero(mask).tolist():
            generator = self.aviary.rng[k]
            assert generator is not None  # a world that starts has one
            self._rng[k] = np.random.default_rng(generator.integers(2**63))

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Draw numbers between the bounds of the action, or choices; see `Policy.act`."""
        action = self.aviary.action
        actions = np.zeros((self.aviary.num_worlds, *action.low.shape))
        for k, rng in self._rng.items():
            if action.choices is not None:
                actions[k] = rng.integers(action.choices, size=action.low.shape)
            else:
                actions[k] = rng.uniform(action.low, action.high)
        return actions
