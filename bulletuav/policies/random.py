"""Policy `random`: uniformly distributed actions, the lower bound of every comparison."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class RandomActions(Policy):
    """Uniformly distributed actions, drawn independently at every decision.

    Each world has its own random generator.
    """

    name = "random"
    actions = ()
    reads_swarm = False
    remembers = ("_rng",)

    def __init__(self, aviary: Aviary) -> None:
        """Allocate the random generators; see `Policy`."""
        super().__init__(aviary)
        self._rng: dict[int, np.random.Generator] = {}

    def reset(self, mask: np.ndarray) -> None:
        """Seed a generator for each world in `mask` (W,)."""
        for k in np.flatnonzero(mask).tolist():
            generator = self.aviary.rng[k]
            assert generator is not None  # set by the reset of the world
            self._rng[k] = np.random.default_rng(generator.integers(2**63))

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Draw actions between their bounds, or valid discrete choices; see `Policy.act`."""
        action = self.aviary.action
        actions = np.zeros((self.aviary.num_worlds, *action.low.shape))
        for k, rng in self._rng.items():
            if self.aviary.options.action_masks:
                actions[k, :, 0] = [
                    rng.choice(np.flatnonzero(mask)) for mask in self.aviary.action_masks()[k]
                ]
            elif action.choices is not None:
                actions[k] = rng.integers(action.choices, size=action.low.shape)
            else:
                actions[k] = rng.uniform(action.low, action.high)
        return actions
