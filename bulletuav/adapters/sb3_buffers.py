"""Buffers of stable-baselines3 that keep nothing of slots without a drone.

In transitions of such slots the reward is NaN, see `bulletuav.adapters.sb3`.
"""

from collections.abc import Generator
from typing import Any

import numpy as np
from gymnasium.spaces import Space

from bulletuav.errors import missing

try:
    import torch
    from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
    from stable_baselines3.common.type_aliases import RolloutBufferSamples
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None


class LivingRollouts(RolloutBuffer):
    """Buffer of on-policy algorithms that gives minibatches of transitions that drones flew.

    Minibatches, at most `batch_size` large, are of one size but for one transition; their order
    follows PyTorch's seed.

    Attributes:
        flown: Indices of the transitions that drones flew, slot by slot.
    """

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        """Compute them as stable-baselines3 does.

        An episode ends before the transitions of a slot without a drone, so they reach no
        advantage of others.

        Args:
            last_values: (slots,) estimated values after the last step.
            dones: (slots,) bool, which episodes the last step ended.
        """
        rewards = self.swap_and_flatten(self.rewards)
        self.flown = np.flatnonzero(~np.isnan(rewards))
        np.nan_to_num(self.rewards, copy=False)
        super().compute_returns_and_advantage(last_values, dones)

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Yield minibatches in a random order.

        Args:
            batch_size: Most transitions in one; None for all at once.
        """
        # Once a rollout, all slots one after the other, without what nobody flew.
        if not self.generator_ready:
            for name in ("observations", "actions", "values", "log_probs", "advantages", "returns"):
                whole = self.swap_and_flatten(getattr(self, name))
                setattr(self, name, whole[self.flown])
            self.generator_ready = True
        count = len(self.flown)
        order = torch.randperm(count).numpy()
        # As many as are needed, rounded up.
        batches = -(-count // (batch_size or count))
        for indices in np.array_split(order, batches):
            yield self._get_samples(indices)


class LivingReplay(ReplayBuffer):
    """Buffer of off-policy algorithms that keeps transitions that drones flew.

    They are kept one after the other, whatever slot they come from.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: Space[Any],
        action_space: Space[Any],
        device: torch.device | str = "auto",
        **kwargs: Any,
    ) -> None:
        """Make room.

        Args:
            buffer_size: How many transitions are kept; then the oldest are forgotten.
            observation_space: Space of one drone's observations.
            action_space: Space of its actions.
            device: PyTorch's device.
            **kwargs: Other arguments of stable-baselines3's buffer.

        Raises:
            ValueError: Memory is to be optimised, for which transitions would have to follow each
                other.
        """
        if kwargs.get("optimize_memory_usage"):
            raise ValueError(
                "optimize_memory_usage is True: transitions of living drones alone do not follow "
                "each other"
            )
        settings = {**kwargs, "n_envs": 1}
        super().__init__(buffer_size, observation_space, action_space, device, **settings)

    def add(
        self,
        obs: np.ndarray,
        next_obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Keep the transitions that have a reward.

        Args:
            obs: (slots, D) observations.
            next_obs: (slots, D) observations after the decision.
            action: (slots, A) actions, or (slots,) choices.
            reward: (slots,) rewards, NaN for slots without a drone.
            done: (slots,) bool, which episodes ended.
            infos: Infos of the slots.
        """
        # Where they go, around the end of the buffer.
        flown = np.flatnonzero(~np.isnan(reward))
        action = np.asarray(action).reshape(len(reward), self.action_dim)
        places = (self.pos + np.arange(len(flown))) % self.buffer_size
        self.observations[places, 0] = obs[flown]
        self.next_observations[places, 0] = next_obs[flown]
        self.actions[places, 0] = action[flown]
        self.rewards[places, 0] = reward[flown]
        self.dones[places, 0] = done[flown]
        self.timeouts[places, 0] = [infos[slot].get("TimeLimit.truncated", False) for slot in flown]
        self.full |= self.pos + len(flown) >= self.buffer_size
        self.pos = (self.pos + len(flown)) % self.buffer_size
